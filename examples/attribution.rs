//! Is the cause that a late tick gets the true one? Injects each cause in a run of its own, writes down when it struck,
//! and prints the confusion matrix: rows are what was injected, columns what the monitor said.
//!
//! ```text
//! cargo build --release --examples && cargo build --release && cargo run --release --example attribution
//! ```
//!
//! The truth comes from the injector, by the clock that the loop is stamped with, and never from the run's own evidence. A
//! late or missed tick belongs to an injection if it was struck: the injector was at work between the instant at which
//! the plant wakes for the tick and the end of that tick. All others of the run are counted as "not struck": they are the
//! host's, and nobody knows their true cause. As many of them fall into the struck stretches by chance as their length says:
//! that number stands beside the share that is right.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::Context as _;
use loopbound_monitor::cause::Cause;
use loopbound_monitor::recording::reader::{Item, Recording};
use loopbound_shared::clock;
use loopbound_shared::group::Group;
use loopbound_shared::ports::Node;
use loopbound_shared::realtime::{ProcessHandle, Signal, set_priority};
use loopbound_shared::sample::{Announce, TickRecord};
use loopbound_shared::say;
use loopbound_shared::topics::Topic as _;
use serde_json::Value;

/// What is injected, and the causes that are right for it.
const CASES: [(&str, &[Cause]); 6] = [
    ("busy processes", &[Cause::RunQueueDelay, Cause::InvoluntarySwitch]),
    ("faulting law", &[Cause::PageFault]),
    ("overrunning law", &[Cause::OwnOverrun]),
    ("delayed controller", &[Cause::InjectedFault]),
    ("stopped controller", &[Cause::ControllerSilent, Cause::ControllerLate]),
    ("joining monitors", &[Cause::MonitorJoined]),
];
/// The law that misbehaves and the injected delay strike every so many ticks.
const EVERY: u64 = 50;
/// Of a run; the first second and the last are left alone.
const RUN_S: u64 = 12;
const CALM_NS: u64 = 1_500_000_000;
const STRIKE_NS: u64 = 9_000_000_000;

/// When an injector was at work, ns of the monotonic clock.
type Struck = Vec<(u64, u64)>;

fn beside(name: &str) -> std::io::Result<PathBuf> {
    let own = std::env::current_exe()?;
    Ok(own.parent().unwrap_or(Path::new(".")).join(name))
}

/// Bursts of 900 µs at a higher real-time priority than the loop's, each said on standard output; run as a process of its own.
fn burst(ns: u64) -> anyhow::Result<()> {
    set_priority(std::process::id(), 95)?;
    let (until_ns, mut struck) = (clock::now_ns() + ns, Struck::new());
    while clock::now_ns() < until_ns {
        let from_ns = clock::now_ns();
        while clock::now_ns() < from_ns + 900_000 {
            std::hint::spin_loop();
        }
        struck.push((from_ns, clock::now_ns()));
        clock::sleep_until_ns(clock::now_ns() + 9_100_000);
    }
    struck.iter().for_each(|(from_ns, to_ns)| say::out!("{from_ns} {to_ns}"));
    Ok(())
}

/// Lines of two instants each.
fn instants(text: &str) -> anyhow::Result<Struck> {
    let pair = |line: &str| {
        let (from_ns, to_ns) = line.split_once(' ').context("two instants")?;
        Ok((from_ns.parse()?, to_ns.parse()?))
    };
    text.lines().map(pair).collect()
}

/// Two of them, so that both cores of a small machine are taken.
fn keep_busy() -> anyhow::Result<Struck> {
    let start = || Command::new(std::env::current_exe()?).arg("--burst").stdout(Stdio::piped()).spawn();
    let mut struck = Struck::new();
    let children: [Child; 2] = [start()?, start()?];
    for mut child in children {
        let mut said = String::new();
        child.stdout.take().context("its output")?.read_to_string(&mut said)?;
        struck.extend(instants(&said)?);
        anyhow::ensure!(child.wait()?.success(), "the busy process needs SCHED_FIFO");
    }
    Ok(struck)
}

/// Stops the controller for 20 ms again and again.
fn stop_and_go(executable: &Path, group: &str) -> anyhow::Result<Struck> {
    let output = Command::new(executable).args(["ps", "--json"]).output()?;
    let groups: Value = serde_json::from_slice(&output.stdout)?;
    let group = groups.as_array().into_iter().flatten().find(|entry| entry["group"] == group).context("the group")?;
    let found = group["processes"].as_array().into_iter().flatten().find(|process| process["role"] == "controller");
    let pid = found.and_then(|process| process["pid"].as_u64()).context("a controller")?;
    let handle = ProcessHandle::open(u32::try_from(pid)?)?;
    let (until_ns, mut struck) = (clock::now_ns() + STRIKE_NS, Struck::new());
    while clock::now_ns() < until_ns {
        let from_ns = clock::now_ns();
        handle.signal(Signal::STOP)?;
        clock::sleep_until_ns(clock::now_ns() + 20_000_000);
        handle.signal(Signal::CONT)?;
        struck.push((from_ns, clock::now_ns()));
        clock::sleep_until_ns(clock::now_ns() + 200_000_000);
    }
    Ok(struck)
}

