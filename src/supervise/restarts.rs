//! Which processes are started again, and when: twice as late each time, and not for ever. A controller's number is never
//! given twice: what a dead one may still have under way is of a stranger.

use loopbound_scenario::{Scenario, controllers};

use super::processes::Process;

/// A process that is to be started again.
#[derive(Debug)]
pub(super) struct Due {
    pub(super) process: Process,
    /// How often, with this time.
    pub(super) restarts: u32,
    /// The number of the one that died.
    pub(super) replaces: u32,
    at_ns: u64,
}

/// Those that wait for their start.
#[derive(Debug)]
pub(super) struct Restarts {
    due: Vec<Due>,
    next_id: u32,
    restarts_max: u32,
    back_off_ns: u64,
    back_off_max_ns: u64,
}

impl Restarts {
    /// Nobody waits; numbers go on after those of the scenario.
    pub(super) fn new(scenario: &Scenario) -> Self {
        let section = &scenario.supervisor;
        Self {
            due: Vec::new(),
            next_id: controllers::of(scenario).iter().map(|part| part.id).max().unwrap_or(0) + 1,
            restarts_max: section.restarts_max,
            back_off_ns: section.back_off.ns(),
            back_off_max_ns: section.back_off_max.ns(),
        }
    }

    /// The number of a controller that is about to be started.
    pub(super) fn take_id(&mut self) -> u32 {
        self.next_id += 1;
        self.next_id - 1
    }

    /// Notes when to start `process` again, which was `restarts` times already, in place of number `replaces`.
    pub(super) fn plan(&mut self, now_ns: u64, process: Process, restarts: u32, replaces: u32) {
        if restarts < self.restarts_max {
            let doubled_ns = self.back_off_ns.saturating_mul(1 << restarts.min(30));
            let at_ns = now_ns.saturating_add(doubled_ns.min(self.back_off_max_ns));
            self.due.push(Due { process, restarts: restarts + 1, replaces, at_ns });
        }
    }

    /// The next one to start now.
    pub(super) fn look(&mut self, now_ns: u64) -> Option<Due> {
        let at = self.due.iter().position(|due| due.at_ns <= now_ns)?;
        Some(self.due.remove(at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_process_is_started_again_twice_as_late_each_time_until_it_is_given_up() {
        let scenario = Scenario::default();
        let section = &scenario.supervisor;
        let mut restarts = Restarts::new(&scenario);
        let process = super::super::processes::table(&scenario, Path::new("s.toml"), None).remove(0);
        let mut now_ns = 0;
        for time in 0..section.restarts_max {
            restarts.plan(now_ns, process.clone(), time, 1);
            let wait_ns = section.back_off.ns().saturating_mul(1 << time).min(section.back_off_max.ns());
            assert!(restarts.look(now_ns + wait_ns - 1).is_none(), "{time}");
            now_ns += wait_ns;
            assert_eq!(restarts.look(now_ns).map(|due| (due.restarts, due.replaces)), Some((time + 1, 1)));
        }
        restarts.plan(now_ns, process, section.restarts_max, 1);
        assert!(restarts.look(u64::MAX).is_none());
    }

    #[test]
    fn numbers_go_on_after_those_of_the_scenario_and_none_comes_twice() {
        let mut scenario = Scenario::default();
        scenario.controller.standby = 2;
        let mut restarts = Restarts::new(&scenario);
        assert_eq!([restarts.take_id(), restarts.take_id()], [4, 5]);
    }
}
