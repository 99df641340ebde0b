//! The start-up of a real-time process, step by step; each step may be refused without stopping the others.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::num::NonZeroU64;
use std::path::Path;

use rustix::io::Errno;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::{CapabilitySet, CpuSet, capabilities, sched_setaffinity, set_current_timer_slack};

use super::{Outcome, Privileges, Step, system};
use crate::spawn;

/// Processor time, in µs, that a real-time thread may use without once sleeping; then `SIGXCPU` ends the process, and
/// after twice that time `SIGKILL`. A loop within 90 % duty sleeps every period, so only a runaway meets it.
pub const RUNAWAY_LIMIT_US: u64 = 500_000;
/// How much stack the loops may use without a page fault.
pub const STACK_PREFAULT_BYTES: usize = 256 * 1024;
/// Pages are at least this large on every system that Linux runs on.
const PAGE_BYTES: usize = 4096;

/// What a process asks for, normally `[realtime]` of the scenario. The default asks for nothing privileged.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Request {
    /// Priority under `SCHED_FIFO`, 1..=99, or 0 for none.
    pub priority: u32,
    /// The core to stay on.
    pub core: Option<usize>,
    /// Lock all pages in memory.
    pub lock_memory: bool,
    /// Keep idle cores from halting, as long as [`Entered`] lives.
    pub dma_latency: bool,
}

/// The state of a process that has entered real time; dropping it lets idle cores halt again.
#[derive(Debug)]
#[must_use = "dropping it lets idle cores halt again"]
pub struct Entered {
    privileges: Privileges,
    /// `/dev/cpu_dma_latency`, with 0 written: the kernel honours it while the descriptor is open.
    dma_latency: Option<File>,
}

/// Enters real time on the calling thread, to be called once all ports are open and all memory is mapped.
///
/// Affinity, policy and timer slack are the thread's own; the run-away guard, the memory lock and the latency request
/// hold for the process. The stack is prefaulted and the timer slack reduced in any case, as both need no privilege.
pub fn enter(request: &Request) -> Entered {
    let mut privileges = Privileges::default();
    if let Some(core) = request.core {
        let outcome = outcome_of(bind_to_core(core));
        privileges.note(Step::Affinity, outcome);
        if outcome == Outcome::Had {
            privileges.core = u32::try_from(core).unwrap_or(super::CORE_NONE);
        }
    }
    // The kernel ignores this request of a real-time thread, whose slack is 0; it is for the loops that stay ordinary.
    privileges.note(Step::TimerSlack, outcome_of(set_current_timer_slack(NonZeroU64::new(1))));
    if request.priority > 0 {
        // The guard comes first: there is no moment at which a runaway would hold the core for good.
        privileges.note(Step::RunawayGuard, outcome_of(guard_against_runaway()));
        match become_fifo(request.priority) {
            Ok(priority) => {
                privileges.priority = priority;
                privileges.note(Step::SchedFifo, Outcome::Had);
            }
            Err(errno) => privileges.note(Step::SchedFifo, outcome_of(Err(errno))),
        }
    }
    if request.lock_memory {
        privileges.note(Step::LockMemory, outcome_of(lock_memory()));
    }
    privileges.note(Step::PrefaultStack, outcome_of(prefault_stack_within_limit()));
    let mut dma_latency = None;
    if request.dma_latency {
        match hold_dma_latency(Path::new("/dev/cpu_dma_latency")) {
            Ok(file) => {
                dma_latency = Some(file);
                privileges.note(Step::DmaLatency, Outcome::Had);
            }
            Err(errno) => privileges.note(Step::DmaLatency, outcome_of(Err(errno))),
        }
    }
    Entered { privileges, dma_latency }
}

impl Entered {
    /// What was had, what was refused.
    #[must_use]
    pub const fn privileges(&self) -> Privileges {
        self.privileges
    }

    /// Whether idle cores are kept from halting.
    #[must_use]
    pub const fn holds_dma_latency(&self) -> bool {
        self.dma_latency.is_some()
    }

