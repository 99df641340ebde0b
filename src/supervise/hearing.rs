//! What the supervisor hears of the group by its topics: announcements, the newest state and closed tick and, in lockstep,
//! who has answered which tick.

use loopbound_shared::event::Phase;
use loopbound_shared::ports::{Node, PortError, Subscriber};
use loopbound_shared::sample::{Announce, State, TickRecord, Torque};
use loopbound_shared::topics::Topic as _;

/// The subscribers, and what was heard last.
pub(super) struct Hearing {
    announcements: Subscriber<Announce>,
    states: Subscriber<State>,
    closed: Subscriber<TickRecord>,
    newest_closed: Option<TickRecord>,
    /// Lockstep alone.
    torques: Option<Subscriber<Torque>>,
    answered: Vec<(u32, u64)>,
    opened: Option<u64>,
}

impl Hearing {
    /// Subscribes. What strangers say is counted by others.
    pub(super) fn open(node: &Node, lockstep: bool) -> Result<Self, PortError> {
        Ok(Self {
            announcements: node.subscriber(Announce::DEPTH)?.uncounted(),
            states: node.subscriber(1)?.uncounted(),
            closed: node.subscriber(1)?.uncounted(),
            newest_closed: None,
            torques: lockstep.then(|| node.subscriber(1)).transpose()?.map(Subscriber::uncounted),
            answered: Vec::new(),
            opened: None,
        })
    }

    /// The next announcement of somebody that is ready.
    pub(super) fn next_ready(&mut self) -> Option<Announce> {
        std::iter::from_fn(|| self.announcements.take()).find(|announce| announce.phase == Phase::Ready.code())
    }

    /// A state that is new since the last look.
    pub(super) fn latest_state(&mut self) -> Option<State> {
        let state = self.states.latest();
        self.opened = state.map(|state| state.tick).or(self.opened);
        state
    }

    /// Notes who has answered which tick.
    pub(super) fn hear_torques(&mut self) {
        let Some(torques) = &self.torques else { return };
        while let Some((writer, tick)) = torques.take_with(|torque| (torque.writer, torque.tick)) {
            match self.answered.iter_mut().find(|(id, _)| *id == writer) {
                Some(entry) => entry.1 = entry.1.max(tick),
                None => self.answered.push((writer, tick)),
            }
        }
    }

    /// The last closed tick. Readers pass over a record without links: it is of the warm-up.
    pub(super) fn newest_closed(&mut self) -> Option<&TickRecord> {
        self.newest_closed = self.closed.latest().filter(|record| record.links != 0).or(self.newest_closed);
        self.newest_closed.as_ref()
    }

    /// Whether the plant has published the state of `tick`.
    pub(super) fn has_opened(&self, tick: u64) -> bool {
        self.opened.is_some_and(|opened| opened >= tick)
    }

    /// Whether controller `id` has answered `tick`; known in lockstep alone.
    pub(super) fn has_answered(&self, id: u32, tick: u64) -> bool {
        self.answered.iter().any(|(writer, last)| *writer == id && *last >= tick)
    }
}
