//! Is a verdict right? Short runs of unchanged code under a load that comes and goes, and runs with a regression built
//! in, each judged by the same expectations; prints the counts, and ends with 1 if one is not what it must be.
//!
//! ```text
//! cargo build --release && cargo run --release --example verdict_soak -- --runs 100 --regressions 50
//! ```

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use loopbound_shared::clock;
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

/// Two threads at the ordinary priority that compute and stream through memory for 0.1 to 0.8 s, then rest as long.
fn start_load(stop: &Arc<AtomicBool>) -> Vec<std::thread::JoinHandle<()>> {
    let work = |thread: u64, stop: Arc<AtomicBool>| {
        move || {
            let mut memory = vec![1u64; 1 << 20];
            let mut state = 0x9e37_79b9 + thread;
            while !stop.load(Relaxed) {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let length_ns = 100_000_000 + (state >> 33) % 700_000_000;
                let until_ns = clock::now_ns() + length_ns;
                while clock::now_ns() < until_ns && !stop.load(Relaxed) {
                    memory.iter_mut().for_each(|word| *word = word.wrapping_mul(3).wrapping_add(thread));
                }
                clock::sleep_until_ns(clock::now_ns() + length_ns);
            }
        }
    };
    (0..2).map(|thread| std::thread::spawn(work(thread, Arc::clone(stop)))).collect()
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
        println!("  unexpected: {}", summary["verdict"]["reasons"]);
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
    let stop = Arc::new(AtomicBool::new(false));
    let load = start_load(&stop);
    let mut counts = Counts::default();
    for index in 0..runs {
        std::fs::write(&path, format!("{SCENARIO}{}", text(u64::from(index) + 1)))?;
        run(executable, &path, &mut counts, Some(unexpected))?;
    }
    stop.store(true, Relaxed);
    load.into_iter().for_each(|thread| drop(thread.join()));
    if runs > 0 {
        std::fs::remove_file(&path)?;
    }
    let Counts { pass, fail, inconclusive, other } = counts;
    println!("{name:<28}{runs:>6} runs: {pass:>4} pass {fail:>4} fail {inconclusive:>4} inconclusive {other:>4} other");
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
    println!("{}", if right { "as it must be" } else { "NOT as it must be" });
    Ok(if right { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
