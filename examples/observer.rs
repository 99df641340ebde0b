//! What watching costs: the same loop with no, one and four attached monitors, with monitors that join and leave, and with the
//! live view on a terminal (by `script`), interleaved; prints ratios of p50 and p99 to the unwatched loop, with confidence intervals.
//!
//! The launcher's own monitor is part of every run; "unwatched" means that nobody else is there.
//!
//! ```text
//! cargo build --release && cargo run --release --example observer -- --rounds 8
//! ```

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use loopbound::commands::check::read_blocks;
use loopbound_monitor::verdict::blocks::Blocks;
use loopbound_monitor::verdict::comparison::compare;
use loopbound_shared::clock;
use loopbound_shared::say;

const PERIOD_NS: u64 = 1_000_000;
const RUN_S: u64 = 4;
/// Names of the arrangements, and how many monitors each has.
const CASES: [(&str, usize); 5] = [("none", 0), ("one", 1), ("four", 4), ("joining and leaving", 1), ("live view", 1)];

fn monitor(executable: &Path, group: &str, duration: &str) -> anyhow::Result<Child> {
    let mut command = Command::new(executable);
    command.args(["monitor", "--group", group, "--json", "--duration", duration]);
    Ok(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?)
}

/// The live view on a terminal that nobody looks at; it ends with the group.
fn live_view(executable: &Path, group: &str) -> anyhow::Result<Child> {
    let line = format!("stty cols 130 rows 40; exec {} monitor --group {group} --tui", executable.display());
    let mut command = Command::new("script");
    command.args(["--quiet", "--flush", "--command", &line, "/dev/null"]);
    Ok(command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()?)
}

fn run(executable: &Path, case: usize, out: &Path) -> anyhow::Result<Blocks> {
    let group = format!("observer-{}", std::process::id());
    let mut command = Command::new(executable);
    command.args(["run", "--quiet", "--duration", &format!("{RUN_S}s"), "--group", &group, "--out"]).arg(out);
    let mut launcher = command.stdout(Stdio::null()).spawn()?;
    clock::sleep_until_ns(clock::now_ns() + 800_000_000);
    let mut monitors = Vec::new();
    let comes_and_goes = CASES[case].0 == "joining and leaving";
    if comes_and_goes {
        while launcher.try_wait()?.is_none() {
            monitor(executable, &group, "200ms")?.wait()?;
        }
    } else if CASES[case].0 == "live view" {
        monitors.push(live_view(executable, &group)?);
    } else {
        for _ in 0..CASES[case].1 {
            monitors.push(monitor(executable, &group, "60s")?);
        }
    }
    launcher.wait()?;
    for mut child in monitors {
        child.wait()?;
    }
    Ok(read_blocks(out)?)
}

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip_while(|arg| arg != "--rounds").skip(1);
    let rounds: u32 = args.next().and_then(|value| value.parse().ok()).unwrap_or(8);
    let own = std::env::current_exe()?;
    let executable: PathBuf = own.parent().and_then(Path::parent).unwrap_or(Path::new(".")).join("loopbound");
    let out = std::env::temp_dir().join(format!("loopbound-observer-{}", std::process::id()));
    let mut all: Vec<Blocks> = CASES.iter().map(|_| Blocks::new(PERIOD_NS)).collect();
    for round in 0..rounds as usize {
        // Each round begins elsewhere, so that what drifts hits no case more than another.
        for at in 0..CASES.len() {
            let case = (round + at) % CASES.len();
            let blocks = &mut all[case];
            // The first second, in which the monitors come, is left out for all alike; but not where they go on coming.
            for block in run(&executable, case, &out)?.closed().iter().filter(|block| block.index >= 5) {
                blocks.push(block.clone());
            }
        }
    }
    std::fs::remove_dir_all(&out)?;
    say::out!("{rounds} rounds of {RUN_S} s each, 1 kHz; ratio to no attached monitor, 95 %");
    for (case, blocks) in all.iter().enumerate().skip(1) {
        for ratio in compare(&all[0], blocks) {
            let wanted = ratio.hop == "round_trip" || ratio.hop == "deadline_to_torque";
            if wanted && (ratio.quantile == "p50" || ratio.quantile == "p99") {
                let (lower, upper) = (ratio.lower.unwrap_or(f64::NAN), ratio.upper.unwrap_or(f64::NAN));
                say::out!(
                    "{:<22}{:<20}{:<6}{:.3}  {lower:.3} to {upper:.3}",
                    CASES[case].0,
                    ratio.hop,
                    ratio.quantile,
                    ratio.ratio.unwrap_or(f64::NAN)
                );
            }
        }
    }
    Ok(())
}
