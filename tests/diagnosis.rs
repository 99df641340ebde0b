//! Diagnoses end to end in lockstep: what goes wrong on purpose is named for what it is, and nothing else is named.
#![allow(clippy::disallowed_macros, reason = "the harness keeps what a test prints")]

use loopbound::commands::study::measure::tracker_config;
use loopbound::inprocess::InProcess;
use loopbound_controller::{Builtin, ControllerCore};
use loopbound_monitor::Summary;
use loopbound_monitor::judge::Judge;
use loopbound_monitor::tracker::Tracker;
use loopbound_monitor::verdict::judge_summary;
use loopbound_scenario::Scenario;
use loopbound_scenario::controllers;
use loopbound_shared::event::{Decision, HappeningKind};
use loopbound_shared::headline::Headline;
use loopbound_shared::realtime::Privileges;
use loopbound_shared::sample::{TickRecord, record_flag};

/// The paper's case in lockstep with some settings.
fn scenario(settings: &[&str]) -> Scenario {
    let all: Vec<&str> = ["loop.mode=lockstep", "loop.duration=2s"].iter().chain(settings).copied().collect();
    Scenario::default().with_sets(&all).expect("a scenario")
}

fn with_toml(settings: &[&str], toml: &str) -> Scenario {
    let all: Vec<&str> = ["loop.mode=lockstep", "loop.duration=2s"].iter().chain(settings).copied().collect();
    Scenario::from_toml(toml, "test").and_then(|scenario| scenario.with_sets(&all)).expect("a scenario")
}

/// Runs a scenario: its summary, and the verdicts of the ticks that broke the bound, in order.
fn run(scenario: &Scenario) -> (Summary, Vec<(u64, String)>) {
    let judge = Judge::new(scenario).expect("a system");
    let mut tracker = Tracker::<3>::new(tracker_config(scenario), Some(judge));
    let mut named = Vec::new();
    for part in controllers::of(scenario) {
        let controller = Builtin::<3>::new(scenario, part.law).expect("a law");
        tracker.learn(&ControllerCore::new(scenario, part.id, controller).announcement(Privileges::default()));
    }
    InProcess::<3>::new(scenario).expect("a system").run(|record| {
        tracker.feed(record);
        for event in tracker.drain_events() {
            if let loopbound_monitor::event::EventKind::Bound { verdict, .. } = event.kind {
                named.push((event.tick, verdict.to_owned()));
            }
        }
    });
    tracker.finish();
    (tracker.summarise(), named)
}

fn count(summary: &Summary, verdict: &str) -> u64 {
    summary.bound.verdicts.get(verdict).copied().unwrap_or(0)
}

#[test]
fn nothing_is_named_where_nothing_is_wrong_at_any_rate_that_11_allows() {
    // The long version of this is the ignored test below.
    no_false_alarm(|_| 6_000);
}

#[test]
#[ignore = "an hour of plant time at each rate, 67 million ticks: minutes in release, hours in debug"]
fn no_false_alarm_in_an_hour_at_each_rate() {
    no_false_alarm(|rate_hz| 3600 * rate_hz);
}

fn no_false_alarm(ticks_at: impl Fn(u64) -> u64) {
    for rate_hz in [500u64, 1000, 2000, 5000, 10_000] {
        let ticks = ticks_at(rate_hz);
        let ms = ticks * 1000 / rate_hz;
        let rate = format!("loop.rate={rate_hz}Hz");
        let duration = format!("loop.duration={ms}ms");
        // At 500 Hz the default gain violates [11] (K_t h = 0.21 > 2 λ_min): K3 C1² is lowered until it doesn't.
        let gains: &[&str] = if rate_hz == 500 { &["controller.gains.k3=0.02"] } else { &[] };
        let settings: Vec<&str> = [rate.as_str(), duration.as_str()].into_iter().chain(gains.iter().copied()).collect();
        let (summary, named) = run(&scenario(&settings));
        assert!(summary.bound.certified, "{rate_hz} Hz: {:?}", summary.bound.shortfalls);
        assert!(
            summary.bound.budget_used.is_some_and(|used| used < 1.0),
            "{rate_hz} Hz: {:?}",
            summary.bound.budget_used
        );
        assert!(named.is_empty(), "{rate_hz} Hz: {named:?}");
        assert!(count(&summary, "certified") + 2 > ticks, "{rate_hz} Hz: {:?}", summary.bound.verdicts);
        println!("{rate_hz} Hz: {:?} of {ticks} ticks", summary.bound.verdicts);
    }
}

