//! The control laws: pure functions from a sample and a setpoint to a torque.
//!
//! No clock, no memory, no input or output: the same input gives the same torque in every process and in a replay.
//! What a gain is worth (certificates, C1, κ) belongs to `bound`; limits of the actuators belong to the plant.
//!
//! With e = q_d − q, r = ė + β e (6), v_r = q̇_d + β e and a_r = q̈_d + β ė, and hats for the controller's model:
//!
//! ```text
//! robust      τ = K_t r
//! robust-ff   τ = M̂ a_r + Ĉ v_r + Ĝ + K_t r
//! ctc         τ = M̂ (q̈_d + K_d ė + K_p e) + Ĉ q̇ + Ĝ
//! pd+g        τ = K_p e + K_d ė + Ĝ
//! ```

use core::fmt;
use core::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::chain::{Chain, Vector};
use crate::quote;

/// Which law computes the torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum LawKind {
    /// The paper's law, free of a model: a proportional-derivative law without gravity.
    #[serde(rename = "robust")]
    Robust,
    /// The paper's (9) with its robust term: feed-forward of the model and K_t r.
    #[serde(rename = "robust-ff")]
    RobustFf,
    /// Computed torque.
    #[serde(rename = "ctc")]
    Ctc,
    /// Proportional-derivative with gravity compensation, the baseline.
    #[serde(rename = "pd+g")]
    PdG,
}

impl LawKind {
    /// Every law, in the order of the documentation.
    pub const ALL: [Self; 4] = [Self::Robust, Self::RobustFf, Self::Ctc, Self::PdG];

    /// The name in scenarios, on the command line and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Robust => "robust",
            Self::RobustFf => "robust-ff",
            Self::Ctc => "ctc",
            Self::PdG => "pd+g",
        }
    }
}

impl fmt::Display for LawKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A name that is no law's.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("no law is called \"{}\", allowed: robust, robust-ff, ctc, pd+g{}", quote::text(found), hint(found))]
pub struct UnknownLaw {
    /// What was found.
    pub found: String,
}

fn hint(found: &str) -> String {
    let near = crate::quote::nearest(found, LawKind::ALL.map(LawKind::name));
    near.map(|near| format!(", did you mean \"{near}\"?")).unwrap_or_default()
}

impl FromStr for LawKind {
    type Err = UnknownLaw;

    fn from_str(name: &str) -> Result<Self, UnknownLaw> {
        Self::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| UnknownLaw { found: name.to_owned() })
    }
}

/// What a law sees: a measured state and the setpoint at the same instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawInput<const N: usize> {
    /// Measured angles, rad.
    pub q: Vector<N>,
    /// Measured velocities, rad/s.
    pub v: Vector<N>,
    /// Desired angles, rad.
    pub q_d: Vector<N>,
    /// Desired velocities, rad/s.
    pub v_d: Vector<N>,
    /// Desired accelerations, rad/s².
    pub a_d: Vector<N>,
}

impl<const N: usize> LawInput<N> {
    /// e = q_d − q, rad.
    #[must_use]
    pub fn e(&self) -> Vector<N> {
        self.q_d - self.q
    }

    /// ė = q̇_d − q̇, rad/s.
    #[must_use]
    pub fn e_dot(&self) -> Vector<N> {
        self.v_d - self.v
    }

    /// r = ė + β e, rad/s. (6)
    #[must_use]
    pub fn r(&self, beta: f64) -> Vector<N> {
        self.e_dot() + self.e() * beta
    }
}

/// A law with its gains and its nominal model. A gain that the law does not use has no effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law<const N: usize> {
    /// Which law.
    pub kind: LawKind,
    /// The controller's model of the chain; the plant's may differ.
    pub model: Chain<N>,
    /// β of r = ė + β e, 1/s.
    pub beta: f64,
    /// Total gain K_t = K2 + κ + K3 C1² on r, N·m·s.
    pub k_t: f64,
    /// K_p: 1/s² in `ctc`, N·m in `pd+g`.
    pub k_p: f64,
    /// K_d: 1/s in `ctc`, N·m·s in `pd+g`.
    pub k_d: f64,
}

impl<const N: usize> Law<N> {
    /// The torque τ, N·m, not limited.
    #[must_use]
    pub fn torque(&self, input: &LawInput<N>) -> Vector<N> {
        let LawInput { q, v, v_d, a_d, .. } = input;
        let (e, e_dot) = (input.e(), input.e_dot());
        match self.kind {
            LawKind::Robust => input.r(self.beta) * self.k_t,
            LawKind::RobustFf => {
                let (v_r, a_r) = (v_d + e * self.beta, a_d + e_dot * self.beta);
                self.model.torque_for(q, v, &v_r, &a_r) + input.r(self.beta) * self.k_t
            }
            LawKind::Ctc => self.model.torque_for(q, v, v, &(a_d + e_dot * self.k_d + e * self.k_p)),
            LawKind::PdG => e * self.k_p + e_dot * self.k_d + self.model.gravity(q),
        }
    }
}

/// Weight of the new law's torque in the tick `passed` (from 0) of a cross-fade over `ticks` ticks: 10 s³ − 15 s⁴ + 6 s⁵,
/// whose rate and curvature are zero at both ends, so that the torque neither steps nor kinks there.
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "a few thousand ticks at most")]
pub fn fade_weight(passed: u64, ticks: u64) -> f64 {
    let s = (passed + 1) as f64 / (ticks + 1) as f64;
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// One joint's torque in a cross-fade, N·m. Whoever computes it again gets the same bits.
#[must_use]
pub fn faded(weight: f64, new_nm: f64, old_nm: f64) -> f64 {
    weight * new_nm + (1.0 - weight) * old_nm
}

#[cfg(test)]
mod tests;
