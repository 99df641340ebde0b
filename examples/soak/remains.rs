//! What there is of a group, seen from outside: its processes by their command lines, its folder, its objects in memory.

use std::fs;
use std::path::{Path, PathBuf};

use loopbound_shared::clock::{now_ns, sleep_ns};
use loopbound_shared::group::object_prefix;
use loopbound_shared::realtime::{ProcessHandle, Signal};

pub(crate) const LAUNCHER: &str = "launcher";
pub(crate) const KEEPER: &str = "keeper";
/// A child of the launcher that is still a copy of it.
pub(crate) const NEWBORN: &str = "newborn";
/// What a wrapper script has started.
const GRANDCHILD: &str = "grandchild";
const ROLES: [&str; 5] = [KEEPER, "plant", "controller", "reference", "monitor"];
const LOOK_NS: u64 = 5_000_000;

/// Where a group is, and what its processes are known by.
#[derive(Debug)]
pub(crate) struct Place {
    pub(crate) group: String,
    /// A runtime folder that no other group is in.
    pub(crate) folder: PathBuf,
    /// How long the grandchildren sleep, s: nobody else sleeps so long.
    pub(crate) word: String,
}

/// A process of a group.
#[derive(Debug)]
pub(crate) struct Seen {
    pub(crate) role: String,
    pub(crate) process: ProcessHandle,
    pid: u32,
}

impl Place {
    /// The processes that live; `launcher` is the launcher's number.
    pub(crate) fn members(&self, launcher: u32) -> Vec<Seen> {
        let pids = names(Path::new("/proc")).into_iter().filter_map(|name| name.parse().ok());
        pids.filter_map(|pid| self.look_at(pid, launcher)).collect()
    }

    fn look_at(&self, pid: u32, launcher: u32) -> Option<Seen> {
        self.role_of(pid, launcher)?;
        // First the handle, then the look: what is seen is what is held.
        let process = ProcessHandle::open(pid).ok()?;
        Some(Seen { role: self.role_of(pid, launcher)?, process, pid })
    }

    fn role_of(&self, pid: u32, launcher: u32) -> Option<String> {
        let line = fs::read(format!("/proc/{pid}/cmdline")).ok()?;
        let line = String::from_utf8_lossy(&line);
        let words: Vec<&str> = line.split('\0').collect();
        if words.starts_with(&["sleep", &self.word]) {
            return Some(GRANDCHILD.to_owned());
        }
        if !words.windows(2).any(|two| two == ["--group", &self.group]) {
            return None;
        }
        let role = words.iter().take(3).find_map(|word| ROLES.iter().find(|role| *role == word));
        let other = if pid == launcher { LAUNCHER } else { NEWBORN };
        Some(role.map_or(other, |role| role).to_owned())
    }

    /// What is left: processes, the group's folder with its sockets and locks, its objects in shared memory. The last to
    /// go have `patience_ns`.
    pub(crate) fn left_after(&self, patience_ns: u64) -> Vec<String> {
        let until_ns = now_ns() + patience_ns;
        loop {
            let left = self.left();
            if left.is_empty() || now_ns() >= until_ns {
                return left;
            }
            sleep_ns(LOOK_NS);
        }
    }

    fn left(&self) -> Vec<String> {
        let processes = self.members(0).into_iter().map(|one| format!("{} {}", one.role, one.pid));
        let prefix = object_prefix(&self.folder.join(&self.group));
        let objects = names(Path::new("/dev/shm")).into_iter().filter(|name| name.starts_with(&prefix));
        let mut left: Vec<String> = processes.chain(objects).collect();
        if self.folder.exists() {
            left.push(format!("{}: {:?}", self.folder.display(), names(&self.folder)));
            left.extend(names(&self.folder.join(&self.group)));
        }
        left
    }

    /// Ends what the documents say may go on: what was stopped, and what a wrapper has started.
    pub(crate) fn end_the_rest(&self) {
        for one in self.members(0) {
            let signal = if one.role == GRANDCHILD { Signal::KILL } else { Signal::CONT };
            // It may have ended by itself meanwhile.
            let _ = one.process.signal(signal);
        }
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().into_string().ok()).collect()
}
