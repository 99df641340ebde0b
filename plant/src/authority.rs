//! Which controller's torque acts. The plant alone decides it: it judges every torque that comes, and changes authority at
//! tick boundaries (by command) or within a tick (failover). No clock and no physics here: the loops say when a torque
//! arrived and when the grace deadline has passed.
//!
//! Four parts: `members` knows the controllers and their states, `judgement` decides one tick and changes nothing,
//! `swap` decides what is due between two ticks, `journal` counts and writes down. [`Authority`] joins them: it alone
//! carries out what they decide. The *epoch* counts changes of authority.
//!
//! A member is active, a standby, or fenced:
//!
//! ```text
//!                           swap, failover                failover
//!   ── add ──▶  standby  ───────────────────▶  active  ─────────────▶  fenced
//!                ▲   ▲                           │                       │
//!                │   └──────── swap, rollback ───┘                       │
//!                └──────────── 20 good answers in the new epoch ─────────┘
//!   remove: from each of the three
//! ```
//!
//! A swap is decided between two ticks:
//!
//! ```text
//!   ── swap ──▶  pending  ── gate passes ──▶  done, watched  ── rollback_for is over ──▶  done
//!                   │                               │
//!                   │ named tick, timeout,          │ V above its bound, m misses of K,
//!                   │ member gone, cancelled        │ failover
//!                   ▼                               ▼
//!                refused                        rolled back
//! ```
//!
//! Without any torque the plant falls back (`fallback.rs`):
//!
//! ```text
//!               no torque            time to hold is over             all links slow
//!   answered ─────────────▶  hold  ───────────────────────▶  damp  ◀────────────────▶  stop
//!      ▲                       │                               │      a link is fast     │
//!      └── accepted torque ────┴───────────────────────────────┴─────────────────────────┘
//!   the loop diverged: stop, whoever answers from then on
//! ```

mod journal;
mod judgement;
mod members;
mod swap;

use loopbound_shared::event::{Acceptance, Decision, HappeningKind, Refusal};
use loopbound_shared::sample::{Command, Links, RECEIPTS_MAX, Receipt, Reply, Torque};

use crate::replies;
pub use journal::Journal;
use judgement::{Judgement, OpenTick, Replacement};
use members::Members;
pub(crate) use swap::CertifiedLevels;
pub use swap::SwapRules;
use swap::Swaps;

#[cfg(test)]
mod tests;

/// A torque that is to act from `from_ns` on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Applied {
    /// τ as it was answered, before limits, N·m.
    pub tau: Links,
    /// Since when.
    pub from_ns: u64,
    /// Whose.
    pub writer: u32,
    /// In which epoch.
    pub epoch: u32,
    /// The setpoint it was computed with: q_d, q̇_d, q̈_d.
    pub setpoint: [Links; 3],
}

/// The members, the open tick, the swaps, and what is written down of them. Allocates at construction only.
pub struct Authority {
    links: u32,
    members: Members,
    open: OpenTick,
    swaps: Swaps,
    /// Counters, happenings and receipts.
    pub journal: Journal,
}

impl Authority {
    /// No members, and no active controller.
    #[must_use]
    pub fn new(links: usize, rules: SwapRules) -> Self {
        Self {
            links: u32::try_from(links).unwrap_or(0),
            members: Members::new(),
            open: OpenTick::default(),
            swaps: Swaps::new(rules),
            journal: Journal::new(),
        }
    }

    /// The id of the active controller, and the epoch.
    #[must_use]
    pub fn active(&self) -> (u32, u32) {
        self.members.active()
    }

    /// The open tick.
    #[must_use]
    pub fn tick(&self) -> u64 {
        self.open.tick
    }

    /// Ids of the members; in lockstep a tick waits for all of them.
    pub fn member_ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.members.iter().map(|member| member.id)
    }

    /// The decision on the open tick, once there is one.
    #[must_use]
    pub fn decision(&self) -> Option<Decision> {
        self.open.decision
    }

    /// Whether some torque of the open tick acts or will.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.open.decision.is_some()
    }

    /// The receipts of the open tick, and how many there are.
    #[must_use]
    pub fn receipts(&self) -> (&[Receipt; RECEIPTS_MAX], usize) {
        self.journal.receipts()
    }

    /// Whether the last switch may still be rolled back.
    #[must_use]
    pub fn is_on_probation(&self) -> bool {
        self.swaps.is_watched()
    }
}

