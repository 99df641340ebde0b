//! A fault that is injected into a running group befalls whom it was meant for, is named as what it is, and is over when it
//! was to be.

use serde_json::Value;

use crate::harness::{Case, Ended, wait_until};

/// Injects a fault into a group in full flight, and waits for the group's end.
fn injected(case: &Case, scenario: &str, fault: &[&str]) -> (Value, Ended, Vec<Value>) {
    let mut running = case.run(&format!("[loop]\nduration = \"2s\"\n{scenario}"), &["--out", "seen"]);
    running.wait_until_active();
    let mut arguments = vec!["fault", "--group", &case.group, "--json"];
    arguments.extend(fault);
    let report = case.output(&arguments).json_with(0);
    let ended = running.wait();
    let events = std::fs::read_to_string(case.work.path().join("seen/events.jsonl")).expect("the events");
    let events = events.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    case.assert_nothing_left();
    (report, ended, events)
}

/// Ticks of a run that were late or missed because of what was injected.
fn put_down_to_it(summary: &Value) -> u64 {
    let of = |table: &str| summary[table]["injected_fault"].as_u64().expect("a count");
    of("late_ticks_by_cause") + of("missed_ticks_by_cause")
}

fn tick(value: &Value) -> u64 {
    value["tick"].as_u64().expect("a tick")
}

#[test]
fn delayed_dropped_and_unusable_torques_are_missed_ticks_of_an_injected_fault() {
    for kind in ["delay", "drop", "nan"] {
        let case = Case::new(&format!("fault-{kind}"));
        let (report, ended, events) = injected(&case, "", &[kind, "--for", "50ms"]);
        assert_eq!((&report["result"], &report["controller"]), (&Value::from("done"), &Value::from(1)), "{report}");
        let summary = ended.json();
        // Of 50 ticks some may fall to the host, who skips them.
        assert!((25..=200).contains(&put_down_to_it(&summary)), "{kind}: {}", summary["missed_ticks_by_cause"]);
        let found: Vec<&Value> = events.iter().filter(|event| event["kind"] == "fault injected").collect();
        assert_eq!(found.len(), 1, "{kind}: {found:?}");
        assert_eq!((&found[0]["fault"], &found[0]["subject"]), (&Value::from(kind), &Value::from(1)));
        assert!(tick(found[0]) >= tick(&report), "{} of {report}", found[0]);
        // Of ticks that were skipped with the first one the event names the earliest.
        let opened = events.iter().filter(|event| event["decision"] != "skipped");
        let blamed = opened.filter(|event| event["cause"] == "injected_fault").map(tick);
        let (first, end) = (tick(&report), tick(&report) + 60);
        assert!(blamed.clone().all(|tick| (first..end).contains(&tick)), "{kind}: {:?}", blamed.collect::<Vec<_>>());
        assert_eq!(summary["supervision"]["deaths"], Value::Array(Vec::new()));
    }
}

#[test]
fn a_glitch_is_laid_to_the_torque_and_the_recording_is_still_replayed_to_the_bit() {
    let case = Case::new("fault-glitch");
    let (report, ended, _) = injected(&case, "", &["glitch", "--for", "30ms", "--value", "-200"]);
    assert_eq!(report["value_nm"], -200.0);
    let bound = &ended.json()["bound"];
    assert!(bound["violations_delay_aware"].as_u64().is_some_and(|ticks| ticks >= 10), "{bound}");
    let replayed = case.output(&["replay", "seen", "--json"]).json_with(0);
    let taken = replayed["torques_as_recorded"].as_u64();
    assert!(taken.is_some_and(|taken| (1..=60).contains(&taken)), "{replayed}");
}

