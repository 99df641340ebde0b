//! A folder of results is one run's, or one study's: who may write into it, what says so, and whether it is all there.
//!
//! | step | who | what |
//! |---|---|---|
//! | [`Claim::prepare`] | whoever wants to write, before anything starts | locks the folder and refuses; touches nothing |
//! | [`Claim::begin`] | the same, once nothing can be refused any more | marks it unfinished, removes what an earlier run wrote |
//! | [`Results`] | launcher and monitor while the run lasts | writes files, and keeps size and hash of each |
//! | [`Results::finish`] | the last one | writes the manifest that says *finished* |
//! | [`Look::at`] | `check`, `compare`, `report`, `replay` | whose it is, whether it was finished, and which file is no longer as written |
//!
//! The manifest is written aside, synced and renamed: a reader finds the old one or the new one. The other files are not
//! synced; a power cut that takes some of them shows as a size or hash that does not match. Nothing is removed but what
//! a manifest lists or what [`known`] recognises, and no symbolic link is followed.

mod claim;
pub mod known;
mod look;
mod manifest;
mod results;
mod stream;

use loopbound_model::quote;
use std::path::Path;

use loopbound_scenario::input::WAYPOINTS_BYTES_MAX;
use loopbound_scenario::{Scenario, ScenarioError};

pub use claim::{Begin, Claim};
pub use look::{Look, refuse_file_of_a_run};
pub use manifest::{FILE, Kind, Manifest, Stamp, State};
pub use results::Results;
pub(crate) use stream::{Shared, Stream};

/// Why a folder can't be used: one line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct FolderError(pub String);

/// The scenario as the folder of its run has it: what it follows lies beside it, wherever the folder goes.
#[must_use]
pub fn self_contained(scenario: &Scenario) -> Scenario {
    scenario.with_own_waypoints()
}

/// The scenario of a recording in `folder`, with its paths as they are there.
///
/// # Errors
/// If the text is no scenario.
pub fn recorded_scenario(text: &str, folder: &Path) -> Result<Scenario, ScenarioError> {
    let mut scenario = Scenario::from_toml(text, &quote::path(folder))?;
    scenario.anchor(folder);
    Ok(scenario)
}

/// The file of waypoints that a scenario follows, if it follows one.
///
/// # Errors
/// If it can't be read, or is longer than any that is accepted.
pub fn waypoints_of(scenario: &Scenario) -> Result<Option<Vec<u8>>, FolderError> {
    let Some(file) = &scenario.reference.file else { return Ok(None) };
    let text = file.text(WAYPOINTS_BYTES_MAX).map_err(|error| FolderError::of(file.path(), error))?;
    Ok(Some(text.as_bytes().to_vec()))
}

impl FolderError {
    pub(crate) fn of(path: &Path, why: impl std::fmt::Display) -> Self {
        Self(format!("{}: {why}", quote::path(path)))
    }
}

#[cfg(test)]
mod tests;
