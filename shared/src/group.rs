//! A process group on this host: its folder, who is in it, and that nothing of it outlives it.
//!
//! Everything of a group lies in one folder in memory (`/dev/shm/loopbound-UID/NAME`) and in shared-memory objects
//! whose names start with a prefix of the group's own. Every member holds a shared lock on the folder's `alive` file;
//! the kernel drops it when the member dies, however it dies. Whoever can take the lock exclusively is alone and
//! sweeps: the last member on leaving, the next `run` of that name, or `clean`.
//!
//! `alive` is also the mark of a group: only a folder of this user's with a file of that name and the right words in it
//! is ever swept. What lies there is private to the user, whatever the umask.

pub mod room;
mod runtime;
mod sweep;

use std::fs::File;
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{FileExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use rustix::process::geteuid;
use thiserror::Error;

use crate::layout::{FNV_START, fnv1a};
use crate::run_id::RunId;
use room::NoRoom;
use runtime::Folder;
pub use runtime::{RUNTIME_VARIABLE, runtime_folder};
use sweep::SHARED_MEMORY;

/// Why a group can't be created or joined.
#[derive(Debug, Error)]
pub enum GroupError {
    /// The name is not one.
    #[error("group name `{0}`: 1 to 32 of a-z, A-Z, 0-9, `-` and `_` are allowed")]
    Name(String),
    /// It is running.
    #[error("group `{0}` is running already; stop it, or choose another name with --group")]
    Running(String),
    /// It is not running.
    #[error("no group `{name}` is running{}", running_list(.running))]
    NotRunning {
        /// What was asked for.
        name: String,
        /// What runs.
        running: Vec<String>,
    },
    /// The variable that names the runtime directory is no absolute path.
    #[error(
        "{RUNTIME_VARIABLE} is {0:?}: the absolute path of a folder is needed; unset, it is /dev/shm/loopbound-UID"
    )]
    Variable(String),
    /// Something of that name is there that this program did not make for this user.
    #[error(
        "{path} {why}; groups are kept only in a folder of your own that nobody else may enter: \
         remove that one, or name another with {RUNTIME_VARIABLE}=/absolute/path"
    )]
    NotOurs {
        /// What is there.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The folder can't be used.
    #[error("the group's folder {path}: {source}")]
    Folder {
        /// The folder or a file in it.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

fn running_list(running: &[String]) -> String {
    if running.is_empty() { " (none is)".to_owned() } else { format!("; running: {}", running.join(", ")) }
}

/// A member's hold on its group. Leaves on drop, and the last to leave sweeps.
#[derive(Debug)]
pub struct Group {
    name: String,
    runtime: Folder,
    folder: Folder,
    run_id: RunId,
    alive: File,
}

/// What `ps` and `clean` see of a group.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Its name.
    pub name: String,
    /// Whether any member lives.
    pub alive: bool,
}

fn check_name(name: &str) -> Result<(), GroupError> {
    let good = |c: u8| c.is_ascii_alphanumeric() || c == b'-' || c == b'_';
    if (1..=32).contains(&name.len()) && name.bytes().all(good) {
        Ok(())
    } else {
        Err(GroupError::Name(name.to_owned()))
    }
}

/// The lock's file, and the mark of a group.
const ALIVE_FILE: &str = "alive";
/// What is in it.
const MARK: &[u8] = b"loopbound group\n";
/// The file that holds the run's id.
const RUN_ID_FILE: &str = "run-id";
/// Tries of [`Group::create`], a millisecond apart: the lock of a dead group is free again by then.
const CREATE_TRIES: u32 = 20;
/// Tries of the one who leaves, a millisecond apart.
const LEAVE_TRIES: u32 = 3;
/// Tries to get hold of a folder that others remove meanwhile.
const RACE_TRIES: u32 = 1000;

/// What came of asking for a group's lock.
enum Lock {
    /// It is ours.
    Taken { runtime: Folder, folder: Folder, alive: File },
    /// Members hold it.
    Held,
    /// There is no such group.
    Nobody,
}

/// Takes `operation` on the lock of group `name`, which is made first if `make`.
fn lock(name: &str, make: bool, operation: FlockOperation) -> Result<Lock, GroupError> {
    for _ in 0..RACE_TRIES {
        let Some(runtime) = Folder::runtime(make)? else { return Ok(Lock::Nobody) };
        let there = match runtime.folder(name, make)? {
            Some(folder) => open_alive(&folder, make)?.map(|alive| (folder, alive)),
            None => None,
        };
        let Some((folder, alive)) = there else {
            if make {
                continue;
            }
            return Ok(Lock::Nobody);
        };
        match flock(&alive, operation) {
            Ok(()) => {}
            Err(Errno::WOULDBLOCK) => return Ok(Lock::Held),
            Err(errno) => return Err(folder.error(ALIVE_FILE, errno.into())),
        }
        // A sweeper may have removed the file between our open and our lock: then the lock is on nothing.
        if alive.metadata().is_ok_and(|found| found.nlink() == 1) {
            return Ok(Lock::Taken { runtime, folder, alive });
        }
        if !make {
            return Ok(Lock::Nobody);
        }
    }
    Err(GroupError::Running(name.to_owned()))
}

/// The lock's file of a folder that is a group's; with `make` an empty folder becomes one. `None` if it is not there, or
/// being removed just now.
fn open_alive(folder: &Folder, make: bool) -> Result<Option<File>, GroupError> {
    let foreign = |why: &str| Err(GroupError::NotOurs { path: folder.path().to_owned(), why: why.to_owned() });
    let unmarked = || foreign("is not a group's folder: something else is in it");
    let file = match folder.open_file(ALIVE_FILE) {
        Ok(file) => file,
        Err(error) if error.kind() != io::ErrorKind::NotFound => return unmarked(),
        Err(_) if !make => return Ok(None),
        // Looked at before a file is made: that nothing is there.
        Err(_) => match folder.entries() {
            Ok(names) if !names.is_empty() => return unmarked(),
            _ => match folder.create_file(ALIVE_FILE, OFlags::empty()) {
                Ok(file) => file,
                Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
                Err(error) => return Err(folder.error(ALIVE_FILE, error)),
            },
        },
    };
    // In this order: a group's maker writes the mark before anything else.
    let alone = folder.entries().is_ok_and(|names| names.len() <= 1);
    let found = file.metadata().map_err(|e| folder.error(ALIVE_FILE, e))?;
    let ours = found.is_file() && found.uid() == geteuid().as_raw() && found.nlink() <= 1;
    if ours && (has_mark(&file) || (alone && found.len() == 0)) { Ok(Some(file)) } else { unmarked() }
}

fn has_mark(file: &File) -> bool {
    let mut bytes = [0; MARK.len() + 1];
    file.read_at(&mut bytes, 0).is_ok_and(|length| bytes[..length] == *MARK)
}

/// Tries again what failed: [`list`] holds each lock for an instant, and whoever asks just then would take that for a
/// living member.
fn patiently<T>(
    tries: u32,
    mut attempt: impl FnMut() -> Result<Option<T>, GroupError>,
) -> Result<Option<T>, GroupError> {
    for _ in 1..tries {
        if let Some(got) = attempt()? {
            return Ok(Some(got));
        }
        crate::clock::sleep_ns(1_000_000);
    }
    attempt()
}

impl Group {
    /// Makes a group of this name and joins it. What a dead group of that name left is swept first.
    ///
    /// # Errors
    /// If the name is not one, the group is running, the folder can't be made, or something else lies in its place.
    pub fn create(name: &str) -> Result<Self, GroupError> {
        check_name(name)?;
        let taken = patiently(CREATE_TRIES, || match lock(name, true, FlockOperation::NonBlockingLockExclusive)? {
            Lock::Taken { runtime, folder, alive } => Ok(Some((runtime, folder, alive))),
            Lock::Held | Lock::Nobody => Ok(None),
        })?;
        let Some((runtime, folder, alive)) = taken else { return Err(GroupError::Running(name.to_owned())) };
        let group = Self { name: name.to_owned(), runtime, folder, run_id: RunId::draw(), alive };
        group.alive.write_all_at(MARK, 0).map_err(|e| group.folder.error(ALIVE_FILE, e))?;
        group.sweep_contents();
        group.write(RUN_ID_FILE, group.run_id.to_string().as_bytes())?;
        group.make_transport_root()?;
        flock(&group.alive, FlockOperation::LockShared).map_err(|e| group.folder.error(ALIVE_FILE, e.into()))?;
        Ok(group)
    }

    /// Joins a running group.
    ///
    /// # Errors
    /// If the name is not one, the group is not running, or the runtime directory is not this user's.
    pub fn join(name: &str) -> Result<Self, GroupError> {
        check_name(name)?;
        let members = list()?;
        if members.iter().any(|g| g.alive && g.name == name)
            && let Ok(Lock::Taken { runtime, folder, alive }) = lock(name, false, FlockOperation::NonBlockingLockShared)
        {
            let run_id = read_run_id(&folder).map_err(|e| folder.error(RUN_ID_FILE, e))?;
            return Ok(Self { name: name.to_owned(), runtime, folder, run_id, alive });
        }
        let running = members.into_iter().filter(|g| g.alive && g.name != name).map(|g| g.name).collect();
        Err(GroupError::NotRunning { name: name.to_owned(), running })
    }

    /// The identity of the run that this group is.
    #[must_use]
    pub fn run_id(&self) -> RunId {
        self.run_id
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The path of a file of the group's own, for a process that is told where it lies.
    #[must_use]
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Opens a file of the group's own to append to; made if it is not there.
    ///
    /// # Errors
    /// The system's, with the path.
    pub fn append(&self, name: &str) -> Result<File, GroupError> {
        self.folder.create_file(name, OFlags::APPEND).map_err(|e| self.folder.error(name, e))
    }

    /// Writes a whole file of the group's own or nothing: a reader finds the old one or the new one.
    ///
    /// # Errors
    /// The system's, with the path.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), GroupError> {
        let new = format!("{name}.new");
        let written = self.folder.create_file(&new, OFlags::TRUNC).and_then(|mut file| file.write_all(bytes));
        written.and_then(|()| self.folder.rename(&new, name)).map_err(|e| self.folder.error(name, e))
    }

    /// The prefix of all its shared-memory objects. Nobody can know it before the group is there: it ends with a part of
    /// the run's id.
    #[must_use]
    pub fn prefix(&self) -> String {
        let run = self.run_id.bits() & 0xfff_ffff;
        format!("{}{run:07x}_", object_prefix(self.folder.path()))
    }

    /// Where the transport keeps its own files. Its sockets lie there, and the system allows their paths 107 bytes: so
    /// this one is short, whatever the group's name and folder are. It is swept with the other objects of the prefix.
    #[must_use]
    pub fn transport_root(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(format!("{}t", self.prefix()))
    }

    /// The transport would make its folder such that others may look into it.
    fn make_transport_root(&self) -> Result<(), GroupError> {
        use std::os::unix::fs::DirBuilderExt as _;
        let path = self.transport_root();
        std::fs::DirBuilder::new().mode(0o700).create(&path).map_err(|source| GroupError::Folder { path, source })
    }

    /// Takes everybody else's rights from what the transport has made. It gives them for one of its objects, which counts
    /// the group's nodes.
    pub fn close_objects(&self) {
        sweep::close_objects(&self.prefix());
    }

    /// Leaves as the last one, if the others leave within `patience_ns`: one that was killed holds on until the kernel has
    /// taken it down.
    pub fn leave_last(self, patience_ns: u64) {
        let until_ns = crate::clock::now_ns().saturating_add(patience_ns);
        while flock(&self.alive, FlockOperation::NonBlockingLockExclusive).is_err() && crate::clock::now_ns() < until_ns
        {
            crate::clock::sleep_ns(2_000_000);
        }
    }

    /// Takes the pages of all objects that the transport has made for this group, so that touching one can't fail later.
    ///
    /// # Errors
    /// If there is no room for one.
    pub fn take_room(&self) -> Result<(), NoRoom> {
        room::take(&self.prefix())
    }

    fn sweep_contents(&self) {
        sweep::objects(&object_prefix(self.folder.path()));
        sweep::files(&self.folder, ALIVE_FILE);
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        // An upgrade gives up the shared lock first: of several that leave at once, the last to try gets it.
        let upgrade = || Ok(flock(&self.alive, FlockOperation::NonBlockingLockExclusive).ok());
        if matches!(patiently(LEAVE_TRIES, upgrade), Ok(Some(()))) {
            self.sweep_contents();
            // The mark goes last: a sweep that is interrupted is taken up by the next.
            let _ = self.folder.remove_file(ALIVE_FILE.as_ref());
            let _ = self.runtime.remove_folder(&self.name);
            self.runtime.remove_runtime();
        }
    }
}

fn read_run_id(folder: &Folder) -> io::Result<RunId> {
    let mut text = String::new();
    folder.open_file(RUN_ID_FILE)?.take(64).read_to_string(&mut text)?;
    text.parse().map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e))
}

