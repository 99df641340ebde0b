//! Changing authority by command: the gate before, the cross-fade during, the watch after.
//!
//! A swap waits in a queue until its tick (or until the gate passes), is carried out at a tick boundary, and may be
//! taken back while it is being watched. Everything is decided by ticks, never by a clock, so that lockstep decides
//! alike every time.

mod misses;

use std::collections::VecDeque;

use loopbound_model::chain::LINKS_MAX;
use loopbound_model::law::fade_weight;
use loopbound_scenario::Scenario;
use loopbound_shared::event::{HappeningKind, Refusal, ReplyKind};
use loopbound_shared::sample::{Command, Links, Reply};

use crate::authority::{Authority, Standing};
use misses::Misses;

#[cfg(test)]
mod tests;

/// The rules of `[swap_gate]`, in ticks.
#[derive(Clone, Copy, Debug)]
pub struct SwapRules {
    /// On-time, finite torques in a row before the switch.
    pub consecutive: u32,
    /// Largest torque step of one joint without a cross-fade, N·m.
    pub torque_step_nm: f64,
    /// Shortest time since the last switch.
    pub dwell_ticks: u64,
    /// How long a swap without a named tick waits for its gate.
    pub timeout_ticks: u64,
    /// m of K: so many ticks without a torque on time …
    pub rollback_misses: u32,
    /// … among so many roll back.
    pub rollback_window: u32,
    /// How long after a switch.
    pub rollback_ticks: u64,
    /// The period, for blend times.
    pub period_ns: u64,
    /// What the joints can give, N·m.
    pub torque_limit_nm: Links,
}

impl SwapRules {
    /// The rules of a scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        let (gate, period_ns) = (&scenario.swap_gate, scenario.period_ns());
        let ticks = |ns: u64| ns.div_ceil(period_ns);
        Self {
            consecutive: gate.consecutive,
            torque_step_nm: gate.torque_step_nm,
            dwell_ticks: ticks(gate.dwell.ns()),
            timeout_ticks: ticks(gate.timeout.ns()),
            rollback_misses: gate.rollback_misses,
            rollback_window: gate.rollback_window,
            rollback_ticks: ticks(gate.rollback_for.ns()),
            period_ns,
            torque_limit_nm: limits(scenario),
        }
    }
}

/// One entry a joint, infinite where nothing is limited.
fn limits(scenario: &Scenario) -> Links {
    let mut limits = [f64::INFINITY; LINKS_MAX];
    for (limit, written) in limits.iter_mut().zip(scenario.plant.torque_limit_nm()) {
        *limit = written;
    }
    limits
}

#[derive(Clone, Copy, Debug)]
struct Request {
    to: u32,
    /// 0: as soon as the gate passes.
    at_tick: u64,
    blend_ticks: u64,
    force: bool,
    since_tick: u64,
}

#[derive(Clone, Copy, Debug)]
struct Switch {
    from: u32,
    tick: u64,
    blend_ticks: u64,
}

/// Swaps that wait, and the switch that was carried out last.
pub struct Pending {
    requests: Vec<Request>,
    last: Option<Switch>,
    /// How the latest swaps went, by the controller that was to take over.
    outcomes: VecDeque<(u32, Reply)>,
}

/// Swaps that can wait at once.
const REQUESTS_MAX: usize = 64;
/// Outcomes that are kept: whoever asked for a swap looks soon.
const OUTCOMES_MAX: usize = 8;

impl Pending {
    pub(crate) fn new() -> Self {
        let outcomes = VecDeque::with_capacity(OUTCOMES_MAX);
        Self { requests: Vec::with_capacity(REQUESTS_MAX), last: None, outcomes }
    }

    fn conclude(&mut self, to: u32, outcome: Reply) {
        self.outcomes.retain(|(of, _)| *of != to);
        if self.outcomes.len() == OUTCOMES_MAX {
            self.outcomes.pop_front();
        }
        self.outcomes.push_back((to, outcome));
    }

    /// The request to be looked at in `tick`: a named tick is kept, whatever else waits for its gate.
    fn due(&self, tick: u64) -> Option<usize> {
        let named = self.requests.iter().position(|r| r.at_tick != 0 && r.at_tick <= tick);
        named.or_else(|| self.requests.iter().position(|r| r.at_tick == 0))
    }

