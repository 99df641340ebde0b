//! The files of a run, written by a thread of their own: `samples.mcap`, `samples.csv`, `events.jsonl`, `latency.hlog`,
//! and at the end `summary.json`, `blocks.jsonl` and `latency/*.{hgrm,svg}`.
//!
//! The queue to the thread is bounded. What finds it full is counted as dropped, so that a slow disc costs lines of a
//! file and never a record; only in lockstep, where the plant can wait, the monitor waits too. What can't be written at
//! all, since the disc is full, ends the recording and not the watching: the loss is named at once, everything after it
//! is counted, and the folder stays unfinished.

mod writer;

use std::fmt::Write as _;
use std::io;
use std::path::PathBuf;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

use hdrhistogram::Histogram;

use loopbound_shared::run_id::RunId;
use loopbound_shared::sample::{Announce, TickRecord};
use loopbound_shared::spawn;

use crate::event::Event;
use crate::folder::{Results, known};
use crate::hops::{Hop, Hops};
use crate::recording::About;
use crate::summary::{Dropped, RecordingSummary, Summary};
use crate::tracker::Row;
use crate::verdict::blocks::{self, Blocks};
use writer::Written;

/// The file in the group's folder by which a managed monitor tells that it can't record any more, and why.
pub const LOST_FILE: &str = "recording-lost";
/// Entries that wait for the disc: more than a second of ticks at 10 kHz.
const QUEUE: usize = 16_384;

pub(crate) enum Entry {
    /// Boxed: a queue of whole records would be tens of megabytes, full or not.
    Tick(Box<(TickRecord, Row)>),
    Announce(Box<Announce>),
    Event(Event),
    Interval {
        start_ns: u64,
        duration_ns: u64,
        hops: Box<Hops>,
    },
}

impl Entry {
    fn drop_into(&self, dropped: &mut Dropped) {
        match self {
            Self::Tick(_) => dropped.samples += 1,
            Self::Event(_) | Self::Announce(_) => dropped.events += 1,
            Self::Interval { .. } => dropped.intervals += 1,
        }
    }
}

/// Whose the folder is that the files go into.
pub enum Place {
    /// The launcher takes it for the run, after everyone is ready and before the first tick.
    Launcher(PathBuf, RunId),
    /// It was taken by this process.
    Own(Results),
}

/// The sending end of the writer's queue.
pub struct Recorder {
    queue: Option<SyncSender<Entry>>,
    writer: Option<JoinHandle<Written>>,
    lossless: bool,
    dropped: Dropped,
    lost: Lost,
    results: Option<Results>,
}

/// Why nothing more is written, once that is so.
pub(crate) type Lost = Arc<OnceLock<String>>;

