//! A swap by command, step by step between two looks: start the new process, make it a member, ask the plant, watch
//! what becomes of it, answer, and retire whoever is not needed any more.

use std::collections::VecDeque;

use loopbound_model::with_links;
use loopbound_monitor::judge::Judge;
use loopbound_monitor::summary::SwapSummary;
use loopbound_monitor::tracker::segments;
use loopbound_monitor::{Config, Row, Tracker};
use loopbound_scenario::{Restart, Role, Scenario, ScenarioError};
use loopbound_shared::clock;
use loopbound_shared::event::{CommandKind, Refusal, ReplyKind};
use loopbound_shared::sample::{Announce, Command, Reply, TickRecord};

use super::Supervisor;
use super::child::Child;
use super::control::{Answer, Client, Request, SwapReport, SwapRequest};
use super::starting::READY_NS;
use crate::exit::Exit;
use crate::supervise::processes::Process;

/// Latencies before and after are those of so long, and misses count for less.
const COMPARED_NS: u64 = 100_000_000;

/// How long records are read at one look, and at the last one.
const READ_NS: u64 = 20_000_000;
const READ_LAST_NS: u64 = 1_000_000_000;
/// Requests answered at one look: deaths and signals wait no longer than for these.
const REQUESTS_MAX: usize = 16;

/// A swap under way.
pub(super) struct Swapping {
    client: Client,
    request: SwapRequest,
    asked_ns: u64,
    /// The first tick whose record is of any use: latencies before the switch are those of a while.
    from_tick: u64,
    /// Whether a process was started for it.
    started: bool,
    stage: Stage,
    account: Account,
    report: SwapReport,
}

enum Stage {
    /// The new process is starting.
    Starting,
    /// The plant has the command.
    Asked,
    /// Done; may be taken back until this tick.
    Watched(u64),
}

