//! The sections of a scenario about how the group runs: the loop, real time, the supervisor, swaps and faults.
//!
//! Keys without a value of their own are `None` here and get their derived value from an accessor, so that the
//! defaults follow a changed rate or duration.

use super::key::{ABOVE_ZERO, AT_LEAST_ONE, FINITE, Limit, POSITIVE, POSITIVE_OR_INF, key, section};
use super::names::{Distribution, FaultKind, Mode, Restart, Role, Wakeup};
use super::units::{Hertz, Nanos};
use super::values::{Cores, SignedNanos, Target, When};
use super::{PARETO_SHAPE_DEFAULT, ROLLBACK_WINDOW_MAX};
use loopbound_model::law::LawKind;
use std::path::PathBuf;

/// The slowest and the fastest loop. Above, the period is too short for an exchange between two processes.
const RATE: Limit = Limit::range(1.0, 50_000.0, "1Hz to 50kHz (a period of at least 20us)").brief("1 Hz to 50 kHz");
/// Up to the highest priority that leaves the kernel's own threads above the loop.
const PRIORITY: Limit = Limit::range(0.0, 98.0, "1 to 98, or 0 for the ordinary scheduler");
const WINDOW: Limit = Limit::range(1.0, ROLLBACK_WINDOW_MAX as f64, "1 to 1024 ticks");
const PROBABILITY: Limit = Limit::range(0.0, 1.0, "0 to 1");

section! {
    /// The time grid, and what counts as late.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct LoopSection {
        /// Ticks per second. The period h is the nearest whole nanosecond.
        rate: Hertz = Hertz(1000.0) => key().within(RATE);
        /// Length of the run, at least one period.
        duration: Nanos = Nanos::from_s(10) => key();
        /// The time that the loop runs on. `realtime` is the clock of the machine; `lockstep` is virtual time, as fast as it goes, and
        /// bit-identical between runs.
        mode: Mode = Mode::Realtime => key();
        /// How the loop waits. `hybrid` spins around the expected instant, then waits at the doorbell; `block` waits at the doorbell;
        /// `spin` spins all the time; `event` waits for the transport's own events.
        wakeup: Wakeup = Wakeup::Hybrid => key();
        /// How long the plant waits for the active controller after it has published a state. At most h, less the lead.
        grace: Option<Nanos> = None, resolved |s, _| Some(Nanos(s.loop_.grace_ns()))
            => key().otherwise("half the period");
        /// How long before a deadline the plant is awake; less than h.
        lead: Option<Nanos> = None, resolved |s, _| Some(Nanos(s.loop_.lead_ns()))
            => key().otherwise("the smaller of 250 µs and h/4");
        /// Offset of the deadlines from the kernel's own tick; less than h.
        phase: Option<Nanos> = None, resolved |s, _| Some(Nanos(s.loop_.phase_ns()))
            => key().otherwise("the smaller of 100 µs and h/2");
        /// A tick counts as late if its deadline → torque is longer.
        late: Option<Nanos> = None, resolved |s, _| Some(Nanos(s.loop_.late_ns()))
            => key().within(ABOVE_ZERO).otherwise("the grace");
        /// Tracking errors count from this time on; at most the duration.
        settle: Option<Nanos> = None, resolved |s, _| Some(Nanos(s.loop_.settle_ns()))
            => key().otherwise("half the duration");
        /// Latencies count from this long after the first accepted torque.
        start_up: Nanos = Nanos::from_ms(100) => key();
        /// Longest step of the integrator, at least a thousandth of the period.
        max_step: Nanos = Nanos::from_ms(1) => key();
    }
}

impl LoopSection {
    /// The period h (ns): the nearest whole nanosecond to 1/rate, at least 1.
    #[must_use]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the cast saturates, and validate() keeps the rate within 1 Hz and 50 kHz"
    )]
    pub fn period_ns(&self) -> u64 {
        ((1e9 / self.rate.0).round() as u64).max(1)
    }

    /// The rate (Hz) that the whole-nanosecond period really gives.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        1e9 / self.period_ns() as f64
    }

    /// Number of ticks within the duration.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.duration.ns() / self.period_ns()
    }

    /// The grace (ns), default h/2.
    #[must_use]
    pub fn grace_ns(&self) -> u64 {
        self.grace.map_or(self.period_ns() / 2, Nanos::ns)
    }

    /// The lead (ns), default min(250 µs, h/4).
    #[must_use]
    pub fn lead_ns(&self) -> u64 {
        self.lead.map_or((self.period_ns() / 4).min(250_000), Nanos::ns)
    }

    /// The phase (ns), default min(100 µs, h/2).
    #[must_use]
    pub fn phase_ns(&self) -> u64 {
        self.phase.map_or((self.period_ns() / 2).min(100_000), Nanos::ns)
    }

    /// The limit of deadline → torque (ns), default the grace.
    #[must_use]
    pub fn late_ns(&self) -> u64 {
        self.late.map_or(self.grace_ns(), Nanos::ns)
    }

    /// Start of the tracking statistics (ns), default half the duration.
    #[must_use]
    pub fn settle_ns(&self) -> u64 {
        self.settle.map_or(self.duration.ns() / 2, Nanos::ns)
    }
}

