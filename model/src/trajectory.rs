//! The reference: where the chain should be at each instant, and how fast that can change.
//!
//! A trajectory is a pure function of time with its exact first and second derivatives. Each is twice continuously
//! differentiable and comes with proven bounds of its derivatives, the suprema of the paper's Assumption 1, on which
//! certificates rest: closed forms or inequalities, never the maximum of samples.
//!
//! Transport and age of setpoints are the loop's concern, not this module's.

use thiserror::Error;

use self::profile::{chirp_at, chirp_norms, quintic_at, quintic_norms};
use crate::chain::Vector;
use crate::quote;

mod circle;
mod profile;
mod waypoints;

pub use self::circle::{Circle, CircleParameters};
pub use self::waypoints::Waypoints;

/// A setpoint: desired angles with their first two derivatives at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetpointValue<const N: usize> {
    /// Desired angles q_d, rad.
    pub q_d: Vector<N>,
    /// Desired velocities, rad/s.
    pub v_d: Vector<N>,
    /// Desired accelerations, rad/s².
    pub a_d: Vector<N>,
}

impl<const N: usize> SetpointValue<N> {
    /// The setpoint after `delta_s` seconds with its acceleration held: q_d + v_d δ + ½ a_d δ², v_d + a_d δ, a_d.
    #[must_use]
    pub fn extrapolate(&self, delta_s: f64) -> Self {
        Self {
            q_d: self.q_d + self.v_d * delta_s + self.a_d * (0.5 * delta_s * delta_s),
            v_d: self.v_d + self.a_d * delta_s,
            a_d: self.a_d,
        }
    }
}

/// Upper bounds over all times of Assumption 1, true up to rounding (some 1e-15 of their value).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupNorms {
    /// v_∞ = sup max_i |q̇_d,i|, rad/s.
    pub v_inf: f64,
    /// v_2 = sup |q̇_d|, rad/s.
    pub v_2: f64,
    /// a_d = sup |q̈_d|, rad/s².
    pub a_2: f64,
}

impl SupNorms {
    /// Norms from bounds of each link's velocity and acceleration.
    fn from_links<const N: usize>(v: &Vector<N>, a: &Vector<N>) -> Self {
        Self { v_inf: v.amax(), v_2: v.norm(), a_2: a.norm() }
    }
}

/// Why a trajectory cannot be built.
#[derive(Debug, Error)]
pub enum TrajectoryError {
    /// A parameter is outside of its range.
    #[error("{field} is {}, allowed: {allowed}", quote::number(*value))]
    Parameter {
        /// Name of the parameter.
        field: &'static str,
        /// What was found.
        value: f64,
        /// What would be accepted.
        allowed: &'static str,
    },
    /// A circle of the tip that the links cannot follow.
    #[error(
        "the circle takes the tip from {nearest_m} m to {farthest_m} m off the hinge, \
         allowed: more than {inner_m} m and less than {outer_m} m, with the hinge outside of the circle"
    )]
    Unreachable {
        /// Smallest distance of the circle from the hinge, m; negative where the hinge lies inside.
        nearest_m: f64,
        /// Largest distance of the circle from the hinge, m.
        farthest_m: f64,
        /// Lower limit of the distance, m.
        inner_m: f64,
        /// Upper limit of the distance, m.
        outer_m: f64,
    },
    /// A circle needs two directions of motion.
    #[error("a circle of the tip needs at least 2 links, found 1")]
    CircleOfOneLink,
    /// A line of the file of waypoints is refused. Lines are counted from 1.
    #[error("{}, line {line}: {problem}", quote::lines(path))]
    Line {
        /// The file.
        path: String,
        /// Which line, from 1.
        line: usize,
        /// What was found and what is allowed.
        problem: String,
    },
}

/// One oscillation of one link: A sin(ω t + φ).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SineTerm {
    /// A, rad.
    pub amplitude_rad: f64,
    /// ω, rad/s.
    pub omega_rad_s: f64,
    /// φ, rad.
    pub phase_rad: f64,
}

