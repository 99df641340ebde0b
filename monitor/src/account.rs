//! What the answer of `loopbound swap` says of a change of the active controller: its entry in the list of changes, and the
//! latencies around it. The launcher's monitor leaves it in the group's folder, so that the supervisor judges no record.

use std::collections::VecDeque;

use loopbound_shared::event::Decision;
use loopbound_shared::sample::TickRecord;
use serde::{Deserialize, Serialize};

use crate::handover::Handover;
use crate::summary::SwapSummary;
use crate::tracker::segments;

/// Latencies before and after a change are those of so long.
pub const COMPARED_NS: u64 = 100_000_000;
/// The newest changes that are told.
const TOLD_MAX: usize = 16;

/// The newest changes, as far as the records have come.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Account {
    /// The last tick that it rests on.
    pub tick: u64,
    /// In the order in which they happened.
    pub changes: Vec<Change>,
}

/// One change, and what it did to the latencies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Its entry in the list of changes.
    pub entry: SwapSummary,
    /// The latencies around it.
    pub around: Around,
}

/// The latencies around a change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Around {
    /// The tick in which a torque of the new controller first acted; none before that.
    pub first_tick: Option<u64>,
    /// When that torque was accepted, ns of the monotonic clock.
    pub first_accepted_ns: Option<u64>,
    /// Median round trip of the last 100 ms before that tick, ns.
    pub latency_before_ns: Option<u64>,
    /// Median round trip of the first 100 ms from that tick on, ns.
    pub latency_after_ns: Option<u64>,
}

impl Handover for Account {
    const FILE: &str = "changes.json";
}

impl Account {
    /// The change by which controller `id` became the active one in `tick`. A failover may have been faster than the gate:
    /// then the plant only knows that it is active by then. Later ones, there and back, are none of the swap.
    #[must_use]
    pub fn change_to(&self, id: u32, tick: u64) -> Option<&Change> {
        let is_of = |entry: &SwapSummary| entry.to == id && entry.result != "refused" && entry.tick <= tick;
        let mut changes = self.changes.iter().filter(|change| is_of(&change.entry));
        changes.clone().find(|change| change.entry.tick == tick).or_else(|| changes.next())
    }
}

/// Follows the changes of a run, record by record.
#[derive(Debug)]
pub(crate) struct Accountant {
    compared_ticks: u64,
    /// A change is told for so long after it, or after its cross-fade.
    told_ticks: u64,
    /// Round trips of the last while.
    rows: VecDeque<(u64, Option<u64>)>,
    /// One for each entry of the list of changes.
    around: Vec<Around>,
    told_until: u64,
    told: u64,
}

impl Accountant {
    /// Nothing has happened yet. The plant may roll a swap back for `rollback_ns`.
    pub(crate) fn new(period_ns: u64, rollback_ns: u64) -> Self {
        let period_ns = period_ns.max(1);
        let compared_ticks = (COMPARED_NS / period_ns).max(1);
        Self {
            compared_ticks,
            told_ticks: rollback_ns.div_ceil(period_ns) + 2 * compared_ticks,
            rows: VecDeque::new(),
            around: Vec::new(),
            told_until: 0,
            told: 0,
        }
    }

    /// Takes the next record, after the list of changes has.
    pub(crate) fn feed(&mut self, record: &TickRecord, round_trip_ns: Option<u64>, list: &[SwapSummary]) {
        let tick = record.tick;
        self.rows.push_back((tick, round_trip_ns));
        while self.rows.front().is_some_and(|(old, _)| old + 3 * self.compared_ticks < tick) {
            self.rows.pop_front();
        }
        if list.len() > self.around.len() || record.decision == Decision::Blend.code() {
            self.told_until = tick + self.told_ticks;
        }
        self.around.resize(list.len(), Around::default());
        for (around, entry) in self.around.iter_mut().zip(list).rev().take(TOLD_MAX) {
            let acts = segments(record).iter().any(|of| of.writer == entry.to && of.answered_tick >= entry.tick);
            if around.first_tick.is_none() && acts && entry.result != "refused" {
                (around.first_tick, around.first_accepted_ns) = (Some(tick), Some(record.accepted_ns));
            }
        }
    }

