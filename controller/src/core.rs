//! One tick of a controller without a clock: setpoint, law, injected faults. All modes drive this same code.

use loopbound_scenario::{Mode, Role, Scenario};
use loopbound_shared::event::{self, Phase};
use loopbound_shared::fault::board::{Board, Injected};
use loopbound_shared::fault::{FaultActions, FaultPlan};
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
    faults: FaultPlan,
    /// The newest one that was injected by command, and the board's version then.
    injected: Option<Injected>,
    board_seen: u64,
    id: u32,
    links: usize,
    virtual_time: bool,
    /// How far this process's stamps are off, on purpose.
    clock_off_ns: i64,
}

impl<C: Controller> ControllerCore<C> {
    /// The frame around `controller`, as number `id` of the group.
    #[must_use]
    pub fn new(scenario: &Scenario, id: u32, controller: C) -> Self {
        Self {
            controller,
            setpoints: SetpointBook::new(scenario.period_ns()),
            faults: FaultPlan::for_target(scenario, Role::Controller, id),
            injected: None,
            board_seen: 0,
            id,
            links: scenario.links(),
            virtual_time: scenario.loop_.mode == Mode::Lockstep,
            clock_off_ns: 0,
        }
    }

    /// The controller inside.
    pub fn controller(&self) -> &C {
        &self.controller
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

    /// What befalls this controller in a tick, on purpose.
    #[must_use]
    pub fn faults_at(&self, tick: u64) -> FaultActions {
        let mut actions = self.faults.at_tick(tick);
        if let Some(injected) = &self.injected {
            injected.add_to(&mut actions, self.id, tick);
        }
        actions
    }

    /// Looks for a fault that was injected by command since the last look.
    pub fn heed(&mut self, board: &Board) {
        self.injected = board.read_newer(&mut self.board_seen).or(self.injected);
    }

    /// An instant as this process stamps it: the clock may have been set wrong on purpose.
    #[must_use]
    pub fn stamp_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_add_signed(self.clock_off_ns)
    }

    /// Virtual stamps: everything happens at s_k, but for what is delayed on purpose.
    pub fn stamp_virtually(&self, state: &State, torque: &mut Torque) {
        torque.received_ns = self.stamp_ns(state.published_ns);
        torque.published_ns = self.stamp_ns(state.published_ns + torque.virtual_delay_ns);
    }

    /// The answer to a state. Stamps other than those of its inputs are left to the loop. A state that has no setpoint
    /// yet, or that a fault lets go unanswered, is answered by the marker *withheld*, which only lockstep publishes.
    pub fn answer(&mut self, state: &State, faults: &FaultActions) -> Torque {
        self.clock_off_ns = self.clock_off_ns.saturating_add(faults.clock_step_ns);
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
        self.spoil(&mut torque, faults);
        torque
    }

    fn spoil(&self, torque: &mut Torque, faults: &FaultActions) {
        if faults.nan {
            torque.tau[..self.links].fill(f64::NAN);
        }
        if let Some((link, value_nm)) = faults.glitch {
            torque.tau[link.min(self.links - 1)] += value_nm;
        }
        if self.virtual_time {
            torque.virtual_delay_ns = faults.delay_ns;
            let mark = |happens: bool, flag: u32| if happens { flag } else { 0 };
            torque.flags |= mark(faults.duplicate, torque_flag::TWICE)
                | mark(faults.reorder, torque_flag::WITHHELD | torque_flag::AFTER_ITS_TIME)
                | mark(faults.rogue_nm.is_some(), torque_flag::ROGUE);
        }
        if faults.drop || faults.hang_ns > 0 {
            torque.flags |= torque_flag::WITHHELD;
        }
    }
}
