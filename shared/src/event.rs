//! The closed sets of what can be said, asked and refused: small codes on the wire, names in files and on screens.

macro_rules! codes {
    ($($(#[$meta:meta])* pub enum $name:ident { $($(#[$vmeta:meta])* $variant:ident = $code:literal, $text:literal;)* })*) => {$(
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u32)]
        pub enum $name { $($(#[$vmeta])* $variant = $code,)* }

        impl $name {
            /// Every value, in order of its code.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// The value of a code from the wire; `None` for a code that this build does not know.
            #[must_use]
            pub const fn from_code(code: u32) -> Option<Self> {
                match code { $($code => Some(Self::$variant),)* _ => None }
            }

            /// The code on the wire.
            #[must_use]
            pub const fn code(self) -> u32 { self as u32 }

            /// The name in files and on screens.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $text,)* }
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result { f.pad(self.name()) }
        }
    )*};
}

codes! {
    /// The processes of a group.
    pub enum Role {
        /// Spawns, commands, cleans; never in the loop.
        Supervisor = 1, "supervisor";
        /// Publishes setpoints.
        Reference = 2, "reference";
        /// Answers states with torques.
        Controller = 3, "controller";
        /// Integrates the chain and is the sole arbiter of torque.
        Plant = 4, "plant";
        /// Watches.
        Monitor = 5, "monitor";
    }

    /// What travels between the processes of a group.
    pub enum MessageKind {
        /// A setpoint.
        Setpoint = 0, "setpoint";
        /// A state.
        State = 1, "state";
        /// A torque.
        Torque = 2, "torque";
        /// A tick's record.
        TickRecord = 3, "tick_record";
        /// An announcement.
        Announce = 4, "announce";
        /// A command to the plant.
        Command = 5, "command";
        /// The plant's answer to one.
        Reply = 6, "reply";
    }

    /// Where a process is in its life.
    pub enum Phase {
        /// Ports are open, memory is locked, the code is warm.
        Ready = 1, "ready";
        /// It ended in order.
        Ended = 2, "ended";
        /// It could not go on; the reason is on its standard error.
        Failed = 3, "failed";
    }

    /// What became of one torque.
    pub enum Acceptance {
        /// Nothing came from this controller in this tick.
        None = 0, "none";
        /// Accepted and applied.
        Applied = 1, "applied";
        /// Good and in time, of a standby, not needed.
        Standby = 2, "standby";
        /// After the grace deadline, and applied from its arrival.
        Late = 3, "late";
        /// After the grace deadline and not applied: a standby had taken over, or the writer is one.
        LateUnused = 4, "late, unused";
        /// For another tick.
        Stale = 5, "stale";
        /// Not finite.
        NotFinite = 6, "not finite";
        /// The wrong number of links, or beyond what is allowed.
        Malformed = 7, "malformed";
        /// From a writer that is no member of the group.
        UnknownWriter = 8, "unknown writer";
        /// From an epoch that was fenced.
        Fenced = 9, "fenced";
        /// A second one for the same tick.
        Duplicate = 10, "duplicate";
        /// The explicit marker that none is given.
        Withheld = 11, "withheld";
    }

    /// Where the torque of a tick came from.
    pub enum Decision {
        /// The plant rests at its start: no torque was accepted yet.
        Rest = 0, "rest";
        /// The active controller's, in time.
        Active = 1, "active";
        /// The active controller's, after the grace deadline.
        ActiveLate = 2, "active, late";
        /// A standby's for the same tick, since the active one's was not there.
        Standby = 3, "standby";
        /// The last torque goes on.
        Held = 4, "held";
        /// The plant's own damping with gravity compensation.
        Damped = 5, "damped";
        /// The plant's own stop.
        Stopped = 6, "stopped";
        /// A convex combination of the old and the new controller's.
        Blend = 7, "blend";
    }

    /// Entries of a record besides its torques.
    pub enum HappeningKind {
        /// A controller took over by command. Subject: new id; detail: old id; value: torque step, N·m.
        Swap = 1, "swap";
        /// A standby took over within the tick. Subject: new id; detail: old id.
        Failover = 2, "failover";
        /// A swap was rolled back. Subject: the id that is active again; detail: a `Refusal` code.
        Rollback = 3, "rollback";
        /// A swap was refused at its gate. Subject: id refused; detail: a `Refusal` code; value: the number.
        SwapRefused = 4, "swap refused";
        /// The first accepted torque. Subject: controller id.
        FirstTorque = 5, "first torque";
        /// The plant's fallback changed. Subject: a `Decision` code; detail: ticks held.
        Fallback = 6, "fallback";
        /// A port joined and memory was mapped. Detail: nanoseconds it took.
        Joined = 7, "joined";
        /// A controller became a member. Subject: its id.
        MemberAdded = 8, "member added";
        /// A controller is no member any more. Subject: its id.
        MemberRemoved = 9, "member removed";
        /// A fault was injected by command. Subject: the controller it targets; detail: a `LiveFault` code; value: its
        /// length in ticks.
        FaultInjected = 10, "fault injected";
        /// A standby's torque acted and the active controller stays active: the plant had begun the tick too late for an answer,
        /// or a switch is still being watched. Subject: the standby; detail: the active one.
        StoodIn = 12, "stood in";
        /// The loop ran away: the plant stops for good. Subject: the joint; detail: a `RunawayKind` code; value: what it was,
        /// 0 where it was not finite.
        Diverged = 13, "diverged";
    }

    /// What of a loop ran away.
    pub enum RunawayKind {
        /// An angle that is not finite.
        Angle = 1, "q";
        /// A velocity that is not finite.
        Velocity = 2, "v";
        /// A joint faster than its limit.
        Speed = 3, "speed";
        /// V far above its level and its start.
        V = 4, "V";
    }

    /// What the supervisor may ask of the plant.
    pub enum CommandKind {
        /// Start the clock: t_0 at `ns` (or the next aligned instant), stop at `tick`.
        Start = 1, "start";
        /// Stop before `tick`.
        StopAt = 2, "stop at";
        /// `controller` may publish torques from now on.
        AddMember = 3, "add member";
        /// `controller` is dead or retired: wait for it no more, fence it. `option` not 0: unless it is active.
        RemoveMember = 4, "remove member";
        /// Give authority to `controller` through the gate, at `tick` or as soon as it passes.
        Swap = 5, "swap";
        /// Say how the swap asked for last is doing.
        SwapStatus = 6, "swap status";
        /// A fault targets `controller` from `tick` on for `ns`: mark those ticks. `option`: a `LiveFault` code.
        Fault = 7, "fault";
        /// Forget the swap to `controller` if it still waits.
        CancelSwap = 8, "cancel swap";
    }

    /// Faults that can be injected by command into a controller of a running group.
    pub enum LiveFault {
        /// Each torque is published later.
        Delay = 1, "delay";
        /// No torque is published.
        Drop = 2, "drop";
        /// All values of each torque are not numbers.
        Nan = 3, "nan";
        /// The process is killed.
        Kill = 4, "kill";
        /// The process is stopped, and goes on after a while.
        Hang = 5, "hang";
        /// A torque is added to each torque's first link.
        Glitch = 6, "glitch";
    }

    /// How the plant answers.
    pub enum ReplyKind {
        /// Done, or noted and certain to be done.
        Done = 1, "done";
        /// Under way.
        Pending = 2, "pending";
        /// Not done.
        Refused = 3, "refused";
        /// Done, and rolled back.
        RolledBack = 4, "rolled back";
    }

    /// Why the plant says no.
    pub enum Refusal {
        /// The command is not known, or a field is out of range.
        BadCommand = 1, "the command is not understood";
        /// No such member.
        UnknownController = 2, "no such controller";
        /// It is the active controller.
        AlreadyActive = 3, "that controller is in charge already";
        /// Another swap is under way.
        Busy = 4, "another swap is under way";
        /// Its torques do not come in time.
        NotOnTime = 5, "its torques do not come in time";
        /// Its torques are not finite or beyond the limits.
        NotFinite = 6, "its torques are not finite or beyond the limits";
        /// The torque would step by more than allowed.
        TorqueStep = 7, "the torque would step by more than allowed";
        /// V is outside the new law's certified set.
        OutsideLevel = 8, "V is outside the new law's certified set";
        /// Too soon after the last swap.
        Dwell = 9, "too soon after the last swap";
        /// The tick named has passed.
        TickPassed = 10, "the tick named has passed";
        /// V was above its certified bound after the switch.
        BoundExceeded = 11, "the bound's promise was broken after the switch";
        /// Deadlines were missed after the switch.
        Deadlines = 12, "deadlines were missed after the switch";
        /// The controller left.
        Gone = 14, "that controller is gone";
        /// The command came from a process that is not the supervisor of this run.
        Stranger = 15, "the command is not of this run's supervisor";
        /// What was asked for would not be over before the run ends.
        BeyondEnd = 16, "the run ends before that";
        /// Whoever asked for it has left.
        Cancelled = 17, "whoever asked for it has left";
    }
}

impl From<loopbound_scenario::Role> for Role {
    fn from(role: loopbound_scenario::Role) -> Self {
        match role {
            loopbound_scenario::Role::Reference => Self::Reference,
            loopbound_scenario::Role::Controller => Self::Controller,
            loopbound_scenario::Role::Plant => Self::Plant,
            loopbound_scenario::Role::Monitor => Self::Monitor,
        }
    }
}

impl MessageKind {
    /// The word in a sentence, for one of them.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Setpoint => "setpoint",
            Self::State => "state",
            Self::Torque => "torque",
            Self::TickRecord => "tick record",
            Self::Announce => "announcement",
            Self::Command => "command",
            Self::Reply => "reply",
        }
    }
}

/// A text that is no name of a [`LiveFault`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownFault;

impl core::fmt::Display for UnknownFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("no such fault: it is one of")?;
        LiveFault::ALL.iter().try_for_each(|fault| write!(f, " {fault}"))
    }
}

impl core::error::Error for UnknownFault {}

impl core::str::FromStr for LiveFault {
    type Err = UnknownFault;

    fn from_str(text: &str) -> Result<Self, UnknownFault> {
        Self::ALL.iter().copied().find(|fault| fault.name() == text).ok_or(UnknownFault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_reads_back_as_itself_and_an_unknown_one_as_none() {
        for decision in Decision::ALL {
            assert_eq!(Decision::from_code(decision.code()), Some(*decision));
        }
        assert_eq!(Acceptance::from_code(999), None);
        assert_eq!(Role::Plant.to_string(), "plant");
    }
}
