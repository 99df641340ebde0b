//! A process group on this host: its folder, who is in it, and that nothing of it outlives it.
//!
//! Everything of a group lies in one folder in memory (`/dev/shm/loopbound-UID/NAME`) and in shared-memory objects
//! whose names start with a prefix of the group's own. Every member holds a shared lock on the folder's `alive` file;
//! the kernel drops it when the member dies, however it dies. Whoever can take the lock exclusively is alone and
//! sweeps: the last member on leaving, the next `run` of that name, or `clean`.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};
use thiserror::Error;

use crate::layout::{FNV_START, fnv1a};
use crate::run_id::RunId;

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
    folder: PathBuf,
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

/// The folder in which this user's groups have theirs: `LOOPBOUND_RUNTIME_DIR`, or `/dev/shm/loopbound-UID`.
#[must_use]
pub fn runtime_folder() -> PathBuf {
    std::env::var_os("LOOPBOUND_RUNTIME_DIR").map_or_else(
        || PathBuf::from(format!("/dev/shm/loopbound-{}", rustix::process::getuid().as_raw())),
        PathBuf::from,
    )
}

fn check_name(name: &str) -> Result<(), GroupError> {
    let good = |c: u8| c.is_ascii_alphanumeric() || c == b'-' || c == b'_';
    if (1..=32).contains(&name.len()) && name.bytes().all(good) {
        Ok(())
    } else {
        Err(GroupError::Name(name.to_owned()))
    }
}

/// Opens `alive` and takes `operation` on it; `None` if others hold it. Retries when the folder is swept meanwhile.
fn lock(folder: &Path, create: bool, operation: FlockOperation) -> Result<Option<File>, GroupError> {
    use std::os::unix::fs::MetadataExt;
    let path = folder.join("alive");
    let fail = |source| GroupError::Folder { path: path.clone(), source };
    loop {
        if create {
            fs::create_dir_all(folder).map_err(fail)?;
        }
        let file = match File::options().read(true).write(true).create(create).truncate(false).open(&path) {
            Ok(file) => file,
            Err(e) if e.kind() == io::ErrorKind::NotFound && create => continue,
            Err(e) => return Err(fail(e)),
        };
        match flock(&file, operation) {
            Ok(()) => {}
            Err(rustix::io::Errno::WOULDBLOCK) => return Ok(None),
            Err(e) => return Err(fail(e.into())),
        }
        // A sweeper may have removed the file between our open and our lock: then the lock is on nothing.
        match fs::metadata(&path) {
            Ok(there) if there.ino() == file.metadata().map_err(fail)?.ino() => return Ok(Some(file)),
            _ if create => {}
            _ => return Ok(None),
        }
    }
}

/// The file that holds the run's id.
const RUN_ID_FILE: &str = "run-id";
/// Where the system keeps shared-memory objects.
const SHARED_MEMORY: &str = "/dev/shm";
/// Tries of [`Group::create`], a millisecond apart: the lock of a dead group is free again by then.
const CREATE_TRIES: u32 = 20;
/// Tries of the one who leaves, a millisecond apart.
const LEAVE_TRIES: u32 = 3;

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
    /// If the name is not one, the group is running, or the folder can't be made.
    pub fn create(name: &str) -> Result<Self, GroupError> {
        check_name(name)?;
        let folder = runtime_folder().join(name);
        let taken = patiently(CREATE_TRIES, || lock(&folder, true, FlockOperation::NonBlockingLockExclusive));
        let Some(exclusive) = taken? else {
            return Err(GroupError::Running(name.to_owned()));
        };
        let group = Self { name: name.to_owned(), folder, run_id: RunId::draw(), alive: exclusive };
        group.sweep_contents();
        let path = group.file(RUN_ID_FILE);
        fs::write(&path, group.run_id.to_string()).map_err(|source| GroupError::Folder { path, source })?;
        flock(&group.alive, FlockOperation::LockShared)
            .map_err(|e| GroupError::Folder { path: group.folder.clone(), source: e.into() })?;
        Ok(group)
    }

    /// Joins a running group.
    ///
    /// # Errors
    /// If the name is not one or the group is not running.
    pub fn join(name: &str) -> Result<Self, GroupError> {
        check_name(name)?;
        let folder = runtime_folder().join(name);
        let not_running = || GroupError::NotRunning {
            name: name.to_owned(),
            running: list().into_iter().filter(|g| g.alive).map(|g| g.name).collect(),
        };
        if !list().iter().any(|g| g.alive && g.name == name) {
            return Err(not_running());
        }
        match lock(&folder, false, FlockOperation::NonBlockingLockShared) {
            Ok(Some(alive)) => {
                let path = folder.join(RUN_ID_FILE);
                let text =
                    fs::read_to_string(&path).map_err(|source| GroupError::Folder { path: path.clone(), source })?;
                let no_id = |e| GroupError::Folder { path, source: io::Error::new(io::ErrorKind::InvalidData, e) };
                let run_id = text.parse().map_err(no_id)?;
                Ok(Self { name: name.to_owned(), folder, run_id, alive })
            }
            Ok(None) | Err(_) => Err(not_running()),
        }
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

    /// A file of the group's own.
    #[must_use]
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The prefix of all its shared-memory objects.
    #[must_use]
    pub fn prefix(&self) -> String {
        prefix_of(&self.folder)
    }

    /// Where the transport keeps its own files. Its sockets lie there, and the system allows their paths 107 bytes: so
    /// this one is short, whatever the group's name and folder are. It is swept with the other objects of the prefix.
    #[must_use]
    pub fn transport_root(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(format!("{}t", self.prefix()))
    }

    fn sweep_contents(&self) {
        sweep_shared_memory(&self.prefix());
        for entry in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            if entry.file_name() != "alive" {
                remove(&entry);
            }
        }
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        // An upgrade gives up the shared lock first: of several that leave at once, the last to try gets it.
        let upgrade = || Ok(flock(&self.alive, FlockOperation::NonBlockingLockExclusive).ok());
        if matches!(patiently(LEAVE_TRIES, upgrade), Ok(Some(()))) {
            self.sweep_contents();
            let _ = fs::remove_dir_all(&self.folder);
            let _ = fs::remove_dir(runtime_folder());
        }
    }
}

