//! The latencies of a run, block by block: what a verdict is computed from, live and from a recorded run.
//!
//! Late ticks come in clusters (a stall of 5 ms makes five), so ticks are no independent samples. Blocks of
//! [`BLOCK_NS`], much longer than a stall, nearly are. Of each block and hop the counts of logarithmic buckets are kept,
//! 128 an octave: a threshold is resolved to better than 0.8 %, and an hour at 1 kHz fits into some tens of megabytes.
//!
//! A tick that got no torque has no round trip to count, and must not look better than one with a slow torque: in
//! [`Hop::RoundTrip`] and [`Hop::DeadlineToTorque`] it counts as [`NEVER_NS`], above every budget.

use std::fmt::Write as _;

use loopbound_shared::event::Decision;
use loopbound_shared::sample::{Receipt, TickRecord};
use serde::{Deserialize, Serialize};

use crate::hops::Hop;

/// Length of a block.
pub const BLOCK_NS: u64 = 250_000_000;
/// Name of the file in the folder of a run: one line of JSON a block, after one of [`Header`].
pub const FILE: &str = "blocks.jsonl";
/// A torque that never came.
pub const NEVER_NS: u64 = u64::MAX;
/// Buckets an octave; below twice this, every value has a bucket of its own.
const SUB_BUCKETS: u64 = 128;
/// The bucket of [`NEVER_NS`], above all others.
pub const LAST_BUCKET: u16 = 7_423;
/// Blocks beyond these are not kept, and counted: more than four hours.
const BLOCKS_MAX: usize = 65_536;
/// Skipped ticks of one overrun that are counted one by one.
const SKIPPED_MAX: u64 = 1_000;

/// The bucket of a value.
#[must_use]
pub fn bucket(value_ns: u64) -> u16 {
    let shift = u64::from(64 - (value_ns | 1).leading_zeros()).saturating_sub(8);
    u16::try_from(shift * SUB_BUCKETS + (value_ns >> shift)).unwrap_or(LAST_BUCKET)
}

/// The least value of a bucket, ns.
#[must_use]
pub fn least_of(bucket: u16) -> u64 {
    let bucket = u64::from(bucket.min(LAST_BUCKET));
    if bucket < 2 * SUB_BUCKETS {
        return bucket;
    }
    let shift = bucket / SUB_BUCKETS - 1;
    (bucket - shift * SUB_BUCKETS) << shift
}

/// The largest value of a bucket, ns.
#[must_use]
pub fn most_of(bucket: u16) -> u64 {
    if bucket >= LAST_BUCKET { NEVER_NS } else { least_of(bucket + 1) - 1 }
}

/// Counts of one hop in one block: (bucket, count), ascending, no bucket twice.
pub type Counts = Vec<(u16, u32)>;

/// One block.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Block {
    /// Plant time at which it begins, in units of the block's length.
    pub index: u64,
    /// In the order of [`Hop::ALL`].
    pub hops: Vec<Counts>,
}

/// The first line of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Version of the file: 1.
    pub blocks: u32,
    /// Length of a block, ns.
    pub block_ns: u64,
    /// Ticks that a whole block has.
    pub nominal: u64,
}

/// All blocks of a run.
#[derive(Clone, Debug)]
pub struct Blocks {
    nominal: u64,
    closed: Vec<Block>,
    open: [Vec<u16>; Hop::ALL.len()],
    index: u64,
    lost: u64,
}

impl Blocks {
    /// No blocks yet, of a loop with this period.
    #[must_use]
    pub fn new(period_ns: u64) -> Self {
        let nominal = (BLOCK_NS / period_ns.max(1)).max(1);
        Self { nominal, closed: Vec::new(), open: Default::default(), index: 0, lost: 0 }
    }

    /// Ticks that a whole block has.
    #[must_use]
    pub fn nominal(&self) -> u64 {
        self.nominal
    }

    /// The blocks that are complete.
    #[must_use]
    pub fn closed(&self) -> &[Block] {
        &self.closed
    }

