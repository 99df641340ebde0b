//! Taking a folder for a run: first everything that can be refused, which touches nothing; then, in one go, the mark
//! *unfinished* and the removal of what an earlier run wrote there.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use loopbound_scenario::input;
use loopbound_shared::run_id::RunId;
use rustix::fs::{Access, AtFlags, FlockOperation, Mode, OFlags};
use rustix::io::Errno;

use super::known::{self, FOLDERS, HEAD_BYTES, SCENARIO, WAYPOINTS};
use super::manifest::{Kind, Manifest, Stamp, State};
use super::results::Results;
use super::{FILE, FolderError};

/// With less than this a recording would end with its first lines, bytes.
const ROOM_BYTES: u64 = 128 << 10;
/// A file that people may have edited is compared whole up to this size, bytes.
const COMPARED_BYTES: u64 = 16 << 20;

/// A folder that is locked for a run, in which nothing was changed yet. What had to be made of it goes again with it.
#[derive(Debug)]
pub struct Claim {
    path: PathBuf,
    folder: File,
    kind: Kind,
    /// Files of an earlier run or study of this program.
    earlier: Vec<String>,
    listed: BTreeMap<String, Stamp>,
    /// The outermost folder that was made here.
    made: Option<PathBuf>,
}

/// What a run says of itself when it takes the folder.
#[derive(Clone, Debug)]
pub struct Begin<'a> {
    /// Its id.
    pub run_id: RunId,
    /// Its group.
    pub group: &'a str,
    /// The scenario with all defaults filled in; none for a study.
    pub scenario: Option<&'a str>,
    /// The waypoints that it follows, as they were in their file.
    pub waypoints: Option<&'a [u8]>,
}

impl Claim {
    /// Locks the folder (made if need be) and finds everything for which a run there has to be refused.
    ///
    /// # Errors
    /// It is a file, can't be written, has no room left, another run is writing there, or holds files of somebody
    /// else's with names that are needed.
    pub fn prepare(path: &Path, kind: Kind) -> Result<Self, FolderError> {
        let refuse = |why: &dyn std::fmt::Display| FolderError::of(path, why);
        if fs::metadata(path).is_ok_and(|about| !about.is_dir()) {
            return Err(refuse(&"it is a file, allowed: a folder"));
        }
        if fs::symlink_metadata(path).is_ok() && fs::metadata(path).is_err() {
            return Err(refuse(&"it is a symbolic link that leads nowhere, or may not be followed"));
        }
        let made = make(path).map_err(|error| refuse(&format!("it can't be made: {error}")))?;
        let open = || -> io::Result<(PathBuf, File)> {
            let path = path.canonicalize()?;
            let folder = rustix::fs::open(&path, OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC, Mode::empty())?;
            rustix::fs::accessat(&folder, ".", Access::WRITE_OK | Access::EXEC_OK, AtFlags::EACCESS)?;
            Ok((path, folder.into()))
        };
        let opened = open().map_err(|error| refuse(&format!("it can't be written: {error}")));
        let (path, folder) = opened.inspect_err(|_| unmake(made.as_deref()))?;
        let mut claim = Self { path, folder, kind, earlier: Vec::new(), listed: BTreeMap::new(), made };
        claim.lock()?;
        claim.look_around()?;
        claim.ask_for_room()?;
        Ok(claim)
    }

    /// The files that a study will write: they have to be an earlier study's, or not there.
    ///
    /// # Errors
    /// If one is somebody else's.
    pub fn for_files(mut self, names: &[String]) -> Result<Self, FolderError> {
        for name in names {
            if !self.earlier.contains(name) && self.is_there_and_ours(name)? {
                self.earlier.push(name.clone());
            }
        }
        Ok(self)
    }

