//! What can be found out only by trying it on the running system.

use loopbound_shared::clock::{kernel_tick_ns, now_ns, spin_hint};
use loopbound_shared::realtime::{EvidenceReader, Outcome, lockable_bytes, try_fifo};

use super::wakeup::Lateness;
use super::{Finding, Status};

/// How long the search for stalls spins.
const PROBE_NS: u64 = 300_000_000;
/// A gap between two readings of the clock above this counts.
const GAP_NS: u64 = 100_000;

/// What was probed of the running system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Live {
    /// Whether `SCHED_FIFO` is granted.
    pub fifo: Outcome,
    /// The priority that was granted of the 80 asked for.
    pub fifo_priority: u32,
    /// How much memory may be locked; none: all.
    pub lockable_bytes: Option<u64>,
    /// The period of the kernel's tick.
    pub tick_ns: Option<u64>,
    /// Gaps in a short spin.
    pub stalls: Stalls,
    /// How late a periodic thread wakes.
    pub wake_up: Lateness,
    /// The same by cyclictest, where that is installed.
    pub cyclictest: Option<Lateness>,
}

/// Gaps above 100 µs that a spinning thread of ordinary priority noticed in its own time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stalls {
    /// How long it spun.
    pub spun_ns: u64,
    /// Gaps in which another thread had the core, by the scheduler's own counters.
    pub preempted: u32,
    /// Gaps without any such trace: interrupts, or the host of a virtual machine.
    pub unexplained: u32,
    /// The longest gap without a trace.
    pub unexplained_max_ns: u64,
    /// The mean cost of reading the clock once.
    pub clock_read_ns: u64,
}

impl Live {
    /// Probes the running system, for about a second.
    #[must_use]
    pub fn probe() -> Self {
        let (fifo, fifo_priority) = try_fifo(80);
        let lockable_bytes = lockable_bytes();
        Self {
            fifo,
            fifo_priority,
            lockable_bytes,
            tick_ns: kernel_tick_ns(),
            stalls: Stalls::probe(PROBE_NS),
            wake_up: Lateness::own(),
            cyclictest: Lateness::by_cyclictest(),
        }
    }

    pub(super) fn stalls_finding(&self) -> Finding {
        let Stalls { spun_ns, preempted, unexplained, unexplained_max_ns, .. } = self.stalls;
        let found = format!(
            "in a {} ms spin at ordinary priority: {unexplained} gaps above 100 us that the scheduler does not explain \
             (longest {} us), {preempted} preemptions",
            spun_ns / 1_000_000,
            unexplained_max_ns / 1000,
        );
        let key = "stalls";
        let cost = "the machine itself stops, and no priority helps against it: some ticks will be missed, whatever \
                    the program does. Such a short look finds only frequent stalls";
        let mend = "bare metal; on the guest's host, one core for each virtual core (virsh vcpupin)";
        match unexplained_max_ns {
            0 if spun_ns == 0 => Finding::unknown(key, "not probed", cost),
            0 => Finding::good(key, found),
            1..1_000_000 => Finding::new(key, Status::Warn, found, cost, mend),
            _ => Finding::new(key, Status::Bad, found, cost, mend),
        }
    }
}

impl Stalls {
    /// Spins for `duration_ns` and notes each gap, and whether the scheduler gave the core to another thread in it.
    fn probe(duration_ns: u64) -> Self {
        let mut stalls = Self::default();
        let mut reader = EvidenceReader::open();
        let mut evidence = reader.read();
        let start_ns = now_ns();
        let (mut before_ns, mut readings) = (start_ns, 0_u64);
        while before_ns - start_ns < duration_ns {
            let now = now_ns();
            readings += 1;
            let gap_ns = now - before_ns;
            before_ns = now;
            if gap_ns <= GAP_NS {
                spin_hint();
                continue;
            }
            let later = reader.read();
            if later.since(&evidence).involuntary_switches > 0 {
                stalls.preempted += 1;
            } else {
                stalls.unexplained += 1;
                stalls.unexplained_max_ns = stalls.unexplained_max_ns.max(gap_ns);
            }
            evidence = later;
            before_ns = now_ns();
        }
        stalls.spun_ns = before_ns - start_ns;
        stalls.clock_read_ns = stalls.spun_ns / readings.max(1);
        stalls
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_probe_spins_as_long_as_it_says_and_knows_the_cost_of_the_clock() {
        let stalls = Stalls::probe(5_000_000);
        assert!(stalls.spun_ns >= 5_000_000);
        assert!(stalls.clock_read_ns > 0 && stalls.clock_read_ns < 5_000_000, "{stalls:?}");
        assert_eq!(stalls.unexplained == 0, stalls.unexplained_max_ns == 0);
    }
}
