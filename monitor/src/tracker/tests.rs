//! Known answers for every figure and cause, from records made on paper.

use loopbound_model::law::LawKind;
use loopbound_scenario::Scenario;
use loopbound_shared::event::{Decision, HappeningKind, Refusal};
use loopbound_shared::realtime::Evidence;
use loopbound_shared::sample::{Receipt, torque_flag};

use super::*;
use crate::testing::*;

fn feed_all(tracker: &mut Tracker<3>, records: impl IntoIterator<Item = TickRecord>) {
    records.into_iter().for_each(|record| {
        tracker.feed(&record);
    });
    tracker.finish();
}

type ByCause = Vec<(String, u64)>;

/// Causes that were found, late and missed, by name, zeros left out.
fn found(records: impl IntoIterator<Item = TickRecord>) -> (ByCause, ByCause) {
    let mut tracker = tracker();
    feed_all(&mut tracker, records);
    let summary = tracker.summarise();
    let some = |map: std::collections::BTreeMap<String, u64>| map.into_iter().filter(|(_, count)| *count > 0).collect();
    (some(summary.late_ticks_by_cause), some(summary.missed_ticks_by_cause))
}

fn one(name: &str, count: u64) -> ByCause {
    vec![(name.to_owned(), count)]
}

/// Delays the controller's answer by what is given for its wake-up, computation, and way back.
fn delayed(tick: u64, wake_ns: u64, compute_ns: u64, return_ns: u64) -> TickRecord {
    let mut record = good(tick);
    let receipt = &mut record.receipts[0];
    receipt.state_received_ns += wake_ns;
    receipt.torque_published_ns += wake_ns + compute_ns;
    receipt.arrived_ns += wake_ns + compute_ns + return_ns;
    record.accepted_ns = receipt.arrived_ns;
    record.decision = Decision::ActiveLate.code();
    receipt.acceptance = Acceptance::Late.code();
    record.counters.missed = 1;
    record
}

fn with_controller_evidence(mut record: TickRecord, run_delay_ns: u64, switches: u64, faults: u64) -> TickRecord {
    let receipt = &mut record.receipts[0];
    (receipt.run_delay_ns, receipt.involuntary_switches, receipt.faults) = (run_delay_ns, switches, faults);
    record
}

#[test]
fn every_hop_is_the_difference_of_its_stamps() {
    let mut tracker = tracker();
    feed_all(&mut tracker, (0..1000).map(good));
    let latency = tracker.summarise().latency_ns;
    let back_ns = TO_CONTROLLER_NS + COMPUTE_NS + RETURN_NS;
    for (quantiles, expected_ns) in [
        (latency.wakeup, WAKEUP_NS),
        (latency.state_to_controller, TO_CONTROLLER_NS),
        (latency.compute, COMPUTE_NS),
        (latency.controller_to_plant, RETURN_NS),
        (latency.round_trip, back_ns),
        (latency.deadline_to_torque, WAKEUP_NS + PUBLISH_NS + back_ns),
        (latency.setpoint_age, LEAD_NS),
    ] {
        assert_eq!((quantiles.n, quantiles.max), (1000, Some(expected_ns as f64)));
        assert!((quantiles.p50.unwrap() / expected_ns as f64 - 1.0).abs() < 1e-3, "{quantiles:?}");
    }
}

#[test]
fn the_interval_between_samples_has_its_mean_and_deviation() {
    let mut tracker = tracker();
    // Every other tick 10 µs late: intervals alternate between 1.01 and 0.99 ms.
    feed_all(
        &mut tracker,
        (0..1001).map(|tick| {
            let mut record = good(tick);
            record.sampled_ns += 10_000 * (tick % 2);
            record
        }),
    );
    let jitter = tracker.summarise().jitter_ns;
    assert_eq!((jitter.n, jitter.min, jitter.max), (1000, Some(990_000.0), Some(1_010_000.0)));
    assert!((jitter.mean.unwrap() - 1e6).abs() < 1e-6);
    // Of ±10 µs with n − 1 in the denominator.
    assert!((jitter.std.unwrap() - 10_000.0 * (1000.0f64 / 999.0).sqrt()).abs() < 1e-6);
    assert!((jitter.deviation_p99.unwrap() / 10_000.0 - 1.0).abs() < 1e-3);
}

