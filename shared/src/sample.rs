//! Everything that crosses a process boundary, in one place.
//!
//! Wire samples are not generic: a vector is `[f64; 7]` of which the first `links` count, so that a monitor can attach
//! before it knows the scenario. Every sample carries the run and the process that it comes from ([`Origin`]), the tick
//! it belongs to or answers, its writer and that writer's epoch, and copies the stamps of its inputs through. Stamps
//! `…_ns` are CLOCK_MONOTONIC in realtime mode and virtual in lockstep; `…_plant_ns` count from t = 0 of the plant in both.

pub use crate::counters::Counters;
use crate::event::{MessageKind, Role};
use crate::layout::Layout;
use crate::realtime::{Evidence, Privileges};
use crate::run_id::RunId;
use crate::{message, wire};
use loopbound_model::chain::{LINKS_MAX, Vector};
use loopbound_model::claim::Claim;
use loopbound_model::law::LawKind;

/// One entry a link; those from `links` on are zero.
pub type Links = [f64; LINKS_MAX];

/// The first N entries as a vector of the mathematics.
#[must_use]
pub fn to_vector<const N: usize>(links: &Links) -> Vector<N> {
    Vector::from_fn(|i, _| links[i])
}

/// A vector of the mathematics as it travels.
#[must_use]
pub fn to_links<const N: usize>(vector: &Vector<N>) -> Links {
    let mut links = [0.0; LINKS_MAX];
    links[..N].copy_from_slice(vector.as_slice());
    links
}

wire! {
    /// Whose a sample is. It identifies and is no result: recordings and comparisons of results leave it out.
    #[derive(Eq)]
    pub struct Origin {
        /// The run's id, by [`RunId::bits`].
        pub run_id: u64,
        /// [`Role`] of the writer.
        pub role: u32,
        /// Process id of the writer; 0 for the run in one process.
        pub pid: u32,
    }
}

impl Origin {
    /// `role` of a run in one process.
    #[must_use]
    pub const fn in_process(role: Role) -> Self {
        Self { run_id: RunId::IN_PROCESS.bits(), role: role.code(), pid: 0 }
    }
}

/// What travels between the processes of a run. The ports stamp its origin when it is sent, and look at it when it comes.
pub trait Message: Layout {
    /// Which kind it is.
    const KIND: MessageKind;
    /// Hash over the names and types of all fields but the origin: what a recording keeps.
    const CONTENT_HASH: u64;

    /// Whose it says it is.
    fn origin(&self) -> &Origin;

    /// The same, to be stamped.
    fn origin_mut(&mut self) -> &mut Origin;

    /// The role that may say this; none if the code is that of no role.
    fn role(&self) -> Option<Role>;

    /// The writer's number within its role, where the message names it.
    fn writer(&self) -> Option<u32>;
}

message! {
    /// What the reference asks for at tick `tick`, published ahead of time.
    pub struct Setpoint: Setpoint, |_| Some(Role::Reference), |this| Some(this.writer); {
        /// The tick it holds for.
        pub tick: u64,
        /// Time of that tick since t = 0.
        pub plant_ns: u64,
        /// When it was published.
        pub published_ns: u64,
        /// Id of the reference process.
        pub writer: u32,
        /// Links in use.
        pub links: u32,
        /// q_d, rad.
        pub q_d: Links,
        /// q̇_d, rad/s.
        pub v_d: Links,
        /// q̈_d, rad/s².
        pub a_d: Links,
    }
}

message! {
    /// What the plant measured at the start of a tick.
    pub struct State: State, |_| Some(Role::Plant), |_| None; {
        /// The tick k.
        pub tick: u64,
        /// t_k: the deadline of tick k.
        pub deadline_ns: u64,
        /// s_k: when the plant sampled.
        pub sampled_ns: u64,
        /// When this sample was published.
        pub published_ns: u64,
        /// The grace deadline: a torque received after it counts late.
        pub grace_deadline_ns: u64,
        /// s_k since t = 0.
        pub plant_ns: u64,
        /// s_k − t_k in plant time: how far past the setpoint's instant the sample was taken.
        pub setpoint_offset_ns: u64,
        /// Authority: the controller that is obeyed …
        pub active: u32,
        /// … and in which epoch.
        pub epoch: u32,
        /// [`state_flag`].
        pub flags: u32,
        /// Links in use.
        pub links: u32,
        /// Measured q, rad.
        pub q: Links,
        /// Measured q̇, rad/s.
        pub v: Links,
    }
}