    /// Maps every page of the shared mappings whose file name begins with one of `prefixes`, so that the loop's first
    /// pass over them takes no page fault. Needs no privilege. Returns how many bytes are mapped now.
    ///
    /// Called again after new mappings have come, it maps those. The refusal of one mapping doesn't stop the others.
    pub fn populate_shared(&mut self, prefixes: &[&str]) -> u64 {
        let maps = match std::fs::read_to_string("/proc/self/maps") {
            Ok(maps) => maps,
            Err(error) => {
                let errno = Errno::from_io_error(&error).unwrap_or(Errno::IO);
                self.privileges.note(Step::PrefaultShared, outcome_of(Err(errno)));
                return 0;
            }
        };
        let mut outcome = Outcome::Had;
        let mut populated_bytes = 0;
        for (start, len) in shared_mappings(&maps, prefixes) {
            match system::populate(start, len) {
                Ok(()) => populated_bytes += len as u64,
                Err(errno) => outcome = outcome_of(Err(errno)),
            }
        }
        self.privileges.note(Step::PrefaultShared, outcome);
        populated_bytes
    }
}

/// Start and length of the writable shared mappings whose file name begins with one of `prefixes`.
fn shared_mappings<'a>(maps: &'a str, prefixes: &'a [&'a str]) -> impl Iterator<Item = (usize, usize)> + 'a {
    // A line reads `7f00-7f80 rw-s 00000000 00:19 42   /dev/shm/name (deleted)`.
    maps.lines().filter_map(|line| {
        let mut words = line.split_ascii_whitespace();
        let (range, flags, path) = (words.next()?, words.next()?, words.nth(3)?);
        let name = path.rsplit('/').next()?;
        if !flags.starts_with("rw") || !flags.ends_with('s') || !prefixes.iter().any(|prefix| name.starts_with(prefix))
        {
            return None;
        }
        let (start, end) = range.split_once('-')?;
        let (start, end) = (usize::from_str_radix(start, 16).ok()?, usize::from_str_radix(end, 16).ok()?);
        Some((start, end.checked_sub(start)?))
    })
}

fn bind_to_core(core: usize) -> Result<(), Errno> {
    if core >= CpuSet::MAX_CPU {
        return Err(Errno::INVAL);
    }
    let mut cores = CpuSet::new();
    cores.set(core);
    sched_setaffinity(None, &cores)
}

/// Sets the limits of [`RUNAWAY_LIMIT_US`], never above those in force.
fn guard_against_runaway() -> Result<(), Errno> {
    let before = getrlimit(Resource::Rttime);
    let at_most = |limit: Option<u64>, us: u64| Some(limit.map_or(us, |limit| limit.min(us)));
    let after = Rlimit {
        current: at_most(before.current, RUNAWAY_LIMIT_US),
        maximum: at_most(before.maximum, 2 * RUNAWAY_LIMIT_US),
    };
    setrlimit(Resource::Rttime, after)
}

/// Asks for `priority`; where the limit of an unprivileged user is lower, asks for that. Returns what is in force.
fn become_fifo(priority: u32) -> Result<u32, Errno> {
    let refusal = match system::set_scheduler(0, priority) {
        Ok(()) => return Ok(priority),
        Err(errno) => errno,
    };
    let limit = getrlimit(Resource::Rtprio);
    if refusal != Errno::PERM || limit.maximum == Some(0) {
        return Err(refusal);
    }
    // The soft limit may be below the hard one; a failure shows in the attempt that follows.
    let _ = setrlimit(Resource::Rtprio, Rlimit { current: limit.maximum, maximum: limit.maximum });
    let allowed =
        getrlimit(Resource::Rtprio).current.map_or(priority, |limit| u32::try_from(limit).unwrap_or(priority));
    let priority = priority.min(allowed);
    if priority == 0 {
        return Err(refusal);
    }
    system::set_scheduler(0, priority).map(|()| priority)
}

/// Tries whether `SCHED_FIFO` would be granted, on a thread that ends at once, and at which priority (0 if refused).
#[must_use]
pub fn try_fifo(priority: u32) -> (Outcome, u32) {
    let attempt = spawn::thread("attempt", move || become_fifo(priority)).map(std::thread::JoinHandle::join);
    match attempt {
        Ok(Ok(Ok(granted))) => (Outcome::Had, granted),
        Ok(Ok(Err(errno))) => (outcome_of(Err(errno)), 0),
        _ => (outcome_of(Err(Errno::AGAIN)), 0),
    }
}

