//! Swaps between three laws in one group: every other one with a cross-fade.

use serde_json::Value;

use crate::live::{Live, spread};

/// Each with whether it fades.
const ROUND: [(&str, bool); 6] =
    [("robust-ff", true), ("ctc", false), ("robust", true), ("robust-ff", false), ("ctc", true), ("robust", false)];

/// The gate as it is, but shorter waits, so that hundreds of swaps take minutes.
const SETTINGS: [&str; 4] =
    ["loop.duration=2h", "swap_gate.rollback_for=100ms", "swap_gate.retire_after=100ms", "swap_gate.dwell=50ms"];

pub(crate) fn run(count: u32) -> anyhow::Result<u32> {
    let mut live = Live::start("swaps", &SETTINGS)?;
    let (mut done, mut missed, mut with_missed) = (0, 0, 0);
    let mut refusals: Vec<String> = Vec::new();
    let (mut faded, mut hard, mut to_authority_ms) = (Vec::new(), Vec::new(), Vec::new());
    for (number, (law, fades)) in (1..=count).zip(ROUND.into_iter().cycle()) {
        let mut arguments = vec!["--law", law];
        if fades {
            arguments.extend(["--blend", "20ms"]);
        }
        let report = live.swap(&arguments)?;
        if report["result"] != "done" {
            refusals.push(format!("swap {number} to {law}: {} ({})", report["result"], report["reason"]));
            continue;
        }
        done += 1;
        let ticks = report["missed_ticks"].as_u64().unwrap_or(0);
        (missed, with_missed) = (missed + ticks, with_missed + u32::from(ticks > 0));
        let steps = report["torque_step_nm"].as_array().into_iter().flatten().filter_map(Value::as_f64);
        let largest = steps.map(f64::abs).fold(0.0, f64::max);
        if fades {
            faded.push(largest)
        } else {
            hard.push(largest)
        }
        to_authority_ms.extend(report["command_to_authority_ns"].as_f64().map(|ns| ns * 1e-6));
    }
    let (summary, end_ns) = live.end()?;
    let ordinary = ordinary_step(&live.out.path().join("samples.csv"))?;
    println!("swaps: {done} of {count} done, {} not", refusals.len());
    refusals.iter().for_each(|line| println!("  {line}"));
    println!("  missed ticks within 50 ms of a switch: {missed}, in {with_missed} swaps");
    println!("  missed ticks in all: {} of {}", summary["counters"]["missed"], summary["counters"]["ticks"]);
    println!("  torque step at a hard switch, N·m: {}", spread(hard));
    println!("  torque step with --blend 20ms, N·m: {}", spread(faded));
    println!("  torque step of ordinary ticks, N·m: {ordinary}");
    println!("  command to authority, ms: {}", spread(to_authority_ms));
    println!("  causes of the missed: {}", summary["missed_ticks_by_cause"]);
    println!("  bound: {}", summary["bound"]);
    println!("  group {} ended within {:.2} s", live.name, end_ns as f64 * 1e-9);
    Ok(u32::from(end_ns > 2_000_000_000))
}

/// Steps between one tick's torque and the next over the whole run, as text.
fn ordinary_step(samples: &std::path::Path) -> anyhow::Result<String> {
    let text = std::fs::read_to_string(samples)?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let columns: Vec<usize> = (0..header.len()).filter(|i| header[*i].starts_with("tau")).collect();
    let mut steps = Vec::new();
    let mut before: Option<Vec<f64>> = None;
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let tau: Vec<f64> = columns.iter().filter_map(|i| cells.get(*i)?.parse().ok()).collect();
        if let Some(before) = before.replace(tau.clone()) {
            steps.push(tau.iter().zip(&before).map(|(new, old)| (new - old).abs()).fold(0.0, f64::max));
        }
    }
    Ok(spread(steps))
}
