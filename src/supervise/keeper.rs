//! The keeper: a process of a run that outlives its launcher, and ends whatever of the run is left.
//!
//! The kernel tells a role when its parent dies, and nobody else: not the program behind a shell script, nor what that
//! started in turn. The keeper is started before all of them. It sleeps until its standard input ends, which happens when
//! the launcher closes it after an ordinary run, or dies in whatever way. Then it ends every process that was started for
//! the run: SIGTERM first, then SIGKILL, until there is none. It is a member of the group, so that it sweeps as the last
//! one if the launcher can't. It takes no part in the loop and never wakes while the launcher lives.

mod handle;
mod members;

use std::io::Read as _;

use clap::Args;
use loopbound_scenario::Scenario;
use loopbound_shared::clock::{NS_PER_S, now_ns, sleep_ns};
use loopbound_shared::event::Role;
use loopbound_shared::group::{Group, list, sweep_if_dead};
use loopbound_shared::realtime::{Signal, keep_off_cores};
use loopbound_shared::role::realtime_request;
use loopbound_shared::run_id::RunId;
use rustix::process::getppid;

use crate::exit::Exit;
use crate::signals;
pub(super) use handle::Keeper;
use members::Run;

/// Time to end in order after an ordinary run, when all roles have ended.
const AFTER_RUN_NS: u64 = NS_PER_S;
/// The same after the launcher was killed: the monitor has files to write.
const AFTER_DEATH_NS: u64 = 5 * NS_PER_S;
/// Time for the kernel to take the killed down.
const AFTER_KILL_NS: u64 = 5 * NS_PER_S;
/// The first interval between two looks whether all have ended; it doubles up to the last.
const LOOK_NS: u64 = 1_000_000;
const LOOK_NS_MAX: u64 = 50_000_000;

/// How the launcher starts it.
#[derive(Debug, Args)]
pub struct KeeperArgs {
    /// Name of the group.
    #[arg(long)]
    pub group: String,
    /// The run's identity, which its processes carry in their environment.
    #[arg(long)]
    pub run: RunId,
    /// The launcher.
    #[arg(long)]
    pub parent: u32,
}

/// Waits for the end of the launcher or of its run, then ends what is left.
///
/// # Errors
/// If signals can't be caught.
pub fn run(args: &KeeperArgs) -> anyhow::Result<Exit> {
    // Caught, and of no effect: its end is the run's.
    signals::role_stop_flag()?;
    // There is none any more if everybody ended before this process came so far; then all that is left is to look.
    let group = Group::join(&args.group).ok();
    if let Some(group) = &group {
        leave_the_loops_cores(group);
    }
    wait_for_the_end_of_input();
    let launcher_lives = getppid().is_some_and(|pid| pid.as_raw_nonzero().get().unsigned_abs() == args.parent);
    end_all(&Run::new(args, launcher_lives), if launcher_lives { AFTER_RUN_NS } else { AFTER_DEATH_NS });
    match group {
        // After an ordinary run the launcher is the last.
        Some(group) => group.leave_last(if launcher_lives { 0 } else { AFTER_KILL_NS }),
        None if launcher_lives => {}
        None => sweep_what_nobody_holds(&args.group),
    }
    Ok(Exit::Held)
}

/// A launcher that was killed so early that this process could not join its group has left the folder behind. It gives up
/// its hold when the kernel has taken it down.
fn sweep_what_nobody_holds(group: &str) {
    let until_ns = now_ns() + AFTER_KILL_NS;
    let is_there = || list().is_ok_and(|found| found.iter().any(|one| one.name == group));
    while is_there() && now_ns() < until_ns && sweep_if_dead(group).is_ok() {
        sleep_ns(LOOK_NS_MAX);
    }
}

/// It sleeps all the time; where it wakes at last, nobody should be disturbed.
fn leave_the_loops_cores(group: &Group) {
    let Ok(scenario) = Scenario::load(&group.file("scenario.toml")) else { return };
    let cores = [Role::Plant, Role::Controller].map(|role| realtime_request(&scenario, role).core);
    keep_off_cores(&cores.into_iter().flatten().collect::<Vec<_>>());
}

fn wait_for_the_end_of_input() {
    let mut input = std::io::stdin().lock();
    let mut byte = [0];
    loop {
        match input.read(&mut byte) {
            Ok(0) => return,
            Err(error) if error.kind() != std::io::ErrorKind::Interrupted => return,
            Ok(_) | Err(_) => {}
        }
    }
}

/// Ends every process of the run, in order if they do so within `patience_ns`.
fn end_all(run: &Run, patience_ns: u64) {
    for (signal, patience_ns) in [(Signal::TERM, patience_ns), (Signal::KILL, AFTER_KILL_NS)] {
        let until_ns = now_ns() + patience_ns;
        let mut told: Vec<u32> = Vec::new();
        let mut look_ns = LOOK_NS;
        loop {
            let members = run.members();
            if members.is_empty() {
                return;
            }
            for member in members {
                // Once a process: a second SIGTERM means haste to some. New ones may come all the time.
                if !told.contains(&member.pid) {
                    told.push(member.pid);
                    member.tell(signal);
                }
            }
            if now_ns() >= until_ns {
                break;
            }
            sleep_ns(look_ns);
            look_ns = (2 * look_ns).min(LOOK_NS_MAX);
        }
    }
}
