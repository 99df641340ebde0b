//! Who is obeyed. The plant is the sole arbiter: it knows the members, judges every torque that comes, and changes
//! authority at tick boundaries (by command) or within a tick (failover).
//!
//! Terms: the *active* controller is obeyed; *standbys* answer every state too; a *fenced* one has failed, and what it
//! says is counted and never applied until it has heard of the newer epoch and answered well for a while. The *epoch*
//! counts changes of authority. No clock and no physics here: the loops say when something arrived and when the grace
//! deadline has passed.

use loopbound_model::law::faded;
use loopbound_shared::event::{Acceptance, Decision, HappeningKind, Refusal, ReplyKind};
use loopbound_shared::sample::{
    Counters, HAPPENINGS_MAX, Happening, Links, RECEIPTS_MAX, Receipt, Torque, torque_flag,
};

use crate::swap::{Pending, SwapRules, Watch};

#[cfg(test)]
mod tests;

/// Whether a member is obeyed, ready to be, or neither.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// It is obeyed.
    Active,
    /// It answers, and takes over when needed.
    Standby,
    /// It has failed: nothing of it is applied. Answers from before this epoch don't count towards its return.
    Fenced {
        /// The epoch that began when it was fenced.
        since_epoch: u32,
    },
}

/// A controller that belongs to the group.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Member {
    pub(crate) id: u32,
    pub(crate) standing: Standing,
    /// Its good torque for the open tick.
    pub(crate) answer: Option<Torque>,
    /// Whether anything of it came in the open tick, good or not.
    heard: bool,
    /// Whether that was good and on time, also of a fenced one.
    good: bool,
    /// On-time, finite answers in a row.
    pub(crate) streak: u32,
}

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
    /// The tick of that setpoint.
    pub setpoint_tick: u64,
}

/// On-time answers after which a fenced controller is a standby again.
const READMIT_AFTER: u32 = 20;

/// The members, who of them is obeyed, and what came in the open tick. Allocates at construction only.
pub struct Authority {
    pub(crate) members: [Option<Member>; RECEIPTS_MAX],
    pub(crate) active: u32,
    pub(crate) epoch: u32,
    pub(crate) tick: u64,
    grace_ns: u64,
    links: u32,
    decision: Option<Decision>,
    grace_passed: bool,
    /// The open tick leaves too little time to answer, by the plant's own lateness.
    pub(crate) squeezed: bool,
    had_torque: bool,
    receipts: [Receipt; RECEIPTS_MAX],
    happenings: [Happening; HAPPENINGS_MAX],
    happenings_used: usize,
    pub(crate) swaps: Pending,
    pub(crate) watch: Option<Watch>,
    pub(crate) rules: SwapRules,
    /// Counts since the start.
    pub counters: Counters,
}

impl Authority {
    /// No members, nobody obeyed.
    #[must_use]
    pub fn new(links: usize, rules: SwapRules) -> Self {
        Self {
            members: [None; RECEIPTS_MAX],
            active: 0,
            epoch: 0,
            tick: 0,
            grace_ns: 0,
            links: u32::try_from(links).unwrap_or(0),
            decision: None,
            grace_passed: false,
            squeezed: false,
            had_torque: false,
            receipts: [Receipt::zeroed(); RECEIPTS_MAX],
            happenings: [Happening::zeroed(); HAPPENINGS_MAX],
            happenings_used: 0,
            swaps: Pending::new(),
            watch: None,
            rules,
            counters: Counters::zeroed(),
        }
    }

    /// Who is obeyed, and the epoch.
    #[must_use]
    pub fn active(&self) -> (u32, u32) {
        (self.active, self.epoch)
    }

    /// The open tick.
    #[must_use]
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// Moves the grace deadline of the open tick: it counts from the publication of the state. In a `squeezed` tick the
    /// plant published so late that less than half of the grace is left: nobody is blamed for being late then.
    pub fn grace_until(&mut self, grace_ns: u64, squeezed: bool) {
        (self.grace_ns, self.squeezed) = (grace_ns, squeezed);
    }

    /// Counts a torque that came when its tick was over.
    pub fn count_stale(&mut self) {
        self.counters.stale += 1;
    }

