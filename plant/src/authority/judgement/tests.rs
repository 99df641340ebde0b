use super::*;

const GRACE_NS: u64 = 500;
const LINKS: u32 = 2;
const OPEN: OpenTick = OpenTick { tick: 7, grace_ns: GRACE_NS, squeezed: false, grace_passed: false, decision: None };
const PASSED: OpenTick = OpenTick { grace_passed: true, ..OPEN };

/// A good answer to the open tick, published in time: torque `writer` on the first link.
fn answer(writer: u32) -> Torque {
    let mut torque = Torque { tick: 7, writer, epoch: 1, links: LINKS, published_ns: 100, ..Torque::zeroed() };
    torque.tau[0] = f64::from(writer);
    torque
}

/// Members 1 (active), 2 and 3, who have answered like this.
fn members(answers: [Option<Quality>; 3]) -> Members {
    let mut members = Members::new();
    (1..=3).for_each(|id| assert_eq!(members.add(id), Ok(true)));
    members.hand_over(1, None);
    for (writer, quality) in (1..).zip(answers) {
        if let Some(quality) = quality {
            members.note(&answer(writer), Accepted { acceptance: Acceptance::None, quality }, false);
        }
    }
    members
}

fn taken(torque: &Torque, arrived_ns: u64, member: &Member, open: &OpenTick) -> (Acceptance, Quality) {
    let Accepted { acceptance, quality } = accept(torque, arrived_ns, Some(member), open, LINKS);
    (acceptance, quality)
}

#[test]
fn every_torque_is_taken_as_one_thing_and_the_first_that_is_wrong_names_it() {
    let active = Member { standing: Standing::Active, ..Member::standby(1) };
    let good = answer(1);
    let mut not_finite = good;
    not_finite.tau[6] = f64::NAN;
    let withheld = Torque { flags: torque_flag::WITHHELD, links: 9, ..not_finite };
    for (torque, expected) in [
        (good, (Acceptance::Applied, Quality::OnTime)),
        (Torque { tick: 6, ..withheld }, (Acceptance::Stale, Quality::NoAnswer)),
        (withheld, (Acceptance::Withheld, Quality::Bad)),
        (Torque { links: 9, ..not_finite }, (Acceptance::Malformed, Quality::Bad)),
        (not_finite, (Acceptance::NotFinite, Quality::Bad)),
    ] {
        assert_eq!(taken(&torque, 200, &active, &OPEN), expected);
    }
    assert_eq!(accept(&good, 200, None, &OPEN, LINKS).acceptance, Acceptance::UnknownWriter);
    let heard = Member { heard: true, ..active };
    assert_eq!(taken(&good, 200, &heard, &OPEN), (Acceptance::Duplicate, Quality::NoAnswer));
}

#[test]
fn lateness_counts_from_the_arrival_for_the_active_one_and_from_a_possible_stamp_for_standbys() {
    let active = Member { standing: Standing::Active, ..Member::standby(1) };
    let standby = Member::standby(2);
    assert_eq!(taken(&answer(1), GRACE_NS, &active, &OPEN), (Acceptance::Applied, Quality::OnTime));
    assert_eq!(taken(&answer(1), GRACE_NS + 1, &active, &OPEN), (Acceptance::Late, Quality::Late));
    assert_eq!(taken(&answer(2), GRACE_NS + 1, &standby, &OPEN), (Acceptance::Standby, Quality::OnTime));
    let impossible = Torque { state_published_ns: 101, ..answer(2) };
    assert_eq!(taken(&impossible, GRACE_NS + 1, &standby, &OPEN), (Acceptance::LateUnused, Quality::Late));
    let settled = OpenTick { decision: Some(Decision::Standby), ..OPEN };
    assert_eq!(taken(&answer(1), GRACE_NS + 1, &active, &settled), (Acceptance::LateUnused, Quality::Late));
}

