//! The end of a group, in order: the plant, then the monitor with its summary, then the rest; nobody is left.

use std::os::unix::process::ExitStatusExt as _;
use std::sync::atomic::Ordering::SeqCst;

use loopbound_scenario::Role;
use loopbound_shared::clock;
use loopbound_shared::doorbell::Bell;
use loopbound_shared::event::CommandKind;
use loopbound_shared::realtime::ProcessStat;
use loopbound_shared::sample::Command;

use super::child::Child;
use super::record::Death;
use super::{End, Outcome, Supervisor};

/// Time for the plant to close its last tick and end.
const PLANT_NS: u64 = 1_000_000_000;
/// A monitor that does next to nothing for so long will write no summary any more.
const IDLE_NS: u64 = 5_000_000_000;
/// The most that one tick takes it to write.
const TICK_NS: u64 = 1_000_000;
/// Hundredths of a second that it computes in that time if it is at work; one that only looks for records needs a tenth of it.
const WORK_LEAST: u64 = 50;
/// Time for the monitor to take the last records and write its files, as long as it is at work. Longer than any disk takes.
const SUMMARY_NS: u64 = 600_000_000_000;
/// Time for everyone to end by themselves, and again after SIGTERM.
pub(super) const LEAVE_NS: u64 = 1_000_000_000;

impl Supervisor<'_> {
    /// Ends everyone, reaps everyone, and collects what is known.
    ///
    /// # Errors
    /// Why the group did not start.
    pub(super) fn finish(mut self, end: End) -> anyhow::Result<Outcome> {
        self.keeper.renew(&self.group);
        if let End::NotStarted(failure) = end {
            self.end_everyone();
            return Err(failure.into());
        }
        self.resume();
        if self.ready_ns != 0 {
            let asked = matches!(end, End::Stopped(_) | End::Policy(_));
            let patience_ns = if !asked || self.ask_to_stop() { PLANT_NS + 2 * self.scenario.period_ns() } else { 0 };
            self.end_plant(patience_ns);
            self.say_that_the_plant_ended();
            self.wait_for_the_summary();
        }
        let summary = std::fs::read(self.group.file("summary.json")).ok();
        self.end_everyone();
        self.record_last_deaths();
        let stopped = if let End::Stopped(exit) = end { Some(exit) } else { None };
        Ok(Outcome {
            record: self.record(&end),
            summary: summary.and_then(|bytes| serde_json::from_slice(&bytes).ok()),
            results: None,
            stopped,
        })
    }

    /// A long recording on a busy machine takes the monitor a while: it is waited for while it works.
    fn wait_for_the_summary(&mut self) {
        // No longer than what it has seen can take.
        let until_ns = clock::now_ns() + SUMMARY_NS.min(IDLE_NS + self.tick().saturating_mul(TICK_NS));
        let mut before = self.work_of_monitor();
        while !self.wait_for(Role::Monitor, IDLE_NS) && clock::now_ns() < until_ns {
            let work = self.work_of_monitor();
            let Some((now, then)) = work.zip(before) else { return };
            if !now.waits_for_disk() && now.used < then.used + WORK_LEAST {
                return;
            }
            self.note("the monitor is still writing the files of the run");
            before = work;
        }
    }

    fn work_of_monitor(&self) -> Option<ProcessStat> {
        let monitor = self.children.iter().find(|child| child.process.role == Role::Monitor && child.lives())?;
        ProcessStat::of(monitor.pid)
    }

    /// Whether the plant has agreed to stop.
    fn ask_to_stop(&self) -> bool {
        let tick = self.tick() + 1;
        self.command(Command { kind: CommandKind::StopAt.code(), tick, ..Command::zeroed() }).is_ok()
    }

    fn end_plant(&mut self, patience_ns: u64) {
        if !self.wait_for(Role::Plant, patience_ns) {
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

    /// Whoever ended otherwise than in order and is not in the list yet: the plant, who died in the last moment, and
    /// who had to be killed. (A user's own controller may well leave its end to SIGTERM.)
    fn record_last_deaths(&mut self) {
        let tick = self.tick();
        let in_order = |c: &Child| c.ended.is_some_and(|(status, _)| status.success() || status.signal() == Some(15));
        // Whom nobody needs any more, or not yet, is no loss however it ends.
        let needed = |c: &&Child| c.retiring_since_ns.is_none() && (c.member || c.process.role != Role::Controller);
        let last = self.children.iter().filter(needed).filter(|c| !c.settled && !in_order(c));
        self.deaths.extend(last.map(|child| Death {
            role: child.process.role.to_string(),
            id: child.process.id,
            pid: child.pid,
            tick,
            how: child.how_ended(),
            recovered: false,
        }));
    }

    /// Waits until every process of `role` has ended, at most `timeout_ns`; whether all have.
    pub(super) fn wait_for(&mut self, role: Role, timeout_ns: u64) -> bool {
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
        self.clean_up_the_dead();
    }
}