impl Supervisor<'_> {
    /// Takes new requests, and goes on with the swap under way.
    pub(super) fn serve_clients(&mut self) {
        let own_run = self.group.run_id().to_string();
        for _ in 0..REQUESTS_MAX {
            let Some((client, request)) = self.control.accept() else { break };
            match request {
                Err(why) => client.answer(&Answer::Usage(format!("the request is not understood: {why}"))),
                Ok(request) if request.run().is_some_and(|run| run != own_run) => {
                    let run = request.run().unwrap_or_default();
                    client.answer(&Answer::Usage(format!("the request is for run {run}, and this is run {own_run}")));
                }
                // The tick in which a command arrives depends on the machine: no two runs would be alike.
                Ok(request) if self.lockstep() => client.answer(&Answer::Usage(only_scheduled(&request))),
                Ok(Request::Fault(request)) => client.answer(&self.inject(&request)),
                Ok(Request::Swap(_)) if self.swap.is_some() => client.answer(&self.at_once(Refusal::Busy, 0)),
                Ok(Request::Swap(request)) => self.begin_swap(client, request),
            }
        }
        if let Some(swap) = self.swap.take() {
            self.swap = self.go_on(swap);
        }
    }

    /// A refusal before the plant was asked.
    fn at_once(&self, reason: Refusal, to: u32) -> Answer {
        self.refused(reason.name().to_owned(), to)
    }

    fn refused(&self, reason: String, to: u32) -> Answer {
        Answer::Report(Box::new(SwapReport {
            group: self.group.name().to_owned(),
            from: self.active,
            to,
            tick: self.tick(),
            result: "refused".to_owned(),
            reason: Some(reason),
            ..SwapReport::default()
        }))
    }

    /// Why the run leaves no time for a swap, with the tick that it needs and the one that is allowed: so that it does not
    /// wait for what will not come, with every other swap behind it.
    fn no_time_for(&self, request: &SwapRequest) -> Option<(Refusal, u64, u64)> {
        let (now, end) = (self.tick(), self.end_tick());
        if let Some(at) = request.at_tick.filter(|at| *at <= now) {
            return Some((Refusal::TickPassed, at, now + 1));
        }
        let blend_ns = request.blend_ns.unwrap_or(self.scenario.swap_gate.blend.ns());
        // The first tick of the new one and the first after the cross-fade.
        let first = request.at_tick.unwrap_or(now + 1);
        let after = first.saturating_add(blend_ns.div_ceil(self.scenario.period_ns()).max(1));
        (after > end).then_some((Refusal::BeyondEnd, after - 1, end - 1))
    }

    fn begin_swap(&mut self, client: Client, request: SwapRequest) {
        let named = [request.law.is_some(), request.exe.is_some(), request.to.is_some()];
        if named.into_iter().filter(|given| *given).count() != 1 {
            return client.answer(&Answer::Usage("exactly one of law, exe and to is needed".to_owned()));
        }
        if let Some((reason, value, limit)) = self.no_time_for(&request) {
            let Answer::Report(mut report) = self.at_once(reason, request.to.unwrap_or(0)) else { return };
            (report.value, report.limit) = (Some(value as f64), Some(limit as f64));
            return client.answer(&Answer::Report(report));
        }
        let to = match request.to {
            Some(to) if self.controllers().any(|c| c.process.id == to && c.ready() && c.member) => to,
            Some(to) => return client.answer(&self.at_once(Refusal::UnknownController, to)),
            None => self.take_id(),
        };
        if request.to.is_none() {
            let process = Process {
                role: Role::Controller,
                id: to,
                law: request.law,
                exe: request.exe.clone(),
                scenario: self.group.file("scenario.toml"),
                // Until it is in charge its death is nobody's loss.
                policy: Restart::Ignore,
                out: None,
            };
            match self.start_child(process, 0) {
                Ok(child) => self.children.push(child),
                Err(why) if Exit::of(&why) == Exit::Usage => {
                    return client.answer(&Answer::Usage(format!("{why:#}")));
                }
                Err(why) => return client.answer(&self.refused(format!("{why:#}"), to)),
            }
        }
        let account = match Account::new(self.scenario) {
            Ok(account) => account,
            Err(why) => return client.answer(&Answer::Usage(why.to_string())),
        };
        let report = SwapReport { group: self.group.name().to_owned(), from: self.active, to, ..SwapReport::default() };
        let (asked_ns, started) = (clock::now_ns(), request.to.is_none());
        let from_tick = self.tick().saturating_sub(2 * COMPARED_NS / self.scenario.period_ns());
        let stage = Stage::Starting;
        self.swap = Some(Swapping { client, request, asked_ns, from_tick, started, stage, account, report });
    }

    fn go_on(&mut self, mut swap: Swapping) -> Option<Swapping> {
        for announce in self.controllers().filter_map(|c| c.announce.as_ref()) {
            swap.account.learn(announce);
        }
        self.read_records(&mut swap, u64::MAX, READ_NS);
        if !matches!(swap.stage, Stage::Watched(_)) && swap.client.has_left() {
            return self.cancel(swap);
        }
        match swap.stage {
            Stage::Starting => self.ask_when_ready(swap),
            Stage::Asked => self.look_at_asked(swap),
            Stage::Watched(until_tick) => self.look_at_watched(swap, until_tick),
        }
    }

    /// Takes the records up to `until_tick` that have come into the account, for `for_ns` at most: on a busy machine they may
    /// come faster than they are judged, and the group needs its supervisor for more than this. Those from long before the
    /// swap was asked for are passed over.
    fn read_records(&self, swap: &mut Swapping, until_tick: u64, for_ns: u64) {
        let until_ns = clock::now_ns() + for_ns;
        let Swapping { account, report, from_tick, .. } = swap;
        let mut next = || {
            self.records.take_with(|record| {
                if record.tick >= *from_tick {
                    account.feed(record, report.to);
                }
                record.tick < until_tick
            })
        };
        while next() == Some(true) && clock::now_ns() < until_ns {}
    }

    /// Whoever asked has left: a swap that still waits is forgotten, so that others can be asked for.
    fn cancel(&mut self, swap: Swapping) -> Option<Swapping> {
        if matches!(swap.stage, Stage::Asked) {
            let (kind, controller) = (CommandKind::CancelSwap.code(), swap.report.to);
            let reply = self.ask_plant(Command { kind, controller, ..Command::zeroed() });
            // It was faster: what has happened is watched to its end.
            if reply.is_ok_and(|reply| reply.kind == ReplyKind::Done.code()) {
                return self.look_at_asked(swap);
            }
        }
        self.conclude(swap, "refused", Some(Refusal::Cancelled.name().to_owned()))
    }

    fn ask_when_ready(&mut self, mut swap: Swapping) -> Option<Swapping> {
        let to = swap.report.to;
        let Some(child) = self.controllers().find(|c| c.process.id == to).filter(|c| c.lives()) else {
            let child = self.controllers().find(|c| c.process.id == to);
            let said = child.and_then(Child::last_words).map_or_else(String::new, |said| format!(": {said}"));
            return self.conclude(swap, "refused", Some(format!("the new process ended before it was ready{said}")));
        };
        if !child.member {
            let late = clock::now_ns() >= swap.asked_ns + READY_NS;
            // Ready, and the plant would not have it: it was said why.
            let refused = child.ready();
            if !late && !refused {
                return Some(swap);
            }
            let why = if refused { "the plant has no room for it" } else { "the new process did not become ready" };
            return self.conclude(swap, "refused", Some(why.to_owned()));
        }
        swap.report.from = self.active;
        let command = Command {
            kind: CommandKind::Swap.code(),
            controller: to,
            tick: swap.request.at_tick.unwrap_or(0),
            ns: swap.request.blend_ns.unwrap_or(self.scenario.swap_gate.blend.ns()),
            option: u64::from(swap.request.force),
            ..Command::zeroed()
        };
        match self.command(command) {
            Ok(_) => {
                swap.stage = Stage::Asked;
                Some(swap)
            }
            Err(why) => self.conclude(swap, "refused", Some(why)),
        }
    }

    fn status_of(&self, swap: &Swapping) -> Option<(ReplyKind, Reply)> {
        let kind = CommandKind::SwapStatus.code();
        let reply = self.ask_plant(Command { kind, controller: swap.report.to, ..Command::zeroed() }).ok()?;
        Some((ReplyKind::from_code(reply.kind)?, reply))
    }

    fn look_at_asked(&mut self, mut swap: Swapping) -> Option<Swapping> {
        match self.status_of(&swap) {
            Some((ReplyKind::Done, reply)) => Some(self.watch_from(swap, reply.tick)),
            // A failover was faster than the gate: the new one is in charge, as was asked.
            Some((ReplyKind::Refused, reply)) if reply.reason == Refusal::AlreadyActive.code() && swap.started => {
                swap.report.reason = Some("a failover gave it authority before the gate did".to_owned());
                Some(self.watch_from(swap, reply.tick))
            }
            Some((ReplyKind::Refused, reply)) => self.refuse(swap, "refused", &reply),
            Some((ReplyKind::RolledBack, reply)) => self.refuse(swap, "rolled back", &reply),
            Some((ReplyKind::Pending, _)) => Some(swap),
            None => self.conclude(swap, "refused", Some("the plant does not answer".to_owned())),
        }
    }

    /// The change is done, in this tick or, by a failover, before it.
    fn watch_from(&self, mut swap: Swapping, tick: u64) -> Swapping {
        let gate = &self.scenario.swap_gate;
        let blend_ns = swap.request.blend_ns.unwrap_or(gate.blend.ns());
        let watched_ns = gate.rollback_for.ns().max(COMPARED_NS).max(blend_ns);
        swap.report.tick = tick;
        swap.stage = Stage::Watched(tick + watched_ns.div_ceil(self.scenario.period_ns()) + 1);
        swap
    }

    fn look_at_watched(&mut self, mut swap: Swapping, until_tick: u64) -> Option<Swapping> {
        match self.status_of(&swap) {
            Some((ReplyKind::RolledBack, reply)) => self.refuse(swap, "rolled back", &reply),
            _ if self.tick() <= until_tick && !self.plant_ended() => Some(swap),
            _ => {
                self.read_records(&mut swap, until_tick, READ_LAST_NS);
                let reason = swap.report.reason.take();
                self.conclude(swap, "done", reason)
            }
        }
    }

    fn refuse(&mut self, mut swap: Swapping, result: &str, reply: &Reply) -> Option<Swapping> {
        let reason = Refusal::from_code(reply.reason).map_or("no reason given", Refusal::name);
        swap.report.tick = if swap.report.tick == 0 { reply.tick } else { swap.report.tick };
        (swap.report.value, swap.report.limit) = (Some(reply.value), Some(reply.limit));
        self.conclude(swap, result, Some(reason.to_owned()))
    }

    /// Answers, and says who goes.
    fn conclude(&mut self, mut swap: Swapping, result: &str, reason: Option<String>) -> Option<Swapping> {
        let (from, to) = (swap.report.from, swap.report.to);
        (swap.report.result, swap.report.reason) = (result.to_owned(), reason);
        if swap.report.tick == 0 {
            swap.report.tick = self.tick();
        }
        swap.account.complete(&mut swap.report, swap.asked_ns, self.scenario.period_ns());
        if result == "done" {
            let policy = self.scenario.supervisor.controller;
            if let Some(child) = self.children.iter_mut().find(|c| c.process.id == to && c.member) {
                child.process.policy = policy;
            }
            // An exchange with a standby retires nobody.
            if swap.started {
                self.plan_retirement(from, self.scenario.swap_gate.retire_after.ns());
            }
        } else if swap.started {
            // At the next look: by then it is known who is in charge now.
            self.plan_dismissal(to);
        }
        let why = swap.report.reason.as_ref().map_or_else(String::new, |why| format!(": {why}"));
        self.note(&format!("swap from controller {from} to {to} in tick {}: {result}{why}", swap.report.tick));
        swap.client.answer(&Answer::Report(Box::new(swap.report)));
        None
    }
}

