//! The thread that writes what is written while a run lasts.
//!
//! The first error ends the recording: each file keeps its last whole entry, and what comes after is counted.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::sync::mpsc::Receiver;
use std::time::Duration;

use hdrhistogram::serialization::V2DeflateSerializer;
use hdrhistogram::serialization::interval_log::{IntervalLogWriterBuilder, Tag};
use loopbound_shared::sample::TickRecord;

use super::{Entry, Lost, Place};
use crate::event::Event;
use crate::folder::{Results, Shared, Stream, known};
use crate::hops::Hop;
use crate::recording::{About, McapWriter};
use crate::summary::Dropped;
use crate::traces::Traces;
use crate::tracker::Row;

/// Interval logs give the largest value in milliseconds.
const NS_PER_MS: f64 = 1e6;

/// What the thread leaves.
pub(super) struct Written {
    /// The folder; none if it could not be had.
    pub(super) results: Option<Results>,
    /// What could not be written.
    pub(super) dropped: Dropped,
}

/// Writes until the queue is closed.
pub(super) fn write(entries: &Receiver<Entry>, place: Place, about: About, trace_s: f64, lost: &Lost) -> Written {
    let (early, first) = until_the_first_tick(entries);
    let mut entries = early.into_iter().chain(first).chain(entries.iter());
    let mut dropped = Dropped::default();
    let results = match place {
        Place::Own(results) => Ok(results),
        Place::Launcher(path, run_id) => Results::join(&path, run_id),
    };
    let results = match results {
        Ok(mut results) => {
            let mut tick = 0;
            if let Err(error) = record(&mut entries, &mut results, about, trace_s, &mut (&mut dropped, &mut tick)) {
                let _ = lost.set(format!("{error}, in tick {tick}"));
            }
            Some(results)
        }
        Err(error) => {
            let _ = lost.set(error.to_string());
            None
        }
    };
    entries.for_each(|entry| entry.drop_into(&mut dropped));
    Written { results, dropped }
}

/// What is said before the first tick, and the first tick: before it the launcher has not taken the folder.
fn until_the_first_tick(entries: &Receiver<Entry>) -> (Vec<Entry>, Option<Entry>) {
    let mut early = Vec::new();
    while let Ok(entry) = entries.recv() {
        match entry {
            Entry::Tick(_) => return (early, Some(entry)),
            // Nothing was measured yet.
            Entry::Interval { .. } => {}
            Entry::Announce(_) | Entry::Event(_) => early.push(entry),
        }
    }
    (early, None)
}

/// Writes all `entries`, or those until the first that can't be written; then `progress` has what was lost with it, and
/// in which tick.
fn record(
    entries: &mut impl Iterator<Item = Entry>,
    results: &mut Results,
    about: About,
    trace_s: f64,
    progress: &mut (&mut Dropped, &mut u64),
) -> io::Result<()> {
    let (run_id, started) = (format!("run_id {}", about.run_id), epoch(about.started.wall_ns));
    let mut tables = Tables::open(results, about, trace_s)?;
    let latency = Shared::new(open(results, crate::log::FILE)?);
    let (mut file, mut serializer) = (latency.clone(), V2DeflateSerializer::new());
    let mut log = IntervalLogWriterBuilder::new()
        .add_comment("latencies in ns, one tag a hop; start-up left out")
        .add_comment(&run_id)
        .with_start_time(started)
        .with_base_time(started)
        .with_max_value_divisor(NS_PER_MS)
        .begin_log_with(&mut file, &mut serializer)?;
    for entry in entries {
        if let Entry::Tick(tick) = &entry {
            *progress.1 = tick.0.tick;
        }
        let written = match &entry {
            Entry::Tick(tick) => tables.tick(&tick.0, &tick.1),
            Entry::Announce(announce) => named(known::SAMPLES, tables.recording.announce(announce)),
            Entry::Event(event) => tables.event(event),
            Entry::Interval { start_ns, duration_ns, hops } => {
                let (start, duration) = (Duration::from_nanos(*start_ns), Duration::from_nanos(*duration_ns));
                let each =
                    |hop: Hop| log.write_histogram(hops.of(hop).histogram(), start, duration, Tag::new(hop.name()));
                let written = Hop::ALL.into_iter().try_for_each(each).map_err(|e| io::Error::other(format!("{e:?}")));
                named(crate::log::FILE, written.and_then(|()| latency.with(Stream::push)))
            }
        };
        if let Err(error) = written {
            if !matches!(entry, Entry::Tick(_)) {
                entry.drop_into(progress.0);
            }
            progress.0.samples += tables.recording.unsaved();
            return Err(error);
        }
    }
    drop(log);
    named(crate::log::FILE, latency.with(Stream::push))?;
    results.note(crate::log::FILE, latency.with(|file| file.stamp()));
    let unsaved = tables.recording.unsaved();
    tables.close(results).inspect_err(|_| progress.0.samples += unsaved)
}

fn open(results: &Results, name: &str) -> io::Result<Stream> {
    named(name, results.stream(name))
}

/// An error says in which file.
fn named<T>(name: &str, result: io::Result<T>) -> io::Result<T> {
    result.map_err(|error| io::Error::new(error.kind(), format!("{name}: {error}")))
}

/// What is open while the run lasts.
struct Tables {
    links: usize,
    recording: McapWriter,
    samples: Stream,
    events: Stream,
    traces: Traces,
    line: String,
}

const ROWS: &str = "samples.csv";
const EVENTS: &str = "events.jsonl";

impl Tables {
    fn open(results: &Results, about: About, trace_s: f64) -> io::Result<Self> {
        let links = about.links;
        let mut samples = open(results, ROWS)?;
        samples.write_all(csv_header(links).as_bytes())?;
        let recording = named(known::SAMPLES, McapWriter::create(open(results, known::SAMPLES)?, about))?;
        // Both bounds of V: the promise is in every row of the samples, the certified level only here.
        let header = format!("{},V_level\n", csv_header(links).trim_end());
        let traces = Traces::new(results.path().join("changes"), header, trace_s);
        Ok(Self {
            links,
            recording,
            samples,
            events: open(results, EVENTS)?,
            traces,
            line: String::with_capacity(1024),
        })
    }

    fn tick(&mut self, record: &TickRecord, row: &Row) -> io::Result<()> {
        named(known::SAMPLES, self.recording.tick(record, row))?;
        let line = &mut self.line;
        line.clear();
        csv_line(line, row, self.links);
        self.samples.write_all(line.as_bytes())?;
        named(ROWS, self.samples.checkpoint())?;
        line.truncate(line.trim_end().len());
        let level = row.lyapunov_level.map_or_else(String::new, |level| format!("{level:?}"));
        let _ = writeln!(line, ",{level}");
        named("changes", self.traces.line(row.tick, row.t_s, row.active, line))
    }

    fn event(&mut self, event: &Event) -> io::Result<()> {
        named(known::SAMPLES, self.recording.event(event))?;
        writeln!(self.events, "{}", event.to_json())?;
        named(EVENTS, self.events.checkpoint())
    }

    fn close(self, results: &mut Results) -> io::Result<()> {
        let Self { recording, mut samples, mut events, traces, .. } = self;
        named(ROWS, samples.push())?;
        named(EVENTS, events.push())?;
        for (name, stamp) in named("changes", traces.close())? {
            results.note(format!("changes/{name}"), stamp);
        }
        results.note(known::SAMPLES, named(known::SAMPLES, recording.finish())?);
        results.note(ROWS, samples.stamp());
        results.note(EVENTS, events.stamp());
        Ok(())
    }
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
