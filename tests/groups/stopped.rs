//! Processes that are stopped for a while and go on: the causes name whoever did not run, and nobody else.

use loopbound_shared::clock;
use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Case, send};

const RUN: &str = "[loop]\nduration = \"2s\"\n";
const STOPPED_NS: u64 = 300_000_000;

/// Stops the processes of some roles in full flight for 0.3 s.
fn stopped(what: &str, roles: &[&str]) -> Value {
    let case = Case::new(&format!("stopped-{what}"));
    let mut running = case.run(RUN, &[]);
    running.wait_until_active();
    let mut pids: Vec<u32> = Vec::new();
    for role in roles {
        pids.push(if *role == "launcher" { running.pid() } else { running.process(role, 1, &["ready", "active"]) });
    }
    pids.iter().for_each(|pid| send(*pid, Signal::STOP));
    clock::sleep_until_ns(clock::now_ns() + STOPPED_NS);
    pids.iter().for_each(|pid| send(*pid, Signal::CONT));
    let summary = running.wait().json();
    case.assert_nothing_left();
    summary
}

fn missed(summary: &Value, cause: &str) -> u64 {
    summary["missed_ticks_by_cause"][cause].as_u64().unwrap_or(0)
}

#[test]
fn while_everybody_was_stopped_the_plant_did_not_run_and_no_setpoint_is_to_blame() {
    for (what, roles) in [
        ("all", &["launcher", "monitor", "reference", "controller", "plant"][..]),
        ("plant", &["plant"]),
        ("two", &["plant", "controller"]),
    ] {
        let summary = stopped(what, roles);
        let causes = &summary["missed_ticks_by_cause"];
        assert!(missed(&summary, "timer_or_host") >= 200, "{what}: {causes}");
        assert_eq!(
            (missed(&summary, "setpoint_stale"), missed(&summary, "controller_dead")),
            (0, 0),
            "{what}: {causes}"
        );
    }
}

#[test]
fn a_controller_that_is_stopped_is_silent_and_not_dead() {
    let summary = stopped("controller", &["controller"]);
    let causes = &summary["missed_ticks_by_cause"];
    assert!(missed(&summary, "controller_silent") >= 200, "{causes}");
    assert_eq!(missed(&summary, "controller_dead"), 0, "{causes}");
    // Meanwhile the plant brakes, which no controller is to blame for.
    assert_eq!(summary["bound"]["verdicts"]["controller_fault"], 0, "{}", summary["bound"]);
}

#[test]
fn without_its_reference_the_setpoints_are_stale_and_nobody_is_silent() {
    let summary = stopped("reference", &["reference"]);
    assert!(summary["setpoint_stale"].as_u64().is_some_and(|ticks| ticks >= 100), "{}", summary["setpoint_stale"]);
    let causes = &summary["missed_ticks_by_cause"];
    assert_eq!((missed(&summary, "controller_silent"), missed(&summary, "controller_dead")), (0, 0), "{causes}");
}