fn only_scheduled(request: &Request) -> String {
    let (what, key) = match request {
        Request::Swap(_) => ("swaps", "swap"),
        Request::Fault(_) => ("faults", "fault"),
    };
    format!("in lockstep {what} are scheduled: write them as [[{key}]] in the scenario")
}

/// What the records say of a swap, judged as the monitor judges.
struct Account {
    tracker: Box<dyn Judged>,
    rows: VecDeque<(u64, Option<u64>)>,
    /// The tick in which a torque of the new controller first acted, and when it was accepted.
    first: Option<(u64, u64)>,
    learnt: Vec<u32>,
    rows_max: usize,
}

/// A tracker of any number of links.
trait Judged {
    fn learn(&mut self, announce: &Announce);
    fn feed(&mut self, record: &TickRecord) -> Option<Row>;
    fn swap_to(&self, id: u32, tick: u64) -> Option<&SwapSummary>;
}

impl<const N: usize> Judged for Tracker<N> {
    fn learn(&mut self, announce: &Announce) {
        Self::learn(self, announce);
    }

    fn feed(&mut self, record: &TickRecord) -> Option<Row> {
        let row = Self::feed(self, record);
        // Nobody reads these events here: the monitor writes its own.
        self.drain_events().for_each(drop);
        row
    }

