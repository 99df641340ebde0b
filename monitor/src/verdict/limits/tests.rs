//! The limits against a truth that is known: simulated runs with stalls in clusters, looked at after every block.

use super::super::blocks::{bucket, counts_of};
use super::*;

const NOMINAL: u64 = 250;

/// SplitMix64: enough for a simulation, and the same everywhere.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A block of ticks around 10 µs; a stall of `stall_ticks` begins in each tick with the probability `stall`.
fn block(random: &mut Random, stall: f64, stall_ticks: u32) -> Counts {
    let mut left = 0;
    let mut values: Vec<u16> = (0..NOMINAL)
        .map(|_| {
            if left == 0 && random.uniform() < stall {
                left = stall_ticks;
            }
            let stalled = left > 0;
            left = left.saturating_sub(1);
            let base_ns = 9_000 + random.next() % 2_000;
            bucket(if stalled { base_ns + 500_000 } else { base_ns })
        })
        .collect();
    counts_of(&mut values)
}

/// The share of ticks within a stall, measured over many blocks: the truth.
fn share_of(stall: f64, stall_ticks: u32) -> f64 {
    let mut random = Random(99);
    let threshold = bucket(100_000);
    let sum: u64 = (0..10_000).map(|_| above(&block(&mut random, stall, stall_ticks), threshold).1).sum();
    sum as f64 / (10_000 * NOMINAL) as f64
}

/// In how many of `runs` the `side` was ever rejected for, looking after each of 40 blocks.
fn rejections(runs: u64, side: Side, share: f64, stall: f64, stall_ticks: u32) -> u64 {
    let needed = -libm::log(0.05);
    let threshold = bucket(100_000);
    let one = |seed: u64| {
        let mut random = Random(seed);
        let mut seen: Vec<Counts> = Vec::new();
        (0..40).any(|_| {
            seen.push(block(&mut random, stall, stall_ticks));
            evidence(side, share, threshold, NOMINAL, seen.iter()) >= needed
        })
    };
    (1..=runs).map(|seed| u64::from(one(seed * 7919))).sum()
}

#[test]
fn under_clustered_stalls_and_a_look_after_every_block_a_true_budget_fails_no_more_often_than_said() {
    for stall_ticks in [1, 5, 25, 200] {
        let stall = 0.01 / f64::from(stall_ticks);
        // Exactly on the budget is the hardest truth that is still within it.
        let share = share_of(stall, stall_ticks);
        let failed = rejections(100, Side::More, share, stall, stall_ticks);
        // 5 % of 100 are 5; 12 or more have a probability below 1 % if the rate were really 5 %.
        assert!(failed <= 11, "stalls of {stall_ticks} ticks: {failed} of 100 failed");
    }
}

#[test]
fn a_budget_that_is_just_broken_passes_no_more_often_than_said_while_stalls_are_short_against_a_block() {
    for stall_ticks in [1, 5, 10] {
        let stall = 0.01 / f64::from(stall_ticks);
        let share = share_of(stall, stall_ticks);
        let passed = rejections(100, Side::Fewer, share, stall, stall_ticks);
        assert!(passed <= 11, "stalls of {stall_ticks} ticks: {passed} of 100 passed");
    }
}

#[test]
fn treating_ticks_as_independent_would_fail_true_budgets_far_more_often() {
    // The reason for blocks: the same runs by a tick-wise normal limit at the end only, without repeated looks.
    let (stall, stall_ticks) = (0.01 / 25.0, 25);
    let share = share_of(stall, stall_ticks);
    let failed = (1..=200u64).filter(|seed| {
        let mut random = Random(seed * 7919);
        let late: u64 = (0..80).map(|_| above(&block(&mut random, stall, stall_ticks), bucket(100_000)).1).sum();
        let n = (80 * NOMINAL) as f64;
        late as f64 > share * n + 1.645 * (n * share * (1.0 - share)).sqrt()
    });
    assert!(failed.count() > 40);
}

#[test]
fn a_clear_regression_is_found_within_seconds_and_a_clean_run_passes_within_seconds() {
    let mut random = Random(5);
    let clean: Vec<Counts> = (0..24).map(|_| block(&mut random, 0.0, 1)).collect();
    let found = limits(0.99, 0.005, NOMINAL, clean.iter());
    assert!(found.upper_ns.is_some_and(|upper_ns| upper_ns < 11_200), "{found:?}");
    let found = limits(0.5, 0.005, NOMINAL, clean.iter());
    assert!(found.lower_ns.is_some_and(|lower_ns| lower_ns > 9_000), "{found:?}");
    assert!(found.upper_ns.is_some_and(|upper_ns| upper_ns < 11_200), "{found:?}");
    // 1 % of ticks late against a budget of 0.1 %, in 6 s.
    let late: Vec<Counts> = (0..24).map(|_| block(&mut random, 0.01, 1)).collect();
    let found = limits(0.999, 0.005, NOMINAL, late.iter());
    assert!(found.lower_ns.is_some_and(|lower_ns| lower_ns > 400_000), "{found:?}");
}

#[test]
fn limits_enclose_the_estimate_and_come_closer_with_more_data() {
    let mut random = Random(11);
    let blocks: Vec<Counts> = (0..200).map(|_| block(&mut random, 0.002, 3)).collect();
    for quantile in [0.5, 0.9, 0.99] {
        let few = limits(quantile, 0.01, NOMINAL, blocks[..40].iter());
        let many = limits(quantile, 0.01, NOMINAL, blocks.iter());
        let (few_lower_ns, few_upper_ns) = (few.lower_ns.unwrap_or(0), few.upper_ns.unwrap_or(u64::MAX));
        let (lower_ns, upper_ns) = (many.lower_ns.unwrap(), many.upper_ns.unwrap());
        let estimate_ns = estimate(quantile, blocks.iter()).unwrap();
        assert!(lower_ns <= estimate_ns && estimate_ns <= upper_ns, "{quantile}: {many:?} {estimate_ns}");
        assert!(few_lower_ns <= lower_ns && upper_ns <= few_upper_ns, "{quantile}: {few:?} {many:?}");
    }
}

#[test]
fn without_data_there_are_no_limits_and_no_estimate() {
    let none: [Counts; 0] = [];
    assert_eq!(limits(0.5, 0.01, NOMINAL, none.iter()), Limits::default());
    assert_eq!(estimate(0.5, none.iter()), None);
}
