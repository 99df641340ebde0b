//! What a user may write, and what every mistake is answered with.

mod declared;
mod refusals;
mod schema;

use super::*;
use std::path::{Path, PathBuf};

fn shipped() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios");
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("the folder of scenarios exists")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .collect();
    files.sort();
    files
}

/// The message for a text that must be refused.
fn refused(text: &str) -> String {
    let message = Scenario::from_toml(text, "my.toml").expect_err("this must be refused").to_string();
    assert!(!message.contains('\n'), "one line: {message}");
    message
}

fn accepted(text: &str) -> Scenario {
    Scenario::from_toml(text, "my.toml").unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn a_word_that_toml_takes_for_a_number_is_a_word_where_one_is_asked_for() {
    let scenario = Scenario::default().with_set("fault.0.kind=nan").unwrap();
    assert_eq!(scenario.fault[0].kind, FaultKind::Nan);
    assert!(Scenario::default().with_set("plant.gravity=nan").is_err());
}

#[test]
fn every_shipped_scenario_loads_and_survives_the_way_through_toml() {
    let files = shipped();
    for name in ["paper", "mismatch", "disturbance", "swap", "failover", "ci", "faults", "n1", "n7"] {
        assert!(files.iter().any(|file| file.file_stem().is_some_and(|stem| stem == name)), "{name}.toml is missing");
    }
    for file in files {
        let scenario = Scenario::load(&file).unwrap_or_else(|error| panic!("{error}"));
        let text = scenario.to_toml().expect("it can be written");
        let again = Scenario::from_toml(&text, "again").unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_eq!(again, scenario.resolved(), "{}", file.display());
        assert_eq!(again.to_toml().expect("it can be written"), text, "{}", file.display());
    }
}

#[test]
fn the_default_is_the_papers_case() {
    let scenario = Scenario::default();
    scenario.validate().expect("the default is valid");
    assert_eq!(scenario.links(), 3);
    assert_eq!((scenario.period_ns(), scenario.loop_.ticks()), (1_000_000, 10_000));
    assert_eq!((scenario.loop_.grace_ns(), scenario.loop_.lead_ns()), (500_000, 250_000));
    assert_eq!((scenario.loop_.phase_ns(), scenario.loop_.late_ns()), (100_000, 500_000));
    assert_eq!(scenario.setpoint_lead_ns(), 64_000_000);
    assert_eq!(scenario.plant.start_q_rad(), [0.3, -0.2, 0.25]);
    let sine = Motion::Sine { amplitude_rad: vec![1.0; 3], omega_rad_s: vec![0.1; 3] };
    assert_eq!(scenario.motion(), sine);
}

#[test]
fn derived_defaults_follow_the_rate() {
    let scenario = Scenario::default().with_set("loop.rate=10kHz").expect("a valid rate");
    assert_eq!((scenario.loop_.grace_ns(), scenario.loop_.lead_ns()), (50_000, 25_000));
    assert_eq!((scenario.loop_.phase_ns(), scenario.setpoint_lead_ns()), (50_000, 20_000_000));
}

#[test]
fn a_rate_without_a_whole_period_gets_the_nearest_one() {
    let scenario = accepted("[loop]\nrate = \"3kHz\"");
    assert_eq!(scenario.period_ns(), 333_333);
    assert!((scenario.loop_.rate_hz() - 3000.003).abs() < 1e-6);
}

#[test]
fn assignments_take_bare_text_toml_lists_and_entries_of_lists() {
    let scenario = Scenario::default()
        .with_sets(&[
            "loop.rate=2kHz",
            "plant.mass=[1, 2]",
            "controller.gains.k_t = 50",
            "fault[0].kind=delay",
            "fault.0.delay=20us",
            "expect.round_trip.p99=<= 3 floor",
        ])
        .unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((scenario.period_ns(), scenario.links()), (500_000, 2));
    assert_eq!(scenario.controller.gains.k_t, Some(50.0));
    assert_eq!(scenario.fault[0].delay, Some(Nanos(20_000)));
    assert_eq!(scenario.expect.conditions[0].to_string(), "round_trip.p99 <= 3 floor");
    let again = scenario.with_set("expect.round_trip.p99=<= 5 floor").expect("a valid condition");
    assert_eq!(again.expect.conditions.len(), 1, "an assignment replaces");
}

#[test]
fn several_assignments_are_judged_together() {
    let base = accepted("[plant]\nmass = [1, 1, 1]\nlength = [1, 1, 1]");
    assert!(base.with_set("plant.mass=[1, 1]").is_err());
    let two = base.with_sets(&["plant.mass=[1, 1]", "plant.length=[1, 1]"]).expect("consistent");
    assert_eq!(two.links(), 2);
}

#[test]
fn a_mass_error_befalls_the_plant_and_not_the_model() {
    let scenario = accepted("[plant]\nmass = [1, 2]\nmass_error = [0.5, 0]");
    let ChainSpec::Links { mass_kg, inertia_kg_m2, .. } = scenario.plant_chain() else { panic!("by links") };
    assert_eq!(mass_kg, [1.5, 2.0]);
    assert_eq!(inertia_kg_m2, [1.5 / 12.0, 2.0 / 12.0]);
    let ChainSpec::Links { mass_kg, .. } = scenario.model_chain() else { panic!("by links") };
    assert_eq!(mass_kg, [1.0, 2.0]);
}

#[test]
fn a_chain_by_coefficients_decides_the_number_of_links() {
    let scenario = accepted("[plant]\na = [[2, 1], [1, 2]]\nb = [3, 4]");
    assert_eq!(scenario.links(), 2);
    let spec = ChainSpec::Coefficients { a: vec![vec![2.0, 1.0], vec![1.0, 2.0]], b: vec![3.0, 4.0] };
    assert_eq!((scenario.plant_chain(), scenario.model_chain()), (spec.clone(), spec));
}

#[test]
fn files_named_by_a_scenario_lie_beside_it_and_stay_found_from_a_copy() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("s.toml");
    std::fs::write(&path, "[reference]\nkind = \"waypoints\"\nfile = \"points.csv\"").expect("it can be written");
    let scenario = Scenario::load(&path).expect("it loads");
    assert_eq!(scenario.reference.file, Some(NamedFile::new(folder.path().join("points.csv"))));
    let copy = folder.path().join("out");
    std::fs::create_dir(&copy).expect("a folder");
    std::fs::write(copy.join("s.toml"), scenario.to_toml().expect("it can be written")).expect("it can be written");
    assert_eq!(Scenario::load(&copy.join("s.toml")).expect("it loads").reference.file, scenario.reference.file);
}