/// Object names start with a hash over the folder, so that two users or two folders never meet.
fn prefix_of(folder: &Path) -> String {
    format!("lb{:016x}_", fnv1a(FNV_START, folder.as_os_str().as_encoded_bytes()))
}

fn sweep_shared_memory(prefix: &str) {
    for entry in fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
        if entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes()) {
            remove(&entry);
        }
    }
}

/// What can't be removed now is found by the next sweep.
fn remove(entry: &fs::DirEntry) {
    let _ = if entry.file_type().is_ok_and(|t| t.is_dir()) {
        fs::remove_dir_all(entry.path())
    } else {
        fs::remove_file(entry.path())
    };
}

/// All groups of this user that have a folder.
#[must_use]
pub fn list() -> Vec<Found> {
    let mut found: Vec<Found> = fs::read_dir(runtime_folder())
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| check_name(name).is_ok())
        .map(|name| {
            let folder = runtime_folder().join(&name);
            // Asking with a shared lock would make two askers see each other as members; exclusive can't be held
            // while a member lives, and is given back at once.
            let alive = matches!(lock(&folder, false, FlockOperation::NonBlockingLockExclusive), Ok(None));
            Found { name, alive }
        })
        .collect();
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

/// Sweeps every group of this user that has no living member; returns their names.
#[must_use]
pub fn clean() -> Vec<String> {
    let dead = list().into_iter().filter(|g| !g.alive);
    dead.filter_map(|g| Group::create(&g.name).ok().map(|group| group.name().to_owned())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unique(what: &str) -> String {
        format!("test-{what}-{}", std::process::id())
    }

    #[test]
    fn a_running_group_is_refused_a_second_time_and_gone_when_the_last_member_leaves() {
        let name = unique("twice");
        let group = Group::create(&name).unwrap();
        assert!(matches!(Group::create(&name), Err(GroupError::Running(_))));
        let member = Group::join(&name).unwrap();
        let folder = runtime_folder().join(&name);
        drop(group);
        assert!(folder.exists(), "a member is still in it");
        drop(member);
        assert!(!folder.exists(), "the last one sweeps");
        assert!(matches!(Group::join(&name), Err(GroupError::NotRunning { .. })));
    }

    #[test]
    fn a_look_at_the_groups_neither_refuses_a_new_one_nor_keeps_a_last_member_from_sweeping() {
        let done = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(std::sync::atomic::Ordering::Relaxed) {
                    let _ = list();
                }
            });
            let outcome = (0..200).find_map(|round| {
                let name = unique(&format!("looked-{round}"));
                let created = Group::create(&name).map(drop).err().map(|e| e.to_string());
                created.or_else(|| runtime_folder().join(&name).exists().then(|| format!("{name} is still there")))
            });
            done.store(true, std::sync::atomic::Ordering::Relaxed);
            assert_eq!(outcome, None);
        });
    }

    #[test]
    fn what_a_dead_group_left_is_swept_by_the_next_of_that_name() {
        let name = unique("dead");
        let folder = runtime_folder().join(&name);
        let transport = PathBuf::from(format!("/dev/shm/{}t", prefix_of(&folder)));
        fs::create_dir_all(transport.join("nodes")).unwrap();
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("alive"), "").unwrap();
        let object = Path::new("/dev/shm").join(format!("{}left", prefix_of(&folder)));
        fs::write(&object, "x").unwrap();
        assert!(list().contains(&Found { name: name.clone(), alive: false }));
        let group = Group::create(&name).unwrap();
        assert!(!object.exists() && !transport.exists());
        assert_eq!(group.transport_root(), transport);
        drop(group);
        assert!(!folder.exists());
    }

    #[test]
    fn a_bad_name_is_refused() {
        for name in ["", "a/b", "..", "a b", &"x".repeat(33)] {
            assert!(matches!(Group::create(name), Err(GroupError::Name(_))), "{name}");
        }
    }
}
