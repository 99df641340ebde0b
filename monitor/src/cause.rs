//! Why a tick was late or missed, from evidence alone.
//!
//! Every late tick has a *part* in which most of the time went: the plant's wake-up, the controller's wake-up, its
//! computation, or the way back. The thread that owns this part is then asked what the kernel did to it. The order of
//! the questions, the first yes decides:
//!
//! 1. [`Cause::InjectedFault`]: the tick says that a fault was injected into it, or, where the part is the controller's, its
//!    torque does, in time or not, or the scenario has a fault that keeps this controller from answering this tick; or the plant was
//!    kept by a fault of its own beyond the end of the tick before.
//! 2. [`Cause::MonitorJoined`]: the plant mapped memory for a port in this tick or the one before, and its wake-up is
//!    the part (or mapping took at least a quarter of the time lost); or the controller says that it was mapping.
//! 3. [`Cause::PageFault`]: a major fault in the thread, or so many minor ones that they explain a quarter of the time
//!    lost, at [`MINOR_FAULT_NS`] each.
//! 4. [`Cause::InvoluntarySwitch`]: another thread took the core: an involuntary switch, and run-queue delay of at
//!    least a quarter of the time lost (any, where the delay can't be read).
//! 5. [`Cause::RunQueueDelay`]: it was runnable and waited for a core for at least a quarter of the time lost.
//! 6. [`Cause::ControllerDead`]: the controller in charge has ended, and was removed from the group.
//! 7. [`Cause::ControllerSilent`]: it lives, and has given no answer to what it was asked for at least [`SILENCE_NS`] and
//!    two ticks. One that answers when the tick is over is not silent.
//! 8. [`Cause::PageFault`]: minor faults in the thread, few enough that each would have cost up to [`MINOR_FAULT_MAX_NS`].
//! 9. [`Cause::SetpointStale`]: the part is the controller's, and the setpoint of the tick was absent, but not because
//!    everybody had been stopped: where setpoints ran out while the plant itself did not run, they are no cause. Where the scenario has
//!    a fault that made the reference keep it, that fault is the cause.
//! 10. By part: the plant's wake-up is [`Cause::OwnOverrun`] when the thread was running for nine tenths of the time
//!     since the last record and no gap in its spin is as long as half of the time lost, else [`Cause::TimerOrHost`];
//!     computation is [`Cause::OwnOverrun`] of the controller; its wake-up is [`Cause::ControllerLate`]; the way back is
//!     [`Cause::TimerOrHost`]: the torque lay there, and the plant did not run.
//!
//! A plant that could not sleep before a tick was late from the tick before: its evidence then counts from there.
//!
//! Where no answer came, the time lost is the whole silence: a controller that was stopped for 20 ms and then waited 0.2 ms
//! for its core was not late by its run queue. Silence counts from when it was asked: not while the plant did not run. A tick
//! without an answer just before ticks that the plant slept through has the cause of those.
//!
//! A part is unknown only where its stamps are absent or contradict each other: [`Cause::Unknown`].
//! A host that takes the core from a virtual machine shows in no counter of the guest. In a computation it is taken
//! for an overrun, and nothing here can tell them apart.

use std::collections::BTreeMap;

use loopbound_shared::realtime::{Evidence, MISSING_SCHEDSTAT};

/// The least that a minor page fault costs.
pub const MINOR_FAULT_NS: u64 = 500;
/// The most that a minor page fault is taken to cost.
pub const MINOR_FAULT_MAX_NS: u64 = 1_000_000;
/// No answer for this long is more than being late: silent.
pub const SILENCE_NS: u64 = 5_000_000;