#[test]
fn start_up_ticks_are_left_out_and_counted() {
    let config = Config { start_up_ns: 10 * PERIOD_NS, ..config() };
    let mut tracker = Tracker::<3>::new(config.clone(), None);
    let resting = (0..5).map(|tick| {
        let mut record = unanswered(tick);
        record.flags = record_flag::AT_REST;
        record.decision = Decision::Rest.code();
        record
    });
    feed_all(&mut tracker, resting.chain((5..100).map(good)));
    let summary = tracker.summarise();
    assert_eq!((summary.start_up_ticks, summary.latency_ns.round_trip.n), (15, 85));
    assert_eq!(summary.ticks_seen, 100);
    // A monitor that joins a running group has missed the start-up, and leaves nothing out.
    let mut late = Tracker::<3>::new(config.clone(), None);
    feed_all(&mut late, (500..600).map(good));
    assert_eq!((late.summarise().start_up_ticks, late.summarise().first_tick), (0, Some(500)));
    // Virtual time has no start-up.
    let mut lockstep = Tracker::<3>::new(Config { lockstep: true, ..config }, None);
    feed_all(&mut lockstep, (0..100).map(good));
    assert_eq!((lockstep.summarise().start_up_ticks, lockstep.summarise().floor), (0, None));
}

#[test]
fn gaps_are_what_lies_between_records_less_what_the_plant_skipped() {
    let mut tracker = tracker();
    let mut skipping = good(20);
    skipping.skipped_before = 3;
    skipping.counters.missed = 3;
    let mut last = good(30);
    last.counters.missed = 5;
    // 10 follows 4: five are missing. 20 follows 10: nine lie between, three of them skipped. 30: nine more.
    feed_all(&mut tracker, [good(3), good(4), good(10), skipping, good(10), last]);
    let summary = tracker.summarise();
    assert_eq!((summary.monitor_gaps, summary.ticks_seen, summary.ticks), (5 + 6 + 9, 5, 31));
    // The plant counted five misses, of which this monitor saw three.
    assert_eq!(summary.missed_ticks, 5);
    assert_eq!(summary.missed_ticks_by_cause["not_seen"], 2);
    assert_eq!(summary.missed_ticks_by_cause["timer_or_host"], 3);
    assert_eq!(summary.events["gap"], 3);
}

#[test]
fn a_controller_is_asked_for_its_evidence_which_comes_with_its_next_answer() {
    let late = || delayed(5, 600_000, 0, 0);
    let around = |record, next| [good(4), record, next, good(7)];
    let preempted = with_controller_evidence(good(6), 550_000, 1, 0);
    assert_eq!(found(around(late(), preempted)).0, one("involuntary_switch", 1));
    let waited = with_controller_evidence(good(6), 550_000, 0, 0);
    assert_eq!(found(around(late(), waited)).0, one("run_queue_delay", 1));
    let faulted = with_controller_evidence(good(6), 0, 0, 2);
    assert_eq!(found(around(late(), faulted)).0, one("page_fault", 1));
    assert_eq!(found(around(late(), good(6))).0, one("controller_late", 1));
    assert_eq!(found(around(delayed(5, 0, 600_000, 0), good(6))).0, one("own_overrun", 1));
    // A late tick without an answer in time is missed too, for the same reason.
    assert_eq!(found(around(delayed(5, 0, 600_000, 0), good(6))).1, one("own_overrun", 1));
    // What it says of itself is in the answer, late as that is, or in the first one after a tick without any.
    let mut mapping = late();
    mapping.receipts[0].flags |= torque_flag::MAPPED;
    assert_eq!(found(around(mapping, good(6))).0, one("monitor_joined", 1));
    // Evidence that was there before is not of this tick.
    let before = with_controller_evidence(good(4), 550_000, 1, 0);
    let same = with_controller_evidence(good(6), 550_000, 1, 0);
    let unchanged = with_controller_evidence(late(), 550_000, 1, 0);
    assert_eq!(found([before, unchanged, same]).0, one("controller_late", 1));
}

