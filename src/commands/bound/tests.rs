use super::*;
use loopbound_model::bound::stability::radius::Limit;

fn of(scenario: &Scenario, latency_s: f64) -> Answer {
    with_links!(scenario.links(), advise::<N>(scenario, latency_s)).unwrap()
}

/// The answer without advice, which takes longer.
fn plain(scenario: &Scenario) -> Answer {
    with_links!(scenario.links(), examine::<N>(scenario, scenario.plant.actuation_delay.seconds())).unwrap()
}

fn with(settings: &[&str]) -> Scenario {
    Scenario::default().with_sets(settings).unwrap()
}

/// The answer to some settings, at the scenario's own actuation delay.
fn answer(settings: &[&str]) -> Answer {
    let scenario = with(settings);
    of(&scenario, scenario.plant.actuation_delay.seconds())
}

#[test]
fn the_papers_case_is_certified_and_a_small_c1_is_named_with_what_would_do() {
    let good = answer(&[]);
    assert!(good.render().starts_with("robust: certified\n") && good.holds());
    let json = good.to_json();
    // K_t of the defaults as the documentation states it: 106.8.
    assert!((json["certificate"]["k_t"].as_f64().unwrap() - 106.8).abs() < 0.05, "{json}");
    assert_eq!((&json["holds"], &json["outside"]), (&json!(true), &json!([])));
    let bad = answer(&["controller.gains.c1=10"]);
    let text = bad.render();
    assert!(text.contains("NOT certified") && text.contains("C1") && text.contains("would do"), "{text}");
    assert!(!bad.holds());
}

#[test]
fn a_loop_that_is_certified_and_unstable_at_its_rate_is_called_both_and_fails() {
    for (settings, latency_s, headline) in [
        (&["loop.rate=200Hz"][..], 0.0, "robust: certified in continuous time, UNSTABLE at 200 Hz"),
        (&[], 2e-3, "robust: certified in continuous time, UNSTABLE at 1000 Hz with torques 2.0000 ms late"),
        (
            &["controller.law=ctc", "controller.gains.level=8", "loop.rate=5Hz"],
            0.0,
            "ctc: certified in continuous time, UNSTABLE at 5 Hz",
        ),
        (&["controller.gains.c1=10", "loop.rate=200Hz"], 0.0, "robust: NOT certified, UNSTABLE at 200 Hz"),
    ] {
        let answer = of(&with(settings), latency_s);
        assert_eq!(answer.render().lines().next(), Some(headline));
        assert!(!answer.holds() && answer.to_json()["stable"] == json!(false));
    }
}

#[test]
fn a_plant_outside_of_what_the_controller_declares_is_named_line_by_line_and_fails() {
    let off = answer(&["plant.mass_error=0.5", "plant.torque_limit_nm=1", "plant.noise.q_rad=1e-3"]);
    let text = off.render();
    assert_eq!(
        text.lines().next(),
        Some("robust: certified, and the plant is OUTSIDE of what the controller declares"),
        "{text}"
    );
    assert_eq!(text.lines().filter(|line| line.starts_with("  outside: plant.")).count(), 3, "{text}");
    let json = off.to_json();
    assert_eq!(
        (&json["certified"], &json["within_declared"], &json["holds"]),
        (&json!(true), &json!(false), &json!(false))
    );
    assert_eq!(json["outside"].as_array().map(Vec::len), Some(3));
    assert!(!off.holds() && off.sampling.is_stable());
}

#[test]
fn every_shipped_scenario_has_a_plant_that_its_controller_declares_and_a_rate_at_which_it_is_stable() {
    for entry in std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/scenarios")).unwrap() {
        let scenario = Scenario::load(&entry.unwrap().path()).unwrap();
        let answer = plain(&scenario);
        assert!(answer.gaps.is_empty() && answer.sampling.is_stable() && answer.holds(), "{}", answer.render());
    }
}

#[test]
fn the_latency_side_has_the_documented_room_age_and_hold_limit() {
    let sampling = answer(&[]).sampling;
    let budget = sampling.budget.unwrap();
    // Figures of the documentation: d < 0.948 ms, h < 1.90 ms without delay.
    assert!((budget.delay_margin_s - 0.948e-3).abs() < 5e-7 && (budget.period_max_s.unwrap() - 1.9e-3).abs() < 5e-6);
    assert!(sampling.radius < 1.0 && sampling.hold_ticks > 0);
    // 1 kHz is not proven beforehand.
    assert!(sampling.proven.is_some_and(|p| p.age_s < 1e-3), "{:?}", sampling.proven);
    assert!(sampling.render(LawKind::Robust).contains("left to the live check"));
}