#[test]
fn a_reversed_torque_is_laid_to_the_controller_in_its_own_tick() {
    // At the start link 1 is 0.3 rad ahead: its torque is strongly negative, and 400 N·m more turn it around.
    let fault = "[[fault]]\nkind = \"glitch\"\nvalue_nm = 400\njoint = 1\nat = 20\n";
    let (summary, named) = run(&with_toml(&[], fault));
    assert_eq!(
        named.first().map(|(tick, verdict)| (*tick, verdict.as_str())),
        Some((20, "controller_fault")),
        "{named:?}"
    );
    assert_eq!(count(&summary, "uncertainty_exceeded"), 0);
}

#[test]
fn a_saturated_actuator_is_laid_to_the_torque_and_not_to_latency() {
    let (summary, named) = run(&scenario(&["plant.torque_limit_nm=8"]));
    assert!(count(&summary, "controller_fault") > 0, "{:?}", summary.bound.verdicts);
    assert_eq!(count(&summary, "uncertainty_exceeded"), 0, "{named:?}");
    assert!(summary.counters["saturated"] > 0);
}

#[test]
fn a_period_or_a_declared_delay_beyond_11_is_by_design_until_v_leaves_the_level_and_latency_where_it_does() {
    // 1 kHz uses 53 % of [11]; twice the period is beyond it, and so is a delay of two periods.
    for setting in ["loop.rate=500Hz", "plant.actuation_delay=2ms"] {
        let (summary, named) = run(&scenario(&[setting]));
        assert!(summary.bound.budget_used.is_some_and(|used| used > 1.0));
        let by_age = |verdict: &str| verdict == "latency" || verdict == "designed_hold";
        assert!(named.iter().all(|(_, verdict)| by_age(verdict)), "{setting}: {named:?}");
        // The hold is excused as long as V stays within the level, and not where it doesn't.
        assert!(count(&summary, "latency") > 0, "{setting}: {:?}", summary.bound.verdicts);
        assert!(count(&summary, "outside_level") > 0, "{setting}: {:?}", summary.bound.verdicts);
        assert_eq!(summary.late_ticks, 0);
    }
}

#[test]
fn an_exact_model_that_leaves_the_hold_no_room_is_not_late() {
    let settings = ["controller.law=ctc", "controller.gains.level=8"];
    let (summary, named) = run(&scenario(&settings));
    assert!(count(&summary, "designed_hold") > 100, "{:?}", summary.bound.verdicts);
    assert!(named.iter().all(|(_, verdict)| verdict == "designed_hold"), "{named:?}");
    assert_eq!((summary.late_ticks, summary.missed_ticks), (0, 0));
    assert_eq!(judge_summary(&summary).status, "held", "{:?}", judge_summary(&summary).reasons);
    // With torques that are late the same loop is.
    let late = "[[fault]]\nkind = \"delay\"\ndelay = \"700us\"\nat = \"100ms\"\nfor = \"100ms\"\n";
    let (summary, _) = run(&with_toml(&settings, late));
    assert!(count(&summary, "latency") > 10, "{:?}", summary.bound.verdicts);
    assert_eq!(judge_summary(&summary).status, "late");
}

#[test]
fn a_declared_delay_is_no_fault_and_before_the_first_torque_nothing_is_checked() {
    for delay in ["250us", "1500us", "5ms"] {
        let settings =
            ["controller.law=robust-ff", "controller.gains.level=10", &format!("plant.actuation_delay={delay}")];
        let (summary, named) = run(&scenario(&settings));
        assert_eq!(summary.bound.violations_delay_aware, 0, "{delay}: {:?}", named.first());
        let without = summary.ticks - summary.bound.checked;
        assert!((1..=5).contains(&without), "{delay}: {without} ticks before the first torque");
    }
}