/// How the names of all shared-memory objects begin that groups of this folder make or have made. It has a hash over the
/// folder, so that two users or two folders never meet.
#[must_use]
pub fn object_prefix(folder: &Path) -> String {
    format!("lb{:09x}", fnv1a(FNV_START, folder.as_os_str().as_encoded_bytes()) >> 28)
}

/// The path of a file of group `name`, whether it runs or not.
///
/// # Errors
/// If the name is not one, or the runtime directory has no valid name.
pub fn file_of(name: &str, file: &str) -> Result<PathBuf, GroupError> {
    check_name(name)?;
    Ok(runtime_folder()?.join(name).join(file))
}

/// All groups of this user that have a folder.
///
/// # Errors
/// If the runtime directory has no valid name, or is not this user's.
pub fn list() -> Result<Vec<Found>, GroupError> {
    let Some(runtime) = Folder::runtime(false)? else { return Ok(Vec::new()) };
    let names = runtime.entries().map_err(|e| runtime.error("", e))?;
    let names = names.into_iter().filter_map(|name| name.into_string().ok()).filter(|name| check_name(name).is_ok());
    // Asking with a shared lock would make two askers see each other as members; exclusive can't be held while a member
    // lives, and is given back at once. What is not marked as a group's is none.
    let mut found: Vec<Found> = names
        .filter_map(|name| match lock(&name, false, FlockOperation::NonBlockingLockExclusive) {
            Ok(Lock::Held) => Some(Found { name, alive: true }),
            Ok(Lock::Taken { .. }) => Some(Found { name, alive: false }),
            Ok(Lock::Nobody) | Err(_) => None,
        })
        .collect();
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

/// Sweeps group `name` if no member of it lives.
///
/// # Errors
/// If the runtime directory has no valid name, or is not this user's.
pub fn sweep_if_dead(name: &str) -> Result<(), GroupError> {
    if list()?.iter().any(|found| found.name == name && !found.alive) {
        drop(Group::create(name)?);
    }
    Ok(())
}

/// Sweeps every group of this user that has no living member; returns their names.
///
/// # Errors
/// If the runtime directory has no valid name, or is not this user's.
pub fn clean() -> Result<Vec<String>, GroupError> {
    let dead = list()?.into_iter().filter(|g| !g.alive);
    let swept = dead.filter_map(|g| Group::create(&g.name).ok().map(|group| group.name().to_owned()));
    let mut swept: Vec<String> = swept.collect();
    swept.extend(remove_unmarked()?);
    Ok(swept)
}

/// Removes the folders of groups whose maker or last member was killed when there was no mark in them yet, or any more:
/// they are empty. Only where this program has made all that is there; somebody's own folder may be empty on purpose.
fn remove_unmarked() -> Result<Vec<String>, GroupError> {
    let Some(runtime) = Folder::runtime(false)?.filter(Folder::is_made_here) else { return Ok(Vec::new()) };
    let names = runtime.entries().map_err(|e| runtime.error("", e))?;
    let names = names.into_iter().filter_map(|name| name.into_string().ok()).filter(|name| check_name(name).is_ok());
    // Whoever is making one just now makes it again.
    let removed = names.filter(|name| runtime.remove_folder(name).is_ok()).collect();
    runtime.remove_runtime();
    Ok(removed)
}

#[cfg(test)]
mod tests;
