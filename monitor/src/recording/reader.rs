//! Reading a recording back, record by record, also one that a crash has cut off.
//!
//! Nothing of the file is trusted: lengths are checked by the container's reader and a chunk by its checksum before
//! anything of it is handed out.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

use loopbound_scenario::input;
use loopbound_shared::layout::from_content;
use loopbound_shared::sample::{Announce, Message as _, TickRecord};
use mcap::records::Record;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::ABOUT;
use super::channels::Channel;
use super::proto::{self, Figures};

/// No record outside of chunks is longer, nor any chunk.
const LENGTH_MAX: usize = 64 << 20;

/// Why a recording is refused.
#[derive(Debug)]
pub enum ReadError {
    /// The file can't be read.
    Io(io::Error),
    /// It is no recording of loopbound's, or damaged.
    Malformed(String),
    /// It was written by another build: `what` it has and what this one has.
    Other {
        /// What differs.
        what: &'static str,
        /// As recorded.
        recorded: String,
        /// Of this build.
        own: String,
    },
}

impl std::fmt::Display for ReadError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Io(error) => write!(f, "{error}"),
            Self::Malformed(why) => write!(f, "no recording, or a damaged one: {why}"),
            Self::Other { what, recorded, own } => {
                write!(f, "recorded by another build: its {what} is {recorded}, this one's {own}")
            }
        }
    }
}

impl std::error::Error for ReadError {}

/// What a recording is of.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Version of the writer.
    pub version: String,
    /// Name of the group.
    pub group: String,
    /// The scenario, as TOML.
    pub scenario: String,
    /// The run's id; empty in recordings of versions that had none.
    pub run_id: String,
}

/// One thing that was recorded, in the order of the recording.
#[derive(Clone, Debug)]
pub enum Item {
    /// The record of a tick.
    Record(Box<TickRecord>),
    /// What a process said of itself.
    Announce(Box<Announce>),
    /// The figures of the record before.
    Figures(Figures),
}

#[derive(Clone, Copy, Default)]
struct Channels {
    records: Option<u16>,
    announces: Option<u16>,
    ticks: Option<u16>,
}

/// An open recording.
pub struct Recording {
    file: File,
    reader: LinearReader,
    channels: Channels,
    header: Header,
    cut_off: bool,
}

impl Recording {
    /// Opens a recording, and checks that this build can read it.
    ///
    /// # Errors
    /// If the file can't be read, is no recording, or is of another build or layout.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let (mut recording, about) = Self::begin(path)?;
        recording.header = header_of(&about)?;
        Ok(recording)
    }

    /// The scenario of a recording of any build; none of what is no recording.
    #[must_use]
    pub fn scenario_of(path: &Path) -> Option<String> {
        Self::begin(path).ok()?.1.remove("scenario")
    }

    fn begin(path: &Path) -> Result<(Self, BTreeMap<String, String>), ReadError> {
        let options =
            LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(LENGTH_MAX);
        let reader = LinearReader::new_with_options(options);
        let file = input::open_file(path).map_err(ReadError::Io)?;
        let (channels, header) = (Channels::default(), Header::default());
        let mut recording = Self { file, reader, channels, header, cut_off: false };
        // The metadata come before the first chunk.
        while let Some(found) = recording.next_record()? {
            if let Found::About(about) = found {
                return Ok((recording, about));
            }
        }
        Err(ReadError::Malformed("it does not say what it is of".to_owned()))
    }

    /// What it is of.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Whether the file ended before the recording did: known once all was read.
    #[must_use]
    pub fn is_cut_off(&self) -> bool {
        self.cut_off
    }

    /// The next thing that was recorded; none at the end.
    ///
    /// # Errors
    /// If the file can't be read, or is damaged.
    pub fn next_item(&mut self) -> Result<Option<Item>, ReadError> {
        while let Some(found) = self.next_record()? {
            if let Found::Item(item) = found {
                return Ok(Some(item));
            }
        }
        Ok(None)
    }

    fn next_record(&mut self) -> Result<Option<Found>, ReadError> {
        while let Some(event) = self.reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let count = self.file.read(self.reader.insert(wanted)).map_err(ReadError::Io)?;
                    self.reader.notify_read(count);
                }
                // A long chunk of zeros, which are a few bytes when compressed, would be hundreds of millions of them.
                Ok(LinearReadEvent::Record { opcode: 0, .. }) => {
                    return Err(ReadError::Malformed("a record of no kind (opcode 0)".to_owned()));
                }
                Ok(LinearReadEvent::Record { data, opcode }) => {
                    let malformed = |e: mcap::McapError| ReadError::Malformed(e.to_string());
                    let record = mcap::parse_record(opcode, data).map_err(malformed)?;
                    if let Some(found) = look_at(&mut self.channels, record)? {
                        return Ok(Some(found));
                    }
                }
                Err(mcap::McapError::UnexpectedEof | mcap::McapError::UnexpectedEoc) => {
                    self.cut_off = true;
                    return Ok(None);
                }
                Err(error) => return Err(ReadError::Malformed(error.to_string())),
            }
        }
        Ok(None)
    }
}

enum Found {
    About(BTreeMap<String, String>),
    Item(Item),
}

fn look_at(channels: &mut Channels, record: Record<'_>) -> Result<Option<Found>, ReadError> {
    let bad = |what: &str| ReadError::Malformed(format!("a message is no {what}"));
    Ok(match record {
        Record::Metadata(metadata) if metadata.name == ABOUT => Some(Found::About(metadata.metadata)),
        Record::Channel(channel) => {
            let known = Channel::ALL.into_iter().find(|known| known.topic() == channel.topic);
            match known {
                Some(Channel::Records) => channels.records = Some(channel.id),
                Some(Channel::Announces) => channels.announces = Some(channel.id),
                Some(Channel::Ticks) => channels.ticks = Some(channel.id),
                Some(Channel::Events | Channel::Scene) | None => {}
            }
            None
        }
        Record::Message { header, data } => {
            let id = Some(header.channel_id);
            if id == channels.records {
                let record: TickRecord = from_content(&data).ok_or_else(|| bad("record"))?;
                Some(Found::Item(Item::Record(Box::new(record))))
            } else if id == channels.announces {
                let announce: Announce = from_content(&data).ok_or_else(|| bad("announcement"))?;
                Some(Found::Item(Item::Announce(Box::new(announce))))
            } else if id == channels.ticks {
                let figures = proto::figures(&data).ok_or_else(|| bad(proto::MESSAGE))?;
                Some(Found::Item(Item::Figures(figures)))
            } else {
                None
            }
        }
        _ => None,
    })
}

fn header_of(about: &BTreeMap<String, String>) -> Result<Header, ReadError> {
    // The build that is recorded tells who wrote it. What is kept of it is these two layouts, and the version computes alike.
    let get = |key: &str| about.get(key).cloned().unwrap_or_default();
    for (what, key, own) in [
        ("version", "version", env!("CARGO_PKG_VERSION").to_owned()),
        ("layout of TickRecord", "record_layout", format!("{:016x}", TickRecord::CONTENT_HASH)),
        ("layout of Announce", "announce_layout", format!("{:016x}", Announce::CONTENT_HASH)),
    ] {
        let recorded = get(key);
        if recorded != own {
            return Err(ReadError::Other { what, recorded, own });
        }
    }
    Ok(Header { version: get("version"), group: get("group"), scenario: get("scenario"), run_id: get("run_id") })
}
