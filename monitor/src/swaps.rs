//! The list of changes of the controller in charge: what each cost in ticks, torque and V. The only account of them: the
//! report, `summary.json` and the answer of `loopbound swap` say what stands here.

use loopbound_scenario::controllers::Scheduled;
use loopbound_shared::event::{Decision, HappeningKind, Refusal};
use loopbound_shared::sample::{Happening, Segment, TickRecord};

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
    /// The torque that acted last in the record before.
    acting: Option<Segment>,
    /// The last change has not acted yet.
    awaits_torque: bool,
    /// Swaps of the scenario that have not come up yet.
    scheduled: Vec<Scheduled>,
    /// How long after a swap the plant may roll it back.
    rollback_ticks: u64,
}

impl Swaps {
    /// No change yet; the scenario has `scheduled` these, and a swap may be rolled back for so many ticks.
    #[must_use]
    pub fn new(scheduled: Vec<Scheduled>, rollback_ticks: u64) -> Self {
        Self { scheduled, rollback_ticks, ..Self::default() }
    }

    /// Takes the next record; `missed` ticks were missed with it, and V at its start is `v`.
    pub fn feed(&mut self, record: &TickRecord, period_ns: u64, missed: u64, v: Option<f64>) {
        if let (Some(before), Some(swap)) = (self.v_at_change.take(), self.list.last_mut()) {
            swap.delta_v = v.and_then(|v| finite(v - before));
        }
        for happening in happenings(record) {
            self.note(record, happening, v);
        }
        self.note_torques(record);
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
                self.push(record, "swap", from, happening.subject, v);
                self.edit_last(|swap| swap.torque_difference_nm = finite(happening.value));
            }
            Some(HappeningKind::Failover) => {
                let (last, this) = (self.last_failover, (record.tick, from, happening.subject));
                self.last_failover = Some(this);
                // Until authority has moved, the standby steps in at every tick: that is one failover.
                let goes_on = last
                    .is_some_and(|(tick, a, b)| record.tick.saturating_sub(tick) <= 1 && (a, b) == (this.1, this.2));
                if !goes_on {
                    self.fail_over(record.tick, from);
                    self.push(record, "failover", from, happening.subject, v);
                }
            }
            Some(HappeningKind::Rollback) => {
                self.roll_back(refusal(happening.detail));
            }
            Some(HappeningKind::SwapRefused) => {
                self.push(record, "swap", record.active, happening.subject, None);
                self.awaits_torque = false;
                let is_step = u64::from(Refusal::TorqueStep.code()) == happening.detail;
                self.edit_last(|swap| {
                    swap.result = "refused".to_owned();
                    swap.reason = Some(refusal(happening.detail).to_owned());
                    swap.value = finite(happening.value);
                    swap.torque_step_nm = swap.value.filter(|_| is_step);
                });
            }
            _ => {}
        }
    }

    /// The last swap that was carried out is rolled back.
    fn roll_back(&mut self, reason: &str) {
        if let Some(swap) = self.list.iter_mut().rev().find(|swap| swap.kind == "swap" && swap.result == "done") {
            swap.result = "rolled back".to_owned();
            swap.reason = Some(reason.to_owned());
        }
    }

    /// Controller `from` loses authority: a swap to it that the plant still watches counts as rolled back.
    fn fail_over(&mut self, tick: u64, from: u32) {
        let last = self.list.last().filter(|last| last.kind == "swap" && last.result == "done" && last.to == from);
        if last.is_some_and(|last| tick < last.tick.saturating_add(self.rollback_ticks)) {
            self.roll_back(Refusal::Deadlines.name());
        }
    }

    /// Whether a swap to `to` is one of the scenario's, which come up once each.
    fn take_scheduled(&mut self, tick: u64, to: u32) -> bool {
        let at = self.scheduled.iter().position(|of| of.to == to && of.tick <= tick);
        at.map(|at| self.scheduled.remove(at)).is_some()
    }

    /// The step of each joint from the torque that acted before to the first one of the new controller, and the cross-fade.
    fn note_torques(&mut self, record: &TickRecord) {
        let used = segments(record);
        let mut before = self.acting;
        if let Some(swap) = self.list.last_mut().filter(|_| self.awaits_torque) {
            for segment in used {
                // A standby may have stood in before it took over: its torque of then is none of the change.
                let is_first = segment.writer == swap.to && segment.answered_tick >= swap.tick;
                if let (true, Some(before)) = (is_first, before) {
                    let links = usize::try_from(record.links).unwrap_or(0).min(segment.tau.len());
                    let steps = segment.tau.iter().zip(before.tau).take(links).map(|(after, before)| after - before);
                    swap.torque_steps_nm = steps.collect();
                    let largest = swap.torque_steps_nm.iter().map(|step| step.abs()).reduce(f64::max);
                    swap.torque_step_nm = largest.and_then(finite);
                }
                if is_first {
                    self.awaits_torque = false;
                    break;
                }
                before = Some(*segment);
            }
        }
        if record.decision == Decision::Blend.code() {
            self.edit_last(|swap| swap.blended_ticks += 1);
        }
        self.acting = used.last().copied().or(self.acting);
    }

    /// Changes the entry that was made last; with a full list there is none.
    fn edit_last(&mut self, edit: impl FnOnce(&mut SwapSummary)) {
        if let Some(swap) = self.list.last_mut().filter(|_| self.not_listed == 0) {
            edit(swap);
        }
    }

    fn push(&mut self, record: &TickRecord, kind: &str, from: u32, to: u32, v: Option<f64>) {
        if self.list.len() >= LISTED_MAX {
            self.not_listed += 1;
            return;
        }
        let scheduled = kind == "swap" && self.take_scheduled(record.tick, to);
        self.v_at_change = v;
        self.awaits_torque = true;
        self.list.push(SwapSummary {
            tick: record.tick,
            from,
            to,
            kind: kind.to_owned(),
            scheduled,
            result: "done".to_owned(),
            ..SwapSummary::default()
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
