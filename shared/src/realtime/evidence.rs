//! What the scheduler and the memory manager did to a thread: the evidence by which a late tick finds its cause.

use std::fs::File;
use std::marker::PhantomData;

use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

use super::system;

/// Bit of [`Evidence::missing`]: the run-queue delay, the time slices and the run time could not be read.
pub const MISSING_SCHEDSTAT: u64 = 1;
/// Bit of [`Evidence::missing`]: the switches and the faults could not be read.
pub const MISSING_USAGE: u64 = 2;

/// Counters of one thread, cumulative since its start; zero where [`Evidence::missing`] says so.
///
/// Any bit pattern is a valid value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ZeroCopySend)]
#[repr(C)]
#[type_name("loopbound.Evidence.1")]
pub struct Evidence {
    /// Time spent runnable but not running: another thread had the core.
    pub run_delay_ns: u64,
    /// How often the thread was put on a core.
    pub timeslices: u64,
    /// Time spent on a core, as of the last scheduler tick or switch.
    pub run_time_ns: u64,
    /// Switches because the thread waited.
    pub voluntary_switches: u64,
    /// Switches because another thread took the core.
    pub involuntary_switches: u64,
    /// Page faults that needed no disk.
    pub minor_faults: u64,
    /// Page faults that waited for a disk.
    pub major_faults: u64,
    /// What could not be read: [`MISSING_SCHEDSTAT`], [`MISSING_USAGE`].
    pub missing: u64,
}

const _: () = assert!(size_of::<Evidence>() == 64 && align_of::<Evidence>() == 8);

impl Evidence {
    /// What happened between `earlier` and `self`; a counter that is missing on either side is missing, and zero.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Self {
        let missing = self.missing | earlier.missing;
        let between = |bit: u64, now: u64, before: u64| if missing & bit == 0 { now.saturating_sub(before) } else { 0 };
        Self {
            run_delay_ns: between(MISSING_SCHEDSTAT, self.run_delay_ns, earlier.run_delay_ns),
            timeslices: between(MISSING_SCHEDSTAT, self.timeslices, earlier.timeslices),
            run_time_ns: between(MISSING_SCHEDSTAT, self.run_time_ns, earlier.run_time_ns),
            voluntary_switches: between(MISSING_USAGE, self.voluntary_switches, earlier.voluntary_switches),
            involuntary_switches: between(MISSING_USAGE, self.involuntary_switches, earlier.involuntary_switches),
            minor_faults: between(MISSING_USAGE, self.minor_faults, earlier.minor_faults),
            major_faults: between(MISSING_USAGE, self.major_faults, earlier.major_faults),
            missing,
        }
    }
}

/// Reads the [`Evidence`] of the thread that opened it, without allocation.
///
/// It can't move to another thread, since the counters are those of the thread that reads.
#[derive(Debug)]
pub struct EvidenceReader {
    /// `/proc/thread-self/schedstat`, or none where it can't be opened.
    schedstat: Option<File>,
    of_this_thread: PhantomData<*const ()>,
}

impl EvidenceReader {
    /// Opens the counters of the calling thread. Without `/proc`, the counters that need it stay zero and flagged.
    #[must_use]
    pub fn open() -> Self {
        Self { schedstat: File::open("/proc/thread-self/schedstat").ok(), of_this_thread: PhantomData }
    }

    /// The counters now: two system calls, together 1.5 µs (p50; p99 2.0) on a 2-core KVM guest with kernel 6.18. The
    /// ignored test `cost_of_a_reading` measures it.
    pub fn read(&mut self) -> Evidence {
        let mut evidence = Evidence::default();
        match self.read_schedstat() {
            Some([run_time_ns, run_delay_ns, timeslices]) => {
                evidence.run_time_ns = run_time_ns;
                evidence.run_delay_ns = run_delay_ns;
                evidence.timeslices = timeslices;
            }
            None => evidence.missing |= MISSING_SCHEDSTAT,
        }
        match system::thread_usage() {
            Ok(usage) => {
                evidence.voluntary_switches = usage.voluntary_switches;
                evidence.involuntary_switches = usage.involuntary_switches;
                evidence.minor_faults = usage.minor_faults;
                evidence.major_faults = usage.major_faults;
            }
            Err(_) => evidence.missing |= MISSING_USAGE,
        }
        evidence
    }

    fn read_schedstat(&self) -> Option<[u64; 3]> {
        // Three numbers of at most 20 digits, two blanks and a line end.
        let mut buffer = [0_u8; 64];
        let length = rustix::io::pread(self.schedstat.as_ref()?, &mut buffer, 0).ok()?;
        parse_schedstat(buffer.get(..length)?)
    }
}

