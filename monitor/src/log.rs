//! `latency.hlog` read back: the histograms of recorded runs, added up without any loss.
//!
//! Responsible for histograms alone: adding those of several runs gives the one that a single run over all their ticks
//! would have, which no arithmetic on quantiles can.

use std::io::Read as _;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::read::ZlibDecoder;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::Deserializer;
use hdrhistogram::serialization::interval_log::{IntervalLogIterator, LogEntry};

use crate::hops::{Hop, Hops};
use crate::summary::Summary;

/// Name of the file in the folder of a run.
pub const FILE: &str = "latency.hlog";

/// The first bytes of a compressed histogram of version 2.
const COMPRESSED: [u8; 4] = [0x1c, 0x84, 0x93, 0x14];
/// Before the counts: cookie, length, offset, digits, lowest, highest, ratio.
const HEADER_BYTES: usize = 40;
/// No histogram of an interval is longer once unpacked, bytes: those of a run have some tens of kilobytes.
const HISTOGRAM_BYTES_MAX: u64 = 16 << 20;
/// Of more digits the counts alone would be hundreds of megabytes.
const DIGITS_MAX: u32 = 4;

/// Adds all intervals of a run's log to `sum`. What a log has no place for (exact largest values, counts of what is no
/// latency) comes from the run's `summary`.
///
/// # Errors
/// One line: what the log does not hold to. Then `sum` has a part of the run.
pub fn add(sum: &mut Hops, log: &[u8], summary: &Summary) -> Result<(), String> {
    let mut deserializer = Deserializer::new();
    for entry in IntervalLogIterator::new(log) {
        let LogEntry::Interval(interval) = entry.map_err(|e| format!("{FILE}: {e:?}"))? else { continue };
        let tag = interval.tag().map_or("", |tag| tag.as_str());
        // A later version may log more hops than this one knows.
        let Some(hop) = Hop::ALL.into_iter().find(|hop| hop.name() == tag) else { continue };
        let bytes = STANDARD.decode(interval.encoded_histogram()).map_err(|e| format!("{FILE}: {tag}: {e}"))?;
        let bytes = unpacked(&bytes).map_err(|e| format!("{FILE}: {tag}: {e}"))?;
        let histogram: Histogram<u64> =
            deserializer.deserialize(&mut bytes.as_slice()).map_err(|e| format!("{FILE}: {tag}: {e}"))?;
        sum.of_mut(hop).add(&histogram).map_err(|e| format!("{FILE}: {tag}: {e}"))?;
    }
    for hop in Hop::ALL {
        if let Some(own) = summary.hop(hop) {
            sum.of_mut(hop).note(own);
        }
    }
    Ok(())
}

