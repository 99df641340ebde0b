//! What a certificate lacks, and which changes would mend it.
//!
//! Nothing here is a rule of thumb: every remedy is found by certifying the changed gains or assumptions again, as they
//! are printed, so that applying it makes all requirements hold at once, those of the sampled loop included.

use core::fmt;

use crate::law::LawKind;

use super::certificate::{Certificate, Gains};
use super::design::{Candidate, Task, best, round, round_up};
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
    /// μ.
    Mismatch,
    /// D, N·m.
    Disturbance,
    /// β, 1/s.
    Beta,
    /// K2, N·m·s.
    K2,
    /// K3.
    K3,
    /// C1, N·m.
    C1,
    /// c, with K_t following where it is not given.
    Level,
    /// K_t, N·m·s, where it was given.
    KTotal,
    /// K_p.
    KP,
    /// K_d.
    KD,
}

impl Quantity {
    const ALL: [Self; 10] = [
        Self::Mismatch,
        Self::Disturbance,
        Self::Beta,
        Self::K2,
        Self::K3,
        Self::C1,
        Self::Level,
        Self::KTotal,
        Self::KP,
        Self::KD,
    ];

    /// The key of the scenario that holds it.
    #[must_use]
    pub const fn key(self) -> &'static str {
        match self {
            Self::Mismatch => "controller.uncertainty.mass",
            Self::Disturbance => "controller.uncertainty.disturbance_nm",
            Self::Beta => "controller.gains.beta",
            Self::K2 => "controller.gains.k2",
            Self::K3 => "controller.gains.k3",
            Self::C1 => "controller.gains.c1",
            Self::Level => "controller.gains.level",
            Self::KTotal => "controller.gains.k_t",
            Self::KP => "controller.gains.kp",
            Self::KD => "controller.gains.kd",
        }
    }

    /// Its value; none where it is not given.
    fn of(self, envelope: &Envelope, gains: &Gains) -> Option<f64> {
        match self {
            Self::Mismatch => Some(envelope.mu),
            Self::Disturbance => Some(envelope.disturbance_nm),
            Self::Beta => Some(gains.beta),
            Self::K2 => Some(gains.k2),
            Self::K3 => Some(gains.k3),
            Self::C1 => gains.c1,
            Self::Level => Some(gains.level),
            Self::KTotal => gains.k_t,
            Self::KP => Some(gains.k_p),
            Self::KD => Some(gains.k_d),
        }
    }

    fn set(self, envelope: &mut Envelope, gains: &mut Gains, value: f64) {
        match self {
            Self::Mismatch => envelope.mu = value,
            Self::Disturbance => envelope.disturbance_nm = value,
            Self::Beta => gains.beta = value,
            Self::K2 => gains.k2 = value,
            Self::K3 => gains.k3 = value,
            Self::C1 => gains.c1 = Some(value),
            Self::Level => gains.level = value,
            Self::KTotal => gains.k_t = Some(value),
            Self::KP => gains.k_p = value,
            Self::KD => gains.k_d = value,
        }
    }
}

/// What leads from some declarations and gains to a candidate.
#[must_use]
pub fn changes(from: (&Envelope, &Gains), to: &Candidate) -> Vec<(Quantity, f64)> {
    let differs = |quantity: Quantity| {
        let value = quantity.of(&to.envelope, &to.gains)?;
        let same = quantity.of(from.0, from.1).is_some_and(|now| now.to_bits() == value.to_bits());
        (!same).then_some((quantity, value))
    };
    Quantity::ALL.into_iter().filter_map(differs).collect()
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

/// Candidates that mend what is missing: each single change the nearest one on its axis that was found, and last the
/// best gains of a grid. If nothing has to change beside what the task declares, that alone.
#[must_use]
pub fn remedies(task: &Task<'_>) -> Vec<Candidate> {
    let as_it_is = task.candidate(task.envelope, task.gains);
    let mut found = Vec::new();
    if task.suits(&as_it_is) && (task.fits)(&as_it_is) {
        found.push(as_it_is);
    } else {
        let search = Search { task, c1: None };
        let covered = Search { c1: Some(round_up(as_it_is.certificate.c1_required)), ..search };
        found.extend(axes(task).iter().filter_map(|axis| {
            let alone = search.nearest(*axis);
            alone.or_else(|| if *axis == Quantity::C1 { None } else { covered.nearest(*axis) })
        }));
    }
    found.extend(best(task).filter(|best| !found.contains(best)));
    found
}

fn axes(task: &Task<'_>) -> &'static [Quantity] {
    match task.law {
        LawKind::Robust | LawKind::RobustFf if task.gains.k_t.is_some() => {
            &[Quantity::KTotal, Quantity::Level, Quantity::K3, Quantity::C1, Quantity::Mismatch, Quantity::Disturbance]
        }
        LawKind::Robust | LawKind::RobustFf => {
            &[Quantity::Level, Quantity::K3, Quantity::C1, Quantity::Mismatch, Quantity::Disturbance]
        }
        LawKind::Ctc | LawKind::PdG => {
            &[Quantity::Level, Quantity::KD, Quantity::KP, Quantity::Mismatch, Quantity::Disturbance]
        }
    }
}

/// One search along one axis, with C1 raised to a value when it is too small whatever the axis says.
#[derive(Clone, Copy)]
struct Search<'a> {
    task: &'a Task<'a>,
    c1: Option<f64>,
}

impl Search<'_> {
    /// The candidate with the value as it would be printed.
    fn with(&self, axis: Quantity, value: f64) -> Candidate {
        let (mut envelope, mut gains) = (self.task.envelope, self.task.gains);
        gains.c1 = self.c1.or(gains.c1);
        axis.set(&mut envelope, &mut gains, round(value));
        self.task.candidate(envelope, gains)
    }

    /// The value nearest to the present one that suits: a walk in steps of 12 %, away on both sides (μ and D: down to
    /// 0), then bisection between the last one that doesn't and the first that does. None if that one does not fit.
    fn nearest(&self, axis: Quantity) -> Option<Candidate> {
        const STEPS: usize = 80;
        let now = axis.of(&self.task.envelope, &self.task.gains).unwrap_or_else(|| {
            let as_it_is = self.task.candidate(self.task.envelope, self.task.gains);
            as_it_is.certificate.c1
        });
        let suits = |value: f64| self.task.suits(&self.with(axis, value));
        // Where a larger C1 alone is enough, it is the remedy of its own axis.
        if !now.is_finite() || suits(now) {
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
                if suits(next) {
                    let found = self.with(axis, bisect(*fails, next, suits));
                    return (self.task.fits)(&found).then_some(found);
                }
                *fails = next;
            }
        }
        None
    }
}

/// The end of what holds, far finer than what is printed.
fn bisect(mut fails: f64, mut holds: f64, holds_at: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..24 {
        let middle = 0.5 * (fails + holds);
        if holds_at(middle) { holds = middle } else { fails = middle }
    }
    holds
}
