use super::*;

const PERIOD_NS: u64 = 1_000_000;

fn fallback_of(settings: &[&str]) -> Fallback<3> {
    let settings: Vec<String> = settings.iter().map(ToString::to_string).collect();
    Fallback::new(&Scenario::default().with_sets(&settings).unwrap()).unwrap()
}

fn unanswered(fallback: &mut Fallback<3>, tick: u64, v: Option<f64>) {
    let record = TickRecord { start_plant_ns: tick * PERIOD_NS, ..TickRecord::zeroed() };
    fallback.unanswered(&record, v, &[1.0; 7]);
}

fn moving() -> (Vector<3>, Vector<3>) {
    (Vector::<3>::new(0.3, -0.2, 0.1), Vector::<3>::new(0.5, 0.0, -0.5))
}

#[test]
fn where_nothing_is_certified_nothing_is_held() {
    let (q, v) = moving();
    let mut fallback = fallback_of(&[]);
    unanswered(&mut fallback, 10, None);
    assert_eq!(fallback.decision(), Decision::Held, "the tick itself could not know");
    let tau = fallback.own_torque(11 * PERIOD_NS, &q, &v).unwrap();
    assert_eq!((fallback.decision(), fallback.take_change()), (Decision::Damped, Some((Decision::Damped, 1))));
    assert!(v.dot(&(tau - fallback.damping.model.gravity(&q))) < 0.0, "beyond gravity it takes energy out");
}

#[test]
fn the_last_torque_is_held_as_long_as_the_certificate_allows_and_not_a_tick_longer() {
    let (q, v) = moving();
    let mut fallback = fallback_of(&[]);
    let small_v = 1e-3 * fallback.certificate.level;
    let limit_ns = hold_limit_s(&fallback.certificate, small_v, 7.0_f64.sqrt()) * 1e9;
    assert!(limit_ns > 0.0, "the paper's case holds for a while");
    unanswered(&mut fallback, 0, Some(small_v));
    let mut ticks = 1;
    while fallback.own_torque(ticks * PERIOD_NS, &q, &v).is_none() {
        // Later ticks don't move the limit: it counts from the first.
        unanswered(&mut fallback, ticks, Some(0.0));
        ticks += 1;
    }
    let held_ns = (ticks * PERIOD_NS) as f64;
    assert!(held_ns <= limit_ns.max(PERIOD_NS as f64), "held {held_ns} ns of {limit_ns}");
    assert!(held_ns + PERIOD_NS as f64 > limit_ns, "held {held_ns} ns of {limit_ns}");
}

#[test]
fn a_chain_that_is_slow_is_stopped_and_each_change_is_told_once() {
    let (q, v) = moving();
    let mut fallback = fallback_of(&[]);
    unanswered(&mut fallback, 0, None);
    assert!(fallback.own_torque(PERIOD_NS, &q, &v).is_some());
    assert_eq!(fallback.take_change(), Some((Decision::Damped, 1)));
    unanswered(&mut fallback, 1, None);
    assert!(fallback.own_torque(2 * PERIOD_NS, &q, &(v * 1e-3)).is_some());
    assert_eq!(fallback.take_change(), Some((Decision::Stopped, 2)));
    assert_eq!(fallback.take_change(), None);
}

#[test]
fn an_answer_ends_the_fallback_and_says_how_long_it_took() {
    let (q, v) = moving();
    let mut fallback = fallback_of(&[]);
    assert_eq!(fallback.answered(), None);
    unanswered(&mut fallback, 0, None);
    unanswered(&mut fallback, 1, None);
    assert!(fallback.own_torque(2 * PERIOD_NS, &q, &v).is_some());
    assert_eq!(fallback.answered(), Some(2));
    assert_eq!((fallback.own_torque(3 * PERIOD_NS, &q, &v), fallback.decision()), (None, Decision::Held));
}
