//! The controllers of a group: each answers every state of the plant with a torque.
//!
//! Responsible for the frame around a law: joining the group, waiting, the setpoint of the tick, stamps, publication.
//! Not responsible for which torque is obeyed (the plant decides) nor for who runs (the supervisor does).
//!
//! A controller of your own is an executable that calls [`serve`] with a [`Controller`]; the launcher starts it as
//! `EXE --group G --id N --scenario FILE`.

mod arguments;
mod builtin;
mod lockstep;
mod ports;
mod realtime;
mod tick;

use std::sync::atomic::{AtomicBool, Ordering};

use loopbound_model::law::LawKind;
use loopbound_model::with_links;
use loopbound_scenario::{Mode, Scenario};
use loopbound_shared::clock;
use loopbound_shared::event::{Phase, Role};
use loopbound_shared::realtime::{self as privileges, EvidenceReader};
use loopbound_shared::role::{self, RoleArgs, RoleError};
use loopbound_shared::sample::Announce;

pub use arguments::parse_args;
pub use builtin::Builtin;
pub use loopbound_model::claim::Claim;
use ports::Ports;
pub use tick::ControllerCore;

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

/// Runs the built-in law that the scenario names, or `law`, until the group ends or `stop` is set.
///
/// # Errors
/// If the group can't be joined or its scenario describes no system.
pub fn run(args: &RoleArgs, law: Option<LawKind>, stop: &'static AtomicBool) -> Result<(), RoleError> {
    fn with<const N: usize>(
        args: &RoleArgs,
        scenario: &Scenario,
        law: LawKind,
        stop: &'static AtomicBool,
    ) -> Result<(), RoleError> {
        let law = Builtin::<N>::new(scenario, law)?;
        serve_until(law, args, stop)
    }
    let scenario = Scenario::load(&args.scenario)?;
    let law = law.unwrap_or(scenario.controller.law);
    with_links!(scenario.links(), with::<N>(args, &scenario, law, stop))
}

/// Runs a controller of one's own until the group ends. SIGTERM ends the process as it does by default; a supervisor
/// cleans up after it.
///
/// # Errors
/// If the group can't be joined.
pub fn serve(controller: impl Controller, args: &RoleArgs) -> Result<(), RoleError> {
    static NEVER: AtomicBool = AtomicBool::new(false);
    serve_until(controller, args, &NEVER)
}

/// [`serve`], until the group ends or `stop` is set.
///
/// # Errors
/// If the group can't be joined.
pub fn serve_until(controller: impl Controller, args: &RoleArgs, stop: &'static AtomicBool) -> Result<(), RoleError> {
    if let Some(parent) = args.parent {
        privileges::die_with_parent(parent).map_err(|e| RoleError::Other(format!("the launcher: {e}")))?;
    }
    let ports = Ports::open(role::join(args)?)?;
    let scenario = ports.joined.scenario.clone();
    let mut core = ControllerCore::new(&scenario, args.id, controller);
    let mut wanted = role::realtime_request(&scenario, Role::Controller);
    if ports.joined.block.pace().plant_tick.load(Ordering::Relaxed) > 0 {
        // The group runs: starting up must not keep the active controller from its core. The supervisor raises it later.
        wanted.priority = wanted.priority.min(1);
    }
    let mut entered = privileges::enter(&wanted);
    let prefix = ports.joined.group.prefix();
    entered.populate_shared(&[prefix.as_str()]);
    let mut evidence = EvidenceReader::open();
    ports.update_connections();
    ports.drain_setpoints(&mut core.setpoints, scenario.links());
    realtime::warm_up(&mut core, &mut evidence, scenario.links());
    let ready = core.announcement(entered.privileges());
    ports.announce.send(ready);
    let stopped = || stop.load(Ordering::Relaxed) || ports.joined.block.pace().plant_ended.load(Ordering::Relaxed) != 0;
    match scenario.loop_.mode {
        Mode::Lockstep => lockstep::run(&mut core, &ports, &stopped),
        Mode::Realtime => realtime::run(&mut core, &ports, &mut evidence, &stopped),
    }
    ports.announce.send(Announce { phase: Phase::Ended.code(), published_ns: clock::now_ns(), ..ready });
    Ok(())
}