/// The latency side alone.
fn sampled(scenario: &Scenario, latency_s: f64) -> Sampling {
    let certificate = system::certificate_of::<3>(scenario, scenario.controller.law).unwrap();
    sampling::<3>(scenario, &certificate, latency_s).unwrap()
}

#[test]
fn the_limits_of_delay_and_period_separate_stable_from_unstable_when_they_are_tried() {
    let mismatched = ["controller.uncertainty.mass=0.2", "controller.gains.level=7.2", "controller.gains.k3=0.0367"];
    for (settings, latency_s) in [
        (&[][..], 0.0),
        (&[], 4e-4),
        (&[], 1.2e-3),
        (&mismatched, 4e-4),
        (&["controller.law=robust-ff", "controller.gains.level=10"], 2e-3),
        (&["controller.law=ctc", "controller.gains.level=8"], 2e-3),
        (&["loop.rate=170Hz"], 2e-3),
        (&["loop.rate=300Hz"], 1.2e-3),
    ] {
        let scenario = with(settings);
        let found = sampled(&scenario, latency_s);
        let (margin, stable) = (found.delay_margin(), |latency_s| sampled(&scenario, latency_s).is_stable());
        assert_eq!(found.is_stable(), margin.seconds() > 0.0);
        if let (true, Limit::At(left_s)) = (found.is_stable(), margin) {
            let tried = [1.0 - 1e-6, 1.0 + 1e-6].map(|share| stable(latency_s + left_s * share));
            assert_eq!(tried, [true, false], "{settings:?} {latency_s}: {left_s}");
        }
        let Some(period) = found.longest_period() else {
            assert!(!found.is_stable());
            continue;
        };
        // Periods are whole nanoseconds.
        let tried = [-2e-9, 2e-9].map(|by_s| {
            let rate = format!("loop.rate={:.12}Hz", 1.0 / (period.seconds() + by_s));
            sampled(&scenario.with_set(&rate).unwrap(), latency_s).is_stable()
        });
        assert_eq!(tried, [true, false], "{settings:?} {latency_s}: {period:?}");
    }
}

#[test]
fn a_latency_beyond_the_boundary_is_called_unstable_by_rule_and_radius() {
    let late = sampled(&Scenario::default(), 2e-3);
    assert!(late.budget.unwrap().used > 1.0 && late.radius > 1.0 && late.render(LawKind::Robust).contains("UNSTABLE"));
}

#[test]
fn the_gains_that_are_offered_prove_a_smaller_error_and_a_lower_latency_a_smaller_one_still() {
    let e = |latency_s: f64| {
        let better = of(&Scenario::default(), latency_s).better.unwrap();
        let again = Scenario::default().with_sets(&better.settings).unwrap();
        let again = examine::<3>(&again, latency_s).unwrap();
        assert!(again.holds() && again.sampling.budget.unwrap().used <= 0.9, "{}", again.render());
        assert!((again.certification.certificate.ultimate_e / better.certificate.ultimate_e - 1.0).abs() < 1e-12);
        better.certificate.ultimate_e
    };
    assert!(e(5e-4) < e(9e-4));
    // All of the room, and the gains with which 0.030 rad are proven; ‖W‖ was smallest where 0.170 rad are.
    assert!(e(0.0) < 0.036);
}

