//! `samples.mcap`: everything that a run consists of, readable by the field's viewers and, losslessly, by `replay`.
//!
//! Responsible for the container: its channels, its time stamps, and that what was written before a crash can be read.
//! What the channels carry is in [`proto`] (one message a tick) and [`scene`] (events as log lines, the chain as a 3-D
//! scene); reading back is in [`reader`]. The writer belongs to the thread of [`files`](crate::files).

pub mod proto;
pub mod reader;
pub mod scene;

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::Path;

use loopbound_shared::chain::LINKS_MAX;
use loopbound_shared::layout::{Layout, bytes_of};
use loopbound_shared::role::build_id;
use loopbound_shared::sample::{Announce, TickRecord};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::{NoSeek, WriteOptions, Writer};

use crate::event::Event;
use crate::tracker::Row;

/// Topic of the records, as the plant published them.
pub const RECORDS: &str = "/loopbound/record";
/// Topic of what the processes said of themselves.
pub const ANNOUNCES: &str = "/loopbound/announce";
/// Topic of the figures of each tick, for viewers.
pub const TICKS: &str = "/loopbound/tick";
/// Topic of the events, as log lines.
pub const EVENTS: &str = "/loopbound/events";
/// Topic of the chain and its reference, as a 3-D scene.
pub const SCENE: &str = "/loopbound/scene";
/// Name of the metadata that say what the recording is of.
pub const ABOUT: &str = "loopbound";
/// Encoding of what is kept byte by byte; its schema names the layout.
const RAW: &str = "loopbound-raw";

/// A chunk is written whole when it holds this much: what a crash can cost.
const CHUNK_BYTES: u64 = 1 << 20;
/// Interval of the scene in plant time: a viewer shows no more.
const SCENE_NS: u64 = 1_000_000_000 / 30;

/// What a recording must know of its run.
#[derive(Clone, Debug)]
pub struct About {
    /// Links of the chain.
    pub links: usize,
    /// Length of each, m; entries beyond `links` don't count.
    pub length_m: [f64; LINKS_MAX],
    /// When the recording began.
    pub started: Started,
    /// Name of the group.
    pub group: String,
    /// The scenario with all defaults filled in, as TOML.
    pub scenario: String,
}

/// When a recording began, on two clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Started {
    /// Wall time, ns since 1970.
    pub wall_ns: u64,
    /// CLOCK_MONOTONIC at the same instant; none in lockstep, where stamps are virtual.
    pub monotonic_ns: Option<u64>,
}

impl Started {
    /// Wall time of t = 0 of the plant, by one of its records: what the viewers' clocks count from. Virtual time counts
    /// from the start of the recording.
    #[must_use]
    pub fn wall_zero_ns(&self, record: &TickRecord) -> u64 {
        let Some(monotonic_ns) = self.monotonic_ns else { return self.wall_ns };
        let sampled_wall_ns = self.wall_ns.saturating_add(record.sampled_ns).saturating_sub(monotonic_ns);
        sampled_wall_ns.saturating_sub(record.start_plant_ns)
    }
}

#[derive(Clone, Copy)]
struct Channels {
    records: u16,
    announces: u16,
    ticks: u16,
    events: u16,
    scene: u16,
}

/// Writes a recording. A chunk reaches the file whole or not at all; no byte waits in this process beyond the open
/// chunk.
pub struct McapWriter {
    writer: Writer<NoSeek<File>>,
    channels: Channels,
    about: About,
    /// Wall time of t = 0, once a record has shown it.
    wall_zero_ns: Option<u64>,
    sequence: u32,
    last_plant_ns: u64,
    next_scene_ns: u64,
    buffer: Vec<u8>,
}

fn other(error: mcap::McapError) -> io::Error {
    match error {
        mcap::McapError::Io(error) => error,
        error => io::Error::other(error.to_string()),
    }
}

