//! `latency.hlog` read back: the histograms of recorded runs, added up without any loss.
//!
//! Responsible for histograms alone: adding those of several runs gives the one that a single run over all their ticks
//! would have, which no arithmetic on quantiles can.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use hdrhistogram::Histogram;
use hdrhistogram::serialization::Deserializer;
use hdrhistogram::serialization::interval_log::{IntervalLogIterator, LogEntry};

use crate::hops::{Hop, Hops};
use crate::summary::{Quantiles, Summary};

/// Name of the file in the folder of a run.
pub const FILE: &str = "latency.hlog";

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
        let histogram: Histogram<u64> =
            deserializer.deserialize(&mut bytes.as_slice()).map_err(|e| format!("{FILE}: {tag}: {e}"))?;
        sum.of_mut(hop).add(&histogram).map_err(|e| format!("{FILE}: {tag}: {e}"))?;
    }
    for hop in Hop::ALL {
        if let Some(own) = quantiles(summary, hop) {
            sum.of_mut(hop).note(own);
        }
    }
    Ok(())
}

/// The figures of one hop in a summary.
#[must_use]
pub fn quantiles(summary: &Summary, hop: Hop) -> Option<&Quantiles> {
    let latency = &summary.latency_ns;
    match hop {
        Hop::Wakeup => Some(&latency.wakeup),
        Hop::StateToController => Some(&latency.state_to_controller),
        Hop::Compute => Some(&latency.compute),
        Hop::ControllerToPlant => Some(&latency.controller_to_plant),
        Hop::RoundTrip => Some(&latency.round_trip),
        Hop::DeadlineToTorque => Some(&latency.deadline_to_torque),
        Hop::SetpointAge => Some(&latency.setpoint_age),
        Hop::Floor => summary.floor.as_ref(),
    }
}

#[cfg(test)]
mod tests {
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
