//! A monitor comes and goes while the group runs: it sees what there is to see, and nobody suffers for it.

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Case, wait_until};

/// Ticks that a run blames on a monitor's coming or going.
fn blamed_on_monitors(summary: &Value) -> u64 {
    let of = |table: &str| summary[table]["monitor_joined"].as_u64().unwrap_or(0);
    of("late_ticks_by_cause") + of("missed_ticks_by_cause")
}

#[test]
fn a_monitor_attaches_and_leaves_in_full_flight() {
    let case = Case::new("attach");
    let mut running = case.run("[loop]\nduration = \"1500ms\"\n", &[]);
    running.wait_until_active();
    let attached = case.output(&["monitor", "--group", &case.group, "--duration", "400ms", "--json"]).json_with(0);
    assert_eq!((&attached["ended"], &attached["group"]), (&Value::from("duration"), &Value::from(case.group.as_str())));
    let number = |key: &str| attached[key].as_u64().unwrap_or_else(|| panic!("{key}: {attached}"));
    assert!(number("ticks_seen") > 0);
    assert!(number("first_tick") > 0, "it came when the loop was running");
    let span = number("last_tick") - number("first_tick") + 1;
    assert!(number("ticks_seen") + number("monitor_gaps") <= span);
    assert_eq!(attached["bound"]["law"], "robust", "it learns who is in charge from the announcements kept for it");
    let summary = running.wait().json();
    assert_eq!(summary["supervision"]["end"], "done");
    assert_eq!(summary["supervision"]["deaths"], Value::Array(Vec::new()), "a monitor that leaves is not a death");
    // Three ports are mapped and unmapped again, and each costs at most its own tick and the one after.
    assert!(blamed_on_monitors(&summary) <= 12, "{}", summary["late_ticks_by_cause"]);
    case.assert_nothing_left();
}

#[test]
fn a_run_that_nobody_joins_blames_nobody_for_joining() {
    let case = Case::new("alone");
    let summary = case.run("[loop]\nduration = \"1s\"\n", &[]).wait().json();
    assert_eq!(
        blamed_on_monitors(&summary),
        0,
        "{} {}",
        summary["late_ticks_by_cause"],
        summary["missed_ticks_by_cause"]
    );
    case.assert_nothing_left();
}

#[test]
fn an_attached_monitor_ends_with_the_group_or_on_ctrl_c_and_writes_its_files() {
    let case = Case::new("attach-end");
    let mut running = case.run("[loop]\nduration = \"1500ms\"\n", &[]);
    running.wait_until_active();
    let to_the_end = case.start(&["monitor", "--group", &case.group, "--json", "--out", "seen"]);
    let interrupted = case.start(&["monitor", "--group", &case.group, "--json", "--out", "cut"]);
    let samples = case.work.path().join("cut/samples.csv");
    wait_until("the second monitor records", || samples.metadata().is_ok_and(|file| file.len() > 0));
    interrupted.signal(Signal::INT);
    assert_eq!(interrupted.wait().json_with(0)["ended"], "stopped");
    assert_eq!(to_the_end.wait().json_with(0)["ended"], "last record");
    running.wait().json();
    for folder in ["seen", "cut"] {
        for file in ["summary.json", "samples.csv", "scenario.toml"] {
            assert!(case.work.path().join(folder).join(file).exists(), "no {folder}/{file}");
        }
    }
    case.assert_nothing_left();
}

#[test]
fn a_monitor_that_is_killed_or_that_hangs_does_not_stop_the_group() {
    for (signal, mode) in [(Signal::KILL, "realtime"), (Signal::STOP, "realtime"), (Signal::STOP, "lockstep")] {
        let case = Case::apart("attach-bad");
        // In lockstep as many ticks as take about as long.
        let duration = if mode == "lockstep" { "20s" } else { "1s" };
        let mut running = case.run(&format!("[loop]\nmode = \"{mode}\"\nduration = \"{duration}\"\n"), &[]);
        running.wait_until_active();
        let attached = case.start(&["monitor", "--group", &case.group, "--json", "--out", "seen"]);
        let samples = case.work.path().join("seen/samples.csv");
        wait_until("the monitor is in the group", || samples.exists() || !running.runs());
        if running.runs() {
            attached.signal(signal);
        }
        let summary = running.wait().json();
        assert_eq!(summary["supervision"]["end"], "done", "{}", summary["supervision"]);
        assert_eq!(summary["supervision"]["deaths"], Value::Array(Vec::new()));
        drop(attached);
        // A killed guest can't clean, and one that was the last can't either: that is left to `clean`.
        case.output(&["clean"]);
        case.assert_nothing_left();
    }
}
