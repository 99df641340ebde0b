//! How processes of a group watch each other: pidfds, priorities, and the end of a child with its parent.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::process::{
    Pid, PidfdFlags, Signal, getppid, pidfd_open, pidfd_send_signal, set_parent_process_death_signal,
};

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

use super::stat::ProcessStat;
use super::system;
use crate::clock::{NS_PER_S, now_ns};

/// Processes between the one that passed its id down and this one: a wrapper, and a wrapper around that.
const WRAPPERS_MAX: usize = 32;

/// Has the kernel send `SIGTERM` to this process when the thread that spawned it ends.
///
/// To be called first thing in a child, with the process id that the parent has passed down. The parent may have started
/// it by way of others, such as a shell script: then the signal comes with the end of the last of those, and the end of
/// the parent reaches this process by whoever ends those.
///
/// # Errors
/// `NotFound` if the parent has died already, before the kernel could be asked, or if this process was detached from it,
/// so that the parent's end would not reach it: the child should end at once.
pub fn die_with_parent(expected_parent_pid: u32) -> io::Result<()> {
    set_parent_process_death_signal(Some(Signal::TERM))?;
    // The order matters: a parent that dies after the request is signalled, one that died before shows here.
    let mut ancestor = getppid().map_or(0, |pid| pid.as_raw_nonzero().get().unsigned_abs());
    for _ in 0..WRAPPERS_MAX {
        if ancestor == expected_parent_pid {
            return Ok(());
        }
        match parent_of(ancestor) {
            Some(parent) => ancestor = parent,
            None => break,
        }
    }
    let why = if lives(expected_parent_pid) {
        "is not above this one: a program that starts it may not detach it and end (`setsid`, `&`, a daemon)"
    } else {
        "has ended"
    };
    Err(io::Error::new(io::ErrorKind::NotFound, format!("the parent process {expected_parent_pid} {why}")))
}

fn lives(pid: u32) -> bool {
    ProcessStat::of(pid).is_some_and(|stat| !stat.has_ended())
}

/// The parent of a process; none for the first one, or one that has ended.
fn parent_of(pid: u32) -> Option<u32> {
    ProcessStat::of(pid).map(|stat| stat.parent).filter(|parent| *parent != 0)
}

/// Lets this process run on all its cores but `cores`, if there are others.
pub fn keep_off_cores(cores: &[usize]) {
    let Ok(mut allowed) = sched_getaffinity(None) else { return };
    cores.iter().filter(|core| **core < CpuSet::MAX_CPU).for_each(|core| allowed.unset(*core));
    if allowed.count() > 0 {
        // A refusal costs nothing that matters.
        let _ = sched_setaffinity(None, &allowed);
    }
}

/// Sets the `SCHED_FIFO` priority of a process's main thread (its other threads keep theirs); 0 is `SCHED_OTHER`.
///
/// # Errors
/// The kernel's: `PermissionDenied` without the privilege, no such process, a priority above 99.
pub fn set_priority(pid: u32, priority: u32) -> io::Result<()> {
    if pid == 0 {
        // To the kernel it would mean the caller itself.
        return Err(Errno::SRCH.into());
    }
    Ok(system::set_scheduler(pid, priority)?)
}

/// The `SCHED_FIFO` priority of a process's main thread, 0 under any other policy.
///
/// # Errors
/// No such process.
pub fn priority(pid: u32) -> io::Result<u32> {
    if pid == 0 {
        return Err(Errno::SRCH.into());
    }
    Ok(system::fifo_priority(pid)?)
}

/// A process by descriptor: unlike a process id, it can't come to mean another process.
#[derive(Debug)]
pub struct ProcessHandle {
    pidfd: OwnedFd,
}

impl ProcessHandle {
    /// Opens a handle of a running process, or of a child that has ended and was not yet waited for.
    ///
    /// # Errors
    /// No such process, or no descriptor left.
    pub fn open(pid: u32) -> io::Result<Self> {
        let pid = i32::try_from(pid).ok().and_then(Pid::from_raw).ok_or(Errno::SRCH)?;
        Ok(Self { pidfd: pidfd_open(pid, PidfdFlags::empty())? })
    }

