//! The runtime directory, in which the groups of a user have their folders, and a folder as this module's parent handles
//! it: by descriptor, so that nobody can exchange what was checked for something else, and without following links.

use std::ffi::{CString, OsStr};
use std::fs::{self, DirBuilder, File};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, Dir, FileType, Mode, OFlags, fstat, mkdirat, openat, renameat, unlinkat};
use rustix::io::Errno;
use rustix::process::geteuid;

use super::GroupError;

/// The variable that names the runtime directory.
pub const RUNTIME_VARIABLE: &str = "LOOPBOUND_RUNTIME_DIR";
/// In a runtime directory that this program has made, and may remove when it is empty.
const MADE_HERE: &str = ".loopbound";
/// What the owner alone may read and write.
const PRIVATE_FILE: Mode = Mode::from_raw_mode(0o600);
/// What the owner alone may enter.
const PRIVATE_FOLDER: u32 = 0o700;
/// The rights of everybody else.
const OTHERS: u32 = 0o077;

/// The folder in which this user's groups have theirs: `LOOPBOUND_RUNTIME_DIR`, or `/dev/shm/loopbound-UID`.
///
/// # Errors
/// If the variable is empty or no absolute path: what it means would depend on where a process was started.
pub fn runtime_folder() -> Result<PathBuf, GroupError> {
    match std::env::var_os(RUNTIME_VARIABLE) {
        None => Ok(PathBuf::from(format!("/dev/shm/loopbound-{}", geteuid().as_raw()))),
        // Without a slash at the end, behind which a link would be followed.
        Some(value) if Path::new(&value).is_absolute() => Ok(Path::new(&value).components().collect()),
        Some(value) => Err(GroupError::Variable(value.to_string_lossy().into_owned())),
    }
}

/// An open folder.
#[derive(Debug)]
pub(super) struct Folder {
    fd: OwnedFd,
    path: PathBuf,
}

const OPEN_FOLDER: OFlags = OFlags::RDONLY.union(OFlags::DIRECTORY).union(OFlags::NOFOLLOW).union(OFlags::CLOEXEC);

impl Folder {
    /// The runtime directory; `None` if it is not there and not to be made.
    pub(super) fn runtime(make: bool) -> Result<Option<Self>, GroupError> {
        let path = runtime_folder()?;
        let made = make && make_folder(&path).map_err(|source| GroupError::Folder { path: path.clone(), source })?;
        let fd = match rustix::fs::open(&path, OPEN_FOLDER, Mode::empty()) {
            Ok(fd) => fd,
            Err(Errno::NOENT) => return Ok(None),
            Err(errno) => return Err(refused(&path, errno)),
        };
        let found = fstat(&fd).map_err(|errno| refused(&path, errno))?;
        if found.st_uid != geteuid().as_raw() {
            return Err(GroupError::NotOurs { why: foreign_owner(found.st_uid), path });
        }
        if found.st_mode & OTHERS != 0 {
            let mode = found.st_mode & 0o7777;
            return Err(GroupError::NotOurs { why: format!("is open to other users (mode {mode:04o})"), path });
        }
        // The name of the shared-memory objects depends on it: one folder, one path.
        let path = fs::canonicalize(&path).unwrap_or(path);
        let folder = Self { fd, path };
        if made {
            folder.create_file(MADE_HERE, OFlags::EXCL).map_err(|e| folder.error(MADE_HERE, e))?;
        }
        Ok(Some(folder))
    }

    /// Whether this program has made it, and so all that is in it.
    pub(super) fn is_made_here(&self) -> bool {
        self.open_file(MADE_HERE).is_ok()
    }

    /// Removes the runtime directory if this program has made it and nothing is in it.
    pub(super) fn remove_runtime(&self) {
        if self.entries().is_ok_and(|names| names.len() == 1 && names[0].as_bytes() == MADE_HERE.as_bytes())
            && self.remove_file(OsStr::new(MADE_HERE)).is_ok()
            && fs::remove_dir(&self.path).is_err()
        {
            // Somebody has made a group in it just now: the last of that one removes it.
            let _ = self.create_file(MADE_HERE, OFlags::EXCL);
        }
    }