/// Joins with the ports of a monitor again and again; the plant maps them within three ticks.
fn join_and_leave(group: &str, period_ns: u64) -> anyhow::Result<Struck> {
    let node = Node::open(&Group::join(group)?)?;
    let (until_ns, mut struck) = (clock::now_ns() + STRIKE_NS, Struck::new());
    while clock::now_ns() < until_ns {
        let from_ns = clock::now_ns();
        let ports = (
            node.subscriber::<TickRecord>(TickRecord::DEPTH)?,
            node.subscriber::<Announce>(Announce::DEPTH)?,
            node.publisher::<Announce>()?,
        );
        struck.push((from_ns, clock::now_ns() + 3 * period_ns));
        clock::sleep_until_ns(clock::now_ns() + 30_000_000);
        let from_ns = clock::now_ns();
        drop(ports);
        // What has left is unmapped as well.
        struck.push((from_ns, clock::now_ns() + 3 * period_ns));
        clock::sleep_until_ns(clock::now_ns() + 30_000_000);
    }
    Ok(struck)
}

/// Injects until the run is about over. None: it strikes in every [`EVERY`]th tick.
fn inject(case: usize, executable: &Path, group: &str) -> anyhow::Result<Option<Struck>> {
    clock::sleep_until_ns(clock::now_ns() + CALM_NS);
    Ok(match CASES[case].0 {
        "busy processes" => Some(keep_busy()?),
        "stopped controller" => Some(stop_and_go(executable, group)?),
        "joining monitors" => Some(join_and_leave(group, 200_000)?),
        _ => None,
    })
}

fn scenario(case: usize) -> anyhow::Result<String> {
    let base = format!("[loop]\nduration = \"{RUN_S}s\"\n");
    Ok(match CASES[case].0 {
        // Locked memory has no faults, which is what locking is for.
        "faulting law" => {
            format!("{base}[controller]\nexe = {:?}\n[realtime]\nlock_memory = false\n", beside("misbehaving")?)
        }
        "overrunning law" => format!("{base}[controller]\nexe = {:?}\n", beside("misbehaving")?),
        // At 1 kHz a mapping fits into the slack and makes no tick late.
        "joining monitors" => format!("{base}rate = \"5kHz\"\n"),
        "delayed controller" => format!(
            "{base}[[fault]]\nkind = \"delay\"\ntarget = \"controller:1\"\nat = \"1s\"\nevery = \"{EVERY}ms\"\ndelay = \"700us\"\n"
        ),
        _ => base,
    })
}

/// A late tick, or missed ones in a row.
struct Disturbed {
    ticks: u64,
    cause: String,
    /// The plant slept through them: no controller ever saw them.
    skipped: bool,
}

/// Late and missed ticks of a run past its beginning, by their number, each once.
fn disturbed(folder: &Path) -> anyhow::Result<BTreeMap<u64, Disturbed>> {
    let mut found = BTreeMap::new();
    for line in std::fs::read_to_string(folder.join("events.jsonl"))?.lines() {
        let event: Value = serde_json::from_str(line)?;
        let past = event["t_s"].as_f64().is_some_and(|t_s| t_s > 0.5);
        if let (true, Some(tick), Some(cause)) = (past, event["tick"].as_u64(), event["cause"].as_str()) {
            let (ticks, skipped) = (event["ticks"].as_u64().unwrap_or(1), event["decision"] == "skipped");
            found.insert(tick, Disturbed { ticks, cause: cause.to_owned(), skipped });
        }
    }
    Ok(found)
}

/// t_0 and the period, ns, from the recording.
fn timing(folder: &Path) -> anyhow::Result<(u64, u64)> {
    let mut recording = Recording::open(&folder.join("samples.mcap"))?;
    let mut first = None;
    while let Some(item) = recording.next_item()? {
        let Item::Record(record) = item else { continue };
        match first {
            None => first = Some((record.tick, record.deadline_ns)),
            Some((tick, deadline_ns)) if record.tick > tick => {
                let period_ns = (record.deadline_ns - deadline_ns) / (record.tick - tick);
                return Ok((deadline_ns - tick * period_ns, period_ns));
            }
            Some(_) => {}
        }
    }
    anyhow::bail!("fewer than two ticks were recorded")
}

