//! Is a verdict right? Short runs of unchanged code under a load that comes and goes, and runs with a regression built
//! in, each judged by the same expectations; prints the counts, and ends with 1 if one is not what it must be.
//!
//! ```text
//! cargo build --release && cargo run --release --example verdict_soak -- --runs 100 --regressions 50
//! ```

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use loopbound::commands::study::load::background::{Background, Rhythm, Work};
use loopbound_shared::say;
use serde_json::Value;

/// What every run is judged by. The two regressions are far beyond these, and no load of ordinary priority is.
const SCENARIO: &str = r#"
[loop]
duration = "2s"

[expect]
max_duration = "3.5s"
"round_trip.p50" = "<= 15us"
"compute.p99_9" = "<= 100us"
"bound.violations_delay_aware" = "== 0"
"#;
const SLOWER: &str = r#"
[[fault]]
kind = "delay"
target = "controller:1"
delay = "20us"
"#;

fn spiky(seed: u64) -> String {
    format!(
        "[[fault]]\nkind = \"delay\"\ntarget = \"controller:1\"\ndelay = \"200us\"\nprobability = 0.01\n\
         seed = {seed}\n"
    )
}

/// Counts of pass, fail, inconclusive, anything else.
#[derive(Default, Debug)]
struct Counts {
    pass: u32,
    fail: u32,
    inconclusive: u32,
    other: u32,
}

/// Runs it once; what failed is printed, since a wrong verdict is worth nothing without its reason.
fn run(executable: &Path, scenario: &Path, counts: &mut Counts, unexpected: Option<i32>) -> std::io::Result<()> {
    let output = Command::new(executable).arg("run").arg(scenario).args(["--quiet", "--json"]).output()?;
    let code = output.status.code();
    match code {
        Some(0) => counts.pass += 1,
        Some(1) => counts.fail += 1,
        Some(3) => counts.inconclusive += 1,
        _ => counts.other += 1,
    }
    if code == unexpected {
        let summary: Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        say::out!("  unexpected: {}", summary["verdict"]["reasons"]);
    }
    Ok(())
}

fn batch(
    executable: &Path,
    name: &str,
    runs: u32,
    unexpected: i32,
    text: impl Fn(u64) -> String,
) -> std::io::Result<Counts> {
    let path = std::env::temp_dir().join(format!("loopbound-soak-{}.toml", std::process::id()));
    // They come and go: for 0.1 to 0.8 s, then as long not.
    let load = Background::start(&[Work::Stream; 2], Rhythm::OnAndOff, &std::env::temp_dir())?;
    let mut counts = Counts::default();
    for index in 0..runs {
        std::fs::write(&path, format!("{SCENARIO}{}", text(u64::from(index) + 1)))?;
        run(executable, &path, &mut counts, Some(unexpected))?;
    }
    drop(load);
    if runs > 0 {
        std::fs::remove_file(&path)?;
    }
    let Counts { pass, fail, inconclusive, other } = counts;
    say::out!(
        "{name:<28}{runs:>6} runs: {pass:>4} pass {fail:>4} fail {inconclusive:>4} inconclusive {other:>4} other"
    );
    Ok(counts)
}

fn number(name: &str, default: u32) -> u32 {
    let mut args = std::env::args().skip_while(|arg| arg != name).skip(1);
    args.next().and_then(|value| value.parse().ok()).unwrap_or(default)
}

/// The executable that was built beside this example.
fn executable() -> std::io::Result<PathBuf> {
    let own = std::env::current_exe()?;
    Ok(own.parent().and_then(Path::parent).unwrap_or(Path::new(".")).join("loopbound"))
}

fn main() -> std::io::Result<ExitCode> {
    let (runs, regressions) = (number("--runs", 100), number("--regressions", 50));
    let executable = executable()?;
    let unchanged = batch(&executable, "unchanged, load on and off", runs, 1, |_| String::new())?;
    let slower = batch(&executable, "+20 us in every tick", regressions, 0, |_| SLOWER.to_owned())?;
    let spiky = batch(&executable, "+200 us in 1 % of ticks", regressions, 0, spiky)?;
    // One in fifty may stay undecided.
    let found = |counts: &Counts| counts.pass == 0 && counts.fail >= regressions - regressions.div_ceil(50);
    let right = unchanged.fail == 0 && found(&slower) && found(&spiky);
    say::out!("{}", if right { "as it must be" } else { "NOT as it must be" });
    Ok(if right { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
