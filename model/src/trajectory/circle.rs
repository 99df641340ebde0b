//! The tip on a circle: inverse kinematics in closed form, with proven bounds of the velocities.
//!
//! More than two links could reach a point in infinitely many postures. Here the chain moves as an arm with one elbow:
//! the links before the elbow are aligned, and so are the links after it. The elbow is put where the two parts are as
//! equal in length as possible, which leaves the smallest hole around the hinge. With parts L_1, L_2 at the absolute
//! angles φ_1, φ_2, the tip at the distance d and the direction ψ from the downward vertical:
//!
//! ```text
//! φ_1 = ψ + s α,  cos α = (L_1² + d² − L_2²)/(2 L_1 d)
//! φ_2 = ψ − s γ,  cos γ = (L_2² + d² − L_1²)/(2 L_2 d)     s = ±1: the side of the elbow
//! ```
//!
//! With t_i = (cos φ_i, sin φ_i) along and e_i = (sin φ_i, −cos φ_i) across the motion of part i, and δ = φ_2 − φ_1,
//!
//! ```text
//! ṗ = Σ L_i φ̇_i t_i                      φ̇_1 = ṗ·e_2/(L_1 sin δ),  φ̇_2 = −ṗ·e_1/(L_2 sin δ)
//! p̈ + Σ L_i φ̇_i² e_i = Σ L_i φ̈_i t_i      and the same solution for φ̈
//! ```

use super::{SetpointValue, SupNorms, TrajectoryError, all_finite, per_link, positive};
use crate::chain::Vector;

/// Which circle the tip follows; positions are relative to the hinge, y up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleParameters<const N: usize> {
    /// Length of each link, m.
    pub length_m: [f64; N],
    /// Centre (x, y), m.
    pub centre_m: [f64; 2],
    /// Radius, m, ≥ 0.
    pub radius_m: f64,
    /// Angular velocity on the circle, rad/s, counter-clockwise.
    pub omega_rad_s: f64,
    /// Where on the circle the tip is at t = 0, rad from the x axis.
    pub phase_rad: f64,
    /// Whether the elbow is on the side of the larger angles of the first part.
    pub elbow_positive: bool,
}

/// A circle of the tip that the links can follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle<const N: usize> {
    parameters: CircleParameters<N>,
    /// How many links are before the elbow.
    first_part: usize,
    /// L_1 and L_2, m.
    parts_m: [f64; 2],
    /// The smallest |sin δ| on the circle, > 0.
    sin_elbow_min: f64,
}

/// How far from stretched and from folded the arm must stay, relative to its length: at either the velocities of the
/// links are unbounded.
const REACH_MARGIN: f64 = 1e-6;

impl<const N: usize> Circle<N> {
    /// # Errors
    /// One link, a parameter out of range, or a circle that is not reachable or has the hinge inside.
    pub fn new(parameters: CircleParameters<N>) -> Result<Self, TrajectoryError> {
        let CircleParameters { length_m, centre_m, radius_m, omega_rad_s, phase_rad, .. } = &parameters;
        if N < 2 {
            return Err(TrajectoryError::CircleOfOneLink);
        }
        length_m.iter().try_for_each(|&length| positive("length_m", length))?;
        all_finite("centre_m", centre_m)?;
        all_finite("omega_rad_s", &[*omega_rad_s])?;
        all_finite("phase_rad", &[*phase_rad])?;
        if !(radius_m.is_finite() && *radius_m >= 0.0) {
            let allowed = "a finite number >= 0";
            return Err(TrajectoryError::Parameter { field: "radius_m", value: *radius_m, allowed });
        }
        let first_part = elbow(length_m);
        let parts_m = [length_m[..first_part].iter().sum::<f64>(), length_m[first_part..].iter().sum::<f64>()];
        let [l1, l2] = parts_m;
        let centre_distance = libm::hypot(centre_m[0], centre_m[1]);
        let [nearest_m, farthest_m] = [centre_distance - radius_m, centre_distance + radius_m];
        let margin = REACH_MARGIN * (l1 + l2);
        let [inner_m, outer_m] = [(l1 - l2).abs() + margin, l1 + l2 - margin];
        if !(nearest_m > inner_m && farthest_m < outer_m) {
            return Err(TrajectoryError::Unreachable { nearest_m, farthest_m, inner_m, outer_m });
        }
        // cos δ grows with the distance of the tip, so |sin δ| is smallest at the nearest or the farthest point.
        let sin_elbow = |d: f64| (1.0 - square((d * d - l1 * l1 - l2 * l2) / (2.0 * l1 * l2))).max(0.0).sqrt();
        let sin_elbow_min = sin_elbow(nearest_m).min(sin_elbow(farthest_m));
        Ok(Self { parameters, first_part, parts_m, sin_elbow_min })
    }