impl McapWriter {
    /// Makes the file, with its channels and what the recording is of.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn create(path: &Path, about: About) -> io::Result<Self> {
        let options = WriteOptions::new()
            .compression(Some(mcap::Compression::Lz4))
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .library(concat!("loopbound ", env!("CARGO_PKG_VERSION")));
        let mut writer = options.create(NoSeek::new(File::create(path)?)).map_err(other)?;
        let metadata = [
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("build", format!("{:016x}", build_id())),
            ("record_layout", format!("{:016x}", TickRecord::HASH)),
            ("announce_layout", format!("{:016x}", Announce::HASH)),
            ("group", about.group.clone()),
            ("links", about.links.to_string()),
            ("scenario", about.scenario.clone()),
        ];
        let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        writer.write_metadata(&Metadata { name: ABOUT.to_owned(), metadata }).map_err(other)?;
        let channels = add_channels(&mut writer).map_err(other)?;
        let buffer = Vec::with_capacity(4096);
        Ok(Self {
            writer,
            channels,
            about,
            wall_zero_ns: None,
            sequence: 0,
            last_plant_ns: 0,
            next_scene_ns: 0,
            buffer,
        })
    }

    /// Writes a tick: its record byte by byte, its figures, and now and then the scene.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn tick(&mut self, record: &TickRecord, row: &Row) -> io::Result<()> {
        self.last_plant_ns = record.start_plant_ns;
        self.wall_zero_ns.get_or_insert_with(|| self.about.started.wall_zero_ns(record));
        self.put(self.channels.records, record.start_plant_ns, bytes_of(record))?;
        let mut buffer = std::mem::take(&mut self.buffer);
        buffer.clear();
        proto::encode(&mut buffer, record, row, self.about.links);
        let done = self.put(self.channels.ticks, record.start_plant_ns, &buffer);
        self.buffer = buffer;
        done?;
        if record.start_plant_ns >= self.next_scene_ns {
            self.next_scene_ns = record.start_plant_ns + SCENE_NS;
            let time_ns = self.wall_ns(record.start_plant_ns);
            let scene = scene::update(row, &self.about.length_m[..self.about.links], time_ns);
            self.put(self.channels.scene, record.start_plant_ns, scene.as_bytes())?;
        }
        Ok(())
    }

    /// Writes what a process said of itself; it holds from the next record on.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn announce(&mut self, announce: &Announce) -> io::Result<()> {
        self.put(self.channels.announces, self.last_plant_ns, bytes_of(announce))
    }

    /// Writes an event as a log line.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn event(&mut self, event: &Event) -> io::Result<()> {
        let line = scene::log_line(event, self.wall_ns(event.plant_ns));
        self.put(self.channels.events, event.plant_ns, line.as_bytes())
    }

    /// Writes the index, without which a viewer has to read the whole file first.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn finish(mut self) -> io::Result<()> {
        self.writer.finish().map(drop).map_err(other)
    }

    fn wall_ns(&self, plant_ns: u64) -> u64 {
        self.wall_zero_ns.unwrap_or(self.about.started.wall_ns).saturating_add(plant_ns)
    }

    fn put(&mut self, channel_id: u16, plant_ns: u64, data: &[u8]) -> io::Result<()> {
        let time_ns = self.wall_ns(plant_ns);
        let header = MessageHeader { channel_id, sequence: self.sequence, log_time: time_ns, publish_time: time_ns };
        self.sequence = self.sequence.wrapping_add(1);
        self.writer.write_to_known_channel(&header, data).map_err(other)
    }
}

fn add_channels(writer: &mut Writer<NoSeek<File>>) -> Result<Channels, mcap::McapError> {
    let none = BTreeMap::new();
    let mut raw = |topic: &str, name: &str, hash: u64, size: usize| {
        let text = format!("{name}, {size} bytes as in memory (little endian), layout hash {hash:016x}");
        let schema = writer.add_schema(&format!("loopbound.{name}.{hash:016x}"), RAW, text.as_bytes())?;
        writer.add_channel(schema, topic, RAW, &none)
    };
    let records = raw(RECORDS, "TickRecord", TickRecord::HASH, size_of::<TickRecord>())?;
    let announces = raw(ANNOUNCES, "Announce", Announce::HASH, size_of::<Announce>())?;
    let mut add = |topic: &str, name: &str, encoding: (&str, &str), schema: &[u8]| {
        let schema = writer.add_schema(name, encoding.0, schema)?;
        writer.add_channel(schema, topic, encoding.1, &none)
    };
    let json = ("jsonschema", "json");
    Ok(Channels {
        records,
        announces,
        ticks: add(TICKS, proto::MESSAGE, ("protobuf", "protobuf"), &proto::descriptors())?,
        events: add(EVENTS, "foxglove.Log", json, scene::LOG_SCHEMA.as_bytes())?,
        scene: add(SCENE, "foxglove.SceneUpdate", json, scene::SCENE_SCHEMA.as_bytes())?,
    })
}

#[cfg(test)]
mod tests;