section! {
    /// Real-time privileges. If the kernel refuses one, the report says so and the run goes on.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct RealtimeSection {
        /// SCHED_FIFO priority of the plant.
        priority: u32 = 80 => key().within(PRIORITY);
        /// Cores for the real-time processes. In a list such as `[2, 3]` the first is for the plant, the second for the controllers.
        cores: Cores = Cores::Auto => key();
        /// Whether memory is locked, so that the kernel may not take pages from the loop.
        lock_memory: bool = true => key();
        /// Whether deep idle states are forbidden while the group runs.
        dma_latency: bool = true => key();
    }
}

section! {
    /// What happens when a process dies: `restart`, `ignore` or `end` (the run).
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct SupervisorSection {
        /// When a controller dies. It comes back as a standby.
        controller: Restart = Restart::Restart => key();
        /// When the reference dies.
        reference: Restart = Restart::Restart => key();
        /// When the monitor dies.
        monitor: Restart = Restart::Restart => key();
        /// When the plant dies: only `end`, since its state dies with it.
        plant: Restart = Restart::End => key();
        /// Wait before the first restart, doubled each time.
        back_off: Nanos = Nanos::from_ms(100) => key().within(ABOVE_ZERO);
        /// Longest wait before a restart, at least `back_off`.
        back_off_max: Nanos = Nanos::from_s(2) => key();
        /// Restarts of one process before the supervisor gives it up.
        restarts_max: u32 = 10 => key();
    }
}

impl SupervisorSection {
    /// The policy for `role`.
    #[must_use]
    pub fn policy(&self, role: Role) -> Restart {
        match role {
            Role::Reference => self.reference,
            Role::Controller => self.controller,
            Role::Plant => self.plant,
            Role::Monitor => self.monitor,
        }
    }
}

section! {
    /// What a new controller must show before it becomes active, and what rolls the swap back.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct SwapGateSection {
        /// On-time, finite torques within the limits, in a row.
        consecutive: u32 = 20 => key().within(AT_LEAST_ONE);
        /// Largest torque step of one joint at the switch without a cross-fade.
        torque_step_nm: f64 = 5.0 => key().unit("N·m").within(POSITIVE_OR_INF);
        /// Shortest time since the last swap.
        dwell: Nanos = Nanos::from_ms(100) => key();
        /// Cross-fade of swaps that name none. It is smooth at both ends; 0 switches without one.
        blend: Nanos = Nanos(0) => key();
        /// A swap that the gate has not passed by then is refused.
        timeout: Nanos = Nanos::from_s(2) => key().within(ABOVE_ZERO);
        /// This many missed ticks within `rollback_window` roll the swap back.
        rollback_misses: u32 = 3 => key().within(AT_LEAST_ONE);
        /// Ticks within which missed ticks are counted.
        rollback_window: u32 = 100 => key().within(WINDOW);
        /// How long after the switch the plant watches.
        rollback_for: Nanos = Nanos::from_ms(500) => key();
        /// How long the replaced controller stays as a standby. In lockstep it stays to the end.
        retire_after: Nanos = Nanos::from_s(1) => key();
    }
}

section! {
    /// How the group is watched.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct MonitorSection {
        /// How long a monitor that found nothing new waits before it looks again. At most 1000 periods, and at most 1 s.
        poll: Nanos = Nanos::from_ms(2) => key().within(ABOVE_ZERO);
        /// A tick is judged at most this long after its record; at least `poll`.
        finalise: Nanos = Nanos::from_ms(50) => key();
        /// How much is recorded on either side of a swap or failover, at most 65536 periods.
        trace: Nanos = Nanos::from_ms(100) => key();
    }
}

