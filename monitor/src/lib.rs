//! The monitor of a group: passive, may come and go, and judges every tick from its record.
//!
//! | module | responsible for |
//! |---|---|
//! | [`tracker`] | the figures of a run, record by record: no clock, no input or output |
//! | [`hops`], [`jitter`] | distributions of latencies and of sampling intervals |
//! | [`judge`] | V, the promise and the diagnosis of each tick |
//! | [`late`], [`cause`] | which ticks were late or missed, and why |
//! | [`swaps`] | changes of the controller in charge |
//! | [`account`] | what `loopbound swap` is answered of such a change |
//! | [`event`] | what is noted besides figures |
//! | [`summary`], [`verdict`], [`mod@render`] | the keys of `summary.json`, what they come to, one screen of text |
//! | [`counted`] | counts with their words |
//! | [`chart`] | pictures, as SVG and PNG |
//! | [`folder`] | whose a folder of results is, and whether it is all there |
//! | [`files`], `traces`, [`plot`] | the files of a run, written by a thread of their own; percentile plots |
//! | [`log`] | the histograms of recorded runs, added up |
//! | [`recording`] | `samples.mcap`: what viewers open and `replay` reads |
//! | [`live`] | the same messages to Foxglove while the group runs |
//! | [`report`] | `report.html`, the page of a run or of two |
//! | [`tui`] | the live view on a terminal |
//! | [`run`] | the process: attach, drain, report, leave |

#![forbid(unsafe_code)]

pub mod account;
pub mod cause;
pub mod chart;
pub mod counted;
pub mod divergence;
pub mod event;
pub mod files;
pub mod folder;
pub mod handover;
pub mod hops;
mod host;
pub mod jitter;
pub mod judge;
pub mod late;
pub mod live;
pub mod log;
mod members;
pub mod plot;
pub mod recording;
pub mod render;
pub mod report;
mod run;
pub mod summary;
pub mod swaps;
#[cfg(test)]
mod testing;
mod traces;
pub mod tracker;
pub mod tui;
pub mod verdict;

pub use render::render;
pub use run::{Ended, MonitorArgs, Outcome, run};
pub use summary::Summary;
pub use tracker::{Config, Row, Tracker};
