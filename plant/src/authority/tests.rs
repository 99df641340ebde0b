use super::members::{READMIT_AFTER, Standing};
use super::*;
use loopbound_shared::sample::{Counters, Happening, torque_flag};

const GRACE_NS: u64 = 500_000;
const PERIOD_NS: u64 = 1_000_000;

fn rules() -> SwapRules {
    SwapRules::of(&loopbound_scenario::Scenario::default())
}

/// Controller 1 active, 2 and 3 its standbys, in this order; tick 1 is open.
fn group() -> Authority {
    let mut authority = Authority::new(2, rules());
    for id in 1..=3 {
        authority.add(id).unwrap();
    }
    authority.appoint(1).unwrap();
    open(&mut authority, 1);
    authority
}

fn open(authority: &mut Authority, tick: u64) {
    authority.open(tick, tick * PERIOD_NS + GRACE_NS);
}

/// The good answer of `writer` to the open tick, published at once: torque `writer` on every link.
fn answer(authority: &Authority, writer: u32) -> Torque {
    let published_ns = authority.tick() * PERIOD_NS;
    let mut torque = Torque {
        tick: authority.tick(),
        state_published_ns: published_ns,
        published_ns,
        writer,
        epoch: authority.active().1,
        links: 2,
        ..Torque::zeroed()
    };
    torque.tau[..2].fill(f64::from(writer));
    torque
}

/// `after_ns` after the state of the open tick.
fn at(authority: &Authority, after_ns: u64) -> u64 {
    authority.tick() * PERIOD_NS + after_ns
}

fn offer(authority: &mut Authority, torque: &Torque, after_ns: u64) -> Option<Applied> {
    let arrived_ns = at(authority, after_ns);
    authority.offer(torque, arrived_ns)
}

fn acceptance_of(authority: &Authority, writer: u32) -> Option<Acceptance> {
    let (receipts, used) = authority.receipts();
    receipts[..used].iter().find(|r| r.writer == writer).and_then(|r| Acceptance::from_code(r.acceptance))
}

fn happened(authority: &mut Authority, kind: HappeningKind) -> Option<Happening> {
    let (happenings, used) = authority.journal.take_happenings();
    happenings[..used].iter().find(|h| h.kind == kind.code()).copied()
}

#[test]
fn the_active_ones_torque_acts_from_its_arrival_and_a_standbys_is_kept() {
    let mut group = group();
    let (standby, active) = (answer(&group, 2), answer(&group, 1));
    assert_eq!(offer(&mut group, &standby, 10), None);
    let applied = offer(&mut group, &active, 20).unwrap();
    assert_eq!((applied.writer, applied.from_ns, applied.epoch), (1, PERIOD_NS + 20, 1));
    assert_eq!(applied.tau[..3], [1.0, 1.0, 0.0]);
    assert_eq!(group.decision(), Some(Decision::Active));
    assert_eq!(acceptance_of(&group, 1), Some(Acceptance::Applied));
    assert_eq!(acceptance_of(&group, 2), Some(Acceptance::Standby));
    assert_eq!(happened(&mut group, HappeningKind::FirstTorque).map(|h| h.subject), Some(1));
}

#[test]
fn each_bad_torque_has_its_own_counter_and_never_acts() {
    let mut group = group();
    let good = answer(&group, 2);
    let bad = [
        Torque { writer: 9, ..good },
        Torque { tick: 7, ..good },
        Torque { links: 3, ..good },
        Torque { writer: 3, tau: [f64::NAN; 7], ..good },
    ];
    for torque in &bad {
        assert_eq!(offer(&mut group, torque, 10), None);
    }
    assert_eq!(offer(&mut group, &good, 11), None, "the malformed one was its answer for this tick");
    let mut counters = Counters::zeroed();
    (counters.unknown_writer, counters.stale, counters.malformed) = (1, 1, 1);
    (counters.not_finite, counters.duplicate) = (1, 1);
    assert_eq!(group.journal.counters, counters);
    assert_eq!(group.decision(), None);
    assert_eq!(acceptance_of(&group, 9), Some(Acceptance::UnknownWriter));
}

#[test]
fn a_second_torque_of_one_writer_is_a_duplicate_and_leaves_the_first_as_it_is() {
    let mut group = group();
    let first = answer(&group, 1);
    let second = Torque { tau: [50.0; 7], ..first };
    assert!(offer(&mut group, &first, 10).is_some());
    assert_eq!(offer(&mut group, &second, 20), None);
    assert_eq!((group.journal.counters.duplicate, acceptance_of(&group, 1)), (1, Some(Acceptance::Applied)));
}

