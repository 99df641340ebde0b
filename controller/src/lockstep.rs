//! The controller's loop on virtual time: it answers each state as soon as it comes, and has the setpoint of the very
//! tick, for which it waits if need be.

use loopbound_shared::clock;
use loopbound_shared::doorbell::Bell;
use loopbound_shared::sample::state_flag;

use crate::Controller;
use crate::ports::Ports;
use crate::tick::ControllerCore;

/// How long to spin for the next state before sleeping at the doorbell: a few ticks of lockstep.
const SPIN_NS: u64 = 20_000;
/// How often to look whether the group still lives.
const LOOK_NS: u64 = 50_000_000;

pub(crate) fn run<C: Controller>(core: &mut ControllerCore<C>, ports: &Ports, stopped: &dyn Fn() -> bool) {
    let (block, links) = (&ports.joined.block, ports.joined.scenario.links());
    let mut ticks: u64 = 0;
    while !stopped() {
        // Joins are rare, and mapping them costs: looked for now and then, and whenever nothing comes.
        if ticks.is_multiple_of(64) {
            ports.update_connections();
        }
        let until_ns = clock::now_ns() + LOOK_NS;
        let Some(state) = ports.states_bell.wait_lockstep(block, until_ns, SPIN_NS, || ports.states.take()) else {
            ports.update_connections();
            continue;
        };
        if state.flags & state_flag::LAST != 0 {
            return;
        }
        ticks += 1;
        ports.drain_setpoints(&mut core.setpoints, links);
        while !core.setpoints.has(state.tick) && !stopped() {
            block.wait(Bell::Pace, clock::now_ns() + 2_000_000, || {
                ports.drain_setpoints(&mut core.setpoints, links);
                core.setpoints.has(state.tick).then_some(())
            });
        }
        let faults = core.injector.at_tick(state.tick);
        core.injector.take_time(&faults);
        let mut torque = core.answer(&state, &faults);
        core.stamp_virtually(&state, &mut torque);
        ports.torques.send(torque);
        // In lockstep everyone waits at the doorbell, whatever the mode.
        block.ring(Bell::Torque);
    }
}
