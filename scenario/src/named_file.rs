//! A file that a scenario names, with its text once it was read: a pipe can be read only once.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::input;

/// A file by its path. Its text is read when it is asked for, and kept by this and all copies of it.
#[derive(Clone, Debug, Default)]
pub struct NamedFile {
    path: PathBuf,
    text: Arc<OnceLock<Arc<str>>>,
}

impl NamedFile {
    /// The file at `path`, not read yet.
    #[must_use]
    pub fn new(path: PathBuf) -> Self {
        Self { path, text: Arc::default() }
    }

    /// The same text under another path.
    #[must_use]
    pub fn at(&self, path: PathBuf) -> Self {
        Self { path, text: Arc::clone(&self.text) }
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its text, of at most `most` bytes; the file is read once.
    ///
    /// # Errors
    /// Those of [`input::read_text`].
    pub fn text(&self, most: u64) -> io::Result<Arc<str>> {
        if let Some(text) = self.text.get() {
            return Ok(Arc::clone(text));
        }
        let text = Arc::from(input::read_text(&self.path, most)?);
        Ok(Arc::clone(self.text.get_or_init(|| text)))
    }
}

/// Two are the same if they name the same file.
impl PartialEq for NamedFile {
    fn eq(&self, other: &Self) -> bool {
        self.path == other.path
    }
}

impl Serialize for NamedFile {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.path.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for NamedFile {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        PathBuf::deserialize(deserializer).map(Self::new)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_once_and_its_copies_know_its_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, "text").unwrap();
        let file = NamedFile::new(path.clone());
        let copy = file.clone();
        assert_eq!(&*copy.text(10).unwrap(), "text");
        std::fs::remove_file(&path).unwrap();
        assert_eq!(&*file.text(10).unwrap(), "text");
        assert_eq!(&*file.at(PathBuf::from("elsewhere")).text(10).unwrap(), "text");
        assert!(NamedFile::new(path).text(10).is_err());
    }
}