/// How much memory may be locked; none means without limit.
#[must_use]
pub fn lockable_bytes() -> Option<u64> {
    let may_lock_all = capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    // The soft limit is raised to the hard one when the time comes.
    if may_lock_all { None } else { getrlimit(Resource::Memlock).maximum }
}

/// Locks what is mapped; what will be mapped too, unless a limit could then refuse memory to the running process.
fn lock_memory() -> Result<(), Errno> {
    let before = getrlimit(Resource::Memlock);
    if before.current != before.maximum {
        // A failure shows in the lock itself.
        let _ = setrlimit(Resource::Memlock, Rlimit { current: before.maximum, maximum: before.maximum });
    }
    let unlimited = getrlimit(Resource::Memlock).current.is_none()
        || capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    if unlimited { mlockall(MlockAllFlags::CURRENT | MlockAllFlags::FUTURE) } else { mlockall(MlockAllFlags::CURRENT) }
}

/// Prefaults the stack if twice as much is allowed, so that this step can't itself overflow it.
fn prefault_stack_within_limit() -> Result<(), Errno> {
    match getrlimit(Resource::Stack).current {
        Some(limit) if limit < 2 * STACK_PREFAULT_BYTES as u64 => Err(Errno::NOMEM),
        _ => {
            prefault_stack();
            Ok(())
        }
    }
}

#[inline(never)]
fn prefault_stack() {
    let mut stack = [0_u8; STACK_PREFAULT_BYTES];
    for page in stack.chunks_mut(PAGE_BYTES) {
        page[0] = std::hint::black_box(1);
    }
    std::hint::black_box(&stack);
}

/// Opens the latency request and writes 0 µs; it holds until the file is closed.
fn hold_dma_latency(path: &Path) -> Result<File, Errno> {
    let hold = || -> std::io::Result<File> {
        let mut file = OpenOptions::new().write(true).open(path)?;
        file.write_all(&0_i32.to_ne_bytes())?;
        Ok(file)
    };
    hold().map_err(|error| Errno::from_io_error(&error).unwrap_or(Errno::IO))
}

