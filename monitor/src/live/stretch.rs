//! How many ticks are shown: a thousand a second, and those that matter.
//!
//! Up to 1 kHz every tick is shown. Above, the ticks are cut into stretches of a millisecond, and of each stretch the
//! one with the largest latency from deadline to torque is shown, a missed one before all: a plot keeps its peaks, and
//! each message is a tick as it was, no mean. In lockstep a stretch also lasts a millisecond on the wall's clock, since
//! virtual time may pass a hundred times as fast.

use loopbound_shared::sample::TickRecord;

use crate::hops::Hop;
use crate::tracker::{Row, accepted};

/// Length of a stretch, ns.
pub(super) const STRETCH_NS: u64 = 1_000_000;

/// The choice of ticks.
#[derive(Debug)]
pub(super) struct Stretches {
    ticks: u64,
    /// Lockstep: the wall's time from which on a stretch may end, ns.
    due_ns: Option<u64>,
    held: Option<Box<Held>>,
}

#[derive(Clone, Debug)]
struct Held {
    stretch: u64,
    /// Deadline → torque, ns; the largest number of all where there was none.
    lateness_ns: u64,
    record: TickRecord,
    row: Row,
}

impl Stretches {
    pub(super) fn new(period_ns: u64, lockstep: bool) -> Self {
        // Half a stretch more: a period that was rounded to nanoseconds must not leave a tick out now and then.
        let ticks = ((STRETCH_NS + period_ns / 2) / period_ns.max(1)).max(1);
        Self { ticks, due_ns: lockstep.then_some(0), held: None }
    }

    /// Ticks of which one is shown, at least.
    pub(super) fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Takes a tick, and calls `show` with one that is due.
    pub(super) fn take(&mut self, record: &TickRecord, row: &Row, now_ns: u64, show: impl FnOnce(&TickRecord, &Row)) {
        if self.ticks == 1 && self.due_ns.is_none() {
            return show(record, row);
        }
        let stretch = record.tick / self.ticks;
        let lateness_ns = lateness_ns(record);
        let Some(held) = &mut self.held else {
            self.held = Some(Box::new(Held { stretch, lateness_ns, record: *record, row: *row }));
            return;
        };
        let over = held.stretch != stretch && self.due_ns.is_none_or(|due_ns| now_ns >= due_ns);
        if over {
            self.due_ns = self.due_ns.map(|_| now_ns + STRETCH_NS);
            show(&held.record, &held.row);
        }
        // Of two that are alike the newer one is shown.
        if over || lateness_ns >= held.lateness_ns {
            **held = Held { stretch, lateness_ns, record: *record, row: *row };
        }
    }

    /// The tick that was held back at the end.
    pub(super) fn finish(&mut self, show: impl FnOnce(&TickRecord, &Row)) {
        if let Some(held) = self.held.take() {
            show(&held.record, &held.row);
        }
    }
}

fn lateness_ns(record: &TickRecord) -> u64 {
    let stamps = Hop::DeadlineToTorque.stamps(record, accepted(record));
    stamps.and_then(|(from_ns, to_ns)| to_ns.checked_sub(from_ns)).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{good, tracker, unanswered};

    /// The ticks that are shown of records that come in at `now_ns`.
    fn shown(mut stretches: Stretches, records: &[(TickRecord, u64)]) -> Vec<u64> {
        let mut tracker = tracker();
        let mut shown = Vec::new();
        for (record, now_ns) in records {
            let row = tracker.feed(record).unwrap();
            stretches.take(record, &row, *now_ns, |record, row| {
                assert_eq!(record.tick, row.tick, "a row stays with its record");
                shown.push(record.tick);
            });
        }
        stretches.finish(|record, _| shown.push(record.tick));
        shown
    }

    #[test]
    fn every_tick_is_shown_up_to_a_thousand_a_second() {
        let records: Vec<_> = (0..50).map(|tick| (good(tick), 0)).collect();
        assert_eq!(shown(Stretches::new(1_000_000, false), &records), (0..50).collect::<Vec<_>>());
        assert_eq!(Stretches::new(999_999, false).ticks(), 1);
    }

    #[test]
    fn of_each_millisecond_the_latest_torque_is_shown_and_a_missed_tick_before_all() {
        let mut records: Vec<_> = (0..40).map(|tick| (good(tick), 0)).collect();
        records[13].0.accepted_ns += 300_000;
        records[16].0.accepted_ns += 200_000;
        records[24].0.accepted_ns += 400_000;
        records[27].0 = unanswered(27);
        assert_eq!(shown(Stretches::new(100_000, false), &records), [9, 13, 27, 39]);
    }

    #[test]
    fn virtual_time_is_shown_a_thousand_times_a_second_of_the_wall_however_fast_it_passes() {
        // 20 ticks in each of 5 ms: a hundred ticks, at most one shown a millisecond, and the last one.
        let mut records: Vec<_> = (0..100).map(|tick| (good(tick), 1_000_000 * (tick / 20))).collect();
        records[33].0.accepted_ns += 200_000;
        let shown = shown(Stretches::new(1_000_000, true), &records);
        assert_eq!(shown, [0, 19, 33, 59, 79, 99]);
    }
}
