//! What is expected of a run decides its exit code, live and from its files; an open verdict prolongs it.

use crate::harness::Case;

const LOCKSTEP: &str = "[loop]\nmode = \"lockstep\"\nduration = \"1s\"\n";

#[test]
fn expectations_decide_the_exit_code_and_a_recorded_run_is_judged_again_alike() {
    let case = Case::new("expectations");
    let out = case.work.path().join("out");
    let out = out.to_str().expect("a path in UTF-8");
    // In lockstep no latency is a sample, so every key is compared as it is.
    let kept = format!("{LOCKSTEP}[expect]\nmissed_ticks = 0\nround_trip.max = '<= 1ms'\n'bound.certified' = true\n");
    let ended = case.run(&kept, &["--out", out]).wait();
    let summary = ended.json_with(0);
    assert_eq!(summary["verdict"]["status"], "passed");
    assert_eq!(summary["verdict"]["expectations"].as_array().map(Vec::len), Some(3));
    assert_eq!(case.output(&["check", out]).code, Some(0));

    let broken = case.write("broken.toml", "ticks = '< 10'\nmissed_ticks = 0\n");
    let broken = broken.to_str().expect("a path in UTF-8");
    let junit = case.work.path().join("junit.xml");
    let ended = case.output(&["check", out, "--expect", broken, "--junit", junit.to_str().expect("a path in UTF-8")]);
    assert_eq!(ended.code, Some(1), "{ended:?}");
    assert!(ended.out.contains("ticks < 10: found 1000"), "{}", ended.out);
    let junit = std::fs::read_to_string(junit).expect("the file was written");
    assert!(junit.contains("tests=\"2\" failures=\"1\""), "{junit}");
    assert_eq!(case.run(LOCKSTEP, &["--expect", broken]).wait().code, Some(1));

    let ended = case.output(&["compare", out, out]);
    assert!(ended.code == Some(0) && ended.out.contains("1.000"), "{ended:?}");
    case.assert_nothing_left();
}

#[test]
fn an_expectation_that_could_never_be_judged_starts_nothing() {
    let case = Case::apart("unjudgeable");
    let ended = case.run("[expect]\n'round_trip.p98' = '<= 1ms'\n", &[]).wait();
    assert!(ended.code == Some(2) && ended.err.contains("round_trip.p98"), "{ended:?}");
    case.assert_nothing_left();
}

#[test]
fn an_open_verdict_prolongs_the_run_to_its_most_and_no_further() {
    let case = Case::new("prolonged");
    // Five blocks at most: no quantile can be decided from them.
    let scenario = "[loop]\nduration = \"1s\"\n[expect]\nmax_duration = \"1500ms\"\n'compute.p99_9' = '<= 10s'\n";
    let summary = case.run(scenario, &[]).wait().json_with(3);
    let ticks = summary["ticks"].as_u64().expect("a count");
    assert!((1400..=1500).contains(&ticks), "{ticks}");
    assert_eq!(summary["verdict"]["status"], "inconclusive");
    case.assert_nothing_left();
}