#[test]
fn a_fenced_member_is_judged_by_the_epoch_it_has_heard_of() {
    let fenced = Member { standing: Standing::Fenced { since_epoch: 2 }, streak: 19, ..Member::standby(1) };
    assert_eq!(taken(&answer(1), 200, &fenced, &OPEN), (Acceptance::Fenced, Quality::Bad));
    let informed = Torque { epoch: 2, ..answer(1) };
    assert_eq!(taken(&informed, 200, &fenced, &OPEN), (Acceptance::Standby, Quality::OnTime), "the twentieth");
    let earlier = Member { streak: 18, ..fenced };
    assert_eq!(taken(&informed, 200, &earlier, &OPEN), (Acceptance::Fenced, Quality::OnTime));
}

/// Whose torque acts, under which decision, and what becomes of its writer.
fn decided(members: &Members, open: &OpenTick, on_probation: bool) -> Option<(u32, Decision, Option<Replacement>)> {
    let judgement = decide(members, open, None, on_probation)?;
    Some((judgement.torque.writer, judgement.decision, judgement.replacement))
}

#[test]
fn all_that_three_members_can_answer_comes_to_the_decision_of_the_table() {
    use Quality::{Bad, Late, OnTime};
    use Replacement::{StandsIn, TakesOver};
    let all = [None, Some(Bad), Some(Late), Some(OnTime)];
    let cases = all.into_iter().flat_map(|a| all.into_iter().flat_map(move |b| all.map(|c| [a, b, c])));
    for (answers, open, squeezed, on_probation) in cases.flat_map(|answers| {
        [OPEN, PASSED].into_iter().flat_map(move |open| {
            [(false, false), (true, false), (false, true)].map(|(squeezed, watched)| (answers, open, squeezed, watched))
        })
    }) {
        let open = OpenTick { squeezed, ..open };
        let standby = (2..).zip(&answers[1..]).find(|(_, a)| matches!(a, Some(Late | OnTime))).map(|(id, _)| id);
        let by_standby = |replacement| standby.map(|id| (id, Decision::Standby, Some(replacement)));
        let expected = match answers[0] {
            Some(OnTime) => Some((1, Decision::Active, None)),
            Some(Late) => Some((1, Decision::ActiveLate, None)),
            Some(_) => by_standby(TakesOver),
            None if !open.grace_passed => None,
            None if squeezed || on_probation => by_standby(StandsIn),
            None => by_standby(TakesOver),
        };
        let members = members(answers);
        assert_eq!(decided(&members, &open, on_probation), expected, "{answers:?} {open:?} {on_probation}");
        let settled = OpenTick { decision: Some(Decision::Active), ..open };
        assert_eq!(decided(&members, &settled, on_probation), None, "a tick is decided once");
    }
}

#[test]
fn a_controller_that_has_left_is_replaced_without_waiting_also_on_probation() {
    let mut members = members([None, None, Some(Quality::OnTime)]);
    members.remove(1).unwrap();
    let expected = Some((3, Decision::Standby, Some(Replacement::TakesOver)));
    assert_eq!(decided(&members, &OPEN, true), expected);
}

#[test]
fn a_cross_fade_waits_for_both_torques_until_the_grace_deadline() {
    use Quality::{Bad, OnTime};
    let fade = Some(Fade { from: 2, weight: 0.75 });
    let outcome = |answers, open| {
        let judgement = decide(&members(answers), open, fade, true);
        judgement.map(|j| (j.torque.writer, j.torque.tau[0], j.decision))
    };
    let both = [Some(OnTime), Some(OnTime), None];
    assert_eq!(outcome(both, &OPEN), Some((1, 0.75 * 1.0 + 0.25 * 2.0, Decision::Blend)));
    for old in [None, Some(Bad)] {
        let new_alone = [Some(OnTime), old, None];
        assert_eq!(outcome(new_alone, &OPEN), None);
        assert_eq!(outcome(new_alone, &PASSED), Some((1, 1.0, Decision::Active)));
    }
    assert_eq!(outcome([None, Some(OnTime), None], &OPEN), None);
    let mut left = members(both);
    left.remove(2).unwrap();
    assert_eq!(decide(&left, &OPEN, fade, true).map(|j| j.decision), Some(Decision::Active));
}