#[test]
fn the_figures_of_two_laws_are_never_mixed() {
    let toml = "[[swap]]\nat = 1000\nlaw = \"ctc\"\n";
    let (summary, _) = run(&with_toml(&[], toml));
    let laws = &summary.bound.laws;
    let named: Vec<(Option<&str>, &[u32], u64)> =
        laws.iter().map(|of| (of.bound.law.as_deref(), &of.controllers[..], of.ticks)).collect();
    assert_eq!(named, [(Some("robust"), &[1][..], 1000), (Some("ctc"), &[2], 1000)]);
    assert_eq!((laws[0].first_tick, laws[0].last_tick, laws[1].first_tick), (Some(0), Some(999), Some(1000)));
    // Alone, each has the figures that it has here.
    let (alone, _) = run(&scenario(&["loop.duration=1s"]));
    assert_eq!((laws[0].bound.psi_max, laws[0].bound.v_start), (alone.bound.psi_max, alone.bound.v_start));
    assert_eq!((laws[0].bound.c1, laws[0].bound.uub_radius), (alone.bound.c1, alone.bound.uub_radius));
    assert_eq!((summary.bound.law.as_deref(), summary.bound.c1), (Some("ctc"), laws[1].bound.c1));
    assert_eq!(summary.bound.v_max, laws[1].bound.v_max, "V of the law in charge last, not the larger of two");
    assert_eq!(summary.bound.checked, laws[0].bound.checked + laws[1].bound.checked);
    // Back to a law that was known already is no third one.
    let (back, _) = run(&with_toml(&[], "[[swap]]\nat = 500\nlaw = \"ctc\"\n[[swap]]\nat = 1000\nlaw = \"robust\"\n"));
    let named: Vec<(&[u32], u64)> = back.bound.laws.iter().map(|of| (&of.controllers[..], of.ticks)).collect();
    assert_eq!(named, [(&[1, 3][..], 1500), (&[2], 500)]);
}

/// Torques that come too late to act at all: the plant holds, then damps by itself.
#[test]
fn the_plants_own_damping_is_fallback_and_laid_to_what_kept_the_torque_from_coming() {
    let long = "[loop]\nmode=\"lockstep\"\nduration=\"2s\"\n\
                [[fault]]\nkind=\"delay\"\ndelay=\"900us\"\nat=\"60ms\"\nfor=\"60ms\"\n";
    let short =
        "[loop]\nmode=\"lockstep\"\nduration=\"2s\"\n[[fault]]\nkind=\"delay\"\ndelay=\"3ms\"\nat=1\nfor=\"4ms\"\n";
    for (toml, missed) in [(long, 60), (short, 4)] {
        let (summary, named) = run(&with_toml(&[], toml));
        let bound = &summary.bound;
        assert!(count(&summary, "fallback") > 0 && bound.violations_delay_aware == 0, "{:?}", bound.verdicts);
        assert!(named.iter().all(|(_, verdict)| verdict == "fallback" || verdict == "latency"), "{named:?}");
        // It answered each of them, late: it is neither silent nor dead.
        assert_eq!((summary.missed_ticks, summary.missed_ticks_by_cause["injected_fault"]), (missed, missed));
        assert_eq!(summary.counters["stale"], missed);
        assert_eq!(bound.fallback_by_cause.values().sum::<u64>(), count(&summary, "fallback"));
        let status = judge_summary(&summary);
        assert_eq!(status.status, "late", "{:?}", status.reasons);
    }
}

#[test]
fn a_torque_that_is_no_number_is_never_applied_and_what_follows_is_fallback() {
    for kind in ["nan", "drop"] {
        let toml = format!("[[fault]]\nkind = \"{kind}\"\nat = \"60ms\"\nfor = \"60ms\"\n");
        let (summary, named) = run(&with_toml(&[], &toml));
        assert_eq!(count(&summary, "controller_fault"), 0, "{kind}: {named:?}");
        assert_eq!(summary.bound.fallback_by_cause["injected_fault"], count(&summary, "fallback"), "{kind}");
        assert!(count(&summary, "fallback") > 0, "{kind}: {:?}", summary.bound.verdicts);
    }
}

#[test]
fn a_wrong_torque_after_a_fallback_is_still_a_fault() {
    let toml = "[[fault]]\nkind = \"drop\"\nat = \"60ms\"\nfor = \"60ms\"\n\
                [[fault]]\nkind = \"glitch\"\nvalue_nm = 400\njoint = 1\nat = 200\n";
    let (summary, named) = run(&with_toml(&[], toml));
    assert!(named.contains(&(200, "controller_fault".to_owned())), "{named:?}");
    assert_eq!(judge_summary(&summary).status, "violated");
}

#[test]
fn the_torque_that_goes_on_after_a_cross_fade_accuses_nobody() {
    let toml = "[controller.gains]\nshared_v = true\n[plant]\nactuation_delay = \"300us\"\n\
                [[swap]]\nat = 200\nlaw = \"robust-ff\"\nblend = \"20ms\"\n";
    let (summary, named) = run(&with_toml(&[], toml));
    assert_eq!(summary.swaps.len(), 1);
    assert_eq!(summary.bound.violations_delay_aware, 0, "{named:?}");
}

