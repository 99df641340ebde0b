//! The start of a group: everyone becomes ready, then the plant gets its members and its clock.

use loopbound_scenario::Role;
use loopbound_shared::clock;
use loopbound_shared::opening;

use super::child::Child;
use super::ending::LEAVE_NS;
use super::{End, Supervisor, refusal};
use crate::exit::{Exit, Failure};

/// Time for every process to become ready.
pub(super) const READY_NS: u64 = 10_000_000_000;

impl Supervisor<'_> {
    /// `None` when all are ready.
    pub(super) fn wait_until_ready(&mut self) -> Option<End> {
        let until_ns = self.started_ns + READY_NS;
        loop {
            self.listen();
            if let Some(exit) = self.options.stop.requested() {
                return Some(End::Stopped(exit));
            }
            if let Some(child) = self.who_did_not_start() {
                return Some(End::NotStarted(not_started(child)));
            }
            let missing: Vec<String> = self.children.iter().filter(|c| !c.ready()).map(|c| c.process.name()).collect();
            if missing.is_empty() {
                // What two processes made together while they started.
                if let Err(why) = self.group.take_room() {
                    return Some(End::NotStarted(Failure { exit: Exit::Internal, message: why.to_string() }));
                }
                self.ready_ns = clock::now_ns();
                return None;
            }
            if clock::now_ns() >= until_ns {
                let message = format!("not ready within {} s: {}", READY_NS / clock::NS_PER_S, missing.join(", "));
                return Some(End::NotStarted(Failure { exit: Exit::RoleDied, message }));
            }
            clock::sleep_ns(1_000_000);
        }
    }

    /// One that has ended, and not because another did: when the plant ends, everyone else does so in order.
    fn who_did_not_start(&mut self) -> Option<&Child> {
        if self.children.iter_mut().filter_map(|child| child.reap().then_some(())).count() == 0 {
            return None;
        }
        if self.plant_ended() {
            self.wait_for(Role::Plant, LEAVE_NS);
        }
        let ended = || self.children.iter().filter(|child| !child.lives());
        let failed = ended().find(|child| child.ended.is_some_and(|(status, _)| !status.success()));
        failed.or_else(|| ended().find(|child| child.process.role == Role::Plant)).or_else(|| ended().next())
    }

    /// Gives the plant its members and its clock, then watches until the end.
    pub(super) fn run(&mut self) -> End {
        let start = opening::commands(self.scenario, self.scenario.loop_.ticks());
        for command in start {
            let failure = match self.ask_plant(command) {
                Ok(reply) => refusal(command, reply).map(|why| (Exit::Internal, why)),
                // A plant that has ended, or is stopped: a role is lost, and nothing is wrong with the rest.
                Err(why) => Some((Exit::RoleDied, why)),
            };
            let Some((exit, why)) = failure else { continue };
            let mut plants = self.children.iter_mut().filter(|c| c.process.role == Role::Plant);
            let ended = plants.find_map(|plant| plant.reap().then_some(&*plant));
            let message = format!("the plant did not start: {why}");
            return End::NotStarted(ended.map_or(Failure { exit, message }, not_started));
        }
        self.active = 1;
        for child in &mut self.children {
            child.member = child.process.role == Role::Controller;
        }
        self.set_priorities();
        self.watch()
    }
}

fn not_started(child: &Child) -> Failure {
    let said = child.said();
    let why = if said.is_empty() { child.how_ended() } else { said.join("\n  ") };
    Failure {
        exit: match child.ended.and_then(|(status, _)| status.code()) {
            Some(code) if code == i32::from(Exit::Usage.code()) => Exit::Usage,
            // A want of the machine's, which the child has named.
            Some(code) if code == i32::from(Exit::Internal.code()) => Exit::Internal,
            _ => Exit::RoleDied,
        },
        message: format!("{} did not start: {why}", child.process.name()),
    }
}
