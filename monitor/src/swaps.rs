//! The list of changes of the controller in charge: what each cost in ticks, torque and V.

use loopbound_shared::event::HappeningKind;
use loopbound_shared::sample::{Happening, TickRecord};

use crate::event::refusal;
use crate::summary::{SwapSummary, finite};
use crate::tracker::{happenings, segments};

/// Missed ticks count against a change for this long.
const WATCHED_NS: u64 = 50_000_000;
/// Changes that the list holds.
const LISTED_MAX: usize = 1024;

/// Changes of the controller in charge.
#[derive(Debug, Default)]
pub struct Swaps {
    list: Vec<SwapSummary>,
    not_listed: u64,
    last_failover: Option<(u64, u32, u32)>,
    v_at_change: Option<f64>,
}

impl Swaps {
    /// Takes the next record; `missed` ticks were missed with it, and V at its start is `v`.
    pub fn feed(&mut self, record: &TickRecord, period_ns: u64, missed: u64, v: Option<f64>) {
        if let (Some(before), Some(swap)) = (self.v_at_change.take(), self.list.last_mut()) {
            swap.delta_v = v.and_then(|v| finite(v - before));
        }
        for happening in happenings(record) {
            self.note(record, happening, v);
        }
        let watched_ticks = WATCHED_NS / period_ns.max(1);
        for swap in self.list.iter_mut().rev().take_while(|swap| record.tick.saturating_sub(swap.tick) <= watched_ticks)
        {
            if swap.result != "refused" {
                swap.missed_ticks = swap.missed_ticks.saturating_add(missed);
            }
        }
    }

    fn note(&mut self, record: &TickRecord, happening: &Happening, v: Option<f64>) {
        let from = u32::try_from(happening.detail).unwrap_or(0);
        match HappeningKind::from_code(happening.kind) {
            Some(HappeningKind::Swap) => {
                self.push(record, "swap", from, happening.subject, finite(happening.value), v);
            }
            Some(HappeningKind::Failover) => {
                let (last, this) = (self.last_failover, (record.tick, from, happening.subject));
                self.last_failover = Some(this);
                // Until authority has moved, the standby steps in at every tick: that is one failover.
                let goes_on = last
                    .is_some_and(|(tick, a, b)| record.tick.saturating_sub(tick) <= 1 && (a, b) == (this.1, this.2));
                if !goes_on {
                    self.push(record, "failover", from, happening.subject, step(record), v);
                }
            }
            Some(HappeningKind::Rollback) => {
                if let Some(swap) = self.list.iter_mut().rev().find(|swap| swap.kind == "swap") {
                    swap.result = "rolled back".to_owned();
                    swap.reason = Some(refusal(happening.detail).to_owned());
                }
            }
            Some(HappeningKind::SwapRefused) => {
                self.push(record, "swap", record.active, happening.subject, finite(happening.value), None);
                if let Some(swap) = self.list.last_mut() {
                    swap.result = "refused".to_owned();
                    swap.reason = Some(refusal(happening.detail).to_owned());
                }
            }
            _ => {}
        }
    }

    fn push(&mut self, record: &TickRecord, kind: &str, from: u32, to: u32, step_nm: Option<f64>, v: Option<f64>) {
        if self.list.len() >= LISTED_MAX {
            self.not_listed += 1;
            return;
        }
        self.v_at_change = v;
        self.list.push(SwapSummary {
            tick: record.tick,
            from,
            to,
            kind: kind.to_owned(),
            missed_ticks: 0,
            torque_step_nm: step_nm,
            delta_v: None,
            result: "done".to_owned(),
            reason: None,
        });
    }

    /// The changes in order.
    #[must_use]
    pub fn list(&self) -> &[SwapSummary] {
        &self.list
    }

    /// Changes beyond what the list holds.
    #[must_use]
    pub fn not_listed(&self) -> u64 {
        self.not_listed
    }
}

/// The largest step of one torque between neighbouring segments of a tick, N·m.
fn step(record: &TickRecord) -> Option<f64> {
    let steps = segments(record).windows(2).map(|pair| {
        let difference = pair[0].tau.iter().zip(&pair[1].tau).map(|(before, after)| (after - before).abs());
        difference.fold(0.0, f64::max)
    });
    steps.reduce(f64::max).and_then(finite)
}
