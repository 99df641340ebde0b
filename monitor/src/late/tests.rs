//! Late is not silent, silent is not dead, and what had been stopped is not blamed for what others had not done.

use loopbound_shared::event::HappeningKind;
use loopbound_shared::sample::Happening;

use super::*;
use crate::testing::*;
use crate::tracker::Tracker;

/// Causes of missed ticks by name, zeros left out.
fn missed(records: impl IntoIterator<Item = TickRecord>) -> Vec<(String, u64)> {
    let mut tracker: Tracker<3> = tracker();
    for record in records {
        tracker.feed(&record);
    }
    tracker.finish();
    tracker.summarise().missed_ticks_by_cause.into_iter().filter(|(_, count)| *count > 0).collect()
}

fn of(name: &str, count: u64) -> Vec<(String, u64)> {
    vec![(name.to_owned(), count)]
}

/// A tick without a torque in which an answer to an earlier one came.
fn answered_late(tick: u64, injected: bool) -> TickRecord {
    let mut record = unanswered(tick);
    let injected = if injected { torque_flag::FAULT_INJECTED | torque_flag::CAME_LATE_INJECTED } else { 0 };
    record.receipts[0].arrived_ns = record.published_ns + 100_000;
    record.receipts[0].acceptance = Acceptance::Stale.code();
    record.receipts[0].flags = torque_flag::CAME_LATE | injected;
    record
}

/// The plant went on with `tick` after it had skipped `skipped` ticks, and setpoints had run out meanwhile.
fn resumed(tick: u64, skipped: u64) -> TickRecord {
    let mut record = good(tick);
    record.skipped_before = skipped;
    record.flags |= record_flag::SETPOINT_STALE;
    record
}

fn with(mut record: TickRecord, flag: u32) -> TickRecord {
    record.flags |= flag;
    record
}

fn removed(mut record: TickRecord) -> TickRecord {
    record.happenings[0] = Happening { kind: HappeningKind::MemberRemoved.code(), subject: 1, ..Happening::zeroed() };
    record.happenings_used = 1;
    record
}

#[test]
fn a_controller_that_answers_every_tick_too_late_is_late_for_as_long_as_it_does() {
    let late = |injected: bool| (6..66).map(move |tick| answered_late(tick, injected));
    let around =
        |injected: bool| [good(4), unanswered(5)].into_iter().chain(late(injected)).chain([good(66), good(67)]);
    assert_eq!(missed(around(false)), of("controller_late", 61));
    assert_eq!(missed(around(true)), of("injected_fault", 61));
}

#[test]
fn the_answer_to_a_missed_tick_that_comes_beside_the_next_one_says_that_a_fault_was_injected() {
    let mut next = good(6);
    next.receipts[0].flags |= torque_flag::CAME_LATE | torque_flag::CAME_LATE_INJECTED;
    assert_eq!(missed([good(4), unanswered(5), next, good(7)]), of("injected_fault", 1));
}

#[test]
fn a_controller_is_dead_once_it_is_known_to_have_ended_and_silent_until_then() {
    let silent = || (5..25).map(unanswered);
    assert_eq!(missed([good(4)].into_iter().chain(silent())), of("controller_silent", 20));
    // Its end is noticed some ticks after the last answer; all of them are its death.
    let noticed = || (5..25).map(|tick| if tick == 9 { removed(unanswered(tick)) } else { unanswered(tick) });
    assert_eq!(missed([good(4)].into_iter().chain(noticed())), of("controller_dead", 20));
}

#[test]
fn setpoints_that_ran_out_while_everybody_stood_are_no_cause() {
    let after = |first: u64| (first..first + 5).map(|tick| with(good(tick), record_flag::SETPOINT_STALE));
    let all = [good(4), resumed(305, 300)].into_iter().chain(after(306)).chain([good(311), good(312)]);
    assert_eq!(missed(all), of("timer_or_host", 300));
    // Neither is the controller silent that had not been asked, nor the tick in which all of them were stopped its fault.
    let stood = [good(3), unanswered(4), resumed(305, 300), good(306), good(307)];
    assert_eq!(missed(stood), of("timer_or_host", 301));
    let unready = [good(4), with(unanswered(305), record_flag::SETPOINT_STALE)];
    let unready = unready.map(|mut record| {
        record.skipped_before = if record.tick == 305 { 300 } else { 0 };
        record
    });
    let found = missed(unready.into_iter().chain([good(306), good(307)]));
    assert_eq!(found, [("controller_late".to_owned(), 1), ("timer_or_host".to_owned(), 300)]);
}

