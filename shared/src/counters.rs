//! What the plant counts: each count once, with its unit, its words and its sentence. The record, the figures of a run, the
//! screen and the documents are made from this table.

use crate::wire;

/// One of the plant's counts.
#[derive(Clone, Copy, Debug)]
pub struct Counter {
    /// Its key in files.
    pub name: &'static str,
    /// The word for one of what it counts.
    pub unit: &'static str,
    /// What became of that; may be empty.
    pub words: &'static str,
    /// What it counts, in one sentence.
    pub sentence: &'static str,
    /// Its place in the record.
    pub of: fn(&Counters) -> u64,
}

macro_rules! counters {
    ($($(#[doc = $sentence:literal])* $name:ident: $unit:literal, $words:literal;)*) => {
        wire! {
            /// Counts since the start of the plant. Cumulative, so a gap in what a reader saw loses detail, never a count.
            pub struct Counters { $($(#[doc = $sentence])* pub $name: u64,)* }
        }

        impl Counters {
            /// Every count, in the order of the record.
            pub const ALL: &'static [Counter] = &[$(Counter {
                name: stringify!($name),
                unit: $unit,
                words: $words,
                sentence: concat!($($sentence),*).trim_ascii(),
                of: |counters| counters.$name,
            },)*];
        }
    };
}

counters! {
    /// Ticks whose record was published.
    ticks: "tick", "closed";
    /// Ticks skipped in overruns; never published.
    skipped: "tick", "skipped";
    /// Overruns: wake-ups after t_{k+1}.
    overruns: "overrun", "";
    /// Missed ticks: skipped, or without an accepted torque by the grace deadline.
    missed: "tick", "missed";
    /// Torques that came after the grace deadline.
    late: "torque", "late";
    /// Torques for another tick; never applied.
    stale: "torque", "stale";
    /// Torques that were not finite; never applied.
    not_finite: "torque", "not finite";
    /// Torques of the wrong number of links, or beyond what is allowed; never applied.
    malformed: "torque", "malformed";
    /// Torques of unknown writers; never applied.
    unknown_writer: "torque", "of an unknown writer";
    /// Torques of a fenced epoch; never applied.
    fenced: "torque", "fenced";
    /// A second torque of one writer for one tick; never applied.
    duplicate: "torque", "sent twice";
    /// Withheld markers.
    withheld: "torque", "withheld";
    /// Ticks in which the torque limit acted.
    saturated: "tick", "saturated";
    /// Ticks whose setpoint was absent and extrapolated.
    setpoint_stale: "setpoint", "stale";
    /// Faults injected, by the torques' own account and the plant's.
    faults_injected: "fault", "injected";
    /// Ticks held by the last torque.
    held: "tick", "held";
    /// Ticks under the plant's own damping.
    damped: "tick", "damped";
    /// Ticks in safe stop.
    stopped: "tick", "stopped";
    /// Ticks for which a standby's torque was applied.
    failovers: "failover", "";
    /// Segments that found no room in a record.
    segments_dropped: "segment", "dropped";
}
