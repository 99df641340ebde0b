//! Late and missed ticks on their way to a cause.
//!
//! A controller's evidence travels with its *next* torque: what the kernel did to it while it was late is known one
//! answer later. So a case against a controller waits for that answer, at most [`Config::finalise_ns`] of ticks; one
//! against the plant is decided at once.
//!
//! A controller that the scenario's own faults silence can't say so: nothing came that could carry the word. Which ticks those are is
//! asked of the scenario ([`Planned`]).
//!
//! A tick that breaks the bound under the plant's own fallback has the cause of the last missed tick: its torque is the one
//! that did not come.

mod planned;

pub use planned::Planned;

use loopbound_shared::event::{Acceptance, Decision, HappeningKind};
use loopbound_shared::realtime::Evidence;
use loopbound_shared::sample::{RECEIPTS_MAX, Receipt, TickRecord, record_flag, torque_flag};

use crate::cause::{Cause, CauseCounts, Clues, Part, attribute};
use crate::event::{EventKind, EventLog};
use crate::tracker::{Config, accepted, happenings, receipts};

/// Controllers whose last answer is remembered.
const WRITERS_MAX: usize = 2 * RECEIPTS_MAX;
/// Cases that wait for a controller's next answer.
const WAITING_MAX: usize = 512;
/// Controllers that have gone, as far as is remembered.
const GONE_MAX: usize = 64;

/// The last answer of one controller, with its evidence.
#[derive(Clone, Copy, Debug)]
struct LastAnswer {
    writer: u32,
    tick: u64,
    evidence: Evidence,
}

#[derive(Clone, Copy, Debug)]
struct Case {
    tick: u64,
    plant_ns: u64,
    /// Counts as late (after start-up).
    late: bool,
    /// Counts as missed so many times.
    missed: u64,
    /// Ticks that broke the bound since no torque came in this one.
    fallback: u64,
    decision: Option<u32>,
    deadline_to_torque_ns: u64,
    writer: u32,
    /// Since which tick the plant has been running and asking.
    asked_since: u64,
    answered_before: Option<LastAnswer>,
    /// The controller says in its answer to this tick that it was mapping.
    mapped: bool,
    /// The first answer after a silence, by its tick: what is asked for its evidence is the answer after that.
    silent_until: Option<u64>,
    clues: Clues,
}

/// Whether setpoints are there, and if not whether the plant was running when they ran out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Setpoints {
    Fresh,
    RanOut,
    RanOutWhileThePlantStood,
}

/// Finds the causes of late and missed ticks.
#[derive(Debug)]
pub struct Causes {
    waiting: Vec<Case>,
    answers: Vec<LastAnswer>,
    /// The plant's evidence in the tick before and in the one before that, with their instants.
    plant_before: [Option<(Evidence, u64)>; 2],
    active_before: u32,
    joined_before: Option<u64>,
    /// A fault of the plant's own kept it busy beyond the end of the tick before.
    overslept_by_fault: bool,
    /// The tick with which the plant went on after it had skipped some.
    resumed: u64,
    setpoints: Setpoints,
    planned: Planned,
    /// Controllers that were removed from the group. Numbers are never given twice.
    gone: Vec<u32>,
    /// The last missed tick, and its cause once that is known.
    last_missed: Option<(u64, Option<Cause>)>,
    /// Late ticks by cause.
    pub late: CauseCounts,
    /// Missed ticks by cause.
    pub missed: CauseCounts,
    /// Ticks that broke the bound under the plant's own fallback, by cause.
    fallback: CauseCounts,
}

impl Default for Causes {
    fn default() -> Self {
        Self {
            waiting: Vec::with_capacity(WAITING_MAX),
            answers: Vec::with_capacity(WRITERS_MAX),
            plant_before: [None; 2],
            active_before: 0,
            joined_before: None,
            overslept_by_fault: false,
            resumed: 0,
            setpoints: Setpoints::Fresh,
            planned: Planned::default(),
            gone: Vec::with_capacity(GONE_MAX),
            last_missed: None,
            late: CauseCounts::default(),
            missed: CauseCounts::default(),
            fallback: CauseCounts::default(),
        }
    }
}

