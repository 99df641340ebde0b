//! `samples.mcap`: everything that a run consists of, readable by the field's viewers and, losslessly, by `replay`.
//!
//! Responsible for the container, and that what was written before a crash can be read. Its channels are those of
//! [`channels`]; what they carry is made by [`views`] from [`proto`] (one message a tick) and [`scene`] (events as log
//! lines, the chain as a 3-D scene); reading back is in [`reader`]. The writer belongs to the thread of
//! [`files`](crate::files).

pub mod channels;
pub mod proto;
pub mod reader;
pub mod scene;
pub mod views;

use std::collections::BTreeMap;
use std::io;

use loopbound_model::chain::LINKS_MAX;
use loopbound_shared::layout::content_of;
use loopbound_shared::role::build_id;
use loopbound_shared::sample::{Announce, Message as _, TickRecord};
use mcap::records::{MessageHeader, Metadata};
use mcap::write::{NoSeek, WriteOptions, Writer};

use crate::event::Event;
use crate::folder::{Shared, Stamp, Stream};
use crate::tracker::Row;
use channels::Channel;
use views::Views;

/// Name of the metadata that say what the recording is of.
pub const ABOUT: &str = "loopbound";

/// A chunk is written whole when it holds this much: what a crash can cost.
const CHUNK_BYTES: u64 = 1 << 20;

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
    /// The run's id.
    pub run_id: String,
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

/// Writes a recording. A chunk reaches the file whole or not at all; no byte waits in this process beyond the open
/// chunk.
pub(crate) struct McapWriter {
    writer: Writer<NoSeek<Shared>>,
    file: Shared,
    /// The number in the file of each channel, in the order of [`Channel::ALL`].
    numbers: [u16; Channel::ALL.len()],
    views: Views,
    sequence: u32,
    last_plant_ns: u64,
    /// Ticks in the open chunk.
    unsaved: u64,
}

fn other(error: mcap::McapError) -> io::Error {
    match error {
        mcap::McapError::Io(error) => error,
        error => io::Error::other(error.to_string()),
    }
}

impl McapWriter {
    /// Begins the file, with its channels and what the recording is of.
    ///
    /// # Errors
    /// If the file can't be written.
    pub(crate) fn create(file: Stream, about: About) -> io::Result<Self> {
        let options = WriteOptions::new()
            .compression(Some(mcap::Compression::Lz4))
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true)
            .library(concat!("loopbound ", env!("CARGO_PKG_VERSION")));
        let views = Views::new(&about);
        let file = Shared::new(file);
        let mut writer = options.create(NoSeek::new(file.clone())).map_err(other)?;
        let metadata = [
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("build", format!("{:016x}", build_id())),
            ("record_layout", format!("{:016x}", TickRecord::CONTENT_HASH)),
            ("announce_layout", format!("{:016x}", Announce::CONTENT_HASH)),
            ("group", about.group),
            ("links", about.links.to_string()),
            ("scenario", about.scenario),
            ("run_id", about.run_id),
        ];
        let metadata = metadata.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        writer.write_metadata(&Metadata { name: ABOUT.to_owned(), metadata }).map_err(other)?;
        let mut numbers = [0; Channel::ALL.len()];
        for (number, channel) in numbers.iter_mut().zip(Channel::ALL) {
            *number = add_channel(&mut writer, channel).map_err(other)?;
        }
        file.with(Stream::push)?;
        Ok(Self { writer, file, numbers, views, sequence: 0, last_plant_ns: 0, unsaved: 0 })
    }

    /// Writes a tick: its record byte by byte, its figures, and now and then the scene.
    ///
    /// # Errors
    /// If the file can't be written.
    pub(crate) fn tick(&mut self, record: &TickRecord, row: &Row) -> io::Result<()> {
        let plant_ns = record.start_plant_ns;
        self.last_plant_ns = plant_ns;
        self.views.heed_clock(record);
        let time_ns = self.views.wall_ns(plant_ns);
        let saved = self.put(Channel::Records, time_ns, content_of(record));
        self.unsaved += 1;
        saved?;
        let header = self.header(Channel::Ticks, time_ns);
        self.writer.write_to_known_channel(&header, self.views.figures(record, row)).map_err(other)?;
        self.save()?;
        match self.views.scene(record, row) {
            Some(scene) => self.put(Channel::Scene, time_ns, scene.as_bytes()),
            None => Ok(()),
        }
    }

    /// Writes what a process said of itself; it holds from the next record on.
    ///
    /// # Errors
    /// If the file can't be written.
    pub(crate) fn announce(&mut self, announce: &Announce) -> io::Result<()> {
        self.put(Channel::Announces, self.views.wall_ns(self.last_plant_ns), content_of(announce))
    }

    /// Writes an event as a log line.
    ///
    /// # Errors
    /// If the file can't be written.
    pub(crate) fn event(&mut self, event: &Event) -> io::Result<()> {
        let line = self.views.log_line(event);
        self.put(Channel::Events, self.views.wall_ns(event.plant_ns), line.as_bytes())
    }

    /// Writes the index, without which a viewer has to read the whole file first.
    ///
    /// # Errors
    /// If the file can't be written.
    pub(crate) fn finish(mut self) -> io::Result<Stamp> {
        self.writer.finish().map(drop).map_err(other)?;
        self.file.with(Stream::push)?;
        Ok(self.file.with(|file| file.stamp()))
    }

    /// Ticks that are in no chunk of the file yet: what is lost if it can't be written any more.
    pub(crate) fn unsaved(&self) -> u64 {
        self.unsaved
    }

    fn put(&mut self, channel: Channel, time_ns: u64, data: &[u8]) -> io::Result<()> {
        let header = self.header(channel, time_ns);
        self.writer.write_to_known_channel(&header, data).map_err(other)?;
        self.save()
    }

    /// A chunk was closed if bytes have come out of the container's writer: they go to the disk at once.
    fn save(&mut self) -> io::Result<()> {
        let before = self.file.with(|file| file.written());
        self.file.with(Stream::push)?;
        if self.file.with(|file| file.written()) > before {
            self.unsaved = 0;
        }
        Ok(())
    }

    fn header(&mut self, channel: Channel, time_ns: u64) -> MessageHeader {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        let channel_id = self.numbers[channel as usize];
        MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns }
    }
}

fn add_channel(writer: &mut Writer<NoSeek<Shared>>, channel: Channel) -> Result<u16, mcap::McapError> {
    let schema = channel.schema();
    let schema = writer.add_schema(&schema.name, schema.encoding, &schema.data)?;
    writer.add_channel(schema, channel.topic(), channel.encoding(), &BTreeMap::new())
}

#[cfg(test)]
mod tests;