macro_rules! causes {
    ($($(#[doc = $sentence:literal])* $variant:ident = $name:literal, $words:literal;)*) => {
        /// Why a tick was late or missed.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum Cause { $($(#[doc = $sentence])* $variant,)* }

        impl Cause {
            /// Every cause.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The key in files.
            #[must_use]
            pub const fn name(self) -> &'static str { match self { $(Self::$variant => $name,)* } }

            /// The words on screens.
            #[must_use]
            pub const fn words(self) -> &'static str { match self { $(Self::$variant => $words,)* } }

            /// One sentence, for the documents.
            #[must_use]
            pub const fn sentence(self) -> &'static str {
                match self { $(Self::$variant => concat!($($sentence),*).trim_ascii(),)* }
            }
        }
    };
}

causes! {
    /// The timer fired late, or the host took the core away; the kernel's counters saw nothing.
    TimerOrHost = "timer_or_host", "timer or host late";
    /// Runnable, and no core was free.
    RunQueueDelay = "run_queue_delay", "run-queue delay";
    /// Another thread took the core.
    InvoluntarySwitch = "involuntary_switch", "involuntary switch";
    /// A page had to be mapped or read.
    PageFault = "page_fault", "page fault";
    /// The process's own work took too long.
    OwnOverrun = "own_overrun", "own overrun";
    /// The controller answered late, and nothing says why.
    ControllerLate = "controller_late", "controller late";
    /// The controller lives and does not answer.
    ControllerSilent = "controller_silent", "controller silent";
    /// The controller has ended.
    ControllerDead = "controller_dead", "controller dead";
    /// The setpoint of the tick was absent.
    SetpointStale = "setpoint_stale", "setpoint stale";
    /// It was asked for.
    InjectedFault = "injected_fault", "injected fault";
    /// The plant mapped memory for a monitor that joined.
    MonitorJoined = "monitor_joined", "monitor joined";
    /// The plant counted it, and its record did not reach this monitor.
    NotSeen = "not_seen", "not seen";
    /// The evidence does not say.
    Unknown = "unknown", "unknown";
}

/// Where most of the time of a late tick went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Deadline → state published: the plant's.
    PlantWakeup,
    /// State published → received: the controller's wake-up.
    ControllerWakeup,
    /// State received → torque published: the controller's.
    Compute,
    /// Torque published → received: the plant's wake-up from its wait.
    Return,
    /// No answer came at all.
    NoAnswer,
    /// The stamps don't tell.
    Unknown,
}

impl Part {
    /// Whether the plant's thread owns the part.
    #[must_use]
    pub fn is_plants(self) -> bool {
        matches!(self, Self::PlantWakeup | Self::Return)
    }
}

/// What is known about one late or missed tick.
#[derive(Clone, Copy, Debug)]
pub struct Clues {
    /// Where most of the time went.
    pub part: Part,
    /// How long that part took, ns.
    pub lost_ns: u64,
    /// What the kernel did to the thread that owns the part, since its evidence before.
    pub evidence: Evidence,
    /// Time that `evidence` spans, ns.
    pub evidence_span_ns: u64,
    /// Longest gap that the plant saw while spinning, ns.
    pub spin_gap_ns: u64,
    /// The tick, or a torque where the part is the controller's, says that a fault was injected.
    pub injected: bool,
    /// The plant mapped memory in this tick or the one before, and how long that took if it said so, ns.
    pub joined: Option<u64>,
    /// How long the controller in charge has given no answer around this tick, ns.
    pub silence_ns: u64,
    /// Two ticks' worth of time, ns.
    pub two_ticks_ns: u64,
    /// The controller in charge was removed from the group.
    pub removed: bool,
    /// The setpoint of the tick was absent, and the plant had been running when they ran out.
    pub setpoint_stale: bool,
    /// A fault of the reference kept that setpoint away.
    pub stale_injected: bool,
}

/// A cause and how large its evidence is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attribution {
    /// Why.
    pub cause: Cause,
    /// How large, ns: of run-queue delay the delay, of a join the mapping, else the part that took longest.
    pub magnitude_ns: u64,
}

/// The decision described at the head of this module.
#[must_use]
pub fn attribute(clues: &Clues) -> Attribution {
    let lost_ns = clues.lost_ns;
    let answer = |cause, magnitude_ns| Attribution { cause, magnitude_ns };
    if clues.injected {
        return answer(Cause::InjectedFault, lost_ns);
    }
    if let Some(mapping_ns) = clues.joined
        && (clues.part == Part::PlantWakeup || mapping_ns >= (lost_ns / 4).max(1))
    {
        return answer(Cause::MonitorJoined, mapping_ns);
    }
    let evidence = &clues.evidence;
    let silence_ns = if clues.part == Part::NoAnswer { clues.silence_ns } else { 0 };
    let enough_ns = (lost_ns.max(silence_ns) / 4).max(1);
    let faulted_ns = evidence.minor_faults.saturating_mul(MINOR_FAULT_NS);
    if evidence.major_faults > 0 || faulted_ns >= enough_ns {
        return answer(Cause::PageFault, lost_ns);
    }
    let delay_unknown = evidence.missing & MISSING_SCHEDSTAT != 0;
    let waited = evidence.run_delay_ns >= enough_ns;
    if evidence.involuntary_switches > 0 && (waited || delay_unknown) {
        return answer(Cause::InvoluntarySwitch, evidence.run_delay_ns);
    }
    if waited {
        return answer(Cause::RunQueueDelay, evidence.run_delay_ns);
    }
    if clues.removed && clues.part == Part::NoAnswer {
        return answer(Cause::ControllerDead, clues.silence_ns);
    }
    if clues.part == Part::NoAnswer && clues.silence_ns >= SILENCE_NS.max(clues.two_ticks_ns) {
        return answer(Cause::ControllerSilent, clues.silence_ns);
    }
    if evidence.minor_faults > 0 && evidence.minor_faults.saturating_mul(MINOR_FAULT_MAX_NS) >= enough_ns {
        return answer(Cause::PageFault, lost_ns);
    }
    if clues.setpoint_stale && !clues.part.is_plants() {
        let cause = if clues.stale_injected { Cause::InjectedFault } else { Cause::SetpointStale };
        return answer(cause, lost_ns);
    }
    answer(by_part(clues), lost_ns)
}