#[test]
fn the_plant_is_asked_for_what_happened_to_it_in_the_same_tick() {
    let late = |evidence: Evidence| {
        let mut record = good(5);
        record.sampled_ns += 600_000;
        record.published_ns += 600_000;
        let receipt = &mut record.receipts[0];
        receipt.state_received_ns += 600_000;
        receipt.torque_published_ns += 600_000;
        receipt.arrived_ns += 600_000;
        record.accepted_ns += 600_000;
        record.grace_deadline_ns += 600_000;
        record.evidence = evidence;
        record
    };
    let cause = |evidence| found([good(4), late(evidence), good(6)]);
    let none = Evidence::default();
    assert_eq!(cause(none), (one("timer_or_host", 1), vec![]));
    assert_eq!(cause(Evidence { run_delay_ns: 500_000, ..none }).0, one("run_queue_delay", 1));
    assert_eq!(
        cause(Evidence { run_delay_ns: 500_000, involuntary_switches: 2, ..none }).0,
        one("involuntary_switch", 1)
    );
    assert_eq!(cause(Evidence { major_faults: 1, ..none }).0, one("page_fault", 1));
    assert_eq!(cause(Evidence { run_time_ns: 1_600_000, ..none }).0, one("own_overrun", 1));
    // Late from the tick before, without any sleep between: what kept the plant there is in the reading of that tick.
    let kept = Evidence { run_delay_ns: 500_000, ..none };
    let before = TickRecord { evidence: kept, ..good(4) };
    let sleepless = TickRecord { wake_late_ns: u64::MAX, ..late(kept) };
    assert_eq!(found([good(3), before, late(kept)]).0, one("timer_or_host", 1));
    assert_eq!(found([good(3), before, sleepless]).0, one("run_queue_delay", 1));
    let joined = |mut record: TickRecord| {
        record.flags |= record_flag::JOINED;
        record.happenings[0] = Happening { kind: HappeningKind::Joined.code(), detail: 450_000, ..Happening::zeroed() };
        record.happenings_used = 1;
        record
    };
    assert_eq!(found([good(4), joined(late(none))]).0, one("monitor_joined", 1));
    assert_eq!(found([joined(good(4)), late(none)]).0, one("monitor_joined", 1), "mapped in the slack before");
}

#[test]
fn injected_faults_silence_and_death_are_told_apart() {
    let mut injected = delayed(5, 0, 600_000, 0);
    injected.receipts[0].flags = torque_flag::FAULT_INJECTED;
    assert_eq!(found([good(4), injected, good(6)]).0, one("injected_fault", 1));
    let mut withheld = unanswered(5);
    withheld.receipts[0] = Receipt {
        arrived_ns: withheld.published_ns + 9_000,
        acceptance: Acceptance::Withheld.code(),
        flags: torque_flag::WITHHELD,
        ..withheld.receipts[0]
    };
    assert_eq!(found([good(4), withheld, good(6)]), (vec![], one("injected_fault", 1)));
    // One tick without an answer is late, ten are silence, and ten that were spent waiting for a core are that.
    assert_eq!(found([good(4), unanswered(5), good(6)]).1, one("controller_late", 1));
    let silent = || (5..15).map(unanswered);
    assert_eq!(found([good(4)].into_iter().chain(silent()).chain([good(15)])).1, one("controller_silent", 10));
    // What it waited is in the reading after the answer that ends the silence, so in the answer after that.
    let starved = with_controller_evidence(good(16), 9_000_000, 0, 0);
    assert_eq!(found([good(4)].into_iter().chain(silent()).chain([good(15), starved])).1, one("run_queue_delay", 10));
    // It never answers again: decided after the time that a monitor waits, or at the end.
    assert_eq!(found([good(4)].into_iter().chain((5..205).map(unanswered))).1, one("controller_silent", 200));
    let mut removed = unanswered(5);
    removed.happenings[0] = Happening { kind: HappeningKind::MemberRemoved.code(), subject: 1, ..Happening::zeroed() };
    removed.happenings_used = 1;
    assert_eq!(found([good(4), removed]).1, one("controller_dead", 1));
    let mut stale = unanswered(5);
    stale.flags |= record_flag::SETPOINT_STALE;
    assert_eq!(found([good(4), stale, good(6)]).1, one("setpoint_stale", 1));
}

