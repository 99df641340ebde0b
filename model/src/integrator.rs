//! The motion of the plant between two instants: the classical Runge–Kutta method of order 4.
//!
//! Time is whole nanoseconds since the start of the plant. An interval is divided into equal steps no longer than a
//! limit; the caller divides it where a torque arrives, since the torque is constant here. The same steps can carry
//! integrals along (V̇, latency and fault terms of \[10]), without changing a bit of the motion: the monitor then
//! recomputes exactly what the plant did.
//!
//! How long a step may be: in the default closed loop 1 ms is good for 2e-8 rad over 20 s. Coulomb friction asks for
//! more where a joint turns round: 1e-4 rad/s at 1 ms, 5e-9 at 25 µs, for 0.1 N·m at 1000 rad/s².

use crate::chain::Vector;
use crate::truth::Truth;

/// State of the plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantState<const N: usize> {
    /// Angles, rad.
    pub q: Vector<N>,
    /// Velocities, rad/s.
    pub v: Vector<N>,
}

impl<const N: usize> PlantState<N> {
    /// Whether every angle and velocity is a finite number.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.q.iter().chain(&self.v).all(|x| x.is_finite())
    }
}

/// The state `h_s` seconds after `t_s`, in one step under the constant torque `tau` (N·m).
#[must_use]
pub fn rk4_step<const N: usize>(
    truth: &Truth<N>,
    state: &PlantState<N>,
    tau: &Vector<N>,
    t_s: f64,
    h_s: f64,
) -> PlantState<N> {
    step_with(truth, state, tau, t_s, h_s, &|_, _, _| []).0
}

/// The state at `to_ns` from the one at `from_ns` under the constant torque `tau` (N·m), in equal steps of at most
/// `step_max_ns`. Without time to pass (`to_ns` ≤ `from_ns`) the state stays.
#[must_use]
pub fn integrate<const N: usize>(
    truth: &Truth<N>,
    state: &PlantState<N>,
    tau: &Vector<N>,
    from_ns: u64,
    to_ns: u64,
    step_max_ns: u64,
) -> PlantState<N> {
    integrate_with(truth, state, tau, from_ns, to_ns, step_max_ns, |_, _, _| []).0
}

/// As [`integrate`], bit for bit, with the integrals over time of K further quantities.
///
/// `integrand` is given t (s), the state and its acceleration q̈ (rad/s²) at each stage of the method, and the stages
/// have the method's own weights: the integrals are those of K more components of the state, of order 4 as well.
#[must_use]
pub fn integrate_with<const N: usize, const K: usize>(
    truth: &Truth<N>,
    state: &PlantState<N>,
    tau: &Vector<N>,
    from_ns: u64,
    to_ns: u64,
    step_max_ns: u64,
    integrand: impl Fn(f64, &PlantState<N>, &Vector<N>) -> [f64; K],
) -> (PlantState<N>, [f64; K]) {
    let span_ns = to_ns.saturating_sub(from_ns);
    let steps = span_ns.div_ceil(step_max_ns.max(1));
    let from_s = from_ns as f64 * 1e-9;
    let h_s = span_ns as f64 * 1e-9 / steps.max(1) as f64;
    let (mut state, mut sums) = (*state, [0.0; K]);
    for step in 0..steps {
        let (next, parts) = step_with(truth, &state, tau, from_s + step as f64 * h_s, h_s, &integrand);
        state = next;
        for (sum, part) in sums.iter_mut().zip(parts) {
            *sum += part;
        }
    }
    (state, sums)
}

/// One step with its integrals. The stages are (q̇, v̇) at t, twice at t + h/2 and at t + h, with weights 1, 2, 2, 1.
fn step_with<const N: usize, const K: usize>(
    truth: &Truth<N>,
    state: &PlantState<N>,
    tau: &Vector<N>,
    t_s: f64,
    h_s: f64,
    integrand: &impl Fn(f64, &PlantState<N>, &Vector<N>) -> [f64; K],
) -> (PlantState<N>, [f64; K]) {
    let half_s = h_s / 2.0;
    let (middle_s, end_s) = (t_s + half_s, t_s + h_s);
    let disturbance_middle = truth.disturbance(middle_s);
    let after = |v: &Vector<N>, a: &Vector<N>, s: f64| PlantState { q: state.q + v * s, v: state.v + a * s };
    let rate = |x: &PlantState<N>, d: &Vector<N>| truth.acceleration(&x.q, &x.v, tau, d);

    let x1 = *state;
    let a1 = rate(&x1, &truth.disturbance(t_s));
    let x2 = after(&x1.v, &a1, half_s);
    let a2 = rate(&x2, &disturbance_middle);
    let x3 = after(&x2.v, &a2, half_s);
    let a3 = rate(&x3, &disturbance_middle);
    let x4 = after(&x3.v, &a3, h_s);
    let a4 = rate(&x4, &truth.disturbance(end_s));

    let sixth_s = h_s / 6.0;
    let next = PlantState {
        q: state.q + (x1.v + (x2.v + x3.v) * 2.0 + x4.v) * sixth_s,
        v: state.v + (a1 + (a2 + a3) * 2.0 + a4) * sixth_s,
    };
    let parts = [
        integrand(t_s, &x1, &a1),
        integrand(middle_s, &x2, &a2),
        integrand(middle_s, &x3, &a3),
        integrand(end_s, &x4, &a4),
    ];
    let sum = |k: usize| (parts[0][k] + (parts[1][k] + parts[2][k]) * 2.0 + parts[3][k]) * sixth_s;
    (next, core::array::from_fn(sum))
}

#[cfg(test)]
mod tests;
