//! The monitors that `loopbound run` starts beside its own: the view on the terminal, and the server for Foxglove.
//!
//! Each is a process of its own, so that the supervisor has nothing else to do. They leave by themselves when the group
//! has ended, and give the terminal back before the report is printed.

use std::io::Write as _;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

use anyhow::Context as _;
use loopbound_monitor::live::{Address, Origin};
use loopbound_shared::clock::{NS_PER_S, now_ns, sleep_ns};
use loopbound_shared::group::sweep_if_dead;
use loopbound_shared::say;
use loopbound_shared::spawn;
use rustix::process::{Pid, Signal, getpid, kill_process};
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcsetattr};

use crate::exit::{Exit, Failure};

/// Numbers that no other monitor of a group has.
const VIEW_ID: u32 = 1000;
const SERVER_ID: u32 = 1001;
/// Time to leave after the group has ended.
const LEAVE_NS: u64 = 5 * NS_PER_S;
/// Between two looks whether it has left.
const LOOK_NS: u64 = 2_000_000;

/// A monitor that was started beside the launcher's own. Ended when it is dropped, at the latest.
pub(super) struct Guest {
    group: String,
    pid: Option<Pid>,
    waiting: JoinHandle<()>,
}

impl Guest {
    /// Draws on the terminal. Its Ctrl-C is a key there, and is passed on as the signal that it would have been.
    ///
    /// # Errors
    /// If there is no terminal, or no process.
    pub(super) fn view(group: &str) -> anyhow::Result<Self> {
        anyhow::ensure!(say::to_terminal(), Failure::usage("--tui needs a terminal"));
        let before = tcgetattr(say::screen()).ok();
        let view = spawn::process(command(group, VIEW_ID)?.arg("--tui")).context("the live view")?;
        Self::wait_for(group, view, move |code| {
            if code == Some(i32::from(Exit::Interrupted.code())) {
                let _ = kill_process(getpid(), Signal::INT);
            }
            if let (None, Some(before)) = (code, before) {
                give_terminal_back(&before);
            }
        })
    }

    /// Serves at `address`, to pages of `origins` too; its report is nobody's, since there is the launcher's own.
    ///
    /// # Errors
    /// If the address can't be had, or there is no process.
    pub(super) fn server(group: &str, address: &Address, origins: &[Origin], quiet: bool) -> anyhow::Result<Self> {
        // Better no run than one that can't be looked at as was asked.
        address.probe().map_err(|e| Failure::usage(e.to_string()))?;
        let mut server = command(group, SERVER_ID)?;
        server
            .args(["--foxglove", &address.to_string()])
            // Its errors are said in any case.
            .args(quiet.then_some("--quiet"))
            .args(origins.iter().map(|origin| format!("--foxglove-origin={origin}")))
            // The terminal's Ctrl-C is the launcher's; this process ends with the group.
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::null());
        Self::wait_for(group, spawn::process(&mut server).context("the server for Foxglove")?, |_| ())
    }

    fn wait_for(
        group: &str,
        mut child: Child,
        then: impl FnOnce(Option<i32>) + Send + 'static,
    ) -> anyhow::Result<Self> {
        let pid = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
        let wait = move || then(child.wait().ok().and_then(|status| status.code()));
        let waiting = spawn::thread("guest", wait)?;
        Ok(Self { group: group.to_owned(), pid, waiting })
    }

    /// Waits until it has left by itself, for a while.
    pub(super) fn leave(self) {
        self.left_within(LEAVE_NS);
    }

    fn left_within(&self, timeout_ns: u64) -> bool {
        let until_ns = now_ns() + timeout_ns;
        while !self.waiting.is_finished() && now_ns() < until_ns {
            sleep_ns(LOOK_NS);
        }
        self.waiting.is_finished()
    }
}

impl Drop for Guest {
    /// Without a group of this run it would wait for one, or watch another of that name.
    fn drop(&mut self) {
        for signal in [Signal::TERM, Signal::KILL] {
            if let Some(pid) = self.pid.filter(|_| !self.waiting.is_finished()) {
                let _ = kill_process(pid, signal);
                self.left_within(LEAVE_NS / 5);
            }
        }
        // One that had to be killed may have been the last member.
        let _ = sweep_if_dead(&self.group);
    }
}

/// What a view that was killed could not do: the ordinary screen and its cursor, lines and echo as before.
fn give_terminal_back(before: &Termios) {
    let mut screen = say::screen();
    let _ = write!(screen, "\x1b[?1049l\x1b[?25h").and_then(|()| screen.flush());
    let _ = tcsetattr(screen, OptionalActions::Now, before);
}

fn command(group: &str, id: u32) -> anyhow::Result<Command> {
    let mut command = Command::new(std::env::current_exe()?);
    let (id, parent) = (id.to_string(), std::process::id().to_string());
    command.args(["monitor", "--id", &id, "--group", group, "--parent", &parent]);
    Ok(command)
}