#[test]
fn a_missing_torque_is_replaced_by_the_first_standbys_at_the_grace_deadline() {
    let mut group = group();
    for writer in [3, 2] {
        let torque = answer(&group, writer);
        offer(&mut group, &torque, 10);
    }
    let deadline_ns = at(&group, GRACE_NS);
    let applied = group.grace_passed(deadline_ns).unwrap();
    assert_eq!((applied.writer, applied.epoch, group.active()), (2, 2, (2, 2)));
    assert_eq!(group.decision(), Some(Decision::Standby));
    assert_eq!((group.journal.counters.missed, group.journal.counters.failovers), (0, 1));
    let failover = happened(&mut group, HappeningKind::Failover).unwrap();
    assert_eq!((failover.subject, failover.detail), (2, 1));
    assert_eq!(group.grace_passed(deadline_ns), None, "the deadline passes once a tick");
}

#[test]
fn a_torque_that_is_visibly_no_good_hands_over_before_the_deadline() {
    let spoil: [fn(&mut Torque); 3] = [
        |torque| torque.tau[1] = f64::INFINITY,
        |torque| torque.flags = torque_flag::WITHHELD,
        |torque| torque.links = 7,
    ];
    for spoil in spoil {
        for standby_first in [true, false] {
            let mut group = group();
            let (mut bad, standby) = (answer(&group, 1), answer(&group, 2));
            spoil(&mut bad);
            let order = if standby_first { [standby, bad] } else { [bad, standby] };
            assert_eq!(offer(&mut group, &order[0], 10), None);
            let applied = offer(&mut group, &order[1], 20).unwrap();
            assert_eq!((applied.writer, applied.from_ns), (2, PERIOD_NS + 20));
            assert_eq!((group.journal.counters.failovers, group.journal.counters.missed), (1, 0));
        }
    }
}

#[test]
fn a_removed_active_controller_is_replaced_by_the_next_standbys_answer_at_once() {
    let mut group = group();
    group.remove(1).unwrap();
    let standby = answer(&group, 3);
    assert_eq!(offer(&mut group, &standby, 10).map(|applied| applied.writer), Some(3));
    assert_eq!(group.remove(1), Err(Refusal::UnknownController));
}

#[test]
fn a_late_torque_acts_from_its_arrival_when_nobody_else_answers_and_the_tick_is_missed() {
    let mut group = group();
    let late = answer(&group, 1);
    let applied = offer(&mut group, &late, GRACE_NS + 7).unwrap();
    assert_eq!(applied.from_ns, PERIOD_NS + GRACE_NS + 7);
    assert_eq!(group.decision(), Some(Decision::ActiveLate));
    // The loop had not yet said that the deadline had passed; the tick counts as missed nevertheless, and once.
    let after_ns = at(&group, GRACE_NS + 8);
    assert_eq!(group.grace_passed(after_ns), None);
    assert_eq!((group.journal.counters.missed, group.journal.counters.late), (1, 1));
}

#[test]
fn a_late_torque_never_acts_when_a_standby_had_answered() {
    let mut group = group();
    let (standby, late) = (answer(&group, 2), answer(&group, 1));
    offer(&mut group, &standby, 10);
    let applied = offer(&mut group, &late, GRACE_NS + 1).unwrap();
    assert_eq!((applied.writer, group.decision()), (2, Some(Decision::Standby)));
    assert_eq!((group.journal.counters.fenced, group.journal.counters.missed), (1, 0));
}

#[test]
fn a_standby_that_answers_after_the_deadline_still_saves_the_tick_but_not_its_count() {
    let mut group = group();
    let deadline_ns = at(&group, GRACE_NS);
    assert_eq!(group.grace_passed(deadline_ns), None);
    let late = Torque { published_ns: at(&group, GRACE_NS + 5), ..answer(&group, 2) };
    assert_eq!(offer(&mut group, &late, GRACE_NS + 10).map(|applied| applied.writer), Some(2));
    assert_eq!((group.journal.counters.missed, acceptance_of(&group, 2)), (1, Some(Acceptance::LateUnused)));
}

