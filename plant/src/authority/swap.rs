//! Swaps: the queue of requests, the gate before a switch, the cross-fade, and the watch after it.
//!
//! A swap waits until its tick, or until the gate passes. It is carried out at a tick boundary, and may be rolled back
//! while it is watched. Everything is decided by ticks, never by a clock, so that lockstep decides alike every time. Not
//! responsible for changing authority: [`super::Authority`] does what is due here.

mod gate;
mod misses;
mod rules;

use std::collections::VecDeque;

use loopbound_model::law::fade_weight;
use loopbound_shared::event::Refusal;
use loopbound_shared::sample::{Command, Reply};

use super::judgement::Fade;
use super::members::{Members, Standing};
use crate::replies;
pub(crate) use gate::CertifiedLevels;
use gate::{Refused, gate};
use misses::Misses;
pub use rules::SwapRules;

#[cfg(test)]
mod tests;

/// Swaps that can wait at once.
const REQUESTS_MAX: usize = 64;
/// Outcomes that are kept: whoever asked for a swap looks soon.
const OUTCOMES_MAX: usize = 8;

#[derive(Clone, Copy, Debug)]
struct Request {
    to: u32,
    /// 0: as soon as the gate passes.
    at_tick: u64,
    blend_ticks: u64,
    force: bool,
    since_tick: u64,
}

/// The switch that was carried out last.
#[derive(Clone, Copy, Debug)]
struct Switch {
    from: u32,
    tick: u64,
    blend_ticks: u64,
}

/// What a switch is watched by, to roll it back if it turns out badly.
#[derive(Clone, Copy, Debug)]
struct Watch {
    back_to: u32,
    until_tick: u64,
    /// The last ticks without a torque on time.
    misses: Misses,
}

/// A swap that is due at a tick boundary: its target, and what becomes of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Due {
    pub(super) to: u32,
    /// The largest torque step, N·m, if the gate passed.
    pub(super) outcome: Result<f64, Refused>,
    blend_ticks: u64,
}

/// Authority goes back to the controller before the last switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rollback {
    pub(super) to: u32,
    pub(super) reason: Refusal,
}

/// Swaps that wait, the switch that was carried out last, and how the latest swaps went. Allocates at construction only.
pub(super) struct Swaps {
    rules: SwapRules,
    requests: Vec<Request>,
    last: Option<Switch>,
    watch: Option<Watch>,
    /// By the controller that was to take over.
    outcomes: VecDeque<(u32, Reply)>,
}

impl Swaps {
    pub(super) fn new(rules: SwapRules) -> Self {
        let requests = Vec::with_capacity(REQUESTS_MAX);
        let outcomes = VecDeque::with_capacity(OUTCOMES_MAX);
        Self { rules, requests, last: None, watch: None, outcomes }
    }

    /// Queues a swap asked for in `tick`; the answer is its state by now.
    pub(super) fn request(&mut self, command: &Command, tick: u64) -> Reply {
        if self.requests.len() == REQUESTS_MAX {
            return replies::refused(Refusal::Busy);
        }
        self.outcomes.retain(|(to, _)| *to != command.controller);
        self.requests.push(Request {
            to: command.controller,
            at_tick: command.tick,
            blend_ticks: command.ns.div_ceil(self.rules.period_ns),
            force: command.option != 0,
            since_tick: tick,
        });
        replies::pending(command.tick)
    }

    /// How the swap to controller `to` is doing. One that was never asked for counts as pending.
    pub(super) fn status(&self, to: u32) -> Reply {
        let waits = self.requests.iter().any(|request| request.to == to);
        let outcome = self.outcomes.iter().find(|(of, _)| *of == to).filter(|_| !waits);
        outcome.map_or_else(|| replies::pending(0), |(_, outcome)| *outcome)
    }

    /// Forgets the swap to controller `to`; false if none waits.
    pub(super) fn cancel(&mut self, to: u32, tick: u64) -> bool {
        let waits = self.requests.iter().position(|request| request.to == to);
        if let Some(at) = waits {
            self.requests.remove(at);
            self.conclude(to, Reply { tick, ..replies::refused(Refusal::Cancelled) });
        }
        waits.is_some()
    }