/// The tick that answers to warm-up states carry: that of no tick, so they can never act.
pub const WARM_UP_TICK: u64 = u64::MAX;

/// Flags of a [`State`].
pub mod state_flag {
    /// The last state of the group: answer it no more, end.
    pub const LAST: u32 = 1;
    /// Published before tick 0 to warm up both ends; answers carry [`WARM_UP_TICK`](super::WARM_UP_TICK). The deadline
    /// is 0, or one period before t_0 once that is known.
    pub const WARM_UP: u32 = 2;
}

message! {
    /// A controller's answer to one [`State`].
    pub struct Torque: Torque, |_| Some(Role::Controller), |this| Some(this.writer); {
        /// The tick answered.
        pub tick: u64,
        /// `published_ns` of the state answered.
        pub state_published_ns: u64,
        /// When the controller received that state.
        pub received_ns: u64,
        /// When this sample was published.
        pub published_ns: u64,
        /// Tick of the setpoint that was used (the same tick, unless it was absent).
        pub setpoint_tick: u64,
        /// When that setpoint was published.
        pub setpoint_published_ns: u64,
        /// Lockstep only: how much later than the state this torque arrives (an injected delay).
        pub virtual_delay_ns: u64,
        /// Controller id.
        pub writer: u32,
        /// Epoch in which the controller believes it answers.
        pub epoch: u32,
        /// [`torque_flag`].
        pub flags: u32,
        /// Links in use.
        pub links: u32,
        /// τ, N·m.
        pub tau: Links,
        /// The setpoint that was used, at s_k.
        pub q_d: Links,
        /// Its velocity.
        pub v_d: Links,
        /// Its acceleration.
        pub a_d: Links,
        /// The controller's evidence as of its last slack.
        pub evidence: Evidence,
    }
}

/// Flags of a [`Torque`].
pub mod torque_flag {
    /// A marker: no torque is given for this tick (an injected fault; keeps lockstep going).
    pub const WITHHELD: u32 = 1;
    /// The setpoint of this tick was absent; an older one was extrapolated.
    pub const SETPOINT_STALE: u32 = 2;
    /// A fault was injected into this torque.
    pub const FAULT_INJECTED: u32 = 4;
    /// Lockstep only: this torque counts as come twice (an injected fault). Two samples could arrive in two ticks.
    pub const TWICE: u32 = 8;
    /// Lockstep only: withheld in its tick, and counts as come in a later one (an injected fault).
    pub const AFTER_ITS_TIME: u32 = 16;
    /// Lockstep only: a stranger's torque counts as come beside this one (an injected fault).
    pub const ROGUE: u32 = 32;
    /// The controller spent long in mapping a port that joined, since its answer before.
    pub const MAPPED: u32 = 64;
    /// In a receipt only: an answer of this writer came in this tick when its own tick was over.
    pub const CAME_LATE: u32 = 128;
    /// In a receipt only: a fault had been injected into that answer.
    pub const CAME_LATE_INJECTED: u32 = 256;
}

wire! {
    /// A torque as it acted on the plant from `from_plant_ns` until the next segment.
    pub struct Segment {
        /// Since when, in plant time.
        pub from_plant_ns: u64,
        /// The tick whose state it answers.
        pub answered_tick: u64,
        /// Writer, 0 for the plant's own (rest, hold, damping).
        pub writer: u32,
        /// Epoch of the writer.
        pub epoch: u32,
        /// τ after limits, N·m.
        pub tau: Links,
    }
}

wire! {
    /// When and how one controller answered this tick.
    pub struct Receipt {
        /// When the plant received it (0: nothing came).
        pub arrived_ns: u64,
        /// When the controller received the state.
        pub state_received_ns: u64,
        /// When the controller published.
        pub torque_published_ns: u64,
        /// When the setpoint it used was published.
        pub setpoint_published_ns: u64,
        /// The tick of the setpoint it used.
        pub setpoint_tick: u64,
        /// The controller's cumulative run-queue delay.
        pub run_delay_ns: u64,
        /// The controller's cumulative involuntary switches.
        pub involuntary_switches: u64,
        /// The controller's cumulative page faults.
        pub faults: u64,
        /// Controller id.
        pub writer: u32,
        /// Its epoch.
        pub epoch: u32,
        /// [`torque_flag`] as sent, and what the plant adds.
        pub flags: u32,
        /// [`crate::event::Acceptance`]. Stale: nothing came for this tick, and something for an earlier one.
        pub acceptance: u32,
    }
}

