//! The control laws: which there are, and what can be asked of any of them.
//!
//! One file a law: its torque, the gains that it uses, its certificate with what that requires, the rate of its fastest mode,
//! and what may be changed to remedy a certificate. Here is the list; nothing else in the workspace enumerates the laws.
//!
//! No clock, no memory, no input or output: the same input gives the same torque in every process and in a replay.
//! Limits of the actuators belong to the plant.
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

use crate::certificate::envelope::{Assumptions, Envelope};
use crate::certificate::reach::Reach;
use crate::certificate::requirement::Certification;
use crate::certificate::sampling::ProvenAge;
use crate::certificate::search::Rules;
use crate::certificate::start::StartError;
use crate::certificate::units::Units;
use crate::certificate::{Certificate, Gains};
use crate::chain::{Chain, Matrix, Vector};
pub use crate::input::LawInput;
use crate::quote;

mod ctc;
mod pd_g;
mod robust;
mod robust_ff;

/// Which law computes the torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(into = "&str", try_from = "String")]
pub enum LawKind {
    /// The paper's law, free of a model: a proportional-derivative law without gravity.
    Robust,
    /// The paper's (9) with its robust term: feed-forward of the model and K_t r.
    RobustFf,
    /// Computed torque.
    Ctc,
    /// Proportional-derivative with gravity compensation, the baseline.
    PdG,
}

/// Asks something of the law that a kind stands for.
macro_rules! of_law {
    ($kind:expr, $($asked:tt)+) => {
        match $kind {
            LawKind::Robust => <robust::Robust as ControlLaw>::$($asked)+,
            LawKind::RobustFf => <robust_ff::RobustFf as ControlLaw>::$($asked)+,
            LawKind::Ctc => <ctc::Ctc as ControlLaw>::$($asked)+,
            LawKind::PdG => <pd_g::PdG as ControlLaw>::$($asked)+,
        }
    };
}

/// What a law's file says of it.
trait ControlLaw {
    /// The name in scenarios, on the command line and in reports.
    const NAME: &'static str;
    /// The gains that the torque depends on.
    const GAINS: [Gain; 2];
    /// The units of its certificate.
    const UNITS: Units = Units::ON_R;
    /// C1 where the scenario names none, N·m; none: as much as is required.
    const C1_NM: Option<f64> = None;
    /// How it is certified, and how gains are sought for it.
    const RULES: Rules;

    /// The torque τ, N·m, not limited.
    fn torque<const N: usize>(law: &Law<N>, input: &LawInput<N>) -> Vector<N>;

    /// dτ/dq and dτ/dq̇ at rest with e = 0, for M̂ and ∂Ĝ/∂q.
    fn at_rest<const N: usize>(law: &Law<N>, mass: &Matrix<N>, weight: &Matrix<N>) -> (Matrix<N>, Matrix<N>);

    /// What of the terms without state (M q̈_d + C q̇_d + G − d) it feeds forward, N·m; a law certified on y is not asked.
    fn fed_forward<const N: usize>(_law: &Law<N>, _input: &LawInput<N>) -> Vector<N> {
        Vector::zeros()
    }

    /// Bound of |τ_i| on {V ≤ c}, N·m, for link `i` from 0.
    fn torque_bound<const N: usize>(law: &Law<N>, certificate: &Certificate, reach: &Reach<N>, i: usize) -> f64;

    /// The age of a torque for which its certificate is proven beforehand. \[12]
    fn proven_age(_certificate: &Certificate) -> Option<ProvenAge> {
        None
    }

    /// Gains whose fastest mode has about the rate `rate` (1/s), for links with the least inertia `lambda_lo` (kg·m²); none for a
    /// law without such a mode.
    fn gains_for_rate(_rate: f64, _lambda_lo: f64, _gains: &Gains) -> Option<Gains> {
        None
    }
}

impl LawKind {
    /// Every law, in the order of the documentation.
    pub const ALL: [Self; 4] = [Self::Robust, Self::RobustFf, Self::Ctc, Self::PdG];

