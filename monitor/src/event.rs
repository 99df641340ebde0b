//! What a monitor notes besides figures: one small value an event, one line of JSON in `events.jsonl`.

pub mod words;

use std::collections::BTreeMap;

use loopbound_shared::event::{Acceptance, Decision, HappeningKind, LiveFault, Refusal, RunawayKind};
use loopbound_shared::sample::Happening;
use serde_json::{Map, Value, json};

use crate::cause::{Attribution, Cause};

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum EventKind {
    /// The first record that this monitor got; nothing before it was seen.
    FirstSeen,
    /// A tick whose torque came later than `loop.late`.
    Late {
        /// Deadline → torque, ns; 0 if none came.
        deadline_to_torque_ns: u64,
        /// Why.
        why: Attribution,
    },
    /// Ticks without an accepted torque by the grace deadline, or skipped.
    Missed {
        /// How many.
        ticks: u64,
        /// Where the torque came from instead, as a `Decision` code; none for skipped ticks.
        decision: Option<u32>,
        /// Why.
        why: Attribution,
    },
    /// Records that this monitor did not get.
    Gap {
        /// How many.
        ticks: u64,
    },
    /// A torque that was not applied.
    Rejected {
        /// Who sent it.
        writer: u32,
        /// An `Acceptance` code.
        acceptance: u32,
    },
    /// X was above the tolerance: the verdict of the diagnosis, X, ∫L, ∫F.
    Bound {
        /// What the diagnosis found.
        verdict: &'static str,
        /// X, in units of V.
        x: f64,
        /// ∫L.
        int_l: f64,
        /// ∫F.
        int_f: f64,
    },
    /// Promise (a) was broken: V and what was promised.
    Promise {
        /// V.
        v: f64,
        /// The right side of promise (a).
        v_bound: f64,
    },
    /// V left the certified set, or came back.
    Level {
        /// V.
        v: f64,
        /// c.
        level: f64,
        /// Whether it is inside now.
        inside: bool,
    },
    /// An entry of the record.
    Happening(Happening),
}

/// One event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// The tick it belongs to.
    pub tick: u64,
    /// Start of that tick in plant time, ns.
    pub plant_ns: u64,
    /// What happened.
    pub kind: EventKind,
}

impl EventKind {
    /// The name in files.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::FirstSeen => "first seen",
            Self::Late { .. } => "late",
            Self::Missed { .. } => "missed",
            Self::Gap { .. } => "gap",
            Self::Rejected { .. } => "rejected",
            Self::Bound { .. } => "bound",
            Self::Promise { .. } => "promise",
            Self::Level { .. } => "level",
            Self::Happening(happening) => {
                HappeningKind::from_code(happening.kind).map_or("unknown happening", HappeningKind::name)
            }
        }
    }
}

impl Event {
    /// The line of `events.jsonl`, without its end.
    #[must_use]
    pub fn to_json(&self) -> String {
        let mut line = Map::new();
        let mut put = |key: &str, value: Value| {
            line.insert(key.to_owned(), value);
        };
        put("tick", json!(self.tick));
        put("t_s", json!(self.plant_ns as f64 * 1e-9));
        put("kind", json!(self.kind.name()));
        match &self.kind {
            EventKind::FirstSeen => {}
            EventKind::Late { deadline_to_torque_ns, why } => {
                put("deadline_to_torque_ns", json!(deadline_to_torque_ns));
                put("cause", json!(why.cause.name()));
                put("magnitude_ns", json!(why.magnitude_ns));
            }
            EventKind::Missed { ticks, decision, why } => {
                put("ticks", json!(ticks));
                let name = |code: &u32| Decision::from_code(*code).map(Decision::name);
                put("decision", json!(decision.as_ref().map_or(Some("skipped"), name)));
                put("cause", json!(why.cause.name()));
                put("magnitude_ns", json!(why.magnitude_ns));
            }
            EventKind::Gap { ticks } => put("ticks", json!(ticks)),
            EventKind::Rejected { writer, acceptance } => {
                put("controller", json!(writer));
                put("reason", json!(Acceptance::from_code(*acceptance).map_or("unknown", Acceptance::name)));
            }
            EventKind::Bound { verdict, x, int_l, int_f } => {
                put("verdict", json!(verdict));
                put("x", json!(x));
                put("int_l", json!(int_l));
                put("int_f", json!(int_f));
            }
            EventKind::Promise { v, v_bound } => {
                put("v", json!(v));
                put("v_bound", json!(v_bound));
            }
            EventKind::Level { v, level, inside } => {
                put("v", json!(v));
                put("level", json!(level));
                put("inside", json!(inside));
            }
            EventKind::Happening(happening) => {
                put("subject", json!(happening.subject));
                put("detail", json!(happening.detail));
                put("value", json!(happening.value));
                put("text", json!(words::words(happening)));
                let kind = HappeningKind::from_code(happening.kind);
                if matches!(kind, Some(HappeningKind::Rollback | HappeningKind::SwapRefused)) {
                    put("reason", json!(refusal(happening.detail)));
                }
                if kind == Some(HappeningKind::Diverged) {
                    put("quantity", json!(runaway(happening.detail)));
                }
                if kind == Some(HappeningKind::FaultInjected) {
                    put("fault", json!(fault(happening.detail)));
                }
            }
        }
        Value::Object(line).to_string()
    }
}