impl Causes {
    /// Causes of a run in which these faults are planned.
    #[must_use]
    pub fn new(planned: Planned) -> Self {
        Self { planned, ..Self::default() }
    }

    /// Takes the next record. `settled`: past the start-up. Returns how many ticks were missed with it.
    pub fn feed(&mut self, config: &Config, record: &TickRecord, settled: bool, events: &mut EventLog) -> u64 {
        self.note_gone(config, record, events);
        self.decide_answered(config, record, events);
        self.note_setpoints(record);
        let writers = receipts(record).iter().map(|receipt| receipt.writer);
        self.planned.advance(
            record.tick,
            record.skipped_before,
            [record.active, self.active_before].into_iter().chain(writers),
        );
        let at_rest = record.flags & record_flag::AT_REST != 0;
        let mut missed = 0;
        if !at_rest {
            let clues = self.plant_clues(config, record);
            if record.skipped_before > 0 {
                missed = record.skipped_before;
                self.resumed = record.tick;
                self.open_skipped(config, record, clues, events);
            }
            let is_missed = is_missed(record);
            missed = missed.saturating_add(u64::from(is_missed));
            let deadline_to_torque_ns =
                accepted(record).map_or(0, |_| record.accepted_ns.saturating_sub(record.deadline_ns));
            let late = settled && deadline_to_torque_ns > config.late_ns;
            if late || is_missed {
                self.open(config, record, clues, late, is_missed, deadline_to_torque_ns, events);
            }
        }
        self.remember(config, record);
        missed
    }

    /// Decides whatever still waits: nothing more will come.
    pub fn finish(&mut self, config: &Config, last_tick: u64, events: &mut EventLog) {
        while let Some(case) = self.waiting.pop() {
            self.decide(config, case, None, last_tick, events);
        }
    }

    fn plant_clues(&self, config: &Config, record: &TickRecord) -> Clues {
        // Without sleep before the tick it was late already: what kept it lies before the last reading.
        let since = if record.wake_late_ns == u64::MAX { self.plant_before[1] } else { self.plant_before[0] };
        let (evidence, span_ns) = since.or(self.plant_before[0]).map_or((Evidence::default(), 0), |(before, at_ns)| {
            (record.evidence.since(&before), record.sampled_ns.saturating_sub(at_ns))
        });
        Clues {
            part: Part::PlantWakeup,
            lost_ns: 0,
            evidence,
            evidence_span_ns: span_ns,
            spin_gap_ns: record.spin_gap_ns,
            injected: record.flags & record_flag::FAULT_INJECTED != 0,
            joined: joined(record).or(self.joined_before),
            silence_ns: 0,
            two_ticks_ns: config.period_ns.saturating_mul(2),
            removed: false,
            setpoint_stale: self.setpoints == Setpoints::RanOut,
            stale_injected: false,
        }
    }

    fn open_skipped(&mut self, config: &Config, record: &TickRecord, clues: Clues, events: &mut EventLog) {
        let lost_ns = record.skipped_before.saturating_mul(config.period_ns);
        let first = record.tick.saturating_sub(record.skipped_before);
        let case = Case {
            tick: first,
            plant_ns: record.start_plant_ns,
            late: false,
            missed: record.skipped_before,
            fallback: 0,
            decision: None,
            deadline_to_torque_ns: 0,
            writer: 0,
            asked_since: first,
            answered_before: None,
            mapped: false,
            silent_until: None,
            clues: Clues { lost_ns, injected: self.overslept_by_fault, ..clues },
        };
        // The plant stood in the tick before them already. A controller that did not answer in it may have stood as well, and
        // nobody looked.
        while let Some(at) = self
            .waiting
            .iter()
            .position(|waiting| waiting.tick.saturating_add(1) == first && waiting.clues.part == Part::NoAnswer)
        {
            let before = self.waiting.remove(at);
            self.decide(config, Case { clues: Clues { lost_ns, ..case.clues }, ..before }, None, record.tick, events);
        }
        self.decide(config, case, None, record.tick, events);
    }

