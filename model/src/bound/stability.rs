//! How late a torque may be: the stability boundary of the sampled loop, the age for which the bound itself is proven,
//! and how long a torque may be held.
//!
//! All of it is a design rule or a start-up computation; whether a run kept its bound is the matter of `diagnose`.

use crate::law::LawKind;

use super::certificate::Certificate;

pub mod boundary;
pub mod radius;

mod circle;
#[cfg(test)]
mod dense;
mod modal;

pub use self::boundary::critical_rate;
use self::boundary::{critical_rate_with_jitter, longest_period_s};

/// How much of the room that sampling leaves is used by a period and a delay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplingBudget {
    /// a d; 1 and more is unstable where d < h. \[11]
    pub delay_ratio: f64,
    /// a (h − 2d)/2; 1 and more is unstable. \[11]
    pub hold_ratio: f64,
    /// The rate of the fastest mode over the rate at which the loop loses its stability: the larger of both ratios for
    /// a constant d < h. Below 1 the loop is stable.
    pub used: f64,
    /// What may be added to the delay before `used` reaches 1, s; 0 when it has.
    pub delay_margin_s: f64,
    /// The period that separates stable from unstable at this delay, s; none when no period is stable with it.
    pub period_max_s: Option<f64>,
    /// Which rule `used` is of.
    pub rule: SamplingRule,
}

/// The rule by which a use of the sampling budget was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SamplingRule {
    /// \[11]: the delay is the same in every tick.
    ConstantDelay,
    /// \[14]: the delay jumps between its least and its largest. Necessary, not sufficient.
    JitteringDelay,
}

impl SamplingRule {
    /// The name in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ConstantDelay => "constant delay",
            Self::JitteringDelay => "jittering delay",
        }
    }
}

/// Rate a of the fastest mode of the loop, 1/s: ṙ = −a r, in the worst configuration (links aligned).
///
/// K_t/λ̲ for `robust` and `pd+g`; the feed-forward of `robust-ff` adds β times the largest ratio of the model's inertia
/// to the true one. None for `ctc`: it has no mode that is much faster than the chain itself, so that no single rate
/// describes it; [`radius`] does.
#[must_use]
pub fn fast_rate(cert: &Certificate) -> Option<f64> {
    let inertia_ratio = 1.0 + cert.mu / (1.0 - cert.mu) * (cert.lambda_hi / cert.lambda_lo).sqrt();
    let rate = match cert.law()? {
        LawKind::Robust | LawKind::PdG => cert.k_t / cert.lambda_lo,
        LawKind::RobustFf => cert.k_t / cert.lambda_lo + cert.beta * inertia_ratio,
        LawKind::Ctc => return None,
    };
    (rate > 0.0 && rate.is_finite()).then_some(rate)
}

/// \[11] for a period and a constant delay (both s), the torque held in between.
///
/// ṙ = −a r sampled exactly has, for d < h, the characteristic polynomial z² − (1 − a(h−d)) z + a d, and Jury's test of
/// it is a d < 1, a(h − 2d) < 2. None where [`fast_rate`] is none. Local: the loop is linearised; no region of attraction is claimed.
#[must_use]
pub fn sampling_budget(cert: &Certificate, period_s: f64, delay_s: f64) -> Option<SamplingBudget> {
    let critical = |delay_s| critical_rate(period_s, delay_s);
    Some(budget(fast_rate(cert)?, period_s, delay_s, critical, SamplingRule::ConstantDelay))
}

/// The stricter of \[11] and \[14] for a delay that may lie anywhere between `least_s` and `most_s`, from tick to tick.
/// What is left is left of `most_s`.
#[must_use]
pub fn sampling_budget_with_jitter(
    cert: &Certificate,
    period_s: f64,
    least_s: f64,
    most_s: f64,
) -> Option<SamplingBudget> {
    if least_s >= most_s {
        return sampling_budget(cert, period_s, most_s);
    }
    let critical = |most_s| critical_rate_with_jitter(period_s, least_s, most_s);
    let stricter = critical(most_s) < critical_rate(period_s, most_s);
    let rule = if stricter { SamplingRule::JitteringDelay } else { SamplingRule::ConstantDelay };
    Some(budget(fast_rate(cert)?, period_s, most_s, critical, rule))
}

fn budget(rate: f64, period_s: f64, delay_s: f64, critical: impl Fn(f64) -> f64, rule: SamplingRule) -> SamplingBudget {
    SamplingBudget {
        delay_ratio: rate * delay_s,
        hold_ratio: rate * (period_s - 2.0 * delay_s) / 2.0,
        used: rate / critical(delay_s),
        delay_margin_s: boundary::delay_margin_s(rate, period_s, delay_s, critical),
        period_max_s: longest_period_s(rate, period_s, delay_s),
        rule,
    }
}

