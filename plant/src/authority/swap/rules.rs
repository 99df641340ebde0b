//! The rules of `[swap_gate]`, in ticks.

use loopbound_model::chain::LINKS_MAX;
use loopbound_scenario::Scenario;
use loopbound_shared::sample::Links;

/// What the gate demands, and what rolls a swap back.
#[derive(Clone, Copy, Debug)]
pub struct SwapRules {
    /// On-time, finite torques in a row before the switch.
    pub consecutive: u32,
    /// Largest torque step of one joint without a cross-fade, N·m.
    pub torque_step_nm: f64,
    /// Shortest time since the last switch.
    pub dwell_ticks: u64,
    /// How long a swap without a named tick waits for its gate.
    pub timeout_ticks: u64,
    /// m of K: so many ticks without a torque on time …
    pub rollback_misses: u32,
    /// … among so many roll back.
    pub rollback_window: u32,
    /// How long after a switch.
    pub rollback_ticks: u64,
    /// The period, for the length of cross-fades.
    pub period_ns: u64,
    /// Torque limits of the joints, N·m.
    pub torque_limit_nm: Links,
}

impl SwapRules {
    /// The rules of a scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        let (gate, period_ns) = (&scenario.swap_gate, scenario.period_ns());
        let ticks = |ns: u64| ns.div_ceil(period_ns);
        Self {
            consecutive: gate.consecutive,
            torque_step_nm: gate.torque_step_nm,
            dwell_ticks: ticks(gate.dwell.ns()),
            timeout_ticks: ticks(gate.timeout.ns()),
            rollback_misses: gate.rollback_misses,
            rollback_window: gate.rollback_window,
            rollback_ticks: ticks(gate.rollback_for.ns()),
            period_ns,
            torque_limit_nm: limits(scenario),
        }
    }
}

/// One entry a joint, infinite where nothing is limited.
fn limits(scenario: &Scenario) -> Links {
    let mut limits = [f64::INFINITY; LINKS_MAX];
    for (limit, written) in limits.iter_mut().zip(scenario.plant.torque_limit_nm()) {
        *limit = written;
    }
    limits
}