    /// Notes a torque whose own tick is over: never applied. Its receipt says that the writer answers, and too late.
    pub fn came_late(&mut self, torque: &Torque, arrived_ns: u64) {
        self.count(Acceptance::Stale, torque);
        if self.member(torque.writer).is_some() {
            self.note_receipt(torque, arrived_ns, Acceptance::Stale);
        }
    }

    /// Counts a torque of the open tick `tick` that no place was left for, since the members' answers need them.
    pub fn count_unheard(&mut self, torque: &Torque, tick: u64) {
        let acceptance = match self.member(torque.writer) {
            None => Acceptance::UnknownWriter,
            Some(_) if torque.tick != tick => Acceptance::Stale,
            Some(_) => Acceptance::Duplicate,
        };
        self.count(acceptance, torque);
    }

    /// Notes a torque that came after the cut-off of the open tick, or belongs to an earlier one: never applied. A
    /// standby's answer in time that had not been looked at yet is noted as such.
    pub fn too_late(&mut self, torque: &Torque, arrived_ns: u64) {
        let in_time = torque.tick == self.tick && torque.published_ns <= self.grace_ns;
        if in_time && self.is_settled() {
            // Settled: whatever it is, it can't act any more.
            let unused = self.offer(torque, torque.published_ns);
            debug_assert!(unused.is_none(), "a settled tick applies nothing more");
        } else if torque.tick == self.tick && self.is_settled() {
            let _ = self.offer(torque, u64::MAX);
        } else {
            self.came_late(torque, arrived_ns);
        }
    }

