//! A swap in a running group: every place that speaks of it says the same, and the figures of two laws are kept apart.

use serde_json::Value;

use crate::harness::Case;

fn largest(steps: &Value) -> f64 {
    let steps = steps.as_array().into_iter().flatten().filter_map(Value::as_f64);
    steps.map(f64::abs).fold(0.0, f64::max)
}

#[test]
fn the_command_and_the_summary_give_one_account_of_a_swap_and_figures_law_by_law() {
    for blend in ["0ms", "20ms"] {
        let case = Case::new(&format!("swap-account-{blend}"));
        let scenario = "[loop]\nduration = \"4s\"\n[swap_gate]\ntimeout = \"2s\"\nconsecutive = 5\ntorque_step_nm = 100\nrollback_misses = 100\nrollback_window = 100\n[controller.gains]\nshared_v = true\n";
        let mut running = case.run(scenario, &[]);
        running.wait_until_active();
        let swap = ["swap", "--group", &case.group, "--law", "robust-ff", "--blend", blend, "--json"];
        let report = case.output(&swap).json();
        let summary = running.wait().json();
        case.assert_nothing_left();
        let swaps = summary["swaps"].as_array().expect("a list");
        let Some(entry) = swaps.iter().find(|entry| entry["to"] == 2 && entry["result"] == "done") else {
            // A machine that is busy enough refuses or rolls back any swap: the two agree on that as well.
            assert_ne!(report["result"], "done", "{report} {swaps:?}");
            continue;
        };
        assert_eq!((&report["result"], &report["tick"]), (&Value::from("done"), &entry["tick"]), "{report} {entry}");
        assert_eq!(report["torque_step_nm"], entry["torque_steps_nm"]);
        assert_eq!(entry["torque_step_nm"].as_f64(), Some(largest(&report["torque_step_nm"])));
        for key in ["torque_difference_nm", "delta_v", "missed_ticks", "blended_ticks"] {
            assert_eq!(report[key], entry[key], "{key}");
        }
        // The new controller's law was known by the first tick that it was in charge of.
        assert!(entry["delta_v"].is_number(), "{entry}");
        let faded = entry["blended_ticks"].as_u64().expect("a count");
        // A failover that was faster than the gate does not fade.
        assert_eq!(faded > 0, blend == "20ms" && entry["kind"] == "swap", "{entry}");
        let laws = summary["bound"]["laws"].as_array().expect("a list");
        let named: Vec<(&Value, &Value)> = laws.iter().map(|of| (&of["law"], &of["controllers"])).collect();
        let (one, two) = (Value::from(vec![1]), Value::from(vec![2]));
        assert_eq!(named, [(&Value::from("robust"), &one), (&Value::from("robust-ff"), &two)]);
        // C1 = 40 is robust's alone, and what is proven of the other is of the other.
        assert_eq!(laws[0]["c1"], 40.0);
        // A busy machine may have failed over to the old one again: the figures are those of whoever was in charge last.
        let last = laws.iter().find(|of| of["law"] == summary["bound"]["law"]).expect("its own entry");
        for key in ["c1", "v_max", "psi_max", "uub_radius", "w_norm_max_settled"] {
            assert_eq!(summary["bound"][key], last[key], "{key}");
        }
        let sum = |key: &str| laws.iter().filter_map(|of| of[key].as_u64()).sum::<u64>();
        assert_eq!(Some(sum("checked")), summary["bound"]["checked"].as_u64());
        assert!(laws.iter().all(|of| of["ticks"].as_u64() >= of["checked"].as_u64()), "{laws:?}");
    }
}
