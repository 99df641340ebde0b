//! The sections of a scenario about how the group runs: the loop, real time, the supervisor, swaps and faults.
//!
//! Keys without a value of their own are `None` here and get their derived value from an accessor, so that the
//! defaults follow a changed rate or duration.

use super::names::{Distribution, FaultKind, Mode, Restart, Role, Wakeup};
use super::units::{Hertz, Nanos};
use super::values::{Cores, SignedNanos, Target, When};
use loopbound_model::law::LawKind;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// `[loop]`: the time grid and what counts as late.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct LoopSection {
    /// Ticks per second.
    pub rate: Hertz,
    /// Length of the run.
    pub duration: Nanos,
    /// Real or virtual time.
    pub mode: Mode,
    /// How the loop waits.
    pub wakeup: Wakeup,
    /// How long after publishing a state the plant waits for the active controller; default h/2.
    pub grace: Option<Nanos>,
    /// How long before a deadline the plant is awake; default min(250 µs, h/4).
    pub lead: Option<Nanos>,
    /// Offset of the time grid from the kernel's tick; default min(100 µs, h/2).
    pub phase: Option<Nanos>,
    /// Deadline → torque above which a tick counts as late; default the grace.
    pub late: Option<Nanos>,
    /// Tracking errors count from here on; default half the duration.
    pub settle: Option<Nanos>,
    /// Latencies count from this long after the first accepted torque.
    pub start_up: Nanos,
    /// Longest step of the integrator.
    pub max_step: Nanos,
}

impl Default for LoopSection {
    fn default() -> Self {
        Self {
            rate: Hertz(1000.0),
            duration: Nanos::from_s(10),
            mode: Mode::Realtime,
            wakeup: Wakeup::Hybrid,
            grace: None,
            lead: None,
            phase: None,
            late: None,
            settle: None,
            start_up: Nanos::from_ms(100),
            max_step: Nanos::from_ms(1),
        }
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

/// `[realtime]`: what the processes ask of the kernel; whatever is refused is reported, never fatal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct RealtimeSection {
    /// SCHED_FIFO priority of the plant, 1 to 98; 0 leaves the ordinary scheduler.
    pub priority: u32,
    /// Cores for the real-time roles.
    pub cores: Cores,
    /// Whether memory is locked.
    pub lock_memory: bool,
    /// Whether deep idle states are forbidden while the group runs.
    pub dma_latency: bool,
}

impl Default for RealtimeSection {
    fn default() -> Self {
        Self { priority: 80, cores: Cores::Auto, lock_memory: true, dma_latency: true }
    }
}

/// `[supervisor]`: what becomes of a role that dies.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct SupervisorSection {
    /// Policy for controllers.
    pub controller: Restart,
    /// Policy for the reference.
    pub reference: Restart,
    /// Policy for the monitor.
    pub monitor: Restart,
    /// Policy for the plant; its state dies with it, so it cannot be restarted.
    pub plant: Restart,
    /// Wait before the first restart; doubled each time.
    pub back_off: Nanos,
    /// Longest wait before a restart.
    pub back_off_max: Nanos,
    /// Restarts of one process before it is given up.
    pub restarts_max: u32,
}

