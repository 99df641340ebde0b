//! The hops, each declared once: its key, its words, the sentences of the documents, and its two stamps.
//!
//! Whatever lists hops is made from this table: histograms, logs, keys of a summary and of expectations, the screen, the
//! page, the table of `docs/timing.md` and that of `docs/screen.md`.

use loopbound_shared::sample::{Receipt, TickRecord};
use serde::{Deserialize, Serialize};

use crate::summary::Quantiles;

/// The stamps of a hop, from and to, in a record and in the receipt of the accepted torque, where one was accepted.
type Stamps = fn(&TickRecord, Option<&Receipt>) -> Option<(u64, u64)>;

macro_rules! hops {
    (of a tick { $($(#[$meta:meta])* $variant:ident: $key:ident, $words:literal, ends $ends:literal, includes $includes:literal,
            reads $reads:literal, stamps $stamps:expr;)* }
    beside them { $(#[$floor_meta:meta])* $floor:ident: $floor_key:ident, $floor_words:literal, ends $floor_ends:literal,
            includes $floor_includes:literal, reads $floor_reads:literal, stamps $floor_stamps:expr; }) => {
        /// The parts of a tick that are timed.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Hop { $($(#[$meta])* $variant,)* $(#[$floor_meta])* $floor }

        impl Hop {
            /// Every hop, in the order of reports.
            pub const ALL: [Self; [$($words,)* $floor_words].len()] = [$(Self::$variant,)* Self::$floor];

            /// The key in `summary.json` and the tag in `latency.hlog`.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => stringify!($key),)* Self::$floor => stringify!($floor_key) }
            }

            /// The words on screens and pages.
            #[must_use]
            pub const fn words(self) -> &'static str {
                match self { $(Self::$variant => $words,)* Self::$floor => $floor_words }
            }

            /// For `docs/timing.md`: its two ends, and what it includes.
            #[must_use]
            pub const fn defined(self) -> [&'static str; 2] {
                match self { $(Self::$variant => [$ends, $includes],)* Self::$floor => [$floor_ends, $floor_includes] }
            }

            /// For `docs/screen.md`: how its row reads.
            #[must_use]
            pub const fn reads(self) -> &'static str {
                match self { $(Self::$variant => $reads,)* Self::$floor => $floor_reads }
            }

            /// The two stamps between which the hop lies: from, to. None where a stamp is absent.
            ///
            /// `receipt` is that of the accepted torque, where one was accepted.
            #[must_use]
            pub fn stamps(self, record: &TickRecord, receipt: Option<&Receipt>) -> Option<(u64, u64)> {
                let stamps: Stamps = match self { $(Self::$variant => $stamps,)* Self::$floor => $floor_stamps };
                stamps(record, receipt)
            }
        }

        /// One distribution a hop; `docs/timing.md` says what each includes.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(default)]
        pub struct Latency { $($(#[$meta])* pub $key: Quantiles,)* }

        impl Latency {
            /// The figures of each hop.
            #[must_use]
            pub fn of_each(quantiles: impl Fn(Hop) -> Quantiles) -> Self {
                Self { $($key: quantiles(Hop::$variant),)* }
            }

            /// The figures of one hop; none of the floor, which is no part of a tick.
            #[must_use]
            pub const fn of(&self, hop: Hop) -> Option<&Quantiles> {
                match hop { $(Hop::$variant => Some(&self.$key),)* Hop::$floor => None }
            }
        }
    };
}

hops! { of a tick {
    /// Deadline → the plant sampled.
    Wakeup: wakeup, "wake-up",
        ends "t_k → s_k",
        includes "timer, scheduler, the rest of the spin; after an overrun the lateness within the tick that was run",
        reads "deadline → the plant samples",
        stamps |record, _| Some((record.deadline_ns, record.sampled_ns));
    /// State published → the controller received it.
    StateToController: state_to_controller, "state → controller",
        ends "state published → state received",
        includes "loan, copy and send, ringing the doorbell (a system call if a process sleeps there), the controller's wake-up or its spin, copying out",
        reads "the plant publishes the state → the controller has it",
        stamps |record, receipt| Some((record.published_ns, receipt?.state_received_ns));
    /// State received → torque published.
    Compute: compute, "compute",
        ends "state received → torque published",
        includes "finding the setpoint of the tick, the law, injected faults; also reading the queue of setpoints, if that of the tick had not been read yet",
        reads "the controller has the state → it publishes the torque",
        stamps |_, receipt| receipt.map(|of| (of.state_received_ns, of.torque_published_ns));
    /// Torque published → the plant received it.
    ControllerToPlant: controller_to_plant, "controller → plant",
        ends "torque published → torque arrived",
        includes "loan, copy, send, ring, the plant's wake-up or its spin, judging torques that came before it",
        reads "torque published → the plant has it",
        stamps |_, receipt| receipt.map(|of| (of.torque_published_ns, of.arrived_ns));
    /// State published → the plant received the accepted torque.
    // A standby's torque acts from the instant at which it took over, not from its arrival.
    RoundTrip: round_trip, "round trip",
        ends "state published → torque arrived",
        includes "the three above; they add up exactly",
        reads "state published → the plant has the torque: the three rows above",
        stamps |record, receipt| receipt.map(|_| (record.published_ns, record.accepted_ns));
    /// Deadline → the plant received the accepted torque: what control feels.
    DeadlineToTorque: deadline_to_torque, "deadline → torque",
        ends "t_k → torque arrived",
        includes "wake-up lateness, integrating the plant over the tick before and measuring (s_k → published), the round trip",
        reads "deadline → the plant has the torque: the latency that the control loop feels",
        stamps |record, receipt| receipt.map(|_| (record.deadline_ns, record.accepted_ns));
    /// Setpoint published → the plant sampled the state that was answered with it. It contains the reference's lead.
    SetpointAge: setpoint_age, "setpoint age",
        ends "setpoint published → s_k",
        includes "the lead by which the reference publishes ahead. It shows that setpoints came in time, not how fast they travel",
        reads "setpoint published → the plant samples. It is large on purpose: the reference publishes ahead",
        stamps |record, receipt| {
        let published_ns = receipt?.setpoint_published_ns;
        (published_ns != 0).then_some((published_ns, record.sampled_ns))
    };
} beside them {
    /// The plant's sleep before t_k was to end → the kernel woke it: the noise floor, what the host alone does to a
    /// periodic thread of this priority on this core. It stands beside the others in the summary.
    Floor: floor, "floor: bare wake-up",
        ends "end of the plant's sleep before t_k → it ran again",
        includes "the timer, the interrupt, the scheduler: what the host alone does to a periodic thread of this priority on this core (the figure of cyclictest). Only ticks before which the plant slept",
        reads "how late the kernel wakes a periodic thread of this priority on this core: what the host alone costs",
        stamps |record, _| (record.wake_late_ns != u64::MAX).then_some((0, record.wake_late_ns));
} }
