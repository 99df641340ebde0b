//! Nothing outlives a run, whoever is killed in whatever order: not what a wrapper has started, wherever it went.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use loopbound_model::rng::{Stream, bits};
use loopbound_shared::clock;
use rustix::process::Signal;

use crate::harness::{Case, Running, processes_that_mention, send, wait_until};
use crate::untested::not_tested;

const FOREVER: &str = "[loop]\nrate = \"100Hz\"\nduration = \"1h\"\nwakeup = \"block\"\n";

/// An argument that only the descendants of this case's wrapper have.
fn word(case: &Case) -> String {
    let number: u64 = case.group.bytes().map(u64::from).sum();
    format!("{}.{number}", 1_000_000 + std::process::id())
}

/// A controller behind a shell script without `exec`, which starts others in every way that loses their parent.
fn wrapper(case: &Case, arguments: &str, after: &str) -> PathBuf {
    let (word, executable) = (word(case), env!("CARGO_BIN_EXE_loopbound"));
    let script = format!(
        "#!/bin/sh\nsleep {word} &\nsetsid sleep {word} &\n(sleep {word} &)\n(setsid nohup sleep {word} >/dev/null &)\n\
         env -i sleep {word} &\n{executable} controller \"$@\" {arguments}\n{after}\n"
    );
    executable_file(case, "wrapper", &script)
}

fn executable_file(case: &Case, name: &str, text: &str) -> PathBuf {
    let path = case.write(name, text);
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("permissions");
    path
}

fn wrapped(case: &Case, scenario: &str) -> Running {
    let controller = format!("[controller]\nexe = {:?}\nlaw = \"ctc\"\n", wrapper(case, "", ""));
    let mut running = case.run(&format!("{scenario}{controller}"), &[]);
    running.wait_until_active();
    let word = word(case);
    wait_until("the wrapper has started all", || processes_that_mention(&word).len() == 5);
    running
}

#[track_caller]
fn assert_nobody_left(case: &Case) {
    case.assert_nothing_left();
    let left = processes_that_mention(&word(case));
    assert!(left.is_empty(), "grandchildren live: {left:?}");
}

#[test]
fn a_controller_behind_a_shell_script_works_and_what_it_started_ends_with_the_run() {
    let case = Case::new("wrapped");
    let running = wrapped(&case, "[loop]\nrate = \"100Hz\"\nduration = \"1500ms\"\nwakeup = \"block\"\n");
    let ended = running.wait();
    // At once: the launcher has waited for the keeper.
    assert!(processes_that_mention(&word(&case)).is_empty());
    assert!(ended.code.is_some_and(|code| [0, 1, 3].contains(&code)), "{ended:?}");
    let summary = ended.json();
    assert_eq!(summary["supervision"]["deaths"], serde_json::json!([]), "{ended:?}");
    assert_nobody_left(&case);
}

#[test]
fn a_signal_ends_what_a_wrapper_started() {
    let case = Case::new("wrapped-int");
    let running = wrapped(&case, FOREVER);
    running.signal(Signal::INT);
    assert_eq!(running.wait().code, Some(130));
    assert_nobody_left(&case);
}

/// A shell script that detaches the controller twice over, and ends.
fn daemon(case: &Case, arguments: &str) -> PathBuf {
    let executable = env!("CARGO_BIN_EXE_loopbound");
    let script = format!(
        "#!/bin/sh\n(setsid {executable} controller \"$@\" {arguments} &)\n(setsid sleep {} &)\nsleep 2\n",
        word(case)
    );
    executable_file(case, "daemon", &script)
}

#[test]
fn a_wrapper_that_detaches_its_controller_is_named_and_what_it_detached_ends() {
    let case = Case::new("daemon");
    let controller = format!("[controller]\nexe = {:?}\nlaw = \"ctc\"\n", daemon(&case, ""));
    let ended = case.run(&format!("{FOREVER}{controller}"), &[]).wait();
    assert_eq!(ended.code, Some(5), "{ended:?}");
    assert!(ended.err.contains("controller 1 did not start") && ended.err.contains("detach"), "{ended:?}");
    assert_nobody_left(&case);
    // The same as a candidate: it is refused, and the run goes on.
    let mut running = case.run(&format!("{FOREVER}[controller]\nlaw = \"ctc\"\n"), &[]);
    running.wait_until_active();
    let exe = daemon(&case, "--law pd+g");
    let exe = exe.to_str().expect("a path in UTF-8");
    let answer = case.output(&["swap", "--group", &case.group, "--exe", exe, "--force", "--json"]);
    assert_eq!(answer.code, Some(4), "{answer:?}");
    assert!(answer.json()["reason"].as_str().is_some_and(|reason| reason.contains("detach")), "{answer:?}");
    assert!(running.runs());
    running.signal(Signal::INT);
    assert_eq!(running.wait().code, Some(130));
    assert_nobody_left(&case);
}

