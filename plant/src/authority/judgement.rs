//! One tick's judgement, as two pure functions: what one torque is worth ([`accept`]), and which torque acts by what has
//! come so far ([`decide`]). Both read the members and the open tick, and change neither.

use loopbound_model::law::faded;
use loopbound_shared::event::{Acceptance, Decision};
use loopbound_shared::sample::{Torque, torque_flag};

use super::members::{Member, Members, Standing};

/// The open tick, as far as its torques are judged by it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct OpenTick {
    pub(super) tick: u64,
    /// Torques are on time until then.
    pub(super) grace_ns: u64,
    /// It leaves too little time to answer, by the plant's own lateness.
    pub(super) squeezed: bool,
    /// The loop has seen the grace deadline pass.
    pub(super) grace_passed: bool,
    /// What was decided, once that is.
    pub(super) decision: Option<Decision>,
}

/// What a torque is as an answer of its writer to the open tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quality {
    /// None: of a stranger, for another tick, or a second one.
    NoAnswer,
    /// Nothing that could act.
    Bad,
    /// Good, after the grace deadline.
    Late,
    /// Good and on time.
    OnTime,
}

/// How a torque is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Accepted {
    pub(super) acceptance: Acceptance,
    pub(super) quality: Quality,
}

/// Judges one torque of `writer`, if that is a member, in a group with `links` links.
pub(super) fn accept(
    torque: &Torque,
    arrived_ns: u64,
    writer: Option<&Member>,
    open: &OpenTick,
    links: u32,
) -> Accepted {
    let no_answer = |acceptance| Accepted { acceptance, quality: Quality::NoAnswer };
    let Some(member) = writer else { return no_answer(Acceptance::UnknownWriter) };
    if torque.tick != open.tick {
        return no_answer(Acceptance::Stale);
    }
    if member.heard {
        return no_answer(Acceptance::Duplicate);
    }
    if let Some(acceptance) = fault_of(torque, member, links) {
        return Accepted { acceptance, quality: Quality::Bad };
    }
    let on_time = is_on_time(torque, arrived_ns, member, open);
    let acceptance = match (member.standing, on_time) {
        (Standing::Fenced { .. }, true) if member.returns_with_this_answer() => Acceptance::Standby,
        (Standing::Fenced { .. }, _) => Acceptance::Fenced,
        (Standing::Active, true) if open.decision.is_none() => Acceptance::Applied,
        (Standing::Active, false) if open.decision.is_none() => Acceptance::Late,
        (_, true) => Acceptance::Standby,
        (_, false) => Acceptance::LateUnused,
    };
    Accepted { acceptance, quality: if on_time { Quality::OnTime } else { Quality::Late } }
}

/// Why an answer can't act, whenever it came.
fn fault_of(torque: &Torque, member: &Member, links: u32) -> Option<Acceptance> {
    match member.standing {
        Standing::Fenced { since_epoch } if torque.epoch < since_epoch => Some(Acceptance::Fenced),
        _ if torque.flags & torque_flag::WITHHELD != 0 => Some(Acceptance::Withheld),
        _ if torque.links != links => Some(Acceptance::Malformed),
        _ if !torque.tau.iter().all(|x| x.is_finite()) => Some(Acceptance::NotFinite),
        _ => None,
    }
}

/// A standby's answer may lie unread until the active one's is missing, so its own stamp counts; but only one that can be
/// true: a clock that jumped is no excuse.
fn is_on_time(torque: &Torque, arrived_ns: u64, member: &Member, open: &OpenTick) -> bool {
    let stamp_is_possible = (torque.state_published_ns..=arrived_ns).contains(&torque.published_ns);
    let was_in_time = stamp_is_possible && torque.published_ns <= open.grace_ns && member.standing != Standing::Active;
    arrived_ns <= open.grace_ns || was_in_time
}

/// A cross-fade in the open tick: the controller that is faded from, and the weight of the active one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fade {
    pub(super) from: u32,
    pub(super) weight: f64,
}

/// What a standby whose torque acts becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Replacement {
    /// It stays a standby: nobody is to blame, or the rule of misses decides after a switch.
    StandsIn,
    /// It becomes the active controller, and the failed one is fenced.
    TakesOver,
}

/// Which torque acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Judgement {
    pub(super) decision: Decision,
    /// The torque that acts, with its writer and its setpoint; in a cross-fade τ is the combination.
    pub(super) torque: Torque,
    /// Set where it is a standby's.
    pub(super) replacement: Option<Replacement>,
}

/// Decides the open tick by what has come so far; none while the answer that would decide it is missing, and none once it
/// is decided. `on_probation`: a switch is being watched.
pub(super) fn decide(members: &Members, open: &OpenTick, fade: Option<Fade>, on_probation: bool) -> Option<Judgement> {
    if open.decision.is_some() {
        return None;
    }
    let active = members.active_member();
    match active.and_then(|active| Some((active, active.answer?))) {
        Some((active, answer)) if active.on_time => in_time(members, open, fade, answer),
        Some((_, answer)) => Some(acts(Decision::ActiveLate, answer)),
        None => instead_of(active, members, open, on_probation),
    }
}

fn acts(decision: Decision, torque: Torque) -> Judgement {
    Judgement { decision, torque, replacement: None }
}

/// The active controller's answer is there. In a cross-fade that of the old one is waited for, until the grace deadline.
fn in_time(members: &Members, open: &OpenTick, fade: Option<Fade>, new: Torque) -> Option<Judgement> {
    let fading = fade.filter(|_| !open.grace_passed).and_then(|fade| Some((fade, members.get(fade.from)?)));
    let Some((fade, from)) = fading else { return Some(acts(Decision::Active, new)) };
    let old = from.answer?;
    let mut blended = new;
    for (tau, old) in blended.tau.iter_mut().zip(old.tau) {
        *tau = faded(fade.weight, *tau, old);
    }
    Some(acts(Decision::Blend, blended))
}

/// The active controller has left, or has failed visibly in this tick, or its time is over: the first standby that is
/// ready acts in its place.
fn instead_of(active: Option<&Member>, members: &Members, open: &OpenTick, on_probation: bool) -> Option<Judgement> {
    if active.is_some_and(|active| !active.heard) && !open.grace_passed {
        return None;
    }
    let (_, torque) = members.ready_standby()?;
    let only_silent = active.is_some_and(|active| !active.heard);
    let replacement = match only_silent && (open.squeezed || on_probation) {
        true => Replacement::StandsIn,
        false => Replacement::TakesOver,
    };
    Some(Judgement { decision: Decision::Standby, torque, replacement: Some(replacement) })
}

#[cfg(test)]
mod tests;
