//! The integrator against a second one of high order, against conserved energy, and against itself.

use super::*;
use crate::chain::{Chain, LinkParameters};
use crate::law::{Law, LawInput, LawKind};
use crate::trajectory::Trajectory;
use crate::truth::Disturbance;

const MILLISECOND_NS: u64 = 1_000_000;

fn unit_truth<const N: usize>() -> Truth<N> {
    let links = LinkParameters { mass_kg: [1.0; N], length_m: [1.0; N], inertia_kg_m2: None, gravity_m_s2: 9.81 };
    Truth::ideal(Chain::from_links(&links).unwrap())
}

fn start() -> PlantState<3> {
    PlantState { q: Vector::<3>::new(0.3, -0.2, 0.25), v: Vector::zeros() }
}

fn busy_truth() -> Truth<3> {
    let disturbance =
        Disturbance::Sine { amplitude_nm: [2.0; 3], omega_rad_s: [3.0, 2.0, 5.0], phase_rad: [0.0, 1.5, 0.0] };
    Truth { viscous_nm_s: [0.3, 0.2, 0.1], coulomb_nm: [0.1; 3], disturbance, ..unit_truth() }
}

/// Gragg, Bulirsch and Stoer's extrapolated midpoint rule with 2, 4, 6 and 8 substeps (order 8) over `h_s`.
///
/// The oracle: it shares no step, no stage and no weight with Runge–Kutta, and solves the equation of motion with
/// nalgebra's own factorisation of the mass matrix.
fn gragg_step(truth: &Truth<3>, state: &PlantState<3>, tau: &Vector<3>, t_s: f64, h_s: f64) -> PlantState<3> {
    let rate = |t: f64, x: &PlantState<3>| {
        let force = tau + truth.disturbance(t) - truth.friction(&x.v) - truth.chain.bias(&x.q, &x.v);
        PlantState { q: x.v, v: truth.chain.mass_matrix(&x.q).cholesky().unwrap().solve(&force) }
    };
    let plus = |x: &PlantState<3>, y: &PlantState<3>, s: f64| PlantState { q: x.q + y.q * s, v: x.v + y.v * s };
    let counts = [2.0, 4.0, 6.0, 8.0];
    let mut row_before: Vec<PlantState<3>> = Vec::new();
    for (j, count) in counts.into_iter().enumerate() {
        let s = h_s / count;
        let (mut before, mut here, mut t) = (*state, plus(state, &rate(t_s, state), s), t_s + s);
        while t < t_s + h_s - s / 2.0 {
            (before, here) = (here, plus(&before, &rate(t, &here), 2.0 * s));
            t += s;
        }
        // Aitken and Neville's extrapolation to s² = 0.
        let mut row = vec![here];
        for k in 1..=j {
            let ratio = count / counts[j - k];
            let step = plus(&row[k - 1], &row_before[k - 1], -1.0);
            row.push(plus(&row[k - 1], &step, 1.0 / (ratio * ratio - 1.0)));
        }
        row_before = row;
    }
    row_before[counts.len() - 1]
}

/// 20 s of a closed loop at 1 kHz, with each period advanced by `advance`; all states.
fn closed_loop(
    truth: &Truth<3>,
    advance: impl Fn(u64, &PlantState<3>, &Vector<3>) -> PlantState<3>,
) -> Vec<PlantState<3>> {
    let law = Law { kind: LawKind::Robust, model: truth.chain, beta: 5.0, k_t: 106.8, k_p: 25.0, k_d: 10.0 };
    let trajectory = Trajectory::<3>::of_the_paper();
    let mut states = vec![start()];
    for tick in 0..20_000 {
        let state = states[states.len() - 1];
        let setpoint = trajectory.at(tick as f64 * 1e-3);
        let input = LawInput { q: state.q, v: state.v, q_d: setpoint.q_d, v_d: setpoint.v_d, a_d: setpoint.a_d };
        states.push(advance(tick, &state, &law.torque(&input)));
    }
    states
}

fn distance(x: &PlantState<3>, y: &PlantState<3>) -> f64 {
    (x.q - y.q).amax().max((x.v - y.v).amax())
}

#[test]
fn a_closed_loop_of_20_s_agrees_with_an_integrator_of_order_8() {
    // Coulomb friction is as good as a jump at the start, from rest at 1000 rad/s²: the subject of the next test.
    let truth = Truth { coulomb_nm: [0.0; 3], ..busy_truth() };
    let found = closed_loop(&truth, |tick, state, tau| {
        integrate(&truth, state, tau, tick * MILLISECOND_NS, (tick + 1) * MILLISECOND_NS, MILLISECOND_NS)
    });
    let expected = closed_loop(&truth, |tick, x, tau| gragg_step(&truth, x, tau, tick as f64 * 1e-3, 1e-3));
    let error = found.iter().zip(&expected).map(|(x, y)| distance(x, y)).fold(0.0, f64::max);
    assert!(error < 1e-6, "off by {error}");
    // The loop must have done something: it starts 0.3 rad off and moves by 0.9 rad in these 20 s.
    assert!((found[20_000].q[0] - found[0].q[0]).abs() > 0.5);
}

#[test]
fn shorter_steps_resolve_coulomb_friction() {
    let (truth, tau) = (busy_truth(), Vector::<3>::new(160.0, -100.0, 130.0));
    let end = |step_ns: u64| integrate(&truth, &start(), &tau, 0, 4 * MILLISECOND_NS, step_ns);
    let exact = (0..1600).fold(start(), |x, k| gragg_step(&truth, &x, &tau, f64::from(k) * 2.5e-6, 2.5e-6));
    let [coarse, fine] = [1000, 25].map(|us| distance(&end(us * 1000), &exact));
    // Through rest at some 1000 rad/s², the friction turns round within 0.1 ms: found 1.1e-4 and 5e-9.
    assert!(coarse > 1e-5 && fine < 1e-7, "{coarse} and {fine}");
}