/// The age for which the bound is proven a priori, with the constants that it then has. \[12]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProvenAge {
    /// T: largest age of a torque (hold and delay together), s.
    pub age_s: f64,
    /// K_f: the share of K_t that the age costs, N·m·s.
    pub gain_share: f64,
    /// ε with the age in it.
    pub epsilon: f64,
}

/// The largest age T for which 𝒱 = V + γ∫(σ−t+T)|ṙ|²dσ is proven to fall at the rate α with K_t as it is; none for
/// laws other than `robust`, or when not even T = 0 is certified.
///
/// With r̄ = sqrt(2c/λ̲), f_e = β²λ̄ + c̄βx, f_r = βλ̄ + c̄(2w + r̄),
///
/// ```text
/// K_f = √3 T K_t (K_t + f_r)/(λ̲ sqrt(1−ξ)),  ξ = 3(T K_t/λ̲)² + αT < 1,  γ = λ̲ K_t/(2√3 (K_t+f_r) sqrt(1−ξ))   [12]
/// ε = C1²/(4(K_t − κ − K2 − K_f)) + 3γT(C1 + f_e ē)²/λ̲²,   c ≥ max(V(0), ε/α)
/// ```
#[must_use]
pub fn proven_age(cert: &Certificate) -> Option<ProvenAge> {
    if cert.law() != Some(LawKind::Robust) || !cert.is_certified() {
        return None;
    }
    let mut best = with_age(cert, 0.0)?;
    // ξ < 1 alone bounds the age by λ̲/(√3 K_t).
    let mut fails = cert.lambda_lo / cert.k_t;
    for _ in 0..60 {
        let middle = 0.5 * (best.age_s + fails);
        match with_age(cert, middle) {
            Some(found) => best = found,
            None => fails = middle,
        }
    }
    Some(best)
}

fn with_age(cert: &Certificate, age_s: f64) -> Option<ProvenAge> {
    let Certificate { beta, k_t, alpha, lambda_lo, lambda_hi, c_bar, .. } = *cert;
    let r_bar = (2.0 * cert.level / lambda_lo).sqrt();
    let f_e = beta * beta * lambda_hi + c_bar * beta * cert.x;
    let f_r = beta * lambda_hi + c_bar * (2.0 * cert.w + r_bar);
    let turn = age_s * k_t / lambda_lo;
    let root = (1.0 - (3.0 * turn * turn + alpha * age_s)).sqrt();
    let gain_share = 3.0f64.sqrt() * age_s * k_t * (k_t + f_r) / (lambda_lo * root);
    let gamma = lambda_lo * k_t / (2.0 * 3.0f64.sqrt() * (k_t + f_r) * root);
    let left = k_t - cert.kappa - cert.k2 - gain_share;
    let push = (cert.c1 + f_e * cert.e_bar) / lambda_lo;
    let epsilon = cert.c1 * cert.c1 / (4.0 * left) + 3.0 * gamma * age_s * push * push;
    // ξ ≥ 1 has made the root not a number, which fails here too.
    let proven = root > 0.0 && left > 0.0 && epsilon <= alpha * cert.level && cert.v_start <= cert.level;
    proven.then_some(ProvenAge { age_s, gain_share, epsilon })
}

/// How long (s) a torque of norm `tau_norm_nm` may be held from a state with V = `v` before V can reach c; 0 when
/// nothing is certified, for `ctc`, or when V is not below c.
///
/// ```text
/// T_H = (1/ϖ) ln((ϖ√c + N)/(ϖ√V + N)),  ϖ = β + c̄w/λ̲,  N = (C1 + δē + |τ|)/sqrt(2λ̲)                            [13]
/// ```
///
/// It counts from the instant at which V was read.
#[must_use]
pub fn hold_limit_s(cert: &Certificate, v: f64, tau_norm_nm: f64) -> f64 {
    // Comparisons are written so that a V that is not a number holds nothing.
    if !(cert.is_certified() && cert.p > 0.0 && v >= 0.0 && v < cert.level && tau_norm_nm.is_finite()) {
        return 0.0;
    }
    let growth = cert.beta + cert.c_bar * cert.w / cert.lambda_lo;
    let push = (cert.c1_held + cert.delta_held * cert.e_bar + tau_norm_nm) / (2.0 * cert.lambda_lo).sqrt();
    libm::log((growth * cert.level.sqrt() + push) / (growth * v.sqrt() + push)) / growth
}

/// H = floor(T_H/h) whole ticks. \[13]
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, and the limit is not negative")]
pub fn hold_limit_ticks(cert: &Certificate, v: f64, tau_norm_nm: f64, period_s: f64) -> u32 {
    (hold_limit_s(cert, v, tau_norm_nm) / period_s).floor() as u32
}

#[cfg(test)]
mod tests;
