//! The channels of a recording and of the live view, in one table: a layout that a viewer saved for one fits the other.

use std::borrow::Cow;

use loopbound_shared::sample::{Announce, Message, Origin, TickRecord};

use super::{proto, scene};

/// Encoding of what is kept byte by byte; its schema names the layout.
const RAW: &str = "loopbound-raw";

/// A channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// The records, as the plant published them.
    Records,
    /// What the processes said of themselves.
    Announces,
    /// The figures of each tick, for viewers.
    Ticks,
    /// The events, as log lines.
    Events,
    /// The chain and its reference, as a 3-D scene.
    Scene,
}

/// How the messages of a channel are to be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Its name, which viewers know the well-known ones by.
    pub name: String,
    /// The language in which `data` is written.
    pub encoding: &'static str,
    /// The schema itself.
    pub data: Cow<'static, [u8]>,
}

impl Channel {
    /// All of them: what is recorded.
    pub const ALL: [Self; 5] = [Self::Records, Self::Announces, Self::Ticks, Self::Events, Self::Scene];
    /// Those that a viewer can show: what is served live. The others are for `replay`, and no viewer reads them.
    pub const SHOWN: [Self; 3] = [Self::Ticks, Self::Events, Self::Scene];

    /// The name under which viewers list it.
    #[must_use]
    pub const fn topic(self) -> &'static str {
        match self {
            Self::Records => "/loopbound/record",
            Self::Announces => "/loopbound/announce",
            Self::Ticks => "/loopbound/tick",
            Self::Events => "/loopbound/events",
            Self::Scene => "/loopbound/scene",
        }
    }

    /// The encoding of its messages.
    #[must_use]
    pub const fn encoding(self) -> &'static str {
        match self {
            Self::Records | Self::Announces => RAW,
            Self::Ticks => "protobuf",
            Self::Events | Self::Scene => "json",
        }
    }

    /// The schema of its messages.
    #[must_use]
    pub fn schema(self) -> Schema {
        let json = |name: &str, text: &'static str| Schema {
            name: name.into(),
            encoding: "jsonschema",
            data: text.as_bytes().into(),
        };
        match self {
            Self::Records => raw::<TickRecord>("TickRecord"),
            Self::Announces => raw::<Announce>("Announce"),
            Self::Ticks => {
                Schema { name: proto::MESSAGE.into(), encoding: "protobuf", data: proto::descriptors().into() }
            }
            Self::Events => json("foxglove.Log", scene::LOG_SCHEMA),
            Self::Scene => json("foxglove.SceneUpdate", scene::SCENE_SCHEMA),
        }
    }
}

/// All of a message but its origin, which identifies the run and is no result of it.
fn raw<T: Message>(name: &str) -> Schema {
    let (hash, size) = (T::CONTENT_HASH, size_of::<T>() - size_of::<Origin>());
    let text = format!("{name}, {size} bytes as in memory (little endian), layout hash {hash:016x}");
    Schema { name: format!("loopbound.{name}.{hash:016x}"), encoding: RAW, data: text.into_bytes().into() }
}