    /// The controller faded from and the weight of the new one, while a cross-fade lasts.
    pub(crate) fn blend(&self, tick: u64) -> Option<(u32, f64)> {
        let switch = self.last.filter(|s| tick < s.tick + s.blend_ticks)?;
        Some((switch.from, fade_weight(tick - switch.tick, switch.blend_ticks)))
    }

    /// A failover supersedes the last switch: no fade from it, no way back by it.
    pub(crate) fn forget_switch(&mut self) {
        if let Some(switch) = &mut self.last {
            switch.blend_ticks = 0;
        }
    }
}

/// Looks after a switch, to take it back if it turns out badly.
#[derive(Clone, Copy, Debug)]
pub struct Watch {
    back_to: u32,
    until_tick: u64,
    /// The last ticks without a torque on time.
    misses: Misses,
}

/// What the plant's physics says about a swap.
pub trait Judge {
    /// V and the certified level of controller `id`'s law at the present state; `None` where nothing is certified.
    fn level(&self, id: u32) -> Option<(f64, f64)>;
}

impl Authority {
    /// Notes a swap asked for by command; the answer is its state by now.
    pub fn request_swap(&mut self, command: &Command) -> Reply {
        if self.member(command.controller).is_none() {
            return Self::refused(Refusal::UnknownController);
        }
        if self.swaps.requests.len() == REQUESTS_MAX {
            return Self::refused(Refusal::Busy);
        }
        if command.tick != 0 && command.tick <= self.tick && self.counters.ticks > 0 {
            return Self::refused(Refusal::TickPassed);
        }
        self.swaps.outcomes.retain(|(of, _)| *of != command.controller);
        self.swaps.requests.push(Request {
            to: command.controller,
            at_tick: command.tick,
            blend_ticks: command.ns.div_ceil(self.rules.period_ns),
            force: command.option != 0,
            since_tick: self.tick,
        });
        Reply { kind: ReplyKind::Pending.code(), tick: command.tick, ..Reply::zeroed() }
    }

    /// How the swap to controller `to` is doing. One that was never asked for counts as pending.
    #[must_use]
    pub fn swap_status(&self, to: u32) -> Reply {
        let waits = self.swaps.requests.iter().any(|request| request.to == to);
        let outcome = self.swaps.outcomes.iter().find(|(of, _)| *of == to).filter(|_| !waits);
        outcome.map_or(Reply { kind: ReplyKind::Pending.code(), ..Reply::zeroed() }, |(_, outcome)| *outcome)
    }

    /// Forgets the swap to controller `to` if it still waits; how it is doing by now.
    pub fn cancel_swap(&mut self, to: u32) -> Reply {
        if let Some(at) = self.swaps.requests.iter().position(|request| request.to == to) {
            self.swaps.requests.remove(at);
            let reply = Reply { tick: self.tick, ..Self::refused(Refusal::Cancelled) };
            self.happen(HappeningKind::SwapRefused, to, u64::from(Refusal::Cancelled.code()), 0.0);
            self.swaps.conclude(to, reply);
        }
        self.swap_status(to)
    }

    /// Carries out what is due at the boundary before `tick`: rollback first, then at most one swap. Call before
    /// [`Authority::open`], while the answers of the tick before are still there.
    pub fn switch_if_due(&mut self, tick: u64, promise_held: bool, judge: &impl Judge) {
        self.watch_switch(tick, promise_held);
        let Some(at) = self.swaps.due(tick) else { return };
        let request = self.swaps.requests[at];
        match self.gate(&request, tick, judge) {
            Ok(step_nm) => {
                self.swaps.requests.remove(at);
                self.switch(&request, tick, step_nm);
            }
            Err((reason, value, limit)) => {
                let hopeless = matches!(
                    reason,
                    Refusal::UnknownController | Refusal::AlreadyActive | Refusal::Gone | Refusal::TickPassed
                );
                let timed_out = tick >= request.since_tick + self.rules.timeout_ticks;
                // A named tick is kept or refused; only a swap without one waits.
                if hopeless || timed_out || request.at_tick != 0 {
                    self.swaps.requests.remove(at);
                    self.happen(HappeningKind::SwapRefused, request.to, u64::from(reason.code()), value);
                    let refused = Reply { tick, value, limit, ..Self::refused(reason) };
                    self.swaps.conclude(request.to, refused);
                }
            }
        }
    }