#[test]
fn setpoints_that_ran_out_in_a_running_group_are_the_cause_of_what_the_controller_misses() {
    let stale = |tick: u64| with(unanswered(tick), record_flag::SETPOINT_STALE);
    assert_eq!(missed([good(4), stale(5), good(6), good(7)]), of("setpoint_stale", 1));
    // They had run out before, so the plant's own sleep is none of theirs; what follows is.
    let mut slept = with(good(30), record_flag::SETPOINT_STALE);
    slept.skipped_before = 3;
    let before = (5..27).map(|tick| with(good(tick), record_flag::SETPOINT_STALE));
    let found = missed(before.chain([slept, stale(31), good(32), good(33)]));
    assert_eq!(found, [("setpoint_stale".to_owned(), 1), ("timer_or_host".to_owned(), 3)]);
}

#[test]
fn ticks_that_the_plant_slept_through_by_a_fault_are_injected_and_those_of_the_host_in_a_controllers_fault_are_not() {
    let mut slept = good(10);
    slept.skipped_before = 5;
    let mut overslept = with(good(4), record_flag::FAULT_INJECTED);
    overslept.published_ns = overslept.deadline_ns + 6 * PERIOD_NS;
    assert_eq!(missed([good(3), overslept, slept, good(11)]).first(), Some(&("injected_fault".to_owned(), 5)));
    let marked = with(good(4), record_flag::FAULT_INJECTED);
    assert_eq!(missed([good(3), marked, with(slept, record_flag::FAULT_INJECTED), good(11)]), of("timer_or_host", 5));
}

/// Causes of missed ticks where a scenario plans these faults.
fn missed_with(faults: &str, records: impl IntoIterator<Item = TickRecord>) -> Vec<(String, u64)> {
    let scenario = loopbound_scenario::Scenario::from_toml(faults, "test").unwrap();
    let mut tracker: Tracker<3> = Tracker::new(Config { planned: Planned::of(&scenario), ..config() }, None);
    for record in records {
        tracker.feed(&record);
    }
    tracker.finish();
    tracker.summarise().missed_ticks_by_cause.into_iter().filter(|(_, count)| *count > 0).collect()
}

#[test]
fn a_silence_that_the_scenario_planned_is_injected_and_what_goes_beyond_it_is_not() {
    let silent = |to: u64| [good(4)].into_iter().chain((5..to).map(unanswered)).chain([good(to), good(to + 1)]);
    let hang = "[[fault]]\nkind = \"hang\"\ntarget = \"controller:1\"\nat = 5\nfor = \"9ms\"\n";
    assert_eq!(missed_with(hang, silent(15)), of("injected_fault", 10));
    assert_eq!(
        missed_with(hang, silent(25)),
        [("controller_silent".to_owned(), 10), ("injected_fault".to_owned(), 10)]
    );
    let drop = "[[fault]]\nkind = \"drop\"\nat = 5\nfor = 10\n";
    assert_eq!(missed_with(drop, silent(15)), of("injected_fault", 10));
    let kill = "[[fault]]\nkind = \"kill\"\nat = 5\n";
    let died = (5..25).map(|tick| if tick == 9 { removed(unanswered(tick)) } else { unanswered(tick) });
    assert_eq!(missed_with(kill, [good(4)].into_iter().chain(died)), of("injected_fault", 20));
    // That of another controller, and one that is answered, excuse nothing.
    for other in [
        "[[fault]]\nkind = \"hang\"\ntarget = \"controller:2\"\nat = 5\nfor = \"9ms\"\n",
        "[[fault]]\nkind = \"delay\"\ndelay = \"20us\"\n",
    ] {
        assert_eq!(missed_with(other, silent(15)), of("controller_silent", 10), "{other}");
    }
}
