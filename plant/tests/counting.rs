//! Every tick is counted once, as what it was: also by a loop that was kept from running.

use loopbound_plant::{Opening, PlantCore};
use loopbound_scenario::Scenario;
use loopbound_shared::event::{Acceptance, CommandKind, Decision};
use loopbound_shared::sample::{Command, Setpoint, TickRecord, Torque};

const PERIOD_NS: u64 = 1_000_000;
const GRACE_NS: u64 = 500_000;

/// A plant in realtime at its start, with these members, the first in charge.
fn plant(members: u32) -> PlantCore<3> {
    let mut plant = PlantCore::new(&Scenario::default(), true).expect("the paper's plant");
    for id in 1..=members {
        plant.command(&Command { kind: CommandKind::AddMember.code(), controller: id, ..Command::zeroed() });
    }
    plant.authority.appoint(1).expect("a member");
    plant
}

/// Opens a tick on time, with a setpoint.
fn open(plant: &mut PlantCore<3>, tick: u64, skipped: u64) {
    plant.setpoints.enter(&Setpoint { tick, links: 3, ..Setpoint::zeroed() }, 3);
    let deadline_ns = tick * PERIOD_NS;
    let grace_deadline_ns = deadline_ns + GRACE_NS;
    plant.open(Opening {
        tick,
        deadline_ns,
        sampled_ns: deadline_ns,
        grace_deadline_ns,
        skipped,
        wake_late_ns: u64::MAX,
    });
    plant.stamp_published(deadline_ns, grace_deadline_ns, false);
}

fn answer(plant: &mut PlantCore<3>, writer: u32, tick: u64, after_ns: u64) {
    let (_, epoch) = plant.authority.active();
    let published_ns = tick * PERIOD_NS + 1000;
    let torque = Torque { tick, writer, epoch, links: 3, published_ns, ..Torque::zeroed() };
    plant.arrive(&torque, tick * PERIOD_NS + after_ns);
}

fn closed(plant: &mut PlantCore<3>, next: u64) -> TickRecord {
    open(plant, next, 0);
    *plant.closed().expect("a closed tick")
}

#[test]
fn a_late_torque_that_is_found_before_the_clock_is_looked_at_makes_a_missed_tick() {
    let mut plant = plant(1);
    open(&mut plant, 0, 0);
    answer(&mut plant, 1, 0, GRACE_NS + 1);
    plant.grace_passed(GRACE_NS + 2);
    let record = closed(&mut plant, 1);
    assert_eq!(Decision::from_code(record.decision), Some(Decision::ActiveLate));
    assert_eq!((record.counters.missed, record.counters.late), (1, 1));
    assert_eq!(Acceptance::from_code(record.receipts[0].acceptance), Some(Acceptance::Late));
}

#[test]
fn a_standby_in_time_goes_before_an_active_controller_that_is_late() {
    let mut plant = plant(2);
    open(&mut plant, 0, 0);
    answer(&mut plant, 2, 0, 100_000);
    answer(&mut plant, 1, 0, GRACE_NS + 1);
    let record = closed(&mut plant, 1);
    assert_eq!((record.counters.missed, record.counters.failovers), (0, 1));
    assert_eq!(record.active, 2);
}

#[test]
fn a_tick_whose_grace_deadline_passes_twice_is_missed_once() {
    let mut plant = plant(1);
    open(&mut plant, 0, 0);
    // The loop says so at the grace deadline and at the cut-off, and the two may be one instant.
    plant.grace_passed(GRACE_NS);
    plant.grace_passed(GRACE_NS);
    assert_eq!(closed(&mut plant, 1).counters.missed, 1);
}

#[test]
fn ticks_skipped_before_the_first_between_two_and_after_the_last_are_counted() {
    let mut plant = plant(1);
    open(&mut plant, 3, 3);
    answer(&mut plant, 1, 3, 100_000);
    plant.grace_passed(3 * PERIOD_NS + GRACE_NS);
    open(&mut plant, 6, 2);
    answer(&mut plant, 1, 6, 100_000);
    plant.grace_passed(6 * PERIOD_NS + GRACE_NS);
    plant.count_skipped(4);
    let counters = plant.finish(11 * PERIOD_NS).counters;
    assert_eq!((counters.ticks, counters.skipped, counters.overruns), (2, 9, 3));
    assert_eq!(counters.missed, 9, "what is skipped is missed");
}
