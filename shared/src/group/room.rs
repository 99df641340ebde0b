//! Room in shared memory: asked for before a group starts, and taken for every object as soon as it is there.
//!
//! A file in memory is as long as its maker says, but its pages are only taken when they are first touched. Where none is
//! left then, whoever touches it is killed (SIGBUS). So nothing is made where there is no room for it, and what was made
//! is filled at once.

use std::io;

use rustix::fs::{AtFlags, FallocateFlags, FileType, Mode, OFlags, fallocate, openat, statat, statvfs};
use rustix::io::Errno;
use thiserror::Error;

use super::sweep::{SHARED_MEMORY, each_object};

/// What a group of one controller takes, bytes: 24.1 MB measured, most of it the records of 2048 ticks for each of four
/// monitors; and some for its files.
const GROUP_BYTES: u64 = 25 << 20;
/// What each further controller or monitor takes, bytes: 0.2 MB measured.
const MEMBER_BYTES: u64 = 256 << 10;

/// There is not enough shared memory.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "{SHARED_MEMORY} has no room: {:.1} MB are needed and {:.1} MB of {:.1} MB are free; make it larger (a container: \
     --shm-size=64m; else: mount -o remount,size=64m {SHARED_MEMORY}), or remove what other programs keep there",
    megabytes(*.needed), megabytes(*.free), megabytes(*.size)
)]
pub struct NoRoom {
    /// Bytes that are needed.
    pub needed: u64,
    /// Bytes that are free.
    pub free: u64,
    /// Bytes that there are in all.
    pub size: u64,
}

fn megabytes(bytes: u64) -> f64 {
    bytes as f64 * 1e-6
}

/// What a group takes, bytes.
#[must_use]
pub fn needed(controllers: u64, further_monitors: u64) -> u64 {
    GROUP_BYTES + MEMBER_BYTES * (controllers.saturating_sub(1) + further_monitors)
}

/// Whether so many bytes of shared memory are free.
///
/// # Errors
/// If they are not.
pub fn require(needed: u64) -> Result<(), NoRoom> {
    // What can't be asked is found out by whoever makes something there.
    let Ok(found) = statvfs(SHARED_MEMORY) else { return Ok(()) };
    let (free, size) = (found.f_bavail * found.f_frsize, found.f_blocks * found.f_frsize);
    // A size of nothing is no limit.
    if size == 0 || free >= needed { Ok(()) } else { Err(NoRoom { needed, free, size }) }
}

/// Takes the pages of all objects whose names start with `prefix`.
///
/// # Errors
/// If there is no room for one.
pub(crate) fn take(prefix: &str) -> Result<(), NoRoom> {
    let lacking = std::cell::Cell::new(0);
    each_object(prefix, |memory, name, kind| {
        let Ok(found) = statat(memory, name, AtFlags::SYMLINK_NOFOLLOW) else { return };
        let (length, taken) =
            (u64::try_from(found.st_size).unwrap_or(0), u64::try_from(found.st_blocks).unwrap_or(0) * 512);
        if kind != FileType::RegularFile || taken >= length {
            return;
        }
        let flags = OFlags::RDWR | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        // One that is just being made or removed is its maker's affair.
        let Ok(object) = openat(memory, name, flags, Mode::empty()) else { return };
        if let Err(Errno::NOSPC | Errno::NOMEM) = fallocate(&object, FallocateFlags::empty(), 0, length) {
            lacking.set(lacking.get() + (length - taken));
        }
    });
    match lacking.get() {
        0 => Ok(()),
        needed => Err(require(needed).err().unwrap_or(NoRoom { needed, free: 0, size: 0 })),
    }
}

impl From<NoRoom> for io::Error {
    fn from(error: NoRoom) -> Self {
        Self::new(io::ErrorKind::StorageFull, error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_lacking_is_said_with_what_there_is_and_the_remedy() {
        assert_eq!(require(0), Ok(()));
        let error = require(u64::MAX).unwrap_err();
        assert!(error.free <= error.size, "{error:?}");
        let words = NoRoom { needed: needed(1, 0), free: 8_000_000, size: 8_388_608 }.to_string();
        for part in ["26.2 MB", "8.0 MB of 8.4 MB", "--shm-size", "/dev/shm"] {
            assert!(words.contains(part), "{part}: {words}");
        }
    }
}
