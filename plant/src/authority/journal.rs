//! What the plant writes down of its torques: counters since the start, what happened, and a receipt for each writer of
//! the open tick. Allocates nothing; decides nothing.

use loopbound_shared::event::{Acceptance, Decision, HappeningKind};
use loopbound_shared::sample::{
    Counters, HAPPENINGS_MAX, Happening, RECEIPTS_MAX, Receipt, TickRecord, Torque, torque_flag,
};

/// What the plant adds to the flags of a torque in its receipt.
const MARKS: u32 = torque_flag::CAME_LATE | torque_flag::CAME_LATE_INJECTED;

/// Counters, happenings and receipts.
pub struct Journal {
    /// Counts since the start.
    pub counters: Counters,
    happenings: [Happening; HAPPENINGS_MAX],
    happenings_used: usize,
    receipts: [Receipt; RECEIPTS_MAX],
    had_torque: bool,
}

impl Journal {
    pub(super) fn new() -> Self {
        Self {
            counters: Counters::zeroed(),
            happenings: [Happening::zeroed(); HAPPENINGS_MAX],
            happenings_used: 0,
            receipts: [Receipt::zeroed(); RECEIPTS_MAX],
            had_torque: false,
        }
    }

    /// Notes something that happened, for the record of the tick that closes next; what there is no room for is left out.
    pub fn note(&mut self, kind: HappeningKind, subject: u32, detail: u64, value: f64) {
        if let Some(place) = self.happenings.get_mut(self.happenings_used) {
            *place = Happening { kind: kind.code(), subject, detail, value };
            self.happenings_used += 1;
        }
    }

    /// A torque of `writer` acts; the first one of a run is noted.
    pub(super) fn note_torque(&mut self, writer: u32) {
        if !std::mem::replace(&mut self.had_torque, true) {
            self.note(HappeningKind::FirstTorque, writer, 0, 0.0);
        }
    }

    /// Counts a torque by how it was taken.
    pub(super) fn count(&mut self, acceptance: Acceptance, torque: &Torque) {
        let counters = &mut self.counters;
        counters.faults_injected += u64::from(torque.flags & torque_flag::FAULT_INJECTED != 0);
        let counter = match acceptance {
            Acceptance::Late | Acceptance::LateUnused => &mut counters.late,
            Acceptance::Stale => &mut counters.stale,
            Acceptance::NotFinite => &mut counters.not_finite,
            Acceptance::Malformed => &mut counters.malformed,
            Acceptance::UnknownWriter => &mut counters.unknown_writer,
            Acceptance::Fenced => &mut counters.fenced,
            Acceptance::Duplicate => &mut counters.duplicate,
            Acceptance::Withheld => &mut counters.withheld,
            Acceptance::None | Acceptance::Applied | Acceptance::Standby => return,
        };
        *counter += 1;
    }

    /// Counts the closing tick by its decision.
    pub(crate) fn count_decision(&mut self, decision: Decision) {
        let counters = &mut self.counters;
        counters.ticks += 1;
        match decision {
            Decision::Held => counters.held += 1,
            Decision::Damped => counters.damped += 1,
            Decision::Stopped => counters.stopped += 1,
            _ => {}
        }
    }

    /// A tick opens: nobody has answered it.
    pub(super) fn open(&mut self) {
        self.receipts = [Receipt::zeroed(); RECEIPTS_MAX];
    }

    /// Notes how a torque was taken. Each writer has one receipt: its first answer to this tick, on which one to an earlier tick
    /// leaves its mark only. A second answer to this tick leaves the receipt as it is.
    pub(super) fn note_receipt(
        &mut self,
        torque: &Torque,
        arrived_ns: u64,
        acceptance: Acceptance,
        is_member: impl Fn(u32) -> bool,
    ) {
        let Some(place) = self.receipt_place(torque.writer, is_member) else { return };
        let receipt = &mut self.receipts[place];
        let own = receipt.writer == torque.writer;
        let is_stale = acceptance == Acceptance::Stale;
        let mut marks = if own { receipt.flags & MARKS } else { 0 };
        if is_stale {
            marks |= torque_flag::CAME_LATE;
            if torque.flags & torque_flag::FAULT_INJECTED != 0 {
                marks |= torque_flag::CAME_LATE_INJECTED;
            }
        }
        if own && (is_stale || receipt.acceptance != Acceptance::Stale.code()) {
            receipt.flags |= marks;
        } else {
            *receipt = receipt_of(torque, arrived_ns, acceptance, marks);
        }
    }

