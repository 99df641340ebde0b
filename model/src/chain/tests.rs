//! The chain against the mechanics it is derived from, and against the printed equations of the paper.
//!
//! Oracles: the Lagrangian of n rigid links built from positions of the centres of mass (not from a and b),
//! differentiated numerically; the Lagrangian in the paper's appendix; identities that the bound relies on.

use super::*;
use crate::rng::{Stream, uniform};

fn random<const N: usize>(case: u64, what: u32, low: f64, high: f64) -> Vector<N> {
    let lane = |i: usize| what * 8 + u32::try_from(i).unwrap();
    Vector::from_fn(|i, _| low + (high - low) * uniform(1, Stream::Test, case, lane(i)))
}

fn random_links<const N: usize>(case: u64) -> LinkParameters<N> {
    LinkParameters {
        mass_kg: random::<N>(case, 10, 0.2, 3.0).into(),
        length_m: random::<N>(case, 11, 0.2, 2.0).into(),
        inertia_kg_m2: (case % 2 == 1).then(|| random::<N>(case, 12, 0.0, 0.5).into()),
        gravity_m_s2: 9.81,
    }
}

fn unit_links<const N: usize>() -> LinkParameters<N> {
    LinkParameters { mass_kg: [1.0; N], length_m: [1.0; N], inertia_kg_m2: None, gravity_m_s2: 9.81 }
}

/// Kinetic and potential energy of the links, from the motion of each centre of mass and the rotation about it.
fn energies<const N: usize>(links: &LinkParameters<N>, q: &Vector<N>, v: &Vector<N>) -> (f64, f64) {
    let (mut kinetic, mut potential) = (0.0, 0.0);
    let (mut end_y, mut end_velocity) = (0.0, [0.0; 2]);
    for i in 0..N {
        let (m, l) = (links.mass_kg[i], links.length_m[i]);
        let inertia = links.inertia_kg_m2.map_or(m * l * l / 12.0, |given| given[i]);
        let (sin, cos) = libm::sincos(q[i]);
        let half = [l / 2.0 * cos * v[i], l / 2.0 * sin * v[i]];
        let centre = [end_velocity[0] + half[0], end_velocity[1] + half[1]];
        kinetic += (m * (centre[0] * centre[0] + centre[1] * centre[1]) + inertia * v[i] * v[i]) / 2.0;
        potential += m * links.gravity_m_s2 * (end_y - l / 2.0 * cos);
        end_y -= l * cos;
        end_velocity = [centre[0] + half[0], centre[1] + half[1]];
    }
    (kinetic, potential)
}

fn unit<const N: usize>(i: usize) -> Vector<N> {
    Vector::from_fn(|k, _| if k == i { 1.0 } else { 0.0 })
}

