//! What a figure depends on: the machine, its kernel, and the commit.

use std::process::Command;

use loopbound_shared::clock;
use serde::Serialize;

/// The host at the start of the run.
#[derive(Debug, Serialize)]
pub(crate) struct Host {
    pub(crate) taken_at: String,
    pub(crate) machine: String,
    pub(crate) cpu: String,
    pub(crate) cores: usize,
    pub(crate) virtualised: bool,
    pub(crate) kernel: String,
    pub(crate) clock_source: String,
    pub(crate) governor: String,
    pub(crate) load: String,
    pub(crate) commit: String,
}

/// The cores that this process may run on.
pub(crate) fn allowed_cores() -> Vec<usize> {
    let set = rustix::thread::sched_getaffinity(None);
    set.map(|set| (0..rustix::thread::CpuSet::MAX_CPU).filter(|core| set.is_set(*core)).collect()).unwrap_or_default()
}

pub(crate) fn describe() -> Host {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |name: &str| {
        let line = cpu.lines().find(|line| line.starts_with(name))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    };
    let system = rustix::system::uname();
    let text = |part: &std::ffi::CStr| part.to_string_lossy().into_owned();
    Host {
        taken_at: clock::wall_time(),
        machine: text(system.machine()),
        cpu: field("model name").unwrap_or_else(|| "unknown".to_owned()),
        cores: allowed_cores().len(),
        virtualised: field("flags").is_some_and(|flags| flags.split(' ').any(|flag| flag == "hypervisor")),
        kernel: format!("{} {}", text(system.release()), text(system.version())),
        clock_source: line("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        governor: line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        load: line("/proc/loadavg"),
        commit: commit(),
    }
}

fn line(path: &str) -> String {
    std::fs::read_to_string(path).map_or_else(|_| "none".to_owned(), |text| text.trim().to_owned())
}

fn commit() -> String {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]) else { return "unknown".to_owned() };
    let changed = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|status| !status.is_empty());
    if changed { format!("{commit} with changes") } else { commit }
}
