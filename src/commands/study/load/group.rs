//! One run of the study: a real group, started as anybody would start it, watched, and read from its folder.
//!
//! Responsible for that nothing of it is left: whatever happens, the launcher is asked to end, waited for, and killed
//! if it does not.

use std::fs::{self, File};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use loopbound_monitor::hops::Hops;
use loopbound_monitor::{Summary, log};
use loopbound_scenario::input;
use loopbound_scenario::{Nanos, Scenario};
use loopbound_shared::clock;
use loopbound_shared::group::file_of;
use loopbound_shared::realtime::{ProcessHandle, Signal, Step};
use loopbound_shared::spawn;
use thiserror::Error;

use super::case::{Case, Rights, Run};
use super::cpu::{CpuUse, Reading};
use crate::commands::check::read_blocks;
use crate::commands::study::load::background::Background;
use crate::exit::Exit;
use crate::signals::Stop;
use crate::supervise::{ROSTER_FILE, Roster};

/// Interval between two looks at the run: rare enough to disturb nobody.
const LOOK_NS: u64 = 20_000_000;
/// What a run may take beyond its length before it is given up, ns.
const PATIENCE_NS: u64 = 30_000_000_000;
/// Time to end in order when asked to, ns.
const LEAVE_NS: u64 = 10_000_000_000;
/// Interval between two readings of the CPU time, ns.
const READ_NS: u64 = 100_000_000;

/// Why a run has no figures.
#[derive(Debug, Error)]
pub enum RunError {
    /// The machine does not give what the case needs; trying again is of no use.
    #[error("{0}")]
    Refused(String),
    /// This run went wrong.
    #[error("{0}")]
    Failed(String),
    /// A signal came.
    #[error("interrupted")]
    Stopped(Exit),
}

impl From<std::io::Error> for RunError {
    fn from(error: std::io::Error) -> Self {
        Self::Failed(error.to_string())
    }
}

/// What runs of a study have in common.
#[derive(Debug)]
pub struct Runner<'a> {
    /// Takes the files of one run after another.
    pub folder: PathBuf,
    /// Whether to end.
    pub stop: &'a Stop,
}

impl Runner<'_> {
    /// Runs the scenario for `run_ns` under the load of the case.
    ///
    /// # Errors
    /// Why there are no figures.
    pub fn run(&self, case: &Case, scenario: &Scenario, run_ns: u64) -> Result<Run, RunError> {
        let mut scenario = scenario.clone();
        scenario.loop_.duration = Nanos(run_ns);
        fs::create_dir_all(&self.folder)?;
        let result = self.run_in_folder(case, &scenario);
        // Read already, and tens of megabytes each.
        let removed = fs::remove_dir_all(&self.folder);
        let run = result?;
        removed?;
        Ok(run)
    }

    fn run_in_folder(&self, case: &Case, scenario: &Scenario) -> Result<Run, RunError> {
        let file = self.folder.join("case.toml");
        let text = scenario.to_toml().map_err(|e| RunError::Failed(e.to_string()))?;
        fs::write(&file, text)?;
        let out = self.folder.join("run");
        let load = Background::of(case.load, &self.folder)?;
        let (code, said, cpu) = self.watch(&file, &out, scenario.loop_.duration.ns())?;
        drop(load);
        let summary = read_summary(&out, code, &said)?;
        if case.rights == Rights::With {
            check_rights(&summary)?;
        }
        if summary.dropped.intervals > 0 {
            let why = format!("the disc was too slow for {} histograms of the run", summary.dropped.intervals);
            return Err(RunError::Failed(why));
        }
        let mut hops = Hops::default();
        let bytes = input::read_file(&out.join(log::FILE), input::FIGURES_BYTES_MAX)?;
        log::add(&mut hops, &bytes, &summary).map_err(RunError::Failed)?;
        let blocks = read_blocks(&out).map_err(|e| RunError::Failed(e.to_string()))?;
        Ok(Run { summary, hops, blocks, cpu })
    }

    /// The exit code of the launcher, what it said, and the CPU time of the group.
    fn watch(&self, file: &Path, out: &Path, run_ns: u64) -> Result<(Option<i32>, String, CpuUse), RunError> {
        let said = self.folder.join("said.txt");
        let group = format!("study-load-{}", std::process::id());
        let roster = file_of(&group, ROSTER_FILE).map_err(|e| RunError::Failed(e.to_string()))?;
        let mut command = Command::new(std::env::current_exe()?);
        let own = std::process::id().to_string();
        command.arg("run").arg(file).arg("--out").arg(out).args(["--quiet", "--group", &group, "--parent", &own]);
        // A terminal's Ctrl-C reaches the study alone, which then ends the run.
        command.process_group(0).stdin(Stdio::null()).stdout(Stdio::null()).stderr(File::create(&said)?);
        let mut launcher = Launcher(spawn::process(&mut command)?);
        let give_up_ns = clock::now_ns() + run_ns + PATIENCE_NS;
        let mut watch = CpuWatch::new(roster);
        loop {
            if let Some(status) = launcher.0.try_wait()? {
                let said = fs::read_to_string(&said).unwrap_or_default();
                return Ok((status.code(), said, watch.used()));
            }
            if let Some(exit) = self.stop.requested() {
                return Err(RunError::Stopped(exit));
            }
            let now_ns = clock::now_ns();
            if now_ns > give_up_ns {
                return Err(RunError::Failed("it did not end".to_owned()));
            }
            watch.look(now_ns);
            clock::sleep_ns(LOOK_NS);
        }
    }
}

