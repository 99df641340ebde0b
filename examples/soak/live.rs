//! A running group, seen from outside: start, look, kill, wait, and what is left of it.

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use anyhow::{Context as _, bail};
use loopbound::supervise::{Entry, ROSTER_FILE, Roster};
use loopbound_shared::clock;
use loopbound_shared::group::{file_of, object_prefix, runtime_folder};
use loopbound_shared::realtime::{ProcessHandle, Signal};
use serde_json::Value;

/// No group takes longer to be up on a busy machine.
const UP_NS: u64 = 20_000_000_000;
const LOOK_NS: u64 = 2_000_000;

/// A group that this process has started.
pub(crate) struct Live {
    pub(crate) name: String,
    prefix: String,
    launcher: Child,
    pub(crate) out: tempfile::TempDir,
}

impl Live {
    /// Starts `run` with `settings`, and waits until a controller is in charge.
    pub(crate) fn start(what: &str, settings: &[&str]) -> anyhow::Result<Self> {
        let name = format!("soak-{what}-{}", std::process::id());
        let prefix = object_prefix(&runtime_folder()?.join(&name));
        let out = tempfile::tempdir()?;
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["run", "--group", &name, "--quiet", "--out"]).arg(out.path());
        for setting in settings {
            command.args(["--set", setting]);
        }
        let launcher = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn()?;
        let mut live = Self { name, prefix, launcher, out };
        live.wait("nobody is in charge", UP_NS, |roster| in_state(roster, "active").is_some())?;
        Ok(live)
    }

    pub(crate) fn roster(&self) -> Roster {
        let bytes = file_of(&self.name, ROSTER_FILE).ok().and_then(|path| std::fs::read(path).ok());
        serde_json::from_slice(&bytes.unwrap_or_default()).unwrap_or_default()
    }

    /// Waits until the roster is as `right` wants it.
    pub(crate) fn wait(
        &mut self,
        what: &str,
        within_ns: u64,
        right: impl Fn(&Roster) -> bool,
    ) -> anyhow::Result<Roster> {
        let until_ns = clock::now_ns() + within_ns;
        loop {
            let roster = self.roster();
            if right(&roster) {
                return Ok(roster);
            }
            if let Some(status) = self.launcher.try_wait()? {
                bail!("group {} ended ({status}): {what}", self.name);
            }
            if clock::now_ns() >= until_ns {
                bail!("group {}: {what}: {roster:?}", self.name);
            }
            clock::sleep_ns(LOOK_NS);
        }
    }

    /// Asks for a swap; its report.
    pub(crate) fn swap(&self, arguments: &[&str]) -> anyhow::Result<Value> {
        let mut command = Command::new(std::env::current_exe()?);
        let output = command.args(["swap", "--group", &self.name, "--json"]).args(arguments).output()?;
        let words = String::from_utf8_lossy(&output.stderr).into_owned();
        serde_json::from_slice(&output.stdout).with_context(|| format!("swap {arguments:?}: {words}"))
    }

    /// Ends the run by SIGTERM; its summary and how long the end took.
    pub(crate) fn end(&mut self) -> anyhow::Result<(Value, u64)> {
        let from_ns = clock::now_ns();
        ProcessHandle::open(self.launcher.id())?.signal(Signal::TERM)?;
        self.launcher.wait()?;
        let took_ns = clock::now_ns() - from_ns;
        let bytes = std::fs::read(self.out.path().join("summary.json")).context("the summary")?;
        Ok((serde_json::from_slice(&bytes)?, took_ns))
    }

    /// Waits for the launcher's end, at most `within_ns`; how long it took, none if it hangs.
    pub(crate) fn wait_end(&mut self, within_ns: u64) -> anyhow::Result<Option<u64>> {
        let from_ns = clock::now_ns();
        while clock::now_ns() < from_ns + within_ns {
            if self.launcher.try_wait()?.is_some() {
                return Ok(Some(clock::now_ns() - from_ns));
            }
            clock::sleep_ns(LOOK_NS);
        }
        Ok(None)
    }

    pub(crate) fn launcher_pid(&self) -> u32 {
        self.launcher.id()
    }

    /// Processes and objects in memory that outlived the group; `patience_ns` for the last to go.
    pub(crate) fn left_behind(&self, patience_ns: u64) -> Vec<String> {
        let until_ns = clock::now_ns() + patience_ns;
        loop {
            let left = self.look_for_rest();
            if left.is_empty() || clock::now_ns() >= until_ns {
                return left;
            }
            clock::sleep_ns(10 * LOOK_NS);
        }
    }

    fn look_for_rest(&self) -> Vec<String> {
        let names = |folder: &str| {
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            entries.filter_map(|entry| entry.file_name().into_string().ok())
        };
        let mut left: Vec<String> = names("/dev/shm").filter(|name| name.starts_with(&self.prefix)).collect();
        let group = format!("--group\0{}\0", self.name);
        let of_group = |pid: &String| {
            let line = std::fs::read(PathBuf::from("/proc").join(pid).join("cmdline")).unwrap_or_default();
            String::from_utf8_lossy(&line).contains(&group)
        };
        left.extend(names("/proc").filter(of_group).map(|pid| format!("process {pid}")));
        if runtime_folder().is_ok_and(|folder| folder.join(&self.name).exists()) {
            left.push("its folder".to_owned());
        }
        left
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let _ = self.launcher.kill();
        let _ = self.launcher.wait();
    }
}

pub(crate) fn in_state<'a>(roster: &'a Roster, state: &str) -> Option<&'a Entry> {
    roster.processes.iter().find(|p| p.state == state)
}

/// Kills without warning; false if it was gone already.
pub(crate) fn kill(pid: u32) -> bool {
    ProcessHandle::open(pid).is_ok_and(|process| process.signal(Signal::KILL).is_ok())
}

/// A process that computes for nothing.
pub(crate) struct Load(Child);

impl Load {
    pub(crate) fn start() -> anyhow::Result<Self> {
        let command = Command::new("sh").args(["-c", "while :; do :; done"]).stdin(Stdio::null()).spawn();
        Ok(Self(command.context("a process for load")?))
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Median, 99th percentile and largest of some figures, as text.
pub(crate) fn spread(mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    match values.last() {
        Some(most) => {
            let (n, p99) = (values.len(), values[(values.len() - 1) * 99 / 100]);
            format!("median {:.4}, p99 {p99:.4}, most {most:.4} (n = {n})", values[n / 2])
        }
        None => "none".to_owned(),
    }
}
