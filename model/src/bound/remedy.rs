//! What a certificate lacks, and which single change would mend it.
//!
//! Nothing here is a rule of thumb: every remedy is found by certifying the changed gains or assumptions again, so that
//! applying it makes all requirements hold at once.

use core::fmt;

use crate::law::LawKind;

use super::certificate::{Certificate, Gains, StartError, certificate};
use super::envelope::Envelope;

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

/// A number that a remedy changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// c, with K_t following where it is not given.
    Level,
    /// C1, N·m.
    C1,
    /// K3.
    K3,
    /// K_t, N·m·s, where it was given.
    KTotal,
    /// K_p.
    KP,
    /// K_d.
    KD,
    /// μ.
    Mismatch,
    /// D, N·m.
    Disturbance,
}

impl Quantity {
    /// As in the equations.
    #[must_use]
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::Level => "c",
            Self::C1 => "C1",
            Self::K3 => "K3",
            Self::KTotal => "K_t",
            Self::KP => "K_p",
            Self::KD => "K_d",
            Self::Mismatch => "mu",
            Self::Disturbance => "D",
        }
    }
}

/// A change that makes every requirement hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Remedy {
    /// What to change.
    pub quantity: Quantity,
    /// Its value now, in the certificate that fails.
    pub now: f64,
    /// The nearest value found that certifies.
    pub value: f64,
    /// A C1 (N·m) that must go with it, where C1 is too small as well.
    pub with_c1: Option<f64>,
    /// The gain K_t (K_d in `pd+g` and `ctc`) that the mended certificate asks for.
    pub k_t: f64,
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {:.6} instead of {:.6}", self.quantity.symbol(), self.value, self.now)?;
        if let Some(c1) = self.with_c1 {
            write!(f, " with C1 = {c1:.6}")?;
        }
        write!(f, " (gain {:.6})", self.k_t)
    }
}

/// The requirements that a certificate misses, most basic first.
#[must_use]
pub fn shortfalls(cert: &Certificate, env: &Envelope, gains: &Gains, has_start: bool) -> Vec<Shortfall> {
    let mut missing = Vec::new();
    let mut demand = |met: bool, requirement, found, needed| {
        if !met {
            missing.push(Shortfall { requirement, found, needed });
        }
        met
    };
    if !demand((0.0..1.0).contains(&env.mu), Requirement::Mismatch, env.mu, 1.0) {
        return missing;
    }
    let ctc = cert.law() == Some(LawKind::Ctc);
    let positive = match cert.law() {
        Some(LawKind::Ctc) => [gains.k_p, gains.k_d, gains.level, 1.0],
        Some(LawKind::PdG) => [gains.k_p, gains.k_d, gains.level, cert.beta],
        _ => [gains.beta, gains.k3, gains.level, gains.k_t.unwrap_or(gains.k2)],
    };
    let assumed = [env.disturbance_nm, env.v_inf, env.v_2, env.a_2, gains.c1.unwrap_or(0.0)];
    let bad_gain = positive.into_iter().find(|x| !(x.is_finite() && *x > 0.0));
    let bad_bound = assumed.into_iter().find(|x| !(x.is_finite() && *x >= 0.0));
    if let Some(found) = bad_gain.or(bad_bound) {
        demand(false, Requirement::Gains, found, 0.0);
        return missing;
    }
    let solid = if ctc {
        demand(cert.k > 0.0, Requirement::ComputedTorqueMargin, cert.k, 0.0)
    } else {
        let against_c1 = cert.k_t - cert.kappa - cert.k2;
        let pd_g = cert.law() == Some(LawKind::PdG);
        let enough = against_c1 > 0.0 || (cert.c1 <= 0.0 && against_c1 >= 0.0);
        demand(cert.c1 >= cert.c1_required, Requirement::C1, cert.c1, cert.c1_required);
        demand(cert.p > 0.0, Requirement::ErrorWeight, cert.p, 0.0)
            && demand(!pd_g || enough, Requirement::GainAgainstC1, against_c1, 0.0)
            && demand(cert.k2 > 0.0, Requirement::Gain, cert.k2, 0.0)
    };
    if has_start {
        demand(cert.v_start <= cert.level, Requirement::LevelAtStart, cert.level, cert.v_start);
    }
    if solid {
        demand(cert.v_ultimate() <= cert.level, Requirement::LevelInTheLongRun, cert.level, cert.v_ultimate());
    }
    missing
}

