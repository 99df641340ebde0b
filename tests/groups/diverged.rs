//! A loop that runs away ends with 1, whatever was expected of it, and so does everything that looks at it again.

use crate::harness::Case;

const RUNAWAY: &str = "[loop]\nmode = \"lockstep\"\nduration = \"1s\"\nrate = \"200Hz\"\n";

#[test]
fn a_group_that_diverges_ends_with_1_names_the_first_tick_and_its_files_hold_no_value_that_is_not_finite() {
    let case = Case::new("diverged");
    let out = case.work.path().join("out");
    let out = out.to_str().expect("a path in UTF-8");
    let expected = format!("{RUNAWAY}[expect]\nticks = \">= 1\"\n");
    let summary = case.run(&expected, &["--out", out]).wait().json_with(1);
    assert_eq!(summary["verdict"]["status"], "diverged", "{}", summary["verdict"]);
    assert!(
        summary["diverged"]["tick"].as_u64().is_some_and(|tick| (1..100).contains(&tick)),
        "{}",
        summary["diverged"]
    );
    assert_eq!((&summary["late_ticks"], &summary["missed_ticks"]), (&0.into(), &0.into()));
    let samples = std::fs::read_to_string(case.work.path().join("out/samples.csv")).expect("samples");
    assert!(!samples.contains("NaN") && !samples.contains("inf"), "a sample is not finite");
    let junit = std::fs::read_to_string(case.work.path().join("out/junit.xml")).expect("a junit file");
    assert!(junit.contains("failures=\"1\"") && junit.contains("does not diverge"), "{junit}");

    let ended = case.output(&["check", out]);
    assert!(ended.code == Some(1) && ended.out.contains("diverged"), "{ended:?}");
    let replayed = case.output(&["replay", out, "--json"]).json_with(1);
    assert_eq!((&replayed["verdict"], &replayed["differences"]), (&"diverged".into(), &0.into()), "{replayed}");
    let ended = case.output(&["report", out]);
    assert_eq!(ended.code, Some(1), "{ended:?}");
    case.assert_nothing_left();
}

#[test]
fn in_real_time_the_plant_stops_a_loop_that_runs_away_too() {
    let case = Case::new("diverged-rt");
    let scenario = "[loop]\nduration = \"500ms\"\n[controller]\nlaw = \"pd+g\"\n[controller.gains]\nkp = 1e6\n";
    let summary = case.run(scenario, &[]).wait().json_with(1);
    assert_eq!(summary["verdict"]["status"], "diverged", "{}", summary["verdict"]);
    assert_eq!(summary["events"]["diverged"], 1, "{}", summary["events"]);
    assert!(summary["counters"]["stopped"].as_u64().is_some_and(|ticks| ticks > 0), "{}", summary["counters"]);
    case.assert_nothing_left();
}