/// What came of one run.
struct Outcome {
    /// Ticks by cause: those that were struck …
    struck: BTreeMap<String, u64>,
    /// … and those that were not.
    others: BTreeMap<String, u64>,
    /// Of the struck ones, how many the host would have made late anyway.
    by_chance: f64,
}

/// The share of the run, in the tick's sense, that is struck.
fn share_struck(struck: Option<&Struck>, period_ns: u64, early_ns: u64) -> f64 {
    let Some(struck) = struck else { return 1.0 / EVERY as f64 };
    let mut stretches: Struck =
        struck.iter().map(|(from, to)| (from.saturating_sub(period_ns), to + early_ns)).collect();
    stretches.sort_unstable();
    let (mut covered_ns, mut until_ns) = (0, 0);
    for (from_ns, to_ns) in stretches {
        covered_ns += to_ns.saturating_sub(from_ns.max(until_ns));
        until_ns = until_ns.max(to_ns);
    }
    covered_ns as f64 / (RUN_S * clock::NS_PER_S - clock::NS_PER_S / 2) as f64
}

/// One run with its injections.
fn run(case: usize, executable: &Path, folder: &Path) -> anyhow::Result<Outcome> {
    let group = format!("attribution-{}-{case}", std::process::id());
    let file = folder.join("injected.toml");
    std::fs::write(&file, scenario(case)?)?;
    let mut command = Command::new(executable);
    command.arg("run").arg(&file).args(["--quiet", "--group", &group, "--out"]).arg(folder);
    let log = folder.join("struck");
    command.env("MISBEHAVE", if CASES[case].0.contains("faulting") { "page_fault" } else { "overrun" });
    command.env("MISBEHAVE_LOG", &log);
    let mut launcher = command.stdout(Stdio::null()).spawn()?;
    let struck = inject(case, executable, &group)?;
    launcher.wait()?;
    let struck = if CASES[case].0.contains("law") { Some(instants(&std::fs::read_to_string(&log)?)?) } else { struck };
    let (t_0_ns, period_ns) = timing(folder)?;
    let wakes_early_ns = (period_ns / 4).min(250_000);
    let (mut hits, mut others) = (BTreeMap::new(), BTreeMap::new());
    for (tick, Disturbed { ticks, cause, skipped }) in disturbed(folder)? {
        let deadline_ns = t_0_ns + tick * period_ns;
        let (from_ns, to_ns) = (deadline_ns - wakes_early_ns, deadline_ns + ticks * period_ns);
        let hit = match &struck {
            Some(struck) => struck.iter().any(|(begin_ns, end_ns)| *begin_ns < to_ns && *end_ns > from_ns),
            None => !skipped && tick.is_multiple_of(EVERY),
        };
        *if hit { &mut hits } else { &mut others }.entry(cause).or_insert(0) += ticks;
    }
    let share = share_struck(struck.as_ref(), period_ns, wakes_early_ns).min(0.99);
    let by_chance = others.values().sum::<u64>() as f64 * share / (1.0 - share);
    Ok(Outcome { struck: hits, others, by_chance })
}

fn main() -> anyhow::Result<()> {
    if std::env::args().any(|arg| arg == "--burst") {
        return burst(STRIKE_NS);
    }
    let examples = beside("")?;
    let executable = examples.parent().unwrap_or(Path::new(".")).join("loopbound");
    // The files of the last case stay there if a folder is named.
    let temporary = tempfile::tempdir()?;
    let named = std::env::args().nth(1).map(PathBuf::from);
    let folder = named.as_deref().unwrap_or(temporary.path());
    std::fs::create_dir_all(folder)?;
    let mut not_struck = Vec::new();
    let head: Vec<&str> = Cause::ALL.iter().map(|cause| cause.name()).collect();
    say::out!("| injected | ticks | right | by chance | {} |", head.join(" | "));
    say::out!("|---|---|---|---|{}", "---|".repeat(head.len()));
    let row = |name: &str, right: &str, counts: &BTreeMap<String, u64>| {
        let cells: Vec<String> =
            head.iter().map(|cause| counts.get(*cause).map_or_else(String::new, u64::to_string)).collect();
        say::out!("| {name} | {} | {right} | {} |", counts.values().sum::<u64>(), cells.join(" | "));
    };
    for (case, (name, right)) in CASES.iter().enumerate() {
        let Outcome { struck, others, by_chance } = run(case, &executable, folder)?;
        let all: u64 = struck.values().sum();
        let hit: u64 = right.iter().filter_map(|cause| struck.get(cause.name())).sum();
        row(name, &format!("{:.1} % | {by_chance:.0}", 100.0 * hit as f64 / all.max(1) as f64), &struck);
        not_struck.push((format!("not struck: {name}"), others));
    }
    not_struck.iter().for_each(|(name, others)| row(name, " | ", others));
    Ok(())
}
