//! The system calls that rustix doesn't wrap safely, each behind a safe function; the only `unsafe` of this folder.

#![expect(unsafe_code, reason = "system calls on raw memory; each with its proof")]

use std::mem::MaybeUninit;

use rustix::io::Errno;

/// Switches and faults of a thread since its start.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Usage {
    pub(super) voluntary_switches: u64,
    pub(super) involuntary_switches: u64,
    pub(super) minor_faults: u64,
    pub(super) major_faults: u64,
}

/// Gives thread `id` (0: the calling one) the policy `SCHED_FIFO` with `priority`, or `SCHED_OTHER` for priority 0.
pub(super) fn set_scheduler(id: u32, priority: u32) -> Result<(), Errno> {
    let thread = libc::pid_t::try_from(id).map_err(|_| Errno::SRCH)?;
    let policy = if priority == 0 { libc::SCHED_OTHER } else { libc::SCHED_FIFO };
    let priority = libc::c_int::try_from(priority).map_err(|_| Errno::INVAL)?;
    // The system call and not the function of the C library: musl's refuses with ENOSYS.
    // SAFETY: sched_setscheduler reads one `struct sched_param` from the pointer and keeps nothing. The kernel's
    // structure is a single int, which `priority` is, and it lives until the call has returned.
    let result = unsafe { libc::syscall(libc::SYS_sched_setscheduler, thread, policy, &raw const priority) };
    if result == 0 { Ok(()) } else { Err(last_error()) }
}

/// The priority under `SCHED_FIFO` of thread `id` (0: the calling one); 0 for any other policy.
pub(super) fn fifo_priority(id: u32) -> Result<u32, Errno> {
    let thread = libc::pid_t::try_from(id).map_err(|_| Errno::SRCH)?;
    let mut priority: libc::c_int = 0;
    // SAFETY: sched_getscheduler takes no pointer.
    let policy = unsafe { libc::syscall(libc::SYS_sched_getscheduler, thread) };
    // SAFETY: sched_getparam writes one `struct sched_param`, in the kernel a single int, to the pointer, which is
    // valid for writes of an int and outlives the call.
    let result = unsafe { libc::syscall(libc::SYS_sched_getparam, thread, &raw mut priority) };
    if policy < 0 || result != 0 {
        return Err(last_error());
    }
    // SCHED_RESET_ON_FORK may be set beside the policy.
    let is_fifo = policy & !libc::c_long::from(libc::SCHED_RESET_ON_FORK) == libc::c_long::from(libc::SCHED_FIFO);
    Ok(if is_fifo { priority.unsigned_abs() } else { 0 })
}

/// Switches and faults of the calling thread.
pub(super) fn thread_usage() -> Result<Usage, Errno> {
    let mut usage = MaybeUninit::<libc::rusage>::zeroed();
    // SAFETY: getrusage writes at most one `struct rusage` to the pointer, which is valid for that.
    let result = unsafe { libc::getrusage(libc::RUSAGE_THREAD, usage.as_mut_ptr()) };
    if result != 0 {
        return Err(last_error());
    }
    // SAFETY: rusage holds integers only, for which zeroed memory is a valid value; the call has filled it besides.
    let usage = unsafe { usage.assume_init() };
    Ok(Usage {
        voluntary_switches: usage.ru_nvcsw.unsigned_abs(),
        involuntary_switches: usage.ru_nivcsw.unsigned_abs(),
        minor_faults: usage.ru_minflt.unsigned_abs(),
        major_faults: usage.ru_majflt.unsigned_abs(),
    })
}

/// Maps every page of `[start, start + len)` for writing, without changing what it holds.
pub(super) fn populate(start: usize, len: usize) -> Result<(), Errno> {
    // SAFETY: MADV_POPULATE_WRITE takes the faults that writes would take, but alters no content, moves nothing and
    // unmaps nothing; where the range is not mapped or not writable it fails. So whatever another thread has done
    // with the range since it was looked up, no reference in this process can be invalidated.
    unsafe {
        rustix::mm::madvise(std::ptr::with_exposed_provenance_mut(start), len, rustix::mm::Advice::LinuxPopulateWrite)
    }
}

fn last_error() -> Errno {
    Errno::from_io_error(&std::io::Error::last_os_error()).unwrap_or(Errno::IO)
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::ptr::null_mut;

    use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

    use crate::realtime::tests::MEMORY_LOCK;
    use crate::realtime::{EvidenceReader, Outcome, Request, Step, enter};

    const LEN: usize = 64 * 4096;

    /// Maps a new file of `LEN` bytes, writes to each of its pages, and returns how many faults the writes took.
    fn faults_of_first_writes(name: &str, before_writes: impl FnOnce()) -> u64 {
        // The group's memory is of this kind too; on a disk, a write-back in between would bring the faults back.
        let folder = tempfile::tempdir_in("/dev/shm").unwrap();
        let file = File::create_new(folder.path().join(name)).unwrap();
        file.set_len(LEN as u64).unwrap();
        drop(file);
        let file = File::options().read(true).write(true).open(folder.path().join(name)).unwrap();
        // SAFETY: the address is left to the kernel, so no mapping is replaced, and the file is as long as the mapping.
        let start = unsafe { mmap(null_mut(), LEN, ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED, &file, 0) };
        let start = start.unwrap();
        before_writes();
        let mut reader = EvidenceReader::open();
        let before = reader.read();
        for offset in (0..LEN).step_by(4096) {
            // SAFETY: the offset lies within the writable mapping, which nobody else knows.
            unsafe { start.cast::<u8>().add(offset).write_volatile(1) };
        }
        let faults = reader.read().since(&before).minor_faults;
        // SAFETY: the mapping was made above, and no reference into it exists.
        unsafe { munmap(start, LEN) }.unwrap();
        faults
    }

    #[test]
    fn populated_shared_memory_takes_no_fault_at_the_first_write() {
        let _no_other_test_locks_memory = MEMORY_LOCK.lock();
        let mut entered = enter(&Request::default());
        let mut populated_bytes = 0;
        assert!(faults_of_first_writes("lb_others", || ()) > 0, "else this test shows nothing");
        let faults = faults_of_first_writes("lb_mine", || populated_bytes = entered.populate_shared(&["lb_mine"]));
        assert_eq!(entered.privileges().outcome(Step::PrefaultShared), Outcome::Had);
        assert_eq!(populated_bytes, LEN as u64);
        assert_eq!(faults, 0);
    }
}
