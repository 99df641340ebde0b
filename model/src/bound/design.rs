//! Gains for a loop: certified, within a share of the room that sampling leaves, and as they would be written down.
//!
//! Every number that is changed has four significant digits *before* it is certified, so that what is printed is what was
//! tried. Merit is the proven bound of |e|: ‖W‖ adds rad² to rad²/s², and where it is smallest depends on the unit of time.

use crate::law::LawKind;

use super::certificate::{Certificate, Gains, StartError, certificate};
use super::envelope::Envelope;
use super::stability::{critical_rate, fast_rate};

/// Candidates that are asked whether they fit, the best first.
const TRIES: usize = 60;

/// What gains are sought for.
#[derive(Clone, Copy)]
pub struct Task<'a> {
    /// The law.
    pub law: LawKind,
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
        let certificate = certificate(self.law, &envelope, &gains, self.start.as_ref());
        Candidate { envelope, gains, certificate }
    }

    /// Whether a candidate is certified and keeps the room that \[11] leaves.
    #[must_use]
    pub fn suits(&self, candidate: &Candidate) -> bool {
        // The use alone: what is left of delay and period would cost far more than the certificate.
        let used = || Some(fast_rate(&candidate.certificate)? / critical_rate(self.period_s, self.delay_s));
        candidate.certificate.is_certified() && used().is_none_or(|used| used <= self.room)
    }

    /// C1 as it would be written for a requirement (N·m): laws that take what is required write none.
    fn c1(&self, required_nm: f64) -> Option<f64> {
        (self.law == LawKind::Robust || self.gains.c1.is_some()).then(|| round_up(required_nm.max(1e-3)))
    }

    /// The candidate with the least level that its start and its ε ask for; none if no level is enough. κ grows with c,
    /// so the level is raised from below.
    fn settled(&self, gains_at: impl Fn(f64) -> Option<Gains>) -> Option<Candidate> {
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

/// The gains with the smallest proven |e| on a fixed grid; of equal ones (an exact model proves 0) the nearest to those
/// of the task. None if no gains of the grid suit.
#[must_use]
pub fn best(task: &Task<'_>) -> Option<Candidate> {
    let mut found = match task.law {
        LawKind::Robust | LawKind::RobustFf => of_r(task),
        LawKind::Ctc => of_ctc(task),
        LawKind::PdG => of_pd_g(task),
    };
    let merit = |candidate: &Candidate| (candidate.certificate.ultimate_e, distance(&task.gains, &candidate.gains));
    found.sort_by(|a, b| {
        let ((e_a, far_a), (e_b, far_b)) = (merit(a), merit(b));
        e_a.total_cmp(&e_b).then(far_a.total_cmp(&far_b))
    });
    found.into_iter().take(TRIES).find(|candidate| (task.fits)(candidate))
}

/// How far apart gains are: the sum of the logarithms of their ratios.
fn distance(from: &Gains, to: &Gains) -> f64 {
    let pairs = [(from.beta, to.beta), (from.k2, to.k2), (from.k3, to.k3), (from.k_p, to.k_p), (from.k_d, to.k_d)];
    pairs.into_iter().map(|(from, to)| libm::log(to / from).abs()).sum()
}

/// β and shares of the K_t that \[11] allows. Of what κ leaves, K2 takes the share that is best or, where p depends on it,
/// one of a few; the rest works against C1.
fn of_r(task: &Task<'_>) -> Vec<Candidate> {
    let (law, envelope) = (task.law, &task.envelope);
    let rate = task.room * critical_rate(task.period_s, task.delay_s);
    let shares: &[f64] = if law == LawKind::RobustFf && !task.gains.shared_v {
        &[0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8]
    } else {
        &[f64::NAN]
    };
    let mut found = Vec::new();
    for step in 0..33 {
        let beta = round_down(libm::exp2(f64::from(step) * 0.1875 - 1.0));
        let damping = if law == LawKind::RobustFf { beta * (1.0 + envelope.rho()) } else { 0.0 };
        let most = (rate - damping) * envelope.lambda_lo();
        for (stiff, share) in [1.0, 0.7, 0.4].into_iter().flat_map(|stiff| shares.iter().map(move |s| (stiff, *s))) {
            let k_t = round_down(stiff * most);
            if k_t > 0.0 {
                found.extend(task.settled(|level| shared_out(task, k_t, beta, level, share)));
            }
        }
    }
    found
}

/// Gains that come to K_t at a level; none if κ takes all of it. A share that is no number: the best one.
fn shared_out(task: &Task<'_>, k_t: f64, beta: f64, level: f64, share: f64) -> Option<Gains> {
    let k2 = round_down(k_t * if share.is_nan() { 0.5 } else { share });
    let mut plain = Gains { beta, level, k2, k_t: None, c1: None, ..task.gains };
    let probe = certificate(task.law, &task.envelope, &plain, None);
    if share.is_nan() {
        // ε/α is smallest at half of what κ leaves of K_t, or where α stops growing with K2.
        let alike = task.envelope.lambda_hi() * probe.e_rate / probe.p;
        plain.k2 = round_down(((k_t - probe.kappa) / 2.0).min(alike));
    }
    let c1 = task.c1(probe.c1_required);
    let (left, covered) = (k_t - probe.kappa - plain.k2, c1.unwrap_or(probe.c1_required));
    let k3 = if covered > 0.0 { round_down(left / (covered * covered)) } else { plain.k3 };
    let k_t = task.gains.k_t.map(|_| k_t);
    (plain.k2 > 0.0 && left > 0.0 && k3 > 0.0).then_some(Gains { k3, c1, k_t, ..plain })
}

/// K_p and the damping, with the gains as they are among them.
fn of_ctc(task: &Task<'_>) -> Vec<Candidate> {
    let grid = (0..29).flat_map(|step| {
        let k_p = round_down(libm::exp2(f64::from(step) * 0.5));
        [0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0].map(|damping| (k_p, round_down(2.0 * damping * k_p.sqrt())))
    });
    let all = [(task.gains.k_p, task.gains.k_d)].into_iter().chain(grid);
    all.filter_map(|(k_p, k_d)| task.settled(|level| Some(Gains { k_p, k_d, level, ..task.gains }))).collect()
}

/// Shares of the K_d that \[11] allows, and K_p in its proportion.
fn of_pd_g(task: &Task<'_>) -> Vec<Candidate> {
    let most = task.room * critical_rate(task.period_s, task.delay_s) * task.envelope.lambda_lo();
    let required = task.candidate(task.envelope, task.gains).certificate.c1_required;
    let c1 = task.c1(required);
    let mut found = Vec::new();
    for (stiff, ratio) in (0..8).flat_map(|stiff| (0..14).map(move |ratio| (stiff, ratio))) {
        let k_d = round_down(most * libm::exp2(-0.5 * f64::from(stiff)));
        let k_p = round_down(k_d * libm::exp2(0.5 * f64::from(ratio) - 2.5));
        found.extend(task.settled(|level| Some(Gains { k_p, k_d, level, c1, ..task.gains })));
    }
    found
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
    use crate::bound::stability::sampling_budget;
    use crate::bound::testing::{assume, close, default_start, unit_chain};

    fn task(law: LawKind, envelope: Envelope, start: StartError, delay_s: f64) -> Task<'static> {
        let gains = Gains::of(law);
        Task { law, envelope, gains, start: Some(start), period_s: 1e-3, delay_s, room: 0.9, fits: &|_| true }
    }

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

    #[test]
    fn the_best_gains_prove_a_small_error_and_keep_the_room() {
        let assumptions = assume(&unit_chain::<3>(), 0.0, 0.0);
        let (envelope, start) = (assumptions.envelope(), StartError::of(&assumptions.nominal, &default_start()));
        let found = best(&task(LawKind::Robust, envelope, start, 0.0)).unwrap();
        let used = sampling_budget(&found.certificate, 1e-3, 0.0).unwrap().used;
        assert!(found.certificate.is_certified() && used <= 0.9, "{used}");
        // With all of the room K_t = 202.6, β 17, K3 0.06, C1 29.111 and c = 90 prove 0.030.
        assert!(found.certificate.ultimate_e < 0.036, "{}", found.certificate.ultimate_e);
        let mut last = 0.0;
        for delay_s in [4e-4, 6e-4, 8e-4] {
            let e = best(&task(LawKind::Robust, envelope, start, delay_s)).unwrap().certificate.ultimate_e;
            assert!(e >= last, "a later torque proves a smaller error: {e} {last}");
            last = e;
        }
    }

    #[test]
    fn every_law_has_gains_and_what_does_not_fit_is_passed_over() {
        let assumptions = assume(&unit_chain::<3>(), 0.0, 0.1);
        let (envelope, start) = (assumptions.envelope(), StartError::of(&assumptions.nominal, &default_start()));
        for law in LawKind::ALL {
            let any = task(law, envelope, start, 0.0);
            let first = best(&any).unwrap_or_else(|| panic!("{law}: no gains"));
            let other = |candidate: &Candidate| candidate.gains != first.gains;
            let second = best(&Task { fits: &other, ..any }).unwrap();
            assert!(second.certificate.ultimate_e >= first.certificate.ultimate_e, "{law}");
            assert!(best(&Task { fits: &|_| false, ..any }).is_none(), "{law}");
        }
    }
}