fn outcome_of(result: Result<(), Errno>) -> Outcome {
    match result {
        Ok(()) => Outcome::Had,
        Err(errno) => Outcome::Refused(errno.raw_os_error().unsigned_abs()),
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use rustix::mm::munlockall;
    use rustix::thread::{Uid, current_timer_slack, sched_getaffinity, sched_getcpu, set_thread_res_uid};

    use super::*;
    use crate::realtime::tests::{MEMORY_LOCK, first_allowed_core};

    fn all(core: usize) -> Request {
        Request { priority: 10, core: Some(core), lock_memory: true, dma_latency: true }
    }

    #[test]
    fn what_is_said_to_be_in_force_is_in_force() {
        let _no_other_test_counts_faults = MEMORY_LOCK.lock();
        let core = first_allowed_core();
        thread::spawn(move || {
            let entered = enter(&all(core));
            let privileges = entered.privileges();
            assert_eq!(privileges.outcome(Step::Affinity), Outcome::Had);
            assert_eq!(privileges.core as usize, core);
            assert_eq!(sched_getaffinity(None).unwrap().count(), 1);
            assert_eq!(sched_getcpu(), core);
            let fifo = privileges.outcome(Step::SchedFifo);
            assert_eq!(system::fifo_priority(0).unwrap(), privileges.priority);
            assert_eq!(fifo == Outcome::Had, privileges.priority > 0, "{fifo}");
            if privileges.outcome(Step::RunawayGuard) == Outcome::Had {
                assert!(getrlimit(Resource::Rttime).current.unwrap() <= RUNAWAY_LIMIT_US);
            }
            assert_eq!(privileges.outcome(Step::DmaLatency) == Outcome::Had, entered.holds_dma_latency());
            let locked = privileges.outcome(Step::LockMemory) == Outcome::Had;
            let status = std::fs::read_to_string("/proc/self/status").unwrap();
            let locked_line = status.lines().find(|line| line.starts_with("VmLck:")).unwrap();
            assert_eq!(locked, !locked_line.ends_with(" 0 kB"), "{locked_line}");
            assert!(current_timer_slack().unwrap_or(1) <= 1, "a real-time thread reads 0");
            munlockall().unwrap();
        })
        .join()
        .unwrap();
    }

    #[test]
    fn a_thread_without_privileges_still_starts_and_says_what_was_refused() {
        let _no_other_test_counts_faults = MEMORY_LOCK.lock();
        let core = first_allowed_core();
        thread::spawn(move || {
            // The identity is that of this thread only. Where it can't be changed it holds no privilege already.
            let nobody = Uid::from_raw(65534);
            let _ = set_thread_res_uid(nobody, nobody, nobody);
            let allowed = getrlimit(Resource::Rtprio).maximum;
            let entered = enter(&all(core));
            let privileges = entered.privileges();
            assert_eq!(privileges.outcome(Step::Affinity), Outcome::Had, "a core needs no privilege");
            assert_eq!(privileges.outcome(Step::PrefaultStack), Outcome::Had);
            if allowed == Some(0) {
                assert_eq!(privileges.outcome(Step::SchedFifo), Outcome::Refused(libc::EPERM.unsigned_abs()));
                assert_eq!(privileges.priority, 0);
                assert!(privileges.to_string().contains("no sched_fifo"));
            }
            let node = std::fs::metadata("/dev/cpu_dma_latency");
            let writable = node.is_ok() && OpenOptions::new().write(true).open("/dev/cpu_dma_latency").is_ok();
            assert_eq!(privileges.outcome(Step::DmaLatency) == Outcome::Had, writable);
            munlockall().unwrap();
        })
        .join()
        .unwrap();
    }

    #[test]
    fn impossible_requests_are_refused_one_by_one() {
        thread::spawn(|| {
            let request = Request { priority: 1000, core: Some(usize::MAX), ..Request::default() };
            let privileges = enter(&request).privileges();
            let invalid = Outcome::Refused(libc::EINVAL.unsigned_abs());
            assert_eq!(privileges.outcome(Step::Affinity), invalid);
            assert_eq!(privileges.core, super::super::CORE_NONE);
            assert_eq!(privileges.outcome(Step::SchedFifo), invalid);
            assert_eq!(privileges.outcome(Step::LockMemory), Outcome::NotAsked);
            assert_eq!(privileges.outcome(Step::TimerSlack), Outcome::Had);
        })
        .join()
        .unwrap();
    }

    #[test]
    fn trying_a_policy_leaves_the_caller_as_it_was_and_tells_what_entering_would_get() {
        let before = system::fifo_priority(0).unwrap();
        let (outcome, granted) = try_fifo(3);
        assert_eq!(system::fifo_priority(0).unwrap(), before);
        assert_eq!(outcome == Outcome::Had, granted > 0);
        let entered = thread::spawn(|| become_fifo(3)).join().unwrap();
        assert_eq!(entered.is_ok(), outcome == Outcome::Had);
    }

    #[test]
    fn a_latency_request_that_cannot_be_opened_or_written_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let missing = hold_dma_latency(&folder.path().join("cpu_dma_latency"));
        assert_eq!(missing.unwrap_err(), Errno::NOENT);
        let present = folder.path().join("present");
        std::fs::write(&present, "").unwrap();
        drop(hold_dma_latency(&present).unwrap());
        assert_eq!(std::fs::read(&present).unwrap(), [0; 4]);
    }

    #[test]
    fn only_writable_shared_mappings_of_the_group_are_populated() {
        let maps = "\
5500-5600 r-xp 00000000 fd:00 1    /usr/bin/lb_group
7f0000-7f4000 rw-s 00000000 00:19 42    /dev/shm/lb_group.data
7f8000-7fa000 r--s 00000000 00:19 43    /dev/shm/lb_group.readonly
7fb000-7fc000 rw-s 00000000 00:19 44    /dev/shm/other_group.data
7fc000-7fd000 rw-s 00000000 00:19 44    /dev/shm/lb_group.gone (deleted)
7fd000-7fe000 rw-p 00000000 00:00 0
garbage
zz-yy rw-s 0 0 0 /dev/shm/lb_group.bad";
        let found: Vec<_> = shared_mappings(maps, &["lb_group"]).collect();
        assert_eq!(found, [(0x7f_0000, 0x4000), (0x7f_c000, 0x1000)]);
    }
}
