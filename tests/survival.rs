//! Swaps and deaths on real processes, at a rate that a busy machine keeps too.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

use loopbound::supervise::{Entry, ROSTER_FILE, Roster};
use loopbound_shared::clock;
use loopbound_shared::group::runtime_folder;
use loopbound_shared::realtime::{ProcessHandle, Signal};
use serde_json::Value;

const LOOPBOUND: &str = env!("CARGO_BIN_EXE_loopbound");
/// More than any wait here takes on a busy machine.
const PATIENCE_NS: u64 = 30_000_000_000;

/// One group at a time: two on two cores would stall each other.
static TURN: Mutex<()> = Mutex::new(());

struct Group {
    name: String,
    launcher: Child,
    _turn: MutexGuard<'static, ()>,
}

impl Group {
    /// 100 Hz: a stall of the machine of some milliseconds is no miss. The law has to be one that is stable there.
    fn start(what: &str, settings: &[&str]) -> Self {
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let name = format!("test-{what}-{}", std::process::id());
        let mut command = Command::new(LOOPBOUND);
        command.args(["run", "--group", &name, "--quiet", "--rate", "100Hz", "--duration", "60s", "--wakeup", "block"]);
        command.args(["--law", "ctc"]);
        for setting in settings {
            command.args(["--set", setting]);
        }
        let launcher = command.stdin(Stdio::null()).spawn().expect("loopbound starts");
        let group = Self { name, launcher, _turn: turn };
        group.wait("nobody is in charge", |roster| with_state(roster, "active").is_some());
        group
    }

    fn wait(&self, what: &str, right: impl Fn(&Roster) -> bool) -> Roster {
        let until_ns = clock::now_ns() + PATIENCE_NS;
        loop {
            let bytes =
                std::fs::read(runtime_folder().expect("a valid runtime directory").join(&self.name).join(ROSTER_FILE))
                    .unwrap_or_default();
            let roster: Roster = serde_json::from_slice(&bytes).unwrap_or_default();
            if right(&roster) {
                return roster;
            }
            assert!(clock::now_ns() < until_ns, "{what}: {roster:?}");
            clock::sleep_ns(5_000_000);
        }
    }

    fn swap(&self, arguments: &[&str]) -> (Option<i32>, Value) {
        let output: Output = Command::new(LOOPBOUND)
            .args(["swap", "--json", "--group", &self.name])
            .args(arguments)
            .output()
            .expect("it runs");
        (output.status.code(), serde_json::from_slice(&output.stdout).unwrap_or_default())
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        if let Ok(launcher) = ProcessHandle::open(self.launcher.id()) {
            let _ = launcher.signal(Signal::TERM);
        }
        let _ = self.launcher.wait();
        if !std::thread::panicking() {
            assert!(
                !Path::new(&runtime_folder().expect("a valid runtime directory").join(&self.name)).exists(),
                "the last one sweeps"
            );
        }
    }
}

fn with_state<'a>(roster: &'a Roster, state: &str) -> Option<&'a Entry> {
    roster.processes.iter().find(|p| p.state == state)
}

#[test]
fn a_running_group_changes_its_law_and_the_old_process_retires() {
    let group = Group::start("swap", &["swap_gate.retire_after=100ms"]);
    let (code, report) = group.swap(&["--law", "pd+g", "--blend", "50ms"]);
    assert_eq!((code, report["result"].as_str()), (Some(0), Some("done")), "{report}");
    assert_eq!((report["from"].as_u64(), report["to"].as_u64()), (Some(1), Some(2)));
    assert_eq!(report["torque_step_nm"].as_array().map(Vec::len), Some(3));
    assert!(report["delta_v"].is_number() && report["command_to_authority_ns"].is_u64(), "{report}");
    let roster = group
        .wait("controller 1 stays", |roster| !roster.processes.iter().any(|p| p.role == "controller" && p.id == 1));
    assert_eq!(with_state(&roster, "active").map(|p| p.id), Some(2));
}

#[test]
fn a_refused_swap_ends_with_code_4_and_the_old_one_stays_in_charge() {
    let group = Group::start("refused", &[]);
    for (arguments, because) in [
        (["--to", "9"].as_slice(), "no such controller"),
        (&["--exe", "/bin/false"], "ended before it was ready"),
        (&["--law", "ctc", "--at-tick", "1"], "the tick named has passed"),
    ] {
        let (code, report) = group.swap(arguments);
        assert_eq!((code, report["result"].as_str()), (Some(4), Some("refused")), "{arguments:?}: {report}");
        assert!(report["reason"].as_str().is_some_and(|reason| reason.contains(because)), "{report}");
    }
    let roster =
        group.wait("somebody stays", |roster| roster.processes.iter().filter(|p| p.role == "controller").count() == 1);
    assert_eq!(with_state(&roster, "active").map(|p| p.id), Some(1));
}

#[test]
fn a_killed_controller_is_replaced_and_comes_back_with_a_new_number() {
    let group = Group::start("killed", &["controller.standby=1"]);
    let both = group.wait("no standby", |roster| with_state(roster, "standby").is_some());
    let victim = with_state(&both, "active").unwrap().pid;
    ProcessHandle::open(victim).unwrap().signal(Signal::KILL).unwrap();
    let roster = group.wait("nobody comes back", |roster| {
        with_state(roster, "active").is_some_and(|p| p.id == 2) && with_state(roster, "standby").is_some()
    });
    assert_eq!(with_state(&roster, "standby").map(|p| p.id), Some(3));
    let (code, report) = group.swap(&["--to", "3"]);
    assert_eq!((code, report["from"].as_u64(), report["to"].as_u64()), (Some(0), Some(2), Some(3)), "{report}");
}