    /// The account as far as it goes; none if nobody can want a new one.
    pub(crate) fn due(&mut self, tick: Option<u64>, list: &[SwapSummary]) -> Option<Account> {
        let tick = tick.filter(|tick| *tick > self.told && self.told < self.told_until)?;
        self.told = tick;
        let compared = self.compared_ticks;
        let rows = &self.rows;
        let median_of = |from: u64, to: u64| {
            median(rows.iter().filter(|(tick, _)| (from..to).contains(tick)).filter_map(|(_, ns)| *ns).collect())
        };
        for around in self.around.iter_mut().rev().take(TOLD_MAX) {
            // Later the rows before it are gone.
            if let Some(first) = around.first_tick.filter(|first| tick < first + 2 * compared) {
                around.latency_before_ns = median_of(first.saturating_sub(compared), first);
                around.latency_after_ns = median_of(first, first + compared);
            }
        }
        let from = list.len().saturating_sub(TOLD_MAX);
        let pairs = list.iter().cloned().zip(self.around.iter().copied()).skip(from);
        Some(Account { tick, changes: pairs.map(|(entry, around)| Change { entry, around }).collect() })
    }
}

fn median(mut values: Vec<u64>) -> Option<u64> {
    values.sort_unstable();
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(tick: u64, to: u32, result: &str) -> SwapSummary {
        SwapSummary { tick, to, result: result.to_owned(), ..SwapSummary::default() }
    }

    #[test]
    fn the_account_of_a_swap_is_of_the_change_that_it_made_or_of_the_failover_before_it() {
        let list = [entry(5, 2, "refused"), entry(7, 2, "done"), entry(9, 1, "done"), entry(11, 2, "done")];
        let changes = list.map(|entry| Change { entry, ..Change::default() }).to_vec();
        let account = Account { tick: 12, changes };
        let tick_of = |id, tick| account.change_to(id, tick).map(|change| change.entry.tick);
        assert_eq!(tick_of(2, 7), Some(7), "not that of the failovers after it");
        assert_eq!(tick_of(2, 11), Some(11));
        assert_eq!(tick_of(2, 10), Some(7), "the plant was asked three ticks after the failover");
        assert_eq!((tick_of(2, 5), tick_of(3, 20)), (None, None));
    }

    #[test]
    fn the_median_of_nothing_is_nothing() {
        assert_eq!((median(vec![]), median(vec![3, 1, 2])), (None, Some(2)));
    }

    #[test]
    fn latencies_are_those_before_and_after_the_first_torque_of_the_new_controller_and_are_told_until_it_is_settled() {
        let mut accountant = Accountant::new(1_000_000, 200_000_000);
        let list = [entry(500, 2, "done")];
        let mut last = None;
        for tick in 0..2_000 {
            let mut record = TickRecord { tick, accepted_ns: tick * 10, segments_used: 1, ..TickRecord::zeroed() };
            // The new one has a torque two ticks after it was given authority.
            let writer = if tick < 502 { 1 } else { 2 };
            (record.segments[0].writer, record.segments[0].answered_tick) = (writer, tick);
            let known = if tick < 500 { &list[..0] } else { &list[..] };
            accountant.feed(&record, Some(if tick < 502 { 30 } else { 20 }), known);
            if let Some(account) = accountant.due(Some(tick), known) {
                assert!(tick >= 500, "nothing has changed yet");
                last = Some(account);
            }
        }
        let account = last.unwrap();
        assert_eq!(account.tick, 900, "as long as it may be rolled back, and for both latencies");
        let around = Around {
            first_tick: Some(502),
            first_accepted_ns: Some(5_020),
            latency_before_ns: Some(30),
            latency_after_ns: Some(20),
        };
        assert_eq!(account.change_to(2, 500), Some(&Change { entry: list[0].clone(), around }));
    }
}