fn by_part(clues: &Clues) -> Cause {
    match clues.part {
        Part::PlantWakeup => {
            let gap_seen = clues.spin_gap_ns >= (clues.lost_ns / 2).max(1);
            let ran =
                clues.evidence_span_ns > 0 && clues.evidence.run_time_ns as f64 >= 0.9 * clues.evidence_span_ns as f64;
            if ran && !gap_seen { Cause::OwnOverrun } else { Cause::TimerOrHost }
        }
        Part::Compute => Cause::OwnOverrun,
        Part::Return => Cause::TimerOrHost,
        Part::ControllerWakeup | Part::NoAnswer => Cause::ControllerLate,
        Part::Unknown => Cause::Unknown,
    }
}

/// Counts by cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CauseCounts([u64; Cause::ALL.len()]);

impl CauseCounts {
    /// Counts `many` ticks.
    pub fn add(&mut self, cause: Cause, many: u64) {
        let count = &mut self.0[cause as usize];
        *count = count.saturating_add(many);
    }

    /// Of one cause.
    #[must_use]
    pub fn of(&self, cause: Cause) -> u64 {
        self.0[cause as usize]
    }

    /// Of all causes.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.0.iter().fold(0, |total: u64, count| total.saturating_add(*count))
    }

    /// By name, zeros too: an expectation may ask for any of them.
    #[must_use]
    pub fn by_name(&self) -> BTreeMap<String, u64> {
        Cause::ALL.iter().map(|cause| (cause.name().to_owned(), self.of(*cause))).collect()
    }
}