    /// The folder `name` in this one, of this user's; `None` if it is not there and not to be made.
    pub(super) fn folder(&self, name: &str, make: bool) -> Result<Option<Self>, GroupError> {
        let path = self.path.join(name);
        match make.then(|| mkdirat(&self.fd, name, Mode::from_raw_mode(PRIVATE_FOLDER))) {
            // The runtime directory itself has just been removed.
            Some(Err(Errno::NOENT)) => return Ok(None),
            Some(Err(errno)) if errno != Errno::EXIST => return Err(self.error(name, errno.into())),
            _ => {}
        }
        let fd = match openat(&self.fd, name, OPEN_FOLDER, Mode::empty()) {
            Ok(fd) => fd,
            Err(Errno::NOENT) => return Ok(None),
            Err(errno) => return Err(refused(&path, errno)),
        };
        match fstat(&fd) {
            Ok(found) if found.st_uid == geteuid().as_raw() => Ok(Some(Self { fd, path })),
            Ok(found) => Err(GroupError::NotOurs { why: foreign_owner(found.st_uid), path }),
            Err(errno) => Err(refused(&path, errno)),
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn error(&self, name: &str, source: io::Error) -> GroupError {
        GroupError::Folder { path: self.path.join(name), source }
    }

    /// What is in it.
    pub(super) fn entries(&self) -> io::Result<Vec<CString>> {
        entries(&self.fd)
    }

    /// Opens a file that is there, to read and write. Neither a link is followed, nor does a pipe make it wait.
    pub(super) fn open_file(&self, name: &str) -> io::Result<File> {
        let flags = OFlags::RDWR | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
        Ok(openat(&self.fd, name, flags, Mode::empty())?.into())
    }

    /// Makes a file that the owner alone may read and write, or opens it if `how` allows that.
    pub(super) fn create_file(&self, name: &str, how: OFlags) -> io::Result<File> {
        let flags = OFlags::RDWR | OFlags::CREATE | OFlags::NOFOLLOW | OFlags::CLOEXEC | how;
        Ok(openat(&self.fd, name, flags, PRIVATE_FILE)?.into())
    }

    /// Exchanges the file `old`, whether it is there or not, for `new`.
    pub(super) fn rename(&self, new: &str, old: &str) -> io::Result<()> {
        Ok(renameat(&self.fd, new, &self.fd, old)?)
    }

    /// Removes anything but a folder; of a link the link.
    pub(super) fn remove_file(&self, name: &OsStr) -> io::Result<()> {
        Ok(unlinkat(&self.fd, name, AtFlags::empty())?)
    }

    /// Removes an empty folder.
    pub(super) fn remove_folder(&self, name: &str) -> io::Result<()> {
        Ok(unlinkat(&self.fd, name, AtFlags::REMOVEDIR)?)
    }
}

/// Names in the folder behind `fd`.
pub(super) fn entries(fd: &OwnedFd) -> io::Result<Vec<CString>> {
    let mut names = Vec::new();
    for entry in Dir::read_from(fd)? {
        let entry = entry?;
        if !matches!(entry.file_name().to_bytes(), b"." | b"..") {
            names.push(entry.file_name().to_owned());
        }
    }
    Ok(names)
}

/// Makes the folder and those above it; whether it was not there.
fn make_folder(path: &Path) -> io::Result<bool> {
    let mut builder = DirBuilder::new();
    builder.mode(PRIVATE_FOLDER);
    let made = match builder.create(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            builder.recursive(true).create(path.parent().unwrap_or(path))?;
            builder.recursive(false).create(path)
        }
        made => made,
    };
    match made {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
        Err(error) => Err(error),
    }
}

fn foreign_owner(owner: u32) -> String {
    format!("belongs to user {owner}, and you are user {}", geteuid().as_raw())
}

/// Why a folder could not be opened.
fn refused(path: &Path, errno: Errno) -> GroupError {
    let why = match fs::symlink_metadata(path) {
        Ok(found) if found.is_symlink() => "is a symbolic link, which is not followed".to_owned(),
        Ok(found) if !found.is_dir() => "is not a folder".to_owned(),
        Ok(found) if found.uid() != geteuid().as_raw() => foreign_owner(found.uid()),
        _ => return GroupError::Folder { path: path.to_owned(), source: errno.into() },
    };
    GroupError::NotOurs { path: path.to_owned(), why }
}

/// The kind and the owner of an entry, without following a link.
pub(super) fn kind_and_owner(fd: &OwnedFd, name: &std::ffi::CStr) -> Option<(FileType, u32)> {
    let found = rustix::fs::statat(fd, name, AtFlags::SYMLINK_NOFOLLOW).ok()?;
    Some((FileType::from_raw_mode(found.st_mode), found.st_uid))
}