/// A constant disturbance with the norm of so many times the D that C1 = 40 covers.
fn disturbed(times: f64) -> Scenario {
    let each = 10.8 * times / 3.0f64.sqrt();
    let toml = format!("[[plant.disturbance]]\nkind = \"step\"\nvalue_nm = {each:.3}\nat = \"200ms\"\n");
    with_toml(&["controller.uncertainty.disturbance_nm=10.8"], &toml)
}

#[test]
fn a_disturbance_of_twenty_times_what_is_declared_is_laid_to_uncertainty_within_ten_ticks() {
    let (summary, named) = run(&disturbed(20.0));
    // In the tick of the step itself the torque still answers the calm sample before it: its age suffices as the cause.
    let first = named.iter().find(|(_, verdict)| verdict == "uncertainty_exceeded").expect("it is named");
    assert!((200..210).contains(&first.0) && named.iter().all(|(tick, _)| *tick >= 200), "{named:?}");
    assert_eq!(count(&summary, "controller_fault"), 0);
}

#[test]
fn a_disturbance_of_twice_what_is_declared_shows_in_psi_and_accuses_nobody_else() {
    let (summary, named) = run(&disturbed(2.0));
    assert!(named.iter().all(|(_, verdict)| verdict == "uncertainty_exceeded"), "{named:?}");
    // The sharp check: what Ψ leaves for C1 is more than without the disturbance, by about its size.
    let (calm, _) = run(&disturbed(0.0));
    let (psi, calm) = (summary.bound.psi_max.expect("checked"), calm.bound.psi_max.expect("checked"));
    assert!(psi > calm, "{psi} {calm}");
}

/// The records of a scenario, and its summary.
fn records(scenario: &Scenario) -> (Vec<TickRecord>, Summary) {
    let mut tracker = Tracker::<3>::new(tracker_config(scenario), Some(Judge::new(scenario).expect("a system")));
    let mut records = Vec::new();
    InProcess::<3>::new(scenario).expect("a system").run(|record| {
        tracker.feed(record);
        records.push(*record);
    });
    tracker.finish();
    (records, tracker.summarise())
}

fn numbers(record: &TickRecord) -> impl Iterator<Item = f64> {
    let torques = record.segments.iter().flat_map(|segment| segment.tau);
    let state = [record.q, record.v, record.q_measured, record.v_measured, record.q_d, record.v_d, record.a_d];
    let values = record.happenings.map(|happening| happening.value);
    state.into_iter().flatten().chain(torques.collect::<Vec<_>>()).chain(values)
}

#[test]
fn a_loop_that_runs_away_is_stopped_and_diverged_whatever_made_it_run_and_no_record_holds_a_value_that_is_not_finite() {
    let glitch = "[[fault]]\nkind = \"glitch\"\nvalue_nm = 1e12\nat = 40\n";
    let noisy = "[plant.noise]\nq_rad = 1e-3\nv_rad_s = 1e-2\n";
    for (settings, toml) in [
        (vec!["loop.rate=200Hz"], ""),
        (vec!["controller.gains.k_t=1e4"], ""),
        (vec!["controller.law=pd+g", "controller.gains.kp=1e6"], ""),
        (vec!["controller.law=pd+g", "controller.gains.kp=1e6"], noisy),
        // Finite torques so large that the state overflows within the tick.
        (vec![], glitch),
        (vec!["controller.standby=1"], glitch),
        // Without a limit of the speed what is not finite is left, and that is enough.
        (vec!["loop.rate=200Hz", "plant.speed_limit=inf"], ""),
    ] {
        let mut scenario = with_toml(&settings, toml);
        // More than a scenario may ask for: a controller of one's own may give it.
        scenario.fault.iter_mut().for_each(|fault| fault.value_nm = fault.value_nm.map(|_| 1e300));
        let (records, summary) = self::records(&scenario);
        for record in &records {
            let bad = numbers(record).find(|number| !number.is_finite());
            assert_eq!(bad, None, "{settings:?}: tick {}", record.tick);
        }
        let diverged = summary.diverged.as_ref().unwrap_or_else(|| panic!("{settings:?}: {summary:?}"));
        let verdict = judge_summary(&summary);
        assert_eq!(verdict.headline(), Headline::Diverged, "{settings:?}: {:?}", verdict.reasons);
        assert!(verdict.reasons[0].contains(&format!("tick {}", diverged.tick)), "{:?}", verdict.reasons);
        // The controller answered every tick in time, and nobody says otherwise.
        assert_eq!(
            (summary.late_ticks, summary.missed_ticks),
            (0, 0),
            "{settings:?}: {:?}",
            summary.missed_ticks_by_cause
        );
        assert!(summary.missed_ticks_by_cause.values().all(|count| *count == 0), "{settings:?}");
        // The safe stop: the chain stands to the end.
        let last = records.last().expect("records");
        assert_eq!(last.decision, Decision::Stopped.code(), "{settings:?}");
        assert!(last.v.iter().all(|v| v.abs() < f64::EPSILON) && last.flags & record_flag::DIVERGED != 0);
        assert_eq!(happened(&records, HappeningKind::Diverged), 1, "{settings:?}");
        assert!(summary.bound.checked < records.len() as u64, "a V that is no number is not checked");
    }
}

