//! Whoever is killed is named, never hangs the rest, and leaves nothing; what is recovered is recovered.

use loopbound_shared::realtime::ProcessHandle;
use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Case, Ended, Running, processes_that_mention, send, wait_until};

const LONG: &str = "[loop]\nduration = \"2s\"\n";
const HELD_OR_NOT: [i32; 3] = [0, 1, 3];

fn death_of<'a>(summary: &'a Value, role: &str, id: u64) -> &'a Value {
    let deaths = summary["supervision"]["deaths"].as_array().expect("a list of deaths");
    let found = deaths.iter().find(|death| death["role"] == role && death["id"] == id);
    found.unwrap_or_else(|| panic!("{role} {id} is not named among {deaths:?}"))
}

/// Kills one process of a group in full flight and waits for the group's end.
fn killed(case: &Case, scenario: &str, role: &str, id: u64) -> Ended {
    let mut running = case.run(scenario, &[]);
    running.wait_until_active();
    let pid = running.process(role, id, &["ready", "active", "standby"]);
    send(pid, Signal::KILL);
    let ended = running.wait();
    case.assert_nothing_left();
    ended
}

#[test]
fn a_killed_controller_with_a_standby_is_recovered_and_named() {
    let case = Case::new("kill-active");
    let ended = killed(&case, &format!("{LONG}[controller]\nstandby = 1\n"), "controller", 1);
    assert!(ended.code.is_some_and(|code| HELD_OR_NOT.contains(&code)), "{ended:?}");
    let summary = ended.json();
    let death = death_of(&summary, "controller", 1);
    assert_eq!(death["recovered"], true, "{death}");
    assert!(death["how"].as_str().is_some_and(|how| how.contains("SIGKILL")), "{death}");
    assert!(ended.err.contains("controller 1"), "{}", ended.err);
}

#[test]
fn a_killed_only_controller_is_started_again_and_the_plant_brakes_meanwhile() {
    let case = Case::new("kill-only");
    let ended = killed(&case, LONG, "controller", 1);
    let summary = ended.json();
    assert_eq!(death_of(&summary, "controller", 1)["recovered"], true, "{}", summary["supervision"]);
    let restarted = summary["supervision"]["processes"].as_array().into_iter().flatten();
    let restarts: Vec<_> = restarted.filter(|p| p["role"] == "controller").map(|p| p["restarts"].clone()).collect();
    assert_eq!(restarts, [1]);
    assert!(summary["missed_ticks"].as_u64().is_some_and(|missed| missed > 0), "{}", summary["missed_ticks"]);
    assert_ne!(ended.code, Some(5), "{}", ended.err);
}

#[test]
fn a_killed_plant_ends_the_group_with_code_5() {
    let case = Case::new("kill-plant");
    let ended = killed(&case, LONG, "plant", 1);
    let summary = ended.json_with(5);
    assert_eq!(death_of(&summary, "plant", 1)["recovered"], false);
    assert_eq!(summary["supervision"]["end"], "the plant died");
    assert!(ended.err.contains("plant 1"), "{}", ended.err);
    assert!(
        summary["ticks"].as_u64().is_some_and(|ticks| ticks > 0),
        "what was seen is reported: {}",
        summary["ticks"]
    );
}

#[test]
fn a_killed_reference_and_a_killed_monitor_are_started_again() {
    for role in ["reference", "monitor"] {
        let case = Case::new(&format!("kill-{role}"));
        let ended = killed(&case, LONG, role, 1);
        assert!(ended.code.is_some_and(|code| HELD_OR_NOT.contains(&code)), "{role}: {ended:?}");
        let summary = ended.json();
        assert_eq!(death_of(&summary, role, 1)["recovered"], true, "{}", summary["supervision"]);
        assert_eq!(summary["supervision"]["end"], "done");
    }
}

#[test]
fn a_policy_may_end_the_group_with_its_reference() {
    let case = Case::new("policy");
    let ended = killed(&case, &format!("{LONG}[supervisor]\nreference = \"end\"\n"), "reference", 1);
    let summary = ended.json_with(5);
    let end = summary["supervision"]["end"].as_str().expect("an end");
    assert!(end.contains("policy") && end.contains("reference"), "{end}");
}

#[test]
fn a_killed_launcher_takes_its_children_along_and_the_last_one_cleans() {
    for standby in [0, 1] {
        let case = Case::new(&format!("kill-launcher-{standby}"));
        let mut running = case.run(&format!("[loop]\nduration = \"1h\"\n[controller]\nstandby = {standby}\n"), &[]);
        running.wait_until_active();
        running.signal(Signal::KILL);
        assert_eq!(running.wait().code, None);
        case.assert_nothing_left();
    }
}

#[test]
fn killed_in_lockstep_a_group_goes_on_or_ends_but_never_hangs() {
    let scenario = "[loop]\nmode = \"lockstep\"\nduration = \"1000000s\"\nrate = \"1kHz\"\n";
    let case = Case::new("kill-lockstep");
    for (role, code) in [("plant", 5), ("controller", 143), ("reference", 143), ("monitor", 143)] {
        let mut running = case.run(scenario, &[]);
        running.wait_until_active();
        let pid = running.process(role, 1, &["ready", "active"]);
        send(pid, Signal::KILL);
        if code == 143 {
            wait_until("the death is noticed", || noticed(&running, role, pid));
            running.signal(Signal::TERM);
        }
        let ended = running.wait();
        assert_eq!(ended.code, Some(code), "{role}: {ended:?}");
        death_of(&ended.json(), role, 1);
        case.assert_nothing_left();
    }
}