#[test]
fn a_standbys_own_stamp_shows_that_it_was_in_time_unless_the_stamp_is_impossible() {
    for (published_after_ns, expected) in [(GRACE_NS, Acceptance::Standby), (GRACE_NS + 1, Acceptance::LateUnused)] {
        let mut group = group();
        let active = answer(&group, 1);
        offer(&mut group, &active, 10);
        let read_late = Torque { published_ns: at(&group, published_after_ns), ..answer(&group, 2) };
        offer(&mut group, &read_late, GRACE_NS + 50);
        assert_eq!(acceptance_of(&group, 2), Some(expected));
    }
    let mut group = group();
    let active = answer(&group, 1);
    offer(&mut group, &active, 10);
    // Its clock says that it answered before it was asked.
    let jumped = Torque { published_ns: at(&group, 0) - 1, ..answer(&group, 2) };
    offer(&mut group, &jumped, GRACE_NS + 50);
    assert_eq!(acceptance_of(&group, 2), Some(Acceptance::LateUnused));
}

#[test]
fn a_fenced_controller_is_a_standby_again_after_twenty_good_answers_in_the_new_epoch() {
    let mut group = group();
    let standby = answer(&group, 2);
    offer(&mut group, &standby, 10);
    let deadline_ns = at(&group, GRACE_NS);
    group.grace_passed(deadline_ns);
    let mut good = 0;
    for tick in 2..60 {
        open(&mut group, tick);
        let active = answer(&group, 2);
        assert!(offer(&mut group, &active, 10).is_some());
        let mut back = answer(&group, 1);
        // It has not yet heard of the new epoch in the first ticks, and is silent once in the middle.
        if tick < 5 {
            back.epoch = 1;
        }
        if tick != 10 {
            offer(&mut group, &back, 20);
        }
        good = if tick < 5 || tick == 10 { 0 } else { good + 1 };
        let expected =
            if good < READMIT_AFTER && tick < 30 { Standing::Fenced { since_epoch: 2 } } else { Standing::Standby };
        assert_eq!(group.members.get(1).unwrap().standing, expected, "tick {tick}");
    }
    // 2..=29 but for the silent tick 10.
    assert_eq!(group.journal.counters.fenced, 27);
    open(&mut group, 60);
    let back = answer(&group, 1);
    offer(&mut group, &back, 10);
    let deadline_ns = at(&group, GRACE_NS);
    assert_eq!(group.grace_passed(deadline_ns).map(|applied| applied.writer), Some(1), "it takes over when needed");
}

#[test]
fn a_fenced_controllers_torque_is_out_of_reach_of_a_failover() {
    let mut group = group();
    group.remove(3).unwrap();
    let standby = answer(&group, 2);
    offer(&mut group, &standby, 10);
    let deadline_ns = at(&group, GRACE_NS);
    group.grace_passed(deadline_ns);
    open(&mut group, 2);
    let fenced = answer(&group, 1);
    offer(&mut group, &fenced, 10);
    let deadline_ns = at(&group, GRACE_NS);
    assert_eq!(group.grace_passed(deadline_ns), None);
    assert_eq!((group.journal.counters.missed, group.journal.counters.fenced, group.active().0), (1, 1, 2));
}

#[test]
fn a_streak_breaks_with_a_missing_a_late_and_a_bad_answer() {
    let breaks: [fn(&mut Authority, Torque); 3] = [
        |_, _| {},
        |group, torque| {
            let late = Torque { published_ns: at(group, GRACE_NS + 1), ..torque };
            offer(group, &late, GRACE_NS + 2);
        },
        |group, torque| {
            offer(group, &Torque { tau: [f64::NAN; 7], ..torque }, 10);
        },
    ];
    for break_it in breaks {
        let mut group = group();
        for tick in 2..6 {
            open(&mut group, tick);
            let torque = answer(&group, 2);
            if tick == 4 {
                break_it(&mut group, torque);
            } else {
                offer(&mut group, &torque, 10);
            }
        }
        assert_eq!(group.members.get(2).unwrap().streak, 1, "tick 5 alone");
    }
}

#[test]
fn a_torque_after_the_cut_off_is_counted_and_never_acts() {
    let mut group = group();
    let (old, active) = (answer(&group, 1), answer(&group, 1));
    offer(&mut group, &active, 10);
    // A standby's good answer that nobody had looked at keeps its streak.
    let unread = answer(&group, 2);
    group.too_late(&unread, 20);
    assert_eq!((acceptance_of(&group, 2), group.journal.counters.stale), (Some(Acceptance::Standby), 0));
    open(&mut group, 2);
    group.too_late(&old, 2 * PERIOD_NS);
    assert_eq!((group.journal.counters.stale, group.decision()), (1, None));
}