    /// Blocks that found no place.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Counts all hops of one tick; `receipt` is that of the accepted torque.
    pub fn record(&mut self, record: &TickRecord, receipt: Option<&Receipt>, period_ns: u64) {
        let index = record.start_plant_ns / BLOCK_NS;
        if index != self.index {
            self.close();
            self.index = index;
        }
        let at_rest = record.decision == Decision::Rest.code();
        for hop in Hop::ALL {
            let open = &mut self.open[hop as usize];
            let needs_torque = matches!(hop, Hop::RoundTrip | Hop::DeadlineToTorque);
            let stamps = hop.stamps(record, receipt);
            match stamps {
                Some((from_ns, to_ns)) => {
                    open.extend(to_ns.checked_sub(from_ns).map(bucket));
                    if matches!(hop, Hop::Wakeup | Hop::DeadlineToTorque) {
                        let waited_ns = |skipped| to_ns.saturating_sub(from_ns.saturating_sub(skipped * period_ns));
                        open.extend((1..=record.skipped_before.min(SKIPPED_MAX)).map(|k| bucket(waited_ns(k))));
                    }
                }
                None if needs_torque && !at_rest => open.push(LAST_BUCKET),
                None => {}
            }
            // Skipped ticks got no torque of their own: they have no round trip, and wait for that of the tick that was not skipped.
            let waits_for_torque = hop == Hop::DeadlineToTorque && stamps.is_some();
            if needs_torque && !at_rest && !waits_for_torque {
                open.extend((0..record.skipped_before.min(SKIPPED_MAX)).map(|_| LAST_BUCKET));
            }
        }
    }

    /// Closes the block that is being filled; one with less than half of its ticks is left out.
    pub fn close(&mut self) {
        let ticks = self.open.iter().map(Vec::len).max().unwrap_or(0) as u64;
        if 2 * ticks >= self.nominal && self.closed.len() < BLOCKS_MAX {
            let hops = self.open.iter_mut().map(|values| counts_of(values)).collect();
            self.closed.push(Block { index: self.index, hops });
        } else {
            self.lost += u64::from(2 * ticks >= self.nominal);
        }
        self.open.iter_mut().for_each(Vec::clear);
    }

    /// Adds a block: for tests, simulations and files.
    pub fn push(&mut self, block: Block) {
        self.closed.push(block);
    }

    /// Adds all blocks of another run of the same loop: what is computed from blocks then counts both.
    pub fn append(&mut self, other: &Self) {
        self.closed.extend_from_slice(&other.closed);
        self.lost += other.lost;
    }

    /// The file.
    #[must_use]
    pub fn to_text(&self) -> String {
        let header = Header { blocks: 1, block_ns: BLOCK_NS, nominal: self.nominal };
        let mut text = serde_json::to_string(&header).unwrap_or_default();
        text.push('\n');
        for block in &self.closed {
            let _ = writeln!(text, "{}", serde_json::to_string(block).unwrap_or_default());
        }
        text
    }

    /// Reads the file back.
    ///
    /// # Errors
    /// One line: which line of the file is not what it should be.
    pub fn from_text(text: &str) -> Result<Self, String> {
        let mut lines = text.lines().enumerate();
        let header = lines.next().ok_or("it is empty")?.1;
        let header: Header = serde_json::from_str(header).map_err(|e| format!("line 1: {e}"))?;
        if header.blocks != 1 || header.nominal == 0 {
            return Err(format!("line 1: version {} with {} ticks a block", header.blocks, header.nominal));
        }
        let mut blocks =
            Self { nominal: header.nominal, closed: Vec::new(), open: Default::default(), index: 0, lost: 0 };
        for (number, line) in lines {
            let mut block: Block = serde_json::from_str(line).map_err(|e| format!("line {}: {e}", number + 1))?;
            let ascending = |counts: &Counts| counts.windows(2).all(|pair| pair[0].0 < pair[1].0);
            if block.hops.len() > Hop::ALL.len() || !block.hops.iter().all(ascending) {
                return Err(format!("line {}: no counts of hops", number + 1));
            }
            block.hops.resize(Hop::ALL.len(), Counts::new());
            blocks.closed.push(block);
        }
        Ok(blocks)
    }

