//! Confidence limits of a quantile from blocks, valid under clustered stalls and at every look.
//!
//! **The question.** "The q-quantile is at most B" says that the share p of ticks above B is at most m = 1 − q. Let
//! f_b ∈ [0, 1] be that share in block b. Ticks within a block may depend on each other in any way; of a block we only
//! use that, given all blocks before it, its expectation is p.
//!
//! **The test.** To reject p ≤ m, bet on it: a gambler who starts with 1 and stakes λ ∈ [0, 1/m) on each block has
//! after t blocks
//!
//! ```text
//! W_t(λ) = Π_{b ≤ t} (1 + λ (f_b − m)).                                                                  (1)
//! ```
//!
//! If p ≤ m this is a non-negative supermartingale, and so is a fixed mixture W_t = Σ_j w_j W_t(λ_j), Σ w_j = 1. Ville's
//! inequality bounds its whole path,
//!
//! ```text
//! P( sup_t W_t ≥ 1/α ) ≤ α,                                                                              (2)
//! ```
//!
//! so looking after every block costs nothing: (2) spends α over all looks there will ever be, and needs no schedule.
//! To reject p ≥ m, stake on the other side: W_t(λ) = Π (1 + λ (m − f_b)).                                   (3)
//!
//! **Limits.** Stakes are fixed beforehand, so (1) falls and (3) rises with the threshold, for every data. The lower
//! limit of the quantile is the largest threshold at which (1) rejects, the upper limit the least at which (3) does; each
//! misses the true quantile with probability at most α, at all looks together.
//!
//! **How long a stall may be.** In (3), λ < 1/(1 − m) keeps every factor positive whatever f_b is, but then 460 clean
//! blocks are needed for p99 at α = 0.01: a share of 1 % might all lie in one block of a hundred. Stakes up to
//! 1/(c − m), c = max(4 m, [`CLUSTER`]) decide sooner, and are sound while no block's share exceeds c: while a stall is
//! short against a block. Where a block does exceed it, those stakes are ruined for good (their factor is set to 0),
//! and the smaller ones, sound without the assumption, go on. (1) needs no such assumption: a *fail* never rests on it.

use super::blocks::{Counts, LAST_BUCKET, above, least_of, most_of};

/// Share of a block that a stall may fill before the larger stakes on *pass* are ruined: 10 ms.
pub const CLUSTER: f64 = 0.04;
/// Stakes of the mixture, each half the one before, and with half its weight: the boldest decides clean cases, and pays
/// only a factor of 2 for the company of the careful ones.
const STAKES: u32 = 12;
/// Part of the largest possible stake that is the largest used: at 1 a single clean or bad block could ruin it.
const BOLDEST: f64 = 0.9;

/// Which side of the budgeted share is bet on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// More ticks than the share are above: evidence that the quantile is larger. (1)
    More,
    /// Fewer are: evidence that it is smaller. (3)
    Fewer,
}

/// ln of the mixture W_t over all blocks; `share` is m, `nominal` the ticks of a whole block.
///
/// A block with fewer ticks stakes in proportion, which keeps (1) a supermartingale.
#[must_use]
pub fn evidence<'a>(
    side: Side,
    share: f64,
    threshold: u16,
    nominal: u64,
    blocks: impl Iterator<Item = &'a Counts>,
) -> f64 {
    let largest = match side {
        Side::More => 1.0 / share,
        Side::Fewer => 1.0 / ((4.0 * share).clamp(CLUSTER, 1.0) - share),
    };
    let mut logs = [0.0; STAKES as usize];
    for counts in blocks {
        let (all, late) = above(counts, threshold);
        let gain = (late as f64 - share * all as f64) / nominal.max(all) as f64;
        let gain = if side == Side::More { gain } else { -gain };
        let mut stake = BOLDEST * largest;
        for log in &mut logs {
            let factor = 1.0 + stake * gain;
            *log += if factor > 0.0 { libm::log(factor) } else { f64::NEG_INFINITY };
            stake *= 0.5;
        }
    }
    let most = logs.iter().fold(f64::NEG_INFINITY, |most, log| most.max(*log));
    if most.is_finite() {
        let mixture = logs.iter().rev().fold(0.0, |sum, log| 0.5 * (sum + libm::exp(log - most)));
        most + libm::log(mixture)
    } else {
        most
    }
}

/// Limits of a quantile, ns; none where the data don't suffice for one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// The quantile is at least this.
    pub lower_ns: Option<u64>,
    /// The quantile is at most this.
    pub upper_ns: Option<u64>,
}

/// The limits of the `quantile` (such as 0.99), each missed with probability at most `alpha`.
#[must_use]
pub fn limits<'a>(quantile: f64, alpha: f64, nominal: u64, blocks: impl Iterator<Item = &'a Counts> + Clone) -> Limits {
    let share = 1.0 - quantile;
    let needed = -libm::log(alpha);
    let rejects = |side, threshold| evidence(side, share, threshold, nominal, blocks.clone()) >= needed;
    // The first threshold at which (1) does not reject any more, and the first at which (3) does.
    let first_not_above = partition(|threshold| rejects(Side::More, threshold));
    let first_below = partition(|threshold| !rejects(Side::Fewer, threshold));
    Limits {
        // Rejected at the bucket before: the quantile lies in this one or above.
        lower_ns: (first_not_above > 0).then(|| least_of(first_not_above)),
        upper_ns: (first_below < LAST_BUCKET).then(|| most_of(first_below)),
    }
}

/// The first bucket for which `holds` is false; it holds for all before.
fn partition(holds: impl Fn(u16) -> bool) -> u16 {
    let (mut low, mut high) = (0, LAST_BUCKET);
    while low < high {
        let middle = low + (high - low) / 2;
        if holds(middle) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    low
}

/// The quantile of all blocks together, ns: the least bucket that holds it, at its upper end.
#[must_use]
pub fn estimate<'a>(quantile: f64, blocks: impl Iterator<Item = &'a Counts> + Clone) -> Option<u64> {
    let all: u64 = blocks.clone().map(|counts| above(counts, 0).0).sum();
    let late = |threshold| blocks.clone().map(|counts| above(counts, threshold).1).sum::<u64>();
    let allowed = (1.0 - quantile) * all as f64;
    (all > 0).then(|| most_of(partition(|threshold| late(threshold) as f64 > allowed)))
}

/// Whether so many samples say anything of a quantile: with fewer it is the largest sample, and nothing is known of what lies above.
#[must_use]
pub fn are_enough(samples: u64, quantile: f64) -> bool {
    samples as f64 >= (1.0 / (1.0 - quantile)).round()
}

#[cfg(test)]
mod tests;