    #[expect(clippy::too_many_arguments, reason = "one call; all of them describe the one case")]
    fn open(
        &mut self,
        config: &Config,
        record: &TickRecord,
        mut clues: Clues,
        late: bool,
        missed: bool,
        deadline_to_torque_ns: u64,
        events: &mut EventLog,
    ) {
        let blamed = if self.active_before == 0 { record.active } else { self.active_before };
        let blamed_receipt = receipts(record).iter().find(|receipt| receipt.writer == blamed);
        (clues.part, clues.lost_ns) = part_of(config, record, blamed);
        if clues.part.is_plants() {
            clues.injected |= self.overslept_by_fault;
        } else {
            clues.injected |= self.planned.silences(blamed);
            clues.stale_injected = self.planned.withholds_setpoint();
            let answers = [blamed_receipt, accepted(record)];
            let flags = answers.into_iter().flatten().fold(0, |flags, receipt| flags | receipt.flags);
            clues.injected |= flags & INJECTED != 0;
            clues.setpoint_stale |= self.setpoints == Setpoints::Fresh && flags & torque_flag::SETPOINT_STALE != 0;
        }
        clues.removed = self.gone.contains(&blamed);
        let case = Case {
            tick: record.tick,
            plant_ns: record.start_plant_ns,
            late,
            missed: u64::from(missed),
            fallback: 0,
            decision: Some(record.decision),
            deadline_to_torque_ns,
            writer: blamed,
            asked_since: self.resumed,
            answered_before: self.answers.iter().find(|answer| answer.writer == blamed).copied(),
            mapped: blamed_receipt.is_some_and(|receipt| receipt.flags & torque_flag::MAPPED != 0),
            silent_until: None,
            clues,
        };
        if missed {
            self.last_missed = Some((record.tick, None));
        }
        let at_once = clues.part.is_plants() || clues.part == Part::Unknown || clues.injected || clues.removed;
        if at_once || self.waiting.len() == WAITING_MAX {
            self.decide(config, case, None, record.tick, events);
        } else {
            self.waiting.push(case);
        }
    }

    /// Decides the cases whose controller has answered since, and those that have waited for long enough.
    fn decide_answered(&mut self, config: &Config, record: &TickRecord, events: &mut EventLog) {
        let mut at = 0;
        while at < self.waiting.len() {
            let case = self.waiting[at];
            let answer = receipts(record).iter().find(|receipt| receipt.writer == case.writer && has_come(receipt));
            let waited_ns = record.tick.saturating_sub(case.tick).saturating_mul(config.period_ns);
            // A controller reads its evidence in the slack after an answer, and gives it with the next: the answer that ends a
            // silence was prepared before it.
            if let (Part::NoAnswer, None, Some(answer)) = (case.clues.part, case.silent_until, answer) {
                let case = &mut self.waiting[at];
                case.silent_until = Some(record.tick);
                case.mapped |= answer.flags & torque_flag::MAPPED != 0;
                // The answer that did not come in its tick has come now.
                case.clues.injected |= answer.flags & torque_flag::CAME_LATE_INJECTED != 0;
                at += 1;
            } else if answer.is_some() || waited_ns > config.finalise_ns {
                self.waiting.remove(at);
                self.decide(config, case, answer, record.tick, events);
            } else {
                at += 1;
            }
        }
    }

