//! How late a torque may be: the share of the room that sampling leaves \[11], \[14], the age for which the bound itself is proven
//! \[12], and how long a torque may be held \[13].
//!
//! All of it is a design rule or a start-up computation; whether a run kept its bound is the matter of `diagnose`.

use super::boundary::{self, critical_rate, critical_rate_with_jitter, longest_period_s};
use super::{Certificate, Form};

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

/// \[11] for a period and a constant delay (both s), the torque held in between.
///
/// ṙ = −a r sampled exactly has, for d < h, the characteristic polynomial z² − (1 − a(h−d)) z + a d, and Jury's test of
/// it is a d < 1, a(h − 2d) < 2. None where the certificate has no fast rate. Local: the loop is linearised; no region of attraction is claimed.
#[must_use]
pub fn sampling_budget(cert: &Certificate, period_s: f64, delay_s: f64) -> Option<SamplingBudget> {
    let critical = |delay_s| critical_rate(period_s, delay_s);
    Some(budget(cert.fast_rate?, period_s, delay_s, critical, SamplingRule::ConstantDelay))
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
    Some(budget(cert.fast_rate?, period_s, most_s, critical, rule))
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

/// The age for which the bound of a law is proven a priori, with the constants that it then has. \[12]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProvenAge {
    /// T: largest age of a torque (hold and delay together), s.
    pub age_s: f64,
    /// K_f: the share of K_t that the age costs, N·m·s.
    pub gain_share: f64,
    /// ε with the age in it.
    pub epsilon: f64,
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
    let Form::OnR(of) = &cert.form else { return 0.0 };
    // Comparisons are written so that a V that is not a number holds nothing.
    if !(cert.is_certified() && v >= 0.0 && v < cert.level && tau_norm_nm.is_finite()) {
        return 0.0;
    }
    let (lambda_lo, level) = (cert.envelope.lambda_lo(), cert.level);
    let growth = of.beta + cert.envelope.c_bar() * of.w / lambda_lo;
    let push = (of.c1_held + of.delta_held * of.e_bar + tau_norm_nm) / (2.0 * lambda_lo).sqrt();
    libm::log((growth * level.sqrt() + push) / (growth * v.sqrt() + push)) / growth
}

/// H = floor(T_H/h) whole ticks. \[13]
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, and the limit is not negative")]
pub fn hold_limit_ticks(cert: &Certificate, v: f64, tau_norm_nm: f64, period_s: f64) -> u32 {
    (hold_limit_s(cert, v, tau_norm_nm) / period_s).floor() as u32
}
