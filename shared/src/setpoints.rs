//! The setpoints that have come, by tick: what the reference publishes ahead is kept here until its tick.
//!
//! When no more come, the book brakes: from the last setpoint it goes on smoothly and comes to rest within
//! [`BRAKE_NS`], the same in every process that has the same last setpoint. To go on with q̈_d would be unbounded.

use crate::sample::{Links, Setpoint, to_vector};
use loopbound_model::chain::LINKS_MAX;
use loopbound_model::trajectory::SetpointValue;

/// Ticks that the book holds: more than any lead.
const CAPACITY: usize = 4096;

/// Time from the last setpoint known to rest. Long enough that braking asks for little more than the motion itself did
/// (at most 1.5 q̇_d / T), short enough that the chain doesn't go far.
pub const BRAKE_NS: u64 = 500_000_000;

/// A setpoint found for an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundSetpoint<const N: usize> {
    /// q_d, q̇_d, q̈_d at the instant asked for.
    pub value: SetpointValue<N>,
    /// The tick of the setpoint that was used.
    pub tick: u64,
    /// When it was published.
    pub published_ns: u64,
    /// Whether it is of an earlier tick, extrapolated, since that of the tick itself had not come.
    pub stale: bool,
}

/// A setpoint found for an instant, as it travels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundLinks {
    /// q_d at the instant asked for.
    pub q_d: Links,
    /// q̇_d.
    pub v_d: Links,
    /// q̈_d.
    pub a_d: Links,
    /// The tick of the setpoint that was used.
    pub tick: u64,
    /// When it was published.
    pub published_ns: u64,
    /// Whether it is of an earlier tick, extrapolated.
    pub stale: bool,
}

/// The setpoints that have come, by tick. Allocates at construction only.
pub struct SetpointBook {
    entries: Box<[Setpoint]>,
    newest_tick: Option<u64>,
    period_ns: u64,
}

impl SetpointBook {
    /// An empty book for ticks of `period_ns`.
    #[must_use]
    pub fn new(period_ns: u64) -> Self {
        let empty = Setpoint { tick: u64::MAX, ..Setpoint::zeroed() };
        Self { entries: vec![empty; CAPACITY].into_boxed_slice(), newest_tick: None, period_ns }
    }

    /// The period of a tick, ns.
    #[must_use]
    pub const fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// Enters a setpoint. Of two for one tick the later holds (a restarted reference repeats some). One that is not
    /// finite or of another number of links is refused: false.
    pub fn enter(&mut self, setpoint: &Setpoint, links: usize) -> bool {
        let finite = |values: &[f64]| values.iter().all(|x| x.is_finite());
        if setpoint.links as usize != links
            || !finite(&setpoint.q_d)
            || !finite(&setpoint.v_d)
            || !finite(&setpoint.a_d)
        {
            return false;
        }
        self.entries[slot(setpoint.tick)] = *setpoint;
        self.newest_tick = Some(self.newest_tick.map_or(setpoint.tick, |newest| newest.max(setpoint.tick)));
        true
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.entries.fill(Setpoint { tick: u64::MAX, ..Setpoint::zeroed() });
        self.newest_tick = None;
    }

    /// Whether the setpoint of `tick` itself is there.
    #[must_use]
    pub fn has(&self, tick: u64) -> bool {
        self.entries[slot(tick)].tick == tick
    }

    /// The setpoint `offset_ns` after the instant of `tick`: that of the tick itself with q_d + q̇_d δ + ½ q̈_d δ², or
    /// else a brake from the newest earlier one. `None` before the first has come.
    #[must_use]
    pub fn at_links(&self, tick: u64, offset_ns: u64) -> Option<FoundLinks> {
        let entry = if self.has(tick) { &self.entries[slot(tick)] } else { self.last_before(tick)? };
        let delta_s = crate::clock::seconds((tick - entry.tick) * self.period_ns + offset_ns);
        let mut found = FoundLinks {
            q_d: entry.q_d,
            v_d: entry.v_d,
            a_d: entry.a_d,
            tick: entry.tick,
            published_ns: entry.published_ns,
            stale: entry.tick != tick,
        };
        for i in 0..LINKS_MAX {
            if found.stale {
                (found.q_d[i], found.v_d[i], found.a_d[i]) = brake(entry.q_d[i], entry.v_d[i], entry.a_d[i], delta_s);
            } else {
                found.q_d[i] += entry.v_d[i] * delta_s + 0.5 * entry.a_d[i] * (delta_s * delta_s);
                found.v_d[i] += entry.a_d[i] * delta_s;
            }
        }
        Some(found)
    }

    /// The same with the vectors of the mathematics.
    #[must_use]
    pub fn at<const N: usize>(&self, tick: u64, offset_ns: u64) -> Option<FoundSetpoint<N>> {
        let found = self.at_links(tick, offset_ns)?;
        Some(FoundSetpoint {
            value: SetpointValue { q_d: to_vector(&found.q_d), v_d: to_vector(&found.v_d), a_d: to_vector(&found.a_d) },
            tick: found.tick,
            published_ns: found.published_ns,
            stale: found.stale,
        })
    }

