//! Whoever asks by the control socket: takes requests, and carries out the orders of the swap under way.

use loopbound_monitor::account::Account;
use loopbound_monitor::handover::Handover as _;
use loopbound_scenario::{Restart, Role};
use loopbound_shared::clock;
use loopbound_shared::event::Refusal;

use super::Supervisor;
use super::child::Child;
use super::control::{Answer, Client, Request, SwapReport, SwapRequest};
use super::processes::Process;
use super::swapping::{Newcomer, Order, Swapping, View};
use crate::exit::Exit;

/// Requests answered at one look: deaths and signals wait no longer than for these.
const REQUESTS_MAX: usize = 16;

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
        if let Some((client, swap)) = self.swap.take() {
            self.swap = self.go_on(client, swap);
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
            None => self.restarts.take_id(),
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
        let (group, now_ns) = (self.group.name(), clock::now_ns());
        self.swap = Some((client, Swapping::new(request, self.scenario, group, self.active, to, now_ns)));
    }

    fn newcomer(&self, id: u32) -> Newcomer {
        match self.controllers().find(|child| child.process.id == id) {
            Some(child) if child.lives() && child.member => Newcomer::Member,
            // Ready, and the plant would not have it: it was said why.
            Some(child) if child.ready() => Newcomer::Refused,
            Some(child) if child.lives() => Newcomer::Starting,
            child => Newcomer::Ended(child.and_then(Child::last_words)),
        }
    }

    /// One look at the swap under way; none is left when it is concluded.
    fn go_on(&mut self, client: Client, mut swap: Swapping) -> Option<(Client, Swapping)> {
        let status = swap.question().and_then(|command| self.ask_plant(command).ok());
        let account = Account::read(&self.group.file(Account::FILE));
        let view = View {
            newcomer: self.newcomer(swap.to()),
            client_left: client.has_left(),
            active: self.active,
            tick: self.tick(),
            plant_ended: self.plant_ended(),
            status: status.as_ref(),
            account: account.as_ref(),
        };
        let mut order = swap.look(clock::now_ns(), &view);
        while let Some(Order::Ask(command)) = order {
            order = swap.answered(command, self.command(command));
        }
        match order {
            None => Some((client, swap)),
            Some(_) => {
                self.conclude(client, swap);
                None
            }
        }
    }

    /// Answers, and says who goes.
    fn conclude(&mut self, client: Client, swap: Swapping) {
        let started = swap.has_started_one();
        let report = swap.into_report(self.tick());
        let (from, to) = (report.from, report.to);
        if report.result == "done" {
            let policy = self.scenario.supervisor.controller;
            if let Some(child) = self.children.iter_mut().find(|c| c.process.id == to && c.member) {
                child.process.policy = policy;
            }
            // An exchange with a standby retires nobody.
            if started {
                self.retirements.plan(clock::now_ns(), from, self.scenario.swap_gate.retire_after.ns());
            }
        } else if started {
            // At the next look: by then it is known who is active now.
            self.retirements.dismiss(clock::now_ns(), to);
        }
        let why = report.reason.as_ref().map_or_else(String::new, |why| format!(": {why}"));
        self.note(&format!("swap from controller {from} to {to} in tick {}: {}{why}", report.tick, report.result));
        client.answer(&Answer::Report(Box::new(report)));
    }
}

fn only_scheduled(request: &Request) -> String {
    let (what, key) = match request {
        Request::Swap(_) => ("swaps", "swap"),
        Request::Fault(_) => ("faults", "fault"),
    };
    format!("in lockstep {what} are scheduled: write them as [[{key}]] in the scenario")
}