impl Recorder {
    /// Starts the writer; it opens the files with the first tick. `lossless`: wait for the disc instead of dropping.
    /// `trace_s`: how much of the samples before and after a change of the controller in charge goes into a file of its
    /// own.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(place: Place, about: About, lossless: bool, trace_s: f64) -> io::Result<Self> {
        let (queue, entries) = sync_channel(QUEUE);
        let lost = Lost::default();
        let of_writer = Arc::clone(&lost);
        let write = move || writer::write(&entries, place, about, trace_s, &of_writer);
        let writer = spawn::thread("recorder", write)?;
        let dropped = Dropped::default();
        Ok(Self { queue: Some(queue), writer: Some(writer), lossless, dropped, lost, results: None })
    }

    /// Why the recording has ended before the run, once it has.
    #[must_use]
    pub fn lost(&self) -> Option<&str> {
        self.lost.get().map(String::as_str)
    }

    fn send(&mut self, entry: Entry) {
        let Some(queue) = &self.queue else { return };
        let refused = if self.lossless {
            queue.send(entry).map_err(|e| e.0).err()
        } else {
            queue.try_send(entry).map_err(|(TrySendError::Full(entry) | TrySendError::Disconnected(entry))| entry).err()
        };
        if let Some(entry) = refused {
            entry.drop_into(&mut self.dropped);
        }
    }

    /// Queues a tick: its record for `samples.mcap` and its line of `samples.csv`.
    pub fn tick(&mut self, record: &TickRecord, row: Row) {
        self.send(Entry::Tick(Box::new((*record, row))));
    }

    /// Queues what a process said of itself.
    pub fn announce(&mut self, announce: &Announce) {
        self.send(Entry::Announce(Box::new(*announce)));
    }

    /// Queues a line of `events.jsonl`.
    pub fn event(&mut self, event: Event) {
        self.send(Entry::Event(event));
    }

    /// Queues the histograms of an interval that began `start_ns` after the start.
    pub fn interval(&mut self, start_ns: u64, duration_ns: u64, hops: &Hops) {
        self.send(Entry::Interval { start_ns, duration_ns, hops: Box::new(hops.clone()) });
    }

    /// Waits until everything queued is on disc, or lost. Returns what was dropped.
    pub fn finish(&mut self) -> Dropped {
        self.queue = None;
        match self.writer.take().map(JoinHandle::join) {
            Some(Ok(Written { results, dropped })) => {
                self.results = results;
                self.dropped.samples += dropped.samples;
                self.dropped.events += dropped.events;
                self.dropped.intervals += dropped.intervals;
            }
            Some(Err(_)) => {
                let _ = self.lost.set("the thread that writes the files has ended badly".to_owned());
            }
            None => {}
        }
        self.dropped
    }

    /// What a summary says of the recording.
    #[must_use]
    pub fn state(&self) -> RecordingSummary {
        let whole = self.lost.get().is_none() && self.dropped == Dropped::default();
        RecordingSummary { whole, error: self.lost.get().cloned() }
    }

    /// Writes the files that belong to the end of a run, and `summary` with what became of the recording. `ends`: nobody
    /// writes anything after this process.
    pub fn write_end(&mut self, summary: &mut Summary, hops: &Hops, blocks: &Blocks, ends: bool) {
        summary.recording = Some(self.state());
        let Some(mut results) = self.results.take() else { return };
        if let Err(error) = write_figures(&mut results, summary, hops, blocks) {
            let _ = self.lost.set(format!("{error}, at the end of the run"));
            summary.recording = Some(self.state());
        }
        match self.lost.get() {
            Some(why) => results.leave_unfinished(why),
            None if !self.state().whole => results.leave_unfinished(&self.dropped.to_string()),
            None => {
                let saved = if ends { results.finish() } else { results.save() };
                if let Err(error) = saved {
                    let _ = self.lost.set(format!("{}: {error}, at the end of the run", crate::folder::FILE));
                    summary.recording = Some(self.state());
                }
            }
        }
    }
}

fn write_figures(results: &mut Results, summary: &Summary, hops: &Hops, blocks: &Blocks) -> io::Result<()> {
    let mut write = |name: &str, bytes: &[u8]| {
        results.write(name, bytes).map_err(|error| io::Error::new(error.kind(), format!("{name}: {error}")))
    };
    write(known::SUMMARY, &summary_text(summary)?)?;
    write(blocks::FILE, blocks.to_text().as_bytes())?;
    for hop in Hop::ALL {
        write(&format!("latency/{}.hgrm", hop.name()), percentiles(hops.of(hop).histogram()).as_bytes())?;
        let svg = crate::plot::percentile_plot(hop.name(), hops.of(hop).histogram());
        write(&format!("latency/{}.svg", hop.name()), svg.as_bytes())?;
    }
    Ok(())
}

/// `summary.json` as it is written.
///
/// # Errors
/// If it can't be expressed.
pub fn summary_text(summary: &Summary) -> io::Result<Vec<u8>> {
    let mut text = serde_json::to_string_pretty(summary)?;
    text.push('\n');
    Ok(text.into_bytes())
}