    /// Whether a process has ended, also one that nobody has reaped yet.
    ///
    /// # Errors
    /// If the kernel can't tell (it has no such descriptors, or there are none left).
    pub fn has_ended(pid: u32) -> io::Result<bool> {
        match Self::open(pid) {
            Ok(process) => process.wait_end(0),
            Err(e) if e.raw_os_error() == Some(Errno::SRCH.raw_os_error()) => Ok(true),
            Err(e) => Err(e),
        }
    }

    /// Sends a signal.
    ///
    /// # Errors
    /// No such process (it has ended and was waited for), or no permission.
    pub fn signal(&self, signal: Signal) -> io::Result<()> {
        Ok(pidfd_send_signal(&self.pidfd, signal)?)
    }

    /// Waits until the process has ended, at most `timeout_ns`; tells whether it has.
    ///
    /// # Errors
    /// The kernel's, when out of memory.
    pub fn wait_end(&self, timeout_ns: u64) -> io::Result<bool> {
        Ok(wait_any_end(&[self], timeout_ns)?.is_some())
    }
}

impl AsFd for ProcessHandle {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pidfd.as_fd()
    }
}

/// Waits until one of the processes has ended, at most `timeout_ns`; the index of the first that has, if any.
///
/// A signal to the caller doesn't end the wait.
///
/// # Errors
/// The kernel's, when out of memory.
pub fn wait_any_end(processes: &[&ProcessHandle], timeout_ns: u64) -> io::Result<Option<usize>> {
    let deadline_ns = now_ns().saturating_add(timeout_ns);
    let mut polled: Vec<_> = processes.iter().map(|process| PollFd::new(&process.pidfd, PollFlags::IN)).collect();
    loop {
        let left_ns = deadline_ns.saturating_sub(now_ns());
        let timeout = Timespec {
            tv_sec: i64::try_from(left_ns / NS_PER_S).unwrap_or(i64::MAX),
            tv_nsec: i32::try_from(left_ns % NS_PER_S).unwrap_or(0).into(),
        };
        match poll(&mut polled, Some(&timeout)) {
            Ok(_) => return Ok(polled.iter().position(|process| process.revents().contains(PollFlags::IN))),
            Err(Errno::INTR) => {}
            Err(errno) => return Err(errno.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::process::{Child, Command, Stdio};

    use super::*;

    const LONG_NS: u64 = 30 * NS_PER_S;

    fn sleeper() -> Child {
        Command::new("sleep").arg("600").stdout(Stdio::null()).spawn().unwrap()
    }

    #[test]
    fn the_handle_of_a_killed_child_becomes_ready_and_that_of_a_living_one_does_not() {
        let (mut killed, mut living) = (sleeper(), sleeper());
        let handles = [ProcessHandle::open(killed.id()).unwrap(), ProcessHandle::open(living.id()).unwrap()];
        assert!(!handles[0].wait_end(1_000_000).unwrap());
        handles[0].signal(Signal::KILL).unwrap();
        assert_eq!(wait_any_end(&[&handles[1], &handles[0]], LONG_NS).unwrap(), Some(1));
        assert!(!handles[1].wait_end(0).unwrap());
        killed.wait().unwrap();
        assert!(handles[0].signal(Signal::TERM).is_err(), "after the wait the handle means nobody");
        handles[1].signal(Signal::TERM).unwrap();
        assert!(handles[1].wait_end(LONG_NS).unwrap());
        living.wait().unwrap();
    }

    #[test]
    fn no_handle_and_no_priority_for_a_process_that_does_not_exist() {
        for pid in [0, i32::MAX.unsigned_abs(), u32::MAX] {
            assert!(ProcessHandle::open(pid).is_err(), "{pid}");
            assert!(set_priority(pid, 0).is_err(), "{pid}");
            assert!(priority(pid).is_err(), "{pid}");
        }
    }

    #[test]
    fn the_priority_of_another_process_changes_or_the_refusal_says_permission_denied() {
        let mut child = sleeper();
        match set_priority(child.id(), 7) {
            Ok(()) => assert_eq!(priority(child.id()).unwrap(), 7),
            Err(error) => {
                assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
                assert_eq!(priority(child.id()).unwrap(), 0);
            }
        }
        assert!(set_priority(child.id(), 100).is_err(), "there is no priority 100");
        set_priority(child.id(), 0).unwrap();
        assert_eq!(priority(child.id()).unwrap(), 0);
        child.kill().unwrap();
        child.wait().unwrap();
    }

    /// Runs the helper below in a process of its own, which says a process id on its standard output.
    fn helper(part: &str) -> Child {
        let name = "realtime::process::tests::helper_of_the_test_of_parents";
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", name, "--ignored", "--nocapture"]).env("LOOPBOUND_TEST_PART", part);
        command.env("LOOPBOUND_TEST_PARENT", std::process::id().to_string());
        command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
    }

    /// The number behind `pid=` in what a helper says.
    fn said_pid(helper: &mut Child) -> u32 {
        let lines = BufReader::new(helper.stdout.take().unwrap()).lines();
        let pid = lines.map_while(Result::ok).find_map(|line| line.split_once("pid=")?.1.trim().parse().ok());
        pid.expect("the helper says a process id")
    }

    #[test]
    #[ignore = "a helper of the next test, which starts it in two processes"]
    fn helper_of_the_test_of_parents() {
        match std::env::var("LOOPBOUND_TEST_PART").as_deref() {
            Ok("child") => {
                let parent = std::env::var("LOOPBOUND_TEST_PARENT").unwrap().parse().unwrap();
                die_with_parent(parent).unwrap();
                crate::say::out!("pid={}", std::process::id());
            }
            Ok("parent") => crate::say::out!("pid={}", said_pid(&mut helper("child"))),
            Ok("wrapped") => {
                let parent = std::env::var("LOOPBOUND_TEST_GRANDPARENT").unwrap().parse().unwrap();
                die_with_parent(parent).unwrap();
                crate::say::out!("pid={}", std::process::id());
            }
            _ => return,
        }
        crate::clock::sleep_ns(2 * LONG_NS);
    }

    #[test]
    fn a_child_ends_when_its_parent_is_killed() {
        let mut parent = helper("parent");
        let child = ProcessHandle::open(said_pid(&mut parent)).unwrap();
        assert!(!child.wait_end(1_000_000).unwrap(), "it lives as long as its parent");
        parent.kill().unwrap();
        parent.wait().unwrap();
        assert!(child.wait_end(LONG_NS).unwrap());
    }

    #[test]
    fn a_child_behind_a_shell_script_knows_its_parent_and_ends_with_the_script() {
        let mut command = Command::new("sh");
        let name = "realtime::process::tests::helper_of_the_test_of_parents";
        let own = std::env::current_exe().unwrap();
        command.args(["-c", "\"$@\"; true", "sh"]).arg(own).args(["--exact", name, "--ignored", "--nocapture"]);
        command.env("LOOPBOUND_TEST_PART", "wrapped");
        command.env("LOOPBOUND_TEST_GRANDPARENT", std::process::id().to_string());
        let mut script = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let child = ProcessHandle::open(said_pid(&mut script)).unwrap();
        assert!(!child.wait_end(1_000_000).unwrap());
        script.kill().unwrap();
        script.wait().unwrap();
        assert!(child.wait_end(LONG_NS).unwrap());
    }

    #[test]
    fn a_child_whose_parent_is_not_the_expected_one_is_told() {
        // The request follows the calling thread, which ends with this test, and touches no other.
        std::thread::spawn(move || {
            let error = die_with_parent(std::process::id()).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::NotFound);
            set_parent_process_death_signal(None).unwrap();
        })
        .join()
        .unwrap();
    }
}
