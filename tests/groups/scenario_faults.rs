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

#[test]
fn ticks_that_a_dropping_or_a_hanging_controller_leaves_unanswered_are_attributed_to_the_fault() {
    let case = Case::new("unanswered");
    let out = case.work.path().join("out");
    // At 5 ms a tick: 60 to 79 dropped, 120 to 140 in a hang, and from 170 on nobody lives who could answer.
    let scenario = "[loop]\nrate = \"200Hz\"\nduration = \"900ms\"\n[controller]\nlaw = \"pd+g\"\n\
                    [[fault]]\nkind = \"drop\"\nat = 60\nfor = 20\n\
                    [[fault]]\nkind = \"hang\"\nat = 120\nfor = \"100ms\"\n\
                    [[fault]]\nkind = \"kill\"\nat = 170\n";
    let ended = case.run(scenario, &["--out", out.to_str().expect("a path in UTF-8")]).wait();
    case.assert_nothing_left();
    let summary = ended.json();
    let events = std::fs::read_to_string(out.join("events.jsonl")).expect("the file was written");
    let events: Vec<Value> = events.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect();
    let missed = |from: u64, to: u64| {
        let within = move |event: &&Value| event["tick"].as_u64().is_some_and(|tick| (from..to).contains(&tick));
        events.iter().filter(within).filter(|event| event["kind"] == "missed").collect::<Vec<_>>()
    };
    for (from, to) in [(60, 80), (120, 141), (170, 175)] {
        let found = missed(from, to);
        // What the machine itself takes away is skipped, and has its own cause.
        let injected = found.iter().filter(|event| event["cause"] == "injected_fault").count();
        assert!(injected as u64 * 2 >= to - from, "{from} to {to}: {}", summary["missed_ticks_by_cause"]);
        let blamed = ["controller_silent", "controller_late", "controller_dead"];
        let wrong: Vec<_> = found.iter().filter(|event| blamed.iter().any(|cause| event["cause"] == *cause)).collect();
        assert!(wrong.is_empty(), "{wrong:?}");
    }
}