    fn swap_to(&self, id: u32, tick: u64) -> Option<&SwapSummary> {
        change_to(self.swaps().list(), id, tick)
    }
}

fn tracker<const N: usize>(scenario: &Scenario) -> Result<Box<dyn Judged>, ScenarioError> {
    Ok(Box::new(Tracker::<N>::new(Config::of(scenario), Some(Judge::new(scenario)?))))
}

impl Account {
    fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let links = scenario.links();
        Ok(Self {
            tracker: with_links!(links, tracker::<N>(scenario))?,
            rows: VecDeque::new(),
            first: None,
            learnt: Vec::new(),
            rows_max: usize::try_from(COMPARED_NS / scenario.period_ns()).unwrap_or(0).max(1),
        })
    }

    fn learn(&mut self, announce: &Announce) {
        if !self.learnt.contains(&announce.id) {
            self.learnt.push(announce.id);
            self.tracker.learn(announce);
        }
    }

    fn feed(&mut self, record: &TickRecord, to: u32) {
        let Some(row) = self.tracker.feed(record) else { return };
        self.rows.push_back((row.tick, row.round_trip_ns));
        if self.first.is_none() {
            self.first = first_of(record, to);
            if self.first.is_none() && self.rows.len() > self.rows_max {
                self.rows.pop_front();
            }
        }
    }

    fn complete(&self, report: &mut SwapReport, asked_ns: u64, period_ns: u64) {
        let carried_out = report.result != "refused";
        if let Some(swap) = self.tracker.swap_to(report.to, report.tick).filter(|_| carried_out) {
            report.tick = swap.tick;
            (report.missed_ticks, report.delta_v) = (swap.missed_ticks, swap.delta_v);
            report.torque_step_nm.clone_from(&swap.torque_steps_nm);
            (report.torque_difference_nm, report.blended_ticks) = (swap.torque_difference_nm, swap.blended_ticks);
        }
        let Some((first, accepted_ns)) = self.first else { return };
        let compared = COMPARED_NS / period_ns;
        let round_trips = |from: u64, to: u64| {
            let within = self.rows.iter().filter(move |(tick, _)| (from..to).contains(tick));
            median(within.filter_map(|(_, round_trip_ns)| *round_trip_ns).collect())
        };
        report.latency_before_ns = round_trips(first.saturating_sub(compared), first);
        report.latency_after_ns = round_trips(first, first + compared);
        report.command_to_authority_ns = Some(accepted_ns.saturating_sub(asked_ns));
    }
}