    /// The counts of one hop, block by block; blocks without any are left out.
    pub fn of(&self, hop: Hop) -> impl Iterator<Item = &Counts> + Clone {
        self.closed.iter().filter_map(move |block| block.hops.get(hop as usize)).filter(|counts| !counts.is_empty())
    }
}

/// Sorts and counts.
#[must_use]
pub fn counts_of(buckets: &mut [u16]) -> Counts {
    buckets.sort_unstable();
    buckets.chunk_by(|a, b| a == b).map(|run| (run[0], u32::try_from(run.len()).unwrap_or(u32::MAX))).collect()
}

/// All ticks of a block, and those above a bucket.
#[must_use]
pub fn above(counts: &Counts, bucket: u16) -> (u64, u64) {
    counts.iter().fold((0, 0), |(all, above), (at, count)| {
        (all + u64::from(*count), above + u64::from(*count) * u64::from(*at > bucket))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{PERIOD_NS, good, unanswered};
    use crate::tracker::accepted;

    #[test]
    fn buckets_tile_all_values_in_order_and_are_narrow() {
        assert_eq!(bucket(NEVER_NS), LAST_BUCKET);
        for number in 0..LAST_BUCKET {
            assert_eq!((bucket(least_of(number)), bucket(most_of(number))), (number, number));
            assert_eq!(most_of(number) + 1, least_of(number + 1));
            let width = (most_of(number) - least_of(number)) as f64;
            assert!(width <= least_of(number) as f64 / 128.0, "{number}");
        }
    }

    #[test]
    fn a_tick_without_a_torque_counts_as_one_that_never_ended() {
        let mut blocks = Blocks::new(PERIOD_NS);
        for tick in 0..500 {
            let record = if tick % 10 == 3 { unanswered(tick) } else { good(tick) };
            blocks.record(&record, accepted(&record), PERIOD_NS);
        }
        blocks.close();
        assert_eq!(blocks.closed().len(), 2);
        let round_trips: Vec<(u64, u64)> = blocks.of(Hop::RoundTrip).map(|c| above(c, LAST_BUCKET - 1)).collect();
        assert_eq!(round_trips, [(250, 25), (250, 25)]);
        assert_eq!(above(blocks.of(Hop::Compute).next().unwrap(), 0).0, 225);
    }

    #[test]
    fn skipped_ticks_have_no_round_trip_and_are_above_every_latency() {
        let counts = |answered: bool, hop: Hop| {
            let mut blocks = Blocks::new(PERIOD_NS);
            (0..200).for_each(|tick| blocks.record(&good(tick), accepted(&good(tick)), PERIOD_NS));
            let mut record = if answered { good(230) } else { unanswered(230) };
            record.skipped_before = 30;
            blocks.record(&record, accepted(&record), PERIOD_NS);
            blocks.close();
            blocks.of(hop).map(|counts| above(counts, LAST_BUCKET - 1)).collect::<Vec<_>>()
        };
        assert_eq!(counts(true, Hop::RoundTrip), [(231, 30)]);
        assert_eq!(counts(false, Hop::RoundTrip), [(231, 31)]);
        // Each waits for the torque of the next tick, if one came.
        assert_eq!(counts(true, Hop::DeadlineToTorque), [(231, 0)]);
        assert_eq!(counts(false, Hop::DeadlineToTorque), [(231, 31)]);
    }

    #[test]
    fn the_file_reads_back_as_it_was_and_a_broken_one_names_its_line() {
        let mut blocks = Blocks::new(PERIOD_NS);
        (0..750).for_each(|tick| blocks.record(&good(tick), accepted(&good(tick)), PERIOD_NS));
        blocks.close();
        let text = blocks.to_text();
        let back = Blocks::from_text(&text).unwrap();
        assert_eq!((back.closed(), back.nominal()), (blocks.closed(), 250));
        assert!(Blocks::from_text(&text.replace("\"index\":1", "\"index\":x")).unwrap_err().starts_with("line 3"));
        assert!(Blocks::from_text("").is_err());
    }
}
