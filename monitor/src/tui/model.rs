//! What the live view knows: the newest record, a stretch of V, latencies by hop over time, the last events.
//!
//! No terminal and no clock here: records go in, and the view reads.

use std::collections::{BTreeMap, VecDeque};

use loopbound_model::chain::LINKS_MAX;
use loopbound_scenario::{Mode, Scenario, ScenarioError};
use loopbound_shared::event::{LiveFault, Role};
use loopbound_shared::sample::{Announce, TickRecord};

use crate::event::{Event, EventKind};
use crate::hops::Hop;
use crate::judge::Judge;
use crate::summary::Quantiles;
use crate::tracker::{Config, Row, Tracker, receipts};

/// Length of the strip of V, s.
pub const STRIP_S: f64 = 10.0;
/// Points of the strip.
const STRIP_POINTS: usize = 400;
/// Intervals of a sparkline.
const SPARKS: usize = 60;
/// Events that are kept.
const EVENTS: usize = 200;
/// Smallest V that the strip tells from zero.
const V_LEAST: f64 = 1e-9;

/// What can be injected into the controller in charge: the digit of each is its place, from 1.
pub const FAULTS: [(LiveFault, &str); 6] = [
    (LiveFault::Delay, "delay: every torque too late, 100 ms long"),
    (LiveFault::Drop, "drop: no torque, 100 ms long"),
    (LiveFault::Nan, "nan: torques that are no numbers, 100 ms long"),
    (LiveFault::Kill, "kill: SIGKILL"),
    (LiveFault::Hang, "hang: stopped for 100 ms"),
    (LiveFault::Glitch, "glitch: 200 N·m on the first link, 100 ms long"),
];

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Nothing that the model can't do by itself.
    Nothing,
    /// Another controller.
    Swap,
    /// A fault.
    Fault(LiveFault),
    /// To leave; whatever runs goes on.
    Quit,
}

/// One instant of the strip, in powers of ten.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StripPoint {
    /// Plant time, s.
    pub t_s: f64,
    /// lg V.
    pub v: Option<f64>,
    /// lg of the promised V.
    pub promised: Option<f64>,
}

/// All that the view shows.
pub struct Model<const N: usize> {
    /// Name of the group.
    pub group: String,
    /// Lengths of the links, m.
    pub length_m: [f64; LINKS_MAX],
    /// Ticks a second.
    pub rate_hz: f64,
    /// Whether time is virtual.
    pub lockstep: bool,
    /// The figures so far.
    pub tracker: Tracker<N>,
    /// The newest record, with what it came to.
    pub newest: Option<(Box<TickRecord>, Row)>,
    /// V over the last [`STRIP_S`].
    pub strip: VecDeque<StripPoint>,
    /// The p99 (ns) of each hop, one entry an interval.
    pub sparks: [VecDeque<u64>; Hop::ALL.len()],
    /// The last events, the newest at the end.
    pub events: VecDeque<Event>,
    /// Law or executable of each controller.
    pub names: BTreeMap<u32, String>,
    /// The answer to the last command.
    pub answer: String,
    /// The picture stands still; the figures go on.
    pub paused: bool,
    /// The menu of faults is open.
    pub choosing: bool,
}

