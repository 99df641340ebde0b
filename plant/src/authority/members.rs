//! The controllers of the group: which one is active, which stand by, which are fenced, and what each has answered in
//! the open tick. Not responsible for judging an answer: [`super::judgement`] does that, and the result is noted here.

use loopbound_shared::event::Refusal;
use loopbound_shared::sample::{RECEIPTS_MAX, Torque};

use super::judgement::{Accepted, Quality};

/// Good answers in a row, each on time, after which a fenced controller is a standby again.
pub(super) const READMIT_AFTER: u32 = 20;

/// The three states of a member; drawn in [`super`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Standing {
    /// Its torques act.
    Active,
    /// It answers, and takes over when needed.
    Standby,
    /// It has failed: none of its torques acts. Answers from before this epoch don't count towards its return.
    Fenced {
        /// The epoch that began when it was fenced.
        since_epoch: u32,
    },
}

/// A controller that belongs to the group.
#[derive(Clone, Copy, Debug)]
pub(super) struct Member {
    pub(super) id: u32,
    pub(super) standing: Standing,
    /// Its torque for the open tick, if that may act.
    pub(super) answer: Option<Torque>,
    /// Whether it has answered the open tick, well or not.
    pub(super) heard: bool,
    /// Whether that answer was good and on time; a fenced member's counts too.
    pub(super) on_time: bool,
    /// Good answers in a row, each on time.
    pub(super) streak: u32,
}

impl Member {
    /// A new member.
    pub(super) fn standby(id: u32) -> Self {
        Self { id, standing: Standing::Standby, answer: None, heard: false, on_time: false, streak: 0 }
    }

    pub(super) fn is_fenced(&self) -> bool {
        matches!(self.standing, Standing::Fenced { .. })
    }

    /// Whether it has answered the open tick well and, as its streak shows, on time.
    pub(super) fn has_answered_in_time(&self) -> bool {
        self.answer.is_some() && self.streak > 0
    }

    /// Whether one more good answer makes a fenced member a standby.
    pub(super) fn returns_with_this_answer(&self) -> bool {
        self.streak.saturating_add(1) >= READMIT_AFTER
    }

    /// Forgets the answer to the tick that is over. Without a good one on time the streak is over, unless that tick was
    /// `squeezed`.
    fn open(&mut self, was_squeezed: bool) {
        if !self.on_time && !was_squeezed {
            self.streak = 0;
        }
        self.answer = None;
        self.heard = false;
        self.on_time = false;
    }

    /// Notes an answer to the open tick as it was judged.
    fn note(&mut self, torque: &Torque, accepted: Accepted, squeezed: bool) {
        match accepted.quality {
            Quality::NoAnswer => return,
            Quality::Bad => self.heard = true,
            Quality::Late => {
                self.heard = true;
                if !squeezed {
                    self.streak = 0;
                }
            }
            Quality::OnTime => {
                self.heard = true;
                self.on_time = true;
                if self.is_fenced() && self.returns_with_this_answer() {
                    self.standing = Standing::Standby;
                }
                self.streak = self.streak.saturating_add(1);
            }
        }
        // A torque of a fenced member is out of reach of a failover.
        if accepted.quality != Quality::Bad && !self.is_fenced() {
            self.answer = Some(*torque);
        }
    }
}

/// All members, and the epoch, which counts changes of authority.
#[derive(Clone, Copy, Debug)]
pub(super) struct Members {
    places: [Option<Member>; RECEIPTS_MAX],
    active: u32,
    epoch: u32,
}

impl Members {
    /// No members, and no active controller.
    pub(super) fn new() -> Self {
        Self { places: [None; RECEIPTS_MAX], active: 0, epoch: 0 }
    }

