//! The ports of a controller, and what it does at them in the slack.

use loopbound_shared::doorbell::Bell;
use loopbound_shared::ports::{Publisher, Subscriber};
use loopbound_shared::role::{Joined, RoleError};
use loopbound_shared::sample::{Announce, Setpoint, State, Torque};
use loopbound_shared::setpoints::SetpointBook;
use loopbound_shared::wakeup::{Ringer, Waiter};

/// The ports of a controller.
pub(crate) struct Ports {
    pub(crate) joined: Joined,
    pub(crate) states: Subscriber<State>,
    pub(crate) setpoints: Subscriber<Setpoint>,
    pub(crate) torques: Publisher<Torque>,
    pub(crate) announce: Publisher<Announce>,
    pub(crate) states_bell: Waiter,
    pub(crate) torque_bell: Ringer,
}

impl Ports {
    pub(crate) fn open(joined: Joined) -> Result<Self, RoleError> {
        let (node, mode) = (&joined.node, joined.scenario.loop_.wakeup);
        Ok(Self {
            states: node.subscriber(8)?,
            setpoints: node.subscriber(usize::MAX)?.uncounted(),
            torques: node.publisher()?,
            announce: node.publisher()?,
            states_bell: Waiter::new(node, mode, Bell::State)?,
            torque_bell: Ringer::new(node, mode, Bell::Torque)?,
            joined,
        })
    }

    /// Enters all setpoints that have come.
    pub(crate) fn drain_setpoints(&self, book: &mut SetpointBook, links: usize) {
        while self.setpoints.take_with(|setpoint| book.enter(setpoint, links)).is_some() {}
    }

    /// Maps what has joined or left, in the slack.
    pub(crate) fn update_connections(&self) {
        // Every field is named, so that no port can be forgotten.
        let Self { states, setpoints, torques, announce, joined: _, states_bell: _, torque_bell: _ } = self;
        // What can't be mapped now belongs to a process that is just dying; the next look finds it gone.
        let _ = states.update_connections();
        let _ = setpoints.update_connections();
        let _ = torques.update_connections();
        let _ = announce.update_connections();
    }
}
