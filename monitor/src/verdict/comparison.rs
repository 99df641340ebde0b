//! Two runs side by side: the ratio of each quantile with a confidence interval, by a bootstrap over blocks.
//!
//! Whole blocks are drawn with replacement, so clusters of late ticks stay together, from each run for itself. The
//! interval is the percentile interval of the ratios. The generator is this module's own and starts from a fixed seed:
//! the same two files give the same numbers on every machine.

use serde::{Deserialize, Serialize};

use super::blocks::{Blocks, Counts, LAST_BUCKET, least_of, most_of};
use super::limits::are_enough;
use crate::hops::Hop;

/// Draws.
const RESAMPLES: usize = 1000;
/// Fewer blocks than this tell nothing about their spread.
const BLOCKS_MIN: usize = 8;
const SEED: u64 = 0x6c6f_6f70_626f_756e;
/// Quantiles that are compared, by the names of their keys.
pub const QUANTILES: [(&str, f64); 4] = [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("p99_9", 0.999)];

/// One quantile of one hop in both runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ratio {
    /// The hop's key.
    pub hop: String,
    /// The quantile's key.
    pub quantile: String,
    /// In the first run, ns; none where there is no such time, see `a_why`.
    pub a_ns: Option<f64>,
    /// In the second, ns.
    pub b_ns: Option<f64>,
    /// Why the first run has none: `never` (more ticks than the quantile leaves out got no torque), `too few` (samples for this
    /// quantile) or `absent` (no sample at all).
    pub a_why: Option<String>,
    /// The same of the second run.
    pub b_why: Option<String>,
    /// Samples of the first run, with the ticks that got no torque where the hop ends with one.
    pub a_n: u64,
    /// Samples of the second run.
    pub b_n: u64,
    /// b / a; none where one of them is zero or not there.
    pub ratio: Option<f64>,
    /// Its lower limit at 95 %; none with too few blocks, or where some of the draws have no ratio there.
    pub lower: Option<f64>,
    /// Its upper limit.
    pub upper: Option<f64>,
    /// Why there is no ratio: `zero`, `never`, `too few` or `absent`.
    pub why_no_ratio: Option<String>,
    /// Whether there are too few blocks for an interval.
    pub few_blocks: bool,
}

/// Below this a latency is none: the first bucket, whose middle would make a ratio of nothing.
const ZERO_NS: f64 = 1.0;

/// A quantile, unless it lies among the torques that never came.
fn came(value_ns: f64) -> Option<f64> {
    (value_ns < least_of(LAST_BUCKET) as f64).then_some(value_ns)
}

/// A quantile of so many samples, or why there is none.
fn known(value_ns: f64, samples: u64, quantile: f64) -> Result<f64, &'static str> {
    match samples {
        0 => Err("absent"),
        _ if !are_enough(samples, quantile) => Err("too few"),
        _ => came(value_ns).ok_or("never"),
    }
}

/// b / a, or why there is none.
fn ratio_of(a_ns: Result<f64, &'static str>, b_ns: Result<f64, &'static str>) -> Result<f64, &'static str> {
    let (a_ns, b_ns) = (a_ns?, b_ns?);
    if a_ns >= ZERO_NS && b_ns >= ZERO_NS { Ok(b_ns / a_ns) } else { Err("zero") }
}

/// SplitMix64 (Steele, Lea, Flood 2014).
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        usize::try_from((z ^ (z >> 31)) % n as u64).unwrap_or(0)
    }
}

/// The quantiles of some blocks together, each as the middle of its bucket's edges would be too coarse for ratios near
/// 1, so within the bucket the ranks are taken to be evenly spread.
fn quantiles_of(blocks: &[&Counts], totals: &mut [u64]) -> [f64; QUANTILES.len()] {
    totals.fill(0);
    let mut all = 0;
    for (bucket, count) in blocks.iter().flat_map(|counts| counts.iter()) {
        totals[usize::from(*bucket)] += u64::from(*count);
        all += u64::from(*count);
    }
    QUANTILES.map(|(_, quantile)| {
        let rank = quantile * all as f64;
        let mut before = 0.0;
        for (bucket, count) in totals.iter().enumerate().filter(|(_, count)| **count > 0) {
            let count = *count as f64;
            if before + count >= rank {
                let bucket = u16::try_from(bucket).unwrap_or(LAST_BUCKET);
                let (least, most) = (least_of(bucket) as f64, most_of(bucket) as f64 + 1.0);
                return least + (most - least) * ((rank - before) / count).clamp(0.0, 1.0);
            }
            before += count;
        }
        f64::NAN
    })
}

