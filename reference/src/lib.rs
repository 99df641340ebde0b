//! The reference generator of a group: publishes the setpoint of every tick ahead of time.
//!
//! Never in the loop's hot path: the setpoints of the next ticks are with their readers long before they are needed,
//! so this process may be late by the whole lead before anyone notices.

mod lockstep;
mod ports;
mod realtime;
mod tick;

use std::sync::atomic::{AtomicBool, Ordering};

use loopbound_model::with_links;
use loopbound_scenario::{Mode, Scenario};
use loopbound_shared::clock;
use loopbound_shared::event::{Phase, Role};
use loopbound_shared::realtime as privileges;
use loopbound_shared::role::{self, RoleArgs, RoleError};
use loopbound_shared::sample::Announce;

use ports::{Ahead, Ports};
pub use tick::Generator;

/// Runs the reference until the group ends or `stop` is set.
///
/// # Errors
/// If the group can't be joined or its scenario describes no motion.
pub fn run(args: &RoleArgs, stop: &'static AtomicBool) -> Result<(), RoleError> {
    let links = Scenario::load(&args.scenario)?.links();
    with_links!(links, with::<N>(args, stop))
}

fn with<const N: usize>(args: &RoleArgs, stop: &'static AtomicBool) -> Result<(), RoleError> {
    let joined = role::join(args)?;
    role::wait_until_listed(&joined, Role::Reference, args.id)?;
    let generator = Generator::<N>::new(&joined.scenario, args.id)?;
    let ports = Ports::open(joined)?;
    let entered = privileges::enter(&privileges::Request::default());
    let scenario = &ports.joined.scenario;
    let mode = scenario.loop_.mode;
    let (lead_ticks, now_ns): (u64, fn() -> u64) = match mode {
        Mode::Lockstep => (lockstep::LEAD_TICKS, lockstep::now_ns),
        Mode::Realtime => (realtime::lead_ticks(scenario), clock::now_ns),
    };
    let mut ahead = Ahead::new(generator, lead_ticks, &ports);
    ahead.publish(&ports, now_ns);
    let ready = role::announce(Role::Reference, args.id, Phase::Ready, N, entered.privileges(), "reference");
    ports.announce.send(ready);
    let pace = ports.joined.block.pace();
    let stopped = || stop.load(Ordering::Relaxed) || pace.plant_ended.load(Ordering::Relaxed) != 0;
    match mode {
        Mode::Lockstep => lockstep::run(&mut ahead, &ports, &stopped),
        Mode::Realtime => realtime::run(&mut ahead, &ports, &stopped),
    }
    ports.announce.send(Announce { phase: Phase::Ended.code(), published_ns: clock::now_ns(), ..ready });
    Ok(())
}
