//! Which processes belong to a run, by what the kernel says of them.
//!
//! A run's processes carry its identity in their environment, and what they start inherits it, in whatever session or
//! process group it is and whoever its parent has become. Who has cleared its environment is known by its process group
//! or its parent.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::fs::MetadataExt as _;

use loopbound_shared::realtime::{ProcessHandle, ProcessStat, Signal};
use rustix::process::geteuid;

use super::KeeperArgs;
use crate::supervise::processes::RUN_VARIABLE;

/// A run, as its processes show it.
pub(super) struct Run {
    /// `LOOPBOUND_RUN=…` in an environment.
    mark: Vec<u8>,
    /// `--group G` and `--parent L` in a command line.
    words: [Vec<u8>; 2],
    launcher: u32,
    launcher_lives: bool,
}

/// A process of the run, held so that no other can come to be meant.
pub(super) struct Member {
    pub(super) pid: u32,
    handle: ProcessHandle,
}

/// What is known of a process.
struct Seen {
    pid: u32,
    parent: u32,
    group: u32,
    handle: ProcessHandle,
    marked: bool,
}

impl Run {
    /// The views that a launcher has started beside its group are its own affair as long as it lives.
    pub(super) fn new(args: &KeeperArgs, launcher_lives: bool) -> Self {
        let words = |key: &str, value: &str| format!("\0{key}\0{value}\0").into_bytes();
        Self {
            mark: format!("\0{RUN_VARIABLE}={}\0", args.run).into_bytes(),
            words: [words("--group", &args.group), words("--parent", &args.parent.to_string())],
            launcher: args.parent,
            launcher_lives,
        }
    }

    /// All that live; neither the launcher, nor this process.
    pub(super) fn members(&self) -> Vec<Member> {
        let others = [self.launcher, std::process::id()];
        let numbers = fs::read_dir("/proc").into_iter().flatten().flatten();
        let pids = numbers.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
        let seen: Vec<Seen> = pids.filter(|pid| !others.contains(pid)).filter_map(|pid| self.look_at(pid)).collect();
        let mut ours: BTreeSet<u32> = seen.iter().filter(|one| one.marked).map(|one| one.pid).collect();
        let mut groups: BTreeSet<u32> = seen.iter().filter(|one| one.marked).map(|one| one.group).collect();
        loop {
            let before = ours.len();
            for one in &seen {
                if ours.contains(&one.parent) || groups.contains(&one.group) {
                    ours.insert(one.pid);
                    // A group that one of ours leads is all of ours; another may have been there before.
                    if one.pid == one.group {
                        groups.insert(one.group);
                    }
                }
            }
            if ours.len() == before {
                break;
            }
        }
        let member = |one: Seen| ours.contains(&one.pid).then_some(Member { pid: one.pid, handle: one.handle });
        seen.into_iter().filter_map(member).collect()
    }

    /// A living process of this user.
    fn look_at(&self, pid: u32) -> Option<Seen> {
        if fs::metadata(format!("/proc/{pid}")).ok()?.uid() != geteuid().as_raw() {
            // One that runs with capabilities of its own shows as root's: nobody may look into it, and its command line
            // tells all the same.
            if !self.is_named(pid) {
                return None;
            }
        }
        // First the handle, then the look: what is seen is what is held.
        let handle = ProcessHandle::open(pid).ok()?;
        let ProcessStat { parent, group, .. } = ProcessStat::of(pid).filter(|stat| !stat.has_ended())?;
        Some(Seen { pid, parent, group, handle, marked: self.is_marked(pid) })
    }

    fn is_marked(&self, pid: u32) -> bool {
        let environment = fs::read(format!("/proc/{pid}/environ")).map(between_nuls);
        let marked = environment.as_ref().is_ok_and(|bytes| contains(bytes, &self.mark));
        marked || ((environment.is_err() || !self.launcher_lives) && self.is_named(pid))
    }