    fn last_before(&self, tick: u64) -> Option<&Setpoint> {
        let from = tick.min(self.newest_tick?);
        let oldest = from.saturating_sub(CAPACITY as u64 - 1);
        (oldest..=from).rev().find(|&t| self.has(t)).map(|t| &self.entries[slot(t)])
    }
}

/// Angle, velocity and acceleration δ after a setpoint (q, v, a) that has no successor.
///
/// The velocity is the cubic with v(0) = v, v̇(0) = a, v(T) = 0, v̇(T) = 0, so that neither the velocity nor the
/// acceleration steps; with s = δ / T: v(s) = v (2s³ − 3s² + 1) + a T (s³ − 2s² + s). The angle is its integral, which
/// ends at q + v T / 2 + a T² / 12; after T the setpoint rests there.
fn brake(q: f64, v: f64, a: f64, delta_s: f64) -> (f64, f64, f64) {
    let time_s = crate::clock::seconds(BRAKE_NS);
    if delta_s >= time_s {
        return (q + v * time_s / 2.0 + a * (time_s * time_s) / 12.0, 0.0, 0.0);
    }
    let s = delta_s / time_s;
    let (s2, s3, s4) = (s * s, s * s * s, s * s * s * s);
    let angle = v * time_s * (s4 / 2.0 - s3 + s) + a * (time_s * time_s) * (s4 / 4.0 - s3 * (2.0 / 3.0) + s2 / 2.0);
    let velocity = v * (2.0 * s3 - 3.0 * s2 + 1.0) + a * time_s * (s3 - 2.0 * s2 + s);
    let acceleration = v / time_s * (6.0 * s2 - 6.0 * s) + a * (3.0 * s2 - 4.0 * s + 1.0);
    (q + angle, velocity, acceleration)
}

#[expect(clippy::cast_possible_truncation, reason = "a remainder of CAPACITY")]
fn slot(tick: u64) -> usize {
    (tick % CAPACITY as u64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setpoint(tick: u64) -> Setpoint {
        let mut setpoint = Setpoint { tick, links: 1, ..Setpoint::zeroed() };
        (setpoint.q_d[0], setpoint.v_d[0], setpoint.a_d[0]) = (tick as f64, 2.0, 4.0);
        setpoint
    }

    #[test]
    fn an_absent_setpoint_is_braked_from_the_last_one_and_said_to_be_stale() {
        let mut book = SetpointBook::new(BRAKE_NS);
        assert!(book.at::<1>(3, 0).is_none());
        assert!(book.enter(&setpoint(1), 1));
        let exact = book.at::<1>(1, 0).unwrap();
        assert_eq!((exact.stale, exact.value.q_d[0]), (false, 1.0));
        let later = book.at::<1>(3, 0).unwrap();
        assert!(later.stale && later.tick == 1);
        // At rest after T = 0.5 s, at q + v T / 2 + a T² / 12, and there for ever.
        assert_eq!((later.value.q_d[0], later.value.v_d[0], later.value.a_d[0]), (1.0 + 0.5 + 1.0 / 12.0, 0.0, 0.0));
        assert_eq!(book.at::<1>(3000, 0).unwrap().value, later.value);
    }

    #[test]
    fn the_brake_goes_on_from_the_last_setpoint_and_its_derivatives_are_each_others() {
        let mut book = SetpointBook::new(1_000_000);
        assert!(book.enter(&setpoint(1), 1));
        let (first, second) = (book.at::<1>(1, 0).unwrap().value, book.at::<1>(2, 0).unwrap().value);
        assert!((second.q_d[0] - first.q_d[0] - 2.0e-3).abs() < 3e-6);
        // The jerk at the start is −6 v/T² − 4 a/T = −80 rad/s³.
        assert!((second.a_d[0] - (4.0 - 80.0e-3)).abs() < 1e-3);
        let mut v_max: f64 = 0.0;
        for tick in 3..520 {
            let [before, now, after] = [tick - 1, tick, tick + 1].map(|tick| book.at::<1>(tick, 0).unwrap().value);
            // A central difference over 1 ms of a polynomial of degree four is this close.
            let slope = |of: fn(&SetpointValue<1>) -> f64| (of(&after) - of(&before)) / 2e-3;
            assert!((slope(|x| x.q_d[0]) - now.v_d[0]).abs() < 1e-4, "tick {tick}");
            assert!((slope(|x| x.v_d[0]) - now.a_d[0]).abs() < 3e-2, "tick {tick}");
            v_max = v_max.max(now.v_d[0].abs());
        }
        assert!(v_max <= 2.0 + 4.0 * 0.5 * 4.0 / 27.0, "the bound of the cubic: v + 4/27 a T, found {v_max}");
    }

    #[test]
    fn an_old_entry_in_the_same_place_is_not_taken_for_its_tick() {
        let mut book = SetpointBook::new(1);
        assert!(book.enter(&setpoint(5), 1));
        assert!(!book.has(5 + CAPACITY as u64));
    }

    #[test]
    fn a_setpoint_that_is_not_finite_or_of_other_links_is_refused() {
        let mut book = SetpointBook::new(1);
        let mut bad = setpoint(2);
        bad.v_d[0] = f64::NAN;
        assert!(!book.enter(&bad, 1) && !book.enter(&setpoint(2), 2) && !book.has(2));
    }
}
