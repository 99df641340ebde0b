//! Lockstep in one process: the same plant, controllers and reference as in a group, called in turn.
//!
//! It proves that the processes add nothing (the records must be bit-identical to a group's), and it is what the
//! studies run, many cases at once.

use loopbound_controller::{Builtin, ControllerCore};
use loopbound_plant::PlantCore;
use loopbound_plant::lockstep::{judge, open};
use loopbound_reference::Generator;
use loopbound_scenario::controllers;
use loopbound_scenario::{Scenario, ScenarioError};
use loopbound_shared::event::{CommandKind, Refusal};
use loopbound_shared::opening;
use loopbound_shared::realtime::Privileges;
use loopbound_shared::sample::{Command, TickRecord, Torque};

/// A group without processes, on virtual time.
pub struct InProcess<const N: usize> {
    scenario: Scenario,
    plant: PlantCore<N>,
    controllers: Vec<(u32, ControllerCore<Builtin<N>>)>,
    reference: Generator<N>,
    answers: Vec<Torque>,
    tick: u64,
}

impl<const N: usize> InProcess<N> {
    /// The group of a scenario, before its first tick. Users' executables can't be called from here: their scenarios
    /// run the law that is named beside them.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let mut plant = PlantCore::new(scenario, false)?;
        let mut controllers = Vec::new();
        for part in controllers::of(scenario) {
            let core = ControllerCore::new(scenario, part.id, Builtin::new(scenario, part.law)?);
            plant.learn(&core.announcement(Privileges::default()));
            controllers.push((part.id, core));
        }
        for command in opening::commands(scenario, scenario.loop_.ticks()) {
            if command.kind == CommandKind::Start.code() {
                // The controllers have just been added, and there is room for them: see the scenario's limits.
                let appointed = plant.authority.appoint(command.controller);
                debug_assert_eq!(appointed, Ok::<(), Refusal>(()));
            } else {
                plant.command(&command);
            }
        }
        Ok(Self {
            plant,
            answers: Vec::with_capacity(controllers.len()),
            controllers,
            reference: Generator::new(scenario, 1)?,
            scenario: scenario.clone(),
            tick: 0,
        })
    }

    /// Runs one tick; the record of the tick before, none in the first.
    pub fn step(&mut self) -> Option<&TickRecord> {
        let tick = self.tick;
        let faults = self.reference.injector.at_tick(tick);
        let setpoint = self.reference.setpoint(tick, &faults, 0);
        self.plant.setpoints.enter(&setpoint, N);
        let state = open(&mut self.plant, tick, &self.scenario);
        self.answers.clear();
        let mut killed = Vec::new();
        for (id, controller) in &mut self.controllers {
            controller.setpoints.enter(&setpoint, N);
            let faults = controller.injector.at_tick(tick);
            if faults.kill {
                killed.push(*id);
                continue;
            }
            let mut torque = controller.answer(&state, &faults);
            controller.stamp_virtually(&state, &mut torque);
            self.answers.push(torque);
        }
        for id in killed {
            // What the supervisor says when it has noticed: in this very tick, since the plant waits for it.
            self.plant.command(&Command {
                kind: CommandKind::RemoveMember.code(),
                controller: id,
                ..Command::zeroed()
            });
            self.controllers.retain(|(of, _)| *of != id);
        }
        judge(&mut self.plant, &mut self.answers, tick, &self.scenario);
        self.tick += 1;
        self.plant.closed()
    }

    /// Runs to the scenario's end, handing every record to `see`.
    pub fn run(mut self, mut see: impl FnMut(&TickRecord)) {
        for _ in 0..self.scenario.loop_.ticks() {
            if let Some(record) = self.step() {
                see(record);
            }
        }
        see(self.plant.finish(self.tick * self.scenario.period_ns()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_shared::event::{Acceptance, Decision, HappeningKind};
    use loopbound_shared::sample::Happening;

    fn records(scenario: &str) -> Vec<TickRecord> {
        let text = format!("[loop]\nmode = \"lockstep\"\nduration = \"1s\"\n{scenario}");
        let scenario = Scenario::from_toml(&text, "test").unwrap();
        let mut records = Vec::new();
        InProcess::<3>::new(&scenario).unwrap().run(|record| records.push(*record));
        assert_eq!(records.len(), 1000);
        records
    }

    fn happened(records: &[TickRecord], kind: HappeningKind) -> Vec<(u64, Happening)> {
        let of = |r: &TickRecord| {
            let happenings = r.happenings.into_iter().take(r.happenings_used as usize);
            happenings.filter(|h| h.kind == kind.code()).map(|h| (r.tick, h)).collect::<Vec<_>>()
        };
        records.iter().flat_map(of).collect()
    }

    /// Every bit of what acted and where the chain went.
    fn bits(records: &[TickRecord]) -> Vec<u64> {
        let numbers = records.iter().flat_map(|r| [r.q, r.v, r.segments[0].tau].concat());
        numbers.map(f64::to_bits).collect()
    }

    const SWAPS: &str = "[controller.gains]\nshared_v = true\n\
        [[swap]]\nat = 200\nlaw = \"robust-ff\"\nblend = \"20ms\"\n\
        [[swap]]\nat = 500\nlaw = \"ctc\"\nblend = \"50ms\"\n";

    #[test]
    fn scheduled_swaps_happen_in_their_ticks_without_a_missed_one_and_alike_every_time() {
        let records = records(SWAPS);
        let swaps: Vec<(u64, u32, u64)> =
            happened(&records, HappeningKind::Swap).iter().map(|(tick, h)| (*tick, h.subject, h.detail)).collect();
        assert_eq!(swaps, [(200, 2, 1), (500, 3, 2)]);
        assert_eq!(records[999].counters.missed, 0);
        assert_eq!((records[199].active, records[200].active, records[999].active), (1, 2, 3));
        let blended: Vec<u64> =
            records.iter().filter(|r| r.decision == Decision::Blend.code()).map(|r| r.tick).collect();
        assert_eq!(blended, (200..220).chain(500..550).collect::<Vec<u64>>());
        assert_eq!(bits(&records), bits(&super::tests::records(SWAPS)));
    }

    #[test]
    fn a_cross_fade_steps_no_more_than_ordinary_ticks_do() {
        let records = records(SWAPS);
        // The torque that acts at the end of each tick.
        let tau = |r: &TickRecord| r.segments[r.segments_used as usize - 1].tau;
        let step = |tick: usize| {
            let pair = tau(&records[tick - 1]).into_iter().zip(tau(&records[tick]));
            pair.map(|(old, new)| (new - old).abs()).fold(0.0, f64::max)
        };
        let ordinary = (100..200).chain(250..500).map(step).fold(0.0, f64::max);
        let faded = (200..220).chain(500..550).map(step).fold(0.0, f64::max);
        assert!(faded <= ordinary + 0.05, "{faded} N·m in a cross-fade, {ordinary} in ordinary ticks");
    }

    #[test]
    fn a_killed_controller_is_replaced_in_the_same_tick() {
        let records =
            records("[controller]\nstandby = 1\n[[fault]]\nkind = \"kill\"\ntarget = \"controller:1\"\nat = 300");
        let failovers = happened(&records, HappeningKind::Failover);
        assert_eq!(failovers.iter().map(|(tick, h)| (*tick, h.subject)).collect::<Vec<_>>(), [(300, 2)]);
        assert_eq!((records[999].counters.missed, records[300].active), (0, 2));
        assert_eq!(records[300].decision, Decision::Standby.code());
    }

    #[test]
    fn a_controller_that_fails_for_a_while_is_let_in_again_and_takes_over_when_the_other_dies() {
        let records = records(
            "[controller]\nstandby = 1\n\
             [[fault]]\nkind = \"nan\"\ntarget = \"controller:1\"\nat = 300\nfor = 50\n\
             [[fault]]\nkind = \"kill\"\ntarget = \"controller:2\"\nat = 600",
        );
        let failovers = happened(&records, HappeningKind::Failover);
        assert_eq!(failovers.iter().map(|(tick, h)| (*tick, h.subject)).collect::<Vec<_>>(), [(300, 2), (600, 1)]);
        assert_eq!((records[999].counters.missed, records[999].active), (0, 1));
    }

    #[test]
    fn with_nobody_left_the_plant_holds_brakes_and_stops_by_itself() {
        let records = records("[[fault]]\nkind = \"kill\"\ntarget = \"controller:1\"\nat = 300");
        let decisions: Vec<u32> = records[299..].iter().map(|r| r.decision).collect();
        let first = |decision: Decision| decisions.iter().position(|d| *d == decision.code());
        assert_eq!((first(Decision::Active), first(Decision::Held)), (Some(0), Some(1)));
        let damped = first(Decision::Damped).unwrap();
        let stopped = first(Decision::Stopped);
        assert!(stopped.is_none_or(|stopped| stopped > damped));
        let speed = |r: &TickRecord| r.v.iter().map(|v| v.abs()).fold(0.0, f64::max);
        assert!(speed(&records[999]) < speed(&records[300]), "{} rad/s at the end", speed(&records[999]));
        assert_eq!(records[999].counters.missed, 700);
    }

    #[test]
    fn every_injected_fault_of_publication_is_counted_as_what_it_is() {
        let fault = |kind: &str| format!("[[fault]]\nkind = \"{kind}\"\nat = 300\nfor = 10\n");
        let last = |text: String| records(&text)[999].counters;
        assert_eq!(last(fault("duplicate")).duplicate, 10);
        assert_eq!(last(fault("rogue")).unknown_writer, 10);
        let reordered = last(fault("reorder"));
        assert_eq!((reordered.withheld, reordered.stale, reordered.missed), (10, 10, 10));
        let late = last(fault("late"));
        assert_eq!((late.late, late.missed), (10, 10));
        let beyond = records(&format!("{}delay = \"900us\"\n", fault("late")));
        assert_eq!((beyond[999].counters.stale, beyond[999].counters.late), (10, 0), "the next tick has begun by then");
    }

    #[test]
    fn a_clock_that_jumps_changes_stamps_and_nothing_else() {
        let plain = records("");
        let jumped = records("[[fault]]\nkind = \"clock-step\"\nat = 300\nstep = \"-1s\"");
        assert_eq!(bits(&plain), bits(&jumped));
        let stamp = |r: &TickRecord| r.receipts[0].torque_published_ns;
        assert_eq!(stamp(&plain[999]), 999_000_000);
        assert_eq!(stamp(&jumped[999]), 0, "a second earlier, as far as a stamp goes");
        assert_eq!(Acceptance::from_code(jumped[999].receipts[0].acceptance), Some(Acceptance::Applied));
    }
}
