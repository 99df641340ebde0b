//! Removes what a dead group left: its files and its shared-memory objects. Its caller holds the group's lock and has
//! seen its mark. Nothing here follows a link, and nothing of another user is touched.

use std::ffi::CStr;
use std::os::fd::OwnedFd;
use std::os::unix::ffi::OsStrExt as _;

use rustix::fs::{AtFlags, CWD, FileType, Mode, OFlags, chmodat, openat, statat, unlinkat};
use rustix::process::geteuid;

use super::runtime::{Folder, entries, kind_and_owner};

/// Where the system keeps shared-memory objects.
pub(super) const SHARED_MEMORY: &str = "/dev/shm";
/// No folder of the transport is as deep.
const DEPTH_MAX: usize = 8;

const FOLDER: OFlags = OFlags::RDONLY.union(OFlags::DIRECTORY).union(OFlags::NOFOLLOW).union(OFlags::CLOEXEC);

/// Removes all files of a group's folder but `keep`. A group makes no folders there: one that is there is somebody's.
/// What can't be removed now is found by the next sweep.
pub(super) fn files(folder: &Folder, keep: &str) {
    for name in folder.entries().unwrap_or_default() {
        if name.as_bytes() != keep.as_bytes() {
            let _ = folder.remove_file(std::ffi::OsStr::from_bytes(name.as_bytes()));
        }
    }
}

/// Removes this user's shared-memory objects whose names start with `prefix`, and the transport's folder among them.
pub(super) fn objects(prefix: &str) {
    each_object(prefix, |memory, name, kind| match kind {
        FileType::RegularFile => drop(unlinkat(memory, name, AtFlags::empty())),
        FileType::Directory => tree(memory, name, DEPTH_MAX),
        _ => {}
    });
}

/// Takes everybody else's rights from this user's shared-memory objects whose names start with `prefix`.
pub(super) fn close_objects(prefix: &str) {
    each_object(prefix, |memory, name, kind| {
        // Of a file that has a second name somewhere nothing is changed: it would be changed there too.
        let alone = statat(memory, name, AtFlags::SYMLINK_NOFOLLOW).is_ok_and(|found| found.st_nlink == 1);
        if kind == FileType::RegularFile && alone {
            let _ = chmodat(memory, name, Mode::from_raw_mode(0o600), AtFlags::empty());
        }
    });
}

/// Calls `act` with each shared-memory object of this user whose name starts with `prefix`. Where they lie everybody may
/// make entries, and only the owner of one can exchange it.
pub(super) fn each_object(prefix: &str, act: impl Fn(&OwnedFd, &CStr, FileType)) {
    let Ok(memory) = openat(CWD, SHARED_MEMORY, OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC, Mode::empty())
    else {
        return;
    };
    for name in entries(&memory).unwrap_or_default() {
        if name.as_bytes().starts_with(prefix.as_bytes())
            && let Some((kind, owner)) = kind_and_owner(&memory, &name)
            && owner == geteuid().as_raw()
        {
            act(&memory, &name, kind);
        }
    }
}

/// Removes a folder of this user's with all that is in it.
fn tree(parent: &OwnedFd, name: &CStr, depth: usize) {
    let Ok(folder) = openat(parent, name, FOLDER, Mode::empty()) else { return };
    for entry in entries(&folder).unwrap_or_default() {
        match kind_and_owner(&folder, &entry) {
            Some((FileType::Directory, owner)) if owner == geteuid().as_raw() && depth > 0 => {
                tree(&folder, &entry, depth - 1);
            }
            Some((FileType::Directory, _)) | None => {}
            Some(_) => drop(unlinkat(&folder, &entry, AtFlags::empty())),
        }
    }
    let _ = unlinkat(parent, name, AtFlags::REMOVEDIR);
}