/// Membership, by command.
impl Authority {
    /// Adds a controller as a standby.
    ///
    /// # Errors
    /// If there is no room, or the id is 0.
    pub fn add(&mut self, id: u32) -> Result<(), Refusal> {
        if self.members.add(id)? {
            self.journal.note(HappeningKind::MemberAdded, id, 0, 0.0);
        }
        Ok(())
    }

    /// Removes a controller that is dead or retired; what it may still say is of an unknown writer.
    ///
    /// # Errors
    /// If it is no member.
    pub fn remove(&mut self, id: u32) -> Result<(), Refusal> {
        self.members.remove(id)?;
        self.journal.note(HappeningKind::MemberRemoved, id, 0, 0.0);
        Ok(())
    }

    /// Gives authority at the start, before tick 0.
    ///
    /// # Errors
    /// If `id` is no member.
    pub fn appoint(&mut self, id: u32) -> Result<(), Refusal> {
        self.members.get(id).ok_or(Refusal::UnknownController)?;
        self.members.hand_over(id, None);
        Ok(())
    }
}

/// One tick.
impl Authority {
    /// Opens tick `tick`; torques for it are on time until `grace_ns`.
    pub fn open(&mut self, tick: u64, grace_ns: u64) {
        self.members.open(self.open.squeezed);
        self.journal.open();
        self.open = OpenTick { tick, grace_ns, ..OpenTick::default() };
    }

    /// Moves the grace deadline of the open tick: it counts from the publication of the state. In a `squeezed` tick the
    /// plant published so late that less than half of the grace is left: nobody is blamed for being late then.
    pub fn grace_until(&mut self, grace_ns: u64, squeezed: bool) {
        self.open.grace_ns = grace_ns;
        self.open.squeezed = squeezed;
    }

    /// Judges a torque that arrived; returns what is to act from now on, if anything new is.
    pub fn offer(&mut self, torque: &Torque, arrived_ns: u64) -> Option<Applied> {
        // A loop that was kept from running finds a late torque before it has looked at the clock: the tick is missed
        // all the same, and a standby that was in time goes first.
        let taken_over = if arrived_ns > self.open.grace_ns { self.grace_passed(arrived_ns) } else { None };
        let writer = self.members.get(torque.writer);
        let accepted = judgement::accept(torque, arrived_ns, writer, &self.open, self.links);
        self.members.note(torque, accepted, self.open.squeezed);
        self.write_down(torque, arrived_ns, accepted.acceptance);
        taken_over.or_else(|| self.decide(arrived_ns))
    }

    /// The grace deadline of the open tick has passed (once a tick): a standby takes over, or the tick is missed.
    pub fn grace_passed(&mut self, now_ns: u64) -> Option<Applied> {
        if std::mem::replace(&mut self.open.grace_passed, true) || self.is_settled() {
            return None;
        }
        let applied = self.decide(now_ns);
        self.journal.counters.missed += u64::from(applied.is_none());
        applied
    }

    /// Notes a torque that came after the cut-off of the open tick, or belongs to an earlier one: never applied. A
    /// standby's answer in time that had not been looked at yet is noted as such.
    pub fn too_late(&mut self, torque: &Torque, arrived_ns: u64) {
        if torque.tick == self.open.tick && self.is_settled() {
            // Settled: whatever it is, it can't act any more.
            let in_time = torque.published_ns <= self.open.grace_ns;
            let unused = self.offer(torque, if in_time { torque.published_ns } else { u64::MAX });
            debug_assert!(unused.is_none(), "a settled tick applies nothing more");
        } else {
            self.came_late(torque, arrived_ns);
        }
    }

    /// Notes a torque whose own tick is over: never applied. Its receipt says that the writer answers, and too late.
    pub fn came_late(&mut self, torque: &Torque, arrived_ns: u64) {
        if self.members.get(torque.writer).is_some() {
            self.write_down(torque, arrived_ns, Acceptance::Stale);
        } else {
            self.journal.count(Acceptance::Stale, torque);
        }
    }

    /// Counts a torque of the open tick `tick` that no place was left for, since the members' answers need them.
    pub fn count_unheard(&mut self, torque: &Torque, tick: u64) {
        let acceptance = match self.members.get(torque.writer) {
            None => Acceptance::UnknownWriter,
            Some(_) if torque.tick != tick => Acceptance::Stale,
            Some(_) => Acceptance::Duplicate,
        };
        self.journal.count(acceptance, torque);
    }