/// Central difference of order 4 of `f` at 0.
fn derivative(f: impl Fn(f64) -> f64) -> f64 {
    let h = 1e-3;
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

/// d/dt ∂L/∂q̇ − ∂L/∂q at (q, v) with acceleration x, by differences of L alone.
fn euler_lagrange<const N: usize>(
    lagrangian: impl Fn(&Vector<N>, &Vector<N>) -> f64,
    q: &Vector<N>,
    v: &Vector<N>,
    x: &Vector<N>,
) -> Vector<N> {
    // L is quadratic in the velocities, so a wide central difference is exact up to rounding.
    let momentum = |q: &Vector<N>, v: &Vector<N>, i: usize| {
        (lagrangian(q, &(v + unit::<N>(i))) - lagrangian(q, &(v - unit::<N>(i)))) / 2.0
    };
    Vector::from_fn(|i, _| {
        let momentum_rate = derivative(|t| momentum(&(q + v * t + x * (t * t / 2.0)), &(v + x * t), i));
        momentum_rate - derivative(|s| lagrangian(&(q + unit::<N>(i) * s), v))
    })
}

fn check_against_lagrangian<const N: usize>() {
    for case in 0..20 {
        let links = random_links::<N>(case);
        let chain = Chain::from_links(&links).unwrap();
        let q = random(case, 0, -3.0, 3.0);
        let (v, x) = (random(case, 1, -2.0, 2.0), random(case, 2, -3.0, 3.0));
        let (kinetic, potential) = energies(&links, &q, &v);
        let scale = 1.0 + chain.a().amax() * links_f64::<N>() + chain.b().amax();
        assert!((chain.kinetic_energy(&q, &v) - kinetic).abs() < 1e-13 * scale * 10.0, "N {N}, case {case}");
        assert!((chain.potential_energy(&q) - potential).abs() < 1e-13 * scale, "N {N}, case {case}");
        let lagrangian = |q: &Vector<N>, v: &Vector<N>| {
            let (kinetic, potential) = energies(&links, q, v);
            kinetic - potential
        };
        let expected = euler_lagrange(lagrangian, &q, &v, &x);
        let found = chain.mass_matrix(&q) * x + chain.coriolis(&q, &v) * v + chain.gravity(&q);
        // The difference quotients err by h⁴ times a fifth derivative (some 100 · scale) and by rounding over h.
        assert!((found - expected).amax() < 1e-9 * scale, "N {N}, case {case}: {found} {expected}");
        assert!((chain.torque_for(&q, &v, &v, &x) - found).amax() < 1e-13 * scale * 10.0, "N {N}, case {case}");
        assert!((chain.bias(&q, &v) - (found - chain.mass_matrix(&q) * x)).amax() < 1e-12 * scale, "N {N}");
        let solved = chain.acceleration(&q, &v, &chain.torque_for(&q, &v, &v, &x));
        // Forward dynamics lose the condition number of M, here up to some 1e4.
        assert!((solved - x).amax() < 1e-9, "N {N}, case {case}: {solved} {x}");
    }
}

#[test]
fn the_terms_are_the_euler_lagrange_equations_of_rigid_links_for_every_number_of_links() {
    check_against_lagrangian::<1>();
    check_against_lagrangian::<2>();
    check_against_lagrangian::<3>();
    check_against_lagrangian::<4>();
    check_against_lagrangian::<5>();
    check_against_lagrangian::<6>();
    check_against_lagrangian::<7>();
}

/// The Lagrangian of the paper's appendix, as it is printed, with uniform rods for its I_c.
fn lagrangian_of_the_appendix(links: &LinkParameters<3>, q: &Vector<3>, v: &Vector<3>) -> f64 {
    let ([m1, m2, m3], [l1, l2, l3], g) = (links.mass_kg, links.length_m, links.gravity_m_s2);
    let [i1, i2, i3] = core::array::from_fn(|k| links.mass_kg[k] * links.length_m[k] * links.length_m[k] / 12.0);
    let cos = |x: f64| libm::cos(x);
    let square = |x: f64| x * x;
    i1 * square(v[0]) / 2.0
        + m1 * square(l1 * v[0]) / 8.0
        + i2 * square(v[1]) / 2.0
        + m2 / 2.0 * (square(l1 * v[0]) + square(l2 * v[1]) / 4.0 + l1 * l2 * v[0] * v[1] * cos(q[0] - q[1]))
        + i3 * square(v[2]) / 2.0
        + m3 / 2.0
            * (square(l1 * v[0])
                + square(l2 * v[1])
                + square(l3 * v[2]) / 4.0
                + 2.0 * l1 * l2 * cos(q[0] - q[1]) * v[0] * v[1]
                + l1 * l3 * v[0] * v[2] * cos(q[0] - q[2])
                + l2 * l3 * v[1] * v[2] * cos(q[1] - q[2]))
        + m1 * g * l1 * cos(q[0]) / 2.0
        + m2 * g * (l1 * cos(q[0]) + l2 / 2.0 * cos(q[1]))
        + m3 * g * (l1 * cos(q[0]) + l2 * cos(q[1]) + l3 / 2.0 * cos(q[2]))
        - m1 * g * l1 / 2.0
        - m2 * g * (l1 + l2 / 2.0)
        - m3 * g * (l1 + l2 + l3 / 2.0)
}

/// C of the paper's (21), N·m·s²: the printed matrix, and the one with its two wrong entries put right. Both are to
/// be multiplied by the squares of the velocities, which (21) leaves out.
fn coriolis_of_the_paper(links: &LinkParameters<3>, q: &Vector<3>) -> (Matrix<3>, Matrix<3>) {
    let ([_, m2, m3], [l1, l2, l3]) = (links.mass_kg, links.length_m);
    let sin = |i: usize, j: usize| libm::sin(q[i - 1] - q[j - 1]);
    let c12 = (0.5 * m2 + m3) * l1 * l2 * sin(1, 2);
    let c13 = 0.5 * m3 * l1 * l3 * sin(1, 3);
    let printed = Matrix::<3>::new(
        0.0,
        c12,
        c13,
        -c12,
        0.0,
        0.5 * m3 * l2 * l3 * sin(1, 2),
        -c13,
        0.5 * m3 * l2 * l3 * sin(2, 3),
        0.0,
    );
    let mut corrected = printed;
    corrected[(1, 2)] = 0.5 * m3 * l2 * l3 * sin(2, 3);
    corrected[(2, 1)] = -0.5 * m3 * l2 * l3 * sin(2, 3);
    (printed, corrected)
}

#[test]
fn three_links_are_the_lagrangian_of_the_papers_appendix() {
    for case in 0..20 {
        let links = LinkParameters { inertia_kg_m2: None, ..random_links::<3>(case) };
        let chain = Chain::from_links(&links).unwrap();
        let q = random(case, 0, -3.0, 3.0);
        let (v, x) = (random(case, 1, -2.0, 2.0), random(case, 2, -3.0, 3.0));
        let expected = euler_lagrange(|q, v| lagrangian_of_the_appendix(&links, q, v), &q, &v, &x);
        let scale = 1.0 + chain.a().amax() + chain.b().amax();
        assert!((chain.torque_for(&q, &v, &v, &x) - expected).amax() < 1e-9 * scale, "case {case}");
    }
}

#[test]
fn the_papers_printed_coriolis_matrix_fails_and_the_corrected_one_holds() {
    let (mut wrong_rows, mut wrong_without_squares) = ([0; 3], 0);
    for case in 0..20 {
        let links = LinkParameters { inertia_kg_m2: None, ..random_links::<3>(case) };
        let chain = Chain::from_links(&links).unwrap();
        let (q, v) = (random(case, 0, -3.0, 3.0), random(case, 1, -2.0, 2.0));
        let still = Vector::<3>::zeros();
        let lagrangian = |q: &Vector<3>, v: &Vector<3>| lagrangian_of_the_appendix(&links, q, v);
        let truth = euler_lagrange(lagrangian, &q, &v, &still) - euler_lagrange(lagrangian, &q, &still, &still);
        let (printed, corrected) = coriolis_of_the_paper(&links, &q);
        let squares = v.component_mul(&v);
        let scale = 1e-8 * (1.0 + chain.a().amax());
        assert!((corrected * squares - truth).amax() < scale, "case {case}: the corrected (21) does not hold");
        let error = printed * squares - truth;
        for (row, count) in wrong_rows.iter_mut().enumerate() {
            *count += u32::from(error[row].abs() > scale);
        }
        wrong_without_squares += u32::from((corrected * v - truth).amax() > scale);
    }
    // Row 2: sin(θ1 − θ2) for sin(θ2 − θ3). Row 3: + for −. Row 1 is right, and C q̇ without squares is not.
    assert_eq!(wrong_rows, [0, 20, 20]);
    assert_eq!(wrong_without_squares, 20);
}

/// nalgebra offers its eigenvalues for sizes that are literals or dynamic.
fn eigenvalues<const N: usize>(matrix: &Matrix<N>) -> nalgebra::DVector<f64> {
    nalgebra::DMatrix::from_fn(N, N, |i, j| matrix[(i, j)]).symmetric_eigenvalues()
}

fn check_identities<const N: usize>() {
    for case in 0..50 {
        let chain = Chain::from_links(&random_links::<N>(case)).unwrap();
        let q: Vector<N> = random(case, 0, -3.0, 3.0);
        let [v, x, y] = [1, 2, 3].map(|what| random::<N>(case, what, -2.0, 2.0));
        let scale = 1e-13 * (1.0 + chain.a().amax()) * links_f64::<N>();
        let skew = chain.mass_matrix_rate(&q, &v) - chain.coriolis(&q, &v) * 2.0;
        assert!((skew + skew.transpose()).amax() < scale, "N {N}: Ṁ − 2C is not skew-symmetric");
        let symmetry = chain.coriolis(&q, &x) * y - chain.coriolis(&q, &y) * x;
        assert!(symmetry.amax() < 10.0 * scale, "N {N}: C(q, x) y is not C(q, y) x");
        let rate = chain.mass_matrix_rate(&q, &v);
        let differences = Matrix::<N>::from_fn(|i, j| derivative(|t| chain.mass_matrix(&(q + v * t))[(i, j)]));
        // The fifth derivative of a cosine at a rate of up to 4 rad/s, times h⁴/30, is below 1e-10.
        assert!((rate - differences).amax() < 1e-9 * (1.0 + chain.a().amax()), "N {N}: Ṁ is not the rate of M");
        let limits = eigenvalues(chain.a());
        let found = eigenvalues(&chain.mass_matrix(&q));
        assert!(found.min() >= limits.min() - scale, "N {N}: Schur's lower bound");
        assert!(found.max() <= limits.max() + scale, "N {N}: Schur's upper bound");
        let aligned = chain.mass_matrix(&Vector::repeat(q[0]));
        assert!((aligned - chain.a()).amax() < scale, "N {N}: aligned links attain both");
    }
}

#[test]
fn the_identities_that_the_bound_relies_on_hold_for_every_number_of_links() {
    check_identities::<1>();
    check_identities::<2>();
    check_identities::<3>();
    check_identities::<4>();
    check_identities::<5>();
    check_identities::<6>();
    check_identities::<7>();
}

#[test]
fn the_unit_chain_of_three_links_has_the_documented_coefficients() {
    let chain = Chain::from_links(&unit_links::<3>()).unwrap();
    let found = eigenvalues(chain.a());
    // The documentation gives six digits.
    assert!((found.min() - 0.10128).abs() < 5e-6 && (found.max() - 3.56538).abs() < 5e-6);
    assert!((chain.b() - Vector::<3>::new(24.525, 14.715, 4.905)).amax() < 1e-13);
}

#[test]
fn one_link_with_a_equal_to_m_and_b_equal_to_m_g_l_is_the_papers_scalar_system() {
    let (m, g, l) = (2.5, 9.81, 0.7);
    let chain = Chain::from_coefficients(Matrix::<1>::new(m), Vector::<1>::new(m * g * l)).unwrap();
    for case in 0..100 {
        let [q, v, tau] = [0, 1, 2].map(|what| random::<1>(case, what, -3.0, 3.0));
        let expected = -g * l * libm::sin(q[0]) + tau[0] / m;
        // (2) solved for q̈; the velocity must not matter.
        assert!((chain.acceleration(&q, &v, &tau)[0] - expected).abs() < 1e-14 * 20.0);
    }
}

#[test]
fn coefficients_are_accepted_exactly_when_a_is_symmetric_positive_definite_and_b_finite() {
    let b = Vector::<2>::new(-3.0, 0.0);
    let build = |a: [f64; 4], b: Vector<2>| Chain::from_coefficients(Matrix::<2>::new(a[0], a[1], a[2], a[3]), b);
    assert!(build([2.0, 1.0, 1.0, 2.0], b).is_ok());
    assert!(build([2.0, -1.0, -1.0, 2.0], b).is_ok());
    let refusal = |a, b| build(a, b).unwrap_err().to_string();
    assert_eq!(
        refusal([2.0, 1.0, 1.5, 2.0], b),
        "a[2][1] is 1.5, allowed: 1, the value of a[1][2] (a must be symmetric)"
    );
    assert!(refusal([2.0, f64::NAN, 1.0, 2.0], b).starts_with("a[1][2] is NaN"));
    assert!(refusal([1.0, 2.0, 2.0, 1.0], b).starts_with("pivot 2 of a is -3"));
    assert!(refusal([0.0, 0.0, 0.0, 1.0], b).starts_with("pivot 1 of a is 0"));
    assert!(refusal([1.0, 1.0, 1.0, 1.0], b).contains("positive definite"));
    // Singular in exact arithmetic, though not in rounded: 0.3² / 0.1 is not quite 0.9.
    assert!(refusal([0.1, 0.3, 0.3, 0.9], b).contains("positive definite"));
    assert_eq!(
        refusal([2.0, 1.0, 1.0, 2.0], Vector::<2>::new(1.0, f64::INFINITY)),
        "b of link 2 is inf, allowed: any finite number"
    );
    // The smallest eigenvalue decides, whatever the scale: here 1e-9 and -1e-9 of the largest.
    for (sign, accepted) in [(1.0, true), (-1.0, false)] {
        for scale in [1e-12, 1.0, 1e12] {
            let off = scale * (1.0 - sign * 1e-9);
            assert_eq!(build([scale, off, off, scale], b).is_ok(), accepted);
        }
    }
}

#[test]
fn links_are_refused_with_the_name_the_link_and_the_value() {
    let refusal = |links: LinkParameters<3>| Chain::from_links(&links).unwrap_err().to_string();
    let unit = unit_links::<3>();
    let mass = refusal(LinkParameters { mass_kg: [1.0, 0.0, 1.0], ..unit });
    assert_eq!(mass, "mass_kg of link 2 is 0, allowed: a finite number > 0");
    let length = refusal(LinkParameters { length_m: [1.0, 1.0, f64::INFINITY], ..unit });
    assert_eq!(length, "length_m of link 3 is inf, allowed: a finite number > 0");
    let inertia = refusal(LinkParameters { inertia_kg_m2: Some([-0.1, 0.0, 0.0]), ..unit });
    assert_eq!(inertia, "inertia_kg_m2 of link 1 is -0.1, allowed: a finite number >= 0");
    assert_eq!(
        refusal(LinkParameters { gravity_m_s2: f64::NAN, ..unit }),
        "gravity_m_s2 is NaN, allowed: any finite number"
    );
    assert!(Chain::from_links(&LinkParameters { inertia_kg_m2: Some([0.0; 3]), gravity_m_s2: 0.0, ..unit }).is_ok());
}

#[test]
fn joint_torques_are_the_ones_whose_differences_are_the_generalised_torques() {
    let tau = Vector::<4>::new(1.0, -2.0, 4.0, 0.5);
    let u = joint_torques(&tau);
    assert_eq!(u, Vector::<4>::new(3.5, 2.5, 4.5, 0.5));
    assert_eq!(tau, u - Vector::<4>::new(u[1], u[2], u[3], 0.0));
}

#[test]
fn the_tip_hangs_below_the_hinge_at_rest_and_lies_beside_it_at_a_right_angle() {
    let length_m = [1.0, 0.5, 0.25];
    let [x, y] = tip_position(&length_m, &Vector::zeros());
    assert!(x.abs() < 1e-15 && (y + 1.75).abs() < 1e-15);
    let [x, y] = tip_position(&length_m, &Vector::repeat(core::f64::consts::FRAC_PI_2));
    assert!((x - 1.75).abs() < 1e-15 && y.abs() < 1e-15);
}

#[test]
fn a_state_that_is_not_a_number_gives_no_number_and_no_panic() {
    let chain = Chain::from_links(&unit_links::<3>()).unwrap();
    let bad = Vector::<3>::new(f64::NAN, f64::INFINITY, 1e300);
    assert!(chain.acceleration(&bad, &bad, &bad).iter().all(|x| x.is_nan()));
}
