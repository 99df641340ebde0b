//! One tick of the reference without a clock: the setpoint, with the faults that are injected into it. All modes drive this same code.

use loopbound_model::trajectory::Trajectory;
use loopbound_scenario::{Scenario, ScenarioError};
use loopbound_shared::clock;
use loopbound_shared::event::Role;
use loopbound_shared::fault::{FaultActions, Injector};
use loopbound_shared::sample::{Origin, Setpoint, to_links};

/// The setpoints of a scenario, tick by tick, without a clock.
pub struct Generator<const N: usize> {
    trajectory: Trajectory<N>,
    /// The faults that are injected into this reference.
    pub injector: Injector<Setpoint>,
    period_ns: u64,
    id: u32,
}

impl<const N: usize> Generator<N> {
    /// The motion of a scenario.
    ///
    /// # Errors
    /// If the scenario describes no motion.
    pub fn new(scenario: &Scenario, id: u32) -> Result<Self, ScenarioError> {
        Ok(Self {
            trajectory: scenario.build_trajectory()?,
            injector: Injector::new(scenario, loopbound_scenario::Role::Reference, id),
            period_ns: scenario.period_ns(),
            id,
        })
    }

    /// The setpoint of a tick, stamped as published at `now_ns` (0 in lockstep). A fault may repeat that of the tick before, or
    /// make it no number.
    #[must_use]
    pub fn setpoint(&mut self, tick: u64, faults: &FaultActions, now_ns: u64) -> Setpoint {
        self.injector.step_clock(faults);
        let value = self.trajectory.at(clock::seconds(faults.setpoint_tick(tick) * self.period_ns));
        let mut setpoint = Setpoint {
            origin: Origin::in_process(Role::Reference),
            tick,
            plant_ns: tick * self.period_ns,
            published_ns: self.injector.stamp_ns(now_ns),
            writer: self.id,
            links: u32::try_from(N).unwrap_or(0),
            q_d: to_links(&value.q_d),
            v_d: to_links(&value.v_d),
            a_d: to_links(&value.a_d),
        };
        self.injector.spoil(&mut setpoint, faults);
        setpoint
    }
}
