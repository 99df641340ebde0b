//! The plant of a group: integrates the chain, publishes its state every tick, and decides which torque acts.
//!
//! [`tick`] is the plant without a clock, [`authority`] decides which controller's torque acts, `fallback` what acts when
//! none answers. The two loops differ in their clock only: `realtime` runs on the machine's, `lockstep` on virtual time.
//! Whatever judges a run stays out of here: the plant writes records, and reads none.

mod answers;
pub mod authority;
mod fallback;
mod laws;
pub mod lockstep;
mod ports;
mod realtime;
mod replies;
pub mod tick;

use std::sync::atomic::{AtomicBool, Ordering};

use loopbound_model::with_links;
use loopbound_scenario::{Mode, Scenario};
use loopbound_shared::clock;
use loopbound_shared::event::{Phase, Role};
use loopbound_shared::realtime as privileges;
use loopbound_shared::role::{self, RoleArgs, RoleError};
use loopbound_shared::sample::Announce;

pub use crate::fallback::Damping;
use crate::ports::Ports;
pub use crate::tick::{Opening, PlantCore};

/// Runs the plant until its last tick, or until `stop` is set.
///
/// # Errors
/// If the group can't be joined or its scenario describes no system.
pub fn run(args: &RoleArgs, stop: &'static AtomicBool) -> Result<(), RoleError> {
    let links = Scenario::load(&args.scenario)?.links();
    with_links!(links, with::<N>(args, stop))
}

fn with<const N: usize>(args: &RoleArgs, stop: &'static AtomicBool) -> Result<(), RoleError> {
    let joined = role::join(args)?;
    let request = role::realtime_request(&joined.scenario, Role::Plant);
    let mode = joined.scenario.loop_.mode;
    let mut core = PlantCore::<N>::new(&joined.scenario, mode == Mode::Realtime)?;
    let ports = Ports::open(joined, args.id)?;
    let mut entered = privileges::enter(&request);
    entered.populate_shared(&[ports.joined.group.prefix().as_str()]);
    let ready = role::announce(Role::Plant, args.id, Phase::Ready, N, entered.privileges(), "plant");
    // Whatever ends this function, the others learn that there is no plant any more.
    let _ended = Ended(&ports);
    ports.update_connections();
    ports.announce.send(ready);
    let stopped = || stop.load(Ordering::Relaxed);
    match mode {
        Mode::Lockstep => lockstep::run(&mut core, &ports, &stopped),
        Mode::Realtime => realtime::run(&mut core, &ports, &stopped),
    }
    ports.announce.send(Announce { phase: Phase::Ended.code(), published_ns: clock::now_ns(), ..ready });
    Ok(())
}

struct Ended<'a>(&'a Ports);

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        self.0.tell_end();
    }
}