    /// Ids of the members that a tick has to wait for in lockstep.
    pub fn member_ids(&self) -> impl Iterator<Item = u32> + '_ {
        self.members.iter().flatten().map(|m| m.id)
    }

    pub(crate) fn member(&mut self, id: u32) -> Option<&mut Member> {
        self.members.iter_mut().flatten().find(|m| m.id == id)
    }

    /// Admits a controller as a standby, or back as one.
    ///
    /// # Errors
    /// If there is no room, or the id is 0.
    pub fn add(&mut self, id: u32) -> Result<(), Refusal> {
        if id == 0 {
            return Err(Refusal::BadCommand);
        }
        if self.member(id).is_none() {
            let place = self.members.iter_mut().find(|m| m.is_none()).ok_or(Refusal::Busy)?;
            *place =
                Some(Member { id, standing: Standing::Standby, answer: None, heard: false, good: false, streak: 0 });
            self.happen(HappeningKind::MemberAdded, id, 0, 0.0);
        }
        Ok(())
    }

    /// Forgets a controller that is dead or retired; what it may still say is of an unknown writer.
    ///
    /// # Errors
    /// If it is no member.
    pub fn remove(&mut self, id: u32) -> Result<(), Refusal> {
        let place =
            self.members.iter_mut().find(|m| m.is_some_and(|m| m.id == id)).ok_or(Refusal::UnknownController)?;
        *place = None;
        self.happen(HappeningKind::MemberRemoved, id, 0, 0.0);
        Ok(())
    }

    /// Gives authority at the start, before tick 0.
    ///
    /// # Errors
    /// If `id` is no member.
    pub fn appoint(&mut self, id: u32) -> Result<(), Refusal> {
        self.member(id).ok_or(Refusal::UnknownController)?;
        self.hand_over(id, None);
        Ok(())
    }

    /// Makes `id` the active controller in a new epoch. The one before becomes a standby, or is fenced.
    pub(crate) fn hand_over(&mut self, id: u32, fence: Option<u32>) {
        self.epoch += 1;
        let epoch = self.epoch;
        for member in self.members.iter_mut().flatten() {
            if member.id == id {
                member.standing = Standing::Active;
            } else if fence == Some(member.id) {
                member.standing = Standing::Fenced { since_epoch: epoch };
                member.streak = 0;
            } else if member.standing == Standing::Active {
                member.standing = Standing::Standby;
            }
        }
        self.active = id;
    }

    /// Opens tick `tick`; torques for it are on time until `grace_ns`.
    pub fn open(&mut self, tick: u64, grace_ns: u64) {
        (self.tick, self.grace_ns) = (tick, grace_ns);
        (self.decision, self.grace_passed) = (None, false);
        let squeezed = std::mem::replace(&mut self.squeezed, false);
        self.receipts = [Receipt::zeroed(); RECEIPTS_MAX];
        for member in self.members.iter_mut().flatten() {
            // Nothing good came in the tick before: the streak is over.
            if !member.good && !squeezed {
                member.streak = 0;
            }
            member.answer = None;
            (member.heard, member.good) = (false, false);
        }
    }

    pub(crate) fn happen(&mut self, kind: HappeningKind, subject: u32, detail: u64, value: f64) {
        if let Some(place) = self.happenings.get_mut(self.happenings_used) {
            *place = Happening { kind: kind.code(), subject, detail, value };
            self.happenings_used += 1;
        }
    }

    /// What happened since this was last called.
    pub fn take_happenings(&mut self) -> ([Happening; HAPPENINGS_MAX], usize) {
        let taken = (self.happenings, self.happenings_used);
        (self.happenings, self.happenings_used) = ([Happening::zeroed(); HAPPENINGS_MAX], 0);
        taken
    }

    /// The receipts of the open tick, and how many there are.
    #[must_use]
    pub fn receipts(&self) -> (&[Receipt; RECEIPTS_MAX], usize) {
        (&self.receipts, self.receipts.iter().filter(|r| r.writer != 0).count())
    }

    /// The decision on the open tick, once there is one.
    #[must_use]
    pub fn decision(&self) -> Option<Decision> {
        self.decision
    }

    /// Whether some torque of the open tick acts or will.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.decision.is_some()
    }

    /// Judges a torque that arrived; returns what is to act from now on, if anything new is.
    pub fn offer(&mut self, torque: &Torque, arrived_ns: u64) -> Option<Applied> {
        // A loop that was kept from running finds a late torque before it has looked at the clock: the tick is missed
        // all the same, and a standby that was in time goes first.
        let taken_over = if arrived_ns > self.grace_ns { self.grace_passed(arrived_ns) } else { None };
        let used = self.consider(torque, arrived_ns);
        debug_assert!(taken_over.is_none() || used.is_none(), "a tick is settled once");
        taken_over.or(used)
    }

    fn consider(&mut self, torque: &Torque, arrived_ns: u64) -> Option<Applied> {
        let acceptance = self.judge(torque, arrived_ns);
        self.count(acceptance, torque);
        self.note_receipt(torque, arrived_ns, acceptance);
        match acceptance {
            Acceptance::Standby if self.active_failed() => self.fail_over(arrived_ns),
            Acceptance::Applied if self.blending() => self.blend_if_complete(arrived_ns),
            Acceptance::Applied => Some(self.settle(Decision::Active, torque, arrived_ns)),
            Acceptance::Late => Some(self.settle(Decision::ActiveLate, torque, arrived_ns)),
            Acceptance::Standby if self.blending() => self.blend_if_complete(arrived_ns),
            // The active one has failed visibly in this tick, or its time is over: this standby takes over.
            Acceptance::LateUnused if self.active_failed() => self.fail_over(arrived_ns),
            Acceptance::NotFinite | Acceptance::Malformed | Acceptance::Withheld if self.active_failed() => {
                self.fail_over(arrived_ns)
            }
            _ => None,
        }
    }

    /// The grace deadline of the open tick has passed (once a tick): a standby takes over, or the tick is missed.
    pub fn grace_passed(&mut self, now_ns: u64) -> Option<Applied> {
        if std::mem::replace(&mut self.grace_passed, true) || self.decision.is_some() {
            return None;
        }
        // In a blend the new controller's torque alone will do: the old one is on its way out.
        let active = self.active;
        if let Some(answer) = self.member(active).and_then(|m| m.answer) {
            return Some(self.settle(Decision::Active, &answer, now_ns));
        }
        let taken_over = self.fail_over(now_ns);
        if taken_over.is_none() {
            self.counters.missed += 1;
        }
        taken_over
    }

    fn judge(&mut self, torque: &Torque, arrived_ns: u64) -> Acceptance {
        let (tick, links, grace_ns, settled) = (self.tick, self.links, self.grace_ns, self.decision.is_some());
        let squeezed = self.squeezed;
        let Some(member) = self.member(torque.writer) else { return Acceptance::UnknownWriter };
        if torque.tick != tick {
            return Acceptance::Stale;
        }
        if member.heard {
            return Acceptance::Duplicate;
        }
        member.heard = true;
        if let Standing::Fenced { since_epoch } = member.standing
            && torque.epoch < since_epoch
        {
            return Acceptance::Fenced;
        }
        if torque.flags & torque_flag::WITHHELD != 0 {
            return Acceptance::Withheld;
        }
        if torque.links != links {
            return Acceptance::Malformed;
        }
        if !torque.tau.iter().all(|x| x.is_finite()) {
            return Acceptance::NotFinite;
        }
        // A standby's answer may lie unread until the active one's is missing, so its own stamp counts; but only one
        // that can be true: a clock that jumped is no excuse.
        let stamp_is_possible = (torque.state_published_ns..=arrived_ns).contains(&torque.published_ns);
        let was_in_time = stamp_is_possible && torque.published_ns <= grace_ns && member.standing != Standing::Active;
        let on_time = arrived_ns <= grace_ns || was_in_time;
        member.good = on_time;
        if on_time {
            member.streak = member.streak.saturating_add(1);
            if matches!(member.standing, Standing::Fenced { .. }) && member.streak >= READMIT_AFTER {
                member.standing = Standing::Standby;
            }
        } else if !squeezed {
            member.streak = 0;
        }
        if matches!(member.standing, Standing::Fenced { .. }) {
            // Kept as "answered" only by its streak: a fenced torque is never within reach of a failover.
            member.answer = None;
            return Acceptance::Fenced;
        }
        member.answer = Some(*torque);
        match (member.standing, on_time) {
            (Standing::Active, true) if !settled => Acceptance::Applied,
            (Standing::Active, false) if !settled => Acceptance::Late,
            (_, true) => Acceptance::Standby,
            (_, false) => Acceptance::LateUnused,
        }
    }

    fn count(&mut self, acceptance: Acceptance, torque: &Torque) {
        let counters = &mut self.counters;
        let counter = match acceptance {
            Acceptance::Late | Acceptance::LateUnused => &mut counters.late,
            Acceptance::Stale => &mut counters.stale,
            Acceptance::NotFinite => &mut counters.not_finite,
            Acceptance::Malformed => &mut counters.malformed,
            Acceptance::UnknownWriter => &mut counters.unknown_writer,
            Acceptance::Fenced => &mut counters.fenced,
            Acceptance::Duplicate => &mut counters.duplicate,
            Acceptance::Withheld => &mut counters.withheld,
            Acceptance::None | Acceptance::Applied | Acceptance::Standby => return self.count_fault(torque),
        };
        *counter += 1;
        self.count_fault(torque);
    }

    fn count_fault(&mut self, torque: &Torque) {
        self.counters.faults_injected += u64::from(torque.flags & torque_flag::FAULT_INJECTED != 0);
    }

    /// The receipt of a writer, or the place for one. There are as many places as members, and what somebody else has taken
    /// makes way for a member's.
    fn receipt_place(&self, writer: u32) -> Option<usize> {
        let is_member = |id: u32| self.members.iter().flatten().any(|m| m.id == id);
        let own = self.receipts.iter().position(|r| r.writer == writer);
        let free = || self.receipts.iter().position(|r| r.writer == 0);
        let in_the_way = || self.receipts.iter().rposition(|r| !is_member(r.writer)).filter(|_| is_member(writer));
        own.or_else(free).or_else(in_the_way)
    }

    fn note_receipt(&mut self, torque: &Torque, arrived_ns: u64, acceptance: Acceptance) {
        // One place a writer: the first answer to this tick, beside which one to an earlier tick leaves its mark only. A second
        // one for this tick is counted and leaves the receipt as it is.
        let Some(place) = self.receipt_place(torque.writer) else { return };
        let receipt = &mut self.receipts[place];
        let is_stale = acceptance == Acceptance::Stale;
        let injected = torque.flags & torque_flag::FAULT_INJECTED != 0;
        let mark = match (is_stale, injected) {
            (true, true) => torque_flag::CAME_LATE | torque_flag::CAME_LATE_INJECTED,
            (true, false) => torque_flag::CAME_LATE,
            (false, _) => 0,
        };
        let own = receipt.writer == torque.writer;
        let kept = if own { receipt.flags & (torque_flag::CAME_LATE | torque_flag::CAME_LATE_INJECTED) } else { 0 };
        let marks = kept | mark;
        if own && (is_stale || receipt.acceptance != Acceptance::Stale.code()) {
            receipt.flags |= marks;
            return;
        }
        *receipt = Receipt {
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
            flags: torque.flags & !(torque_flag::CAME_LATE | torque_flag::CAME_LATE_INJECTED) | marks,
            acceptance: acceptance.code(),
        };
    }

    fn settle(&mut self, decision: Decision, torque: &Torque, from_ns: u64) -> Applied {
        self.decision = Some(decision);
        if !std::mem::replace(&mut self.had_torque, true) {
            self.happen(HappeningKind::FirstTorque, torque.writer, 0, 0.0);
        }
        applied(torque, torque.tau, from_ns, self.epoch)
    }

    /// Whether the open tick can't count on its active controller any more.
    fn active_failed(&mut self) -> bool {
        let (active, passed) = (self.active, self.grace_passed);
        self.decision.is_none() && self.member(active).is_none_or(|m| m.answer.is_none() && (m.heard || passed))
    }

    /// The first standby with a good torque for this very tick is obeyed from now on; the failed one is fenced. The standby
    /// only stands in for this tick where the plant's own lateness left no time, and after a switch, where the rule of
    /// misses decides whether it is taken back.
    fn fail_over(&mut self, now_ns: u64) -> Option<Applied> {
        let ready = |m: &&Member| m.standing == Standing::Standby && m.answer.is_some();
        let (id, answer) = self.members.iter().flatten().find(ready).map(|m| (m.id, m.answer))?;
        let failed = self.active;
        if (self.squeezed || self.watch.is_some()) && self.member(failed).is_some_and(|m| !m.heard) {
            self.happen(HappeningKind::StoodIn, id, u64::from(failed), 0.0);
            return Some(self.settle(Decision::Standby, &answer?, now_ns));
        }
        self.hand_over(id, Some(failed));
        self.swaps.forget_switch();
        self.end_watch_by_failover(failed);
        self.counters.failovers += 1;
        self.happen(HappeningKind::Failover, id, u64::from(failed), 0.0);
        Some(self.settle(Decision::Standby, &answer?, now_ns))
    }

    /// In a cross-fade both torques of the tick are needed; once both are there their convex combination acts.
    fn blend_if_complete(&mut self, now_ns: u64) -> Option<Applied> {
        if self.decision.is_some() {
            return None;
        }
        let (old_id, weight) = self.swaps.blend(self.tick)?;
        let active = self.active;
        let new = self.member(active)?.answer?;
        let Some(old) = self.member(old_id).map(|m| m.answer) else {
            // The old one is gone: nothing to fade from.
            return Some(self.settle(Decision::Active, &new, now_ns));
        };
        let old = old?;
        let mut tau = new.tau;
        for (new, old) in tau.iter_mut().zip(old.tau) {
            *new = faded(weight, *new, old);
        }
        self.decision = Some(Decision::Blend);
        Some(applied(&new, tau, now_ns, self.epoch))
    }

    fn blending(&self) -> bool {
        self.swaps.blend(self.tick).is_some()
    }

    /// Counts the closing tick by its decision.
    pub fn close(&mut self, decision: Decision) {
        let counters = &mut self.counters;
        counters.ticks += 1;
        match decision {
            Decision::Held => counters.held += 1,
            Decision::Damped => counters.damped += 1,
            Decision::Stopped => counters.stopped += 1,
            _ => {}
        }
    }

    /// The answer to a command that is refused.
    #[must_use]
    pub fn refused(reason: Refusal) -> loopbound_shared::sample::Reply {
        loopbound_shared::sample::Reply {
            kind: ReplyKind::Refused.code(),
            reason: reason.code(),
            ..loopbound_shared::sample::Reply::zeroed()
        }
    }
}

fn applied(torque: &Torque, tau: Links, from_ns: u64, epoch: u32) -> Applied {
    Applied {
        tau,
        from_ns,
        writer: torque.writer,
        epoch,
        setpoint: [torque.q_d, torque.v_d, torque.a_d],
        setpoint_tick: torque.setpoint_tick,
    }
}
