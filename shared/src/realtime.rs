//! What a process asks of the kernel to keep its deadlines, what it was given, and what the kernel did to it.
//!
//! Responsible for the start-up of a real-time process, for the evidence behind late ticks, and for the handles by
//! which the supervisor watches processes. Not responsible for cycles and deadlines: those belong to the loops.
//! Every step is optional, and a refusal is reported rather than fatal. Raw system calls stand in `system` alone.

mod enter;
mod evidence;
mod privileges;
mod process;
mod stat;
mod system;
mod throttle;

pub use enter::{Entered, RUNAWAY_LIMIT_US, Request, STACK_PREFAULT_BYTES, enter, lockable_bytes, try_fifo};
pub use evidence::{Evidence, EvidenceReader, MISSING_SCHEDSTAT, MISSING_USAGE};
pub use privileges::{CORE_NONE, Outcome, Privileges, STEPS, Step};
pub use process::{ProcessHandle, die_with_parent, keep_off_cores, priority, set_priority, wait_any_end};
pub use rustix::process::Signal;
pub use stat::ProcessStat;
pub use throttle::{DUTY_MAX, Throttle};

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use rustix::thread::{CpuSet, sched_getaffinity};

    /// Held by tests that lock the memory of the process and by those that count page faults in it.
    pub(super) static MEMORY_LOCK: Mutex<()> = Mutex::new(());

    pub(super) fn first_allowed_core() -> usize {
        let cores = sched_getaffinity(None).unwrap();
        (0..CpuSet::MAX_CPU).find(|&core| cores.is_set(core)).unwrap()
    }
}