    /// The gate; the torque step (N·m) if it passes, or why not with the number found and the one allowed.
    fn gate(&mut self, request: &Request, tick: u64, judge: &impl Judge) -> Result<f64, (Refusal, f64, f64)> {
        let rules = self.rules;
        if request.to == self.active {
            return Err((Refusal::AlreadyActive, 0.0, 0.0));
        }
        let Some(to) = self.member(request.to).copied() else { return Err((Refusal::Gone, 0.0, 0.0)) };
        let Some(new) = to.answer else { return Err((Refusal::NotOnTime, 0.0, f64::from(rules.consecutive))) };
        if matches!(to.standing, Standing::Fenced { .. }) {
            return Err((Refusal::NotOnTime, f64::from(to.streak), f64::from(rules.consecutive)));
        }
        // Safety checks from here, which nobody may skip; the loop refuses what is not finite before it comes here.
        if let Some((tau, limit)) = new.tau.iter().zip(&rules.torque_limit_nm).find(|(tau, limit)| tau.abs() > **limit)
        {
            return Err((Refusal::NotFinite, *tau, *limit));
        }
        let active = self.active;
        let old = self.member(active).and_then(|m| m.answer).map(|t| t.tau);
        let step_nm = old.map_or(0.0, |old| largest_step(&old, &new.tau));
        if request.force {
            return Ok(step_nm);
        }
        if to.streak < rules.consecutive {
            return Err((Refusal::NotOnTime, f64::from(to.streak), f64::from(rules.consecutive)));
        }
        if let Some(last) = self.swaps.last
            && tick < last.tick + rules.dwell_ticks
        {
            #[expect(clippy::cast_precision_loss, reason = "for display")]
            return Err((Refusal::Dwell, (tick - last.tick) as f64, rules.dwell_ticks as f64));
        }
        if request.blend_ticks == 0 && step_nm > rules.torque_step_nm {
            return Err((Refusal::TorqueStep, step_nm, rules.torque_step_nm));
        }
        match judge.level(request.to) {
            Some((v, level)) if v > level => Err((Refusal::OutsideLevel, v, level)),
            _ => Ok(step_nm),
        }
    }

    fn switch(&mut self, request: &Request, tick: u64, step_nm: f64) {
        let from = self.active;
        self.hand_over(request.to, None);
        self.swaps.last = Some(Switch { from, tick, blend_ticks: request.blend_ticks });
        self.watch =
            Some(Watch { back_to: from, until_tick: tick + self.rules.rollback_ticks, misses: Misses::default() });
        self.happen(HappeningKind::Swap, request.to, u64::from(from), step_nm);
        let done = Reply { kind: ReplyKind::Done.code(), tick, value: step_nm, ..Reply::zeroed() };
        self.swaps.conclude(request.to, done);
    }

    /// A failover takes authority from `failed`: a switch to it that was still being watched counts as taken back.
    pub(crate) fn end_watch_by_failover(&mut self, failed: u32) {
        if self.watch.take().is_some() {
            let (kind, reason) = (ReplyKind::RolledBack.code(), Refusal::Deadlines.code());
            self.swaps.conclude(failed, Reply { kind, reason, tick: self.tick, ..Reply::zeroed() });
        }
    }

    /// Takes the last switch back when the tick before broke the promise, or too many ticks had no torque on time.
    fn watch_switch(&mut self, tick: u64, promise_held: bool) {
        let Some(mut watch) = self.watch else { return };
        if tick >= watch.until_tick {
            self.watch = None;
            return;
        }
        let (active, rules) = (self.active, self.rules);
        let missed = !self.squeezed && self.member(active).is_none_or(|m| m.answer.is_none() || m.streak == 0);
        watch.misses.push(missed, rules.rollback_window);
        self.watch = Some(watch);
        let reason = if !promise_held {
            Refusal::Promise
        } else if watch.misses.count() >= rules.rollback_misses {
            Refusal::Deadlines
        } else {
            return;
        };
        let fit = self.member(watch.back_to).is_some_and(|m| m.standing == Standing::Standby && m.streak > 0);
        if !fit {
            return;
        }
        self.watch = None;
        self.hand_over(watch.back_to, None);
        self.swaps.forget_switch();
        self.happen(HappeningKind::Rollback, watch.back_to, u64::from(reason.code()), 0.0);
        let kind = ReplyKind::RolledBack.code();
        self.swaps.conclude(active, Reply { kind, reason: reason.code(), tick, ..Reply::zeroed() });
    }
}

fn largest_step(old: &Links, new: &Links) -> f64 {
    old.iter().zip(new).map(|(old, new)| (old - new).abs()).fold(0.0, f64::max)
}
