//! What a certificate needs in order to hold, and what it lacks.

use core::fmt;

use super::start::StartError;
use super::{Certificate, Gains, OnR};

/// A requirement of a certificate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Requirement {
    /// 0 ≤ μ < 1.
    Mismatch,
    /// β, K_p, K_d, K3 and c are positive and all numbers finite.
    Gains,
    /// p > 0: in `pd+g` K_p − βK_d + β² m̄.
    ErrorWeight,
    /// K2 > 0: what K_t leaves after κ and K3 C1².
    Gain,
    /// K3 C1² > 0: what K_d leaves after κ and K2 (`pd+g`).
    GainAgainstC1,
    /// C1 covers \[6].
    C1,
    /// k = ½K_d − σ η1 > 0 (`ctc`).
    ComputedTorqueMargin,
    /// c ≥ V(0).
    LevelAtStart,
    /// c ≥ ε/α.
    LevelInTheLongRun,
}

/// A requirement that is not met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shortfall {
    /// Which one.
    pub requirement: Requirement,
    /// What was found.
    pub found: f64,
    /// What it must at least be (exceed, where it is 0; stay below, for μ).
    pub needed: f64,
}

impl Shortfall {
    /// By how much the requirement is missed.
    #[must_use]
    pub fn missing(&self) -> f64 {
        (self.needed - self.found).abs()
    }
}

impl fmt::Display for Shortfall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { requirement, found, needed } = self;
        match requirement {
            Requirement::Mismatch => write!(f, "the mass mismatch is {found}, it must be at least 0 and less than 1"),
            Requirement::Gains => write!(f, "a gain, the level or a bound is {found}, it must be finite and positive"),
            Requirement::ErrorWeight => write!(f, "K_p leaves p = {found:.4} as weight of |e|², it must be positive"),
            Requirement::Gain => write!(f, "K_t leaves K2 = {found:.4} after kappa and K3 C1², it must be positive"),
            Requirement::GainAgainstC1 => write!(f, "K_d leaves {found:.4} against C1, it must be positive"),
            Requirement::C1 => write!(f, "C1 = {found:.4} N·m does not cover {needed:.4} N·m"),
            Requirement::ComputedTorqueMargin => write!(f, "½K_d − σ η1 = {found:.4} 1/s, it must be positive"),
            Requirement::LevelAtStart => write!(f, "the level c = {found:.4} is below V(0) = {needed:.4}"),
            Requirement::LevelInTheLongRun => write!(f, "the level c = {found:.4} is below ε/α = {needed:.4}"),
        }
    }
}

/// A certificate, and what is missing when there is none.
#[derive(Clone, Debug, PartialEq)]
pub struct Certification {
    /// The numbers; not `certified` when something is missing.
    pub certificate: Certificate,
    /// Requirements that are not met, the most basic first; empty when certified.
    pub failures: Vec<Shortfall>,
}

impl Certification {
    /// Holds a law's numbers against what every certificate requires, and against the law's own demands.
    ///
    /// `positive` are the numbers that make no sense unless they are positive. `own` demands what belongs to the law, and says
    /// whether that leaves an ε/α to ask about. V(0) is held against the level when a start is given.
    pub(crate) fn of(
        mut certificate: Certificate,
        gains: &Gains,
        start: Option<&StartError>,
        positive: &[f64],
        own: impl FnOnce(&mut Demands) -> bool,
    ) -> Self {
        certificate.v_start = start.map_or(0.0, |start| start.v(&certificate));
        let mut demands = Demands(Vec::new());
        if demands.makes_sense(&certificate, gains, positive) {
            let solid = own(&mut demands);
            let Certificate { level, v_start, .. } = certificate;
            if start.is_some() {
                demands.that(v_start <= level, Requirement::LevelAtStart, level, v_start);
            }
            if solid {
                let v_ultimate = certificate.v_ultimate();
                demands.that(v_ultimate <= level, Requirement::LevelInTheLongRun, level, v_ultimate);
            }
        }
        certificate.certified = demands.0.is_empty();
        Self { certificate, failures: demands.0 }
    }
}

/// What is demanded of a certificate, and was not met.
pub(crate) struct Demands(Vec<Shortfall>);

impl Demands {
    /// Demands something; whether it is met.
    pub(crate) fn that(&mut self, met: bool, requirement: Requirement, found: f64, needed: f64) -> bool {
        if !met {
            self.0.push(Shortfall { requirement, found, needed });
        }
        met
    }

    /// Demands that what is declared and given are numbers for which the rest makes sense.
    fn makes_sense(&mut self, certificate: &Certificate, gains: &Gains, positive: &[f64]) -> bool {
        let env = &certificate.envelope;
        if !self.that((0.0..1.0).contains(&env.mu), Requirement::Mismatch, env.mu, 1.0) {
            return false;
        }
        let assumed = [env.disturbance_nm, env.v_inf, env.v_2, env.a_2, gains.c1.unwrap_or(0.0)];
        let bad_gain = positive.iter().find(|x| !(x.is_finite() && **x > 0.0));
        let bad_bound = assumed.iter().find(|x| !(x.is_finite() && **x >= 0.0));
        bad_gain.or(bad_bound).is_none_or(|found| self.that(false, Requirement::Gains, *found, 0.0))
    }

    /// Demands that C1 covers \[6].
    pub(crate) fn c1(&mut self, of: &OnR) {
        self.that(of.c1 >= of.c1_required, Requirement::C1, of.c1, of.c1_required);
    }

    /// Demands a V that weighs the error.
    pub(crate) fn error_weight(&mut self, of: &OnR) -> bool {
        self.that(of.p > 0.0, Requirement::ErrorWeight, of.p, 0.0)
    }

    /// Demands a share of the gain that makes V fall.
    pub(crate) fn gain(&mut self, of: &OnR) -> bool {
        self.that(of.k2 > 0.0, Requirement::Gain, of.k2, 0.0)
    }
}