/// Single changes that mend a failing certificate, each the nearest one on its axis that was found.
#[must_use]
pub fn remedies(
    law: LawKind,
    env: &Envelope,
    gains: &Gains,
    start: Option<&StartError>,
    failing: &Certificate,
) -> Vec<Remedy> {
    let axes = match law {
        LawKind::Robust | LawKind::RobustFf if gains.k_t.is_some() => {
            &[Quantity::KTotal, Quantity::Level, Quantity::K3, Quantity::C1, Quantity::Mismatch, Quantity::Disturbance]
                [..]
        }
        LawKind::Robust | LawKind::RobustFf => {
            &[Quantity::Level, Quantity::K3, Quantity::C1, Quantity::Mismatch, Quantity::Disturbance][..]
        }
        LawKind::Ctc | LawKind::PdG => {
            &[Quantity::Level, Quantity::KD, Quantity::KP, Quantity::Mismatch, Quantity::Disturbance][..]
        }
    };
    let search = Search { law, env, gains, start, c1: None };
    let covered = Search { c1: Some(failing.c1_required), ..search };
    axes.iter()
        .filter_map(|axis| {
            search
                .nearest(*axis, failing)
                .or_else(|| if *axis == Quantity::C1 { None } else { covered.nearest(*axis, failing) })
        })
        .collect()
}

/// One search along one axis, with C1 raised to a value when it is too small whatever the axis says.
#[derive(Clone, Copy)]
struct Search<'a> {
    law: LawKind,
    env: &'a Envelope,
    gains: &'a Gains,
    start: Option<&'a StartError>,
    c1: Option<f64>,
}

impl Search<'_> {
    fn with(&self, axis: Quantity, value: f64) -> Certificate {
        let (mut env, mut gains) = (*self.env, *self.gains);
        gains.c1 = self.c1.or(gains.c1);
        match axis {
            Quantity::Level => gains.level = value,
            Quantity::C1 => gains.c1 = Some(value),
            Quantity::K3 => gains.k3 = value,
            Quantity::KTotal => gains.k_t = Some(value),
            Quantity::KP => gains.k_p = value,
            Quantity::KD => gains.k_d = value,
            Quantity::Mismatch => env.mu = value,
            Quantity::Disturbance => env.disturbance_nm = value,
        }
        certificate(self.law, &env, &gains, self.start)
    }

    /// The certified value nearest to the present one: a walk in steps of 12 %, away on both sides (μ and D: down to
    /// 0), then bisection between the last failing and the first certified value.
    fn nearest(&self, axis: Quantity, failing: &Certificate) -> Option<Remedy> {
        const STEPS: usize = 80;
        let now = self.value_now(axis, failing);
        // Where a larger C1 alone is enough, it is the remedy of its own axis.
        if !now.is_finite() || self.with(axis, now).is_certified() {
            return None;
        }
        let ratios: &[f64] = match axis {
            Quantity::Mismatch | Quantity::Disturbance => &[1.0 / 1.12],
            _ => &[1.12, 1.0 / 1.12],
        };
        let mut walkers: Vec<(f64, f64)> = ratios.iter().map(|ratio| (now, *ratio)).collect();
        for step in 0..=STEPS {
            for (fails, ratio) in &mut walkers {
                // From 0 one cannot walk by ratios; and the last step down leads to no mismatch, no disturbance.
                let next = if step == STEPS && *ratio < 1.0 { 0.0 } else { *fails * *ratio };
                if self.with(axis, next).is_certified() {
                    return Some(self.remedy(axis, now, *fails, next));
                }
                *fails = next;
            }
        }
        None
    }

    fn remedy(&self, axis: Quantity, now: f64, mut fails: f64, mut holds: f64) -> Remedy {
        for _ in 0..40 {
            let middle = 0.5 * (fails + holds);
            if self.with(axis, middle).is_certified() { holds = middle } else { fails = middle }
        }
        let mended = self.with(axis, holds);
        let k_t = if self.law == LawKind::Ctc { mended.k_d } else { mended.k_t };
        Remedy { quantity: axis, now, value: holds, with_c1: self.c1, k_t }
    }

    fn value_now(&self, axis: Quantity, failing: &Certificate) -> f64 {
        match axis {
            Quantity::Level => self.gains.level,
            Quantity::C1 => failing.c1,
            Quantity::K3 => self.gains.k3,
            Quantity::KTotal => failing.k_t,
            Quantity::KP => self.gains.k_p,
            Quantity::KD => self.gains.k_d,
            Quantity::Mismatch => self.env.mu,
            Quantity::Disturbance => self.env.disturbance_nm,
        }
    }
}
