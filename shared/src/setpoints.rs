//! The setpoints that have come, by tick: what the reference publishes ahead is kept here until its tick.

use crate::chain::LINKS_MAX;
use crate::sample::{Links, Setpoint, to_vector};
use crate::trajectory::SetpointValue;

/// Ticks that the book holds: more than any lead.
const CAPACITY: usize = 4096;

/// A setpoint found for an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found<const N: usize> {
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

    /// The setpoint `offset_ns` after the instant of `tick`: that of the tick itself, or else the newest earlier one,
    /// extrapolated: q_d + q̇_d δ + ½ q̈_d δ². `None` before the first has come.
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
            found.q_d[i] += entry.v_d[i] * delta_s + 0.5 * entry.a_d[i] * (delta_s * delta_s);
            found.v_d[i] += entry.a_d[i] * delta_s;
        }
        Some(found)
    }

    /// The same with the vectors of the mathematics.
    #[must_use]
    pub fn at<const N: usize>(&self, tick: u64, offset_ns: u64) -> Option<Found<N>> {
        let found = self.at_links(tick, offset_ns)?;
        Some(Found {
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
    fn an_absent_setpoint_is_extrapolated_from_the_last_one_and_said_to_be_stale() {
        let mut book = SetpointBook::new(500_000_000);
        assert!(book.at::<1>(3, 0).is_none());
        assert!(book.enter(&setpoint(1), 1));
        let exact = book.at::<1>(1, 0).unwrap();
        assert_eq!((exact.stale, exact.value.q_d[0]), (false, 1.0));
        let later = book.at::<1>(3, 0).unwrap();
        assert!(later.stale && later.tick == 1);
        assert_eq!((later.value.q_d[0], later.value.v_d[0]), (1.0 + 2.0 + 2.0, 6.0));
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