/// A percentile file as the plotters of HdrHistogram read it, in µs.
#[must_use]
pub fn percentiles(histogram: &Histogram<u64>) -> String {
    let mut text = format!("{:>12} {:>14} {:>10} {:>14}\n\n", "Value", "Percentile", "TotalCount", "1/(1-Percentile)");
    let mut total = 0;
    for step in histogram.iter_quantiles(5) {
        total += step.count_since_last_iteration();
        let (value_us, quantile) = (step.value_iterated_to() as f64 * 1e-3, step.quantile_iterated_to());
        let _ = write!(text, "{value_us:>12.3} {quantile:>2.12} {total:>10}");
        let _ = if quantile < 1.0 { writeln!(text, " {:>14.2}", 1.0 / (1.0 - quantile)) } else { writeln!(text) };
    }
    let (mean_us, stdev_us) = (histogram.mean() * 1e-3, histogram.stdev() * 1e-3);
    let _ = writeln!(text, "#[Mean    = {mean_us:>12.3}, StdDeviation   = {stdev_us:>12.3}]");
    let (max_us, count) = (histogram.max() as f64 * 1e-3, histogram.len());
    let _ = writeln!(text, "#[Max     = {max_us:>12.3}, Total count    = {count:>12}]");
    let _ = writeln!(text, "#[Buckets = {:>12}, SubBuckets     = {:>12}]", histogram.buckets(), 2048);
    text
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::folder::{Begin, Claim, Kind, Look, State};
    use crate::recording::Started;
    use crate::summary::SCHEMA;
    use crate::testing::good;
    use crate::tracker::Tracker;
    use hdrhistogram::serialization::interval_log::{IntervalLogIterator, LogEntry};
    use std::time::Duration;

    /// A run of 3000 ticks with an interval every 1000, and an event each.
    fn record_into(folder: &Path) -> Summary {
        let mut tracker: Tracker<3> = crate::testing::tracker();
        let claim = Claim::prepare(folder, Kind::Run).unwrap();
        let run_id = about().run_id.parse().unwrap();
        let begin = Begin { run_id, group: "g", scenario: Some("[loop]\n"), waypoints: None };
        let place = Place::Own(claim.begin(&begin).unwrap());
        let mut recorder = Recorder::start(place, about(), true, 0.1).unwrap();
        for tick in 0..3000 {
            let mut record = good(tick);
            record.q[2] = 0.125;
            if tick == 7 {
                record.receipts[0].arrived_ns = 0;
                record.receipts[0].acceptance = 0;
            }
            recorder.tick(&record, tracker.feed(&record).unwrap());
            tracker.drain_events().for_each(|event| recorder.event(event));
            if tick % 1000 == 999 {
                recorder.interval((tick - 999) * 1_000_000, 1_000_000_000, tracker.interval());
                tracker.start_interval();
            }
        }
        tracker.finish();
        let mut summary = tracker.summarise();
        summary.dropped = recorder.finish();
        recorder.write_end(&mut summary, tracker.hops(), tracker.blocks(), true);
        assert!(recorder.state().whole, "{:?}", recorder.state());
        summary
    }

    fn about() -> About {
        let started = Started { wall_ns: 1_700_000_000_250_000_000, monotonic_ns: None };
        About {
            links: 3,
            length_m: [1.0; 7],
            started,
            group: "g".into(),
            scenario: "[loop]\n".into(),
            run_id: "00000000000000ab".into(),
        }
    }

    fn temporary(what: &str) -> PathBuf {
        std::env::temp_dir().join(format!("loopbound-{what}-{}", std::process::id()))
    }

    #[test]
    fn the_interval_log_reads_back_with_every_tick_of_every_hop() {
        let folder = temporary("hlog");
        let summary = record_into(&folder);
        let log = fs::read(folder.join("latency.hlog")).unwrap();
        let intervals = IntervalLogIterator::new(&log).filter_map(|entry| match entry.unwrap() {
            LogEntry::Interval(interval) => Some(interval.duration()),
            _ => None,
        });
        let durations: Vec<Duration> = intervals.collect();
        assert_eq!(durations, vec![Duration::from_secs(1); 3 * Hop::ALL.len()]);
        let mut read = Hops::default();
        crate::log::add(&mut read, &log, &summary).unwrap();
        assert_eq!(read.of(Hop::RoundTrip).quantiles().n, 2999);
        assert_eq!(read.latency(), summary.latency_ns);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn the_table_has_one_line_a_tick_and_an_empty_round_trip_where_none_was_accepted() {
        let folder = temporary("csv");
        let summary = record_into(&folder);
        let text = fs::read_to_string(folder.join("samples.csv")).unwrap();
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        assert_eq!(lines.len(), 3001);
        assert_eq!(lines[0][..5], ["tick", "t_s", "q1", "q2", "q3"]);
        assert_eq!(lines[0][lines[0].len() - 4..], ["V", "V_bound", "round_trip_ns", "active"]);
        assert!(lines.iter().all(|line| line.len() == 2 + 6 * 3 + 4));
        assert_eq!((lines[8][0], lines[8][4], lines[8][22], lines[9][22]), ("7", "0.125", "", "8000"));
        let back: Summary = serde_json::from_slice(&fs::read(folder.join("summary.json")).unwrap()).unwrap();
        assert_eq!((&back, back.schema), (&summary, SCHEMA));
        let events = fs::read_to_string(folder.join("events.jsonl")).unwrap();
        assert!(events.starts_with("{\"kind\":\"first seen\""), "{events}");
        assert_eq!(fs::read_to_string(folder.join("scenario.toml")).unwrap(), "[loop]\n");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_percentile_file_ends_at_one_with_the_count_and_the_largest_value() {
        let mut histogram = Histogram::<u64>::new_with_bounds(1, 10_000_000_000, 3).unwrap();
        (1..=1000u64).for_each(|value| histogram.record(value * 1000).unwrap());
        let text = percentiles(&histogram);
        let last = text.lines().rfind(|line| !line.starts_with('#')).unwrap();
        let cells: Vec<&str> = last.split_whitespace().collect();
        assert_eq!((cells[1].parse::<f64>().unwrap().to_bits(), cells[2]), (1f64.to_bits(), "1000"));
        assert!((cells[0].parse::<f64>().unwrap() / 1000.0 - 1.0).abs() < 1e-3);
        assert!(text.contains("Total count    =         1000]"));
    }

    #[test]
    fn the_folder_is_whole_in_the_end_and_every_file_says_whose_it_is() {
        let folder = temporary("whole");
        let summary = record_into(&folder);
        let look = Look::at(&folder).unwrap();
        assert!(look.is_whole(), "{:?}", look.faults);
        let manifest = look.manifest.unwrap();
        assert_eq!((manifest.run_id.as_str(), manifest.state), ("00000000000000ab", State::Finished));
        for name in
            ["summary.json", "samples.mcap", "samples.csv", "latency.hlog", "blocks.jsonl", "latency/wakeup.svg"]
        {
            assert!(manifest.files.contains_key(name), "{name}: {:?}", manifest.files.keys());
        }
        assert_eq!(summary.recording.map(|recording| recording.whole), Some(true));
        let log = fs::read_to_string(folder.join("latency.hlog")).unwrap();
        assert_eq!(log.lines().nth(1), Some("#run_id 00000000000000ab"));
        let recording = crate::recording::reader::Recording::open(&folder.join("samples.mcap")).unwrap();
        assert_eq!(recording.header().run_id, "00000000000000ab");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_folder_that_another_run_has_taken_loses_every_row_and_no_row_of_the_other() {
        let folder = temporary("taken");
        let summary = record_into(&folder);
        let mut tracker: Tracker<3> = crate::testing::tracker();
        let place = Place::Launcher(folder.clone(), loopbound_shared::run_id::RunId::draw());
        let mut recorder = Recorder::start(place, about(), true, 0.1).unwrap();
        (0..100).for_each(|tick| recorder.tick(&good(tick), tracker.feed(&good(tick)).unwrap()));
        assert_eq!(recorder.finish().samples, 100);
        assert!(recorder.lost().unwrap().contains("another run has taken the folder"), "{:?}", recorder.lost());
        assert!(!recorder.state().whole);
        let back: Summary = serde_json::from_slice(&fs::read(folder.join("summary.json")).unwrap()).unwrap();
        assert_eq!(back.ticks_seen, summary.ticks_seen);
        fs::remove_dir_all(folder).unwrap();
    }
}
