//! What `bound` offers for a loop that lacks something makes the loop itself work, and not only its certificate.

use crate::harness::Case;

/// The settings of what is offered, as `--set` takes them.
fn offered(case: &Case, settings: &[&str]) -> Vec<Vec<String>> {
    let set: Vec<&str> = settings.iter().flat_map(|setting| ["--set", setting]).collect();
    let found = case.output(&[&["bound", "--json"][..], &set].concat()).json_with(1);
    let text = |setting: &serde_json::Value| setting.as_str().expect("a setting").to_owned();
    let remedies = found["remedies"].as_array().expect("remedies");
    remedies.iter().map(|remedy| remedy["set"].as_array().expect("settings").iter().map(text).collect()).collect()
}

#[test]
fn a_loop_with_what_bound_offers_holds_its_bound_in_lockstep() {
    for settings in [&["plant.links=5"][..], &["controller.gains.k_t=1e4"], &["plant.mass_error=0.1"]] {
        let case = Case::new("remedies");
        let all = offered(&case, settings);
        let best = all.last().unwrap_or_else(|| panic!("{settings:?}: nothing is offered"));
        let set: Vec<&str> =
            settings.iter().copied().chain(best.iter().map(String::as_str)).flat_map(|set| ["--set", set]).collect();
        assert_eq!(case.output(&[&["bound"][..], &set].concat()).code, Some(0), "{set:?}");
        let summary = case.run("[loop]\nmode = \"lockstep\"\nduration = \"3s\"\n", &set).wait().json_with(0);
        assert_eq!(summary["verdict"]["status"], "held", "{set:?}: {}", summary["verdict"]);
        assert_eq!(summary["bound"]["outside"], serde_json::json!([]));
        case.assert_nothing_left();
    }
}

#[test]
fn a_run_says_what_of_its_plant_nobody_has_declared_and_is_judged_by_what_happened() {
    let case = Case::new("undeclared");
    let scenario = "[loop]\nmode = \"lockstep\"\nduration = \"1s\"\n[plant]\nmass_error = 0.1\n";
    let summary = case.run(scenario, &[]).wait().json_with(0);
    assert_eq!(summary["verdict"]["status"], "held", "{}", summary["verdict"]);
    let outside = summary["bound"]["outside"].as_array().expect("a list");
    let named =
        |line: &serde_json::Value| line.as_str().is_some_and(|line| line.contains("controller.uncertainty.mass"));
    assert!(outside.len() == 1 && named(&outside[0]), "{outside:?}");
}
