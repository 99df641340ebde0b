//! The reference's loop on the machine's clock: sleep for a part of the lead, then publish what is missing of it

use loopbound_scenario::Scenario;
use loopbound_shared::clock;

use crate::ports::{Ahead, Ports};

/// Ticks that the reference publishes ahead of the plant.
pub(crate) fn lead_ticks(scenario: &Scenario) -> u64 {
    scenario.setpoint_lead_ns().div_ceil(scenario.period_ns())
}

pub(crate) fn run<const N: usize>(ahead: &mut Ahead<N>, ports: &Ports, stopped: &dyn Fn() -> bool) {
    let scenario = &ports.joined.scenario;
    // Often enough that most of the lead is always there.
    let nap_ns = (lead_ticks(scenario) * scenario.period_ns() / 8).clamp(1_000_000, 20_000_000);
    while !stopped() {
        clock::sleep_until_ns(clock::now_ns() + nap_ns);
        ahead.publish(ports, clock::now_ns);
        ports.update_connections();
    }
}
