//! The monitor of a group: passive, may come and go, and judges every tick from its record.
//!
//! | module | responsible for |
//! |---|---|
//! | [`tracker`] | the figures of a run, record by record: no clock, no input or output |
//! | [`hops`], [`jitter`] | distributions of latencies and of sampling intervals |
//! | [`late`], [`cause`] | which ticks were late or missed, and why |
//! | [`swaps`] | changes of the controller in charge |
//! | [`event`] | what is noted besides figures |
//! | [`summary`] | the keys of `summary.json` |

#![forbid(unsafe_code)]

pub mod cause;
pub mod event;
pub mod hops;
pub mod jitter;
pub mod late;
pub mod summary;
pub mod swaps;
pub mod tracker;

pub use summary::Summary;
pub use tracker::{Config, Row, Tracker};
