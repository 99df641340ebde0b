//! Lockstep in one process: the same plant, controllers and reference as in a group, called in turn.
//!
//! It proves that the processes add nothing (the records must be bit-identical to a group's), and it is what the
//! studies run, many cases at once.

use loopbound_controller::{Builtin, ControllerCore};
use loopbound_plant::PlantCore;
use loopbound_plant::lockstep::{judge, open};
use loopbound_reference::Generator;
use loopbound_shared::cast;
use loopbound_shared::event::{CommandKind, Refusal};
use loopbound_shared::realtime::Privileges;
use loopbound_shared::sample::{Command, TickRecord, Torque};
use loopbound_shared::scenario::{Scenario, ScenarioError};

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
        for part in cast::controllers(scenario) {
            let core = ControllerCore::new(scenario, part.id, Builtin::new(scenario, part.law)?);
            plant.learn(&core.announcement(Privileges::default()));
            controllers.push((part.id, core));
        }
        for command in cast::opening_commands(scenario, scenario.loop_.ticks()) {
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
        let setpoint = self.reference.setpoint(tick, &self.reference.faults_at(tick));
        self.plant.setpoints.enter(&setpoint, N);
        let state = open(&mut self.plant, tick, &self.scenario);
        self.answers.clear();
        let mut killed = Vec::new();
        for (id, controller) in &mut self.controllers {
            controller.setpoints.enter(&setpoint, N);
            let faults = controller.faults_at(tick);
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