    fn conclude(&mut self, to: u32, outcome: Reply) {
        self.outcomes.retain(|(of, _)| *of != to);
        if self.outcomes.len() == OUTCOMES_MAX {
            self.outcomes.pop_front();
        }
        self.outcomes.push_back((to, outcome));
    }

    /// The cross-fade in `tick`, while one lasts.
    pub(super) fn fade(&self, tick: u64) -> Option<Fade> {
        let switch = self.last.filter(|s| tick < s.tick + s.blend_ticks)?;
        Some(Fade { from: switch.from, weight: fade_weight(tick - switch.tick, switch.blend_ticks) })
    }

    /// Whether the last switch may still be rolled back.
    pub(super) fn is_watched(&self) -> bool {
        self.watch.is_some()
    }

    /// Takes the swap that is due at the boundary before `tick` from the queue, if one is: to be carried out
    /// ([`Swaps::switched`]), or refused by now. One that can still wait for its gate stays.
    pub(super) fn take_due(&mut self, tick: u64, members: &Members, levels: &impl CertifiedLevels) -> Option<Due> {
        let at = self.position_due(tick)?;
        let request = self.requests[at];
        let last_tick = self.last.map(|switch| switch.tick);
        let outcome = gate(&request, tick, members, &self.rules, last_tick, levels);
        if let Err(refused) = outcome {
            let timed_out = tick >= request.since_tick + self.rules.timeout_ticks;
            // A named tick is kept or refused; only a swap without one waits.
            if !refused.is_hopeless() && !timed_out && request.at_tick == 0 {
                return None;
            }
            let Refused { reason, found, allowed } = refused;
            self.conclude(request.to, Reply { tick, value: found, limit: allowed, ..replies::refused(reason) });
        }
        self.requests.remove(at);
        Some(Due { to: request.to, outcome, blend_ticks: request.blend_ticks })
    }

    /// The request to be looked at in `tick`: a named tick is kept, whatever else waits for its gate.
    fn position_due(&self, tick: u64) -> Option<usize> {
        let named = self.requests.iter().position(|r| r.at_tick != 0 && r.at_tick <= tick);
        named.or_else(|| self.requests.iter().position(|r| r.at_tick == 0))
    }

    /// Authority went `from` one controller to that of `due`, with a torque step of `step_nm`: from now on it is watched.
    pub(super) fn switched(&mut self, due: &Due, from: u32, tick: u64, step_nm: f64) {
        self.last = Some(Switch { from, tick, blend_ticks: due.blend_ticks });
        let until_tick = tick + self.rules.rollback_ticks;
        self.watch = Some(Watch { back_to: from, until_tick, misses: Misses::default() });
        self.conclude(due.to, Reply { value: step_nm, ..replies::done(tick) });
    }

    /// Looks after the last switch at the boundary before `tick`: it is rolled back when V was above its certified bound
    /// in the tick before (`bound_held`), or too many ticks had no torque on time (`missed`: the last one), as soon as the
    /// old controller is fit to go on.
    pub(super) fn watch(&mut self, tick: u64, members: &Members, missed: bool, bound_held: bool) -> Option<Rollback> {
        let watch = self.watch.as_mut()?;
        if tick >= watch.until_tick {
            self.watch = None;
            return None;
        }
        watch.misses.push(missed, self.rules.rollback_window);
        let too_many = watch.misses.count() >= self.rules.rollback_misses;
        let reason = match (bound_held, too_many) {
            (false, _) => Refusal::BoundExceeded,
            (true, true) => Refusal::Deadlines,
            (true, false) => return None,
        };
        let to = watch.back_to;
        members.get(to).filter(|m| m.standing == Standing::Standby && m.streak > 0)?;
        self.supersede(members.active().0, reason, tick);
        Some(Rollback { to, reason })
    }

    /// A rollback or a failover takes authority from `failed`: no cross-fade goes on, and a switch to it that was being
    /// watched counts as rolled back.
    pub(super) fn supersede(&mut self, failed: u32, reason: Refusal, tick: u64) {
        if let Some(switch) = &mut self.last {
            switch.blend_ticks = 0;
        }
        if self.watch.take().is_some() {
            self.conclude(failed, replies::rolled_back(reason, tick));
        }
    }
}