#[test]
fn every_remedy_that_is_offered_makes_everything_hold_when_it_is_typed() {
    let links: Vec<String> = (1..=7).map(|n| format!("plant.links={n}")).collect();
    let mut cases: Vec<Vec<&str>> = Vec::new();
    for n in &links {
        for law in ["robust", "robust-ff", "ctc", "pd+g"] {
            let law = match law {
                "robust" => "controller.law=robust",
                "robust-ff" => "controller.law=robust-ff",
                "ctc" => "controller.law=ctc",
                _ => "controller.law=pd+g",
            };
            cases.push(vec![n, law]);
        }
    }
    let bad = [
        &["loop.rate=200Hz"][..],
        &["controller.gains.c1=10"],
        &["controller.gains.level=1"],
        &["controller.gains.k_t=1e4"],
        &["controller.gains.k_t=20"],
        &["plant.mass_error=0.1"],
        &["plant.mass_error=0.3", "controller.law=robust-ff"],
        &["controller.uncertainty.disturbance_nm=20"],
        &["controller.law=pd+g", "controller.gains.kp=1e6"],
        &["controller.law=ctc", "loop.rate=5Hz"],
        &["controller.gains.shared_v=true", "controller.law=robust-ff", "controller.gains.level=1"],
        &["plant.friction.coulomb_nm=0.5"],
        &["plant.torque_limit_nm=300"],
    ];
    cases.extend(bad.iter().map(|settings| settings.to_vec()));
    let mut without = Vec::new();
    for settings in &cases {
        let answer = answer(settings);
        let offered: Vec<Vec<String>> = answer.to_json()["remedies"]
            .as_array()
            .unwrap()
            .iter()
            .map(|remedy| {
                remedy["set"].as_array().unwrap().iter().map(|set| set.as_str().unwrap().to_owned()).collect()
            })
            .collect();
        if !answer.holds() && offered.is_empty() {
            without.push(settings.join(" "));
        }
        for remedy in &offered {
            // It is on the screen as it is typed.
            let typed: Vec<String> = remedy.iter().map(|set| format!("--set {set}")).collect();
            assert!(answer.render().contains(&format!("  would do: {}  (", typed.join(" "))), "{}", answer.render());
            let all: Vec<&str> = settings.iter().copied().chain(remedy.iter().map(String::as_str)).collect();
            let mended = plain(&with(&all));
            assert!(mended.holds() && mended.sampling.radius < 1.0, "{all:?}\n{}", mended.render());
            assert!(mended.sampling.budget.is_none_or(|budget| budget.used <= 0.9), "{all:?}\n{}", mended.render());
        }
    }
    // A random search over β, K2 and c finds nothing for the first three within 90 % of the room either. At 5 Hz the chain
    // falls between two samples; and 300 N·m are asked for by every gain that is certified.
    let nothing = [
        "plant.links=6 controller.law=robust",
        "plant.links=7 controller.law=robust",
        "loop.rate=200Hz",
        "controller.law=ctc loop.rate=5Hz",
        "plant.torque_limit_nm=300",
    ];
    assert_eq!(without, nothing);
}

#[test]
fn computed_torque_is_judged_by_its_spectral_radius_alone() {
    let sampling = of(&with(&["controller.law=ctc"]), 1e-3).sampling;
    assert!(sampling.budget.is_none() && sampling.radius < 1.0);
    assert!(sampling.to_json()["budget"].is_null() && sampling.radius_margin.seconds() > 1e-3);
}

#[test]
fn every_number_of_a_certificate_has_a_key_and_a_unit_in_every_law_and_zero_is_a_value() {
    let keys = |json: &Value, part: &str| json[part].as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    let all = keys(&answer(&[]).to_json(), "certificate");
    for law in LawKind::ALL {
        let json = answer(&[&format!("controller.law={law}")]).to_json();
        assert_eq!((keys(&json, "certificate"), keys(&json, "units")), (all.clone(), all.clone()), "{law}");
        // What the law does not have is null, and nothing else of these.
        let (on_r, pd) = (law != LawKind::Ctc, matches!(law, LawKind::Ctc | LawKind::PdG));
        for (key, has) in [("beta", on_r), ("k_t", on_r), ("c1", on_r), ("k_p", pd), ("k_d", pd), ("level", true)] {
            assert_eq!(json["certificate"][key].is_number(), has, "{law} {key}");
        }
        let energy = law != LawKind::Ctc;
        let unit = |key: &str| json["units"][key].as_str().unwrap().to_owned();
        assert_eq!([unit("level"), unit("epsilon")], if energy { ["J", "J/s"] } else { ["rad²/s²", "rad²/s³"] });
    }
    // An exact model and no disturbance: there is nothing to cover, and that is said.
    let exact = answer(&["controller.law=robust-ff"]);
    let zero = [("c1", "N·m"), ("epsilon", "J/s"), ("ultimate_e_rad", "rad"), ("ultimate_e_link_rad", "rad")];
    for (key, unit) in zero {
        assert_eq!(exact.to_json()["certificate"][key], json!(0.0), "{key}");
        let line = format!("  {key:<20}{:>12.5}  {unit}", 0.0);
        assert!(exact.render().contains(&line), "{line}");
    }
}

#[test]
fn the_proven_error_of_one_link_is_the_largest_that_v_leaves_to_it() {
    let c = answer(&[]).certification.certificate;
    // With r = 0 all of V may be the error of one link.
    let v = 0.5 * c.on_r().unwrap().p * c.ultimate_e_link() * c.ultimate_e_link();
    assert!((v - c.v_ultimate()).abs() < 1e-12 * v, "{v} is not {}", c.v_ultimate());
}