/// The three numbers of a schedstat file: ns on a core, ns waiting for one, time slices.
fn parse_schedstat(text: &[u8]) -> Option<[u64; 3]> {
    let mut numbers = [0; 3];
    let mut words = text.split(|byte| byte.is_ascii_whitespace()).filter(|word| !word.is_empty());
    for number in &mut numbers {
        *number = words.next()?.iter().try_fold(0_u64, |sum, byte| {
            let digit = byte.is_ascii_digit().then(|| u64::from(byte - b'0'))?;
            sum.checked_mul(10)?.checked_add(digit)
        })?;
    }
    Some(numbers)
}

#[cfg(test)]
mod tests {
    use std::hint::black_box;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::thread;

    use super::*;
    use crate::clock::now_ns;
    use crate::realtime::tests::{MEMORY_LOCK, first_allowed_core};
    use crate::realtime::{Request, enter};

    #[test]
    fn first_touches_of_pages_are_counted_as_faults() {
        let _no_other_test_locks_memory = MEMORY_LOCK.lock();
        let mut reader = EvidenceReader::open();
        let before = reader.read();
        let untouched = reader.read().since(&before);
        // Zeroed memory of this size comes straight from the kernel, page by page at the first touch.
        let mut memory = vec![0_u8; 4 << 20];
        for page in memory.chunks_mut(4096) {
            page[0] = 1;
        }
        black_box(&memory);
        let touched = reader.read().since(&before);
        assert_eq!(touched.missing & MISSING_USAGE, 0);
        assert_eq!(untouched.minor_faults, 0, "reading the counters takes no fault");
        assert!(touched.minor_faults > 0, "{touched:?}");
    }

    #[test]
    fn losing_the_core_to_another_thread_shows_as_an_involuntary_switch_and_a_run_queue_delay() {
        let core = first_allowed_core();
        let done = AtomicBool::new(false);
        let seen = thread::scope(|scope| {
            scope.spawn(|| {
                let _bound = enter(&Request { core: Some(core), ..Request::default() });
                while !done.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
            let victim = scope.spawn(|| {
                let _bound = enter(&Request { core: Some(core), ..Request::default() });
                let mut reader = EvidenceReader::open();
                let (before, give_up_ns) = (reader.read(), now_ns() + 10_000_000_000);
                loop {
                    let seen = reader.read().since(&before);
                    if (seen.involuntary_switches > 0 && seen.run_delay_ns > 0) || now_ns() > give_up_ns {
                        done.store(true, Ordering::Relaxed);
                        return seen;
                    }
                }
            });
            victim.join().unwrap()
        });
        assert!(seen.involuntary_switches > 0, "{seen:?}");
        if seen.missing & MISSING_SCHEDSTAT == 0 {
            assert!(seen.run_delay_ns > 0 && seen.timeslices > 0, "{seen:?}");
        }
    }

    #[test]
    fn without_proc_the_scheduler_counters_are_zero_and_flagged() {
        let mut blind = EvidenceReader { schedstat: None, of_this_thread: PhantomData };
        let evidence = blind.read();
        assert_eq!(evidence.missing, MISSING_SCHEDSTAT);
        assert_eq!((evidence.run_delay_ns, evidence.timeslices, evidence.run_time_ns), (0, 0, 0));
        let full = Evidence { run_delay_ns: 5, timeslices: 5, ..Evidence::default() };
        assert_eq!(full.since(&evidence).run_delay_ns, 0, "a difference with a missing reading is missing");
        assert_eq!(full.since(&evidence).missing, MISSING_SCHEDSTAT);
    }

    #[test]
    fn malformed_schedstat_text_is_missing_and_not_wrong() {
        assert_eq!(parse_schedstat(b"935946 82232 3\n"), Some([935_946, 82_232, 3]));
        for text in ["", "1 2", "1 -2 3", "1 2 x", "99999999999999999999 2 3", "1.5 2 3"] {
            assert_eq!(parse_schedstat(text.as_bytes()), None, "{text:?}");
        }
    }

    /// Prints what a reading costs: `cargo test --release -p loopbound-shared -- --ignored --nocapture cost_of`
    #[test]
    #[ignore = "a measurement, not a test"]
    fn cost_of_a_reading() {
        let mut reader = EvidenceReader::open();
        let mut costs_ns: Vec<u64> = Vec::with_capacity(100_000);
        for _ in 0..100_000 {
            let start_ns = now_ns();
            black_box(reader.read());
            costs_ns.push(now_ns() - start_ns);
        }
        costs_ns.sort_unstable();
        crate::say::out!("p50 {} ns, p99 {} ns, max {} ns", costs_ns[50_000], costs_ns[99_000], costs_ns[99_999]);
    }
}
