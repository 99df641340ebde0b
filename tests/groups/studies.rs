//! The study of settings with real groups: what it measures, how it is interrupted, and what a user without privileges gets.

use std::fs;
use std::path::Path;

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Case, Running, processes_that_mention, wait_until};
use crate::untested::not_tested;

/// The study of one rate with its results in the folder `out` of the test.
fn start(case: &Case, options: &[&str]) -> Running {
    let mut all = vec!["study", "load", "--out", "out", "--rates", "1kHz", "--loads", "none"];
    all.extend(options);
    case.start(&all)
}

/// Two cases of half a second, if both kinds of waiting are asked for.
const SHORT: [&str; 4] = ["--duration", "500ms", "--rounds", "1"];

fn table(case: &Case) -> Value {
    let path = case.work.path().join("out/table.json");
    let text = fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_slice(&text).expect("table.json")
}

fn assert_nothing_left(case: &Case, study: u32) {
    case.assert_nothing_left_of(&format!("study-load-{study}"));
    let runs = case.work.path().join(format!("out/run-{study}"));
    assert!(!runs.exists(), "the files of the last run are left in {}", runs.display());
    case.assert_nothing_left();
}

#[test]
fn a_short_study_measures_real_groups_and_writes_what_it_found() {
    let case = Case::apart("study");
    fs::create_dir(case.work.path().join("out")).expect("the folder");
    // Nobody else's recommendation may be taken for the study's, nor be lost.
    case.write("out/recommended.toml", "mine");
    let refused = start(&case, &SHORT).wait();
    assert!(refused.code == Some(2) && refused.err.contains("recommended.toml is not of loopbound's"), "{refused:?}");
    let mine = case.work.path().join("out/recommended.toml");
    assert_eq!(fs::read_to_string(&mine).expect("the file"), "mine");
    fs::remove_file(mine).expect("moved away");
    // Limits that every machine keeps, so that something is recommended even on a busy one.
    let two = ["--wakeups", "hybrid,block", "--privileges", "without", "--missed-max", "100%", "--cpu-max", "1000%"];
    // Long enough for the intervals without which nothing is recommended.
    let running = start(&case, &[&two[..], &["--duration", "2400ms", "--rounds", "1"]].concat());
    let study = running.pid();
    let ended = running.wait();
    assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
    assert!(ended.err.contains("2 cases in 1 round(s) of 2400ms"), "{}", ended.err);
    let report = table(&case);
    let rows = report["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 2);
    for row in rows {
        assert_eq!((&row["runs"], &row["rate_hz"]), (&Value::from(1), &Value::from(1000.0)), "{row}");
        // All but the start-up; a busy machine may skip most of the rest, but not all.
        let n = row["latency_ns"]["deadline_to_torque"]["n"].as_u64().expect("a count");
        assert!((1..=2320).contains(&n), "{row}");
        assert!(row["cpu"].as_f64().is_some_and(|cpu| cpu > 0.0), "{row}");
        assert!(row["cpu_by_role"]["plant"].as_f64().is_some_and(|cpu| cpu > 0.0), "{row}");
    }
    let out = case.work.path().join("out");
    for name in ["table.csv", "report.md", "load.html", "load.svg", "load.png"] {
        assert!(fs::metadata(out.join(name)).is_ok_and(|file| file.len() > 500), "{name}");
    }
    check_recommendation(&case, &report, &out.join("recommended.toml"));
    let manifest: Value =
        serde_json::from_slice(&fs::read(out.join("manifest.json")).expect("manifest")).expect("JSON");
    assert!(manifest["kind"] == "study" && manifest["state"] == "finished", "{manifest}");
    assert!(manifest["files"]["load.html"]["sha256"].is_string(), "{manifest}");
    assert_nothing_left(&case, study);
}

/// What is recommended is a scenario that is certified, and it has been run once more; where nothing is, there is no file.
fn check_recommendation(case: &Case, report: &Value, file: &Path) {
    let Some(choice) = report["advice"]["choice"].as_u64() else {
        assert!(!file.exists() && report["check"].is_null(), "{}", report["advice"]);
        return;
    };
    let setting = &report["advice"]["settings"][usize::try_from(choice).expect("an index")];
    let certificate = case.output(&["bound", file.to_str().expect("a path in UTF-8"), "--json"]).json_with(0);
    let (found, promised) = (certificate["certificate"]["ultimate_e_rad"].as_f64(), setting["e_proven_rad"].as_f64());
    let (found, promised) = (found.expect("|e| of the file"), promised.expect("|e| of the table"));
    assert!((found / promised - 1.0).abs() < 1e-9, "{found} {promised}");
    assert_eq!(report["check"]["row"]["wakeup"], setting["wakeup"]);
}

#[test]
fn a_study_of_half_a_second_recommends_nothing_and_says_why() {
    let case = Case::apart("few-data-study");
    let limits = ["--missed-max", "100%", "--cpu-max", "1000%", "--privileges", "without", "--wakeups", "hybrid,block"];
    let running = start(&case, &[&limits[..], &SHORT].concat());
    let study = running.pid();
    running.wait();
    let report = table(&case);
    assert!(report["advice"]["choice"].is_null(), "{}", report["advice"]);
    let words = report["advice"]["rates"][0]["words"].as_str().expect("words");
    assert!(words.contains("too few data") || words.contains("so few data"), "{words}");
    assert!(!case.work.path().join("out/recommended.toml").exists());
    assert_nothing_left(&case, study);
}

#[test]
fn an_interrupted_study_ends_its_group_and_keeps_what_was_measured() {
    let case = Case::apart("interrupted-study");
    let mut running = start(&case, &["--rounds", "40", "--duration", "20s", "--wakeups", "hybrid,block"]);
    let study = running.pid();
    let group = format!("study-load-{study}");
    let file = case.work.path().join(format!("out/run-{study}/run/samples.mcap"));
    // It comes, goes when the first run has been added, and comes again with the second.
    for there in [true, false, true] {
        wait_until("a second run records", || {
            assert!(running.runs(), "{}", running.said());
            file.exists() == there
        });
    }
    assert!(case.group_folder().parent().is_some_and(|folder| folder.join(&group).exists()));
    running.signal(Signal::INT);
    let ended = running.wait();
    assert_eq!(ended.code, Some(130), "{ended:?}");
    let report = table(&case);
    assert_eq!(report["interrupted"], true);
    let runs: u64 = report["rows"].as_array().expect("rows").iter().filter_map(|row| row["runs"].as_u64()).sum();
    assert!((1..160).contains(&runs), "{runs} runs");
    assert_nothing_left(&case, study);
}

#[test]
fn a_killed_study_takes_its_run_along() {
    let case = Case::apart("killed-study");
    let mut running = start(&case, &["--rounds", "40", "--duration", "20s", "--wakeups", "block"]);
    let study = running.pid();
    let group = format!("study-load-{study}");
    let roster = case.runtime_folder().join(&group).join("processes.json");
    wait_until("a run of it runs", || {
        assert!(running.runs(), "{}", running.said());
        std::fs::read_to_string(&roster).is_ok_and(|text| text.contains("active"))
    });
    running.signal(Signal::KILL);
    running.wait();
    wait_until("its run has ended", || processes_that_mention(&group).is_empty());
    case.assert_nothing_left_of(&group);
}

#[test]
fn who_has_no_privileges_is_told_that_the_cases_with_them_are_not_to_be_had() {
    let case = Case::as_nobody("poor-study");
    if !rustix::process::getuid().is_root() {
        return not_tested("a study without privileges", "only root can give them up");
    }
    let running = start(&case, &[&["--privileges", "with", "--wakeups", "block,spin"][..], &SHORT].concat());
    let study = running.pid();
    let ended = running.wait();
    assert_eq!(ended.code, Some(3), "{ended:?}");
    let report = table(&case);
    for row in report["rows"].as_array().expect("rows") {
        let why = row["not_to_be_had"].as_str().unwrap_or_default();
        assert!(why.contains("SCHED_FIFO is refused here") && why.contains("prlimit"), "{row}");
        assert_eq!(row["runs"], 0);
    }
    assert!(ended.out.contains("nothing is feasible"), "{}", ended.out);
    assert_nothing_left(&case, study);
}