#[test]
fn a_killed_launcher_leaves_nobody_behind_a_wrapper() {
    let case = Case::new("wrapped-kill");
    let running = wrapped(&case, FOREVER);
    running.signal(Signal::KILL);
    running.wait();
    assert_nobody_left(&case);
}

#[test]
fn a_killed_keeper_has_a_successor_that_does_the_same() {
    let case = Case::new("wrapped-keeper");
    let mut running = wrapped(&case, FOREVER);
    let first = case.keeper(0);
    send(first, Signal::KILL);
    case.keeper(first);
    assert!(running.runs(), "the run goes on");
    running.signal(Signal::KILL);
    running.wait();
    assert_nobody_left(&case);
}

#[test]
fn a_keeper_killed_just_before_the_end_is_missed_by_nobody() {
    let case = Case::new("wrapped-late");
    let running = wrapped(&case, FOREVER);
    send(case.keeper(0), Signal::KILL);
    running.signal(Signal::INT);
    assert_eq!(running.wait().code, Some(130));
    assert_nobody_left(&case);
}

#[test]
fn launcher_and_keeper_killed_at_once_end_the_roles_and_the_next_run_has_the_name() {
    let case = Case::new("both");
    let mut running = case.run(FOREVER, &[]);
    running.wait_until_active();
    send(case.keeper(0), Signal::KILL);
    running.signal(Signal::KILL);
    running.wait();
    // The kernel tells the launcher's own children.
    case.assert_nothing_left();
    let ended = case.run("[loop]\nmode = \"lockstep\"\nduration = \"100ms\"\n", &[]).wait();
    assert!(ended.code.is_some_and(|code| [0, 1, 3].contains(&code)), "{ended:?}");
    case.assert_nothing_left();
}

#[test]
fn killed_in_any_order_a_run_leaves_nobody_and_nothing() {
    for seed in 0..4 {
        let case = Case::new(&format!("order-{seed}"));
        let running = wrapped(&case, FOREVER);
        let mut all = case.everyone();
        let keeper = case.keeper(0);
        // Without its keeper a killed launcher can't be kept: those two are never the first two.
        all.retain(|pid| *pid != running.pid() && *pid != keeper);
        for last in (1..all.len()).rev() {
            let choices = u64::try_from(last + 1).expect("a small number");
            let choice = bits(seed, Stream::Test, choices, 0)[0] % choices;
            all.swap(last, usize::try_from(choice).expect("a small number"));
        }
        for pid in all.iter().take(1 + usize::try_from(seed).expect("a small number")) {
            if let Ok(handle) = loopbound_shared::realtime::ProcessHandle::open(*pid) {
                let _ = handle.signal(Signal::KILL);
            }
            clock::sleep_ns(30_000_000);
        }
        // Whichever is alive; it may have ended by the deaths of the others.
        if let Ok(handle) = loopbound_shared::realtime::ProcessHandle::open(running.pid()) {
            let _ = handle.signal(Signal::KILL);
        }
        running.wait();
        assert_nobody_left(&case);
    }
}

#[test]
fn a_terminal_that_is_closed_under_the_live_view_leaves_nothing() {
    let case = Case::new("closed");
    if Command::new("script").arg("--version").stdout(Stdio::null()).status().is_err() {
        return not_tested("a terminal that is closed", "it is made by `script`, which is not here");
    }
    let file = case.write("scenario.toml", &format!("{FOREVER}[controller]\nlaw = \"ctc\"\n"));
    let run = format!("{} run {} --tui --group {}", env!("CARGO_BIN_EXE_loopbound"), file.display(), case.group);
    let mut terminal = Command::new("script");
    terminal
        .args(["-q", "-c", &run, "/dev/null"])
        .env("LOOPBOUND_RUNTIME_DIR", case.runtime_folder())
        .env("TERM", "xterm");
    let mut running = case.start_command(terminal);
    running.wait_until_active();
    // The terminal's other end is gone with it, as with a window.
    running.signal(Signal::KILL);
    running.wait();
    case.assert_nothing_left();
}