impl<const N: usize> Model<N> {
    /// A view that has seen nothing.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn new(group: &str, scenario: &Scenario) -> Result<Self, ScenarioError> {
        let mut length_m = [1.0; LINKS_MAX];
        if let Some(lengths) = &scenario.plant.length {
            length_m.iter_mut().zip(lengths.to_vec(N)).for_each(|(place, length)| *place = length);
        }
        Ok(Self {
            group: group.to_owned(),
            length_m,
            rate_hz: scenario.loop_.rate_hz(),
            lockstep: scenario.loop_.mode == Mode::Lockstep,
            tracker: Tracker::new(Config::of(scenario), Some(Judge::new(scenario)?)),
            newest: None,
            strip: VecDeque::with_capacity(STRIP_POINTS),
            sparks: std::array::from_fn(|_| VecDeque::with_capacity(SPARKS)),
            events: VecDeque::with_capacity(EVENTS),
            names: BTreeMap::new(),
            answer: String::new(),
            paused: false,
            choosing: false,
        })
    }

    /// Takes a record.
    pub fn feed(&mut self, record: &TickRecord) {
        let Some(row) = self.tracker.feed(record) else { return };
        for event in self.tracker.drain_events() {
            // What happens tick after tick must not push everything else off the screen: the newest stands for all.
            let repeats =
                matches!(event.kind, EventKind::Rejected { .. } | EventKind::Bound { .. } | EventKind::Promise { .. });
            let same = self.events.back().is_some_and(|last| last.kind.name() == event.kind.name());
            if (repeats && same) || self.events.len() == EVENTS {
                let at = if repeats && same { self.events.len() - 1 } else { 0 };
                self.events.remove(at);
            }
            self.events.push_back(event);
        }
        if self.paused {
            return;
        }
        let due = self.strip.back().is_none_or(|last| row.t_s - last.t_s >= STRIP_S / STRIP_POINTS as f64);
        if due {
            let lg = |v: Option<f64>| v.filter(|v| v.is_finite()).map(|v| libm::log10(v.max(V_LEAST)));
            self.strip.push_back(StripPoint { t_s: row.t_s, v: lg(row.lyapunov), promised: lg(row.lyapunov_bound) });
        }
        while self.strip.front().is_some_and(|first| row.t_s - first.t_s > STRIP_S) {
            self.strip.pop_front();
        }
        self.newest = Some((Box::new(*record), row));
    }

    /// Takes a key; `'\u{1b}'` is Esc. While the menu is open it takes them all.
    pub fn press(&mut self, key: char) -> Wish {
        const ESC: char = '\u{1b}';
        if std::mem::take(&mut self.choosing) {
            let place = key.to_digit(10).and_then(|digit| usize::try_from(digit).ok()?.checked_sub(1));
            return match (place.and_then(|place| FAULTS.get(place)), key) {
                (Some((fault, _)), _) => Wish::Fault(*fault),
                (None, ESC | 'f') => Wish::Nothing,
                (None, _) => {
                    self.choosing = true;
                    Wish::Nothing
                }
            };
        }
        match key {
            'q' | ESC => return Wish::Quit,
            's' => return Wish::Swap,
            'f' => self.choosing = true,
            ' ' => self.paused = !self.paused,
            _ => {}
        }
        Wish::Nothing
    }

    /// Takes what a process says of itself.
    pub fn learn(&mut self, announce: &Announce) {
        self.tracker.learn(announce);
        if announce.role == Role::Controller.code() {
            let end = announce.name.iter().position(|byte| *byte == 0).unwrap_or(announce.name.len());
            self.names.insert(announce.id, String::from_utf8_lossy(&announce.name[..end]).into_owned());
        }
    }

    /// Closes an interval of the sparklines.
    pub fn close_interval(&mut self) {
        for (sparks, hop) in self.sparks.iter_mut().zip(Hop::ALL) {
            if sparks.len() == SPARKS {
                sparks.pop_front();
            }
            let p99_ns = self.tracker.interval().of(hop).histogram().value_at_quantile(0.99);
            sparks.push_back(p99_ns);
        }
        self.tracker.start_interval();
    }

    /// Who is in charge, and in which epoch.
    #[must_use]
    pub fn in_charge(&self) -> (u32, u32) {
        self.newest.as_ref().map_or((0, 0), |(record, _)| (record.active, record.epoch))
    }

    /// The controllers that answered the newest tick and are not in charge.
    #[must_use]
    pub fn standbys(&self) -> Vec<u32> {
        let Some((record, _)) = &self.newest else { return Vec::new() };
        let others = receipts(record).iter().map(|receipt| receipt.writer);
        others.filter(|id| *id != 0 && *id != record.active).collect()
    }

    /// The law or executable of a controller.
    #[must_use]
    pub fn name(&self, id: u32) -> &str {
        self.names.get(&id).map_or("unknown", String::as_str)
    }

    /// The quantiles of a hop over the run.
    #[must_use]
    pub fn quantiles(&self, hop: Hop) -> Quantiles {
        self.tracker.hops().of(hop).quantiles()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_menu_takes_a_digit_or_esc_and_no_other_key() {
        let mut model = Model::<3>::new("g", &Scenario::default()).unwrap();
        assert_eq!((model.press('1'), model.choosing), (Wish::Nothing, false));
        assert_eq!((model.press('f'), model.choosing), (Wish::Nothing, true));
        for key in ['s', 'q', ' ', '0', '9'] {
            assert_eq!((model.press(key), model.choosing, model.paused), (Wish::Nothing, true, false), "{key}");
        }
        assert_eq!((model.press('\u{1b}'), model.choosing), (Wish::Nothing, false));
        for (digit, (fault, _)) in ('1'..).zip(FAULTS) {
            model.press('f');
            assert_eq!((model.press(digit), model.choosing), (Wish::Fault(fault), false));
        }
        assert_eq!((model.press('s'), model.press('q'), model.press('\u{1b}')), (Wish::Swap, Wish::Quit, Wish::Quit));
        model.press(' ');
        assert!(model.paused);
    }
}
