//! `manifest.json`: which run a folder belongs to, whether that run finished it, and every file's size and hash.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::{Component, Path};

use loopbound_scenario::input;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::FolderError;

/// Its name.
pub const FILE: &str = "manifest.json";
/// Version of the keys below.
const VERSION: u32 = 1;
/// No manifest is longer: a study of some hundred pictures has some tens of kilobytes.
const BYTES_MAX: u64 = 4 << 20;

/// What a folder holds the results of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A run, or what a monitor that was attached saw of one.
    Run,
    /// A study.
    Study,
}

/// How far the writing came.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Its writer is at work, or ended before it was done.
    Unfinished,
    /// All files are there.
    Finished,
}

/// Size and hash of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Length, bytes.
    pub bytes: u64,
    /// SHA-256 in hexadecimal, as `sha256sum` prints it.
    pub sha256: String,
}

impl Stamp {
    /// Of these bytes.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, sha256: hexadecimal(&Sha256::digest(bytes)) }
    }

    /// Of all that can be read.
    ///
    /// # Errors
    /// The reader's.
    pub fn of_reader(mut from: impl Read) -> io::Result<Self> {
        let (mut hash, mut buffer, mut bytes) = (Sha256::new(), vec![0; 1 << 16], 0);
        loop {
            match from.read(&mut buffer) {
                Ok(0) => return Ok(Self { bytes, sha256: hexadecimal(&hash.finalize()) }),
                Ok(count) => {
                    hash.update(&buffer[..count]);
                    bytes += count as u64;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }
}

pub(super) fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the keys: 1.
    pub manifest: u32,
    /// Version of the program that wrote it.
    pub version: String,
    /// What the folder holds.
    pub kind: Kind,
    /// The run's id; a study draws one of its own.
    pub run_id: String,
    /// Name of the group, or of the study.
    pub group: String,
    /// How far the writing came.
    pub state: State,
    /// When the folder was taken, UTC.
    pub begun: String,
    /// When it was finished, UTC.
    pub finished: Option<String>,
    /// Why it is not, as far as the writer knew.
    pub why: Option<String>,
    /// The files that are whole, by their paths in the folder.
    pub files: BTreeMap<String, Stamp>,
    /// Files of an earlier run that may still be there: only while they are being removed.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub earlier: BTreeMap<String, Stamp>,
}

impl Manifest {
    /// Of a folder that is just being taken.
    #[must_use]
    pub fn new(kind: Kind, run_id: &str, group: &str) -> Self {
        Self {
            manifest: VERSION,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            kind,
            run_id: run_id.to_owned(),
            group: group.to_owned(),
            state: State::Unfinished,
            begun: loopbound_shared::clock::wall_time(),
            finished: None,
            why: None,
            files: BTreeMap::new(),
            earlier: BTreeMap::new(),
        }
    }

    /// Reads that of a folder; none if it has none.
    ///
    /// # Errors
    /// If there is a file of that name that can't be read, or is no manifest of loopbound's.
    pub fn read(folder: &Path) -> Result<Option<Self>, FolderError> {
        let path = folder.join(FILE);
        let refuse = |why: &dyn std::fmt::Display| FolderError::of(&path, why);
        let about = match std::fs::symlink_metadata(&path) {
            Ok(about) => about,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(refuse(&error)),
        };
        if !about.is_file() || about.len() > BYTES_MAX {
            return Err(refuse(&"not a manifest of loopbound's"));
        }
        let text = input::read_file(&path, input::SUMMARY_BYTES_MAX).map_err(|error| refuse(&error))?;
        let manifest: Self = serde_json::from_slice(&text)
            .map_err(|error| refuse(&format!("not a manifest of loopbound's, or a damaged one: {error}")))?;
        if manifest.manifest != VERSION {
            return Err(refuse(&format!("version {} of a manifest, allowed: {VERSION}", manifest.manifest)));
        }
        match manifest.files.keys().chain(manifest.earlier.keys()).find(|name| !stays_inside(name)) {
            Some(name) => Err(refuse(&format!("it lists {name:?}, which is no file of this folder"))),
            None => Ok(Some(manifest)),
        }
    }

    /// The run, for a sentence: its id and when it began.
    #[must_use]
    pub fn whose(&self) -> String {
        let what = match self.kind {
            Kind::Run => "run",
            Kind::Study => "study",
        };
        format!("{what} {} of {}", self.run_id, self.begun)
    }
}

/// Whether a path leads to a file below the folder that it is joined to.
pub(super) fn stays_inside(name: &str) -> bool {
    !name.is_empty() && Path::new(name).components().all(|part| matches!(part, Component::Normal(_)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_what_sha256sum_prints() {
        let stamp = Stamp::of(b"abc");
        assert_eq!(stamp.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!(Stamp::of_reader(b"abc".as_slice()).unwrap(), stamp);
    }

    #[test]
    fn a_manifest_that_lists_a_file_outside_of_its_folder_is_refused_and_so_is_what_is_none() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Manifest::read(folder.path()), Ok(None));
        let mut manifest = Manifest::new(Kind::Run, "0000000000000001", "g");
        manifest.files.insert("summary.json".to_owned(), Stamp::of(b"x"));
        let write = |manifest: &Manifest| {
            std::fs::write(folder.path().join(FILE), serde_json::to_vec(manifest).unwrap()).unwrap();
        };
        write(&manifest);
        assert_eq!(Manifest::read(folder.path()), Ok(Some(manifest.clone())));
        for outside in ["../summary.json", "/etc/passwd", "latency/../../x", ""] {
            let mut manifest = manifest.clone();
            manifest.files.insert(outside.to_owned(), Stamp::of(b"x"));
            write(&manifest);
            assert!(Manifest::read(folder.path()).unwrap_err().0.contains("no file of this folder"), "{outside}");
        }
        std::fs::write(folder.path().join(FILE), r#"{"name":"my web app"}"#).unwrap();
        assert!(Manifest::read(folder.path()).unwrap_err().0.contains("not a manifest of loopbound's"));
    }
}
