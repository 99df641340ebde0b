//! Chains, assumptions and comparisons that tests share.

use crate::chain::{Chain, LinkParameters, Vector};
use crate::input::LawInput;
use crate::trajectory::SupNorms;

use crate::certificate::envelope::Assumptions;

/// N links of 1 kg and 1 m.
pub(crate) fn unit_chain<const N: usize>() -> Chain<N> {
    scaled_chain([1.0; N])
}

/// N links of 1 m and the given masses.
pub(crate) fn scaled_chain<const N: usize>(mass_kg: [f64; N]) -> Chain<N> {
    let links = LinkParameters { mass_kg, length_m: [1.0; N], inertia_kg_m2: None, gravity_m_s2: 9.81 };
    Chain::from_links(&links).unwrap()
}

/// Suprema of the default reference, sin 0.1 t in each link.
pub(crate) fn default_sup<const N: usize>() -> SupNorms {
    let root = (N as f64).sqrt();
    SupNorms { v_inf: 0.1, v_2: 0.1 * root, a_2: 0.01 * root }
}

/// Assumptions with the default reference.
pub(crate) fn assume<const N: usize>(nominal: &Chain<N>, mu: f64, disturbance_bound_nm: f64) -> Assumptions<N> {
    Assumptions { nominal: *nominal, mass_mismatch: mu, disturbance_bound_nm, sup: default_sup::<N>() }
}

/// The default reference at `t_s` and a state.
pub(crate) fn input_at<const N: usize>(q: Vector<N>, v: Vector<N>, t_s: f64) -> LawInput<N> {
    let (sin, cos) = (libm::sin(0.1 * t_s), libm::cos(0.1 * t_s));
    LawInput { q, v, q_d: Vector::repeat(sin), v_d: Vector::repeat(0.1 * cos), a_d: Vector::repeat(-0.01 * sin) }
}

/// The default start: (0.3, −0.2, 0.25) rad off, at rest.
pub(crate) fn default_start() -> LawInput<3> {
    input_at(Vector::<3>::new(0.3, -0.2, 0.25), Vector::zeros(), 0.0)
}

#[track_caller]
pub(crate) fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} instead of {expected} ± {tolerance}");
}