impl Default for SupervisorSection {
    fn default() -> Self {
        Self {
            controller: Restart::Restart,
            reference: Restart::Restart,
            monitor: Restart::Restart,
            plant: Restart::End,
            back_off: Nanos::from_ms(100),
            back_off_max: Nanos::from_s(2),
            restarts_max: 10,
        }
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

/// `[swap_gate]`: what a controller must show before it is obeyed, and what takes authority from it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct SwapGateSection {
    /// On-time, finite, within-limits torques in a row.
    pub consecutive: u32,
    /// Largest torque step of one joint at the switch without a cross-fade (N·m).
    pub torque_step_nm: f64,
    /// Shortest time since the last swap.
    pub dwell: Nanos,
    /// Cross-fade of swaps that name none; zero switches hard.
    pub blend: Nanos,
    /// How long a swap waits for the gate before it is refused.
    pub timeout: Nanos,
    /// Misses among the last `rollback_window` ticks that roll a swap back (m of K).
    pub rollback_misses: u32,
    /// Ticks looked at by the deadline rule (K).
    pub rollback_window: u32,
    /// How long after a switch a rollback is possible.
    pub rollback_for: Nanos,
    /// How long the replaced controller stays as a standby.
    pub retire_after: Nanos,
}

impl Default for SwapGateSection {
    fn default() -> Self {
        Self {
            consecutive: 20,
            torque_step_nm: 5.0,
            dwell: Nanos::from_ms(100),
            blend: Nanos(0),
            timeout: Nanos::from_s(2),
            rollback_misses: 3,
            rollback_window: 100,
            rollback_for: Nanos::from_ms(500),
            retire_after: Nanos::from_s(1),
        }
    }
}

/// `[monitor]`: how the group is watched.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct MonitorSection {
    /// Interval between two looks at the topics.
    pub poll: Nanos,
    /// A tick is judged at most this long after its record.
    pub finalise: Nanos,
    /// Trace kept on either side of a swap or failover.
    pub trace: Nanos,
}

impl Default for MonitorSection {
    fn default() -> Self {
        Self { poll: Nanos::from_ms(2), finalise: Nanos::from_ms(50), trace: Nanos::from_ms(100) }
    }
}

/// `[[swap]]`: a scheduled change of the controller in charge; exactly one of `law`, `exe`, `to` names the new one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
pub struct SwapSpec {
    /// When.
    pub at: When,
    /// To a new process with this law.
    #[serde(default, deserialize_with = "super::names::optional_law")]
    pub law: Option<LawKind>,
    /// To a new process of this executable.
    #[serde(default)]
    pub exe: Option<PathBuf>,
    /// To the standby with this id.
    #[serde(default)]
    pub to: Option<u32>,
    /// Cross-fade; default that of `[swap_gate]`.
    #[serde(default)]
    pub blend: Option<Nanos>,
    /// Skips the gate, not the safety checks.
    #[serde(default)]
    pub force: bool,
}

/// `[[fault]]`: something that goes wrong on purpose.
///
/// A fault fires in the ticks of its window that pass `every` and `probability`. The window starts at `at` (default tick 0)
/// and lasts for `for`; without `for` it is the one tick `at` when `at` stands alone, else it lasts to the end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
pub struct FaultSpec {
    /// What happens.
    pub kind: FaultKind,
    /// To whom; the default depends on the kind, see `target()`.
    #[serde(default)]
    pub target: Option<Target>,
    /// First tick.
    #[serde(default)]
    pub at: Option<When>,
    /// Length of the window; of a hang, its length.
    #[serde(default, rename = "for")]
    pub for_: Option<When>,
    /// Only every so many ticks or so long, counted from `at`.
    #[serde(default)]
    pub every: Option<When>,
    /// Chance that an eligible tick is hit, 0 to 1; default 1.
    #[serde(default)]
    pub probability: Option<f64>,
    /// How late: all of it, the least, or the scale, according to `distribution`.
    #[serde(default)]
    pub delay: Option<Nanos>,
    /// The longest delay of `uniform` and `pareto`.
    #[serde(default)]
    pub delay_max: Option<Nanos>,
    /// How delays are spread; default constant.
    #[serde(default)]
    pub distribution: Option<Distribution>,
    /// Exponent of `pareto`: the smaller, the heavier the tail; default 1.5.
    #[serde(default)]
    pub shape: Option<f64>,
    /// Torque of a glitch or of a rogue (N·m).
    #[serde(default)]
    pub value_nm: Option<f64>,
    /// Link of a glitch, counted from 1; default 1.
    #[serde(default)]
    pub joint: Option<usize>,
    /// Jump of a clock step.
    #[serde(default)]
    pub step: Option<SignedNanos>,
    /// Seed of its random numbers; default 1.
    #[serde(default)]
    pub seed: Option<u64>,
}

impl FaultSpec {
    /// Whom it befalls: as written, else the reference for a stale setpoint and every controller for all the others.
    #[must_use]
    pub fn target(&self) -> Target {
        let role = if self.kind == FaultKind::StaleSetpoint { Role::Reference } else { Role::Controller };
        self.target.unwrap_or(Target { role, id: None })
    }
}
