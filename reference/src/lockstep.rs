//! The reference's loop on virtual time: wait until the plant has moved on, then publish what is missing of the lead

use loopbound_shared::clock;
use loopbound_shared::doorbell::Bell;

use crate::ports::{Ahead, Ports};

/// Ticks that the reference runs ahead of the plant; less than a reader's buffer, several of the blocks in which the
/// plant rings.
pub(crate) const LEAD_TICKS: u64 = 1024;
/// How often to look whether the group still lives.
const LOOK_NS: u64 = 20_000_000;

/// In virtual time a setpoint has no instant of publication.
pub(crate) const fn now_ns() -> u64 {
    0
}

pub(crate) fn run<const N: usize>(ahead: &mut Ahead<N>, ports: &Ports, stopped: &dyn Fn() -> bool) {
    let block = &ports.joined.block;
    while !stopped() {
        let seen = ports.plant_tick();
        block.wait(Bell::Pace, clock::now_ns() + LOOK_NS, || (ports.plant_tick() != seen).then_some(()));
        if ahead.publish(ports, now_ns) {
            block.ring(Bell::Pace);
        }
        ports.update_connections();
    }
}
