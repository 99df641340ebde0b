use super::*;
use crate::system;

fn of(scenario: &Scenario) -> Vec<Gap> {
    system::gaps::<3>(scenario, scenario.controller.law).unwrap()
}

fn gaps_of(settings: &[&str]) -> Vec<Gap> {
    of(&Scenario::default().with_sets(settings).unwrap())
}

/// The one gap of some settings, as it is printed.
#[track_caller]
fn only(settings: &[&str]) -> String {
    let found = gaps_of(settings);
    assert_eq!(found.len(), 1, "{settings:?}: {found:?}");
    found[0].to_string()
}

const LAWS: [&str; 4] =
    ["controller.law=robust", "controller.law=robust-ff", "controller.law=ctc", "controller.law=pd+g"];

#[test]
fn the_ideal_plant_and_one_within_its_declared_bounds_are_covered() {
    for law in LAWS {
        assert_eq!(gaps_of(&[law]), [], "{law}");
    }
    let declared = "controller.uncertainty.mass=0.2";
    for settings in [
        &["plant.mass_error=0.2", declared][..],
        &["plant.mass_error=[-0.2,0.2,0.1]", declared],
        &["controller.model.gravity=9", declared],
        &["plant.friction.coulomb_nm=1", "controller.uncertainty.disturbance_nm=10"],
        &["plant.torque_limit_nm=5000"],
        // 10 kHz is proven beforehand, and so is a torque that then acts a little late.
        &["loop.rate=10kHz", "plant.actuation_delay=40us"],
    ] {
        assert_eq!(gaps_of(settings), [], "{settings:?}");
    }
}

#[test]
fn a_model_that_the_plant_does_not_fit_is_named_with_both_numbers_and_the_key_that_covers_it() {
    let line = only(&["plant.mass_error=0.5"]);
    for part in
        ["plant.mass_error", "50.00 %", "controller.uncertainty.mass = 0 covers 0.00 %", "would have to be 0.5000"]
    {
        assert!(line.contains(part), "{line}");
    }
    // What is asked for covers it, and a little less does not.
    for (mass, covered) in [(0.5, true), (0.4999, false)] {
        let set = format!("controller.uncertainty.mass={mass}");
        let found = gaps_of(&["plant.mass_error=0.5", &set]);
        assert_eq!(found.iter().any(|gap| matches!(gap, Gap::Model { .. })), !covered, "{found:?}");
    }
    let gravity = only(&["controller.model.gravity=3"]);
    assert!(gravity.contains("weight 227.00 %") && gravity.contains("less than 1 is allowed"), "{gravity}");
    assert!(only(&["controller.model.gravity=0"]).contains("more than 10000 %"));
    for key in ["mass=1.3", "length=0.8", "inertia=0.2", "gravity=9", "mass=[1,1,1.001]"] {
        assert!(only(&[&format!("controller.model.{key}")]).contains("controller.model"), "{key}");
    }
    assert!(only(&["plant.mass_error=[0,0,-0.01]"]).contains("plant.mass_error"));
}

#[test]
fn a_disturbance_and_friction_share_what_is_declared() {
    let shaken = |value_nm: f64, settings: &[&str]| {
        let toml = format!("[[plant.disturbance]]\nkind = \"constant\"\nvalue_nm = {value_nm}\n");
        of(&Scenario::from_toml(&toml, "test").unwrap().with_sets(settings).unwrap())
    };
    let found = shaken(100.0, &[]);
    assert!(found.len() == 1 && found[0].to_string().contains("up to 173.205 N·m"), "{found:?}");
    let declared = "controller.uncertainty.disturbance_nm=10";
    assert_eq!(shaken(5.0, &[declared]), []);
    assert!(only(&["plant.friction.viscous_nm_s=5"]).starts_with("plant.friction: "));
    assert!(only(&["plant.friction.coulomb_nm=0.1"]).starts_with("plant.friction: "));
    let coulomb = "plant.friction.coulomb_nm=1";
    assert_eq!(gaps_of(&[coulomb, declared]), []);
    assert!(matches!(shaken(5.0, &[coulomb, declared])[..], [Gap::Friction { left_nm, .. }] if left_nm < 1.4));
}