fn happened(records: &[TickRecord], kind: HappeningKind) -> usize {
    let of = |record: &TickRecord| {
        record.happenings.iter().take(record.happenings_used as usize).filter(|h| h.kind == kind.code()).count()
    };
    records.iter().map(of).sum()
}

#[test]
fn a_finite_runaway_is_diverged_by_its_v_though_no_joint_is_too_fast() {
    for setting in ["loop.rate=500Hz", "plant.actuation_delay=2ms"] {
        let (records, summary) = records(&scenario(&["loop.duration=10s", setting]));
        let diverged =
            summary.diverged.as_ref().unwrap_or_else(|| panic!("{setting}: V max {:?}", summary.bound.v_max));
        assert_eq!(diverged.quantity, "V", "{setting}: {diverged:?}");
        assert!(diverged.value > diverged.limit && diverged.limit == Some(60.0), "{setting}: {diverged:?}");
        assert_eq!(judge_summary(&summary).headline(), Headline::Diverged);
        let fastest = records.iter().flat_map(|record| record.v).fold(0.0f64, |most, v| most.max(v.abs()));
        println!("{setting}: {diverged:?}, fastest link {fastest:.1} rad/s");
    }
}

#[test]
fn an_uncertified_loop_runs_away_by_the_level_of_its_scenario_and_a_sound_one_does_not() {
    let uncertified = "controller.uncertainty.mass=0.2";
    let (_, summary) = records(&scenario(&[uncertified]));
    assert!(!summary.bound.certified && summary.diverged.is_none(), "{:?}", summary.diverged);
    assert_eq!(judge_summary(&summary).headline(), Headline::NotCertified);
    let (_, summary) = records(&scenario(&[uncertified, "loop.rate=200Hz"]));
    assert_eq!(judge_summary(&summary).headline(), Headline::Diverged);
}

#[test]
fn a_delay_that_jumps_shakes_a_loop_that_is_calm_with_the_longest_of_its_delays_all_the_time() {
    // a h = 1.5, a d = 0.9: within [11], beyond the rule for jitter [14].
    let settings = ["controller.gains.k_t=151.9", "controller.gains.c1=29.2", "loop.grace=740us", "loop.settle=500ms"];
    let delayed = |every: u32| {
        let fault = format!("[[fault]]\nkind = \"delay\"\ndelay = \"600us\"\nat = 0\nfor = \"1h\"\nevery = {every}\n");
        run(&with_toml(&settings, &fault)).0
    };
    let (constant, jittering) = (delayed(1), delayed(2));
    let (calm, shakes) = (constant.tracking.max_abs_ed_rad_s, jittering.tracking.max_abs_ed_rad_s);
    assert!(constant.diverged.is_none() && calm.is_some_and(|v| v < 0.5), "{calm:?}");
    assert!(jittering.diverged.is_some() || shakes.is_some_and(|v| v > 20.0), "{shakes:?}");
    let (constant, jittering) = (constant.bound, jittering.bound);
    assert_eq!(constant.budget_rule.as_deref(), Some("constant delay"));
    assert!(constant.budget_used.is_some_and(|used| (used - 0.9).abs() < 5e-3), "{:?}", constant.budget_used);
    assert_eq!(jittering.budget_rule.as_deref(), Some("jittering delay"));
    assert!(jittering.budget_used.is_some_and(|used| (used - 1.085).abs() < 5e-3), "{:?}", jittering.budget_used);
    assert!(jittering.delay_margin_ns.is_some_and(|margin| margin < 1.0));
}