/// The words of a `Refusal` code.
#[must_use]
pub fn refusal(code: u64) -> &'static str {
    u32::try_from(code).ok().and_then(Refusal::from_code).map_or("a reason this build does not know", Refusal::name)
}

/// The name of a `RunawayKind` code.
#[must_use]
pub fn runaway(code: u64) -> &'static str {
    let kind = u32::try_from(code).ok().and_then(RunawayKind::from_code);
    kind.map_or("a quantity this build does not know", RunawayKind::name)
}

/// The name of a `LiveFault` code.
#[must_use]
pub fn fault(code: u64) -> &'static str {
    u32::try_from(code).ok().and_then(LiveFault::from_code).map_or("a fault this build does not know", LiveFault::name)
}

/// Events that wait to be written, in a place of fixed size, and counts of all that ever were.
#[derive(Debug)]
pub struct EventLog {
    waiting: Vec<Event>,
    counts: BTreeMap<&'static str, u64>,
    dropped: u64,
}

/// Events that wait at most; drained after each batch of records.
const WAITING_MAX: usize = 8192;

impl Default for EventLog {
    fn default() -> Self {
        Self { waiting: Vec::with_capacity(WAITING_MAX), counts: BTreeMap::new(), dropped: 0 }
    }
}

impl EventLog {
    /// Notes an event; one that finds no place is counted as dropped.
    pub fn push(&mut self, tick: u64, plant_ns: u64, kind: EventKind) {
        *self.counts.entry(kind.name()).or_default() += 1;
        if self.waiting.len() < WAITING_MAX {
            self.waiting.push(Event { tick, plant_ns, kind });
        } else {
            self.dropped += 1;
        }
    }

    /// Hands out what waits, in order.
    pub fn drain(&mut self) -> impl Iterator<Item = Event> + '_ {
        self.waiting.drain(..)
    }

    /// Counts by kind since the start.
    #[must_use]
    pub fn counts(&self) -> BTreeMap<String, u64> {
        self.counts.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect()
    }

    /// Events that found no place.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

/// The cause of an event, where it has one.
#[must_use]
pub fn cause_of(event: &Event) -> Option<Cause> {
    match event.kind {
        EventKind::Late { why, .. } | EventKind::Missed { why, .. } => Some(why.cause),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_json_with_the_tick_the_cause_and_its_size_and_never_holds_nan() {
        let why = Attribution { cause: Cause::RunQueueDelay, magnitude_ns: 7 };
        let late = Event { tick: 5, plant_ns: 5_000_000, kind: EventKind::Late { deadline_to_torque_ns: 9, why } };
        let line: Value = serde_json::from_str(&late.to_json()).unwrap();
        assert_eq!(
            (&line["tick"], &line["cause"], &line["magnitude_ns"]),
            (&json!(5), &json!("run_queue_delay"), &json!(7))
        );
        let detail = u64::from(LiveFault::Hang.code());
        let kind = HappeningKind::FaultInjected.code();
        let injected = EventKind::Happening(Happening { kind, subject: 2, detail, value: 7.0 });
        let line: Value = serde_json::from_str(&Event { tick: 5, plant_ns: 0, kind: injected }.to_json()).unwrap();
        assert_eq!(
            (&line["kind"], &line["fault"], &line["subject"]),
            (&json!("fault injected"), &json!("hang"), &json!(2))
        );
        let promise = EventKind::Promise { v: f64::NAN, v_bound: 1.0 };
        let line: Value = serde_json::from_str(&Event { tick: 0, plant_ns: 0, kind: promise }.to_json()).unwrap();
        assert_eq!(line["v"], Value::Null);
    }

    #[test]
    fn a_log_that_is_not_drained_counts_what_it_loses() {
        let mut log = EventLog::default();
        (0..WAITING_MAX as u64 + 3).for_each(|tick| log.push(tick, 0, EventKind::Gap { ticks: 1 }));
        assert_eq!((log.dropped(), log.counts()["gap"]), (3, WAITING_MAX as u64 + 3));
        assert_eq!(log.drain().count(), WAITING_MAX);
    }
}
