//! A hash over every field of a record, so that two runs are compared to the last bit and a golden value can be kept.
//!
//! Every field counts but the origin, which says whose run it is and is no result: in lockstep the stamps are virtual and the evidence is not read, so nothing of the wall clock is in
//! a record. The lists of fields are checked by the compiler to be whole.

use loopbound_shared::layout::{FNV_START, fnv1a};
use loopbound_shared::realtime::Evidence;
use loopbound_shared::sample::{Counters, Happening, Receipt, Segment, TickRecord};

/// Adds a value to a hash, bit by bit.
pub(crate) trait Fold {
    /// `hash`, continued over this value.
    fn fold(&self, hash: u64) -> u64;
}

impl Fold for u32 {
    fn fold(&self, hash: u64) -> u64 {
        fnv1a(hash, &self.to_le_bytes())
    }
}

impl Fold for u64 {
    fn fold(&self, hash: u64) -> u64 {
        fnv1a(hash, &self.to_le_bytes())
    }
}

impl Fold for f64 {
    fn fold(&self, hash: u64) -> u64 {
        self.to_bits().fold(hash)
    }
}

impl<T: Fold, const K: usize> Fold for [T; K] {
    fn fold(&self, hash: u64) -> u64 {
        self.iter().fold(hash, |hash, entry| entry.fold(hash))
    }
}

macro_rules! fold {
    ($name:ident { $($field:ident),* $(,)? } $(without $left_out:ident)?) => {
        impl Fold for $name {
            fn fold(&self, hash: u64) -> u64 {
                let $name { $($field,)* $($left_out: _)? } = self;
                $(let hash = $field.fold(hash);)*
                hash
            }
        }
    };
}

fold!(Segment { from_plant_ns, answered_tick, writer, epoch, tau });
fold!(Receipt {
    arrived_ns,
    state_received_ns,
    torque_published_ns,
    setpoint_published_ns,
    setpoint_tick,
    run_delay_ns,
    involuntary_switches,
    faults,
    writer,
    epoch,
    flags,
    acceptance,
});
fold!(Happening { kind, subject, detail, value });
fold!(Evidence {
    run_delay_ns,
    timeslices,
    run_time_ns,
    voluntary_switches,
    involuntary_switches,
    minor_faults,
    major_faults,
    missing,
});
fold!(Counters {
    ticks,
    skipped,
    overruns,
    missed,
    late,
    stale,
    not_finite,
    malformed,
    unknown_writer,
    fenced,
    duplicate,
    withheld,
    saturated,
    setpoint_stale,
    faults_injected,
    held,
    damped,
    stopped,
    failovers,
    segments_dropped,
});
fold!(TickRecord {
    tick,
    deadline_ns,
    sampled_ns,
    published_ns,
    grace_deadline_ns,
    end_ns,
    start_plant_ns,
    end_plant_ns,
    setpoint_offset_ns,
    accepted_ns,
    setpoint_tick,
    skipped_before,
    spin_gap_ns,
    wake_late_ns,
    decision,
    active,
    epoch,
    flags,
    links,
    segments_used,
    receipts_used,
    happenings_used,
    q,
    v,
    q_measured,
    v_measured,
    q_d,
    v_d,
    a_d,
    disturbance,
    used_q_d,
    used_v_d,
    used_a_d,
    segments,
    receipts,
    happenings,
    evidence,
    counters,
} without origin);

/// The hash of one record.
#[must_use]
pub(crate) fn fingerprint(record: &TickRecord) -> u64 {
    record.fold(FNV_START)
}

/// The hash of a whole run.
#[must_use]
pub(crate) fn golden(fingerprints: &[u64]) -> u64 {
    fingerprints.iter().fold(FNV_START, |hash, fingerprint| fingerprint.fold(hash))
}