    /// Where it is, without links and from the root.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn refuse(&self, why: impl std::fmt::Display) -> FolderError {
        FolderError::of(&self.path, why)
    }

    /// Filesystems without such locks have none: there two runs at once are not noticed.
    fn lock(&self) -> Result<(), FolderError> {
        match rustix::fs::flock(&self.folder, FlockOperation::NonBlockingLockExclusive) {
            Err(Errno::WOULDBLOCK) => {
                let whose = Manifest::read(&self.path).ok().flatten().map(|manifest| manifest.whose());
                let whose = whose.unwrap_or_else(|| "another run".to_owned());
                Err(self.refuse(format!("{whose} is writing there; wait for its end, or choose another folder")))
            }
            _ => Ok(()),
        }
    }

    /// Finds what an earlier run wrote, and refuses what nobody of ours did.
    fn look_around(&mut self) -> Result<(), FolderError> {
        let manifest = Manifest::read(&self.path)?;
        if let Some(manifest) = manifest {
            if manifest.kind != self.kind {
                return Err(self.refuse(format!("it holds {}; choose another folder", manifest.whose())));
            }
            self.listed = manifest.files;
            self.listed.extend(manifest.earlier);
        }
        for name in FOLDERS {
            let there = fs::symlink_metadata(self.path.join(name));
            if self.kind == Kind::Run && there.is_ok_and(|about| !about.is_dir()) {
                return Err(self.refuse(format!("{name} is there and no folder: remove it, or choose another folder")));
            }
        }
        let mut names: Vec<String> = self.listed.keys().cloned().collect();
        if self.kind == Kind::Run {
            names.extend(known::names());
            let changes = fs::read_dir(self.path.join("changes")).into_iter().flatten().flatten();
            let changes = changes.filter_map(|entry| entry.file_name().into_string().ok());
            names.extend(changes.filter(|name| known::is_change(name)).map(|name| format!("changes/{name}")));
        }
        names.sort();
        names.dedup();
        for name in names {
            if self.is_there_and_ours(&name)? {
                self.earlier.push(name);
            }
        }
        Ok(())
    }

    /// Whether there is such a file of an earlier run; refused if it is somebody else's.
    fn is_there_and_ours(&self, name: &str) -> Result<bool, FolderError> {
        let path = self.path.join(name);
        let refuse =
            |why: &str| Err(self.refuse(format!("{name} {why}; it stays: move it away, or choose another folder")));
        // A file below a link is not this folder's.
        let below = path.parent().filter(|parent| *parent != self.path);
        if below.is_some_and(|parent| fs::symlink_metadata(parent).is_ok_and(|about| !about.is_dir())) {
            return refuse("lies behind a symbolic link");
        }
        let Ok(about) = fs::symlink_metadata(&path) else { return Ok(false) };
        if !about.is_file() {
            return refuse("is a symbolic link or no ordinary file");
        }
        let limit = if name == SCENARIO { COMPARED_BYTES } else { HEAD_BYTES as u64 };
        let head = input::open_file(&path).and_then(|file| {
            let mut head = Vec::new();
            file.take(limit).read_to_end(&mut head).map(|_| head)
        });
        let head = match head {
            Ok(head) => head,
            Err(error) => return refuse(&format!("can't be read ({error})")),
        };
        let as_listed = |stamp: &Stamp| {
            // Writing was cut off before anything came of the file.
            about.len() == 0
                || (stamp.bytes == about.len()
                    && stamp.bytes <= COMPARED_BYTES
                    && input::open_file(&path).and_then(Stamp::of_reader).is_ok_and(|now| now == *stamp))
        };
        let empty_of_ours = about.len() == 0 && fs::symlink_metadata(self.path.join(FILE)).is_ok();
        // What a study wrote is told by its manifest alone.
        let known = || self.kind == Kind::Run && known::is_ours(&self.path, name, &head);
        if self.listed.get(name).is_some_and(as_listed) || empty_of_ours || known() {
            return Ok(true);
        }
        refuse(match (self.listed.contains_key(name), self.kind) {
            (true, Kind::Run) => "was changed since its run wrote it",
            (true, Kind::Study) => "was changed since its study wrote it",
            (false, _) => "is not of loopbound's",
        })
    }

    fn ask_for_room(&self) -> Result<(), FolderError> {
        let freed = self.earlier.iter().filter_map(|name| fs::symlink_metadata(self.path.join(name)).ok());
        let freed: u64 = freed.map(|about| about.len()).sum();
        let room = rustix::fs::fstatvfs(&self.folder).map(|stat| stat.f_bavail.saturating_mul(stat.f_frsize));
        match room {
            Ok(room) if room.saturating_add(freed) < ROOM_BYTES => {
                let need = ROOM_BYTES >> 10;
                Err(self.refuse(format!(
                    "its disk has {} KiB left, and not even the shortest run needs less than {need}",
                    room >> 10
                )))
            }
            _ => Ok(()),
        }
    }

    /// From here on the folder is the new run's: marked unfinished, then emptied of what an earlier one wrote.
    ///
    /// # Errors
    /// If the mark can't be written (then the earlier run is still there, whole), or the rest can't.
    pub fn begin(mut self, begin: &Begin<'_>) -> Result<Results, FolderError> {
        let fail = |path: &Path, error: io::Error| FolderError::of(path, error);
        let mut manifest = Manifest::new(self.kind, &begin.run_id.to_string(), begin.group);
        manifest.earlier = std::mem::take(&mut self.listed);
        let folder = self.folder.try_clone().map_err(|error| fail(&self.path, error))?;
        let mut results = Results::new(self.path.clone(), folder, manifest);
        match results.save() {
            // Not even the mark has room: the earlier files have to go first. A crash just now leaves a manifest of
            // which files are missing, and that is said too.
            Err(error) if error.kind() == io::ErrorKind::StorageFull => {
                self.remove_earlier()?;
                results.save()
            }
            saved => saved,
        }
        .map_err(|error| fail(&self.path.join(FILE), error))?;
        self.made = None;
        self.remove_earlier()?;
        // One that is not empty holds files of somebody else's.
        for name in FOLDERS {
            let _ = rustix::fs::unlinkat(&self.folder, name, AtFlags::REMOVEDIR);
        }
        results.forget_the_earlier();
        for (name, bytes) in [(SCENARIO, begin.scenario.map(str::as_bytes)), (WAYPOINTS, begin.waypoints)] {
            if let Some(bytes) = bytes {
                results.write(name, bytes).map_err(|error| fail(&self.path.join(name), error))?;
            }
        }
        results.save().map_err(|error| fail(&self.path.join(FILE), error))?;
        debug_assert_eq!(results.manifest().state, State::Unfinished);
        results.share();
        Ok(results)
    }

    fn remove_earlier(&self) -> Result<(), FolderError> {
        let remove = |name: &String| self.remove(name).map_err(|error| FolderError::of(&self.path.join(name), error));
        self.earlier.iter().try_for_each(remove)
    }

    /// By descriptors, so that nothing can be put in the way.
    fn remove(&self, name: &str) -> io::Result<()> {
        let removed = match name.rsplit_once('/') {
            None => rustix::fs::unlinkat(&self.folder, name, AtFlags::empty()),
            Some((below, name)) => {
                let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
                rustix::fs::openat(&self.folder, below, flags, Mode::empty())
                    .and_then(|below| rustix::fs::unlinkat(&below, name, AtFlags::empty()))
            }
        };
        match removed {
            Err(Errno::NOENT) | Ok(()) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        unmake(self.made.as_deref());
    }
}

/// Makes the folder; the outermost one that was not there before.
fn make(path: &Path) -> io::Result<Option<PathBuf>> {
    let missing =
        path.ancestors().filter(|at| !at.as_os_str().is_empty()).take_while(|at| fs::symlink_metadata(at).is_err());
    let outermost = missing.last().map(Path::to_path_buf);
    fs::create_dir_all(path).inspect_err(|_| unmake(outermost.as_deref()))?;
    // A working directory that is left meanwhile must not change what is meant.
    Ok(outermost.map(|made| std::path::absolute(&made).unwrap_or(made)))
}

/// Removes folders that were made and are empty.
fn unmake(outermost: Option<&Path>) {
    let Some(outermost) = outermost else { return };
    let mut innermost = outermost.to_path_buf();
    while let Some(Ok(entry)) = fs::read_dir(&innermost).ok().and_then(|mut entries| entries.next()) {
        innermost = entry.path();
    }
    while fs::remove_dir(&innermost).is_ok() && innermost != outermost {
        innermost.pop();
    }
}
