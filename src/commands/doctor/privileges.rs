//! Findings on what this user may do: the policy, the latency request, locked and shared memory.

use std::fs::OpenOptions;
use std::io::ErrorKind;

use loopbound_shared::realtime::{Outcome, Step};

use super::live::Live;
use super::tree::Tree;
use super::{Finding, Status, cgroup};

const MIB: u64 = 1 << 20;

pub(super) fn sched_fifo(tree: &Tree, live: &Live) -> Finding {
    let key = "sched_fifo";
    let budget = cgroup::forbids_fifo(tree, live);
    let mend = match &budget {
        Some((_, mend)) => mend,
        None if tree.is_container() => "docker run --cap-add=SYS_NICE --ulimit rtprio=99 …  # this is a container",
        None => "sudo prlimit --rtprio=99 --pid $$  # this shell; for good: /etc/security/limits.d",
    };
    match live.fifo {
        Outcome::Had if live.fifo_priority >= 80 => Finding::good(key, "granted"),
        Outcome::Had => {
            let found = format!("granted up to priority {}", live.fifo_priority);
            Finding::new(key, Status::Warn, found, "real-time threads above it can preempt the loop", mend)
        }
        refused => Finding::new(key, Status::Bad, refused.to_string(), Step::SchedFifo.cost(), mend),
    }
}

pub(super) fn dma_latency(tree: &Tree) -> Finding {
    let key = "dma_latency";
    let cost = "idle cores halt. On a 2-core KVM guest, a round trip that wakes the other core took 75 us instead of \
                6.5 us while nobody held the file open at 0";
    // Opened and closed without a write, the file keeps the kernel's default.
    match OpenOptions::new().write(true).open(tree.path("dev/cpu_dma_latency")) {
        Ok(_) => Finding::good(key, "/dev/cpu_dma_latency can be held at 0"),
        Err(error) if error.kind() == ErrorKind::NotFound => Finding::new(
            key,
            Status::Warn,
            "there is no /dev/cpu_dma_latency (in a container, it may not be passed in)",
            cost,
            "docker run --device /dev/cpu_dma_latency …  # if in a container",
        ),
        Err(error) => {
            let found = format!("/dev/cpu_dma_latency: {error}");
            Finding::new(key, Status::Bad, found, cost, "sudo chmod o+rw /dev/cpu_dma_latency  # until the next boot")
        }
    }
}

pub(super) fn memory_lock(tree: &Tree, live: &Live) -> Finding {
    let key = "memory_lock";
    match live.lockable_bytes {
        None => Finding::good(key, "without limit"),
        Some(bytes) => Finding::new(
            key,
            Status::Warn,
            format!("limited to {} KiB", bytes / 1024),
            "a process that needs more runs with pages that can be reclaimed; touching one again stalls its loop",
            if tree.is_container() {
                "docker run --ulimit memlock=-1 …  # this is a container"
            } else {
                "sudo prlimit --memlock=unlimited --pid $$  # this shell"
            },
        ),
    }
}

pub(super) fn shared_memory(tree: &Tree) -> Finding {
    let key = "shared_memory";
    let cost = "all samples of a group live in /dev/shm; where it is too small or full, nothing can start or join";
    let Ok(stat) = rustix::fs::statvfs(tree.path("dev/shm")) else {
        return Finding::new(key, Status::Bad, "no /dev/shm", cost, "sudo mount -t tmpfs -o size=1G tmpfs /dev/shm");
    };
    let (size, free) = (stat.f_blocks.saturating_mul(stat.f_frsize), stat.f_bavail.saturating_mul(stat.f_frsize));
    let found = format!("/dev/shm: {} MiB, of which {} MiB are free", size / MIB, free / MIB);
    let mend = "sudo mount -o remount,size=1G /dev/shm  # in a container: docker run --shm-size=1g";
    match free / MIB {
        0..32 => Finding::new(key, Status::Bad, found, cost, mend),
        32..128 => Finding::new(key, Status::Warn, found, cost, mend),
        _ => Finding::good(key, found),
    }
}
