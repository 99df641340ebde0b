//! One child process: started, watched by descriptor, reaped, and never left behind.

use std::fs;
use std::os::unix::process::ExitStatusExt as _;
use std::path::PathBuf;
use std::process::ExitStatus;

use anyhow::Context as _;
use loopbound_model::quote;
use loopbound_scenario::input;
use loopbound_shared::clock;
use loopbound_shared::group::{Group, room};
use loopbound_shared::realtime::{ProcessHandle, Signal};
use loopbound_shared::sample::Announce;
use loopbound_shared::spawn;

use crate::exit::Failure;
use crate::supervise::processes::Process;

/// Lines of a child's own words that a report quotes.
const QUOTED_LINES_MAX: usize = 20;

/// Of so many bytes at the end of what it said.
const QUOTED_BYTES_MAX: u64 = 1 << 16;

/// A started process.
pub(super) struct Child {
    pub(super) process: Process,
    pub(super) pid: u32,
    /// Its latest announcement; none before it is ready.
    pub(super) announce: Option<Announce>,
    /// How and when it ended.
    pub(super) ended: Option<(ExitStatus, u64)>,
    /// How often it was started before.
    pub(super) restarts: u32,
    /// The controller whose place it takes after a death; a number is never given twice.
    pub(super) replaces: Option<u32>,
    /// Whether the plant was told of this controller.
    pub(super) member: bool,
    /// Its end was asked for: it is no death.
    pub(super) retiring_since_ns: Option<u64>,
    /// Whether its end has been dealt with.
    pub(super) settled: bool,
    child: std::process::Child,
    /// None where the kernel has no such descriptors: then it is polled.
    handle: Option<ProcessHandle>,
    log: PathBuf,
}

impl Child {
    /// Starts `process`. To be called on the launcher's main thread: the kernel ends a child when the *thread* that
    /// started it does.
    pub(super) fn start(process: Process, group: &Group, restarts: u32) -> anyhow::Result<Self> {
        let log = format!("{}.log", process.file_stem());
        let (file, log) = (group.append(&log)?, group.file(&log));
        let mut command = process.command(group, file).context("starting a process")?;
        let child = spawn::process(&mut command).map_err(|e| match &process.exe {
            Some(exe) => {
                Failure::usage(format!("{}: {} can't be started: {e}", process.name(), quote::path(exe))).into()
            }
            None => anyhow::Error::new(e).context(format!("{} can't be started", process.name())),
        })?;
        let pid = child.id();
        let handle = ProcessHandle::open(pid).ok();
        Ok(Self {
            process,
            pid,
            announce: None,
            ended: None,
            restarts,
            replaces: None,
            member: false,
            retiring_since_ns: None,
            settled: false,
            child,
            handle,
            log,
        })
    }

    /// The process that does its work: behind a wrapper, such as a shell script, it is another than the one started.
    pub(super) fn worker_pid(&self) -> u32 {
        self.announce.as_ref().map_or(self.pid, |announce| announce.pid)
    }

    /// Whether an announcement is this child's own, or of what a program of the user's has started in its place.
    pub(super) fn is_announced_by(&self, announce: &Announce) -> bool {
        let role = loopbound_shared::event::Role::from(self.process.role).code();
        (announce.role, announce.id) == (role, self.process.id)
            && (announce.pid == self.pid || self.process.exe.is_some())
    }

    /// Looks whether it has ended, and reaps it if so.
    pub(super) fn reap(&mut self) -> bool {
        // Before it is reaped, while its number can't mean another group: what a wrapper has left in its place.
        if self.ended.is_none() && self.handle.as_ref().is_some_and(|handle| handle.wait_end(0).unwrap_or(false)) {
            self.signal(Signal::TERM);
        }
        // An error means that it is no child of ours any more: nothing is left to wait for.
        if self.ended.is_none()
            && let Some(status) = self.child.try_wait().unwrap_or_else(|_| Some(ExitStatus::from_raw(0)))
        {
            self.ended = Some((status, clock::now_ns()));
        }
        self.ended.is_some()
    }

    pub(super) fn lives(&self) -> bool {
        self.ended.is_none()
    }

    pub(super) fn ready(&self) -> bool {
        self.lives() && self.announce.is_some()
    }

    pub(super) fn handle(&self) -> Option<&ProcessHandle> {
        self.handle.as_ref().filter(|_| self.lives())
    }

    /// Asks it to end.
    pub(super) fn terminate(&self) {
        self.signal(Signal::TERM);
    }

    /// Ends it.
    pub(super) fn kill(&self) {
        self.signal(Signal::KILL);
    }

    /// Stops it where it is, until [`Child::resume`].
    pub(super) fn stop(&self) {
        self.signal(Signal::STOP);
    }

    /// Lets it go on.
    pub(super) fn resume(&self) {
        self.signal(Signal::CONT);
    }

    fn signal(&self, signal: Signal) {
        if !self.lives() {
            return;
        }
        // It leads a process group of its own: a wrapper and the program behind it hear the same. It may end between the look
        // and the signal; until it is reaped its number can't mean another group.
        if let Some(pid) = i32::try_from(self.pid).ok().and_then(rustix::process::Pid::from_raw) {
            let heard = rustix::process::kill_process_group(pid, signal).is_ok();
            if !heard && let Some(handle) = &self.handle {
                let _ = handle.signal(signal);
            }
        }
    }

    /// What it said, by lines; the last ones if it said much.
    pub(super) fn said(&self) -> Vec<String> {
        let bytes = input::read_end(&self.log, QUOTED_BYTES_MAX).unwrap_or_default();
        let text = String::from_utf8_lossy(&bytes);
        let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
        let from = lines.len().saturating_sub(QUOTED_LINES_MAX);
        lines[from..].iter().map(|line| quote::lines(line.strip_prefix("loopbound: ").unwrap_or(line))).collect()
    }

    /// The last line that it said; where it could not even do that, why.
    pub(super) fn last_words(&self) -> Option<String> {
        self.said().pop().or_else(|| room::require(room::NEWCOMER).err().map(|why| why.to_string()))
    }

    /// Its words are of no use any more.
    pub(super) fn remove_log(&self) {
        let _ = fs::remove_file(&self.log);
    }

    /// How it ended, in words.
    pub(super) fn how_ended(&self) -> String {
        self.ended.map_or_else(|| "running".to_owned(), |(status, _)| describe(status))
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // Only on a way out by an error: the ordinary end has reaped everyone.
        if !self.reap() {
            self.kill();
            let _ = self.child.wait();
        }
    }
}

/// How a process ended, in words.
pub(super) fn describe(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(0), _) => "ended in order".to_owned(),
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(9)) => "killed (SIGKILL)".to_owned(),
        (None, Some(11)) => "crashed (SIGSEGV)".to_owned(),
        (None, Some(7)) => "crashed (SIGBUS)".to_owned(),
        (None, Some(6)) => "aborted (SIGABRT)".to_owned(),
        (None, Some(15)) => "terminated (SIGTERM)".to_owned(),
        (None, Some(24)) => "ran away (SIGXCPU)".to_owned(),
        (None, signal) => format!("signal {}", signal.unwrap_or(0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_is_named_by_its_code_or_signal() {
        assert_eq!(describe(ExitStatus::from_raw(0)), "ended in order");
        assert_eq!(describe(ExitStatus::from_raw(2 << 8)), "exit code 2");
        assert_eq!(describe(ExitStatus::from_raw(9)), "killed (SIGKILL)");
        assert_eq!(describe(ExitStatus::from_raw(31)), "signal 31");
    }
}
