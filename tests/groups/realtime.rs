//! On the machine's clock: every wake-up mode, with privileges and without, ends as it should and reports everything.

use serde_json::Value;

use crate::harness::Case;

const MODES: [&str; 4] = ["hybrid", "block", "spin", "event"];

/// The keys of a summary that others rely on, as paths.
const KEYS: &[&str] = &[
    "ticks",
    "rate_hz",
    "mode",
    "start_up_ticks",
    "missed_ticks",
    "missed_ticks_by_cause",
    "late_ticks_by_cause",
    "overruns",
    "setpoint_stale",
    "monitor_gaps",
    "floor",
    "bound.law",
    "bound.certified",
    "bound.checked",
    "bound.violations",
    "bound.violations_delay_aware",
    "bound.violations_promise",
    "bound.level",
    "bound.kappa",
    "bound.k_t",
    "bound.v_max",
    "bound.v_final",
    "bound.alpha",
    "bound.epsilon",
    "bound.c1",
    "bound.psi_max",
    "bound.uub_radius",
    "bound.ultimate_bound",
    "bound.ultimate_bound_link",
    "bound.v_unit",
    "bound.psi_unit",
    "bound.w_norm_max_settled",
    "bound.delay_margin_ns",
    "bound.budget_used",
    "tracking.max_abs_e_rad",
    "tracking.max_norm_e_rad",
    "tracking.rms_e_rad",
    "tracking.max_abs_ed_rad_s",
    "tracking.max_norm_ed_rad_s",
    "tracking.rms_ed_rad_s",
    "swaps",
    "host",
    "verdict",
];
const HOPS: &[&str] = &[
    "wakeup",
    "state_to_controller",
    "compute",
    "controller_to_plant",
    "round_trip",
    "deadline_to_torque",
    "setpoint_age",
];
const STATISTICS: &[&str] = &["n", "min", "p50", "p90", "p99", "p99_9", "max", "mean"];

/// Asserts that a run of `ticks` ticks has reported all there is to report.
fn assert_whole(summary: &Value, ticks: u64) {
    let has = |path: &str| summary.pointer(&format!("/{}", path.replace('.', "/"))).is_some();
    let missing: Vec<&&str> = KEYS.iter().filter(|path| !has(path)).collect();
    assert!(missing.is_empty(), "keys that are missing: {missing:?}");
    let count = |name: &str| summary["counters"][name].as_u64().unwrap_or_else(|| panic!("counter {name}"));
    // Torques of the start-up count in no hop.
    let answered = count("missed") + summary["start_up_ticks"].as_u64().expect("a count") < ticks;
    for hop in HOPS {
        let figures = &summary["latency_ns"][hop];
        let samples = figures["n"].as_u64().unwrap_or_else(|| panic!("latency_ns.{hop}: {figures}"));
        // A machine that is busy enough lets no controller answer for the whole run: figures of nothing are null.
        assert!(
            samples > 0 || !(answered || *hop == "wakeup"),
            "latency_ns.{hop} has no samples: {}",
            summary["counters"]
        );
        for statistic in STATISTICS {
            let value = &figures[statistic];
            assert_eq!(value.is_number(), samples > 0 || *statistic == "n", "latency_ns.{hop}.{statistic} is {value}");
        }
    }
    assert_all_ticks_counted(summary, ticks);
    assert_eq!(summary["supervision"]["end"], "done");
    assert_eq!(summary["supervision"]["deaths"], Value::Array(Vec::new()));
}

/// Asserts that every tick of the run was either run or skipped, and that no tick was missed twice.
fn assert_all_ticks_counted(summary: &Value, ticks: u64) {
    let counter = |name: &str| summary["counters"][name].as_u64().unwrap_or_else(|| panic!("counter {name}"));
    assert_eq!(counter("ticks") + counter("skipped"), ticks, "{}", summary["counters"]);
    let (missed, seen) = (counter("missed"), summary["missed_ticks"].as_u64());
    assert!(seen == Some(missed) && counter("skipped") <= missed && missed <= ticks, "{}", summary["counters"]);
    // A plant that stopped a runaway stands still whatever it is answered.
    let stopped = if summary["diverged"].is_null() { counter("stopped") } else { 0 };
    let unanswered = counter("held") + counter("damped") + stopped;
    assert!(unanswered + counter("skipped") <= missed, "an unanswered tick is missed: {}", summary["counters"]);
    let by_cause = summary["missed_ticks_by_cause"].as_object().expect("a table of causes");
    let explained: u64 = by_cause.values().filter_map(Value::as_u64).sum();
    assert!(explained <= missed, "{explained} causes of {missed} missed ticks");
}

