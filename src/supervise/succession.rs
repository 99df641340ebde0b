//! Who comes after whom: restarts with back-off, new members, retirement of those that were replaced, priorities.
//!
//! A controller's number is never given twice: what a dead one may still have under way is of a stranger.

use loopbound_scenario::Role;
use loopbound_shared::clock;
use loopbound_shared::event::{CommandKind, Refusal};
use loopbound_shared::realtime::{priority, set_priority};
use loopbound_shared::sample::Command;

use super::Supervisor;
use super::child::Child;
use super::ending::LEAVE_NS;
use crate::supervise::processes::Process;

impl Supervisor<'_> {
    /// A process that joined a running group is ready: the plant learns of a controller, and a death is recovered.
    pub(super) fn admit(&mut self, pid: u32) {
        let Some(child) = self.children.iter().find(|c| c.pid == pid) else { return };
        let (role, id, replaces, name) = (child.process.role, child.process.id, child.replaces, child.process.name());
        let admitted = role != Role::Controller
            || self
                .command(Command { kind: CommandKind::AddMember.code(), controller: id, ..Command::zeroed() })
                .inspect_err(|why| self.note(&format!("{name}: {why}")))
                .is_ok();
        if let Some(child) = self.children.iter_mut().find(|c| c.pid == pid) {
            child.member = admitted && role == Role::Controller;
        }
        self.set_priorities();
        let Some(dead) = replaces else { return };
        if admitted {
            self.note(&format!("{name} is ready, in place of the one that died"));
        }
        for death in self.deaths.iter_mut().filter(|d| d.role == role.name() && d.id == dead) {
            death.recovered |= admitted;
        }
    }

    /// Notes when to start it again. In lockstep a controller is not: the tick in which it would be back depends on the
    /// machine, and runs would differ.
    pub(super) fn plan_restart(&mut self, process: Process, restarts: u32, replaces: u32) {
        if !(self.lockstep() && process.role == Role::Controller) {
            self.restarts.plan(clock::now_ns(), process, restarts, replaces);
        }
    }

    pub(super) fn start_due(&mut self) {
        let now_ns = clock::now_ns();
        while let Some(mut due) = self.restarts.look(now_ns) {
            if due.process.role == Role::Controller {
                due.process.id = self.restarts.take_id();
            }
            match self.start_child(due.process.clone(), due.restarts) {
                Ok(mut child) => {
                    child.replaces = Some(due.replaces);
                    let dead = |c: &Child| c.process.role == due.process.role && c.process.id == due.replaces;
                    self.children.retain(|c| !dead(c));
                    self.children.push(child);
                }
                Err(why) => {
                    self.note(&format!("{why:#}"));
                    self.plan_restart(due.process, due.restarts, due.replaces);
                }
            }
        }
    }

    /// Authority went from `from` to `to` in `tick`: if the scenario had scheduled that, `from` is replaced for good, unless
    /// a later swap goes back to it. Before its tick the new one is a standby, which may have to step in: nobody is replaced
    /// by that. In lockstep `from` stays: when it would go depends on the machine.
    pub(super) fn retire_after_scheduled(&mut self, from: u32, to: u32, tick: u64) {
        let period_ns = self.scenario.period_ns();
        let first_id = self.scenario.controller.standby + 2;
        let started = self.scenario.swap.iter().filter(|swap| swap.to.is_none());
        let scheduled = (first_id..).zip(started).any(|(id, swap)| id == to && swap.at.tick(period_ns) <= tick);
        let needed = self.scenario.swap.iter().any(|swap| swap.to == Some(from));
        let lives = self.controllers().any(|c| c.process.id == from && c.lives());
        if scheduled && lives && !needed && !self.lockstep() {
            self.retirements.plan(clock::now_ns(), from, self.scenario.swap_gate.retire_after.ns());
        }
    }

    /// Lets those go whose time is over.
    pub(super) fn retire_due(&mut self) {
        let now_ns = clock::now_ns();
        while let Some(due) = self.retirements.look(now_ns, self.active) {
            let id = due.id;
            let of = |c: &Child| c.process.role == Role::Controller && c.process.id == id;
            let Some(index) = self.children.iter().position(of) else { continue };
            if self.children[index].member && self.children[index].lives() {
                let kind = CommandKind::RemoveMember.code();
                // Between the look at who is active and the command there may be a failover.
                let remove = Command { kind, controller: id, option: 1, ..Command::zeroed() };
                match self.ask_plant(remove) {
                    Ok(reply) if reply.reason == Refusal::AlreadyActive.code() => {
                        self.retirements.is_active(now_ns, due);
                        continue;
                    }
                    Ok(_) => {}
                    Err(why) => self.note(&format!("controller {id}: {why}")),
                }
            }
            self.children[index].retiring_since_ns = Some(now_ns);
            // What a process does to end takes milliseconds: not above those who still control. Without the privilege it
            // has no real-time priority to lose.
            let _ = set_priority(self.children[index].worker_pid(), 0);
            self.children[index].terminate();
        }
    }

    /// Forgets those that have gone as they were asked to, and ends those that don't heed it.
    pub(super) fn bury_retired(&mut self) {
        let over_ns = clock::now_ns().saturating_sub(LEAVE_NS);
        self.children.iter().filter(|c| c.retiring_since_ns.is_some_and(|ns| ns < over_ns)).for_each(Child::kill);
        while let Some(index) = self.children.iter().position(|c| c.retiring_since_ns.is_some() && !c.lives()) {
            let child = self.children.remove(index);
            child.remove_log();
            self.clean_up_the_dead();
        }
    }

    /// Standbys run above the active controller: when that one dies, the kernel takes it down at its own priority, on
    /// the core where a standby is to answer the same tick.
    pub(super) fn set_priorities(&self) {
        for child in self.controllers().filter(|c| c.ready() && c.member) {
            let wanted = self.scenario.realtime.priority + u32::from(child.process.id != self.active);
            // Only who has real time by its own start-up; a refusal costs a failover's margin, not the run.
            if priority(child.worker_pid()).is_ok_and(|now| now != 0 && now != wanted) {
                let _ = set_priority(child.worker_pid(), wanted);
            }
        }
    }
}
