//! One tick of a controller without a clock: setpoint, law, injected faults. All modes drive this same code.

use loopbound_scenario::{Role, Scenario};
use loopbound_shared::event::{self, Phase};
use loopbound_shared::fault::{FaultActions, Injector};
use loopbound_shared::realtime::Privileges;
use loopbound_shared::role;
use loopbound_shared::sample::{Announce, Origin, State, Torque, torque_flag};
use loopbound_shared::setpoints::SetpointBook;

use crate::{Controller, Input};

/// A controller without a clock.
pub struct ControllerCore<C> {
    controller: C,
    /// The setpoints that have come.
    pub setpoints: SetpointBook,
    /// The faults that are injected into this controller.
    pub injector: Injector<Torque>,
    id: u32,
    links: usize,
}

impl<C: Controller> ControllerCore<C> {
    /// The frame around `controller`, as number `id` of the group.
    #[must_use]
    pub fn new(scenario: &Scenario, id: u32, controller: C) -> Self {
        Self {
            controller,
            setpoints: SetpointBook::new(scenario.period_ns()),
            injector: Injector::new(scenario, Role::Controller, id),
            id,
            links: scenario.links(),
        }
    }

    /// The controller inside.
    pub fn controller(&self) -> &C {
        &self.controller
    }

    /// Its number in the group.
    #[must_use]
    pub const fn id(&self) -> u32 {
        self.id
    }

    /// How many links its torques have.
    #[must_use]
    pub const fn links(&self) -> usize {
        self.links
    }

    /// Says who this is, and which law it claims to be.
    #[must_use]
    pub fn announcement(&self, privileges: Privileges) -> Announce {
        let name = self.controller.name();
        let mut ready = role::announce(event::Role::Controller, self.id, Phase::Ready, self.links, privileges, name);
        if let Some(claim) = self.controller.claim() {
            ready.set_claim(&claim);
        }
        ready
    }

    /// Virtual stamps: everything happens at s_k, except what an injected fault delays.
    pub fn stamp_virtually(&self, state: &State, torque: &mut Torque) {
        torque.received_ns = self.injector.stamp_ns(state.published_ns);
        torque.published_ns = self.injector.stamp_ns(state.published_ns + torque.virtual_delay_ns);
    }

    /// The answer to a state. Stamps other than those of its inputs are left to the loop. A state that has no setpoint
    /// yet, or that a fault lets go unanswered, is answered by the marker *withheld*, which only lockstep publishes.
    pub fn answer(&mut self, state: &State, faults: &FaultActions) -> Torque {
        self.injector.step_clock(faults);
        let mut torque = Torque {
            origin: Origin::in_process(event::Role::Controller),
            tick: state.tick,
            state_published_ns: state.published_ns,
            writer: self.id,
            epoch: state.epoch,
            links: state.links,
            flags: if faults.any() { torque_flag::FAULT_INJECTED } else { 0 },
            ..Torque::zeroed()
        };
        // The number of links is compile-time in the plant and its law; here it must fit before anything is sliced.
        let setpoint = self.setpoints.at_links(state.tick, state.setpoint_offset_ns);
        let (Some(setpoint), true) = (setpoint, state.links as usize == self.links) else {
            torque.flags |= torque_flag::WITHHELD;
            return torque;
        };
        (torque.q_d, torque.v_d, torque.a_d) = (setpoint.q_d, setpoint.v_d, setpoint.a_d);
        (torque.setpoint_tick, torque.setpoint_published_ns) = (setpoint.tick, setpoint.published_ns);
        if setpoint.stale {
            torque.flags |= torque_flag::SETPOINT_STALE;
        }
        let n = self.links;
        let input = Input {
            tick: state.tick,
            time_s: loopbound_shared::clock::seconds(state.plant_ns),
            q: &state.q[..n],
            v: &state.v[..n],
            q_d: &setpoint.q_d[..n],
            v_d: &setpoint.v_d[..n],
            a_d: &setpoint.a_d[..n],
        };
        self.controller.torque(&input, &mut torque.tau[..n]);
        self.injector.spoil(&mut torque, faults);
        torque
    }
}
