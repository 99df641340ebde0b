//! When a loop counts as having run away: one rule for the plant, which stops, and for the monitor, which says *diverged*.
//!
//! A loop has diverged when a value is not finite, when a joint is faster than `plant.speed_limit`, or when V is above
//! 10 · max(c, V(0)). The plant knows the first two and looks at them in every tick; V and its level c are the monitor's,
//! which knows the law in charge. c is the level that the scenario gives, certified or not; for a controller that
//! announced no law there is no V, and the first two decide alone.

use crate::event::RunawayKind;
use loopbound_model::chain::Vector;

/// V may be this many times the larger one of its level and its start.
pub const V_FACTOR: f64 = 10.0;

/// What ran away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Runaway {
    /// Which quantity.
    pub kind: RunawayKind,
    /// The joint, from 1; 0 for V.
    pub joint: u32,
    /// Its value: rad, rad/s, or V. Not finite where that is what is wrong.
    pub value: f64,
    /// The largest value allowed; infinite where only finiteness counts.
    pub limit: f64,
}

/// Looks at a state: q (rad) and q̇ (rad/s) in absolute angles, and the limit of each joint's speed (rad/s), which is the
/// difference of its two links' speeds.
#[must_use]
pub fn of_state<const N: usize>(q: &Vector<N>, v: &Vector<N>, speed_limit_rad_s: f64) -> Option<Runaway> {
    let joint = |at: usize| u32::try_from(at + 1).unwrap_or(u32::MAX);
    for (kind, values) in [(RunawayKind::Angle, q), (RunawayKind::Velocity, v)] {
        if let Some((at, value)) = values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
            return Some(Runaway { kind, joint: joint(at), value: *value, limit: f64::INFINITY });
        }
    }
    let mut before = 0.0;
    for (at, &link) in v.iter().enumerate() {
        let value = link - before;
        before = link;
        if value.abs() > speed_limit_rad_s {
            return Some(Runaway { kind: RunawayKind::Speed, joint: joint(at), value, limit: speed_limit_rad_s });
        }
    }
    None
}

/// Looks at V: its level c, and what it was at the start under the same law.
#[must_use]
pub fn of_v(v: f64, level: f64, v_start: f64) -> Option<Runaway> {
    let limit = V_FACTOR * [level, v_start].into_iter().filter(|x| x.is_finite()).fold(0.0, f64::max);
    (!v.is_finite() || v > limit).then_some(Runaway { kind: RunawayKind::V, joint: 0, value: v, limit })
}

/// Four decimals, with an exponent where the number is too long to be read.
fn readable(value: f64) -> String {
    if value.abs() < 1e6 { format!("{value:.4}") } else { format!("{value:.4e}") }
}

impl std::fmt::Display for Runaway {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { kind, joint, value, limit } = self;
        match kind {
            RunawayKind::V if value.is_finite() => {
                let (value, limit) = (readable(*value), readable(*limit));
                write!(f, "V = {value} is above {limit}, {V_FACTOR} times the larger one of its level and its start")
            }
            RunawayKind::V => write!(f, "V is not a number"),
            RunawayKind::Speed => {
                let value = readable(*value);
                write!(f, "joint {joint} turns at {value} rad/s, faster than plant.speed_limit = {limit} rad/s")
            }
            RunawayKind::Angle => write!(f, "the angle of link {joint} is not finite"),
            RunawayKind::Velocity => write!(f, "the velocity of link {joint} is not finite"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_runs_away_by_a_value_that_is_not_finite_or_by_a_joint_that_is_too_fast() {
        let (q, calm) = (Vector::<2>::new(0.1, -3.0), Vector::<2>::new(90.0, 95.0));
        assert_eq!(of_state(&q, &calm, 100.0), None);
        let found = of_state(&q, &Vector::<2>::new(60.0, -60.0), 100.0).unwrap();
        assert_eq!((found.kind, found.joint, found.value), (RunawayKind::Speed, 2, -120.0));
        let found = of_state(&Vector::<2>::new(f64::NAN, 0.0), &calm, f64::INFINITY).unwrap();
        assert_eq!((found.kind, found.joint), (RunawayKind::Angle, 1));
        let found = of_state(&q, &Vector::<2>::new(0.0, f64::NEG_INFINITY), f64::INFINITY).unwrap();
        assert_eq!((found.kind, found.joint), (RunawayKind::Velocity, 2));
        assert!(found.to_string().contains("velocity of link 2"), "{found}");
    }

    #[test]
    fn v_runs_away_beyond_ten_times_its_level_or_its_start_and_when_it_is_no_number() {
        assert_eq!(of_v(60.0, 6.0, 1.0), None);
        assert_eq!(of_v(200.0, 6.0, 20.0), None);
        assert_eq!(of_v(60.1, 6.0, f64::NAN).map(|found| found.limit), Some(60.0));
        assert!(of_v(f64::NAN, 6.0, 1.0).is_some() && of_v(f64::INFINITY, 6.0, 1.0).is_some());
    }
}
