//! Latency of every hop in HdrHistograms: which stamps make a hop, and what becomes of values that are none.
//!
//! Latencies count from the intended time or from the stamp before, so a stalled loop hides nothing. A value beyond the
//! range is counted at its end and as overflow, and the largest value is kept exactly: nothing is clipped silently.

mod declared;

use hdrhistogram::{AdditionError, Histogram};
use loopbound_shared::sample::{Receipt, TickRecord};

pub use declared::{Hop, Latency};

use crate::summary::Quantiles;

/// The largest latency that a histogram resolves: 10 s.
pub const HIGHEST_NS: u64 = 10_000_000_000;
const SIGNIFICANT_DIGITS: u8 = 3;

/// One distribution of nanoseconds.
#[derive(Clone, Debug)]
pub struct Distribution {
    histogram: Histogram<u64>,
    overflow: u64,
    negative: u64,
    max_ns: u64,
}

impl Default for Distribution {
    fn default() -> Self {
        let histogram = Histogram::new_with_bounds(1, HIGHEST_NS, SIGNIFICANT_DIGITS);
        Self {
            histogram: histogram.expect("1 ns to 10 s with 3 digits is a valid range"),
            overflow: 0,
            negative: 0,
            max_ns: 0,
        }
    }
}

impl Distribution {
    /// Counts one value. Never allocates.
    pub fn record(&mut self, value_ns: u64) {
        self.overflow += u64::from(value_ns > HIGHEST_NS);
        self.max_ns = self.max_ns.max(value_ns);
        self.histogram.saturating_record(value_ns.min(HIGHEST_NS));
    }

    /// Counts the time between two stamps.
    pub fn record_between(&mut self, (from_ns, to_ns): (u64, u64)) {
        match to_ns.checked_sub(from_ns) {
            Some(value_ns) => self.record(value_ns),
            None => self.negative += 1,
        }
    }

    /// Adds all values of a histogram that was recorded elsewhere.
    ///
    /// # Errors
    /// If it holds values beyond the range of this one.
    pub fn add(&mut self, other: &Histogram<u64>) -> Result<(), AdditionError> {
        self.histogram.add(other)
    }

    /// Takes from the figures of what was added what histograms don't hold: the exact largest value, and the counts of
    /// values that are none.
    pub fn note(&mut self, added: &Quantiles) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it was a count of ns; saturates")]
        let max_ns = added.max.unwrap_or(0.0) as u64;
        self.max_ns = self.max_ns.max(max_ns);
        self.overflow += added.overflow;
        self.negative += added.negative;
    }

    /// The histogram itself.
    #[must_use]
    pub fn histogram(&self) -> &Histogram<u64> {
        &self.histogram
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.histogram.reset();
        (self.overflow, self.negative, self.max_ns) = (0, 0, 0);
    }

    /// The quantiles for the report, ns.
    #[must_use]
    pub fn quantiles(&self) -> Quantiles {
        let n = self.histogram.len();
        let some = |value: u64| (n > 0).then_some(value as f64);
        // The histogram answers with the upper end of a bucket, which may lie above the largest value.
        let at = |quantile: f64| some(self.histogram.value_at_quantile(quantile).min(self.max_ns));
        Quantiles {
            n,
            min: some(self.histogram.min()),
            p50: at(0.5),
            p90: at(0.9),
            p99: at(0.99),
            p99_9: at(0.999),
            max: some(self.max_ns),
            mean: (n > 0).then(|| self.histogram.mean()),
            overflow: self.overflow,
            negative: self.negative,
        }
    }
}

/// Skipped ticks of one overrun that are counted one by one: a number from another process must not hold this one up.
const SKIPPED_MAX: u64 = 100_000;

/// One distribution a hop.
#[derive(Clone, Debug, Default)]
pub struct Hops {
    distributions: [Distribution; Hop::ALL.len()],
}

impl Hops {
    /// Counts the hops of one tick. The ticks skipped before it were intended too: each counts its own wait from its
    /// own deadline, or an overrun would shorten the tail that it is the worst of (coordinated omission).
    pub fn record(&mut self, record: &TickRecord, receipt: Option<&Receipt>, period_ns: u64) {
        for hop in Hop::ALL {
            let Some(stamps) = hop.stamps(record, receipt) else { continue };
            let distribution = &mut self.distributions[hop as usize];
            distribution.record_between(stamps);
            if matches!(hop, Hop::Wakeup | Hop::DeadlineToTorque) {
                for skipped in 1..=record.skipped_before.min(SKIPPED_MAX) {
                    distribution.record_between((stamps.0.saturating_sub(skipped * period_ns), stamps.1));
                }
            }
        }
    }

    /// The distribution of one hop.
    #[must_use]
    pub fn of(&self, hop: Hop) -> &Distribution {
        &self.distributions[hop as usize]
    }

    /// The same, to add to.
    pub fn of_mut(&mut self, hop: Hop) -> &mut Distribution {
        &mut self.distributions[hop as usize]
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.distributions.iter_mut().for_each(Distribution::clear);
    }

    /// The quantiles for the report, ns.
    #[must_use]
    pub fn latency(&self) -> Latency {
        Latency::of_each(|hop| self.of(hop).quantiles())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_beyond_the_range_is_counted_as_overflow_and_its_size_is_kept() {
        let mut distribution = Distribution::default();
        distribution.record(HIGHEST_NS + 5);
        distribution.record(1000);
        let quantiles = distribution.quantiles();
        assert_eq!((quantiles.n, quantiles.overflow), (2, 1));
        assert_eq!(quantiles.max, Some((HIGHEST_NS + 5) as f64));
        assert_eq!(quantiles.min, Some(1000.0));
    }

    #[test]
    fn stamps_in_the_wrong_order_are_no_latency() {
        let mut distribution = Distribution::default();
        distribution.record_between((10, 9));
        let quantiles = distribution.quantiles();
        assert_eq!((quantiles.n, quantiles.negative, quantiles.p50), (0, 1, None));
    }

    #[test]
    fn quantiles_of_one_to_ten_thousand_are_right_to_three_digits() {
        let mut distribution = Distribution::default();
        (1..=10_000).for_each(|value| distribution.record(value));
        let quantiles = distribution.quantiles();
        for (found, expected) in [(quantiles.p50, 5e3), (quantiles.p99, 9.9e3), (quantiles.p99_9, 9.99e3)] {
            assert!((found.unwrap() / expected - 1.0).abs() < 1.1e-3, "{found:?} for {expected}");
        }
        assert_eq!(quantiles.max, Some(10_000.0));
    }
}