    fn decide(&mut self, config: &Config, case: Case, answer: Option<&Receipt>, now_tick: u64, events: &mut EventLog) {
        let mut clues = case.clues;
        if !clues.part.is_plants() {
            // Until its answer comes, nothing is known of what the kernel did to the controller.
            clues.evidence = match (answer, case.answered_before) {
                (Some(answer), Some(before)) => evidence_of(answer).since(&before.evidence),
                _ => Evidence::default(),
            };
            if case.mapped {
                clues.joined = Some(clues.lost_ns);
            }
            let from_tick = case.answered_before.map_or(case.tick, |before| before.tick.saturating_add(1));
            let from_tick = from_tick.max(case.asked_since);
            clues.silence_ns =
                case.silent_until.unwrap_or(now_tick).saturating_sub(from_tick).saturating_mul(config.period_ns);
        }
        let why = attribute(&clues);
        self.fallback.add(why.cause, case.fallback);
        if let Some((tick, cause)) = &mut self.last_missed
            && *tick == case.tick
        {
            *cause = Some(why.cause);
        }
        if case.late {
            self.late.add(why.cause, 1);
            let deadline_to_torque_ns = case.deadline_to_torque_ns;
            events.push(case.tick, case.plant_ns, EventKind::Late { deadline_to_torque_ns, why });
        }
        if case.missed > 0 {
            self.missed.add(why.cause, case.missed);
            let kind = EventKind::Missed { ticks: case.missed, decision: case.decision, why };
            events.push(case.tick, case.plant_ns, kind);
        }
    }

    /// Decides the cases of whoever has ended: no answer will come.
    fn note_gone(&mut self, config: &Config, record: &TickRecord, events: &mut EventLog) {
        let removed = happenings(record).iter().filter(|h| h.kind == HappeningKind::MemberRemoved.code());
        for id in removed.map(|happening| happening.subject) {
            if self.gone.len() == GONE_MAX {
                self.gone.remove(0);
            }
            self.gone.push(id);
            while let Some(at) = self.waiting.iter().position(|case| case.writer == id) {
                let mut case = self.waiting.remove(at);
                // One that has answered since was only late in this tick.
                case.clues.removed = case.silent_until.is_none();
                self.decide(config, case, None, record.tick, events);
            }
        }
    }

    fn note_setpoints(&mut self, record: &TickRecord) {
        let stale = record.flags & record_flag::SETPOINT_STALE != 0;
        self.setpoints = match (stale, self.setpoints) {
            (false, _) => Setpoints::Fresh,
            (true, Setpoints::Fresh) if record.skipped_before > 0 => Setpoints::RanOutWhileThePlantStood,
            (true, Setpoints::Fresh) => Setpoints::RanOut,
            (true, since) => since,
        };
    }

    fn remember(&mut self, config: &Config, record: &TickRecord) {
        let end_ns = record.deadline_ns.saturating_add(config.period_ns);
        self.overslept_by_fault = record.flags & record_flag::FAULT_INJECTED != 0 && record.published_ns >= end_ns;
        self.plant_before = [Some((record.evidence, record.sampled_ns)), self.plant_before[0]];
        self.active_before = record.active;
        self.joined_before = joined(record);
        for receipt in receipts(record).iter().filter(|receipt| has_come(receipt)) {
            let last = LastAnswer { writer: receipt.writer, tick: record.tick, evidence: evidence_of(receipt) };
            let known = self.answers.iter().position(|answer| answer.writer == receipt.writer);
            if known.is_none() && self.answers.len() < WRITERS_MAX {
                self.answers.push(last);
                continue;
            }
            // A group that has seen more controllers than fit forgets the one that has been silent for longest.
            let oldest = || (0..self.answers.len()).min_by_key(|&at| self.answers[at].tick);
            if let Some(place) = known.or_else(oldest) {
                self.answers[place] = last;
            }
        }
    }

    /// The tick that was fed last broke the bound under the plant's own fallback.
    pub fn note_fallback(&mut self) {
        match self.last_missed {
            Some((_, Some(cause))) => self.fallback.add(cause, 1),
            Some((tick, None)) => {
                if let Some(case) = self.waiting.iter_mut().rev().find(|case| case.tick == tick) {
                    case.fallback += 1;
                }
            }
            None => {}
        }
    }