/// The ratios of all quantiles of all hops that both runs have.
#[must_use]
pub fn compare(a: &Blocks, b: &Blocks) -> Vec<Ratio> {
    Hop::ALL.into_iter().flat_map(|hop| compare_hop(hop, a, b)).collect()
}

/// The ratios of all quantiles of one hop; none if neither run has it.
#[must_use]
pub fn compare_hop(hop: Hop, a: &Blocks, b: &Blocks) -> Vec<Ratio> {
    let (a, b): (Vec<&Counts>, Vec<&Counts>) = (a.of(hop).collect(), b.of(hop).collect());
    if a.is_empty() && b.is_empty() {
        return Vec::new();
    }
    let mut totals = vec![0; usize::from(LAST_BUCKET) + 1];
    let (of_a, of_b) = (quantiles_of(&a, &mut totals), quantiles_of(&b, &mut totals));
    let mut drawn = draw_ratios(&a, &b, &mut totals);
    let samples = |of: &[&Counts]| of.iter().flat_map(|counts| counts.iter()).map(|(_, n)| u64::from(*n)).sum::<u64>();
    let (a_n, b_n) = (samples(&a), samples(&b));
    let one = |(index, (name, quantile)): (usize, &(&str, f64))| {
        let ratios = &mut drawn[index];
        ratios.sort_by(f64::total_cmp);
        let (a_ns, b_ns) = (known(of_a[index], a_n, *quantile), known(of_b[index], b_n, *quantile));
        let found = ratio_of(a_ns, b_ns);
        let is_ratio = |limit: &f64| found.is_ok() && limit.is_finite() && *limit > 0.0;
        let at = |share: usize| ratios.get(ratios.len() * share / 1000).copied().filter(is_ratio);
        Ratio {
            hop: hop.name().to_owned(),
            quantile: (*name).to_owned(),
            a_ns: a_ns.ok(),
            b_ns: b_ns.ok(),
            a_why: a_ns.err().map(str::to_owned),
            b_why: b_ns.err().map(str::to_owned),
            a_n,
            b_n,
            ratio: found.ok(),
            lower: at(25),
            upper: at(975),
            why_no_ratio: found.err().map(str::to_owned),
            few_blocks: ratios.is_empty(),
        }
    };
    QUANTILES.iter().enumerate().map(one).collect()
}

/// The ratios of each quantile in resampled blocks; none with too few blocks.
fn draw_ratios(a: &[&Counts], b: &[&Counts], totals: &mut [u64]) -> [Vec<f64>; QUANTILES.len()] {
    let mut drawn: [Vec<f64>; QUANTILES.len()] = Default::default();
    if a.len() < BLOCKS_MIN || b.len() < BLOCKS_MIN {
        return drawn;
    }
    let mut random = Random(SEED);
    for _ in 0..RESAMPLES {
        let mut draw = |from: &[&Counts]| {
            let chosen: Vec<&Counts> = (0..from.len()).map(|_| from[random.below(from.len())]).collect();
            quantiles_of(&chosen, totals)
        };
        let (of_a, of_b) = (draw(a), draw(b));
        for (index, ratios) in drawn.iter_mut().enumerate() {
            // One without a ratio lies at the end that it belongs to.
            let end = if came(of_a[index]).is_none() || of_b[index] < ZERO_NS { 0.0 } else { f64::INFINITY };
            let [a_ns, b_ns] = [of_a[index], of_b[index]].map(|value_ns| came(value_ns).ok_or("never"));
            ratios.push(ratio_of(a_ns, b_ns).unwrap_or(end));
        }
    }
    drawn
}

/// A quantile of one run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// What was found, ns; [`NEVER_NS`](super::blocks::NEVER_NS) where more ticks than the rest got no torque.
    pub value_ns: f64,
    /// Its lower limit at 95 %; none with too few blocks.
    pub lower_ns: Option<f64>,
    /// Its upper limit.
    pub upper_ns: Option<f64>,
}