#[test]
fn expectations_take_dotted_keys_numbers_truths_and_lists() {
    let text = "[expect]\nmissed_ticks = 0\nbound.certified = true\nround_trip.p99 = ['<= 50us', '<= 3 floor']";
    let shown: Vec<String> = accepted(text).expect.conditions.iter().map(Expectation::to_string).collect();
    assert_eq!(
        shown,
        ["bound.certified == true", "missed_ticks == 0", "round_trip.p99 <= 50us", "round_trip.p99 <= 3 floor"]
    );
    let alone = ExpectSection::from_toml("missed_ticks = \"== 0\"\nconfidence = 0.9", "e.toml").expect("keys alone");
    let table = ExpectSection::from_toml("[expect]\nmissed_ticks = 0\nconfidence = 0.9", "e.toml").expect("a table");
    assert_eq!(alone, table);
    let error = ExpectSection::from_toml("missed_ticks = \"0\"", "e.toml").expect_err("no comparison").to_string();
    assert!(error.starts_with("e.toml:1:1: `missed_ticks`: found \"0\""), "{error}");
    let error = ExpectSection::from_toml("\n\nconfidence = 3", "e.toml").expect_err("out of limits").to_string();
    assert!(error.starts_with("e.toml:3:1: `expect.confidence`"), "{error}");
}

#[test]
fn durations_and_rates_are_read_and_written_exactly() {
    for (text, ns) in [
        ("20ms", 20_000_000),
        ("100 us", 100_000),
        ("100µs", 100_000),
        ("1.5s", 1_500_000_000),
        ("250ns", 250),
        ("0.5ms", 500_000),
        ("10min", 600_000_000_000),
        ("1h", 3_600_000_000_000),
        (".25s", 250_000_000),
        ("0s", 0),
        ("18446744073709551615ns", u64::MAX),
    ] {
        assert_eq!(parse_duration(text), Ok(ns), "{text}");
        assert_eq!(parse_duration(&format_duration(ns)), Ok(ns), "{text}");
    }
    for text in
        ["", "ms", "5", "1e3ms", "1.2.3s", "--1s", "1-s", "nans", "inf s", "5 sec", "1s2", "18446744073709551616ns"]
    {
        assert!(parse_duration(text).is_err(), "{text}");
    }
    assert_eq!((format_duration(1_500_000), format_duration(0)), ("1500us".to_owned(), "0s".to_owned()));
    for (text, hz) in [("1kHz", 1e3), ("10 kHz", 1e4), ("500Hz", 500.0), ("12.5Hz", 12.5), ("0.02MHz", 2e4)] {
        let parsed = parse_rate(text).expect("a rate");
        assert_eq!(parsed.to_bits(), f64::to_bits(hz), "{text}");
        assert_eq!(parse_rate(&format_rate(hz)).map(f64::to_bits), Ok(hz.to_bits()), "{text}");
    }
    for text in ["", "kHz", "1", "1khz", "-5Hz", "1e400Hz", "1s"] {
        assert!(parse_rate(text).is_err(), "{text}");
    }
    assert_eq!(parse_signed_duration("-5ms"), Ok(-5_000_000));
}