    /// The id of the active controller (also after it has left; 0 before the first), and the epoch.
    pub(super) fn active(&self) -> (u32, u32) {
        (self.active, self.epoch)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Member> {
        self.places.iter().flatten()
    }

    pub(super) fn get(&self, id: u32) -> Option<&Member> {
        self.iter().find(|member| member.id == id)
    }

    /// The active controller, if it is still a member.
    pub(super) fn active_member(&self) -> Option<&Member> {
        self.get(self.active)
    }

    /// The first standby with a good torque for the open tick.
    pub(super) fn ready_standby(&self) -> Option<(u32, Torque)> {
        let mut standbys = self.iter().filter(|member| member.standing == Standing::Standby);
        standbys.find_map(|member| Some((member.id, member.answer?)))
    }

    /// Adds a standby; false if it is a member already.
    ///
    /// # Errors
    /// If there is no room, or the id is 0.
    pub(super) fn add(&mut self, id: u32) -> Result<bool, Refusal> {
        if id == 0 {
            return Err(Refusal::BadCommand);
        }
        if self.get(id).is_some() {
            return Ok(false);
        }
        let place = self.places.iter_mut().find(|place| place.is_none()).ok_or(Refusal::Busy)?;
        *place = Some(Member::standby(id));
        Ok(true)
    }

    /// # Errors
    /// If `id` is no member.
    pub(super) fn remove(&mut self, id: u32) -> Result<(), Refusal> {
        let is_it = |place: &&mut Option<Member>| place.is_some_and(|member| member.id == id);
        *self.places.iter_mut().find(is_it).ok_or(Refusal::UnknownController)? = None;
        Ok(())
    }

    /// Makes `id` the active controller in a new epoch. The one before becomes a standby; `fence` is fenced.
    pub(super) fn hand_over(&mut self, id: u32, fence: Option<u32>) {
        self.epoch += 1;
        self.active = id;
        let epoch = self.epoch;
        for member in self.places.iter_mut().flatten() {
            if member.id == id {
                member.standing = Standing::Active;
            } else if fence == Some(member.id) {
                member.standing = Standing::Fenced { since_epoch: epoch };
                member.streak = 0;
            } else if member.standing == Standing::Active {
                member.standing = Standing::Standby;
            }
        }
    }

    /// A new tick opens; in a `squeezed` one before it nobody is blamed for having been late.
    pub(super) fn open(&mut self, was_squeezed: bool) {
        for member in self.places.iter_mut().flatten() {
            member.open(was_squeezed);
        }
    }

    /// Notes a torque as it was judged.
    pub(super) fn note(&mut self, torque: &Torque, accepted: Accepted, squeezed: bool) {
        if let Some(member) = self.places.iter_mut().flatten().find(|member| member.id == torque.writer) {
            member.note(torque, accepted, squeezed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_shared::event::Acceptance;

    /// Members 1 (active), 2 and 3.
    fn three() -> Members {
        let mut members = Members::new();
        (1..=3).for_each(|id| assert_eq!(members.add(id), Ok(true)));
        members.hand_over(1, None);
        members
    }

    fn standings(members: &Members) -> Vec<Standing> {
        members.iter().map(|member| member.standing).collect()
    }

    fn note(members: &mut Members, writer: u32, quality: Quality) {
        let accepted = Accepted { acceptance: Acceptance::Standby, quality };
        members.note(&Torque { writer, ..Torque::zeroed() }, accepted, false);
    }

    #[test]
    fn authority_moves_with_a_new_epoch_and_the_one_before_stands_by_or_is_fenced() {
        use Standing::{Active, Fenced, Standby};
        let mut members = three();
        assert_eq!((members.active(), standings(&members)), ((1, 1), vec![Active, Standby, Standby]));
        members.hand_over(2, None);
        assert_eq!((members.active(), standings(&members)), ((2, 2), vec![Standby, Active, Standby]));
        members.hand_over(3, Some(2));
        let expected = vec![Standby, Fenced { since_epoch: 3 }, Active];
        assert_eq!((members.active(), standings(&members)), ((3, 3), expected));
        // A swap to a fenced member is refused at the gate; a command at the start may name any.
        members.hand_over(2, None);
        assert_eq!(standings(&members), [Standby, Active, Standby]);
        members.remove(2).unwrap();
        assert_eq!((members.active(), members.active_member().is_none()), ((2, 4), true), "the id stays known");
    }

    #[test]
    fn a_fenced_member_stands_by_again_with_its_twentieth_good_answer_and_can_take_over_with_that_very_one() {
        let mut members = three();
        members.hand_over(2, Some(1));
        for answers in 1..=READMIT_AFTER {
            members.open(false);
            note(&mut members, 1, Quality::OnTime);
            let back = answers == READMIT_AFTER;
            assert_eq!(members.get(1).unwrap().is_fenced(), !back, "after {answers}");
            assert_eq!(members.ready_standby().map(|(id, _)| id), back.then_some(1), "after {answers}");
        }
    }

    #[test]
    fn what_is_no_answer_leaves_a_member_as_it_is_and_a_bad_one_leaves_nothing_to_apply() {
        let mut members = three();
        note(&mut members, 2, Quality::NoAnswer);
        assert!(!members.get(2).unwrap().heard);
        note(&mut members, 2, Quality::Bad);
        assert!(members.get(2).unwrap().heard && members.ready_standby().is_none());
        note(&mut members, 3, Quality::Late);
        assert_eq!(members.ready_standby().map(|(id, _)| id), Some(3), "a late one is better than none");
        members.open(false);
        assert!(members.ready_standby().is_none() && members.iter().all(|member| !member.heard));
    }

    #[test]
    fn a_streak_survives_a_tick_that_left_no_time_and_no_other() {
        for (was_squeezed, expected) in [(true, 1), (false, 0)] {
            let mut members = three();
            note(&mut members, 2, Quality::OnTime);
            members.open(false);
            members.open(was_squeezed);
            assert_eq!(members.get(2).unwrap().streak, expected);
        }
    }
}