#[test]
fn a_standby_in_time_is_no_miss_and_a_failover_is_one_entry_however_long_it_lasts() {
    let standby = |tick: u64| {
        let mut record = good(tick);
        record.decision = Decision::Standby.code();
        record.receipts[1] = Receipt { writer: 1, ..Receipt::zeroed() };
        record.receipts[0].writer = 2;
        record.receipts_used = 2;
        record.happenings[0] =
            Happening { kind: HappeningKind::Failover.code(), subject: 2, detail: 1, ..Happening::zeroed() };
        record.happenings_used = 1;
        record.segments[1] = Segment { tau: [1.0, -2.5, 0.0, 0.0, 0.0, 0.0, 0.0], writer: 2, ..record.segments[0] };
        record.segments_used = 2;
        record
    };
    let mut tracker = tracker();
    feed_all(&mut tracker, [good(4), standby(5), standby(6), standby(7), good(8)]);
    let summary = tracker.summarise();
    assert_eq!(summary.missed_ticks_by_cause.values().sum::<u64>(), 0);
    assert_eq!(summary.swaps.len(), 1);
    let swap = &summary.swaps[0];
    assert_eq!((swap.tick, swap.from, swap.to, swap.kind.as_str(), swap.missed_ticks), (5, 1, 2, "failover", 0));
    assert_eq!(swap.torque_step_nm, Some(2.5));
}

#[test]
fn a_swap_carries_its_step_its_misses_and_the_reason_of_its_rollback() {
    let happened = |mut record: TickRecord, kind: HappeningKind, subject, detail, value| {
        record.happenings[0] = Happening { kind: kind.code(), subject, detail, value };
        record.happenings_used = 1;
        record
    };
    let mut tracker = tracker();
    let refused = happened(good(2), HappeningKind::SwapRefused, 3, u64::from(Refusal::TorqueStep.code()), 7.5);
    let mut swap = happened(good(4), HappeningKind::Swap, 2, 1, 0.25);
    // In lockstep the old torque is in the record before.
    swap.segments[0] = Segment { tau: [0.5, -1.5, 0.0, 0.0, 0.0, 0.0, 0.0], writer: 2, ..swap.segments[0] };
    let back = happened(good(7), HappeningKind::Rollback, 1, u64::from(Refusal::BoundExceeded.code()), 0.0);
    feed_all(&mut tracker, [good(1), refused, good(3), swap, unanswered(5), unanswered(6), back, unanswered(90)]);
    let swaps = tracker.summarise().swaps;
    assert_eq!((swaps.len(), swaps[0].result.as_str(), swaps[0].torque_step_nm), (2, "refused", Some(7.5)));
    assert_eq!(swaps[0].reason.as_deref(), Some(Refusal::TorqueStep.name()));
    assert_eq!((swaps[1].from, swaps[1].to, swaps[1].missed_ticks, swaps[1].torque_step_nm), (1, 2, 2, Some(1.5)));
    assert_eq!((swaps[1].torque_steps_nm.clone(), swaps[1].torque_difference_nm), (vec![0.5, -1.5, 0.0], Some(0.25)));
    assert_eq!(
        (swaps[1].result.as_str(), swaps[1].reason.as_deref()),
        ("rolled back", Some(Refusal::BoundExceeded.name()))
    );
}