#[test]
fn a_refused_candidate_that_ignores_sigterm_costs_the_run_nothing() {
    let case = Case::new("stubborn");
    // No other law's torque is near enough for this gate.
    let gate = "[swap_gate]\nconsecutive = 1\ntorque_step_nm = 1e-12\ntimeout = \"200ms\"\n";
    let mut running = case.run(&format!("{FOREVER}[controller]\nlaw = \"ctc\"\n{gate}"), &[]);
    running.wait_until_active();
    let forever = format!("trap '' TERM\nwhile :; do sleep {}; done", word(&case));
    let refused = wrapper(&case, "--law pd+g", &forever);
    let swap = |exe: &PathBuf| {
        let exe = exe.to_str().expect("a path in UTF-8");
        case.start(&["swap", "--group", &case.group, "--exe", exe, "--json"])
    };
    let answer = swap(&refused).wait();
    assert_eq!(answer.code, Some(4), "{answer:?}");
    // It is ended long before the run is, by SIGKILL.
    wait_until("the candidate is gone", || {
        running.roster().iter().filter(|process| process["role"] == "controller").count() == 1
    });
    // Another never becomes ready, and the run ends meanwhile.
    let mute = executable_file(&case, "mute", &format!("#!/bin/sh\n{forever}\n"));
    let waiting = swap(&mute);
    wait_until("the second candidate has started", || {
        running.roster().iter().filter(|process| process["role"] == "controller").count() == 2
    });
    running.signal(Signal::INT);
    let ended = running.wait();
    waiting.wait();
    assert_eq!(ended.json_with(130)["supervision"]["deaths"], serde_json::json!([]));
    assert_nobody_left(&case);
}

#[test]
fn who_is_silent_in_lockstep_is_named_and_nobody_else() {
    let scenario = "[loop]\nmode = \"lockstep\"\nduration = \"1000000s\"\n";
    for (role, name) in
        [("reference", "reference"), ("monitor", "monitor"), ("controller", "controller 1"), ("plant", "plant")]
    {
        let case = Case::new(&format!("silent-{role}"));
        let mut running = case.run(scenario, &[]);
        running.wait_until_active();
        let pid = running.process(role, 1, &["ready", "active"]);
        send(pid, Signal::STOP);
        wait_until("it is said to be silent", || running.said().contains("is silent in tick"));
        if role != "plant" {
            running.signal(Signal::TERM);
        }
        let ended = running.wait();
        let silent: Vec<&str> = ended.err.lines().filter(|line| line.contains("is silent in tick")).collect();
        assert!(silent[0].contains(&format!(" {name} is silent")), "{role} was stopped: {}", ended.err);
        assert_eq!(silent.len(), 1, "{role} was stopped: {}", ended.err);
        case.assert_nothing_left();
    }
}

#[test]
fn hundreds_of_idle_connections_delay_neither_a_death_nor_ctrl_c() {
    let case = Case::new("idle");
    let mut running = case.run(&format!("{FOREVER}[controller]\nlaw = \"ctc\"\nstandby = 1\n"), &[]);
    running.wait_until_active();
    let control = case.group_folder().join("control");
    let idle: Vec<UnixStream> = (0..500).map(|_| UnixStream::connect(&control).expect("a connection")).collect();
    let pid = running.process("controller", 1, &["active"]);
    let from_ns = clock::now_ns();
    send(pid, Signal::KILL);
    running.process("controller", 2, &["active"]);
    let more: Vec<UnixStream> = (0..100).map(|_| UnixStream::connect(&control).expect("a connection")).collect();
    running.signal(Signal::INT);
    let ended = running.wait();
    // At 200 ms for each of them it took two minutes.
    assert!(clock::now_ns() < from_ns + 30 * clock::NS_PER_S, "{ended:?}");
    assert_eq!(ended.code, Some(130));
    drop((idle, more));
    case.assert_nothing_left();
}
