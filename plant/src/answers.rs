//! The torques that came in one tick of lockstep, gathered until every member has answered.

use loopbound_shared::sample::{RECEIPTS_MAX, Torque};

use crate::tick::PlantCore;

/// The torques that came in one tick. Each member has room for its answer, whatever else comes: what is no member's first
/// answer to this tick makes way for one, and is counted all the same.
pub(crate) struct Answers {
    torques: [Torque; ANSWERS_MAX],
    used: usize,
}

/// More than all members: what comes besides is judged too, up to here.
const ANSWERS_MAX: usize = 2 * RECEIPTS_MAX;

impl Answers {
    pub(crate) fn new() -> Self {
        Self { torques: [Torque::zeroed(); ANSWERS_MAX], used: 0 }
    }

    pub(crate) fn note<const N: usize>(&mut self, torque: &Torque, core: &mut PlantCore<N>, tick: u64) {
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

    pub(crate) fn are_complete(&self, mut members: impl Iterator<Item = u32>, tick: u64) -> bool {
        let answers = &self.torques[..self.used];
        members.all(|id| answers.iter().any(|torque| torque.writer == id && torque.tick == tick))
    }

    pub(crate) fn as_mut_slice(&mut self) -> &mut [Torque] {
        &mut self.torques[..self.used]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_scenario::Scenario;
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
            let counters = &core.authority.journal.counters;
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