    fn write_down(&mut self, torque: &Torque, arrived_ns: u64, acceptance: Acceptance) {
        let is_member = |id| self.members.get(id).is_some();
        self.journal.count(acceptance, torque);
        self.journal.note_receipt(torque, arrived_ns, acceptance, is_member);
    }

    /// Decides the open tick by what has come so far, and carries the decision out.
    fn decide(&mut self, now_ns: u64) -> Option<Applied> {
        let fade = self.swaps.fade(self.open.tick);
        let judgement = judgement::decide(&self.members, &self.open, fade, self.swaps.is_watched())?;
        let Judgement { decision, torque, replacement } = judgement;
        match replacement {
            Some(Replacement::StandsIn) => self.stand_in(torque.writer),
            Some(Replacement::TakesOver) => self.fail_over(torque.writer),
            None => {}
        }
        self.open.decision = Some(decision);
        self.journal.note_torque(torque.writer);
        Some(Applied {
            tau: torque.tau,
            from_ns: now_ns,
            writer: torque.writer,
            epoch: self.members.active().1,
            setpoint: [torque.q_d, torque.v_d, torque.a_d],
        })
    }

    fn stand_in(&mut self, standby: u32) {
        let (active, _) = self.members.active();
        self.journal.note(HappeningKind::StoodIn, standby, u64::from(active), 0.0);
    }

    fn fail_over(&mut self, standby: u32) {
        let (failed, _) = self.members.active();
        self.members.hand_over(standby, Some(failed));
        self.swaps.supersede(failed, Refusal::Deadlines, self.open.tick);
        self.journal.counters.failovers += 1;
        self.journal.note(HappeningKind::Failover, standby, u64::from(failed), 0.0);
    }
}

/// Swaps, by command and between two ticks.
impl Authority {
    /// Notes a swap asked for by command; the answer is its state by now.
    pub fn request_swap(&mut self, command: &Command) -> Reply {
        if self.members.get(command.controller).is_none() {
            return replies::refused(Refusal::UnknownController);
        }
        if command.tick != 0 && command.tick <= self.open.tick && self.journal.counters.ticks > 0 {
            return replies::refused(Refusal::TickPassed);
        }
        self.swaps.request(command, self.open.tick)
    }

    /// How the swap to controller `to` is doing. One that was never asked for counts as pending.
    #[must_use]
    pub fn swap_status(&self, to: u32) -> Reply {
        self.swaps.status(to)
    }

    /// Forgets the swap to controller `to` if it still waits; how it is doing by now.
    pub fn cancel_swap(&mut self, to: u32) -> Reply {
        if self.swaps.cancel(to, self.open.tick) {
            self.journal.note(HappeningKind::SwapRefused, to, u64::from(Refusal::Cancelled.code()), 0.0);
        }
        self.swaps.status(to)
    }

    /// Carries out what is due at the boundary before `tick`: rollback first, then at most one swap. `bound_held`: V was
    /// not above its certified bound in the tick before. Call before [`Authority::open`], while the answers of the tick
    /// before are still there.
    pub(crate) fn switch_if_due(&mut self, tick: u64, bound_held: bool, levels: &impl CertifiedLevels) {
        let missed = !self.open.squeezed && !self.members.active_member().is_some_and(|m| m.has_answered_in_time());
        if let Some(rollback) = self.swaps.watch(tick, &self.members, missed, bound_held) {
            self.members.hand_over(rollback.to, None);
            self.journal.note(HappeningKind::Rollback, rollback.to, u64::from(rollback.reason.code()), 0.0);
        }
        let Some(due) = self.swaps.take_due(tick, &self.members, levels) else { return };
        match due.outcome {
            Ok(step_nm) => {
                let (from, _) = self.members.active();
                self.members.hand_over(due.to, None);
                self.swaps.switched(&due, from, tick, step_nm);
                self.journal.note(HappeningKind::Swap, due.to, u64::from(from), step_nm);
            }
            Err(refused) => {
                let reason = u64::from(refused.reason.code());
                self.journal.note(HappeningKind::SwapRefused, due.to, reason, refused.found);
            }
        }
    }
}