#[test]
fn names_of_groups_are_short_and_plain() {
    for name in ["a", "loop-1_B", &"x".repeat(32)] {
        check_group_name(name).expect("a plain name");
    }
    for name in ["", "a b", "a/b", "ä", "..", &"x".repeat(33)] {
        assert!(check_group_name(name).is_err(), "{name}");
    }
}

#[test]
fn the_default_builds_the_papers_chain_start_and_motion() {
    use loopbound_model::chain::{Chain, LinkParameters};
    let scenario = Scenario::default();
    let links = LinkParameters { mass_kg: [1.0; 3], length_m: [1.0; 3], inertia_kg_m2: None, gravity_m_s2: 9.81 };
    let unit = Chain::<3>::from_links(&links).expect("the unit chain");
    assert_eq!(scenario.build_model::<3>().expect("a chain"), unit);
    assert_eq!(
        scenario.build_truth::<3>().expect("a plant"),
        loopbound_model::truth::Truth { seed: 1, ..loopbound_model::truth::Truth::ideal(unit) }
    );
    assert_eq!(scenario.build_start::<3>().expect("a start").q.as_slice(), [0.3, -0.2, 0.25]);
    let trajectory = scenario.build_trajectory::<3>().expect("a motion");
    assert_eq!(trajectory, loopbound_model::trajectory::Trajectory::of_the_paper());
    assert!(scenario.build_model::<2>().is_err(), "the scenario has three links");
}

#[test]
fn every_kind_of_disturbance_and_motion_can_be_built() {
    let folder = tempfile::tempdir().expect("a folder");
    let points = folder.path().join("p.csv");
    std::fs::write(&points, "t_s,q1,q2\n0,0,0\n1,0.5,0.2\n2,0.1,0.4\n").expect("it can be written");
    let motions = [
        "kind = 'sine'\nomega_rad_s = [1, 2]".to_owned(),
        "kind = 'multi-sine'\noffset_rad = 0.1\nterm = [{ amplitude_rad = 1, omega_rad_s = 2 }, { amplitude_rad = [1, 2], omega_rad_s = 3 }]".to_owned(),
        "kind = 'quintic'\nto_rad = 1\nduration = '2s'".to_owned(),
        "kind = 'chirp'\nomega_end_rad_s = 3\nduration = '2s'".to_owned(),
        "kind = 'circle'\ncentre_m = [0.5, -1.2]\nradius_m = 0.2\nphase_rad = 1\nelbow_positive = false".to_owned(),
        format!("kind = 'waypoints'\nfile = '{}'", points.display()),
    ];
    let mut starts = Vec::new();
    for motion in motions {
        let scenario = accepted(&format!(
            "[plant]\nlinks = 2\n[reference]\n{motion}
            [[plant.disturbance]]\nkind = 'constant'\nvalue_nm = [1, 0]
            [[plant.disturbance]]\nkind = 'step'\nvalue_nm = 2\nat = '1s'
            [[plant.disturbance]]\nkind = 'sine'\namplitude_nm = 1\nomega_rad_s = 3
            [[plant.disturbance]]\nkind = 'noise'\nrms_nm = 0.5\nlow_hz = 1\nhigh_hz = 10"
        ));
        assert_eq!(accepted(&scenario.to_toml().expect("it can be written")), scenario.resolved());
        starts.push(scenario.build_trajectory::<2>().unwrap_or_else(|error| panic!("{error}")).at(0.7));
        let truth = scenario.build_truth::<2>().unwrap_or_else(|error| panic!("{error}"));
        let jump = truth.disturbance(1.0) - truth.disturbance(1.0 - 1e-9);
        // The step is the only part that is not continuous; the others move by at most 1e-9 times their slope.
        assert!((jump[0] - 2.0).abs() < 1e-6 && (jump[1] - 2.0).abs() < 1e-6, "{jump}");
    }
    for (index, one) in starts.iter().enumerate() {
        assert!(starts[..index].iter().all(|other| other != one), "two kinds give the same motion");
    }
}

#[test]
fn a_circle_out_of_reach_is_refused_under_its_section() {
    let scenario = accepted("[reference]\nkind = 'circle'\ncentre_m = [5, 0]\nradius_m = 0.2");
    let error = scenario.build_trajectory::<3>().expect_err("three metres do not reach five").to_string();
    assert!(error.starts_with("`reference`: the circle takes the tip from"), "{error}");
}

#[test]
fn every_kind_of_fault_is_accepted_and_survives_the_way_through_toml() {
    for kind in FaultKind::ALL {
        let keys = match kind {
            FaultKind::Delay => "delay = '1us'\ndelay_max = '1ms'\ndistribution = 'pareto'",
            FaultKind::Glitch => "value_nm = -3",
            FaultKind::ClockStep => "step = '-5ms'",
            _ => "",
        };
        let scenario = accepted(&format!("[[fault]]\nkind = '{kind}'\nat = '1s'\nfor = 20\n{keys}"));
        assert_eq!(scenario.fault[0].kind, *kind);
        assert_eq!(accepted(&scenario.to_toml().expect("it can be written")), scenario.resolved());
    }
}
