//! In place of the server, in a build without it: nothing can be served, and whoever asks is told how to build it.

use std::convert::Infallible;

use loopbound_shared::sample::TickRecord;

use super::{Address, LiveError, Origin};
use crate::event::Event;
use crate::recording::About;
use crate::tracker::Row;

/// There is none in this build.
pub struct Live(Infallible);

impl Live {
    /// Refuses.
    ///
    /// # Errors
    /// Always.
    pub fn start(_: &Address, _: &[Origin], _: &About, _: u64, _: bool) -> Result<Self, LiveError> {
        Err(LiveError::Absent)
    }

    /// Where it is served.
    #[must_use]
    pub fn url(&self) -> String {
        match self.0 {}
    }

    /// Takes a tick.
    pub fn tick(&mut self, _: &TickRecord, _: &Row, _: u64) {
        match self.0 {}
    }

    /// Takes an event.
    pub fn event(&mut self, _: &Event) {
        match self.0 {}
    }

    /// Tells clients what they should know.
    pub fn care(&mut self, _: u64) {
        match self.0 {}
    }

    /// Ends.
    pub fn stop(self) {
        match self.0 {}
    }
}