    /// Ticks that broke the bound under the plant's own fallback by what kept the torque from coming; those without a missed
    /// tick that this monitor saw are unknown.
    #[must_use]
    pub fn fallback_of(&self, total: u64) -> CauseCounts {
        let mut counts = self.fallback;
        counts.add(Cause::Unknown, total.saturating_sub(counts.total()));
        counts
    }

    /// Missed ticks by cause, with those that the plant counted and this monitor did not see under a word of their own.
    #[must_use]
    pub fn missed_of(&self, total: u64) -> CauseCounts {
        let mut counts = self.missed;
        counts.add(Cause::NotSeen, total.saturating_sub(counts.total()));
        counts
    }
}

/// What of a receipt says that a fault was injected.
const INJECTED: u32 = torque_flag::FAULT_INJECTED | torque_flag::WITHHELD | torque_flag::CAME_LATE_INJECTED;

/// Whether a tick had no accepted torque by its grace deadline.
fn is_missed(record: &TickRecord) -> bool {
    // A plant that has stopped for good obeys no torque; that is not the fault of one that answered in time.
    let in_time = |receipt: &Receipt| receipt.acceptance != Acceptance::Late.code();
    if record.flags & record_flag::DIVERGED != 0 && accepted(record).is_some_and(in_time) {
        return false;
    }
    match Decision::from_code(record.decision) {
        Some(Decision::Active | Decision::Standby | Decision::Blend | Decision::Rest) => false,
        Some(Decision::ActiveLate | Decision::Held | Decision::Damped | Decision::Stopped) | None => true,
    }
}

fn has_come(receipt: &Receipt) -> bool {
    receipt.arrived_ns != 0 && receipt.acceptance != Acceptance::None.code()
}

fn evidence_of(receipt: &Receipt) -> Evidence {
    Evidence {
        run_delay_ns: receipt.run_delay_ns,
        involuntary_switches: receipt.involuntary_switches,
        // The receipt does not tell minor from major; minor is the more frequent by far.
        minor_faults: receipt.faults,
        ..Evidence::default()
    }
}

/// How long mapping took in this tick, if anything was mapped; 0 if the record does not say how long.
fn joined(record: &TickRecord) -> Option<u64> {
    let happened = happenings(record).iter().filter(|happening| happening.kind == HappeningKind::Joined.code());
    let mapping_ns = happened.map(|happening| happening.detail).max();
    mapping_ns.or((record.flags & record_flag::JOINED != 0).then_some(0))
}

/// Where most of the time went, and how long that was.
fn part_of(config: &Config, record: &TickRecord, blamed: u32) -> (Part, u64) {
    let before_state_ns = record.published_ns.saturating_sub(record.deadline_ns);
    let answer = receipts(record).iter().find(|receipt| {
        receipt.writer == blamed
            && matches!(
                Acceptance::from_code(receipt.acceptance),
                Some(Acceptance::Applied | Acceptance::Late | Acceptance::LateUnused | Acceptance::Standby)
            )
    });
    let Some(receipt) = answer else {
        let open_ns = record.grace_deadline_ns.saturating_sub(record.published_ns);
        let plants = before_state_ns >= config.late_ns.max(open_ns);
        return if plants { (Part::PlantWakeup, before_state_ns) } else { (Part::NoAnswer, open_ns) };
    };
    let between = |from_ns: u64, to_ns: u64| to_ns.checked_sub(from_ns);
    let parts = [
        (Part::ControllerWakeup, between(record.published_ns, receipt.state_received_ns)),
        (Part::Compute, between(receipt.state_received_ns, receipt.torque_published_ns)),
        (Part::Return, between(receipt.torque_published_ns, receipt.arrived_ns)),
    ];
    let mut most = (Part::PlantWakeup, before_state_ns);
    for (part, lost_ns) in parts {
        match lost_ns {
            None => return (Part::Unknown, 0),
            Some(lost_ns) if lost_ns > most.1 => most = (part, lost_ns),
            Some(_) => {}
        }
    }
    most
}

#[cfg(test)]
mod tests;
