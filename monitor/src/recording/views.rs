//! What viewers are told of a run: the messages of their channels, and the time that each message bears.
//!
//! The recording and the live view both take their messages from here.

use loopbound_model::chain::LINKS_MAX;
use loopbound_shared::sample::TickRecord;

use super::{About, Started, proto, scene};
use crate::event::Event;
use crate::tracker::Row;

/// Interval of the scene in plant time: a viewer shows no more.
const SCENE_NS: u64 = 1_000_000_000 / 30;

/// Makes the messages of one run.
#[derive(Debug)]
pub struct Views {
    links: usize,
    length_m: [f64; LINKS_MAX],
    started: Started,
    /// Wall time of t = 0, once a record has shown it.
    wall_zero_ns: Option<u64>,
    next_scene_ns: u64,
    buffer: Vec<u8>,
}

impl Views {
    /// For the run that `about` is of.
    #[must_use]
    pub fn new(about: &About) -> Self {
        let About { links, length_m, started, .. } = *about;
        let buffer = Vec::with_capacity(4096);
        Self { links, length_m, started, wall_zero_ns: None, next_scene_ns: 0, buffer }
    }

    /// The viewers' time of an instant of the plant, ns since 1970; the first record says where t = 0 was.
    #[must_use]
    pub fn wall_ns(&self, plant_ns: u64) -> u64 {
        self.wall_zero_ns.unwrap_or(self.started.wall_ns).saturating_add(plant_ns)
    }

    /// Takes the clocks from a record, if it is the first one.
    pub fn heed_clock(&mut self, record: &TickRecord) {
        self.wall_zero_ns.get_or_insert_with(|| self.started.wall_zero_ns(record));
    }

    /// The figures of a tick, as protobuf.
    pub fn figures(&mut self, record: &TickRecord, row: &Row) -> &[u8] {
        self.buffer.clear();
        proto::encode(&mut self.buffer, record, row, self.links);
        &self.buffer
    }

    /// The scene of a tick, as JSON, if the last one is old enough.
    pub fn scene(&mut self, record: &TickRecord, row: &Row) -> Option<String> {
        if record.start_plant_ns < self.next_scene_ns {
            return None;
        }
        self.next_scene_ns = record.start_plant_ns + SCENE_NS;
        let time_ns = self.wall_ns(record.start_plant_ns);
        Some(scene::update(row, &self.length_m[..self.links], time_ns))
    }

    /// An event as a log line, as JSON.
    #[must_use]
    pub fn log_line(&self, event: &Event) -> String {
        scene::log_line(event, self.wall_ns(event.plant_ns))
    }
}