/// The histogram without its compression, once its header has nothing that the memory could not bear: the deserialiser
/// takes as much as the header asks for.
fn unpacked(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let found = match bytes.split_first_chunk() {
        Some((cookie, rest)) if *cookie == COMPRESSED => {
            let mut unpacked = Vec::new();
            let decoder = ZlibDecoder::new(rest.get(4..).unwrap_or_default());
            decoder.take(HISTOGRAM_BYTES_MAX + 1).read_to_end(&mut unpacked).map_err(|e| e.to_string())?;
            unpacked
        }
        _ => bytes.to_vec(),
    };
    let number = |at: usize| found.get(at..at + 4).and_then(|four| four.try_into().ok()).map(u32::from_be_bytes);
    let (Some(payload), Some(digits)) = (number(4), number(12)) else { return Err("no histogram".to_owned()) };
    let there = found.len().saturating_sub(HEADER_BYTES);
    if found.len() as u64 > HISTOGRAM_BYTES_MAX || payload as usize > there {
        return Err(format!("a histogram of {payload} bytes, of which {there} are there"));
    }
    if digits > DIGITS_MAX {
        return Err(format!("a histogram of {digits} digits, allowed: 0 to {DIGITS_MAX}"));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;
    use std::time::{Duration, SystemTime};

    use hdrhistogram::serialization::V2DeflateSerializer;
    use hdrhistogram::serialization::interval_log::{IntervalLogWriterBuilder, Tag};

    use super::*;
    use crate::hops::Distribution;

    /// The log and the summary of a run with these round trips, ns, in intervals of 100.
    fn run(values_ns: &[u64]) -> (Vec<u8>, Summary) {
        let (mut log, mut serializer, mut whole) = (Vec::new(), V2DeflateSerializer::new(), Distribution::default());
        let mut writer = IntervalLogWriterBuilder::new()
            .with_start_time(SystemTime::UNIX_EPOCH)
            .begin_log_with(&mut log, &mut serializer)
            .unwrap();
        for (at, values) in values_ns.chunks(100).enumerate() {
            let mut interval = Distribution::default();
            values.iter().for_each(|value| interval.record(*value));
            values.iter().for_each(|value| whole.record(*value));
            let (start, tag) = (Duration::from_secs(at as u64), Tag::new(Hop::RoundTrip.name()));
            writer.write_histogram(interval.histogram(), start, Duration::from_secs(1), tag).unwrap();
        }
        drop(writer);
        let mut summary = Summary::default();
        summary.latency_ns.round_trip = whole.quantiles();
        (log, summary)
    }

    /// A histogram whose header asks for so much, in a log.
    fn asking_for(payload: u32, digits: u32, compressed: bool) -> Vec<u8> {
        let mut plain = vec![0x1c, 0x84, 0x93, 0x13];
        plain.extend([payload, 0, digits].map(u32::to_be_bytes).concat());
        plain.extend([1_u64, 1 << 40, 1.0_f64.to_bits()].map(u64::to_be_bytes).concat());
        plain.extend([0; 64]);
        if compressed {
            let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
            encoder.write_all(&plain).unwrap();
            let packed = encoder.finish().unwrap();
            let length = u32::try_from(packed.len()).unwrap();
            plain = [&COMPRESSED[..], &length.to_be_bytes(), &packed].concat();
        }
        let encoded = STANDARD.encode(plain);
        format!("#[StartTime: 0.000]\nTag=round_trip,0.000,1.000,1.000,{encoded}\n").into_bytes()
    }

    #[test]
    fn a_header_that_asks_for_more_than_is_there_is_refused_before_anything_is_reserved_for_it() {
        let refusal = |log: &[u8]| add(&mut Hops::default(), log, &Summary::default()).unwrap_err();
        for compressed in [false, true] {
            let words = refusal(&asking_for(u32::MAX - 15, 3, compressed));
            assert!(words.contains("4294967280 bytes, of which 64 are there"), "{compressed}: {words}");
            let words = refusal(&asking_for(64, 5, compressed));
            assert!(words.contains("5 digits, allowed: 0 to 4"), "{compressed}: {words}");
        }
        // Some kilobytes that unpack to far more than any histogram has.
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(&vec![0; 64 << 20]).unwrap();
        let packed = [&COMPRESSED[..], &[0; 4], &encoder.finish().unwrap()].concat();
        assert!(packed.len() < 100_000);
        let log = format!("Tag=round_trip,0.000,1.000,1.000,{}\n", STANDARD.encode(packed));
        assert!(refusal(log.as_bytes()).contains("a histogram of"), "{}", refusal(log.as_bytes()));
    }

    #[test]
    fn runs_added_up_have_the_quantiles_of_one_run_over_all_their_ticks_and_not_the_mean_of_theirs() {
        let calm: Vec<u64> = (0..900).map(|k| 5_000 + k).collect();
        let stormy: Vec<u64> = (0..100).map(|k| 1_000_000 + 1_001 * k).collect();
        let mut sum = Hops::default();
        for values in [&calm, &stormy] {
            let (log, summary) = run(values);
            add(&mut sum, &log, &summary).unwrap();
        }
        let mut together = Distribution::default();
        calm.iter().chain(&stormy).for_each(|value| together.record(*value));
        let sum = sum.of(Hop::RoundTrip).quantiles();
        assert_eq!(sum, together.quantiles());
        assert_eq!((sum.n, sum.max), (1000, Some(1_099_099.0)), "the largest is exact, not the end of its bucket");
        let mean_of_medians = (5_450.0 + 1_050_050.0) / 2.0;
        assert!(sum.p50.unwrap() < 6_000.0 && mean_of_medians > 500_000.0);
    }

    #[test]
    fn a_log_that_is_cut_within_a_histogram_is_an_error_that_names_the_file() {
        let (log, summary) = run(&[1_000; 300]);
        let error = add(&mut Hops::default(), &log[..log.len() - 20], &summary).unwrap_err();
        assert!(error.contains("latency.hlog"), "{error}");
    }
}
