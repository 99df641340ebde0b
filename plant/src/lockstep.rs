//! The plant's loop on virtual time: t_k = k h. Each tick waits for an answer of every member, and for the setpoint of
//! the very tick; no timeout decides anything, so every run decides alike.

use std::sync::atomic::Ordering;

use loopbound_scenario::Scenario;
use loopbound_shared::clock;
use loopbound_shared::doorbell::Bell;
use loopbound_shared::fault::ROGUE_WRITER;
use loopbound_shared::role;
use loopbound_shared::sample::{RECEIPTS_MAX, State, Torque, torque_flag};

use crate::core::{Opening, PlantCore};
use crate::ports::{Orders, Ports};

/// How long to spin for torques before sleeping at the doorbell.
const SPIN_NS: u64 = 20_000;
/// How often to look for commands and for the stop flag while nothing comes.
const LOOK_NS: u64 = 5_000_000;
/// The reference and the monitor are woken once in so many ticks.
const PACE_TICKS: u64 = 256;

pub(crate) fn run<const N: usize>(core: &mut PlantCore<N>, ports: &Ports, stopped: &dyn Fn() -> bool) {
    let mut orders = Orders::default();
    while !orders.start {
        if stopped() {
            return;
        }
        ports.update_connections();
        ports.serve(core, &mut orders);
        clock::sleep_until_ns(clock::now_ns() + 200_000);
    }
    let mut tick = 0;
    while orders.stop_at.is_none_or(|stop| tick < stop) {
        if !one_tick(core, ports, tick, &mut orders, stopped) {
            return;
        }
        tick += 1;
    }
    let end_ns = tick * ports.joined.scenario.period_ns();
    core.finish(end_ns);
    publish_closed(core, ports);
}

/// One tick; false if the group was stopped meanwhile.
fn one_tick<const N: usize>(
    core: &mut PlantCore<N>,
    ports: &Ports,
    tick: u64,
    orders: &mut Orders,
    stopped: &dyn Fn() -> bool,
) -> bool {
    let (block, scenario) = (&ports.joined.block, &ports.joined.scenario);
    let pace = block.pace();
    pace.plant_tick.store(tick, Ordering::Release);
    if tick.is_multiple_of(PACE_TICKS) {
        block.ring(Bell::Pace);
        ports.update_connections();
    }
    if ports.faults.at_tick(tick).kill {
        role::kill_self();
    }
    // Credit: the launcher's monitor has room for the record of this tick.
    while !(core.setpoints.has(tick) && pace.credit.load(Ordering::Acquire) > tick) {
        if stopped() {
            return false;
        }
        block.wait(Bell::Pace, clock::now_ns() + LOOK_NS, || {
            ports.drain_setpoints(core);
            (core.setpoints.has(tick) && pace.credit.load(Ordering::Acquire) > tick).then_some(())
        });
        ports.serve(core, orders);
        ports.update_connections();
    }
    let state = open(core, tick, scenario);
    ports.states.send(state);
    // In lockstep everyone waits at the doorbell, whatever the mode.
    block.ring(Bell::State);
    publish_closed(core, ports);
    if !gather(core, ports, tick, orders, stopped) {
        return false;
    }
    // A command changes membership at a tick: between two of them.
    if tick.is_multiple_of(PACE_TICKS) {
        ports.serve(core, orders);
    }
    true
}

fn publish_closed<const N: usize>(core: &PlantCore<N>, ports: &Ports) {
    if let Some(record) = core.closed() {
        ports.records.send(*record);
    }
}

/// Waits for the answer of every member, then judges them in the order of their virtual arrival.
fn gather<const N: usize>(
    core: &mut PlantCore<N>,
    ports: &Ports,
    tick: u64,
    orders: &mut Orders,
    stopped: &dyn Fn() -> bool,
) -> bool {
    let block = &ports.joined.block;
    let mut answers = Answers::new();
    loop {
        let complete = ports.torque_bell.wait_lockstep(block, clock::now_ns() + LOOK_NS, SPIN_NS, || {
            while let Some(torque) = ports.torques.take() {
                answers.note(&torque, core, tick);
            }
            answers.are_complete(core.authority.member_ids(), tick).then_some(())
        });
        if complete.is_some() {
            break;
        }
        if stopped() {
            return false;
        }
        // The supervisor says who is dead; until then the tick waits.
        ports.serve(core, orders);
        ports.update_connections();
    }
    ports.count_strangers(core);
    judge(core, answers.as_mut_slice(), tick, &ports.joined.scenario);
    true
}

/// Opens a tick at its virtual instant t_k = k h; the state to be published.
pub fn open<const N: usize>(core: &mut PlantCore<N>, tick: u64, scenario: &Scenario) -> State {
    let t_k_ns = tick * scenario.period_ns();
    let grace_deadline_ns = t_k_ns + scenario.loop_.grace_ns();
    let mut state = core.open(Opening {
        tick,
        deadline_ns: t_k_ns,
        sampled_ns: t_k_ns,
        grace_deadline_ns,
        skipped: 0,
        wake_late_ns: u64::MAX,
    });
    state.published_ns = t_k_ns;
    core.stamp_published(t_k_ns, grace_deadline_ns, false);
    state
}

