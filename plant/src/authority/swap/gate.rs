//! The gate: whether a controller may take over at a tick boundary. A pure function of the request, the members with
//! their answers to the tick before, the rules, and V at the present state.

use loopbound_shared::event::Refusal;
use loopbound_shared::sample::{Links, Torque};

use super::{Request, SwapRules};
use crate::authority::members::{Member, Members};

/// What the plant's physics says of a controller's law.
pub(crate) trait CertifiedLevels {
    /// V and the certified level of controller `id`'s law at the present state; `None` where nothing is certified.
    fn level(&self, id: u32) -> Option<(f64, f64)>;
}

/// Why the gate does not pass, with the number found and the one allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::authority) struct Refused {
    pub(in crate::authority) reason: Refusal,
    pub(in crate::authority) found: f64,
    pub(in crate::authority) allowed: f64,
}

impl Refused {
    fn new(reason: Refusal, found: f64, allowed: f64) -> Self {
        Self { reason, found, allowed }
    }

    /// Whether waiting can't change it.
    pub(super) fn is_hopeless(&self) -> bool {
        matches!(self.reason, Refusal::UnknownController | Refusal::AlreadyActive | Refusal::Gone | Refusal::TickPassed)
    }
}

/// The largest torque step of one joint (N·m) if the gate passes at the boundary before `tick`. `last_tick` is that of the
/// last switch.
pub(super) fn gate(
    request: &Request,
    tick: u64,
    members: &Members,
    rules: &SwapRules,
    last_tick: Option<u64>,
    levels: &impl CertifiedLevels,
) -> Result<f64, Refused> {
    let (to, answer) = is_safe(request.to, members, rules)?;
    let old = members.active_member().and_then(|active| active.answer);
    let step_nm = old.map_or(0.0, |old| largest_step(&old.tau, &answer.tau));
    if request.force {
        return Ok(step_nm);
    }
    if to.streak < rules.consecutive {
        return Err(not_on_time(to.streak, rules));
    }
    if let Some(last) = last_tick
        && tick < last + rules.dwell_ticks
    {
        #[expect(clippy::cast_precision_loss, reason = "for display")]
        return Err(Refused::new(Refusal::Dwell, (tick - last) as f64, rules.dwell_ticks as f64));
    }
    if request.blend_ticks == 0 && step_nm > rules.torque_step_nm {
        return Err(Refused::new(Refusal::TorqueStep, step_nm, rules.torque_step_nm));
    }
    match levels.level(request.to) {
        Some((v, level)) if v > level => Err(Refused::new(Refusal::OutsideLevel, v, level)),
        _ => Ok(step_nm),
    }
}

/// The checks that nobody may skip: `to` is a member and not active, is not fenced, and has answered within the limits. An
/// answer that is not finite never gets as far as here.
fn is_safe<'a>(to: u32, members: &'a Members, rules: &SwapRules) -> Result<(&'a Member, Torque), Refused> {
    if to == members.active().0 {
        return Err(Refused::new(Refusal::AlreadyActive, 0.0, 0.0));
    }
    let member = members.get(to).ok_or(Refused::new(Refusal::Gone, 0.0, 0.0))?;
    let answer = member.answer.ok_or(not_on_time(0, rules))?;
    if member.is_fenced() {
        return Err(not_on_time(member.streak, rules));
    }
    let beyond = answer.tau.iter().zip(&rules.torque_limit_nm).find(|(tau, limit)| tau.abs() > **limit);
    match beyond {
        Some((tau, limit)) => Err(Refused::new(Refusal::NotFinite, *tau, *limit)),
        None => Ok((member, answer)),
    }
}

fn not_on_time(streak: u32, rules: &SwapRules) -> Refused {
    Refused::new(Refusal::NotOnTime, f64::from(streak), f64::from(rules.consecutive))
}