wire! {
    /// Something that happened in a tick, as a closed kind with its numbers.
    pub struct Happening {
        /// [`crate::event::HappeningKind`].
        pub kind: u32,
        /// Controller id or role, by kind.
        pub subject: u32,
        /// A count, a tick or nanoseconds, by kind.
        pub detail: u64,
        /// A magnitude, by kind.
        pub value: f64,
    }
}

/// Segments that a record holds.
pub const SEGMENTS_MAX: usize = 8;
/// Controllers that a record has receipts of.
pub const RECEIPTS_MAX: usize = loopbound_scenario::CONTROLLERS_MAX;
/// Happenings that a record holds.
pub const HAPPENINGS_MAX: usize = 6;

message! {
    /// All of tick k, published when it has closed: the one sample from which everything is judged.
    pub struct TickRecord: TickRecord, |_| Some(Role::Plant), |_| None; {
        /// The tick k.
        pub tick: u64,
        /// t_k.
        pub deadline_ns: u64,
        /// s_k: when the plant sampled.
        pub sampled_ns: u64,
        /// When the state was published.
        pub published_ns: u64,
        /// The grace deadline of the tick.
        pub grace_deadline_ns: u64,
        /// s_{k+1}: when the tick ended.
        pub end_ns: u64,
        /// s_k in plant time: where the integration of this tick starts.
        pub start_plant_ns: u64,
        /// s_{k+1} in plant time: where it ends.
        pub end_plant_ns: u64,
        /// s_k − t_k in plant time.
        pub setpoint_offset_ns: u64,
        /// When the accepted torque arrived (0: none).
        pub accepted_ns: u64,
        /// Setpoint tick used for q_d …: the same tick, unless it was absent.
        pub setpoint_tick: u64,
        /// Ticks skipped just before this one.
        pub skipped_before: u64,
        /// The longest gap between two looks at the clock while the plant was spinning.
        pub spin_gap_ns: u64,
        /// How late the kernel woke the plant from its sleep before t_k: what the host alone does to a periodic thread
        /// of this priority on this core. The largest number: it did not sleep (an overrun, or lockstep).
        pub wake_late_ns: u64,
        /// [`crate::event::Decision`].
        pub decision: u32,
        /// The active controller at the end of the tick …
        pub active: u32,
        /// … and its epoch.
        pub epoch: u32,
        /// [`record_flag`].
        pub flags: u32,
        /// Links in use.
        pub links: u32,
        /// Entries of `segments` in use.
        pub segments_used: u32,
        /// Entries of `receipts` in use.
        pub receipts_used: u32,
        /// Entries of `happenings` in use.
        pub happenings_used: u32,
        /// True q at s_k, rad.
        pub q: Links,
        /// True q̇ at s_k, rad/s.
        pub v: Links,
        /// Measured q, as published.
        pub q_measured: Links,
        /// Measured q̇, as published.
        pub v_measured: Links,
        /// The setpoint at s_k.
        pub q_d: Links,
        /// Its velocity.
        pub v_d: Links,
        /// Its acceleration.
        pub a_d: Links,
        /// The disturbance at s_k, N·m.
        pub disturbance: Links,
        /// The setpoint that the accepted torque used.
        pub used_q_d: Links,
        /// Its velocity.
        pub used_v_d: Links,
        /// Its acceleration.
        pub used_a_d: Links,
        /// The torques that acted, in order of time; the first starts at or before `start_plant_ns`.
        pub segments: [Segment; SEGMENTS_MAX],
        /// How each controller answered.
        pub receipts: [Receipt; RECEIPTS_MAX],
        /// What happened besides.
        pub happenings: [Happening; HAPPENINGS_MAX],
        /// The plant's evidence, read in the slack of this tick.
        pub evidence: Evidence,
        /// Counts since the start.
        pub counters: Counters,
    }
}

