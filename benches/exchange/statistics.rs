//! From latencies, in blocks by round, to the figures that are printed. No outlier is removed anywhere.

use serde::Serialize;

use crate::mechanism::Mechanism;

/// The latencies of one mechanism, ns, one block a round.
pub(crate) type Blocks = Vec<Vec<u64>>;

/// The figures of one mechanism.
#[derive(Debug, Serialize)]
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) n: usize,
    pub(crate) p50_ns: u64,
    pub(crate) p99_ns: u64,
    pub(crate) p99_9_ns: u64,
    pub(crate) max_ns: u64,
    pub(crate) ratio: Option<Ratio>,
}

/// How much slower than the baseline, by the medians of blocks of the same round.
#[derive(Debug, Serialize)]
pub(crate) struct Ratio {
    pub(crate) baseline: &'static str,
    /// Median over the rounds.
    pub(crate) median: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
    /// The probability that [low, high] covers the true median, if rounds are alike and independent.
    pub(crate) confidence: f64,
    pub(crate) aim: Option<f64>,
    /// Whether the aim is met; none without an aim, or if the interval contains it.
    pub(crate) met: Option<bool>,
}

/// The figures of every mechanism that was run.
pub(crate) fn rows(measured: &[(Mechanism, Blocks)], paced: bool) -> Vec<Row> {
    measured
        .iter()
        .map(|(mechanism, blocks)| {
            let ratio = mechanism.baseline(paced).and_then(|baseline| {
                let (_, base) = measured.iter().find(|(other, _)| *other == baseline.mechanism)?;
                Some(ratio(blocks, base, baseline.mechanism.name(), baseline.aim))
            });
            row(mechanism.name(), blocks, ratio)
        })
        .collect()
}

fn row(name: &'static str, blocks: &Blocks, ratio: Option<Ratio>) -> Row {
    let mut sorted: Vec<u64> = blocks.iter().flatten().copied().collect();
    sorted.sort_unstable();
    // All samples are at hand, so the quantiles are exact: the smallest value that so many per mille don't exceed.
    let per_mille = |q: usize| sorted[(sorted.len() * q).div_ceil(1000).max(1) - 1];
    Row {
        name,
        n: sorted.len(),
        p50_ns: per_mille(500),
        p99_ns: per_mille(990),
        p99_9_ns: per_mille(999),
        max_ns: per_mille(1000),
        ratio,
    }
}

/// Pairs the blocks of each round: what slows the machine for a while slows both.
fn ratio(blocks: &Blocks, base: &Blocks, baseline: &'static str, aim: Option<f64>) -> Ratio {
    let mut ratios: Vec<f64> = blocks.iter().zip(base).map(|(a, b)| median_ns(a) / median_ns(b)).collect();
    ratios.sort_unstable_by(f64::total_cmp);
    let (below, confidence) = sign_interval(ratios.len());
    let (low, high) = (ratios[below], ratios[ratios.len() - 1 - below]);
    let met = aim.and_then(|aim| if high <= aim { Some(true) } else { (low > aim).then_some(false) });
    Ratio { baseline, median: median(&ratios), low, high, confidence, aim, met }
}

#[expect(clippy::cast_precision_loss, reason = "2^53 ns are 104 days")]
fn median_ns(block: &[u64]) -> f64 {
    let mut sorted = block.to_vec();
    sorted.sort_unstable();
    sorted[sorted.len() / 2] as f64
}

/// The median of sorted numbers.
pub(crate) fn median(sorted: &[f64]) -> f64 {
    f64::midpoint(sorted[(sorted.len() - 1) / 2], sorted[sorted.len() / 2])
}

/// The interval of the sign test: of `n` sorted numbers, drop so many at each end that what is left covers their true
/// median with a probability of at least 95 %; how many, and that probability. It assumes no distribution. With fewer
/// than six numbers nothing can be dropped and the probability is what it is.
fn sign_interval(n: usize) -> (usize, f64) {
    // P(fewer than k + 1 of n fair coins) for growing k, from the binomial coefficients.
    let mut term = (0..n).fold(1.0, |product, _| product / 2.0);
    let (mut tail, mut outcome) = (term, (0, 1.0 - 2.0 * term));
    for (k, k_f64) in (1..n / 2).zip((1_u32..).map(f64::from)) {
        term *= (f64::from(u32::try_from(n).unwrap_or(u32::MAX)) - k_f64 + 1.0) / k_f64;
        tail += term;
        if 1.0 - 2.0 * tail < 0.95 {
            break;
        }
        outcome = (k, 1.0 - 2.0 * tail);
    }
    outcome
}
