//! The folder while its run lasts: files are written whole, and what is written is kept in the manifest.

use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use loopbound_shared::clock::wall_time;
use loopbound_shared::run_id::RunId;
use rustix::fs::{FlockOperation, Mode, OFlags};

use super::manifest::{Manifest, Stamp, State};
use super::{FILE, FolderError, Stream};

/// The folder, with a lock that keeps other runs out.
#[derive(Debug)]
pub struct Results {
    path: PathBuf,
    folder: File,
    manifest: Manifest,
}

impl Results {
    pub(super) fn new(path: PathBuf, folder: File, manifest: Manifest) -> Self {
        Self { path, folder, manifest }
    }

    /// The same folder in another process of the run.
    ///
    /// # Errors
    /// If the folder can't be opened, or another run has taken it.
    pub fn join(path: &Path, run_id: RunId) -> Result<Self, FolderError> {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
        let folder: File =
            rustix::fs::open(path, flags, Mode::empty()).map_err(|error| FolderError::of(path, error))?.into();
        let manifest = Manifest::read(path)?.filter(|manifest| manifest.run_id == run_id.to_string());
        let manifest = manifest.ok_or_else(|| FolderError::of(path, "another run has taken the folder"))?;
        let results = Self::new(path.to_owned(), folder, manifest);
        results.share();
        Ok(results)
    }

    /// Members of the run hold the lock together; whoever wants to take the folder needs it alone.
    pub(super) fn share(&self) {
        // A filesystem without such locks has none.
        let _ = rustix::fs::flock(&self.folder, FlockOperation::NonBlockingLockShared);
    }

    /// What is known of the folder.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Takes over what another process of the run has written meanwhile.
    ///
    /// # Errors
    /// If the manifest can't be read.
    pub fn reload(&mut self) -> Result<(), FolderError> {
        if let Some(manifest) = Manifest::read(&self.path)?.filter(|now| now.run_id == self.manifest.run_id) {
            self.manifest = manifest;
        }
        Ok(())
    }

    /// Begins a file that grows while the run lasts. What a monitor of the same run wrote before it had to be started
    /// again makes room.
    pub(crate) fn stream(&self, name: &str) -> io::Result<Stream> {
        let path = self.path.join(name);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        Stream::create(&path)
    }

    /// A file is whole.
    pub fn note(&mut self, name: impl Into<String>, stamp: Stamp) {
        self.manifest.files.insert(name.into(), stamp);
    }

    /// A file with this content is about to be written.
    pub fn announce(&mut self, name: &str, bytes: &[u8]) {
        self.note(name, Stamp::of(bytes));
    }

    /// Writes a file whole or not at all.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn write(&mut self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let path = self.path.join(name);
        if let Some(parent) = path.parent().filter(|parent| *parent != self.path) {
            fs::create_dir_all(parent)?;
        }
        write_aside(&path, bytes, false)?;
        self.note(name, Stamp::of(bytes));
        Ok(())
    }

    pub(super) fn forget_the_earlier(&mut self) {
        self.manifest.earlier.clear();
    }

    /// Writes the manifest as it is.
    ///
    /// # Errors
    /// If it can't be written.
    pub fn save(&self) -> io::Result<()> {
        let mut text = serde_json::to_string_pretty(&self.manifest)?;
        text.push('\n');
        write_aside(&self.path.join(FILE), text.as_bytes(), true)?;
        self.folder.sync_all().or(Ok(()))
    }

    /// All files are there.
    ///
    /// # Errors
    /// If the manifest can't be written: then the folder stays unfinished.
    pub fn finish(mut self) -> io::Result<()> {
        self.manifest.state = State::Finished;
        self.manifest.finished = Some(wall_time());
        self.manifest.why = None;
        self.save()
    }

    /// They are not, and this is why. A disk that has no room even for that leaves the folder unfinished too.
    pub fn leave_unfinished(mut self, why: &str) {
        self.manifest.why = Some(why.to_owned());
        let _ = self.save();
    }
}

/// Under a name of its own first; a reader finds the file as it was, or as it is now.
fn write_aside(path: &Path, bytes: &[u8], sync: bool) -> io::Result<()> {
    let mut name = std::ffi::OsString::from(".loopbound-new-");
    name.push(path.file_name().unwrap_or_default());
    let aside = path.with_file_name(name);
    let write = || -> io::Result<()> {
        let _ = fs::remove_file(&aside);
        let mut file = File::create_new(&aside)?;
        file.write_all(bytes)?;
        if sync { file.sync_all() } else { Ok(()) }
    };
    write().and_then(|()| fs::rename(&aside, path)).inspect_err(|_| drop(fs::remove_file(&aside)))
}
