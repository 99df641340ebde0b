//! Who may say what in a run: the supervisor's list of its processes, and the count of what strangers said.
//!
//! It lies in the control block. A message is heard if it carries the run's id and its writer is on the list in the role
//! that this message is for; all else is counted and never obeyed. The aim is what goes wrong by accident (a process that
//! an earlier run left behind, a test against the wrong group), not an attacker of the same user, who can read the list.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed, Ordering::SeqCst};

use crate::event::{MessageKind, Role};
use crate::realtime::ProcessHandle;
use crate::run_id::RunId;
use crate::sample::Message;

/// Processes that the list has room for: twice those that a group has places for.
const WRITERS_MAX: usize = 64;

/// The list and the counts. All zero: nobody is on it.
#[derive(Debug)]
#[repr(C, align(64))]
pub struct Writers {
    /// Role (8 bits), number within the role (24) and process id (32); 0 is nobody.
    list: [AtomicU64; WRITERS_MAX],
    /// By [`MessageKind`].
    strangers: [AtomicU64; MessageKind::ALL.len()],
}

/// The largest number within a role that the list can tell.
const ID_MAX: u32 = 0x00ff_ffff;

const fn packed(role: Role, id: u32, pid: u32) -> u64 {
    ((role as u64) << 56) | (((id & ID_MAX) as u64) << 32) | pid as u64
}

impl Writers {
    /// Enters a process. The supervisor's, for itself and for everyone that it starts. Those that have ended stay on the
    /// list, since what they said last may still be on its way, until their place is needed.
    pub fn enlist(&self, role: Role, id: u32, pid: u32) {
        let entry = packed(role, id, pid);
        let mut places = self.list.iter();
        if places.clone().any(|place| place.load(SeqCst) == entry) {
            return;
        }
        let has_ended = |place: &&AtomicU64| {
            let pid = u32::try_from(place.load(SeqCst) & u64::from(u32::MAX)).unwrap_or(0);
            ProcessHandle::has_ended(pid).unwrap_or(false)
        };
        let free = places.clone().find(|place| place.load(SeqCst) == 0).or_else(|| places.find(has_ended));
        if let Some(place) = free {
            place.store(entry, SeqCst);
        }
    }

    /// Whether a process is on the list; of any number within its role if none is named.
    #[must_use]
    pub fn knows(&self, role: Role, id: Option<u32>, pid: u32) -> bool {
        let wanted = packed(role, id.unwrap_or(0), pid);
        let mask = if id.is_some() { u64::MAX } else { !(u64::from(ID_MAX) << 32) };
        if id.is_some_and(|id| id > ID_MAX) {
            return false;
        }
        // Entries fill the list from its front, and an empty one is followed by none.
        let mut entries = self.list.iter().map(|place| place.load(Relaxed)).take_while(|entry| *entry != 0);
        entries.any(|entry| entry & mask == wanted & mask)
    }

    /// Whether a message is of this run and of a process on the list.
    #[must_use]
    pub fn vouch_for<M: Message>(&self, run_id: RunId, message: &M) -> bool {
        let origin = message.origin();
        let role = message.role().filter(|role| origin.run_id == run_id.bits() && origin.role == role.code());
        role.is_some_and(|role| self.knows(role, message.writer(), origin.pid))
    }

    /// Counts what a stranger said.
    pub fn count_stranger(&self, kind: MessageKind) {
        self.strangers[kind as usize].fetch_add(1, Relaxed);
    }

    /// How many messages of a kind were refused since the start of the run.
    #[must_use]
    pub fn strangers(&self, kind: MessageKind) -> u64 {
        self.strangers[kind as usize].load(Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Origin, Setpoint, State, Torque};

    fn empty() -> Writers {
        Writers { list: [const { AtomicU64::new(0) }; WRITERS_MAX], strangers: Default::default() }
    }

    #[test]
    fn a_message_is_vouched_for_by_its_run_its_role_its_number_and_its_process_together() {
        let (writers, run) = (empty(), RunId::draw());
        writers.enlist(Role::Plant, 1, 10);
        writers.enlist(Role::Controller, 2, 20);
        writers.enlist(Role::Reference, 1, 30);
        let origin = |role: Role, pid| Origin { run_id: run.bits(), role: role.code(), pid };
        let state = State { origin: origin(Role::Plant, 10), ..State::zeroed() };
        let torque = Torque { origin: origin(Role::Controller, 20), writer: 2, ..Torque::zeroed() };
        let setpoint = Setpoint { origin: origin(Role::Reference, 30), writer: 1, ..Setpoint::zeroed() };
        assert!(writers.vouch_for(run, &state) && writers.vouch_for(run, &torque) && writers.vouch_for(run, &setpoint));
        assert!(!writers.vouch_for(RunId::draw(), &state), "another run");
        assert!(!writers.vouch_for(run, &State::zeroed()), "no run at all");
        assert!(!writers.vouch_for(run, &State { origin: origin(Role::Plant, 11), ..state }), "another process");
        assert!(!writers.vouch_for(run, &State { origin: origin(Role::Controller, 20), ..state }), "another role");
        assert!(!writers.vouch_for(run, &Torque { writer: 1, ..torque }), "another number");
        assert!(!writers.vouch_for(run, &Torque { writer: 2 + (1 << 24), ..torque }), "a number beyond the list's");
    }

    #[test]
    fn a_successor_is_entered_beside_the_one_that_died_and_a_full_list_gives_up_the_dead() {
        let writers = empty();
        writers.enlist(Role::Reference, 1, 30);
        writers.enlist(Role::Reference, 1, 31);
        assert!(writers.knows(Role::Reference, Some(1), 30) && writers.knows(Role::Reference, Some(1), 31));
        let own = std::process::id();
        writers.enlist(Role::Plant, 1, own);
        // No process has so large a number.
        const DEAD: u32 = 0x7fff_0000;
        for id in 1..=200 {
            writers.enlist(Role::Controller, id, DEAD + id);
            assert!(writers.knows(Role::Controller, Some(id), DEAD + id));
        }
        assert!(writers.knows(Role::Plant, None, own), "a living process keeps its place");
        assert!(!writers.knows(Role::Controller, Some(1), DEAD + 1));
    }
}
