//! Injected faults, in one place for every process and both modes: what is planned, what is commanded, how each is injected
//!
//! [`plan`] says which faults of the scenario are due in a tick, [`board`] which one was injected by command, and
//! [`injector`] injects them into the process. [`FaultActions`] is what passes between them. The kinds are
//! those of `FaultKind` in `scenario`; `plan` turns a kind into actions, and `injector` carries these out.

pub mod board;
pub mod injector;
pub mod plan;

pub use injector::{Injector, ROGUE_WRITER};
pub use plan::FaultPlan;

/// What is injected into a process in one tick. The default is nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaultActions {
    /// The process ends at once, without any clean-up.
    pub kill: bool,
    /// The process does nothing for so long (ns); 0 is no hang, `u64::MAX` is for ever.
    pub hang_ns: u64,
    /// The sample is published so much later (ns); delays of several faults add up.
    pub delay_ns: u64,
    /// The sample is not published; in lockstep it is marked as withheld.
    pub drop: bool,
    /// All values of the sample are not numbers.
    pub nan: bool,
    /// A torque (N·m) is added to the link with this index, counted from 0.
    pub glitch: Option<(usize, f64)>,
    /// The sample is published twice.
    pub duplicate: bool,
    /// The sample is published after its successor.
    pub reorder: bool,
    /// The setpoint of the tick before is repeated.
    pub stale_setpoint: bool,
    /// The stamps of the role jump by so much from this tick on (ns).
    pub clock_step_ns: i64,
    /// A stranger publishes this torque (N·m) on every link.
    pub rogue_nm: Option<f64>,
}

impl FaultActions {
    /// Whether anything is injected at all.
    #[must_use]
    pub fn any(&self) -> bool {
        *self != Self::default()
    }

    /// Whether the tick gets no usable sample of this process, whatever comes later.
    #[must_use]
    pub const fn leaves_no_sample(&self) -> bool {
        self.kill || self.hang_ns > 0 || self.drop || self.nan || self.reorder
    }

    /// How long the process does nothing, ns.
    #[must_use]
    pub const fn pause_ns(&self) -> u64 {
        self.hang_ns.saturating_add(self.delay_ns)
    }

    /// The tick whose setpoint is given for `tick`.
    #[must_use]
    pub const fn setpoint_tick(&self, tick: u64) -> u64 {
        tick.saturating_sub(self.stale_setpoint as u64)
    }

    /// Changes the numbers of a sample.
    pub fn spoil(&self, values: &mut [f64]) {
        if self.nan {
            values.fill(f64::NAN);
        }
        if let Some((link, value_nm)) = self.glitch
            && let Some(last) = values.len().checked_sub(1)
        {
            values[link.min(last)] += value_nm;
        }
    }
}