#[test]
fn late_torques_and_sensors_that_are_not_exact_are_covered_by_no_certificate() {
    assert!(only(&["plant.actuation_delay=2ms"]).starts_with("plant.actuation_delay: torques act 2.0000 ms late"));
    assert!(
        only(&["plant.actuation_delay=2ms", "controller.law=ctc", "controller.gains.level=8"]).contains("0.0000 ms in")
    );
    for key in ["q_rad", "v_rad_s", "quantum_q_rad", "quantum_v_rad_s"] {
        let line = only(&[&format!("plant.noise.{key}=1e-4")]);
        assert!(line.starts_with(&format!("plant.noise.{key}: 0.0001")), "{line}");
    }
}

#[test]
fn a_limit_counts_only_where_it_is_reached_on_the_certified_level() {
    // `pd+g` has a certificate at this level only.
    let level = "controller.gains.level=8";
    for law in LAWS {
        let asked_nm = match gaps_of(&["plant.torque_limit_nm=1", law, level])[..] {
            [Gap::TorqueLimit { asked_nm, .. }] => asked_nm,
            ref other => panic!("{law}: {other:?}"),
        };
        let limit = |share: f64| format!("plant.torque_limit_nm={}", share * asked_nm);
        assert_eq!(gaps_of(&[&limit(1.001), law, level]), [], "{law}");
        assert_eq!(gaps_of(&[&limit(0.999), law, level]).len(), 1, "{law}");
    }
    let slow = only(&["plant.speed_limit=10"]);
    assert!(slow.starts_with("plant.speed_limit: the plant stops at 10 rad/s"), "{slow}");
    assert_eq!(gaps_of(&["plant.speed_limit=20"]), []);
}

#[test]
fn the_torque_that_robust_may_ask_for_is_reached() {
    let scenario = Scenario::default();
    let cert = system::certificate_of::<3>(&scenario, LawKind::Robust).unwrap();
    let mass = scenario.build_model::<3>().unwrap().mass_matrix(&Vector::zeros());
    // K_t r with ½ rᵀ M r = c and links aligned.
    let reached = (0..3).map(|i| {
        let direction = mass.try_inverse().unwrap() * Vector::<3>::ith(i, 1.0);
        let r = direction * (2.0 * cert.level / direction.dot(&(mass * direction))).sqrt();
        cert.k_t() * r[i].abs()
    });
    let reached = reached.fold(0.0, f64::max);
    let [Gap::TorqueLimit { asked_nm, .. }] = gaps_of(&["plant.torque_limit_nm=1"])[..] else { panic!("no limit") };
    assert!((asked_nm / reached - 1.0).abs() < 1e-9, "{asked_nm} {reached}");
}

#[test]
fn a_value_that_follows_from_others_and_is_not_allowed_is_refused_before_anything_starts() {
    let scenario = Scenario::default().with_set("plant.mass=1e-12").unwrap();
    let error = check(&scenario).unwrap_err().to_string();
    assert!(
        error.starts_with("`plant.inertia[0]`: found 8.33") && error.contains("which follows from other keys"),
        "{error}"
    );
}

#[test]
fn a_fault_of_a_process_that_is_not_started_is_remarked() {
    let of = |target: &str| {
        let settings = ["fault.0.kind=drop".to_owned(), "fault.0.at=5".to_owned(), format!("fault.0.target={target}")];
        remarks(&Scenario::default().with_sets(&settings).unwrap()).unwrap()
    };
    assert_eq!(of("controller:1"), Vec::<String>::new());
    assert!(
        of("controller:9")[0]
            .starts_with("fault[0] is for controller 9, and the scenario starts no controller beyond 1")
    );
}