    /// The name in scenarios, on the command line and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        of_law!(self, NAME)
    }

    /// The names of some laws, as a message lists them.
    #[must_use]
    pub fn names(of: impl Fn(Self) -> bool) -> String {
        Self::ALL.into_iter().filter(|law| of(*law)).map(Self::name).collect::<Vec<_>>().join(", ")
    }

    /// The code in samples: 1 and up, since 0 stands for none.
    #[must_use]
    pub const fn code(self) -> u32 {
        self as u32 + 1
    }

    /// The law of a code; none for 0 and for codes of no law.
    #[must_use]
    pub fn of_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|law| law.code() == code)
    }

    /// Whether the torque depends on a gain.
    #[must_use]
    pub fn uses(self, gain: Gain) -> bool {
        self.gains().contains(&gain)
    }

    /// The gains that the torque depends on.
    #[must_use]
    pub const fn gains(self) -> [Gain; 2] {
        of_law!(self, GAINS)
    }

    /// The units of its certificate.
    #[must_use]
    pub const fn units(self) -> Units {
        of_law!(self, UNITS)
    }

    /// C1 where the scenario names none, N·m; none: as much as is required.
    #[must_use]
    pub const fn c1_nm(self) -> Option<f64> {
        of_law!(self, C1_NM)
    }

    /// How it is certified, and how gains are sought for it.
    #[must_use]
    pub const fn rules(self) -> Rules {
        of_law!(self, RULES)
    }

    /// The age of a torque for which a certificate of this law is proven beforehand; none for a law, or a certificate, for which
    /// nothing is. \[12]
    #[must_use]
    pub fn proven_age(self, certificate: &Certificate) -> Option<ProvenAge> {
        of_law!(self, proven_age(certificate))
    }

    /// Gains whose fastest mode has about the rate `rate` (1/s), for links with the least inertia `lambda_lo` (kg·m²); none for a
    /// law without such a mode.
    #[must_use]
    pub fn gains_for_rate(self, rate: f64, lambda_lo: f64, gains: &Gains) -> Option<Gains> {
        of_law!(self, gains_for_rate(rate, lambda_lo, gains))
    }
}

impl fmt::Display for LawKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl From<LawKind> for &str {
    fn from(kind: LawKind) -> Self {
        kind.name()
    }
}

/// A name that is no law's.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("no law is called \"{}\", allowed: {}{}", quote::text(found), LawKind::names(|_| true), hint(found))]
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

impl TryFrom<String> for LawKind {
    type Error = UnknownLaw;

    fn try_from(name: String) -> Result<Self, UnknownLaw> {
        name.parse()
    }
}

/// A gain that torques can depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gain {
    /// β.
    Beta,
    /// K_t.
    KTotal,
    /// K_p.
    KP,
    /// K_d.
    KD,
}

impl Gains {
    /// The gains that a law has when nothing is said; those of `robust` are the documentation's example.
    #[must_use]
    pub const fn of(law: LawKind) -> Self {
        Self {
            beta: 5.0,
            k2: 10.0,
            k3: 0.04,
            c1: law.c1_nm(),
            level: 6.0,
            k_p: 25.0,
            k_d: 10.0,
            k_t: None,
            analyst_beta: None,
            analyst_k2: None,
            shared_v: false,
        }
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
    /// A law with the gains that its certificate was computed for.
    #[must_use]
    pub fn new(kind: LawKind, model: Chain<N>, gains: &Gains, certificate: &Certificate) -> Self {
        let Gains { beta, k_p, k_d, .. } = *gains;
        Self { kind, model, beta, k_t: certificate.k_t(), k_p, k_d }
    }

    /// The torque τ, N·m, not limited.
    #[must_use]
    pub fn torque(&self, input: &LawInput<N>) -> Vector<N> {
        of_law!(self.kind, torque(self, input))
    }

    /// dτ/dq (N·m/rad) and dτ/dq̇ (N·m·s/rad) about rest at `q` with e = 0.
    #[must_use]
    pub fn at_rest(&self, q: &Vector<N>) -> (Matrix<N>, Matrix<N>) {
        of_law!(self.kind, at_rest(self, &self.model.mass_matrix(q), &self.model.gravity_rate(q)))
    }

    /// What of the terms without state it feeds forward, N·m: what Ψ is reduced by. \[5]
    pub(crate) fn fed_forward(&self, input: &LawInput<N>) -> Vector<N> {
        of_law!(self.kind, fed_forward(self, input))
    }

    /// Bound of |τ_i| on {V ≤ c}, N·m, for link `i` from 0: what `robust` reaches, what the other laws stay below.
    pub(crate) fn torque_bound(&self, certificate: &Certificate, reach: &Reach<N>, i: usize) -> f64 {
        of_law!(self.kind, torque_bound(self, certificate, reach, i))
    }
}

/// Certifies a law. V(0) is checked against the level when a start is given.
#[must_use]
pub fn certify<const N: usize>(
    law: LawKind,
    assumptions: &Assumptions<N>,
    gains: &Gains,
    start: Option<&LawInput<N>>,
) -> Certification {
    let start = start.map(|input| StartError::of(&assumptions.nominal, input));
    (law.rules().certify)(&assumptions.envelope(), gains, start.as_ref())
}

/// The certificate alone, without diagnosis of what is missing.
#[must_use]
pub fn certificate(law: LawKind, envelope: &Envelope, gains: &Gains, start: Option<&StartError>) -> Certificate {
    (law.rules().certify)(envelope, gains, start).certificate
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
