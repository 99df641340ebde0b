//! Kills of the controller in charge, one after the other, in a group with a standby.

use loopbound_shared::clock;
use loopbound_shared::say;
use serde_json::Value;

use crate::live::{Live, in_state, kill, spread};
use crate::trace::Trace;

const SETTINGS: [&str; 5] = [
    "loop.duration=2h",
    "controller.standby=1",
    "supervisor.restarts_max=100000",
    "supervisor.back_off=20ms",
    "supervisor.back_off_max=20ms",
];
/// Time between two kills in which the standby shows that it is one.
const STEADY_NS: u64 = 150_000_000;
/// A successor is ready within this on a busy machine.
const SUCCESSOR_NS: u64 = 10_000_000_000;

pub(crate) fn run(count: u32) -> anyhow::Result<u32> {
    let mut live = Live::start("kills", &SETTINGS)?;
    for _ in 0..count {
        let both = live.wait("no standby", SUCCESSOR_NS, |roster| {
            in_state(roster, "active").is_some() && in_state(roster, "standby").is_some()
        })?;
        // One that has just joined, or was fenced by a stall of the machine, is a standby after twenty good answers.
        clock::sleep_ns(STEADY_NS);
        let victim = in_state(&both, "active").map_or(0, |entry| entry.pid);
        kill(victim);
        live.wait("nobody took over", SUCCESSOR_NS, |roster| {
            in_state(roster, "active").is_some_and(|entry| entry.pid != victim)
        })?;
    }
    let (summary, end_ns) = live.end()?;
    let swaps = summary["swaps"].as_array().cloned().unwrap_or_default();
    let failovers: Vec<&Value> = swaps.iter().filter(|swap| swap["kind"] == "failover").collect();
    let figure = |key: &str| failovers.iter().filter_map(|swap| swap[key].as_f64()).collect::<Vec<_>>();
    let ticks: Vec<u64> = failovers.iter().filter_map(|swap| swap["tick"].as_u64()).collect();
    say::out!("kills of the active controller: {count}; failovers {}", failovers.len());
    Trace::read(live.out.path())?.print_missed("a failover", &ticks);
    say::out!("  ticks missed in all: {} of {}", summary["counters"]["missed"], summary["counters"]["ticks"]);
    say::out!("  torque step at the failover, N·m: {}", spread(figure("torque_step_nm")));
    say::out!("  held, damped: {}, {}", summary["counters"]["held"], summary["counters"]["damped"]);
    say::out!("  bound: {}, slack min {}", summary["bound"]["verdicts"], summary["bound"]["slack_min"]);
    say::out!("  the group ended within {:.2} s", end_ns as f64 * 1e-9);
    Ok(u32::from(end_ns > 2_000_000_000))
}