#[test]
fn the_receipt_of_one_that_answers_late_says_so_whether_or_not_it_answers_this_tick_too() {
    let late = torque_flag::CAME_LATE | torque_flag::CAME_LATE_INJECTED;
    let receipt = |group: &Authority| *group.receipts().0.iter().find(|r| r.writer == 1).expect("it was heard");
    for order in 0..3 {
        let mut group = group();
        let old = Torque { flags: torque_flag::FAULT_INJECTED, ..answer(&group, 1) };
        open(&mut group, 2);
        let now = answer(&group, 1);
        if order == 1 {
            offer(&mut group, &now, 10);
        }
        offer(&mut group, &old, 20);
        let only_old = (receipt(&group).acceptance, receipt(&group).flags & late);
        if order == 0 {
            assert_eq!(only_old, (Acceptance::Stale.code(), late));
            continue;
        }
        if order == 2 {
            offer(&mut group, &now, 30);
        }
        let receipt = receipt(&group);
        assert_eq!((receipt.acceptance, receipt.flags & late), (Acceptance::Applied.code(), late), "order {order}");
        assert_eq!((group.journal.counters.stale, group.decision()), (1, Some(Decision::Active)));
    }
    // A stranger's answer to an earlier tick takes nobody's place.
    let mut group = group();
    let strange = Torque { writer: 99, ..answer(&group, 1) };
    open(&mut group, 2);
    group.too_late(&strange, 2 * PERIOD_NS);
    assert_eq!((group.receipts().1, group.journal.counters.stale), (0, 1));
}

#[test]
fn there_is_room_for_eight_members_and_none_has_number_zero() {
    let mut group = Authority::new(1, rules());
    assert_eq!(group.add(0), Err(Refusal::BadCommand));
    for id in 1..=8 {
        assert_eq!(group.add(id), Ok(()));
    }
    assert_eq!(group.add(9), Err(Refusal::Busy));
    assert_eq!(group.add(8), Ok(()), "it is one already");
    assert_eq!(group.appoint(9), Err(Refusal::UnknownController));
    group.remove(4).unwrap();
    assert_eq!(group.add(9), Ok(()));
    assert_eq!(group.member_ids().count(), 8);
}

#[test]
fn decisions_of_the_plants_own_are_counted_by_their_step() {
    let mut group = group();
    for decision in [Decision::Held, Decision::Damped, Decision::Damped, Decision::Stopped, Decision::Active] {
        group.journal.count_decision(decision);
    }
    let Counters { ticks, held, damped, stopped, .. } = group.journal.counters;
    assert_eq!((ticks, held, damped, stopped), (5, 1, 2, 1));
}

#[test]
fn nobody_loses_authority_for_being_late_in_a_tick_that_left_no_time() {
    let mut authority = group();
    let grace_ns = at(&authority, GRACE_NS);
    authority.grace_until(grace_ns, true);
    let from_standby = answer(&authority, 2);
    assert_eq!(offer(&mut authority, &from_standby, 100_000), None);
    let stands_in = authority.grace_passed(grace_ns);
    assert_eq!(stands_in.map(|applied| applied.writer), Some(2));
    assert_eq!(
        (authority.active(), authority.journal.counters.failovers, authority.journal.counters.missed),
        ((1, 1), 0, 0)
    );
    let happening = happened(&mut authority, HappeningKind::StoodIn).unwrap();
    assert_eq!((happening.subject, happening.detail), (2, 1));
    // What it says now is late and not used; its streak is not at an end for that.
    let streak = authority.members.get(1).unwrap().streak;
    let late = answer(&authority, 1);
    assert_eq!(offer(&mut authority, &late, GRACE_NS + 1), None);
    assert_eq!(acceptance_of(&authority, 1), Some(Acceptance::LateUnused));
    open(&mut authority, 2);
    assert_eq!(authority.members.get(1).unwrap().streak, streak);
    // In a tick with its time it is blamed.
    let from_standby = answer(&authority, 2);
    offer(&mut authority, &from_standby, 100_000);
    let grace_ns = at(&authority, GRACE_NS);
    assert_eq!(authority.grace_passed(grace_ns).map(|applied| applied.writer), Some(2));
    assert_eq!((authority.active(), authority.journal.counters.failovers), ((2, 2), 1));
}

#[test]
fn a_bad_answer_costs_authority_even_in_a_tick_that_left_no_time() {
    let mut authority = group();
    let grace_ns = at(&authority, GRACE_NS);
    authority.grace_until(grace_ns, true);
    let from_standby = answer(&authority, 2);
    offer(&mut authority, &from_standby, 100_000);
    let mut bad = answer(&authority, 1);
    bad.tau[0] = f64::NAN;
    assert_eq!(offer(&mut authority, &bad, 100_001).map(|applied| applied.writer), Some(2));
    assert_eq!(authority.active(), (2, 2));
}
