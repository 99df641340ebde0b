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

/// Files that a group of one controller has there: 126 seen.
const GROUP_FILES: u64 = 140;
/// Files of each further controller or monitor: 20 to 26 seen.
const MEMBER_FILES: u64 = 26;
/// What has to be free for whoever joins a running group: what it takes, and what its last port wants to find.
pub const NEWCOMER: Need = Need { bytes: 1 << 20, files: MEMBER_FILES };

/// How much of the shared memory somebody needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Need {
    /// Bytes.
    pub bytes: u64,
    /// Files: a filesystem in memory has places for so many.
    pub files: u64,
}

/// There is not enough shared memory.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum NoRoom {
    /// Bytes are lacking.
    #[error(
        "{SHARED_MEMORY} has no room: {:.1} MB are needed and {:.1} MB of {:.1} MB are free; make it larger (a container: \
         --shm-size=64m; else: mount -o remount,size=64m {SHARED_MEMORY}), or remove what other programs keep there",
        megabytes(*.needed), megabytes(*.free), megabytes(*.size)
    )]
    Bytes {
        /// Bytes that are needed.
        needed: u64,
        /// Bytes that are free.
        free: u64,
        /// Bytes that there are in all.
        size: u64,
    },
    /// Places for files are lacking.
    #[error(
        "{SHARED_MEMORY} has no room: {needed} files are needed and there are places for {free} of {size}; allow more \
         (mount -o remount,nr_inodes=10k {SHARED_MEMORY}), or remove what other programs keep there"
    )]
    Files {
        /// Files that are needed.
        needed: u64,
        /// Places that are free.
        free: u64,
        /// Places that there are in all.
        size: u64,
    },
}

fn megabytes(bytes: u64) -> f64 {
    bytes as f64 * 1e-6
}

/// What a group takes.
#[must_use]
pub fn needed(controllers: u64, further_monitors: u64) -> Need {
    let further = controllers.saturating_sub(1) + further_monitors;
    Need { bytes: GROUP_BYTES + MEMBER_BYTES * further, files: GROUP_FILES + MEMBER_FILES * further }
}

/// Whether so much of the shared memory is free.
///
/// # Errors
/// If it is not.
pub fn require(need: Need) -> Result<(), NoRoom> {
    // What can't be asked is found out by whoever makes something there.
    let Ok(found) = statvfs(SHARED_MEMORY) else { return Ok(()) };
    let (free, size) = (found.f_bavail.saturating_mul(found.f_frsize), found.f_blocks.saturating_mul(found.f_frsize));
    // A size of nothing is no limit.
    if size != 0 && free < need.bytes {
        return Err(NoRoom::Bytes { needed: need.bytes, free, size });
    }
    let (free, size) = (found.f_favail, found.f_files);
    if size != 0 && free < need.files {
        return Err(NoRoom::Files { needed: need.files, free, size });
    }
    Ok(())
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
        needed => {
            let found = require(Need { bytes: needed, files: 0 });
            Err(found.err().unwrap_or(NoRoom::Bytes { needed, free: 0, size: 0 }))
        }
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
        assert_eq!(require(Need { bytes: 0, files: 0 }), Ok(()));
        let of_files = require(Need { bytes: 0, files: u64::MAX });
        assert!(matches!(of_files, Ok(()) | Err(NoRoom::Files { .. })), "{of_files:?}");
        let error = require(Need { bytes: u64::MAX, files: 0 }).unwrap_err();
        assert!(matches!(error, NoRoom::Bytes { free, size, .. } if free <= size), "{error:?}");
        let words = NoRoom::Bytes { needed: needed(1, 0).bytes, free: 8_000_000, size: 8_388_608 }.to_string();
        for part in ["26.2 MB", "8.0 MB of 8.4 MB", "--shm-size", "/dev/shm"] {
            assert!(words.contains(part), "{part}: {words}");
        }
    }
}
