//! The motions with a beginning and an end: point to point, and the sweep of frequencies.

use super::{SetpointValue, SupNorms, per_link};
use crate::chain::Vector;

/// s(u) = 10u³ − 15u⁴ + 6u⁵ between the postures, with u the fraction of the time; s, ṡ and s̈ vanish at u = 0, and
/// 1 − s, ṡ and s̈ at u = 1.
pub(super) fn quintic_at<const N: usize>(
    from_rad: &[f64; N],
    to_rad: &[f64; N],
    u: f64,
    duration_s: f64,
) -> SetpointValue<N> {
    let u = u.clamp(0.0, 1.0);
    let s = u * u * u * (10.0 + u * (-15.0 + 6.0 * u));
    let s_rate = 30.0 * u * u * (1.0 - u) * (1.0 - u) / duration_s;
    let s_rate_rate = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / (duration_s * duration_s);
    per_link(|i| {
        let way = to_rad[i] - from_rad[i];
        [from_rad[i] + way * s, way * s_rate, way * s_rate_rate]
    })
}

/// max |ds/du| = 15/8 at u = 1/2, max |d²s/du²| = 10/√3 at u = 1/2 ± √3/6; all links move in step, so both are attained.
pub(super) fn quintic_norms<const N: usize>(from_rad: &[f64; N], to_rad: &[f64; N], duration_s: f64) -> SupNorms {
    let way = Vector::<N>::from_fn(|i, _| (to_rad[i] - from_rad[i]).abs());
    let speed = 15.0 / 8.0 / duration_s;
    let acceleration = 10.0 / 3.0_f64.sqrt() / (duration_s * duration_s);
    SupNorms::from_links(&(way * speed), &(way * acceleration))
}

/// A sin φ with φ̇ = ω_0 + Δω S(t/T), S(u) = 3u² − 2u³ held constant outside of 0..1, and φ(0) = 0.
pub(super) fn chirp_at<const N: usize>(
    amplitude_rad: &[f64; N],
    [omega_from, omega_to]: [f64; 2],
    duration_s: f64,
    t_s: f64,
) -> SetpointValue<N> {
    let change = omega_to - omega_from;
    let u = (t_s / duration_s).clamp(0.0, 1.0);
    // ∫S = u³ − u⁴/2 up to u = 1, from where φ grows at the rate ω_0 + Δω.
    let after_s = (t_s - duration_s).max(0.0);
    let phase = omega_from * t_s + change * (duration_s * u * u * u * (1.0 - 0.5 * u) + after_s);
    let phase_rate = omega_from + change * u * u * (3.0 - 2.0 * u);
    let phase_rate_rate = change * 6.0 * u * (1.0 - u) / duration_s;
    let (sin, cos) = libm::sincos(phase);
    per_link(|i| {
        let a = amplitude_rad[i];
        [a * sin, a * phase_rate * cos, a * (phase_rate_rate * cos - phase_rate * phase_rate * sin)]
    })
}

/// |φ̇| ≤ max(|ω_0|, |ω_1|) as S is monotone, |φ̈| ≤ 3|Δω|/(2T), and |x cos φ − y sin φ| ≤ sqrt(x² + y²).
pub(super) fn chirp_norms<const N: usize>(
    amplitude_rad: &[f64; N],
    [omega_from, omega_to]: [f64; 2],
    duration_s: f64,
) -> SupNorms {
    let rate = omega_from.abs().max(omega_to.abs());
    let rate_rate = 1.5 * (omega_to - omega_from).abs() / duration_s;
    let acceleration = (rate * rate * rate * rate + rate_rate * rate_rate).sqrt();
    let amplitude = Vector::<N>::from_fn(|i, _| amplitude_rad[i].abs());
    SupNorms::from_links(&(amplitude * rate), &(amplitude * acceleration))
}