/// A reference for N links.
#[derive(Clone, Debug, PartialEq)]
pub enum Trajectory<const N: usize> {
    /// q_d,i = A_i sin(ω_i t); the paper's has A_i = 1 and ω_i = 0.1.
    Sine {
        /// A_i, rad.
        amplitude_rad: [f64; N],
        /// ω_i, rad/s.
        omega_rad_s: [f64; N],
    },
    /// q_d,i = offset_i + Σ of sines.
    MultiSine {
        /// The mean of each link's angle, rad.
        offset_rad: [f64; N],
        /// The oscillations of each link.
        terms: [Vec<SineTerm>; N],
    },
    /// From one posture to another along a polynomial of degree 5, at rest before and after.
    Quintic {
        /// Angles before, rad.
        from_rad: [f64; N],
        /// Angles after, rad.
        to_rad: [f64; N],
        /// When the motion begins, s.
        start_s: f64,
        /// How long it takes, s.
        duration_s: f64,
    },
    /// A sweep q_d,i = A_i sin φ(t): φ̇ goes from one frequency to the other along the smooth step 3u² − 2u³ and stays
    /// there. A linear sweep would make the acceleration jump where it ends.
    Chirp {
        /// A_i, rad.
        amplitude_rad: [f64; N],
        /// Frequency for t ≤ 0, rad/s.
        omega_from_rad_s: f64,
        /// Frequency from `duration_s` on, rad/s.
        omega_to_rad_s: f64,
        /// Length of the sweep, s.
        duration_s: f64,
    },
    /// The tip goes round a circle.
    Circle(Circle<N>),
    /// Through given postures at given times.
    Waypoints(Waypoints<N>),
}

impl<const N: usize> Trajectory<N> {
    /// The paper's reference: sin(0.1 t) for each link.
    #[must_use]
    pub fn of_the_paper() -> Self {
        Self::Sine { amplitude_rad: [1.0; N], omega_rad_s: [0.1; N] }
    }

    /// Checks the parameters that a scenario gives; circles and waypoints are checked when they are built.
    ///
    /// # Errors
    /// Names the parameter, the value found and what is allowed.
    pub fn validate(&self) -> Result<(), TrajectoryError> {
        match self {
            Self::Sine { amplitude_rad, omega_rad_s } => {
                all_finite("amplitude_rad", amplitude_rad)?;
                all_finite("omega_rad_s", omega_rad_s)
            }
            Self::MultiSine { offset_rad, terms } => {
                all_finite("offset_rad", offset_rad)?;
                terms.iter().flatten().try_for_each(|term| {
                    all_finite("amplitude_rad", &[term.amplitude_rad])?;
                    all_finite("omega_rad_s", &[term.omega_rad_s])?;
                    all_finite("phase_rad", &[term.phase_rad])
                })
            }
            Self::Quintic { from_rad, to_rad, start_s, duration_s } => {
                all_finite("from_rad", from_rad)?;
                all_finite("to_rad", to_rad)?;
                all_finite("start_s", &[*start_s])?;
                positive("duration_s", *duration_s)
            }
            Self::Chirp { amplitude_rad, omega_from_rad_s, omega_to_rad_s, duration_s } => {
                all_finite("amplitude_rad", amplitude_rad)?;
                all_finite("omega_from_rad_s", &[*omega_from_rad_s])?;
                all_finite("omega_to_rad_s", &[*omega_to_rad_s])?;
                positive("duration_s", *duration_s)
            }
            Self::Circle(_) | Self::Waypoints(_) => Ok(()),
        }
    }