    fn is_named(&self, pid: u32) -> bool {
        let line = fs::read(format!("/proc/{pid}/cmdline")).map(between_nuls).unwrap_or_default();
        self.words.iter().all(|words| contains(&line, words))
    }
}

impl Member {
    /// Sends a signal, and lets a process go on that was stopped.
    pub(super) fn tell(&self, signal: Signal) {
        // It may have ended by itself meanwhile.
        let _ = self.handle.signal(signal);
        let _ = self.handle.signal(Signal::CONT);
    }
}

/// The same with a NUL on both sides, so that the first and the last word have one too.
fn between_nuls(mut bytes: Vec<u8>) -> Vec<u8> {
    bytes.insert(0, 0);
    bytes.push(0);
    bytes
}

fn contains(bytes: &[u8], wanted: &[u8]) -> bool {
    bytes.windows(wanted.len()).any(|window| window == wanted)
}

#[cfg(test)]
mod tests {
    use std::process::{Child, Command, Stdio};

    use loopbound_shared::run_id::RunId;

    use super::*;

    fn shell(script: &str, run: RunId) -> Child {
        use std::os::unix::process::CommandExt as _;
        let mut command = Command::new("sh");
        command.args(["-c", script]).env(RUN_VARIABLE, run.to_string()).process_group(0);
        command.stdin(Stdio::null()).stdout(Stdio::null()).spawn().unwrap()
    }

    fn run_of(id: RunId) -> Run {
        Run::new(&KeeperArgs { group: "g".into(), run: id, parent: std::process::id() }, true)
    }

    #[test]
    fn whoever_was_started_for_a_run_is_found_wherever_it_went_and_nobody_else() {
        let (id, other) = (RunId::draw(), RunId::draw());
        let (run, other_run) = (run_of(id), run_of(other));
        // In a session of its own, in the background of one that has ended, and with an empty environment.
        let scripts = ["setsid sleep 1000 & wait", "(sleep 1000 &) & exit", "env -i sleep 1000; true"];
        let mut shells: Vec<Child> = scripts.iter().map(|script| shell(script, id)).collect();
        let mut stranger = shell("sleep 1000; true", other);
        let until_ns = loopbound_shared::clock::now_ns() + 20_000_000_000;
        while run.members().len() < 5 {
            assert!(loopbound_shared::clock::now_ns() < until_ns, "{} of 5 were found", run.members().len());
            loopbound_shared::clock::sleep_ns(2_000_000);
        }
        let strangers = other_run.members();
        assert!(strangers.iter().any(|member| member.pid == stranger.id()));
        assert!(!run.members().iter().any(|member| strangers.iter().any(|other| other.pid == member.pid)));
        super::super::end_all(&run, 1_000_000_000);
        super::super::end_all(&other_run, 1_000_000_000);
        assert!(run.members().is_empty() && other_run.members().is_empty());
        shells.iter_mut().chain([&mut stranger]).for_each(|shell| drop(shell.wait()));
    }

    #[test]
    fn who_ignores_sigterm_or_was_stopped_is_ended_too() {
        let id = RunId::draw();
        let run = run_of(id);
        let mut stubborn = shell("trap '' TERM; while :; do sleep 1000; done", id);
        let mut stopped = shell("kill -STOP $$; sleep 1000", id);
        let until_ns = loopbound_shared::clock::now_ns() + 20_000_000_000;
        let is_stopped = |pid: u32| ProcessStat::of(pid).is_some_and(|stat| stat.is_stopped());
        while run.members().len() < 3 || !is_stopped(stopped.id()) {
            assert!(loopbound_shared::clock::now_ns() < until_ns);
            loopbound_shared::clock::sleep_ns(2_000_000);
        }
        super::super::end_all(&run, 100_000_000);
        assert!(run.members().is_empty());
        assert!(stubborn.wait().unwrap().code().is_none() && stopped.wait().unwrap().code().is_none());
    }
}