/// The tick in which a torque of `to` first acts, and when it was accepted.
fn first_of(record: &TickRecord, to: u32) -> Option<(u64, u64)> {
    let acts = segments(record).iter().any(|segment| segment.writer == to);
    acts.then_some((record.tick, record.accepted_ns))
}

/// The change by which controller `id` came to be in charge in `tick`. A failover may have been faster than the gate: then
/// the plant only knows that it is in charge by then. Later ones, there and back, are none of the swap.
fn change_to(list: &[SwapSummary], id: u32, tick: u64) -> Option<&SwapSummary> {
    let mut changes = list.iter().filter(|swap| swap.to == id && swap.result != "refused" && swap.tick <= tick);
    changes.clone().find(|swap| swap.tick == tick).or_else(|| changes.next())
}

fn median(mut values: Vec<u64>) -> Option<u64> {
    values.sort_unstable();
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_account_of_a_swap_is_of_the_change_that_it_made_or_of_the_failover_before_it() {
        let change = |tick, to, result: &str| SwapSummary { tick, to, result: result.to_owned(), ..Default::default() };
        let list = [change(5, 2, "refused"), change(7, 2, "done"), change(9, 1, "done"), change(11, 2, "done")];
        let tick_of = |id, tick| change_to(&list, id, tick).map(|swap| swap.tick);
        assert_eq!(tick_of(2, 7), Some(7), "not that of the failovers after it");
        assert_eq!(tick_of(2, 11), Some(11));
        assert_eq!(tick_of(2, 10), Some(7), "the plant was asked three ticks after the failover");
        assert_eq!((tick_of(2, 5), tick_of(3, 20)), (None, None));
    }

    #[test]
    fn the_median_of_nothing_is_nothing() {
        assert_eq!((median(vec![]), median(vec![3, 1, 2])), (None, Some(2)));
    }
}
