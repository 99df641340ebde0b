//! Which changes would make a certificate hold.
//!
//! Nothing here is a rule of thumb: every remedy is found by certifying the changed gains or assumptions again, as they
//! are printed, so that applying it makes all requirements hold at once, those of the sampled loop included.

use crate::certificate::Gains;
use crate::certificate::envelope::Envelope;
use crate::certificate::search::{Candidate, Quantity, Task, round, round_up};

use super::design::best;

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
        let covered = Search { c1: Some(round_up(as_it_is.certificate.c1_required())), ..search };
        found.extend((task.rules.axes)(&task.gains).iter().filter_map(|axis| {
            let alone = search.nearest(*axis);
            alone.or_else(|| if *axis == Quantity::C1 { None } else { covered.nearest(*axis) })
        }));
    }
    found.extend(best(task).filter(|best| !found.contains(best)));
    found
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
            as_it_is.certificate.on_r().map_or(0.0, |on_r| on_r.c1)
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
