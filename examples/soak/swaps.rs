//! Swaps between three laws in one group: every other one with a cross-fade.

use loopbound_shared::say;

use crate::live::{Live, spread};
use crate::trace::Trace;

/// Each with whether it fades. To and from `robust` a hard switch is refused sooner or later: it has no model, and its
/// torque is another wherever gravity asks for much.
const ROUND: [(&str, bool); 6] =
    [("robust-ff", true), ("ctc", false), ("robust-ff", false), ("robust", true), ("ctc", true), ("robust", true)];

const BLEND: &str = "20ms";
/// The same at 1 kHz, and the tick after it.
const BLEND_TICKS: u64 = 21;

/// The gate as it is, but shorter waits, so that hundreds of swaps take minutes.
const SETTINGS: [&str; 4] =
    ["loop.duration=2h", "swap_gate.rollback_for=100ms", "swap_gate.retire_after=100ms", "swap_gate.dwell=50ms"];

pub(crate) fn run(count: u32) -> anyhow::Result<u32> {
    let mut live = Live::start("swaps", &SETTINGS)?;
    let mut done = 0;
    let mut refusals: Vec<String> = Vec::new();
    let (mut faded, mut hard, mut to_authority_ms) = (Vec::new(), Vec::new(), Vec::new());
    let mut switches = Vec::new();
    for (number, (law, fades)) in (1..=count).zip(ROUND.into_iter().cycle()) {
        let mut arguments = vec!["--law", law];
        if fades {
            arguments.extend(["--blend", BLEND]);
        }
        let report = live.swap(&arguments)?;
        if report["result"] != "done" {
            refusals.push(format!("swap {number} to {law}: {} ({})", report["result"], report["reason"]));
            continue;
        }
        done += 1;
        let tick = report["tick"].as_u64().unwrap_or(0);
        switches.push(tick);
        if fades {
            faded.push(tick)
        } else {
            hard.push(tick)
        }
        to_authority_ms.extend(report["command_to_authority_ns"].as_f64().map(|ns| ns * 1e-6));
    }
    let (summary, end_ns) = live.end()?;
    let trace = Trace::read(live.out.path())?;
    say::out!("swaps: {done} of {count} done, {} not", refusals.len());
    refusals.iter().for_each(|line| say::out!("  {line}"));
    trace.print_missed("a switch", &switches);
    let steps = |ticks: &[u64], within: u64| spread(ticks.iter().filter_map(|t| trace.step(*t, within)).collect());
    say::out!("  torque step at a hard switch, N·m: {}", steps(&hard, 1));
    say::out!("  torque step at a switch with --blend {BLEND}, N·m: {}", steps(&faded, 1));
    say::out!("  largest step of a tick in such a fade, N·m: {}", steps(&faded, BLEND_TICKS));
    say::out!("  torque step of ordinary ticks, N·m: {}", spread(trace.ordinary_steps(&switches)));
    say::out!("  command to authority, ms: {}", spread(to_authority_ms));
    say::out!("  ticks missed in all: {} of {}", summary["counters"]["missed"], summary["counters"]["ticks"]);
    say::out!("  bound: {}, slack min {}", summary["bound"]["verdicts"], summary["bound"]["slack_min"]);
    say::out!("  group {} ended within {:.2} s", live.name, end_ns as f64 * 1e-9);
    Ok(u32::from(end_ns > 2_000_000_000))
}
