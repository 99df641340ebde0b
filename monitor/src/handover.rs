//! What the launcher's monitor leaves in the group's folder for the supervisor, as a small file of JSON.

use std::path::Path;

use loopbound_shared::group::{Group, GroupError};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Something that is left there, the newest in place of the one before.
pub trait Handover: Serialize + DeserializeOwned {
    /// Its file in the group's folder.
    const FILE: &str;

    /// Writes it, whole or not at all.
    ///
    /// # Errors
    /// If it can't be written.
    fn write(&self, group: &Group) -> Result<(), GroupError> {
        // Plain fields always have a JSON form.
        group.write(Self::FILE, &serde_json::to_vec(self).unwrap_or_default())
    }

    /// Reads it; none if there is none yet.
    #[must_use]
    fn read(path: &Path) -> Option<Self> {
        serde_json::from_slice(&std::fs::read(path).ok()?).ok()
    }
}
