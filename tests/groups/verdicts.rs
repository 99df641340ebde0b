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

/// Too short for the last thousandth.
const SHORT: &str = "[loop]\nmode = \"lockstep\"\nduration = \"900ms\"\n";
/// A gate that lets nobody through.
const REFUSES: &str = "[swap_gate]\ntorque_step_nm = 1e-12\n[[swap]]\nat = 300\nlaw = \"robust-ff\"\n";
/// A new controller that answers nothing from its second tick on.
const ROLLS_BACK: &str = "[swap_gate]\ntorque_step_nm = 1000\n[[swap]]\nat = 300\nlaw = \"robust-ff\"\n\
                          [[fault]]\nkind = \"drop\"\ntarget = \"controller:2\"\nat = 302\nfor = \"100ms\"\n";

#[test]
fn a_scheduled_swap_that_is_refused_or_rolled_back_ends_the_run_with_4_between_its_neighbours() {
    for (name, swap, result) in [("swap-refused", REFUSES, "refused"), ("swap-back", ROLLS_BACK, "rolled back")] {
        let case = Case::new(name);
        let out = case.work.path().join("out");
        let out = out.to_str().expect("a path in UTF-8");
        let summary = case.run(&format!("{SHORT}{swap}"), &["--out", out]).wait().json_with(4);
        assert_eq!(summary["verdict"]["status"], "swap refused", "{}", summary["verdict"]);
        let reason = summary["verdict"]["reasons"][0].as_str().expect("a reason");
        let words = format!("the swap to controller 2 that is scheduled for tick 300 was {result}: ");
        assert!(reason.starts_with(&words), "{reason}");
        // Before it: failed. After it: inconclusive (a quantile of too few samples), passed.
        let expected = [
            ("ticks = '< 10'\n", 1, "failed", "fail"),
            ("'round_trip.p99_9' = '<= 1ms'\n", 4, "swap refused", "inconclusive"),
            ("ticks = 900\n", 4, "swap refused", "pass"),
        ];
        for (condition, code, status, outcome) in expected {
            let file = case.write("expect.toml", condition);
            let ended = case.output(&["check", out, "--expect", file.to_str().expect("a path in UTF-8"), "--json"]);
            let verdict = ended.json_with(code);
            assert_eq!((&verdict["status"], &verdict["expectations"][0]["outcome"]), (&status.into(), &outcome.into()));
        }
        let live = format!("{SHORT}[expect]\nticks = 900\n{swap}");
        assert_eq!(case.run(&live, &[]).wait().json_with(4)["verdict"]["status"], "swap refused");
        case.assert_nothing_left();
    }
}

#[test]
fn in_real_time_too_a_scheduled_swap_that_is_refused_ends_the_run_with_4() {
    let case = Case::new("swap-refused-live");
    // Without a certificate nothing graver can come of a busy machine; should it, the refusal is a reason all the same.
    let scenario = format!("[loop]\nrate = \"200Hz\"\nduration = \"2500ms\"\n[controller]\nlaw = \"pd+g\"\n{REFUSES}");
    for _ in 0..5 {
        let ended = case.run(&scenario, &[]).wait();
        case.assert_nothing_left();
        let summary: serde_json::Value = serde_json::from_str(&ended.out).expect("a summary");
        // A host that stops the controller before the swap makes its standby active: then there is nothing to refuse.
        if summary["swaps"].as_array().is_some_and(|swaps| swaps.iter().any(|swap| swap["kind"] == "failover")) {
            continue;
        }
        assert_eq!((ended.code, &summary["verdict"]["status"]), (Some(4), &"swap refused".into()), "{ended:?}");
        return;
    }
    panic!("five runs with a failover before their swap");
}

#[test]
fn a_swap_whose_controller_a_failover_put_in_charge_before_is_no_refusal() {
    let case = Case::new("swap-by-failover");
    let early =
        "[[swap]]\nat = 300\nlaw = \"robust-ff\"\n[[fault]]\nkind = \"kill\"\ntarget = \"controller:1\"\nat = 200\n";
    let summary = case.run(&format!("{LOCKSTEP}{early}"), &[]).wait().json();
    assert_eq!(summary["swaps"][0]["kind"], "failover", "{}", summary["swaps"]);
    assert_eq!(summary["swaps"][1]["reason"], "that controller is in charge already", "{}", summary["swaps"]);
    assert_ne!(summary["verdict"]["status"], "swap refused", "{}", summary["verdict"]);
    case.assert_nothing_left();
}
