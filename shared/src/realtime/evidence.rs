//! What the scheduler and the memory manager did to a thread: the evidence by which a late tick finds its cause.

use iceoryx2::prelude::ZeroCopySend;
use serde::Serialize;

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
