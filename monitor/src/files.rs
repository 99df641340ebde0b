//! The files of a run, written by a thread of their own: `samples.mcap`, `samples.csv`, `events.jsonl`, `latency.hlog`,
//! and at the end `summary.json`, `scenario.toml`, `blocks.jsonl` and `latency/*.{hgrm,svg}`.
//!
//! The queue to the thread is bounded. What finds it full is counted as dropped, so that a slow disc costs lines of a
//! file and never a record; only in lockstep, where the plant can wait, the monitor waits too.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use hdrhistogram::Histogram;
use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriterBuilder, Tag};

use loopbound_shared::sample::{Announce, TickRecord};

use crate::event::Event;
use crate::hops::{Hop, Hops};
use crate::recording::{About, McapWriter};
use crate::summary::{Dropped, Summary};
use crate::traces::Traces;
use crate::tracker::Row;
use crate::verdict::blocks::{self, Blocks};

/// Entries that wait for the disc: more than a second of ticks at 10 kHz.
const QUEUE: usize = 16_384;
/// Interval logs give the largest value in milliseconds.
const NS_PER_MS: f64 = 1e6;

enum Entry {
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

/// The sending end of the writer's queue.
pub struct Recorder {
    folder: PathBuf,
    queue: Option<SyncSender<Entry>>,
    writer: Option<JoinHandle<io::Result<()>>>,
    lossless: bool,
    dropped: Dropped,
}

impl Recorder {
    /// Opens the files in `folder` (made if absent) and starts the writer. `lossless`: wait for the disc instead of
    /// dropping. `trace_s`: how much of the samples before and after a change of the controller in charge goes into a
    /// file of its own.
    ///
    /// # Errors
    /// If a file can't be made.
    pub fn start(folder: &Path, about: About, lossless: bool, trace_s: f64) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let open = |name: &str| File::create(folder.join(name)).map(BufWriter::new);
        let (mut samples, events, latency) = (open("samples.csv")?, open("events.jsonl")?, open("latency.hlog")?);
        samples.write_all(csv_header(about.links).as_bytes())?;
        let (links, wall_start_ns) = (about.links, about.started.wall_ns);
        let recording = McapWriter::create(&folder.join("samples.mcap"), about)?;
        let (queue, entries) = sync_channel(QUEUE);
        // Both bounds of V: the promise is in every row of the samples, the certified level only here.
        let header = format!("{},V_level\n", csv_header(links).trim_end());
        let traces = Traces::new(folder.join("changes"), header, trace_s);
        let tables = Tables { recording, samples, events, latency, traces };
        let write = move || write_entries(&entries, links, wall_start_ns, tables);
        let writer = std::thread::Builder::new().name("recorder".to_owned()).spawn(write)?;
        let (folder, dropped) = (folder.to_owned(), Dropped::default());
        Ok(Self { folder, queue: Some(queue), writer: Some(writer), lossless, dropped })
    }

