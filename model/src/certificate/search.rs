//! Gains and declarations, tried by certifying them: what a search may change, what it asks of a candidate, and the grid
//! of the laws on r.
//!
//! Every number that is changed has four significant digits *before* it is certified, so that what is printed is what was
//! tried.

use super::boundary::critical_rate;
use super::envelope::Envelope;
use super::requirement::Certification;
use super::start::StartError;
use super::{Certificate, Gains};

/// What certifying and searching need to know of a law.
#[derive(Clone, Copy)]
pub struct Rules {
    /// Its certificate, with what is missing. V(0) is held against the level when a start is given.
    pub certify: fn(&Envelope, &Gains, Option<&StartError>) -> Certification,
    /// What remedies may change, the first tried first.
    pub axes: fn(&Gains) -> &'static [Quantity],
    /// A fixed grid of gains that are certified and keep the room that \[11] leaves.
    pub grid: fn(&Task<'_>) -> Vec<Candidate>,
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
    /// All of them, in the order in which they are listed.
    pub(crate) const ALL: [Self; 10] = [
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
    pub(crate) fn of(self, envelope: &Envelope, gains: &Gains) -> Option<f64> {
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

    /// Sets it.
    pub(crate) fn set(self, envelope: &mut Envelope, gains: &mut Gains, value: f64) {
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

/// What gains are sought for.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// What is to be known of the law.
    pub rules: Rules,
    /// What is declared.
    pub envelope: Envelope,
    /// The gains as they are; what is not changed stays.
    pub gains: Gains,
    /// The start that c has to cover.
    pub start: Option<StartError>,
    /// h, s.
    pub period_s: f64,
    /// From a sample to the action of its torque, s.
    pub delay_s: f64,
    /// The share of \[11] that may be used, at most 1.
    pub room: f64,
    /// What else is asked of a candidate, such as a spectral radius: dear, so it is asked last.
    pub fits: &'a dyn Fn(&Candidate) -> bool,
}

/// Gains and declarations with their certificate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// What is declared.
    pub envelope: Envelope,
    /// The gains.
    pub gains: Gains,
    /// What they certify, if anything.
    pub certificate: Certificate,
}

impl Task<'_> {
    /// The certificate of some gains and declarations.
    #[must_use]
    pub fn candidate(&self, envelope: Envelope, gains: Gains) -> Candidate {
        let certificate = (self.rules.certify)(&envelope, &gains, self.start.as_ref()).certificate;
        Candidate { envelope, gains, certificate }
    }

    /// Whether a candidate is certified and keeps the room that \[11] leaves.
    #[must_use]
    pub fn suits(&self, candidate: &Candidate) -> bool {
        // The use alone: what is left of delay and period would cost far more than the certificate.
        let used = || Some(candidate.certificate.fast_rate? / critical_rate(self.period_s, self.delay_s));
        candidate.certificate.is_certified() && used().is_none_or(|used| used <= self.room)
    }

    /// C1 as it would be written for a requirement (N·m): where none is written, what is required is taken.
    pub(crate) fn c1(&self, required_nm: f64) -> Option<f64> {
        self.gains.c1.map(|_| round_up(required_nm.max(1e-3)))
    }

    /// The candidate with the least level that its start and its ε ask for; none if no level is enough. κ grows with c,
    /// so the level is raised from below.
    pub(crate) fn settled(&self, gains_at: impl Fn(f64) -> Option<Gains>) -> Option<Candidate> {
        // The first look tells what the start needs. Longer steps end a chase that κ would win anyway.
        const RAISED_BY: [f64; 8] = [1.0, 1.0, 1.02, 1.1, 1.3, 1.6, 2.0, 2.0];
        let mut level = 1e-3;
        for raised_by in RAISED_BY {
            let found = self.candidate(self.envelope, gains_at(level)?);
            let cert = &found.certificate;
            if cert.is_certified() {
                return self.suits(&found).then_some(found);
            }
            let needed = cert.v_start.max(cert.v_ultimate());
            // Something else is missing, which a larger level does not give.
            if !needed.is_finite() || needed <= level {
                return None;
            }
            level = round_up(needed * raised_by);
        }
        None
    }
}

/// β and shares of the K_t that \[11] allows. Of what κ leaves, K2 takes the share that is best or, where p depends on it,
/// one of a few; the rest works against C1.
///
/// `shares` are those few; none: the best is known. `modelled` is the part of the fast rate (1/s) that a β costs without K_t.
pub(crate) fn on_r(task: &Task<'_>, shares: &[f64], modelled: impl Fn(f64) -> f64) -> Vec<Candidate> {
    let rate = task.room * critical_rate(task.period_s, task.delay_s);
    let shares: Vec<Option<f64>> =
        if shares.is_empty() { vec![None] } else { shares.iter().copied().map(Some).collect() };
    let mut found = Vec::new();
    for step in 0..33 {
        let beta = round_down(libm::exp2(f64::from(step) * 0.1875 - 1.0));
        let most = (rate - modelled(beta)) * task.envelope.lambda_lo();
        for (stiff, share) in [1.0, 0.7, 0.4].into_iter().flat_map(|stiff| shares.iter().map(move |s| (stiff, *s))) {
            let k_t = round_down(stiff * most);
            if k_t > 0.0 {
                found.extend(task.settled(|level| shared_out(task, k_t, beta, level, share)));
            }
        }
    }
    found
}

/// Gains that come to K_t at a level; none if κ takes all of it. Without a share: the best one.
fn shared_out(task: &Task<'_>, k_t: f64, beta: f64, level: f64, share: Option<f64>) -> Option<Gains> {
    let k2 = round_down(k_t * share.unwrap_or(0.5));
    let mut plain = Gains { beta, level, k2, k_t: None, c1: None, ..task.gains };
    let probed = (task.rules.certify)(&task.envelope, &plain, None).certificate;
    let probe = probed.on_r()?;
    if share.is_none() {
        // ε/α is smallest at half of what κ leaves of K_t, or where α stops growing with K2.
        let alike = task.envelope.lambda_hi() * probed.e_rate / probe.p;
        plain.k2 = round_down(((k_t - probe.kappa) / 2.0).min(alike));
    }
    let c1 = task.c1(probe.c1_required);
    let (left, covered) = (k_t - probe.kappa - plain.k2, c1.unwrap_or(probe.c1_required));
    let k3 = if covered > 0.0 { round_down(left / (covered * covered)) } else { plain.k3 };
    let k_t = task.gains.k_t.map(|_| k_t);
    (plain.k2 > 0.0 && left > 0.0 && k3 > 0.0).then_some(Gains { k3, c1, k_t, ..plain })
}

/// The nearest number of four significant digits.
#[must_use]
pub fn round(value: f64) -> f64 {
    to_digits(value, f64::round)
}

/// The largest number of four significant digits that is not above.
#[must_use]
pub fn round_down(value: f64) -> f64 {
    to_digits(value, f64::floor)
}

/// The smallest number of four significant digits that is not below.
#[must_use]
pub fn round_up(value: f64) -> f64 {
    to_digits(value, f64::ceil)
}

fn to_digits(value: f64, whole: impl Fn(f64) -> f64) -> f64 {
    // Beyond these nothing is a gain.
    if !(1e-12..1e12).contains(&value.abs()) {
        return if value.is_finite() && value.abs() < 1.0 { 0.0 } else { value };
    }
    // Powers of ten up to 10^22 are exact, so the quotient is the double next to the decimal number.
    let places = 3.0 - libm::floor(libm::log10(value.abs()));
    if places >= 0.0 {
        let scale = libm::round(libm::pow(10.0, places));
        whole(value * scale) / scale
    } else {
        let scale = libm::round(libm::pow(10.0, -places));
        whole(value / scale) * scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::close;

    #[test]
    fn numbers_are_rounded_to_what_is_printed() {
        for value in [0.0, 1.0, 12345.678, 0.000_123_456, 9.9996, 99995.0, 1e-9, 3.0 * 7.7, -0.012_345] {
            let (down, up) = (round_down(value), round_up(value));
            assert!(down <= value && value <= up && up - down <= 1.1e-3 * value.abs(), "{value}: {down} {up}");
            for rounded in [down, up, round(value)] {
                let text = format!("{rounded}");
                assert!(
                    text.trim_start_matches(['0', '.', '-']).replace('.', "").trim_end_matches('0').len() <= 4,
                    "{text}"
                );
                close(text.parse().unwrap(), rounded, 0.0);
            }
        }
        assert!(round(f64::NAN).is_nan() && round(f64::INFINITY).is_infinite());
    }
}
