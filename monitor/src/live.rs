//! The running group on the screen of Foxglove: a server of the Foxglove WebSocket protocol in the monitor's process.
//!
//! Responsible for where it is served and for how much. The topics, their schemas and their messages are those of the
//! recording ([`Channel::SHOWN`](crate::recording::channels::Channel::SHOWN)), so that one layout fits both. A server takes
//! nothing from its clients: they subscribe and unsubscribe, and whoever comes, stalls or leaves is the concern of the
//! server's own threads, at the ordinary priority. A client that reads too slowly loses its oldest messages, which shows
//! as a gap in `tick`. Web pages may look if they are Foxglove's or this machine's own: a relay before the server asks.

mod address;
#[cfg(feature = "foxglove")]
mod connection;
#[cfg(feature = "foxglove")]
mod head;
mod origin;
#[cfg(feature = "foxglove")]
mod relay;
#[cfg(feature = "foxglove")]
mod server;
#[cfg(not(feature = "foxglove"))]
#[path = "live/absent.rs"]
mod server;
#[cfg(feature = "foxglove")]
mod stretch;

pub use address::{Address, AddressError};
pub use origin::{Origin, OriginError};
pub use server::Live;

/// Why nothing is served.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The address can't be had: in use, not of this machine, or not to be resolved.
    #[error("--foxglove {address}: {source}")]
    Bind {
        /// Where it was to be served.
        address: Address,
        /// What the system says.
        source: std::io::Error,
    },
    /// This executable was built without it.
    #[error(
        "this build can't serve Foxglove: build it with `cargo build --release --features foxglove` (a default feature)"
    )]
    Absent,
    /// The server itself could not start.
    #[error("--foxglove: {0}")]
    Server(String),
}
