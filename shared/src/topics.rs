//! The table of topics: what flows, from whom to whom, and with which quality of service.

use crate::sample::{Announce, Message, Setpoint, State, TickRecord, Torque};

/// Subscribers that a topic has room for.
pub const SUBSCRIBERS_MAX: usize = 16;
/// Publishers that a topic has room for: the eight controllers that a plant takes, the other roles, and the dead, who
/// keep their places until they are cleaned up.
pub const PUBLISHERS_MAX: usize = 16;
/// Nodes that a topic has room for: every process of the group and those that attach.
pub const NODES_MAX: usize = 32;

/// A sample type and the quality of service of its topic. Safe overflow is on everywhere: a reader that sleeps loses
/// its own oldest samples and delays nobody.
pub trait Topic: Message + iceoryx2::prelude::ZeroCopySend + core::fmt::Debug {
    /// Name of the service.
    const NAME: &'static str;
    /// Samples that a reader's buffer holds.
    const DEPTH: usize;
    /// Past samples that a late reader is given.
    const HISTORY: usize;
    /// Samples that a writer has room for.
    const KEPT: usize = 4 * Self::DEPTH + Self::HISTORY + 16;
}

macro_rules! topics {
    ($($sample:ty: $name:literal, depth $depth:literal, history $history:literal;)*) => {
        $(impl Topic for $sample {
            const NAME: &'static str = $name;
            const DEPTH: usize = $depth;
            const HISTORY: usize = $history;
        })*
    };
}

topics! {
    // Of the reference, for controllers and plant.
    Setpoint:   "setpoint",    depth 2048, history 2048;
    // Of the plant, for controllers and supervisor.
    State:      "state",       depth 64,   history 1;
    // Of the controllers, for the plant, and in lockstep for the supervisor.
    Torque:     "torque",      depth 64,   history 0;
    // Of the plant, for monitors.
    TickRecord: "tick-record", depth 2048, history 0;
    // Of all, for supervisor, plant and monitors.
    Announce:   "announce",    depth 64,   history 8;
}