#[test]
fn a_swap_that_was_refused_for_another_reason_took_no_step() {
    let mut tracker = tracker();
    let mut refused = good(2);
    let detail = u64::from(Refusal::OutsideLevel.code());
    refused.happenings[0] = Happening { kind: HappeningKind::SwapRefused.code(), subject: 3, detail, value: 7.5 };
    refused.happenings_used = 1;
    feed_all(&mut tracker, [good(1), refused, good(3)]);
    let swaps = tracker.summarise().swaps;
    assert_eq!((swaps[0].torque_step_nm, swaps[0].value), (None, Some(7.5)));
}

#[test]
fn the_step_of_a_change_is_to_its_first_own_torque_also_where_that_acts_later() {
    let tau = |first: f64| [first, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let acting = |tick: u64, segments: &[(u32, u64, f64)]| {
        let mut record = good(tick);
        for (place, (writer, answered_tick, first)) in record.segments.iter_mut().zip(segments) {
            *place = Segment { writer: *writer, answered_tick: *answered_tick, tau: tau(*first), ..*place };
        }
        record.segments_used = u32::try_from(segments.len()).unwrap();
        record
    };
    // Controller 2 had stood in before; it takes over in tick 5, and the way to the actuator takes one and a half ticks.
    let mut swap = acting(5, &[(2, 3, 9.0), (1, 4, 1.0)]);
    swap.happenings[0] = Happening { kind: HappeningKind::Swap.code(), subject: 2, detail: 1, value: 4.0 };
    swap.happenings_used = 1;
    swap.decision = Decision::Blend.code();
    let mut fading = acting(6, &[(1, 4, 1.0), (2, 5, 1.25)]);
    fading.decision = Decision::Blend.code();
    let mut tracker = tracker();
    feed_all(&mut tracker, [acting(4, &[(2, 3, 9.0)]), swap, fading, acting(7, &[(2, 6, 5.0)])]);
    let swap = &tracker.summarise().swaps[0];
    assert_eq!((swap.torque_step_nm, swap.torque_steps_nm.first(), swap.blended_ticks), (Some(0.25), Some(&0.25), 2));
    assert_eq!(swap.torque_difference_nm, Some(4.0));
}

#[test]
fn tracking_errors_count_once_settled() {
    let mut tracker = Tracker::<3>::new(Config { settle_ns: 10 * PERIOD_NS, ..config() }, None);
    let off = |tick: u64, e: f64| {
        let mut record = good(tick);
        (record.q_d[1], record.q[1], record.v_d[0]) = (e, 0.0, -2.0 * e);
        (record.q_d[2], record.q[2], record.v_d[2]) = (0.0, 0.75 * e, 1.5 * e);
        record
    };
    feed_all(&mut tracker, [off(9, 100.0), off(10, 3.0), off(11, -4.0)]);
    let tracking = tracker.summarise().tracking;
    assert_eq!((tracking.n, tracking.max_abs_e_rad, tracking.max_abs_ed_rad_s), (2, Some(4.0), Some(8.0)));
    // Links of 4 and 3 rad, of 8 and 6 rad/s: the norm is neither's.
    assert_eq!((tracking.max_norm_e_rad, tracking.max_norm_ed_rad_s), (Some(5.0), Some(10.0)));
    // Two ticks of three links: sqrt((9 + 16)(1 + 9/16)/6).
    assert!((tracking.rms_e_rad.unwrap() - (25.0f64 * 1.5625 / 6.0).sqrt()).abs() < 1e-12);
    let mut unsettled = Tracker::<3>::new(Config { settle_ns: u64::MAX, ..config() }, None);
    feed_all(&mut unsettled, [good(0)]);
    assert_eq!(unsettled.summarise().tracking, Tracking::default());
}

#[test]
fn a_record_of_random_bytes_harms_nothing_and_the_summary_stays_readable() {
    let mut tracker = judged_tracker(&Scenario::default());
    let mut wild = good(7);
    (wild.segments_used, wild.receipts_used, wild.happenings_used) = (u32::MAX, 99, u32::MAX);
    (wild.decision, wild.active, wild.flags) = (77, 1, 0);
    (wild.sampled_ns, wild.published_ns, wild.end_plant_ns) = (u64::MAX, 1, 0);
    wild.q = [f64::NAN; 7];
    wild.v = [f64::INFINITY; 7];
    wild.q_d[0] = 1e308;
    wild.skipped_before = u64::MAX;
    wild.receipts[3].acceptance = 1234;
    wild.counters.missed = u64::MAX;
    feed_all(&mut tracker, [good(5), wild, good(8), TickRecord { tick: u64::MAX, ..wild }, good(9)]);
    let text = serde_json::to_string(&tracker.summarise()).unwrap();
    let back: Summary = serde_json::from_str(&text).unwrap();
    assert_eq!(back.ticks_seen, 4);
    assert_eq!(back.bound.v_max, None, "infinite is not a figure");
    assert!(tracker.drain_events().all(|event| serde_json::from_str::<serde_json::Value>(&event.to_json()).is_ok()));
}

#[test]
fn the_default_loop_keeps_its_promise_and_every_figure_of_the_bound_is_there() {
    let scenario = Scenario::default();
    let mut tracker = judged_tracker(&scenario);
    let mut plant = Loop::new(&scenario, LawKind::Robust);
    for _ in 0..3000 {
        tracker.feed(&plant.next());
    }
    let bound = tracker.summarise().bound;
    assert_eq!((bound.checked, bound.violations_delay_aware, bound.violations_promise), (3000, 0, 0), "{bound:?}");
    assert!(bound.certified && bound.law.as_deref() == Some("robust"));
    assert!((bound.v_start.unwrap() - 5.93).abs() < 0.01, "{bound:?}");
    assert!((bound.k_t.unwrap() - 106.8).abs() < 0.05 && (bound.kappa.unwrap() - 32.80).abs() < 0.01);
    assert!(bound.psi_max.unwrap() < bound.c1.unwrap() && bound.slack_min.unwrap() > 0.0);
    assert!(bound.v_final.unwrap() < 1.0 && bound.budget_used.unwrap() < 1.0 && bound.delay_margin_ns.unwrap() > 0.0);
}

#[test]
fn a_reversed_torque_is_laid_to_the_controller_and_a_foreign_law_is_not_certified() {
    let scenario = Scenario::default();
    let mut tracker = judged_tracker(&scenario);
    let mut plant = Loop::new(&scenario, LawKind::Robust);
    plant.factor = -1.0;
    for _ in 0..5 {
        tracker.feed(&plant.next());
    }
    let bound = tracker.summarise().bound;
    assert!(bound.violations_delay_aware > 0 && bound.verdicts["controller_fault"] > 0, "{bound:?}");
    assert_eq!(crate::verdict::judge_summary(&tracker.summarise()).status, "violated");

    let mut tracker = judged_tracker(&scenario);
    let mut plant = Loop::new(&scenario, LawKind::Robust);
    tracker.learn(&Announce { law: 0, ..controller(1, LawKind::Robust, &plant.law) });
    for _ in 0..5 {
        assert_eq!(tracker.feed(&plant.next()).unwrap().lyapunov, None);
    }
    let summary = tracker.summarise();
    assert_eq!((summary.bound.checked, summary.bound.law.clone()), (0, None));
    assert_eq!(crate::verdict::judge_summary(&summary).status, "not certified");
}

#[test]
fn a_monitor_that_joins_late_checks_the_promise_from_its_second_tick_on() {
    let scenario = Scenario::default();
    let mut tracker = judged_tracker(&scenario);
    let mut plant = Loop::new(&scenario, LawKind::Robust);
    for _ in 0..500 {
        plant.next();
    }
    let rows: Vec<_> = (0..3).map(|_| tracker.feed(&plant.next()).unwrap()).collect();
    assert_eq!(rows[0].lyapunov_bound, None);
    assert!(rows[1].lyapunov.unwrap() <= rows[1].lyapunov_bound.unwrap());
    assert_eq!(tracker.summarise().bound.checked, 3);
}
