use super::*;

const PERIOD_NS: u64 = 1_000_000;

fn ladder(settings: &[&str]) -> Fallback<3> {
    let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
    Fallback::new(&Scenario::default().with_sets(&settings).unwrap()).unwrap()
}

fn unanswered(ladder: &mut Fallback<3>, tick: u64, v: Option<f64>) {
    let record = TickRecord { start_plant_ns: tick * PERIOD_NS, ..TickRecord::zeroed() };
    ladder.unanswered(&record, v, &[1.0; 7]);
}

fn moving() -> (Vector<3>, Vector<3>) {
    (Vector::<3>::new(0.3, -0.2, 0.1), Vector::<3>::new(0.5, 0.0, -0.5))
}

#[test]
fn where_nothing_is_certified_nothing_is_held() {
    let (q, v) = moving();
    let mut ladder = ladder(&[]);
    unanswered(&mut ladder, 10, None);
    assert_eq!(ladder.decision(), Decision::Held, "the tick itself could not know");
    let tau = ladder.brake(11 * PERIOD_NS, &q, &v).unwrap();
    assert_eq!((ladder.decision(), ladder.take_change()), (Decision::Damped, Some((Decision::Damped, 1))));
    assert!(v.dot(&(tau - ladder.brake.model.gravity(&q))) < 0.0, "beyond gravity it takes energy out");
}

#[test]
fn the_last_torque_is_held_as_long_as_the_certificate_allows_and_not_a_tick_longer() {
    let (q, v) = moving();
    let mut ladder = ladder(&[]);
    let small_v = 1e-3 * ladder.certificate.level;
    let limit_ns = hold_limit_s(&ladder.certificate, small_v, 7.0_f64.sqrt()) * 1e9;
    assert!(limit_ns > 0.0, "the paper's case holds for a while");
    unanswered(&mut ladder, 0, Some(small_v));
    let mut ticks = 1;
    while ladder.brake(ticks * PERIOD_NS, &q, &v).is_none() {
        // Later ticks don't move the limit: it counts from the first.
        unanswered(&mut ladder, ticks, Some(0.0));
        ticks += 1;
    }
    let held_ns = (ticks * PERIOD_NS) as f64;
    assert!(held_ns <= limit_ns.max(PERIOD_NS as f64), "held {held_ns} ns of {limit_ns}");
    assert!(held_ns + PERIOD_NS as f64 > limit_ns, "held {held_ns} ns of {limit_ns}");
}

#[test]
fn a_chain_that_is_slow_is_stopped_and_each_change_is_told_once() {
    let (q, v) = moving();
    let mut ladder = ladder(&[]);
    unanswered(&mut ladder, 0, None);
    assert!(ladder.brake(PERIOD_NS, &q, &v).is_some());
    assert_eq!(ladder.take_change(), Some((Decision::Damped, 1)));
    unanswered(&mut ladder, 1, None);
    assert!(ladder.brake(2 * PERIOD_NS, &q, &(v * 1e-3)).is_some());
    assert_eq!(ladder.take_change(), Some((Decision::Stopped, 2)));
    assert_eq!(ladder.take_change(), None);
}

#[test]
fn an_answer_leaves_the_ladder_and_says_how_long_it_took() {
    let (q, v) = moving();
    let mut ladder = ladder(&[]);
    assert_eq!(ladder.answered(), None);
    unanswered(&mut ladder, 0, None);
    unanswered(&mut ladder, 1, None);
    assert!(ladder.brake(2 * PERIOD_NS, &q, &v).is_some());
    assert_eq!(ladder.answered(), Some(2));
    assert_eq!((ladder.brake(3 * PERIOD_NS, &q, &v), ladder.decision()), (None, Decision::Held));
}