/// Counts by name in words, the most frequent first; those that never occurred are left out.
#[must_use]
pub fn words_of(by_name: &BTreeMap<String, u64>) -> String {
    let mut found: Vec<(u64, &str)> = by_name
        .iter()
        .filter(|(_, count)| **count > 0)
        .map(|(name, count)| {
            let known = Cause::ALL.iter().find(|cause| cause.name() == name);
            (*count, known.map_or(name.as_str(), |cause| cause.words()))
        })
        .collect();
    found.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(b.1)));
    let list: Vec<String> = found.into_iter().map(|(count, words)| format!("{count} {words}")).collect();
    list.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn late(part: Part) -> Clues {
        Clues {
            part,
            lost_ns: 400_000,
            evidence: Evidence::default(),
            evidence_span_ns: 1_000_000,
            spin_gap_ns: 0,
            injected: false,
            joined: None,
            silence_ns: 0,
            two_ticks_ns: 2_000_000,
            removed: false,
            setpoint_stale: false,
            stale_injected: false,
        }
    }

    fn with(part: Part, evidence: Evidence) -> Cause {
        attribute(&Clues { evidence, ..late(part) }).cause
    }

    #[test]
    fn each_piece_of_evidence_leads_to_its_cause() {
        let delay = Evidence { run_delay_ns: 300_000, ..Evidence::default() };
        assert_eq!(with(Part::PlantWakeup, delay), Cause::RunQueueDelay);
        assert_eq!(with(Part::Compute, Evidence { involuntary_switches: 1, ..delay }), Cause::InvoluntarySwitch);
        assert_eq!(with(Part::Compute, Evidence { minor_faults: 1, ..Evidence::default() }), Cause::PageFault);
        assert_eq!(with(Part::Compute, Evidence { major_faults: 1, ..delay }), Cause::PageFault);
        assert_eq!(with(Part::Compute, Evidence::default()), Cause::OwnOverrun);
        assert_eq!(with(Part::ControllerWakeup, Evidence::default()), Cause::ControllerLate);
        assert_eq!(with(Part::PlantWakeup, Evidence::default()), Cause::TimerOrHost);
        assert_eq!(with(Part::Unknown, Evidence::default()), Cause::Unknown);
    }

    #[test]
    fn a_delay_too_short_to_explain_the_time_lost_is_not_the_cause() {
        let short = Evidence { run_delay_ns: 9_000, ..Evidence::default() };
        assert_eq!(with(Part::PlantWakeup, short), Cause::TimerOrHost);
        // A switch that cost no time did not make the tick late either.
        assert_eq!(with(Part::Compute, Evidence { involuntary_switches: 1, ..short }), Cause::OwnOverrun);
        let unreadable = Evidence { involuntary_switches: 1, missing: MISSING_SCHEDSTAT, ..Evidence::default() };
        assert_eq!(with(Part::Compute, unreadable), Cause::InvoluntarySwitch);
    }

    #[test]
    fn a_plant_that_ran_all_the_time_overran_and_one_with_a_gap_lost_its_core_to_the_host() {
        let ran =
            Clues { evidence: Evidence { run_time_ns: 990_000, ..Evidence::default() }, ..late(Part::PlantWakeup) };
        assert_eq!(attribute(&ran).cause, Cause::OwnOverrun);
        assert_eq!(attribute(&Clues { spin_gap_ns: 300_000, ..ran }).cause, Cause::TimerOrHost);
        assert_eq!(attribute(&late(Part::Return)).cause, Cause::TimerOrHost);
    }

    #[test]
    fn a_long_silence_a_short_one_a_death_and_preemption_are_told_apart() {
        let silent = Clues { silence_ns: 6_000_000, ..late(Part::NoAnswer) };
        assert_eq!(attribute(&silent), Attribution { cause: Cause::ControllerSilent, magnitude_ns: 6_000_000 });
        assert_eq!(attribute(&Clues { silence_ns: 1_000_000, ..silent }).cause, Cause::ControllerLate);
        assert_eq!(attribute(&Clues { silence_ns: 0, removed: true, ..silent }).cause, Cause::ControllerDead);
        let starved = Evidence { run_delay_ns: 5_000_000, ..Evidence::default() };
        assert_eq!(attribute(&Clues { evidence: starved, ..silent }).cause, Cause::RunQueueDelay);
        // A stop of 20 ms, then a short wait for the core.
        let waited = Evidence { run_delay_ns: 200_000, ..Evidence::default() };
        let stopped = Clues { silence_ns: 20_000_000, evidence: waited, ..silent };
        assert_eq!(attribute(&stopped).cause, Cause::ControllerSilent);
        // One fault in passing does not explain 20 ms.
        let faulted_once = Evidence { minor_faults: 1, ..Evidence::default() };
        assert_eq!(attribute(&Clues { evidence: faulted_once, ..stopped }).cause, Cause::ControllerSilent);
        let asleep = Clues { lost_ns: 300_000_000, evidence: faulted_once, ..late(Part::PlantWakeup) };
        assert_eq!(attribute(&asleep).cause, Cause::TimerOrHost);
        let faulted = Evidence { minor_faults: 4_000, ..Evidence::default() };
        assert_eq!(attribute(&Clues { evidence: faulted, ..silent }).cause, Cause::PageFault);
    }

    #[test]
    fn what_was_asked_for_comes_before_what_was_found() {
        let faults = Evidence { minor_faults: 30, ..Evidence::default() };
        let joined = Clues { joined: Some(120_000), evidence: faults, ..late(Part::PlantWakeup) };
        assert_eq!(attribute(&joined), Attribution { cause: Cause::MonitorJoined, magnitude_ns: 120_000 });
        assert_eq!(attribute(&Clues { part: Part::Compute, joined: Some(1), ..joined }).cause, Cause::PageFault);
        assert_eq!(attribute(&Clues { injected: true, ..joined }).cause, Cause::InjectedFault);
        assert_eq!(attribute(&Clues { setpoint_stale: true, ..late(Part::Compute) }).cause, Cause::SetpointStale);
        // The plant waits for no setpoint.
        assert_eq!(attribute(&Clues { setpoint_stale: true, ..late(Part::PlantWakeup) }).cause, Cause::TimerOrHost);
    }
}