section! {
    /// A scheduled swap of the active controller: exactly one of `law`, `exe`, `to` names the new one.
    #[serde(deny_unknown_fields, expecting = "a table")]
    pub struct SwapSpec {
        /// When.
        at: When => key().needed().example("\"2s\"");
        /// To a new process with this law.
        #[serde(default, deserialize_with = "super::names::optional_law")]
        law: Option<LawKind> => key().otherwise("none").example("\"robust-ff\"");
        /// To a new process of this executable.
        exe: Option<PathBuf> => key().otherwise("none").example("\"path\"");
        /// To the standby with this number.
        to: Option<u32> => key().otherwise("none").example("2");
        /// Cross-fade.
        blend: Option<Nanos>, resolved |s, own| Some(own.blend.unwrap_or(s.swap_gate.blend))
            => key().otherwise("that of `[swap_gate]`").example("\"20ms\"");
        /// Skips the gate, not the safety checks.
        #[serde(default)]
        force: bool => key().otherwise("`false`").example("false");
    }
}

section! {
    /// An injected fault: it acts in the ticks of its window that pass `every` and `probability`.
    ///
    /// The window starts at `at` (default tick 0) and lasts for `for`; without `for` it is the one tick `at` when `at` stands alone,
    /// else it lasts to the end.
    #[serde(deny_unknown_fields, expecting = "a table")]
    pub struct FaultSpec {
        /// What happens.
        kind: FaultKind => key().needed().example("\"delay\"");
        /// The process that it is injected into, such as `"controller:1"`, or a whole role.
        target: Option<Target>, resolved |_, own| Some(own.target())
            => key().otherwise("every controller; the reference for stale-setpoint").example("\"controller:1\"");
        /// First tick of the window.
        at: Option<When> => key().otherwise("the first tick").example("\"2s\"");
        /// Length of the window; with hang, how long it hangs.
        #[serde(rename = "for")]
        for_: Option<When> => key().within(ABOVE_ZERO).otherwise("the tick `at` alone, else to the end").example("\"500ms\"");
        /// Only every so many ticks, or in this interval, counted from `at`.
        every: Option<When> => key().within(ABOVE_ZERO).otherwise("every tick").example("10");
        /// Chance of each tick.
        probability: Option<f64> => key().within(PROBABILITY).otherwise("`1`").example("0.01");
        /// The delay. With distribution `constant` it is this, with `uniform` at least this, and with `pareto` this is the scale. For `late` it
        /// is the delay beyond the grace, by default h/10.
        delay: Option<Nanos> => key().needed_by(&["delay"]).of(&["late"]).example("\"200us\"");
        /// The largest delay, above `delay`.
        delay_max: Option<Nanos> => key().of(&["delay"]).otherwise("needed by uniform, pareto").example("\"5ms\"");
        /// How delays are spread.
        distribution: Option<Distribution>, resolved |_, own| Some(own.distribution())
            => key().of(&["delay"]).otherwise("`\"constant\"`").example("\"pareto\"");
        /// Exponent of `pareto`: the smaller, the heavier the tail.
        shape: Option<f64>, resolved |_, own| own.shape()
            => key().of(&["delay"]).within(POSITIVE).otherwise("`1.5`").example("1.5");
        /// Torque added by a glitch, or of a rogue.
        value_nm: Option<f64> => key().unit("N·m").needed_by(&["glitch"]).of(&["rogue"]).within(FINITE)
            .otherwise("`100` of rogue").example("20");
        /// The link, counted from 1.
        joint: Option<usize>, resolved |_, own| Some(own.joint.unwrap_or(1))
            => key().of(&["glitch"]).otherwise("`1`").example("1");
        /// The jump of the stamps.
        step: Option<SignedNanos> => key().needed_by(&["clock-step"]).example("\"-5ms\"");
        /// Seed of its random numbers.
        seed: Option<u64>, resolved |_, own| Some(own.seed.unwrap_or(1)) => key().otherwise("`1`").example("1");
    }
}

impl FaultSpec {
    /// The process or the role that it is injected into: as written, else the reference for a stale setpoint and every controller for
    /// all the others.
    #[must_use]
    pub fn target(&self) -> Target {
        let role = if self.kind == FaultKind::StaleSetpoint { Role::Reference } else { Role::Controller };
        self.target.unwrap_or(Target { role, id: None })
    }

    /// How its delays are spread.
    #[must_use]
    pub fn distribution(&self) -> Distribution {
        self.distribution.unwrap_or(Distribution::Constant)
    }

    /// The exponent of its delays, where their distribution has one.
    fn shape(&self) -> Option<f64> {
        self.shape.or((self.distribution() == Distribution::Pareto).then_some(PARETO_SHAPE_DEFAULT))
    }
}
