//! Which ticks the scenario's own faults leave without an answer in real time: those of a process that gives none say nothing of
//! themselves, since nothing came that could say it.
//!
//! The plan of faults is a pure function of the tick, so a monitor recomputes it. A fault is injected in a tick that its process
//! handles. One that hangs, or whose delay is longer than a period, handles nothing until it is over, and then the newest.

use loopbound_scenario::{Role, Scenario};
use loopbound_shared::fault::FaultPlan;

/// Ticks that are asked one by one; of a longer gap in the records the last ones.
const GAP_MAX: u64 = 100_000;
/// Processes whose plan is remembered.
const PROCESSES_MAX: usize = 64;

/// What a fault leaves of one process.
#[derive(Clone, Debug, PartialEq)]
struct Process {
    role: Role,
    id: u32,
    plan: FaultPlan,
    /// The next tick that it handles.
    handles: u64,
    /// The first tick that it can answer in time again.
    answers: u64,
}

impl Process {
    fn advance(&mut self, tick: u64, period_ns: u64) {
        if tick < self.handles {
            return;
        }
        let actions = self.plan.at_tick(tick);
        let pause_ns = actions.pause_ns();
        let pause = pause_ns / period_ns.max(1);
        if actions.kill || actions.hang_ns == u64::MAX {
            (self.handles, self.answers) = (u64::MAX, u64::MAX);
        } else if pause_ns >= period_ns {
            self.handles = tick.saturating_add(pause.max(1));
            self.answers = self.answers.max(tick.saturating_add(pause).saturating_add(1));
        } else if actions.leaves_no_sample() {
            self.answers = self.answers.max(tick.saturating_add(1));
        }
    }
}

/// The faults of a scenario, tick by tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Planned {
    /// None where the scenario has no faults of controllers or references: then there is nothing to ask.
    scenario: Option<Box<Scenario>>,
    period_ns: u64,
    processes: Vec<Process>,
    next: u64,
}

impl Planned {
    /// The faults of a scenario, before its first tick.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        let processes = vec![Process::new(scenario, Role::Reference, 1, 0)];
        let any = !scenario.fault.is_empty();
        Self {
            scenario: any.then(|| Box::new(scenario.clone())),
            period_ns: scenario.period_ns(),
            processes: if any { processes } else { Vec::new() },
            next: 0,
        }
    }

    /// Takes the next tick, before which the plant skipped some: their states were never published, and nobody handled them.
    /// `controllers`: those that are known in it.
    pub fn advance(&mut self, tick: u64, skipped: u64, controllers: impl Iterator<Item = u32>) {
        let Some(scenario) = self.scenario.as_deref() else { return };
        for id in controllers {
            let known = self.processes.iter().any(|process| process.role == Role::Controller && process.id == id);
            if !known && id != 0 && self.processes.len() < PROCESSES_MAX {
                self.processes.push(Process::new(scenario, Role::Controller, id, tick));
            }
        }
        let from = self.next.max(tick.saturating_sub(GAP_MAX));
        for at in (from..=tick).filter(|at| *at == tick || at.saturating_add(skipped) < tick) {
            self.processes.iter_mut().for_each(|process| process.advance(at, self.period_ns));
        }
        self.next = tick.saturating_add(1);
    }

    /// Whether a fault keeps controller `id` from answering the tick that was taken last in time.
    #[must_use]
    pub fn silences(&self, id: u32) -> bool {
        self.is_silenced(Role::Controller, id)
    }

    /// Whether a fault keeps the setpoint of the tick that was taken last away.
    #[must_use]
    pub fn withholds_setpoint(&self) -> bool {
        self.is_silenced(Role::Reference, 1)
    }

    fn is_silenced(&self, role: Role, id: u32) -> bool {
        let process = self.processes.iter().find(|process| process.role == role && process.id == id);
        process.is_some_and(|process| self.next <= process.answers && process.answers > 0)
    }
}

impl Process {
    fn new(scenario: &Scenario, role: Role, id: u32, from: u64) -> Self {
        Self { role, id, plan: FaultPlan::for_target(scenario, role, id), handles: from, answers: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ticks up to 100 in which controller 1 is kept from answering.
    fn silenced(fault: &str) -> Vec<u64> {
        let text = format!("[[fault]]\ntarget = \"controller:1\"\n{fault}");
        let mut planned = Planned::of(&Scenario::from_toml(&text, "test").unwrap());
        let mut found = Vec::new();
        for tick in 0..100 {
            planned.advance(tick, 0, [1, 2].into_iter());
            assert!(!planned.silences(2) && !planned.withholds_setpoint());
            found.extend(planned.silences(1).then_some(tick));
        }
        found
    }

    #[test]
    fn every_kind_that_leaves_a_tick_without_an_answer_is_known_and_no_other() {
        for (fault, ticks) in [
            ("kind = \"drop\"\nat = 10\nfor = 3", vec![10, 11, 12]),
            ("kind = \"nan\"\nat = 10", vec![10]),
            ("kind = \"reorder\"\nat = 10", vec![10]),
            ("kind = \"hang\"\nat = 10\nfor = \"500us\"", vec![10]),
            ("kind = \"hang\"\nat = 10\nfor = \"4500us\"", (10..=14).collect()),
            ("kind = \"hang\"\nat = 10", (10..100).collect()),
            ("kind = \"kill\"\nat = 10", (10..100).collect()),
            ("kind = \"delay\"\ndelay = \"2500us\"\nat = 10\nfor = 4", (10..=14).collect()),
            // It answers, and its answer says so.
            ("kind = \"delay\"\ndelay = \"900us\"\nat = 10", vec![]),
            ("kind = \"glitch\"\nvalue_nm = 5.0\nat = 10", vec![]),
            ("kind = \"duplicate\"\nat = 10", vec![]),
            ("kind = \"rogue\"\nat = 10", vec![]),
            ("kind = \"clock-step\"\nstep = \"-1s\"\nat = 10", vec![]),
        ] {
            assert_eq!(silenced(fault), ticks, "{fault}");
        }
    }

    #[test]
    fn a_fault_is_injected_in_a_tick_that_is_handled() {
        let text = "[[fault]]\nkind = \"hang\"\nfor = \"3ms\"\nat = 10\n[[fault]]\nkind = \"drop\"\nat = 12\n[[fault]]\nkind = \"drop\"\nat = 21";
        let mut planned = Planned::of(&Scenario::from_toml(text, "test").unwrap());
        let mut silenced = |tick: u64, skipped: u64| {
            planned.advance(tick, skipped, [1].into_iter());
            planned.silences(1)
        };
        assert_eq!([9, 10, 11, 12, 13, 14].map(|tick| silenced(tick, 0)), [false, true, true, true, true, false]);
        // Tick 21 was skipped by the plant: nobody was asked.
        assert_eq!([(20, 0), (22, 1), (23, 0)].map(|(tick, skipped)| silenced(tick, skipped)), [false; 3]);
    }

    #[test]
    fn setpoints_that_the_reference_was_made_to_keep_are_known() {
        let text = "[[fault]]\nkind = \"hang\"\ntarget = \"reference\"\nfor = \"5ms\"\nat = 10";
        let mut planned = Planned::of(&Scenario::from_toml(text, "test").unwrap());
        let withheld = (0..20).filter(|tick| {
            planned.advance(*tick, 0, [1].into_iter());
            planned.withholds_setpoint()
        });
        assert_eq!(withheld.collect::<Vec<_>>(), (10..=15).collect::<Vec<_>>());
    }
}