/// Applies the answers of a tick in the order of their virtual arrival, as the realtime loop would see them.
pub fn judge<const N: usize>(core: &mut PlantCore<N>, answers: &mut [Torque], tick: u64, scenario: &Scenario) {
    let t_k_ns = tick * scenario.period_ns();
    let (grace_ns, cutoff_ns) =
        (t_k_ns + scenario.loop_.grace_ns(), t_k_ns + scenario.period_ns() - scenario.loop_.lead_ns());
    answers.sort_unstable_by_key(|torque| (torque.tick != tick, torque.virtual_delay_ns, torque.writer));
    let mut grace_passed = false;
    for torque in answers {
        let arrives_ns = t_k_ns + torque.virtual_delay_ns;
        if arrives_ns > grace_ns && !grace_passed {
            core.grace_passed(grace_ns);
            grace_passed = true;
        }
        if arrives_ns > cutoff_ns {
            // By then the realtime loop is in the next tick.
            core.authority.came_late(torque, arrives_ns);
        } else {
            core.arrive(torque, arrives_ns);
            suffer_injected(core, torque, arrives_ns);
        }
    }
    if !grace_passed {
        core.grace_passed(grace_ns);
    }
}

/// What in realtime are further samples: here the torque itself says that they come, so that no two runs differ.
fn suffer_injected<const N: usize>(core: &mut PlantCore<N>, torque: &Torque, arrives_ns: u64) {
    if torque.flags & torque_flag::TWICE != 0 {
        core.arrive(torque, arrives_ns);
    }
    if torque.flags & torque_flag::AFTER_ITS_TIME != 0 {
        core.authority.count_stale();
    }
    if torque.flags & torque_flag::ROGUE != 0 {
        core.arrive(&Torque { writer: ROGUE_WRITER, flags: 0, ..*torque }, arrives_ns);
    }
}

/// The torques that came in one tick. Each member has room for its answer, whatever else comes: what is no member's first
/// answer to this tick makes way for one, and is counted all the same.
struct Answers {
    torques: [Torque; ANSWERS_MAX],
    used: usize,
}

/// More than all members: what comes besides is judged too, up to here.
const ANSWERS_MAX: usize = 2 * RECEIPTS_MAX;

impl Answers {
    fn new() -> Self {
        Self { torques: [Torque::zeroed(); ANSWERS_MAX], used: 0 }
    }

    fn note<const N: usize>(&mut self, torque: &Torque, core: &mut PlantCore<N>, tick: u64) {
        if self.used < ANSWERS_MAX {
            self.torques[self.used] = *torque;
            self.used += 1;
            return;
        }
        let is_awaited = |torque: &Torque, before: &[Torque]| {
            let answered = before.iter().any(|t| t.writer == torque.writer && t.tick == tick);
            torque.tick == tick && !answered && core.authority.member_ids().any(|id| id == torque.writer)
        };
        let in_the_way = (0..self.used).rev().find(|&at| !is_awaited(&self.torques[at], &self.torques[..at]));
        let unheard = match in_the_way.filter(|_| is_awaited(torque, &self.torques)) {
            Some(at) => std::mem::replace(&mut self.torques[at], *torque),
            None => *torque,
        };
        core.authority.count_unheard(&unheard, tick);
    }

    fn are_complete(&self, mut members: impl Iterator<Item = u32>, tick: u64) -> bool {
        let answers = &self.torques[..self.used];
        members.all(|id| answers.iter().any(|torque| torque.writer == id && torque.tick == tick))
    }

    fn as_mut_slice(&mut self) -> &mut [Torque] {
        &mut self.torques[..self.used]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_shared::event::CommandKind;
    use loopbound_shared::sample::Command;

    const TICK: u64 = 5;

    fn torque(writer: u32, tick: u64) -> Torque {
        Torque { writer, tick, links: 3, ..Torque::zeroed() }
    }

    /// A plant with eight members, as many as there can be.
    fn full_plant() -> PlantCore<3> {
        let mut core = PlantCore::new(&Scenario::default(), false).unwrap();
        for id in 1..=8 {
            core.command(&Command { kind: CommandKind::AddMember.code(), controller: id, ..Command::zeroed() });
        }
        core
    }

    #[test]
    fn whatever_comes_before_them_and_however_much_every_member_is_heard() {
        for first in [torque(99, TICK), torque(1, TICK), torque(1, TICK - 1)] {
            let (mut core, mut answers) = (full_plant(), Answers::new());
            for _ in 0..1000 {
                answers.note(&first, &mut core, TICK);
            }
            for id in 1..=8 {
                assert!(!answers.are_complete(core.authority.member_ids(), TICK), "before {id}");
                answers.note(&torque(id, TICK), &mut core, TICK);
                answers.note(&first, &mut core, TICK);
            }
            assert!(answers.are_complete(core.authority.member_ids(), TICK));
            let counters = &core.authority.counters;
            let counted = counters.unknown_writer + counters.duplicate + counters.stale;
            assert_eq!(counted + answers.used as u64, 1000 + 16, "nothing goes uncounted: {counters:?}");
        }
    }

    #[test]
    fn an_answer_to_another_tick_does_not_stand_for_the_one_that_is_waited_for() {
        let (mut core, mut answers) = (full_plant(), Answers::new());
        (1..=8).for_each(|id| answers.note(&torque(id, TICK - u64::from(id == 3)), &mut core, TICK));
        assert!(!answers.are_complete(core.authority.member_ids(), TICK));
        answers.note(&torque(3, TICK), &mut core, TICK);
        assert!(answers.are_complete(core.authority.member_ids(), TICK));
    }
}