fn noticed(running: &Running, role: &str, pid: u32) -> bool {
    let is_back = |p: &Value| p["role"] == role && p["pid"] != pid;
    running.roster().iter().any(|p| p["role"] == role && p["state"] == "dead" || is_back(p))
}

#[test]
fn everyone_killed_at_once_is_cleaned_by_clean_or_by_the_next_run() {
    for by_clean in [true, false] {
        let case = Case::apart(&format!("all-{by_clean}"));
        let mut running = case.run("[loop]\nduration = \"1h\"\n", &[]);
        running.wait_until_active();
        case.keeper(0);
        let all = case.everyone();
        assert_eq!(all.len(), 6, "the launcher, its four, and the keeper");
        // Stopped first, so that nobody is left to notice and clean while the others are being killed.
        all.iter().for_each(|pid| send(*pid, Signal::STOP));
        all.iter().for_each(|pid| send(*pid, Signal::KILL));
        assert_eq!(running.wait().code, None);
        wait_until("all of them are dead", || !case.is_mentioned());
        assert!(case.group_folder().exists(), "nobody was left to clean");
        if by_clean {
            // A killed process gives up its hold only when the kernel has torn it down: until then the group is not dead.
            wait_until("the dead group is cleaned", || {
                let ended = case.output(&["clean"]);
                assert_eq!(ended.code, Some(0), "{ended:?}");
                ended.out.contains(&case.group)
            });
        } else {
            let ended = case.run("[loop]\nduration = \"200ms\"\n", &[]).wait();
            assert!(ended.code.is_some_and(|code| HELD_OR_NOT.contains(&code)), "{ended:?}");
        }
        case.assert_nothing_left();
    }
}

#[test]
fn ctrl_c_and_sigterm_end_a_group_in_order_with_its_report() {
    for (signal, code, word) in [(Signal::INT, 130, "interrupted"), (Signal::TERM, 143, "terminated")] {
        for mode in ["realtime", "lockstep"] {
            let case = Case::new(&format!("{word}-{mode}"));
            let out = case.work.path().join("out");
            let out = out.to_str().expect("a path in UTF-8");
            let scenario = format!("[loop]\nmode = \"{mode}\"\nduration = \"100000s\"\n");
            let mut running = case.run(&scenario, &["--out", out]);
            running.wait_until_active();
            running.signal(signal);
            let summary = running.wait().json_with(code);
            assert_eq!(summary["supervision"]["end"], word);
            assert_eq!(summary["supervision"]["deaths"], Value::Array(Vec::new()));
            assert!(summary["ticks"].as_u64().is_some_and(|ticks| ticks > 0));
            for file in ["summary.json", "samples.csv", "scenario.toml"] {
                assert!(case.work.path().join("out").join(file).exists(), "no {file}");
            }
            case.assert_nothing_left();
        }
    }
}

#[test]
fn a_signal_during_the_start_ends_it_without_a_trace() {
    let case = Case::new("early");
    let running = case.run("[loop]\nduration = \"1h\"\n", &[]);
    wait_until("the group is being made", || case.group_folder().join("bell").exists());
    running.signal(Signal::INT);
    assert_eq!(running.wait().code, Some(130));
    case.assert_nothing_left();
}

#[test]
fn a_plant_that_a_signal_ends_before_the_clock_runs_is_a_lost_role_and_no_fault_of_loopbound() {
    for signal in [Signal::TERM, Signal::HUP, Signal::KILL] {
        let case = Case::new("plant-early");
        let running = case.run("[loop]\nduration = \"1h\"\n", &[]);
        wait_until("the plant is being started", || {
            let lines = processes_that_mention(&case.group);
            let plant = lines.iter().find(|line| line.contains(" plant --group "));
            let pid = plant.and_then(|line| line.split_once(':')?.0.parse().ok());
            pid.is_some_and(|pid| ProcessHandle::open(pid).is_ok_and(|plant| plant.signal(signal).is_ok()))
        });
        let ended = running.wait();
        assert_eq!(ended.code, Some(5), "{signal:?}: {ended:?}");
        assert!(ended.err.contains("plant"), "{ended:?}");
        case.assert_nothing_left();
    }
}

#[test]
fn a_plant_that_a_signal_ends_alone_leaves_an_incomplete_run_whatever_was_expected() {
    for (signal, mode) in [(Signal::INT, "realtime"), (Signal::HUP, "realtime"), (Signal::TERM, "lockstep")] {
        let case = Case::new(&format!("plant-alone-{mode}"));
        let out = case.work.path().join("out");
        let out = out.to_str().expect("a path in UTF-8");
        let scenario = format!("[loop]\nmode = \"{mode}\"\nduration = \"100000s\"\n[expect]\nticks = \">= 1\"\n");
        let mut running = case.run(&scenario, &["--out", out]);
        running.wait_until_active();
        let pid = running.process("plant", 1, &["ready", "active"]);
        send(pid, signal);
        let ended = running.wait();
        let summary = ended.json_with(5);
        assert_eq!(summary["verdict"]["status"], "incomplete", "{}", summary["verdict"]);
        let ended = case.output(&["check", out]);
        assert!(ended.code == Some(5) && ended.out.contains("incomplete"), "{ended:?}");
        assert_eq!(case.output(&["report", out]).code, Some(5));
        case.assert_nothing_left();
    }
}