/// Reads the CPU time of a group from when its clock runs, and keeps the last reading in which everybody still lived:
/// beside a load, the end of a run is seen late.
struct CpuWatch {
    roster: PathBuf,
    again_ns: u64,
    first: Option<Reading>,
    last: Option<Reading>,
}

impl CpuWatch {
    fn new(roster: PathBuf) -> Self {
        Self { roster, again_ns: 0, first: None, last: None }
    }

    fn look(&mut self, now_ns: u64) {
        if now_ns < self.again_ns {
            return;
        }
        let Some(roster) = read_roster(&self.roster).filter(is_running) else { return };
        self.again_ns = now_ns + READ_NS;
        let reading = Reading::take(&roster);
        match &self.first {
            None if reading.is_of_all(&roster) => self.first = Some(reading),
            Some(first) if reading.has_all_of(first) => self.last = Some(reading),
            _ => {}
        }
    }

    fn used(&self) -> CpuUse {
        CpuUse::between(self.first.as_ref(), self.last.as_ref())
    }
}

/// The `loopbound run` that owns the group.
struct Launcher(Child);

impl Drop for Launcher {
    fn drop(&mut self) {
        if matches!(self.0.try_wait(), Ok(Some(_))) {
            return;
        }
        if let Ok(handle) = ProcessHandle::open(self.0.id()) {
            let _ = handle.signal(Signal::TERM);
            let _ = handle.wait_end(LEAVE_NS);
        }
        // Its children end with it, and the next run of the same name sweeps up.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn read_roster(path: &Path) -> Option<Roster> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

/// Whether a controller is in charge: the clock runs.
fn is_running(roster: &Roster) -> bool {
    roster.processes.iter().any(|process| process.state == "active")
}

fn read_summary(out: &Path, code: Option<i32>, said: &str) -> Result<Summary, RunError> {
    // A bound that broke, or a role that died at the very end, is no reason to have no latencies.
    if let Ok(text) = fs::read(out.join("summary.json")) {
        return serde_json::from_slice(&text).map_err(|e| RunError::Failed(format!("summary.json: {e}")));
    }
    let line = said.lines().last().unwrap_or("it said nothing");
    let code = code.map_or_else(|| "a signal".to_owned(), |code| format!("code {code}"));
    Err(RunError::Failed(format!("it ended with {code}: {line}")))
}

/// A case "with privileges" that did not get the scheduler would be one without under a wrong name.
fn check_rights(summary: &Summary) -> Result<(), RunError> {
    let missing = summary.processes.iter().flat_map(|process| &process.missing);
    match missing.into_iter().find(|missing| missing.step == Step::SchedFifo.name()) {
        Some(missing) => Err(RunError::Refused(format!("SCHED_FIFO is refused here; remedy: {}", missing.remedy))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_monitor::summary::{MissingPrivilege, ProcessSummary};

    #[test]
    fn a_refused_scheduler_makes_a_case_impossible_and_names_what_mends_it() {
        let mut summary = Summary::default();
        assert!(check_rights(&summary).is_ok());
        let missing = |step: &str| MissingPrivilege {
            step: step.into(),
            cost: "other processes".into(),
            remedy: "`sudo prlimit`".into(),
        };
        let with = |step: &str| ProcessSummary { missing: vec![missing(step)], ..ProcessSummary::default() };
        summary.processes = vec![with("dma_latency")];
        assert!(check_rights(&summary).is_ok(), "worth having, but the loop is what the case says");
        summary.processes = vec![with("dma_latency"), with("sched_fifo")];
        let error = check_rights(&summary).unwrap_err();
        assert!(matches!(&error, RunError::Refused(why) if why.contains("`sudo prlimit`")), "{error}");
    }

    #[test]
    fn a_run_without_a_summary_says_how_it_ended_and_its_last_words() {
        let folder = tempfile::tempdir().unwrap();
        let error = read_summary(folder.path(), Some(2), "a note\nloopbound: no room\n").unwrap_err();
        assert_eq!(error.to_string(), "it ended with code 2: loopbound: no room");
    }
}