#[test]
fn halving_the_step_divides_the_error_by_sixteen() {
    let (truth, tau) = (Truth { coulomb_nm: [0.0; 3], ..busy_truth() }, Vector::<3>::new(3.0, -2.0, 1.0));
    let end = |step_ns: u64| integrate(&truth, &start(), &tau, 0, 400 * MILLISECOND_NS, step_ns);
    let exact = (0..400).fold(start(), |x, k| gragg_step(&truth, &x, &tau, f64::from(k) * 1e-3, 1e-3));
    let [coarse, fine] = [8, 4].map(|ms| distance(&end(ms * MILLISECOND_NS), &exact));
    assert!((12.0..22.0).contains(&(coarse / fine)), "{coarse} and {fine}");
}

fn check_energy<const N: usize>() {
    let truth = unit_truth::<N>();
    let start = PlantState { q: Vector::<N>::from_fn(|i, _| 0.9 - 0.4 * i as f64), v: Vector::repeat(0.3) };
    let energy = |x: &PlantState<N>| truth.chain.kinetic_energy(&x.q, &x.v) + truth.chain.potential_energy(&x.q);
    let still = Vector::zeros();
    let end = integrate(&truth, &start, &still, 0, 2_000 * MILLISECOND_NS, MILLISECOND_NS / 5);
    let scale = truth.chain.b().sum();
    assert!((energy(&end) - energy(&start)).abs() < 1e-8 * scale, "N {N}: {}", energy(&end) - energy(&start));
    assert!((end.q - start.q).amax() > 0.1, "N {N}: nothing moved");
}

#[test]
fn a_free_chain_keeps_its_energy_for_every_number_of_links() {
    check_energy::<1>();
    check_energy::<2>();
    check_energy::<3>();
    check_energy::<4>();
    check_energy::<5>();
    check_energy::<6>();
    check_energy::<7>();
}

#[test]
fn integrals_on_the_way_do_not_change_a_bit_of_the_motion_and_the_power_adds_up_to_the_energy() {
    let (truth, tau) = (busy_truth(), Vector::<3>::new(20.0, -10.0, 5.0));
    let energy = |x: &PlantState<3>| truth.chain.kinetic_energy(&x.q, &x.v) + truth.chain.potential_energy(&x.q);
    let mut state = start();
    for tick in 0..300u64 {
        // Uneven intervals, as the arrivals of torques make them.
        let (from, to) = (tick * MILLISECOND_NS + tick * tick, (tick + 1) * MILLISECOND_NS + (tick + 1) * (tick + 1));
        let plain = integrate(&truth, &state, &tau, from, to, MILLISECOND_NS / 3);
        let power = |t: f64, x: &PlantState<3>, a: &Vector<3>| {
            [x.v.dot(&(tau + truth.disturbance(t) - truth.friction(&x.v))), a[0], 1.0]
        };
        let (next, [work, velocity, time]) = integrate_with(&truth, &state, &tau, from, to, MILLISECOND_NS / 3, power);
        assert_eq!(next, plain);
        assert!((energy(&next) - energy(&state) - work).abs() < 1e-9, "tick {tick}");
        assert!((next.v[0] - state.v[0] - velocity).abs() < 1e-13, "the acceleration is not that of the motion");
        assert!((time - (to - from) as f64 * 1e-9).abs() < 1e-17);
        state = next;
    }
    assert!(distance(&state, &start()) > 0.1);
}

#[test]
fn an_interval_is_divided_into_the_fewest_equal_steps_within_the_limit() {
    let truth = unit_truth::<3>();
    let still = Vector::zeros();
    for (span_ns, limit_ns, steps) in [(1000, 1000, 1), (1001, 1000, 2), (3000, 1000, 3), (0, 1000, 0), (5, 0, 5)] {
        let stages = core::cell::Cell::new(0);
        let count = |_: f64, _: &PlantState<3>, _: &Vector<3>| {
            stages.set(stages.get() + 1);
            [1.0]
        };
        let (_, [time]) = integrate_with(&truth, &start(), &still, 7, 7 + span_ns, limit_ns, count);
        assert_eq!(stages.get(), 4 * steps);
        assert!((time - span_ns as f64 * 1e-9).abs() < 1e-20);
    }
    assert_eq!(integrate(&truth, &start(), &still, 9, 3, 1), start());
}

#[test]
fn a_step_is_what_an_interval_of_one_step_is() {
    let (truth, tau) = (busy_truth(), Vector::<3>::new(3.0, 2.0, 1.0));
    let step = rk4_step(&truth, &start(), &tau, 0.0, MILLISECOND_NS as f64 * 1e-9);
    assert_eq!(step, integrate(&truth, &start(), &tau, 0, MILLISECOND_NS, MILLISECOND_NS));
}

#[test]
fn a_run_ends_in_the_same_bits_on_every_machine_and_in_every_build() {
    let truth = busy_truth();
    let states = closed_loop(&truth, |tick, state, tau| {
        integrate(&truth, state, tau, tick * MILLISECOND_NS, (tick + 1) * MILLISECOND_NS, MILLISECOND_NS)
    });
    let bits = states[20_000].q.map(f64::to_bits);
    assert_eq!(bits, nalgebra::Vector3::new(0x3feb_fe47_d57d_1dc4, 0x3fec_617c_5e49_3f46, 0x3fec_c8ba_4f01_d562));
}
