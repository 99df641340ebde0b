//! The true plant: what the controllers do not know about it.
//!
//! Around the chain with its true masses: friction in the joints, disturbance torques, noise and steps of the
//! sensors, limits of the actuators. Everything is a pure function of state, time and seed, so that a replay computes
//! the same numbers. The controllers' nominal model lives in `law`, injected faults of processes in the loop.
//!
//! Sign convention, with the joint friction f of [`Truth::friction`]:
//!
//! ```text
//! M q̈ + C q̇ + G = τ + d − f
//! ```

use thiserror::Error;

use crate::chain::{Chain, Vector};
use crate::rng::{Stream, standard_normal};

mod disturbance;

pub use self::disturbance::{BandNoise, Disturbance};

/// The speed of a joint at which Coulomb friction reaches tanh(1) = 76 % of its value, rad/s.
///
/// A sharp sign function would make the integration steps matter more than the physics. Near rest the smooth one is
/// viscous with the coefficient (coulomb)/(this speed).
pub const COULOMB_SPEED_RAD_S: f64 = 0.05;

/// The true plant.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth<const N: usize> {
    /// The chain with its true parameters, mismatch included.
    pub chain: Chain<N>,
    /// Viscous friction of each joint, N·m·s, ≥ 0.
    pub viscous_nm_s: [f64; N],
    /// Coulomb friction of each joint, N·m, ≥ 0.
    pub coulomb_nm: [f64; N],
    /// Disturbance torque d(t).
    pub disturbance: Disturbance<N>,
    /// Standard deviation of the noise of measured angles, rad, ≥ 0.
    pub noise_q_rad: f64,
    /// Standard deviation of the noise of measured velocities, rad/s, ≥ 0.
    pub noise_v_rad_s: f64,
    /// Step of the measured angles, rad; 0: continuous.
    pub quant_q_rad: f64,
    /// Step of the measured velocities, rad/s; 0: continuous.
    pub quant_v_rad_s: f64,
    /// Largest |τ_i| that the actuators deliver, N·m, > 0; infinity: no limit.
    pub torque_limit_nm: [f64; N],
    /// Seed of the sensors' noise.
    pub seed: u64,
}

/// A parameter of the plant that is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("{field} is {value}, allowed: {allowed}")]
pub struct TruthError {
    /// Name of the parameter.
    pub field: &'static str,
    /// What was found.
    pub value: f64,
    /// What would be accepted.
    pub allowed: &'static str,
}

impl<const N: usize> Truth<N> {
    /// The chain alone: no friction, no disturbance, exact sensors, no limits.
    #[must_use]
    pub fn ideal(chain: Chain<N>) -> Self {
        Self {
            chain,
            viscous_nm_s: [0.0; N],
            coulomb_nm: [0.0; N],
            disturbance: Disturbance::None,
            noise_q_rad: 0.0,
            noise_v_rad_s: 0.0,
            quant_q_rad: 0.0,
            quant_v_rad_s: 0.0,
            torque_limit_nm: [f64::INFINITY; N],
            seed: 0,
        }
    }

    /// Checks the ranges that the fields document.
    ///
    /// # Errors
    /// Names the parameter, the value found and what is allowed.
    pub fn validate(&self) -> Result<(), TruthError> {
        not_negative("viscous_nm_s", &self.viscous_nm_s)?;
        not_negative("coulomb_nm", &self.coulomb_nm)?;
        not_negative("noise_q_rad", &[self.noise_q_rad])?;
        not_negative("noise_v_rad_s", &[self.noise_v_rad_s])?;
        not_negative("quant_q_rad", &[self.quant_q_rad])?;
        not_negative("quant_v_rad_s", &[self.quant_v_rad_s])?;
        if let Some(&value) = self.torque_limit_nm.iter().find(|limit| limit.is_nan() || **limit <= 0.0) {
            return Err(TruthError { field: "torque_limit_nm", value, allowed: "a number > 0, or inf for no limit" });
        }
        self.disturbance.validate()
    }

    /// d(t), N·m.
    #[must_use]
    pub fn disturbance(&self, t_s: f64) -> Vector<N> {
        self.disturbance.at(t_s)
    }

    /// The generalised torque f of the friction, N·m.
    ///
    /// Friction acts in the joints, on the relative velocity w_i = q̇_i − q̇_{i−1} (w_1 = q̇_1), with the joint torque
    /// u_i = viscous_i w_i + coulomb_i tanh(w_i/v_0); then f_i = u_i − u_{i+1}, as for any joint torque. It never
    /// drives: q̇·f = Σ w_i u_i ≥ 0.
    #[must_use]
    pub fn friction(&self, v: &Vector<N>) -> Vector<N> {
        let mut friction = Vector::zeros();
        for i in 0..N {
            let relative = if i == 0 { v[0] } else { v[i] - v[i - 1] };
            let mut joint = self.viscous_nm_s[i] * relative;
            if self.coulomb_nm[i] > 0.0 {
                joint += self.coulomb_nm[i] * libm::tanh(relative / COULOMB_SPEED_RAD_S);
            }
            friction[i] += joint;
            if i > 0 {
                friction[i - 1] -= joint;
            }
        }
        friction
    }

    /// q̈ = M⁻¹(τ + d − f − C q̇ − G), rad/s², under the actuators' torque τ and the disturbance d, both N·m.
    #[must_use]
    pub fn acceleration(&self, q: &Vector<N>, v: &Vector<N>, tau: &Vector<N>, d: &Vector<N>) -> Vector<N> {
        self.chain.acceleration(q, v, &(tau + d - self.friction(v)))
    }

    /// What the sensors say at `tick` of the state (q, v): the state, plus noise, rounded to the sensors' steps.
    #[must_use]
    pub fn measure(&self, q: &Vector<N>, v: &Vector<N>, tick: u64) -> (Vector<N>, Vector<N>) {
        let sense = |x: &Vector<N>, noise: f64, step: f64, stream: Stream| {
            Vector::from_iterator((0u32..).zip(x.iter()).map(|(link, &value)| {
                let noisy =
                    if noise > 0.0 { value + noise * standard_normal(self.seed, stream, tick, link) } else { value };
                if step > 0.0 { (noisy / step).round() * step } else { noisy }
            }))
        };
        (
            sense(q, self.noise_q_rad, self.quant_q_rad, Stream::MeasuredAngle),
            sense(v, self.noise_v_rad_s, self.quant_v_rad_s, Stream::MeasuredVelocity),
        )
    }

    /// The torque that the actuators deliver for `tau`, N·m, and whether a limit was met.
    ///
    /// A torque that is not a number stays one: refusing it is the loop's business, not the actuators'.
    #[must_use]
    pub fn saturate(&self, tau: &Vector<N>) -> (Vector<N>, bool) {
        let mut delivered = *tau;
        let mut limited = false;
        for (torque, &limit) in delivered.iter_mut().zip(&self.torque_limit_nm) {
            if torque.abs() > limit {
                *torque = limit.copysign(*torque);
                limited = true;
            }
        }
        (delivered, limited)
    }
}

/// Refuses a value that is negative, infinite or not a number.
fn not_negative(field: &'static str, values: &[f64]) -> Result<(), TruthError> {
    match values.iter().find(|value| !value.is_finite() || **value < 0.0) {
        Some(&value) => Err(TruthError { field, value, allowed: "a finite number >= 0" }),
        None => Ok(()),
    }
}

/// Refuses a value that is infinite or not a number.
fn all_finite(field: &'static str, values: &[f64]) -> Result<(), TruthError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(TruthError { field, value, allowed: "a finite number" }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
