//! Is the cause that a late tick gets the true one? Injects each cause in a run of its own and prints the confusion
//! matrix: rows are what was injected, columns what the monitor found.
//!
//! ```text
//! cargo build --release --examples && cargo build --release && cargo run --release --example attribution
//! ```
//!
//! Only the ticks that were struck count where they are known: the page fault, the overrun and the delay come in every
//! 50th. For the others all late and missed ticks of the run count, the host's own among them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use loopbound_shared::clock;
use loopbound_shared::realtime::{ProcessHandle, Signal, set_priority};
use serde_json::Value;

/// What is injected, and the causes that are right for it.
const CASES: [(&str, &[&str]); 6] = [
    ("busy process", &["run_queue_delay", "involuntary_switch"]),
    ("page fault", &["page_fault"]),
    ("overrunning law", &["own_overrun"]),
    ("delayed controller", &["injected_fault"]),
    ("stopped controller", &["controller_dead", "controller_late"]),
    ("joining monitors", &["monitor_joined"]),
];

/// How long the disturbance goes on.
const BUSY_NS: u64 = 3_000_000_000;

fn beside(name: &str) -> std::io::Result<PathBuf> {
    let own = std::env::current_exe()?;
    Ok(own.parent().unwrap_or(Path::new(".")).join(name))
}

/// A controller's process id, from the launcher's roster.
fn controller_pid(executable: &Path, group: &str) -> Option<u32> {
    let output = Command::new(executable).args(["ps", "--json"]).output().ok()?;
    let groups: Value = serde_json::from_slice(&output.stdout).ok()?;
    let group = groups.as_array()?.iter().find(|entry| entry["group"] == group)?;
    let found = group["processes"].as_array()?.iter().find(|process| process["role"] == "controller")?;
    u32::try_from(found["pid"].as_u64()?).ok()
}

/// Bursts of 900 µs at a higher real-time priority than the loop's, for so long; run as a process of its own.
fn burst(ns: u64) -> anyhow::Result<()> {
    set_priority(std::process::id(), 95)?;
    let until_ns = clock::now_ns() + ns;
    while clock::now_ns() < until_ns {
        let burst_end_ns = clock::now_ns() + 900_000;
        while clock::now_ns() < burst_end_ns {
            std::hint::spin_loop();
        }
        clock::sleep_until_ns(clock::now_ns() + 9_100_000);
    }
    Ok(())
}

/// Two of them, so that both cores of a small machine are taken.
fn keep_busy() -> anyhow::Result<()> {
    let start = || Command::new(std::env::current_exe()?).arg("--burst").spawn();
    let children = [start()?, start()?];
    for mut child in children {
        anyhow::ensure!(child.wait()?.success(), "the busy process needs SCHED_FIFO");
    }
    Ok(())
}

fn disturb(case: usize, executable: &Path, group: &str) -> anyhow::Result<()> {
    clock::sleep_until_ns(clock::now_ns() + 1_000_000_000);
    let until_ns = clock::now_ns() + BUSY_NS;
    match CASES[case].0 {
        "busy process" => keep_busy()?,
        "stopped controller" => {
            let Some(pid) = controller_pid(executable, group) else { anyhow::bail!("no controller in {group}") };
            let handle = ProcessHandle::open(pid)?;
            while clock::now_ns() < until_ns {
                handle.signal(Signal::STOP)?;
                clock::sleep_until_ns(clock::now_ns() + 20_000_000);
                handle.signal(Signal::CONT)?;
                clock::sleep_until_ns(clock::now_ns() + 200_000_000);
            }
        }
        "joining monitors" => {
            while clock::now_ns() < until_ns {
                let mut command = Command::new(executable);
                command.args(["monitor", "--group", group, "--json", "--duration", "50ms"]);
                command.stdout(Stdio::null()).stderr(Stdio::null()).status()?;
            }
        }
        _ => {}
    }
    Ok(())
}

fn scenario(case: usize) -> anyhow::Result<String> {
    let base = "[loop]\nduration = \"5s\"\n".to_owned();
    Ok(match CASES[case].0 {
        // Locked memory has no faults, which is what locking is for.
        "page fault" | "overrunning law" => {
            let exe = beside("misbehaving")?;
            format!("{base}[controller]\nexe = {exe:?}\n[realtime]\nlock_memory = false\n")
        }
        // At 1 kHz a mapping fits into the slack and makes no tick late.
        "joining monitors" => format!("{base}rate = \"5kHz\"\n"),
        "delayed controller" => format!(
            "{base}[[fault]]\nkind = \"delay\"\ntarget = \"controller:1\"\nat = \"1s\"\nevery = \"50ms\"\ndelay = \"700us\"\n"
        ),
        _ => base,
    })
}

/// Late and missed ticks of a run, each once, by cause.
fn causes(folder: &Path, every: u64) -> anyhow::Result<BTreeMap<String, u64>> {
    let mut by_tick: BTreeMap<u64, String> = BTreeMap::new();
    for line in std::fs::read_to_string(folder.join("events.jsonl"))?.lines() {
        let event: Value = serde_json::from_str(line)?;
        // The disturbance begins a second after the start.
        if event["t_s"].as_f64().is_some_and(|t_s| t_s < 0.5) {
            continue;
        }
        if let (Some(tick), Some(cause)) = (event["tick"].as_u64(), event["cause"].as_str())
            && tick.is_multiple_of(every)
        {
            by_tick.insert(tick, cause.to_owned());
        }
    }
    let mut counts = BTreeMap::new();
    by_tick.into_values().for_each(|cause| *counts.entry(cause).or_insert(0) += 1);
    Ok(counts)
}

fn main() -> anyhow::Result<()> {
    if std::env::args().any(|arg| arg == "--burst") {
        return burst(BUSY_NS);
    }
    let examples = beside("")?;
    let executable = examples.parent().unwrap_or(Path::new(".")).join("loopbound");
    let folder = std::env::temp_dir().join(format!("loopbound-attribution-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    for (case, (name, right)) in CASES.iter().enumerate() {
        let group = format!("attribution-{}-{case}", std::process::id());
        let file = folder.join("injected.toml");
        std::fs::write(&file, scenario(case)?)?;
        let mut command = Command::new(&executable);
        command.arg("run").arg(&file).args(["--quiet", "--group", &group, "--out"]).arg(&folder);
        command.env("MISBEHAVE", if *name == "page fault" { "page_fault" } else { "overrun" });
        let mut launcher = command.stdout(Stdio::null()).spawn()?;
        disturb(case, &executable, &group)?;
        launcher.wait()?;
        let every = if matches!(*name, "page fault" | "overrunning law" | "delayed controller") { 50 } else { 1 };
        let counts = causes(&folder, every)?;
        let all: u64 = counts.values().sum();
        let hit: u64 = counts.iter().filter(|(cause, _)| right.contains(&cause.as_str())).map(|(_, n)| n).sum();
        let share = if all > 0 { 100.0 * hit as f64 / all as f64 } else { 0.0 };
        let unknown = counts.get("unknown").copied().unwrap_or(0);
        let listed: Vec<String> = counts.iter().map(|(cause, n)| format!("{n} {cause}")).collect();
        println!("{name:<20}{all:>5} ticks, {share:>5.1} % right, {unknown} unknown: {}", listed.join(", "));
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}