/// All [`QUANTILES`] of one hop of a run, each with its interval; none if the run doesn't have the hop.
#[must_use]
pub fn estimates(hop: Hop, run: &Blocks) -> Option<[Estimate; QUANTILES.len()]> {
    let blocks: Vec<&Counts> = run.of(hop).collect();
    let mut totals = vec![0; usize::from(LAST_BUCKET) + 1];
    let values = quantiles_of(&blocks, &mut totals);
    let mut drawn: [Vec<f64>; QUANTILES.len()] = Default::default();
    if blocks.len() >= BLOCKS_MIN {
        let mut random = Random(SEED);
        for _ in 0..RESAMPLES {
            let chosen: Vec<&Counts> = (0..blocks.len()).map(|_| blocks[random.below(blocks.len())]).collect();
            let quantiles = quantiles_of(&chosen, &mut totals);
            drawn.iter_mut().zip(quantiles).for_each(|(all, value)| all.push(value));
        }
    }
    drawn.iter_mut().for_each(|all| all.sort_by(f64::total_cmp));
    let at = |index: usize, share: usize| drawn[index].get(drawn[index].len() * share / 1000).copied();
    let one = |index| Estimate { value_ns: values[index], lower_ns: at(index, 25), upper_ns: at(index, 975) };
    (!blocks.is_empty()).then(|| std::array::from_fn(one))
}