fn largest_step(old: &Links, new: &Links) -> f64 {
    old.iter().zip(new).map(|(old, new)| (old - new).abs()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::authority::judgement::{Accepted, Quality};
    use loopbound_scenario::Scenario;
    use loopbound_shared::event::Acceptance;

    /// V, and the level that every law is certified to.
    struct AtV(f64);

    impl CertifiedLevels for AtV {
        fn level(&self, _: u32) -> Option<(f64, f64)> {
            Some((self.0, 1.0))
        }
    }

    /// Members 1 (active, with torque 10), 2 (with torque 12, for `streak` ticks) and 3 (silent).
    fn members(streak: u32) -> Members {
        let mut members = Members::new();
        (1..=3).for_each(|id| assert_eq!(members.add(id), Ok(true)));
        members.hand_over(1, None);
        for _ in 0..streak {
            members.open(false);
            for (writer, tau) in [(1, 10.0), (2, 12.0)] {
                let mut torque = Torque { writer, ..Torque::zeroed() };
                torque.tau[0] = tau;
                members.note(&torque, Accepted { acceptance: Acceptance::None, quality: Quality::OnTime }, false);
            }
        }
        members
    }

    const REQUEST: Request = Request { to: 2, at_tick: 0, blend_ticks: 0, force: false, since_tick: 0 };

    #[test]
    fn the_gate_passes_with_the_step_or_names_the_first_check_that_fails_with_its_numbers() {
        let rules = SwapRules { consecutive: 20, torque_step_nm: 3.0, dwell_ticks: 50, ..rules() };
        let strict = SwapRules { torque_step_nm: 1.5, ..rules };
        let limited = SwapRules { torque_limit_nm: [11.0; 7], ..rules };
        let (force, to_active) = (Request { force: true, ..REQUEST }, Request { to: 1, ..REQUEST });
        let (to_silent, to_nobody) = (Request { to: 3, ..REQUEST }, Request { to: 4, ..REQUEST });
        let faded = Request { blend_ticks: 5, ..REQUEST };
        let refused = |reason, found, allowed| Err(Refused::new(reason, found, allowed));
        for (request, streak, rules, last, v, expected) in [
            (REQUEST, 20, rules, None, 1.0, Ok(2.0)),
            (REQUEST, 20, rules, Some(50), 1.0, Ok(2.0)),
            (REQUEST, 20, rules, Some(51), 1.0, refused(Refusal::Dwell, 49.0, 50.0)),
            (REQUEST, 19, rules, None, 1.0, refused(Refusal::NotOnTime, 19.0, 20.0)),
            (REQUEST, 20, strict, None, 1.0, refused(Refusal::TorqueStep, 2.0, 1.5)),
            (faded, 20, strict, None, 1.0, Ok(2.0)),
            (REQUEST, 20, rules, None, 1.25, refused(Refusal::OutsideLevel, 1.25, 1.0)),
            (force, 1, strict, Some(99), 1.25, Ok(2.0)),
            (force, 1, limited, None, 1.0, refused(Refusal::NotFinite, 12.0, 11.0)),
            (to_silent, 20, rules, None, 1.0, refused(Refusal::NotOnTime, 0.0, 20.0)),
            (to_active, 20, rules, None, 1.0, refused(Refusal::AlreadyActive, 0.0, 0.0)),
            (to_nobody, 20, rules, None, 1.0, refused(Refusal::Gone, 0.0, 0.0)),
        ] {
            let found = gate(&request, 100, &members(streak), &rules, last, &AtV(v));
            assert_eq!(found, expected, "{request:?}, streak {streak}, last {last:?}, V {v}");
        }
    }

    #[test]
    fn nobody_can_force_a_swap_to_a_fenced_controller() {
        let mut members = members(5);
        members.hand_over(3, Some(2));
        let forced = Request { force: true, ..REQUEST };
        assert_eq!(gate(&forced, 100, &members, &rules(), None, &AtV(0.0)).unwrap_err().reason, Refusal::NotOnTime);
    }

    fn rules() -> SwapRules {
        SwapRules::of(&Scenario::default())
    }
}