    /// The setpoint at `t_s`, which may be negative. Allocates nothing.
    #[must_use]
    pub fn at(&self, t_s: f64) -> SetpointValue<N> {
        match self {
            Self::Sine { amplitude_rad, omega_rad_s } => per_link(|i| {
                let term = SineTerm { amplitude_rad: amplitude_rad[i], omega_rad_s: omega_rad_s[i], phase_rad: 0.0 };
                term.at(t_s)
            }),
            Self::MultiSine { offset_rad, terms } => per_link(|i| {
                terms[i].iter().fold([offset_rad[i], 0.0, 0.0], |sum, term| {
                    let [q, v, a] = term.at(t_s);
                    [sum[0] + q, sum[1] + v, sum[2] + a]
                })
            }),
            Self::Quintic { from_rad, to_rad, start_s, duration_s } => {
                quintic_at(from_rad, to_rad, (t_s - start_s) / duration_s, *duration_s)
            }
            Self::Chirp { amplitude_rad, omega_from_rad_s, omega_to_rad_s, duration_s } => {
                chirp_at(amplitude_rad, [*omega_from_rad_s, *omega_to_rad_s], *duration_s, t_s)
            }
            Self::Circle(circle) => circle.at(t_s),
            Self::Waypoints(waypoints) => waypoints.at(t_s),
        }
    }

    /// Bounds of Assumption 1 over all times. Attained (so the suprema themselves) by sines with one frequency and by
    /// point-to-point motions; v_∞ and a_d also by waypoints.
    #[must_use]
    pub fn sup_norms(&self) -> SupNorms {
        match self {
            // |A ω cos| ≤ |A ω| and |A ω² sin| ≤ |A ω²|, all attained at once when ω is common.
            Self::Sine { amplitude_rad, omega_rad_s } => SupNorms::from_links(
                &Vector::<N>::from_fn(|i, _| (amplitude_rad[i] * omega_rad_s[i]).abs()),
                &Vector::<N>::from_fn(|i, _| (amplitude_rad[i] * omega_rad_s[i] * omega_rad_s[i]).abs()),
            ),
            // The triangle inequality over the terms of a link.
            Self::MultiSine { terms, .. } => {
                let sum = |i: usize, bound: fn(&SineTerm) -> f64| terms[i].iter().map(bound).sum::<f64>();
                SupNorms::from_links(
                    &Vector::<N>::from_fn(|i, _| sum(i, |t| (t.amplitude_rad * t.omega_rad_s).abs())),
                    &Vector::<N>::from_fn(|i, _| sum(i, |t| (t.amplitude_rad * t.omega_rad_s * t.omega_rad_s).abs())),
                )
            }
            Self::Quintic { from_rad, to_rad, duration_s, .. } => quintic_norms(from_rad, to_rad, *duration_s),
            Self::Chirp { amplitude_rad, omega_from_rad_s, omega_to_rad_s, duration_s } => {
                chirp_norms(amplitude_rad, [*omega_from_rad_s, *omega_to_rad_s], *duration_s)
            }
            Self::Circle(circle) => circle.sup_norms(),
            Self::Waypoints(waypoints) => waypoints.sup_norms(),
        }
    }
}

impl SineTerm {
    /// Angle, velocity and acceleration at `t_s`.
    fn at(&self, t_s: f64) -> [f64; 3] {
        let (sin, cos) = libm::sincos(self.omega_rad_s * t_s + self.phase_rad);
        let speed = self.amplitude_rad * self.omega_rad_s;
        [self.amplitude_rad * sin, speed * cos, -speed * self.omega_rad_s * sin]
    }
}

/// Collects angle, velocity and acceleration of each link.
fn per_link<const N: usize>(value: impl Fn(usize) -> [f64; 3]) -> SetpointValue<N> {
    let mut setpoint = SetpointValue { q_d: Vector::zeros(), v_d: Vector::zeros(), a_d: Vector::zeros() };
    for i in 0..N {
        [setpoint.q_d[i], setpoint.v_d[i], setpoint.a_d[i]] = value(i);
    }
    setpoint
}

fn all_finite(field: &'static str, values: &[f64]) -> Result<(), TrajectoryError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(TrajectoryError::Parameter { field, value, allowed: "any finite number" }),
        None => Ok(()),
    }
}

fn positive(field: &'static str, value: f64) -> Result<(), TrajectoryError> {
    if value.is_finite() && value > 0.0 {
        Ok(())
    } else {
        Err(TrajectoryError::Parameter { field, value, allowed: "a finite number > 0" })
    }
}

#[cfg(test)]
mod tests;
