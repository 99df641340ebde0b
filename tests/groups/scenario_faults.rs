//! Faults on purpose that are not the controllers': of the plant's states, of a monitor; and what lockstep can't have.

use serde_json::Value;

use crate::harness::{Case, wait_until};

fn number(summary: &Value, path: &str) -> u64 {
    summary.pointer(path).and_then(Value::as_u64).unwrap_or_else(|| panic!("{path}: {summary}"))
}

#[test]
fn states_that_are_lost_doubled_swapped_or_stamped_wrongly_are_named_and_lose_no_tick_but_their_own() {
    let case = Case::new("plant-faults");
    let faults = [
        ("drop", "at = 100"),
        ("duplicate", "at = 150"),
        ("reorder", "at = 200"),
        ("delay", "at = 250\ndelay = \"3ms\""),
        ("clock-step", "at = 300\nstep = \"-5ms\""),
    ];
    let mut scenario = "[loop]\nduration = \"800ms\"\nrate = \"500Hz\"\n[controller.gains]\nk3 = 0.02\n".to_owned();
    for (kind, keys) in faults {
        scenario += &format!("[[fault]]\ntarget = \"plant\"\nkind = \"{kind}\"\n{keys}\n");
    }
    let ended = case.run(&scenario, &[]).wait();
    case.assert_nothing_left();
    let summary = ended.json();
    // The lost state and the one that came after its successor can't have been answered in time; the delayed one is late.
    assert!(number(&summary, "/missed_ticks_by_cause/injected_fault") >= 3, "{}", summary["missed_ticks_by_cause"]);
    assert_eq!(number(&summary, "/counters/ticks") + number(&summary, "/counters/skipped"), 400);
    assert!(number(&summary, "/counters/duplicate") + number(&summary, "/counters/stale") >= 2, "{summary}");
    // From the step of the clock on, each of the hundred ticks was answered all the same, but for what the host took.
    assert!(number(&summary, "/missed_ticks") < 100, "{}", summary["missed_ticks_by_cause"]);
}

#[test]
fn a_monitor_that_a_fault_kills_is_started_again() {
    let case = Case::new("monitor-fault");
    let scenario = "[loop]\nduration = \"1s\"\n[[fault]]\ntarget = \"monitor\"\nkind = \"kill\"\nat = 200\n";
    let ended = case.run(scenario, &[]).wait();
    case.assert_nothing_left();
    let summary = ended.json();
    let deaths = summary["supervision"]["deaths"].as_array().cloned().unwrap_or_default();
    assert_eq!(deaths.len(), 1, "{deaths:?}");
    assert_eq!((deaths[0]["role"].as_str(), deaths[0]["recovered"].as_bool()), (Some("monitor"), Some(true)));
}

#[test]
fn the_controller_that_a_scheduled_swap_replaced_retires() {
    let case = Case::new("scheduled");
    let scenario = "[loop]\nduration = \"20s\"\n[swap_gate]\nretire_after = \"100ms\"\n[[swap]]\nat = 300\nlaw = \"ctc\"\nblend = \"20ms\"\n";
    let mut running = case.run(scenario, &[]);
    running.process("controller", 2, &["active"]);
    wait_until("controller 1 has gone", || {
        !running.roster().iter().any(|process| process["role"] == "controller" && process["id"] == 1)
    });
    running.signal(rustix::process::Signal::TERM);
    let ended = running.wait();
    case.assert_nothing_left();
    assert_eq!(ended.json()["supervision"]["deaths"], Value::Array(Vec::new()), "to retire is not to die");
}

#[test]
fn a_controller_that_steps_in_before_its_scheduled_swap_replaces_nobody() {
    let case = Case::new("early");
    let scenario = "[loop]\nduration = \"20s\"\n[swap_gate]\nretire_after = \"100ms\"\n[[swap]]\nat = \"19s\"\nlaw = \"robust-ff\"\n\
                    [[fault]]\nkind = \"nan\"\ntarget = \"controller:1\"\nat = 300\n";
    let mut running = case.run(scenario, &[]);
    running.process("controller", 2, &["active"]);
    // Five times as long as a replaced one would stay.
    loopbound_shared::clock::sleep_ns(500_000_000);
    running.process("controller", 1, &["active", "standby", "fenced", "silent"]);
    running.signal(rustix::process::Signal::TERM);
    let ended = running.wait();
    case.assert_nothing_left();
    assert_eq!(ended.json()["supervision"]["deaths"], Value::Array(Vec::new()));
}