    /// The setpoint at `t_s`.
    #[must_use]
    pub fn at(&self, t_s: f64) -> SetpointValue<N> {
        let CircleParameters { centre_m: [x_c, y_c], radius_m, omega_rad_s, phase_rad, elbow_positive, .. } =
            self.parameters;
        let [l1, l2] = self.parts_m;
        let (sin, cos) = libm::sincos(omega_rad_s * t_s + phase_rad);
        let offset = [radius_m * cos, radius_m * sin];
        let tip = [x_c + offset[0], y_c + offset[1]];
        let tip_rate = [-omega_rad_s * offset[1], omega_rad_s * offset[0]];
        let tip_rate_rate = [-omega_rad_s * omega_rad_s * offset[0], -omega_rad_s * omega_rad_s * offset[1]];

        // Measured from the centre's direction, the tip's stays within ±π/2, so that it never jumps by a turn.
        let from_centre = libm::atan2(x_c * tip[1] - y_c * tip[0], dot([x_c, y_c], tip));
        let direction = libm::atan2(x_c, -y_c) + from_centre;
        let distance = libm::hypot(tip[0], tip[1]);
        let side = if elbow_positive { 1.0 } else { -1.0 };
        let inner_angle = |near: f64, far: f64| {
            libm::acos(((near * near + distance * distance - far * far) / (2.0 * near * distance)).clamp(-1.0, 1.0))
        };
        let phi = [direction + side * inner_angle(l1, l2), direction - side * inner_angle(l2, l1)];

        let [(s1, c1), (s2, c2)] = phi.map(libm::sincos);
        let [e1, e2] = [[s1, -c1], [s2, -c2]];
        let sin_elbow = s2 * c1 - c2 * s1;
        let solve = |p: [f64; 2]| [dot(p, e2) / (l1 * sin_elbow), -dot(p, e1) / (l2 * sin_elbow)];
        let rate = solve(tip_rate);
        let [w1, w2] = [l1 * rate[0] * rate[0], l2 * rate[1] * rate[1]];
        let rate_rate = solve([tip_rate_rate[0] + w1 * e1[0] + w2 * e2[0], tip_rate_rate[1] + w1 * e1[1] + w2 * e2[1]]);
        per_link(|i| {
            let part = usize::from(i >= self.first_part);
            [phi[part], rate[part], rate_rate[part]]
        })
    }

    /// From the module's equations with |ṗ| = ρ|ω|, |p̈| = ρω², unit e_i and |sin δ| ≥ its minimum on the circle.
    #[must_use]
    pub fn sup_norms(&self) -> SupNorms {
        let speed = (self.parameters.radius_m * self.parameters.omega_rad_s).abs();
        let rate = self.parts_m.map(|length| speed / (length * self.sin_elbow_min));
        let centripetal = self.parts_m[0] * rate[0] * rate[0] + self.parts_m[1] * rate[1] * rate[1];
        let load = speed * self.parameters.omega_rad_s.abs() + centripetal;
        let rate_rate = self.parts_m.map(|length| load / (length * self.sin_elbow_min));
        let of_part = |values: [f64; 2]| Vector::<N>::from_fn(|i, _| values[usize::from(i >= self.first_part)]);
        SupNorms::from_links(&of_part(rate), &of_part(rate_rate))
    }
}

/// How many links to put before the elbow so that both parts are as equal as possible; at least 1, at most N − 1.
fn elbow<const N: usize>(length_m: &[f64; N]) -> usize {
    let total: f64 = length_m.iter().sum();
    let (mut best, mut best_difference, mut before) = (1, f64::INFINITY, 0.0);
    for (count, length) in (1..N).zip(length_m) {
        before += length;
        let difference = (total - 2.0 * before).abs();
        if difference < best_difference {
            (best, best_difference) = (count, difference);
        }
    }
    best
}

fn dot(x: [f64; 2], y: [f64; 2]) -> f64 {
    x[0] * y[0] + x[1] * y[1]
}

fn square(x: f64) -> f64 {
    x * x
}
