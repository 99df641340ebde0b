//! The end of a group, in order: the plant, then the monitor with its summary, then the rest; nobody is left.

use std::sync::atomic::Ordering::SeqCst;

use loopbound_shared::clock;
use loopbound_shared::doorbell::Bell;
use loopbound_shared::event::CommandKind;
use loopbound_shared::sample::Command;
use loopbound_shared::scenario::Role;

use super::child::Child;
use super::record::Death;
use super::{End, Outcome, Supervisor};

/// Time for the plant to close its last tick and end.
const PLANT_NS: u64 = 1_000_000_000;
/// Time for the monitor to take the last records and write its files.
const SUMMARY_NS: u64 = 5_000_000_000;
/// Time for everyone to end by themselves, and again after SIGTERM.
const LEAVE_NS: u64 = 1_000_000_000;

impl Supervisor<'_> {
    /// Ends everyone, reaps everyone, and collects what is known.
    ///
    /// # Errors
    /// Why the group did not start.
    pub(super) fn finish(mut self, end: End) -> anyhow::Result<Outcome> {
        if let End::NotStarted(failure) = end {
            self.end_everyone();
            return Err(failure.into());
        }
        let asked = matches!(end, End::Stopped(_) | End::Policy(_));
        if asked && self.ready_ns != 0 {
            // Without an answer the plant is terminated below, like whoever does not listen.
            let _ =
                self.command(Command { kind: CommandKind::StopAt.code(), tick: self.tick() + 1, ..Command::zeroed() });
        }
        if self.ready_ns != 0 {
            self.end_plant();
            let died = self.children.iter().find(|c| c.process.role == Role::Plant).is_some_and(plant_died);
            self.say_that_the_plant_ended();
            if died {
                self.record_plant_death();
            }
            self.wait_for(Role::Monitor, SUMMARY_NS);
        }
        let summary = std::fs::read(self.group.file("summary.json")).ok();
        self.end_everyone();
        let stopped = if let End::Stopped(exit) = end { Some(exit) } else { None };
        Ok(Outcome {
            record: self.record(&end),
            summary: summary.and_then(|bytes| serde_json::from_slice(&bytes).ok()),
            stopped,
        })
    }

    fn end_plant(&mut self) {
        let period_ns = self.scenario.period_ns();
        if !self.wait_for(Role::Plant, PLANT_NS + 2 * period_ns) {
            self.children.iter().filter(|c| c.process.role == Role::Plant).for_each(Child::terminate);
            if !self.wait_for(Role::Plant, LEAVE_NS) {
                self.children.iter().filter(|c| c.process.role == Role::Plant).for_each(Child::kill);
                self.wait_for(Role::Plant, LEAVE_NS);
            }
        }
    }

    /// A plant that was killed could not say so itself; whoever waits for it looks again now.
    fn say_that_the_plant_ended(&self) {
        self.block.pace().plant_ended.store(1, SeqCst);
        for bell in [Bell::State, Bell::Torque, Bell::Pace] {
            self.block.ring(bell);
        }
    }

    fn record_plant_death(&mut self) {
        let tick = self.tick();
        let plants = self.children.iter().filter(|c| c.process.role == Role::Plant);
        self.deaths.extend(plants.map(|plant| Death {
            role: plant.process.role.to_string(),
            id: plant.process.id,
            pid: plant.pid,
            tick,
            how: plant.how_ended(),
            recovered: false,
        }));
    }

    /// Waits until every process of `role` has ended, at most `timeout_ns`; whether all have.
    fn wait_for(&mut self, role: Role, timeout_ns: u64) -> bool {
        self.wait_until_ended(|child| child.process.role == role, timeout_ns)
    }

    fn wait_until_ended(&mut self, whom: impl Fn(&Child) -> bool, timeout_ns: u64) -> bool {
        let until_ns = clock::now_ns().saturating_add(timeout_ns);
        loop {
            for child in &mut self.children {
                child.reap();
            }
            let now_ns = clock::now_ns();
            let all_ended = !self.children.iter().any(|child| child.lives() && whom(child));
            if all_ended || now_ns >= until_ns {
                return all_ended;
            }
            self.wait_for_an_end((until_ns - now_ns).min(10_000_000));
        }
    }

    /// By themselves if the plant has told them, else on SIGTERM, else by SIGKILL. Then the roster shows it.
    fn end_everyone(&mut self) {
        let told = self.plant_ended();
        if !(told && self.wait_until_ended(|_| true, LEAVE_NS)) {
            self.children.iter().for_each(Child::terminate);
            if !self.wait_until_ended(|_| true, LEAVE_NS) {
                self.children.iter().for_each(Child::kill);
                self.wait_until_ended(|_| true, LEAVE_NS);
            }
        }
        for child in &self.children {
            self.block.clear_place_of(child.pid);
        }
        self.node.clean_up_dead_nodes();
    }
}

fn plant_died(plant: &Child) -> bool {
    plant.ended.is_none_or(|(status, _)| !status.success())
}