/// A table for people.
#[must_use]
pub fn table(ratios: &[Ratio]) -> String {
    use super::expectations::time;
    use std::fmt::Write as _;
    let mut text = format!("{:<22}{:<7}{:>12}{:>12}{:>9}  95 % of the ratio\n", "hop", "", "A", "B", "B / A");
    for one in ratios {
        let limit = |limit: Option<f64>| limit.map_or_else(|| "unknown".to_owned(), |limit| format!("{limit:.3}"));
        let interval = match one.ratio {
            None => String::new(),
            Some(_) if one.few_blocks => format!("needs {BLOCKS_MIN} blocks of 250 ms in each"),
            Some(_) => format!("{} to {}", limit(one.lower), limit(one.upper)),
        };
        let ns = |value_ns: Option<f64>, why: &Option<String>| match value_ns {
            None => why.clone().unwrap_or_else(|| "never".to_owned()),
            Some(value_ns) if value_ns < ZERO_NS => "zero".to_owned(),
            value_ns => time(value_ns),
        };
        let ratio = one.ratio.map_or_else(|| "none".to_owned(), |ratio| format!("{ratio:.3}"));
        let Ratio { hop, quantile, a_ns, b_ns, a_why, b_why, .. } = one;
        let line =
            format!("{hop:<22}{quantile:<7}{:>12}{:>12}{ratio:>9}  {interval}", ns(*a_ns, a_why), ns(*b_ns, b_why));
        let _ = writeln!(text, "{}", line.trim_end());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::blocks::{Block, bucket, counts_of};
    use super::*;

    fn run(seed: u64, blocks: u64, base_ns: usize) -> Blocks {
        let mut random = Random(seed);
        let mut run = Blocks::new(1_000_000);
        for index in 0..blocks {
            let mut values: Vec<u16> = (0..250).map(|_| bucket((base_ns + random.below(base_ns / 5)) as u64)).collect();
            let mut hops = vec![Vec::new(); Hop::ALL.len()];
            hops[Hop::RoundTrip as usize] = counts_of(&mut values);
            run.push(Block { index, hops });
        }
        run
    }

    #[test]
    fn runs_alike_have_ratios_around_one_and_a_slower_one_is_told_apart() {
        let ratios = compare(&run(1, 40, 10_000), &run(2, 40, 10_000));
        assert_eq!(ratios.len(), QUANTILES.len());
        for ratio in &ratios {
            let (lower, upper) = (ratio.lower.unwrap(), ratio.upper.unwrap());
            assert!(lower <= 1.003 && upper >= 0.997 && upper - lower < 0.05, "{ratio:?}");
        }
        let ratios = compare(&run(1, 40, 10_000), &run(2, 40, 11_000));
        assert!(ratios.iter().all(|ratio| ratio.lower.unwrap() > 1.05 && ratio.upper.unwrap() < 1.15), "{ratios:?}");
    }

    #[test]
    fn a_quantile_lies_within_its_interval_and_few_blocks_give_none() {
        let [median, ..] = estimates(Hop::RoundTrip, &run(1, 40, 10_000)).unwrap();
        let (lower_ns, upper_ns) = (median.lower_ns.unwrap(), median.upper_ns.unwrap());
        assert!(lower_ns < median.value_ns && median.value_ns < upper_ns && upper_ns / lower_ns < 1.02, "{median:?}");
        assert!((median.value_ns / 11_000.0 - 1.0).abs() < 0.01, "the middle of 10 to 12 µs: {median:?}");
        let few = estimates(Hop::RoundTrip, &run(1, 3, 10_000)).unwrap();
        assert!(few.iter().all(|estimate| estimate.lower_ns.is_none() && estimate.value_ns > 9_000.0));
        assert_eq!(estimates(Hop::Compute, &run(1, 3, 10_000)), None);
    }

    /// Blocks in which every round trip lies in one bucket.
    fn alike(bucket: u16) -> Blocks {
        let mut run = Blocks::new(1_000_000);
        for index in 0..20 {
            let mut hops = vec![Vec::new(); Hop::ALL.len()];
            hops[Hop::RoundTrip as usize] = vec![(bucket, 250)];
            run.push(Block { index, hops });
        }
        run
    }

    #[test]
    fn zero_and_never_are_words_and_have_no_ratio() {
        let (zero, never, some) = (alike(0), alike(LAST_BUCKET), run(1, 20, 10_000));
        for (a, b, words) in [
            (&zero, &zero, "zero        zero     none"),
            (&zero, &some, "none"),
            (&never, &never, "never       never     none"),
            (&some, &never, "never     none"),
            (&never, &some, "none"),
        ] {
            let ratios = compare(a, b);
            assert!(ratios.iter().all(|one| one.ratio.is_none() && one.lower.is_none() && one.why_no_ratio.is_some()));
            let text = table(&ratios);
            assert!(text.lines().skip(1).all(|line| line.contains(words) && line.ends_with("none")), "{text}");
        }
    }

    #[test]
    fn a_run_with_few_round_trips_or_none_looks_no_better_for_it() {
        // 28 of 400 ticks got a torque, each in the same 10 µs.
        let mut few = Blocks::new(1_000_000);
        let mut hops = vec![Vec::new(); Hop::ALL.len()];
        hops[Hop::RoundTrip as usize] = vec![(bucket(10_000), 28), (LAST_BUCKET, 372)];
        hops[Hop::Compute as usize] = vec![(bucket(300), 28)];
        few.push(Block { index: 0, hops });
        let mut good = run(1, 40, 10_000);
        let mut hops = vec![Vec::new(); Hop::ALL.len()];
        hops[Hop::Compute as usize] = vec![(bucket(300), 1000)];
        good.push(Block { index: 40, hops });
        let ratios = compare(&good, &few);
        let of = |hop: Hop, quantile: &str| {
            ratios.iter().find(|one| one.hop == hop.name() && one.quantile == quantile).unwrap()
        };
        let why = |one: &Ratio| (one.a_why.clone(), one.b_why.clone(), one.ratio);
        for quantile in ["p50", "p90", "p99"] {
            assert_eq!(why(of(Hop::RoundTrip, quantile)), (None, Some("never".into()), None), "{quantile}");
        }
        // 400 samples say nothing of the worst thousandth, 28 nothing of the worst hundredth.
        assert_eq!(why(of(Hop::RoundTrip, "p99_9")), (None, Some("too few".into()), None));
        assert_eq!(why(of(Hop::Compute, "p99")), (None, Some("too few".into()), None));
        assert_eq!(of(Hop::Compute, "p50").ratio, Some(1.0));
        assert_eq!((of(Hop::RoundTrip, "p50").a_n, of(Hop::RoundTrip, "p50").b_n), (10_000, 400));
        let text = table(&ratios);
        assert!(text.contains("too few") && text.contains("never"), "{text}");
        // A hop that one run has none of is a line, and not left out.
        let none = Blocks::new(1_000_000);
        let ratios = compare(&good, &none);
        assert!(!ratios.is_empty() && ratios.iter().all(|one| one.b_why.as_deref() == Some("absent")), "{ratios:?}");
        assert!(compare(&none, &none).is_empty());
    }

    #[test]
    fn the_same_files_give_the_same_numbers_and_few_blocks_give_no_interval() {
        let (a, b) = (run(1, 12, 10_000), run(2, 12, 10_000));
        assert_eq!(compare(&a, &b), compare(&a, &b));
        assert!(
            compare(&a, &run(2, 5, 10_000))
                .iter()
                .all(|ratio| ratio.lower.is_none() && ratio.few_blocks && ratio.ratio > Some(0.9))
        );
    }
}
