//! The controllers of a group: each answers every state of the plant with a torque.
//!
//! Responsible for the frame around a law: joining the group, waiting, the setpoint of the tick, stamps, publication.
//! Not responsible for which torque is obeyed (the plant decides) nor for who runs (the supervisor does).
//!
//! A controller of your own is an executable that calls [`serve`] with a [`Controller`]; the launcher starts it as
//! `EXE --group G --id N --scenario FILE`.

mod builtin;
mod core;
mod lockstep;
mod realtime;
mod serve;

pub use builtin::Builtin;
pub use core::ControllerCore;
pub use serve::{parse_args, run, serve, serve_until};

pub use loopbound_model::claim::Claim;

/// What a controller sees of one tick. Every slice has one entry a link.
#[derive(Clone, Copy, Debug)]
pub struct Input<'a> {
    /// The tick.
    pub tick: u64,
    /// Time of the sample since t = 0, s.
    pub time_s: f64,
    /// Measured angles from the downward vertical, rad.
    pub q: &'a [f64],
    /// Measured velocities, rad/s.
    pub v: &'a [f64],
    /// Desired angles, rad.
    pub q_d: &'a [f64],
    /// Desired velocities, rad/s.
    pub v_d: &'a [f64],
    /// Desired accelerations, rad/s².
    pub a_d: &'a [f64],
}

/// A control law as a process runs it. Called once a tick in the real-time part: no allocation, lock or input and
/// output in there.
pub trait Controller {
    /// A name for reports, at most 32 bytes.
    fn name(&self) -> &str;

    /// The built-in law that this is, if it is one. Without a claim the bound is not checked against this controller.
    fn claim(&self) -> Option<Claim> {
        None
    }

    /// The torque of a tick, N·m, one entry a link, conjugate to the absolute angles. `tau` comes in as zeros.
    fn torque(&mut self, input: &Input<'_>, tau: &mut [f64]);
}