/// Flags of a [`TickRecord`].
pub mod record_flag {
    /// The last record of the group.
    pub const LAST: u32 = 1;
    /// The plant rests at its start: no torque was accepted yet.
    pub const AT_REST: u32 = 2;
    /// The torque limit acted.
    pub const SATURATED: u32 = 4;
    /// The setpoint of this tick was absent; an older one was extrapolated.
    pub const SETPOINT_STALE: u32 = 8;
    /// No setpoint has come yet: q_d is the start position.
    pub const SETPOINT_NONE: u32 = 16;
    /// A fault was injected in this tick.
    pub const FAULT_INJECTED: u32 = 32;
    /// The plant had to map memory for a port that joined.
    pub const JOINED: u32 = 64;
    /// The loop has run away, in this tick or an earlier one: the plant stands still, and no torque acts any more.
    pub const DIVERGED: u32 = 128;
}

message! {
    /// Who a process is and what it claims; published once it is ready and whenever that changes.
    pub struct Announce: Announce, |this| Role::from_code(this.role), |this| Some(this.id); {
        /// [`crate::event::Role`].
        pub role: u32,
        /// Id within the group.
        pub id: u32,
        /// Process id.
        pub pid: u32,
        /// [`crate::event::Phase`].
        pub phase: u32,
        /// Build of the executable.
        pub build: u64,
        /// When it was published.
        pub published_ns: u64,
        /// What the process had of real-time privileges.
        pub privileges: Privileges,
        /// Law of a controller: 0 none announced, else `LawKind::code`.
        pub law: u32,
        /// Links in use.
        pub links: u32,
        /// β of the announced law.
        pub beta: f64,
        /// K_t of the announced law.
        pub k_t: f64,
        /// K_p of the announced law.
        pub k_p: f64,
        /// K_d of the announced law.
        pub k_d: f64,
        /// Name of the law or executable, UTF-8, zero-filled.
        pub name: [u8; 32],
    }
}

message! {
    /// What the supervisor asks of the plant.
    pub struct Command: Command, |_| Some(Role::Supervisor), |_| None; {
        /// [`crate::event::CommandKind`].
        pub kind: u32,
        /// Controller id, where one is meant.
        pub controller: u32,
        /// The tick at which it takes effect (0: at once).
        pub tick: u64,
        /// Nanoseconds, by kind: t_0 for start, blend time for swap, length of a fault.
        pub ns: u64,
        /// By kind. Of a swap, 1: skip the gate (not the safety checks). Of a removal, 1: unless it is active. Of a fault, which.
        pub option: u64,
    }
}

message! {
    /// The plant's answer.
    pub struct Reply: Reply, |_| Some(Role::Plant), |_| None; {
        /// [`crate::event::ReplyKind`].
        pub kind: u32,
        /// [`crate::event::Refusal`], 0 where accepted.
        pub reason: u32,
        /// The tick at which it takes or took effect.
        pub tick: u64,
        /// A magnitude that belongs to the reason (a torque step in N·m, V …).
        pub value: f64,
        /// What is allowed of it.
        pub limit: f64,
    }
}

impl Announce {
    /// The law that a controller says it is, with its gains; none if it names no law, or one that is not known.
    #[must_use]
    pub fn claim(&self) -> Option<Claim> {
        let Self { beta, k_t, k_p, k_d, .. } = *self;
        LawKind::of_code(self.law).map(|law| Claim { law, beta, k_t, k_p, k_d })
    }

    /// Says a law and its gains.
    pub fn set_claim(&mut self, claim: &Claim) {
        self.law = claim.law.code();
        (self.beta, self.k_t, self.k_p, self.k_d) = (claim.beta, claim.k_t, claim.k_p, claim.k_d);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_announcement_says_a_claim_and_none_of_a_law_that_does_not_exist() {
        let mut announce = Announce::zeroed();
        assert_eq!(announce.claim(), None);
        for law in LawKind::ALL {
            let claim = Claim { law, beta: 5.0, k_t: 100.0, k_p: 25.0, k_d: 10.0 };
            announce.set_claim(&claim);
            assert_eq!(announce.claim(), Some(claim));
        }
        announce.law = 5;
        assert_eq!(announce.claim(), None);
    }
}
