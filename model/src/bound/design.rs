//! Gains for a loop: certified, within a share of the room that sampling leaves, and as they would be written down.
//!
//! Merit is the proven bound of |e|: ‖W‖ adds rad² to rad²/s², and where it is smallest depends on the unit of time.

use crate::certificate::Gains;
use crate::certificate::search::{Candidate, Task};

/// Candidates that are asked whether they fit, the best first.
const TRIES: usize = 60;

/// The gains with the smallest proven |e| on a fixed grid; of equal ones (an exact model proves 0) the nearest to those
/// of the task. None if no gains of the grid suit.
#[must_use]
pub fn best(task: &Task<'_>) -> Option<Candidate> {
    let mut found = (task.rules.grid)(task);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::certificate::envelope::Envelope;
    use crate::certificate::sampling::sampling_budget;
    use crate::certificate::start::StartError;
    use crate::law::LawKind;
    use crate::testing::{assume, default_start, unit_chain};

    fn task(law: LawKind, envelope: Envelope, start: StartError, delay_s: f64) -> Task<'static> {
        let gains = Gains::of(law);
        Task {
            rules: law.rules(),
            envelope,
            gains,
            start: Some(start),
            period_s: 1e-3,
            delay_s,
            room: 0.9,
            fits: &|_| true,
        }
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
