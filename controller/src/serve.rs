//! Entry of a controller process: join, open ports, become real-time, say ready, then the loop of the mode.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use loopbound_model::law::LawKind;
use loopbound_model::with_links;
use loopbound_scenario::{Mode, Scenario};
use loopbound_shared::doorbell::Bell;
use loopbound_shared::event::{Phase, Role};
use loopbound_shared::ports::{Publisher, Subscriber};
use loopbound_shared::realtime::{self, EvidenceReader};
use loopbound_shared::role::{self, Joined, RoleArgs, RoleError};
use loopbound_shared::sample::{Announce, Setpoint, State, Torque};
use loopbound_shared::setpoints::SetpointBook;
use loopbound_shared::wakeup::{Ringer, Waiter};

use crate::core::ControllerCore;
use crate::{Builtin, Controller, lockstep, realtime as realtime_loop};

/// The ports of a controller.
pub(crate) struct Ports {
    pub(crate) joined: Joined,
    pub(crate) states: Subscriber<State>,
    pub(crate) setpoints: Subscriber<Setpoint>,
    pub(crate) torques: Publisher<Torque>,
    pub(crate) announce: Publisher<Announce>,
    pub(crate) states_bell: Waiter,
    pub(crate) torque_bell: Ringer,
}

impl Ports {
    fn open(joined: Joined) -> Result<Self, RoleError> {
        let (node, mode) = (&joined.node, joined.scenario.loop_.wakeup);
        Ok(Self {
            states: node.subscriber(8)?,
            setpoints: node.subscriber(usize::MAX)?.uncounted(),
            torques: node.publisher()?,
            announce: node.publisher()?,
            states_bell: Waiter::new(node, mode, Bell::State)?,
            torque_bell: Ringer::new(node, mode, Bell::Torque)?,
            joined,
        })
    }

    /// Enters all setpoints that have come.
    pub(crate) fn drain_setpoints(&self, book: &mut SetpointBook, links: usize) {
        while self.setpoints.take_with(|setpoint| book.enter(setpoint, links)).is_some() {}
    }

    /// Maps what has joined or left, in the slack.
    pub(crate) fn update_connections(&self) {
        // Every field is named, so that no port can be forgotten.
        let Self { states, setpoints, torques, announce, joined: _, states_bell: _, torque_bell: _ } = self;
        // What can't be mapped now belongs to a process that is just dying; the next look finds it gone.
        let _ = states.update_connections();
        let _ = setpoints.update_connections();
        let _ = torques.update_connections();
        let _ = announce.update_connections();
    }
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
        realtime::die_with_parent(parent).map_err(|e| RoleError::Other(format!("the launcher: {e}")))?;
    }
    let ports = Ports::open(role::join(args)?)?;
    let scenario = ports.joined.scenario.clone();
    let mut core = ControllerCore::new(&scenario, args.id, controller);
    let mut wanted = role::realtime_request(&scenario, Role::Controller);
    if ports.joined.block.pace().plant_tick.load(Ordering::Relaxed) > 0 {
        // The group runs: starting up must not keep the one in charge from its core. The supervisor raises it later.
        wanted.priority = wanted.priority.min(1);
    }
    let mut entered = realtime::enter(&wanted);
    let prefix = ports.joined.group.prefix();
    entered.populate_shared(&[prefix.as_str()]);
    let mut evidence = EvidenceReader::open();
    ports.update_connections();
    ports.drain_setpoints(&mut core.setpoints, scenario.links());
    realtime_loop::warm_up(&mut core, &mut evidence, scenario.links());
    let ready = core.announcement(entered.privileges());
    ports.announce.send(ready);
    let stopped = || stop.load(Ordering::Relaxed) || ports.joined.block.pace().plant_ended.load(Ordering::Relaxed) != 0;
    match scenario.loop_.mode {
        Mode::Lockstep => lockstep::run(&mut core, &ports, &stopped),
        Mode::Realtime => realtime_loop::run(&mut core, &ports, &mut evidence, args.id, &stopped),
    }
    ports.announce.send(Announce {
        phase: Phase::Ended.code(),
        published_ns: loopbound_shared::clock::now_ns(),
        ..ready
    });
    Ok(())
}

/// Reads `--group G --id N --scenario FILE [--parent PID]` as the launcher passes it to a user's controller.
///
/// # Errors
/// Names the argument that is missing or not understood.
pub fn parse_args(args: impl Iterator<Item = String>) -> Result<RoleArgs, RoleError> {
    let mut args = args.skip(1);
    let (mut group, mut id, mut scenario, mut parent) = (None, None, None, None);
    while let Some(key) = args.next() {
        let value = args.next().ok_or_else(|| RoleError::Other(format!("{key} needs a value")))?;
        let number = || value.parse().map_err(|_| RoleError::Other(format!("{key}: `{value}` is no number")));
        match key.as_str() {
            "--group" => group = Some(value.clone()),
            "--id" => id = Some(number()?),
            "--scenario" => scenario = Some(PathBuf::from(&value)),
            "--parent" => parent = Some(number()?),
            _ => return Err(RoleError::Other(format!("argument {key} is not understood"))),
        }
    }
    let missing = |key: &str| RoleError::Other(format!("{key} is missing: the launcher passes it"));
    Ok(RoleArgs {
        group: group.ok_or_else(|| missing("--group"))?,
        id: id.ok_or_else(|| missing("--id"))?,
        scenario: scenario.ok_or_else(|| missing("--scenario"))?,
        parent,
    })
}
