//! The live view and its terminal: whatever ends the view, the run goes on or ends in order, and nothing is left.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::process::{Child, Command};
use std::thread::JoinHandle;

use loopbound_shared::clock;
use rustix::fs::{Mode, OFlags};
use rustix::process::Signal;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, tcgetattr};

use crate::harness::{Case, PATIENCE_S, processes_that_mention, send, wait_until};

/// A run with a live view on a terminal of its own.
struct Viewed {
    launcher: Child,
    /// The end of the terminal that a window would hold.
    window: Option<OwnedFd>,
    /// Held open, to see how the terminal was left.
    terminal: File,
    case: Case,
}

impl Viewed {
    /// `session`: the launcher leads the terminal's session, as a window's own program does.
    fn start(what: &str, session: bool) -> Self {
        let case = Case::new(what);
        let window = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).expect("a terminal");
        grantpt(&window).and_then(|()| unlockpt(&window)).expect("a terminal");
        let name = ptsname(&window, Vec::new()).expect("its name");
        let open = || {
            File::from(
                rustix::fs::open(&name, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())
                    .expect("its other end"),
            )
        };
        let group = case.group.clone();
        let plain = case.command(&["run", "--duration", "3s", "--tui", "--group", &group]);
        let mut command = if session {
            let mut setsid = Command::new("setsid");
            setsid.arg("--ctty").arg(plain.get_program()).args(plain.get_args());
            setsid.envs(plain.get_envs().filter_map(|(key, value)| Some((key, value?))));
            setsid
        } else {
            plain
        };
        command.env("TERM", "xterm").stdin(open()).stdout(open()).stderr(open());
        let launcher = command.spawn().expect("it starts");
        let viewed = Self { launcher, window: Some(window), terminal: open(), case };
        wait_until("the view draws", || !viewed.views().is_empty() && viewed.is_raw());
        viewed
    }

    fn is_raw(&self) -> bool {
        tcgetattr(&self.terminal).is_ok_and(|terminal| !terminal.local_modes.contains(LocalModes::ICANON))
    }

    fn views(&self) -> Vec<u32> {
        let of_the_group = processes_that_mention(&self.case.group);
        let views = of_the_group.iter().filter(|line| line.contains("--tui") && line.contains(" monitor "));
        views.filter_map(|line| line.split(':').next()?.parse().ok()).collect()
    }

    /// Takes what is drawn, as a window does.
    fn watch(&self) -> JoinHandle<String> {
        let window = self.window.as_ref().and_then(|window| window.try_clone().ok()).expect("the window");
        std::thread::spawn(move || {
            let (mut drawn, mut bytes, mut window) = (Vec::new(), [0; 4096], File::from(window));
            // It ends with an error when nobody has the other end any more.
            while let Ok(count) = window.read(&mut bytes) {
                drawn.extend_from_slice(&bytes[..count]);
            }
            String::from_utf8_lossy(&drawn).into_owned()
        })
    }

    fn code(mut self) -> Option<i32> {
        let until_ns = clock::now_ns() + PATIENCE_S * clock::NS_PER_S;
        let code = loop {
            if let Some(status) = self.launcher.try_wait().expect("the state of a child") {
                break status.code();
            }
            if clock::now_ns() >= until_ns {
                let _ = self.launcher.kill();
                panic!("it hangs");
            }
            clock::sleep_ns(2_000_000);
        };
        self.case.assert_nothing_left();
        code
    }
}

/// A verdict's exit code, whatever this machine's timing makes of the run.
fn is_verdict(code: Option<i32>) -> bool {
    matches!(code, Some(0 | 1 | 3))
}

#[test]
fn a_terminal_that_goes_ends_the_view_alone_and_the_run_comes_to_its_verdict() {
    let mut viewed = Viewed::start("gone-tty", false);
    // The test's own end would not keep it: a terminal is gone when its window is.
    viewed.window = None;
    wait_until("the view has left", || viewed.views().is_empty());
    assert!(viewed.launcher.try_wait().expect("the state of a child").is_none(), "the run goes on");
    let code = viewed.code();
    assert!(is_verdict(code), "{code:?}");
}

#[test]
fn a_hangup_ends_the_run_in_order() {
    let mut viewed = Viewed::start("hangup", true);
    viewed.window = None;
    assert_eq!(viewed.code(), Some(143));
}

#[test]
fn the_terminal_is_given_back_though_the_view_was_killed() {
    let viewed = Viewed::start("killed-view", false);
    let drawn = viewed.watch();
    viewed.views().into_iter().for_each(|pid| send(pid, Signal::KILL));
    wait_until("lines and echo are as before", || !viewed.is_raw());
    let code = viewed.code();
    assert!(is_verdict(code), "{code:?}");
    assert!(drawn.join().expect("the window's reader").contains("\x1b[?1049l\x1b[?25h"), "the ordinary screen");
}

#[test]
fn q_leaves_the_view_and_ctrl_c_ends_the_run() {
    for (key, ends) in [(b"q", false), (b"\x03", true)] {
        let viewed = Viewed::start("keys", false);
        let drawn = viewed.watch();
        let mut window = File::from(viewed.window.as_ref().and_then(|w| w.try_clone().ok()).expect("the window"));
        window.write_all(key).expect("a key");
        wait_until("the view has left", || viewed.views().is_empty());
        let code = viewed.code();
        assert!(if ends { code == Some(130) } else { is_verdict(code) }, "{code:?}");
        drop(window);
        drawn.join().expect("the window's reader");
    }
}