    fn send(&mut self, entry: Entry) {
        let Some(queue) = &self.queue else { return };
        let refused = if self.lossless {
            queue.send(entry).map_err(|e| e.0).err()
        } else {
            queue.try_send(entry).map_err(|(TrySendError::Full(entry) | TrySendError::Disconnected(entry))| entry).err()
        };
        match refused {
            None => {}
            Some(Entry::Tick(_)) => self.dropped.samples += 1,
            Some(Entry::Event(_) | Entry::Announce(_)) => self.dropped.events += 1,
            Some(Entry::Interval { .. }) => self.dropped.intervals += 1,
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

    /// Waits until everything queued is on disc. Returns what was dropped.
    ///
    /// # Errors
    /// What the writer met: a full disc, say.
    pub fn finish(&mut self) -> io::Result<Dropped> {
        self.queue = None;
        match self.writer.take().map(JoinHandle::join) {
            Some(Ok(result)) => result?,
            Some(Err(_)) => return Err(io::Error::other("the thread that writes the files has ended badly")),
            None => {}
        }
        Ok(self.dropped)
    }

    /// Writes the files that belong to the end of a run.
    ///
    /// # Errors
    /// If a file can't be written.
    pub fn write_end(&self, summary: &Summary, hops: &Hops, blocks: &Blocks, scenario_toml: &str) -> io::Result<()> {
        write_atomically(&self.folder.join("scenario.toml"), scenario_toml.as_bytes())?;
        fs::write(self.folder.join(blocks::FILE), blocks.to_text())?;
        let folder = self.folder.join("latency");
        fs::create_dir_all(&folder)?;
        for hop in Hop::ALL {
            let text = percentiles(hops.of(hop).histogram());
            fs::write(folder.join(format!("{}.hgrm", hop.name())), text)?;
            let svg = crate::plot::percentile_plot(hop.name(), hops.of(hop).histogram());
            fs::write(folder.join(format!("{}.svg", hop.name())), svg)?;
        }
        write_atomically(&self.folder.join("summary.json"), summary_text(summary)?.as_bytes())
    }
}

/// The text of `summary.json`.
pub(crate) fn summary_text(summary: &Summary) -> io::Result<String> {
    let mut text = serde_json::to_string_pretty(summary)?;
    text.push('\n');
    Ok(text)
}

pub(crate) fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(format!(".{}.tmp", std::process::id()));
    fs::write(&beside, bytes)?;
    fs::rename(&beside, path)
}

/// What is written while the run lasts.
struct Tables {
    recording: McapWriter,
    samples: BufWriter<File>,
    events: BufWriter<File>,
    latency: BufWriter<File>,
    traces: Traces,
}

fn write_entries(entries: &Receiver<Entry>, links: usize, wall_start_ns: u64, tables: Tables) -> io::Result<()> {
    let Tables { mut recording, mut samples, mut events, mut latency, mut traces } = tables;
    let mut serializer = V2DeflateSerializer::new();
    let mut log = IntervalLogWriterBuilder::new()
        .add_comment("latencies in ns, one tag a hop; start-up left out")
        .with_start_time(epoch(wall_start_ns))
        .with_base_time(epoch(wall_start_ns))
        .with_max_value_divisor(NS_PER_MS)
        .begin_log_with(&mut latency, &mut serializer)?;
    let mut line = String::with_capacity(1024);
    while let Ok(entry) = entries.recv() {
        match entry {
            Entry::Tick(tick) => {
                let (record, row) = &*tick;
                recording.tick(record, row)?;
                line.clear();
                csv_line(&mut line, row, links);
                samples.write_all(line.as_bytes())?;
                line.truncate(line.trim_end().len());
                let level = row.lyapunov_level.map_or_else(String::new, |level| format!("{level:?}"));
                let _ = writeln!(line, ",{level}");
                traces.line(row.tick, row.t_s, row.active, &line)?;
            }
            Entry::Announce(announce) => recording.announce(&announce)?,
            Entry::Event(event) => {
                recording.event(&event)?;
                writeln!(events, "{}", event.to_json())?;
            }
            Entry::Interval { start_ns, duration_ns, hops } => {
                for hop in Hop::ALL {
                    let tag = Tag::new(hop.name());
                    let (start, duration) = (Duration::from_nanos(start_ns), Duration::from_nanos(duration_ns));
                    log.write_histogram(hops.of(hop).histogram(), start, duration, tag)
                        .map_err(|e| io::Error::other(format!("latency.hlog: {e:?}")))?;
                }
            }
        }
    }
    drop(log);
    recording.finish()?;
    samples.flush()?;
    events.flush()?;
    latency.flush()
}

fn epoch(wall_ns: u64) -> std::time::SystemTime {
    std::time::UNIX_EPOCH + Duration::from_nanos(wall_ns)
}

fn csv_header(links: usize) -> String {
    let mut header = "tick,t_s".to_owned();
    for name in ["q", "v", "qd", "vd", "ad", "tau"] {
        for link in 1..=links {
            let _ = write!(header, ",{name}{link}");
        }
    }
    header.push_str(",V,V_bound,round_trip_ns,active\n");
    header
}

/// One line. Writing to a string cannot fail.
fn csv_line(line: &mut String, row: &Row, links: usize) {
    let _ = write!(line, "{},{:?}", row.tick, row.t_s);
    for values in [&row.q, &row.v, &row.q_d, &row.v_d, &row.a_d, &row.tau] {
        for value in values.iter().take(links) {
            let _ = write!(line, ",{value:?}");
        }
    }
    for value in [row.lyapunov, row.lyapunov_bound] {
        line.push(',');
        if let Some(value) = value {
            let _ = write!(line, "{value:?}");
        }
    }
    line.push(',');
    if let Some(value_ns) = row.round_trip_ns {
        let _ = write!(line, "{value_ns}");
    }
    let _ = writeln!(line, ",{}", row.active);
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
    use super::*;
    use crate::recording::Started;
    use crate::summary::SCHEMA;
    use crate::testing::good;
    use crate::tracker::Tracker;
    use hdrhistogram::serialization::interval_log::{IntervalLogIterator, LogEntry};

    /// A run of 3000 ticks with an interval every 1000, and an event each.
    fn record_into(folder: &Path) -> Summary {
        let mut tracker: Tracker<3> = crate::testing::tracker();
        let mut recorder = Recorder::start(folder, about(), true, 0.1).unwrap();
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
        summary.dropped = recorder.finish().unwrap();
        recorder.write_end(&summary, tracker.hops(), tracker.blocks(), "[loop]\n").unwrap();
        summary
    }

    fn about() -> About {
        let started = Started { wall_ns: 1_700_000_000_250_000_000, monotonic_ns: None };
        About { links: 3, length_m: [1.0; 7], started, group: "g".into(), scenario: "[loop]\n".into() }
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
    fn a_folder_that_can_not_be_made_is_an_error_with_nothing_started() {
        assert!(Recorder::start(Path::new("/proc/none"), about(), false, 0.1).is_err());
    }
}
