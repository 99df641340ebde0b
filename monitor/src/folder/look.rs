//! The folder of a run that is over: whose it is, whether it was finished, and which file is no longer as written.

use loopbound_model::quote;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, Mode, OFlags};

use super::known::{SAMPLES, SUMMARY};
use super::manifest::{Kind, Manifest, Stamp, State};
use super::{FILE, FolderError};
use loopbound_scenario::input;

/// What was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Look {
    /// Where.
    pub folder: PathBuf,
    /// The manifest; none in folders of versions that wrote none.
    pub manifest: Option<Manifest>,
    /// Why the recording is not whole: one line each, none if it is.
    pub faults: Vec<String>,
}

impl Look {
    /// Looks at the folder of a run, and compares every file with its size and hash.
    ///
    /// # Errors
    /// If there is no recording, it is that of a study, or its manifest can't be understood.
    pub fn at(folder: &Path) -> Result<Self, FolderError> {
        if !folder.is_dir() {
            let why =
                if folder.exists() { "it is a file, allowed: the folder of a run" } else { "there is no such folder" };
            return Err(FolderError::of(folder, why));
        }
        let manifest = Manifest::read(folder)?;
        let mut look = Self { folder: folder.to_owned(), manifest, faults: Vec::new() };
        match &look.manifest {
            Some(manifest) if manifest.kind == Kind::Study => {
                Err(FolderError::of(folder, format!("it holds {}, allowed: the folder of a run", manifest.whose())))
            }
            Some(manifest) => {
                look.faults = faults(folder, manifest);
                Ok(look)
            }
            None if folder.join(SUMMARY).exists() => Ok(look),
            None if folder.join(SAMPLES).exists() => {
                look.faults.push(format!("its run was not finished: there is no {SUMMARY}"));
                Ok(look)
            }
            None => {
                let why = format!("no recording there: neither {FILE} nor {SUMMARY} nor {SAMPLES}");
                Err(FolderError::of(folder, why))
            }
        }
    }

    /// Whether everything is there as its run wrote it, as far as can be known.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.faults.is_empty()
    }

    /// The run's id and time, or where its recording is.
    #[must_use]
    pub fn whose(&self) -> String {
        self.manifest.as_ref().map_or_else(|| format!("run in {}", quote::path(&self.folder)), Manifest::whose)
    }

    /// The line that goes before everything else that is said of a recording that is not whole.
    #[must_use]
    pub fn headline(&self) -> String {
        format!("INCOMPLETE: {} ({}): {}", self.whose(), quote::path(&self.folder), self.faults.join("; "))
    }

    /// A file of this folder was written again on purpose, such as its page: its size and hash follow. Nothing happens
    /// where there is no manifest, or a run is at work.
    ///
    /// # Errors
    /// If the manifest can't be written.
    pub fn rewrite(folder: &Path, name: &str, bytes: &[u8]) -> Result<(), FolderError> {
        let path = folder.join(name);
        let fail = |error: io::Error| FolderError::of(&path, error);
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
        let lock: File = rustix::fs::open(folder, flags, Mode::empty()).map_err(|error| fail(error.into()))?.into();
        let alone = rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive).is_ok();
        match Manifest::read(folder)?.filter(|_| alone) {
            Some(manifest) => {
                let mut results = super::Results::new(folder.to_owned(), lock, manifest);
                results.write(name, bytes).and_then(|()| results.save()).map_err(fail)
            }
            None if alone => fs::write(&path, bytes).map_err(fail),
            None => Err(FolderError::of(folder, "its run is still writing there")),
        }
    }
}

/// Whether the run that the manifest is of is at work now.
fn is_at_work(folder: &Path) -> bool {
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
    rustix::fs::open(folder, flags, Mode::empty()).is_ok_and(|folder| {
        rustix::fs::flock(&folder, FlockOperation::NonBlockingLockExclusive) == Err(rustix::io::Errno::WOULDBLOCK)
    })
}

fn faults(folder: &Path, manifest: &Manifest) -> Vec<String> {
    let mut faults = Vec::new();
    if manifest.state == State::Unfinished {
        faults.push(match &manifest.why {
            _ if is_at_work(folder) => "it is still under way".to_owned(),
            Some(why) => format!("its recording is not whole: {why}"),
            None => "it ended before its recording was finished".to_owned(),
        });
    }
    for (name, stamp) in &manifest.files {
        faults.extend(fault(&folder.join(name), stamp).map(|why| format!("{name} {why}")));
    }
    faults
}

/// What is wrong with a file, if anything is.
fn fault(path: &Path, stamp: &Stamp) -> Option<String> {
    let about = match fs::symlink_metadata(path) {
        Ok(about) if about.is_file() => about,
        Ok(_) => return Some("is no file any more".to_owned()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Some("is missing".to_owned()),
        Err(error) => return Some(format!("can't be read: {error}")),
    };
    if about.len() != stamp.bytes {
        return Some(format!("has {} bytes, its run wrote {}", about.len(), stamp.bytes));
    }
    match input::open_file(path).and_then(Stamp::of_reader) {
        Ok(now) if now == *stamp => None,
        Ok(_) => Some("is not what its run wrote: its SHA-256 differs".to_owned()),
        Err(error) => Some(format!("can't be read: {error}")),
    }
}

/// Refuses an output file that would take the place of a recording's own, such as `report a b --out a/samples.mcap`.
/// `own`: the one file of a folder that the command is there to write.
///
/// # Errors
/// If it would, or is a folder.
pub fn refuse_file_of_a_run(path: &Path, own: &str) -> Result<(), FolderError> {
    if path.is_dir() {
        return Err(FolderError::of(path, "it is a folder, allowed: a file"));
    }
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let Some(name) = absolute.file_name().and_then(|name| name.to_str()) else { return Ok(()) };
    if name == own {
        return Ok(());
    }
    // The folder of the run is the file's own, or the one above for `latency` and `changes`.
    let folders = absolute.ancestors().skip(1).take(2);
    for folder in folders {
        let below = absolute.strip_prefix(folder).ok().and_then(Path::to_str).unwrap_or(name);
        let listed = Manifest::read(folder).ok().flatten().is_some_and(|manifest| manifest.files.contains_key(below));
        let legacy =
            folder.join(SUMMARY).exists() && folder.join(SAMPLES).exists() && super::known::names().any(|n| n == below);
        if listed || legacy || (below == FILE && folder.join(FILE).exists()) {
            return Err(FolderError::of(path, "it is a file of a recorded run; choose another name"));
        }
    }
    Ok(())
}