#[test]
fn a_controller_that_is_stopped_goes_on_and_the_ticks_between_are_put_down_to_the_fault() {
    let case = Case::new("fault-hang");
    let (report, ended, _) = injected(&case, "", &["hang", "--for", "50ms"]);
    assert_eq!(report["for_ns"], 50_000_000);
    let summary = ended.json();
    assert!(put_down_to_it(&summary) >= 25, "{}", summary["missed_ticks_by_cause"]);
    let process = summary["supervision"]["processes"].as_array().into_iter().flatten();
    let restarts: Vec<&Value> = process.filter(|p| p["role"] == "controller").map(|p| &p["restarts"]).collect();
    assert_eq!(restarts, [0], "it is the same process that goes on");
    assert_eq!(summary["supervision"]["deaths"], Value::Array(Vec::new()));
}

#[test]
fn a_killed_controller_is_named_a_death_and_its_missed_ticks_an_injected_fault() {
    let case = Case::new("fault-kill");
    let (report, ended, events) = injected(&case, "", &["kill"]);
    let summary = ended.json();
    assert_eq!(summary["supervision"]["deaths"][0]["how"], "killed (SIGKILL)");
    assert_eq!(summary["supervision"]["deaths"][0]["recovered"], true);
    // The successor is started after 100 ms.
    assert!(put_down_to_it(&summary) >= 50, "{}", summary["missed_ticks_by_cause"]);
    let first = events.iter().find(|event| event["kind"] == "missed" && tick(event) > tick(&report));
    assert_eq!(first.map(|event| &event["cause"]), Some(&Value::from("injected_fault")));
}

#[test]
fn a_standby_can_be_struck_and_the_one_in_charge_does_not_feel_it() {
    let case = Case::new("fault-standby");
    let scenario = "[controller]\nstandby = 1\n";
    let (report, ended, events) = injected(&case, scenario, &["drop", "--controller", "2"]);
    assert_eq!(report["controller"], 2);
    let first = tick(&report);
    let failovers: Vec<&Value> = events.iter().filter(|event| event["kind"] == "failover").collect();
    let within = |event: &&&Value| (first..first + 100).contains(&tick(event)) && event["subject"] == 2;
    assert_eq!(failovers.iter().find(within), None, "who says nothing takes nothing over");
    // A stall of the host may have given it the authority before, and then its silence is felt.
    if failovers.iter().all(|event| tick(event) >= first + 100) {
        let summary = ended.json();
        assert_eq!(put_down_to_it(&summary), 0, "{}", summary["missed_ticks_by_cause"]);
    }
}

#[test]
fn what_can_not_be_injected_is_refused_with_its_reason() {
    let case = Case::new("fault-refused");
    let mut running = case.run("[loop]\nduration = \"2s\"\n", &[]);
    running.wait_until_active();
    let ask = |arguments: &[&str]| {
        let mut all = vec!["fault", "--group", &case.group];
        all.extend(arguments);
        case.output(&all)
    };
    let unknown = ask(&["hang", "--controller", "9", "--json"]).json_with(4);
    assert_eq!((&unknown["result"], &unknown["reason"]), (&Value::from("refused"), &Value::from("no such controller")));
    assert_eq!(ask(&["delay", "--delay", "200us", "--for", "1s"]).code, Some(0));
    let second = ask(&["drop"]);
    assert!(second.code == Some(4) && second.out.contains("another fault is under way"), "{second:?}");
    for (arguments, named) in [(&["kill", "--for", "1s"], "length"), (&["drop", "--delay", "1ms"], "delay")] {
        let ended = ask(arguments);
        assert!(ended.code == Some(2) && ended.err.contains(named), "{ended:?}");
    }
    running.wait();
    assert_eq!(case.output(&["fault", "--group", "nobody", "kill"]).code, Some(2));
    let mut lockstep = case.run("[loop]\nmode = \"lockstep\"\nduration = \"60s\"\n", &[]);
    let socket = case.group_folder().join("control");
    wait_until("the socket is there", || socket.exists() || !lockstep.runs());
    lockstep.wait_until_active();
    let scheduled = ask(&["drop"]);
    assert!(scheduled.code == Some(2) && scheduled.err.contains("[[fault]]"), "{scheduled:?}");
    lockstep.signal(rustix::process::Signal::INT);
    lockstep.wait();
    case.assert_nothing_left();
}