    /// The receipt of a writer, or the place for one. There are as many places as members, and a receipt of a stranger makes way
    /// for a member's.
    fn receipt_place(&self, writer: u32, is_member: impl Fn(u32) -> bool) -> Option<usize> {
        let own = self.receipts.iter().position(|r| r.writer == writer);
        let free = || self.receipts.iter().position(|r| r.writer == 0);
        let of_a_stranger = || self.receipts.iter().rposition(|r| !is_member(r.writer)).filter(|_| is_member(writer));
        own.or_else(free).or_else(of_a_stranger)
    }

    /// The receipts of the open tick, and how many there are.
    #[must_use]
    pub fn receipts(&self) -> (&[Receipt; RECEIPTS_MAX], usize) {
        (&self.receipts, self.receipts.iter().filter(|r| r.writer != 0).count())
    }

    /// What happened since this was last called.
    pub fn take_happenings(&mut self) -> ([Happening; HAPPENINGS_MAX], usize) {
        let happenings = std::mem::replace(&mut self.happenings, [Happening::zeroed(); HAPPENINGS_MAX]);
        (happenings, std::mem::take(&mut self.happenings_used))
    }

    /// Enters all that is written down into the record of the tick that closes.
    pub(crate) fn enter(&mut self, record: &mut TickRecord) {
        let (receipts, receipts_used) = self.receipts();
        record.receipts = *receipts;
        record.receipts_used = u32::try_from(receipts_used).unwrap_or(0);
        let (happenings, happenings_used) = self.take_happenings();
        record.happenings = happenings;
        record.happenings_used = u32::try_from(happenings_used).unwrap_or(0);
        record.counters = self.counters;
    }
}

fn receipt_of(torque: &Torque, arrived_ns: u64, acceptance: Acceptance, marks: u32) -> Receipt {
    Receipt {
        arrived_ns,
        state_received_ns: torque.received_ns,
        torque_published_ns: torque.published_ns,
        setpoint_published_ns: torque.setpoint_published_ns,
        setpoint_tick: torque.setpoint_tick,
        run_delay_ns: torque.evidence.run_delay_ns,
        involuntary_switches: torque.evidence.involuntary_switches,
        faults: torque.evidence.minor_faults + torque.evidence.major_faults,
        writer: torque.writer,
        epoch: torque.epoch,
        flags: torque.flags & !MARKS | marks,
        acceptance: acceptance.code(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn torque(writer: u32, flags: u32) -> Torque {
        Torque { writer, flags, ..Torque::zeroed() }
    }

    #[test]
    fn strangers_make_way_for_members_and_never_the_other_way_round() {
        let is_member = |id: u32| id <= 8;
        let mut journal = Journal::new();
        (100..120).for_each(|id| journal.note_receipt(&torque(id, 0), 1, Acceptance::UnknownWriter, is_member));
        assert_eq!(journal.receipts().1, RECEIPTS_MAX);
        (1..=8).for_each(|id| journal.note_receipt(&torque(id, 0), 2, Acceptance::Standby, is_member));
        journal.note_receipt(&torque(100, 0), 3, Acceptance::UnknownWriter, is_member);
        let mut writers = journal.receipts().0.map(|receipt| receipt.writer);
        writers.sort_unstable();
        assert_eq!(writers, [1, 2, 3, 4, 5, 6, 7, 8]);
    }

    #[test]
    fn a_sender_can_not_set_the_marks_that_the_plant_gives() {
        let mut journal = Journal::new();
        journal.note_receipt(&torque(1, MARKS | torque_flag::MAPPED), 1, Acceptance::Applied, |_| true);
        assert_eq!(journal.receipts().0[0].flags, torque_flag::MAPPED);
    }

    #[test]
    fn more_happenings_than_there_is_room_for_keep_the_first() {
        let mut journal = Journal::new();
        for subject in 0..100 {
            journal.note(HappeningKind::Joined, subject, 0, 0.0);
        }
        let (happenings, used) = journal.take_happenings();
        assert_eq!((used, happenings[0].subject), (HAPPENINGS_MAX, 0));
        assert_eq!(journal.take_happenings().1, 0, "they are taken once");
    }

    #[test]
    fn an_injected_fault_is_counted_beside_what_became_of_the_torque() {
        let mut journal = Journal::new();
        journal.count(Acceptance::Applied, &torque(1, torque_flag::FAULT_INJECTED));
        journal.count(Acceptance::LateUnused, &torque(1, torque_flag::FAULT_INJECTED));
        let Counters { faults_injected, late, .. } = journal.counters;
        assert_eq!((faults_injected, late), (2, 1));
    }
}