fn assert_every_mode_ends_well(case: &Case) {
    for mode in MODES {
        let ended = case.run("[loop]\nduration = \"700ms\"\n", &["--wakeup", mode]).wait();
        // A loaded machine may miss so much that the verdict suffers; that is not what is asked here.
        assert!(matches!(ended.code, Some(0 | 1 | 3)), "{mode}: {ended:?}");
        assert_whole(&ended.json(), 700);
        case.assert_nothing_left();
    }
}

#[test]
fn every_wake_up_mode_ends_well_with_the_privileges_of_this_user() {
    assert_every_mode_ends_well(&Case::new("modes"));
}

#[test]
fn every_wake_up_mode_ends_well_without_any_privileges() {
    assert_every_mode_ends_well(&Case::as_nobody("modes-nobody"));
}

#[test]
fn a_group_may_have_the_longest_name_in_a_long_folder_in_every_mode() {
    let mut case = Case::apart(&"long".repeat(20));
    case.group = "x".repeat(32);
    for mode in MODES {
        let ended = case.run("[loop]\nduration = \"100ms\"\n", &["--wakeup", mode]).wait();
        assert!(matches!(ended.code, Some(0 | 1 | 3)), "{mode}: {ended:?}");
        case.assert_nothing_left();
    }
}

#[test]
fn rates_from_one_hertz_to_twenty_kilohertz_run() {
    let case = Case::new("rates");
    for (rate, duration, ticks) in [("1Hz", "2s", 2), ("100Hz", "500ms", 50), ("20kHz", "200ms", 4000)] {
        let scenario = format!("[loop]\nrate = \"{rate}\"\nduration = \"{duration}\"\n");
        let summary = case.run(&scenario, &[]).wait().json();
        assert_all_ticks_counted(&summary, ticks);
        case.assert_nothing_left();
    }
}

#[test]
fn two_groups_side_by_side_do_not_meet() {
    let case = Case::new("side");
    let scenario = "[loop]\nduration = \"1s\"\n";
    let other_name = format!("{}-b", case.group);
    let mut first = case.run(scenario, &[]);
    first.wait_until_active();
    let file = case.write("other.toml", "[loop]\nduration = \"600ms\"\n[plant]\nlinks = 2\n");
    let file = file.to_str().expect("a path in UTF-8");
    let second = case.start(&["run", file, "--group", &other_name, "--json"]);
    let (second, first) = (second.wait().json(), first.wait().json());
    assert_eq!((&first["links"], &second["links"]), (&Value::from(3), &Value::from(2)));
    assert_all_ticks_counted(&first, 1000);
    assert_all_ticks_counted(&second, 600);
    for summary in [&first, &second] {
        for counter in ["unknown_writer", "malformed", "duplicate", "fenced"] {
            assert_eq!(summary["counters"][counter], 0, "{counter}: {}", summary["counters"]);
        }
    }
    case.assert_nothing_left();
    case.assert_nothing_left_of(&other_name);
}

#[test]
fn a_name_that_runs_is_refused_and_its_group_goes_on() {
    let case = Case::new("taken");
    let mut first = case.run("[loop]\nduration = \"1500ms\"\n", &[]);
    first.wait_until_active();
    let second = case.output(&["run", "--group", &case.group]);
    assert_eq!(second.code, Some(2), "{second:?}");
    assert!(second.err.contains("running already") && second.err.trim_end().lines().count() == 1, "{}", second.err);
    let first = first.wait().json();
    assert_all_ticks_counted(&first, 1500);
    assert_eq!(first["supervision"]["deaths"], Value::Array(Vec::new()));
    case.assert_nothing_left();
}
