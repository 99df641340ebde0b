//! How regularly the plant samples.

use loopbound_shared::sample::TickRecord;

use crate::hops::Distribution;
use crate::summary::Jitter;

/// Statistics of the distance between neighbouring sampling instants.
#[derive(Debug, Default)]
pub struct JitterStatistics {
    before: Option<(u64, u64)>,
    n: u64,
    mean_ns: f64,
    /// Sum of squared distances from the mean (Welford).
    squares_ns2: f64,
    min_ns: u64,
    max_ns: u64,
    deviation: Distribution,
}

impl JitterStatistics {
    /// Takes the sampling instant of the next record. Only pairs of neighbouring ticks are an interval.
    pub fn record(&mut self, record: &TickRecord, period_ns: u64) {
        let before = self.before.replace((record.tick, record.sampled_ns));
        let Some((tick, sampled_ns)) = before else { return };
        if tick.checked_add(1) != Some(record.tick) {
            return;
        }
        let Some(interval_ns) = record.sampled_ns.checked_sub(sampled_ns) else { return };
        self.min_ns = if self.n == 0 { interval_ns } else { self.min_ns.min(interval_ns) };
        self.max_ns = self.max_ns.max(interval_ns);
        self.n += 1;
        let from_mean_ns = interval_ns as f64 - self.mean_ns;
        self.mean_ns += from_mean_ns / self.n as f64;
        self.squares_ns2 += from_mean_ns * (interval_ns as f64 - self.mean_ns);
        self.deviation.record(interval_ns.abs_diff(period_ns));
    }

    /// The next record has no neighbour before it.
    pub fn skip(&mut self) {
        self.before = None;
    }

    /// The figures for the report, ns.
    #[must_use]
    pub fn summary(&self) -> Jitter {
        let some = |value: f64| (self.n > 0).then_some(value);
        let deviation = self.deviation.quantiles();
        Jitter {
            n: self.n,
            mean: some(self.mean_ns),
            std: (self.n > 1).then(|| (self.squares_ns2 / (self.n - 1) as f64).sqrt()),
            min: some(self.min_ns as f64),
            max: some(self.max_ns as f64),
            deviation_p50: deviation.p50,
            deviation_p99: deviation.p99,
            deviation_p99_9: deviation.p99_9,
        }
    }
}
