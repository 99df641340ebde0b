//! The thin entries of the roles: signals become a flag, and the role's own crate does the rest.

use std::sync::atomic::AtomicBool;

use anyhow::Context as _;
use loopbound_monitor::tui::Left;
use loopbound_shared::realtime::die_with_parent;
use loopbound_shared::role::{RoleArgs, RoleError};

use crate::cli;
use crate::exit::Exit;
use crate::needs;
use crate::signals;

/// Runs a role to its end.
///
/// # Errors
/// The role's, or the system's.
pub fn role(
    run: impl FnOnce(&RoleArgs, &'static AtomicBool) -> Result<(), RoleError>,
    args: RoleArgs,
) -> anyhow::Result<Exit> {
    let stop = begin(args.parent)?;
    run(&args, stop)?;
    Ok(Exit::Held)
}

/// First thing in a child: the launcher's death reaches it as SIGTERM, and SIGTERM is a flag by then.
fn begin(parent: Option<u32>) -> anyhow::Result<&'static AtomicBool> {
    let stop = signals::role_stop_flag().context("signals")?;
    if let Some(parent) = parent {
        die_with_parent(parent)?;
    }
    Ok(stop)
}

/// `loopbound monitor`: attached by a user, or managed by the launcher.
///
/// # Errors
/// The monitor's, or the system's.
pub fn monitor(args: cli::MonitorArgs) -> anyhow::Result<Exit> {
    let stop = begin(args.parent)?;
    if !args.managed {
        needs::check_descriptors(0)?;
    }
    let tui = args.tui;
    let args = loopbound_monitor::MonitorArgs {
        group: args.group,
        id: args.id,
        scenario: args.scenario,
        parent: args.parent,
        out: args.out,
        json: args.json,
        quiet: args.quiet,
        managed: args.managed,
        duration_ns: args.duration,
        foxglove: args.foxglove,
        foxglove_origins: args.foxglove_origins,
    };
    if tui {
        let left = loopbound_monitor::tui::run(&args, stop)?;
        return Ok(if left == Left::Interrupted { Exit::Interrupted } else { Exit::Held });
    }
    let outcome = loopbound_monitor::run(&args, stop)?;
    // The launcher looks at the recording of its own monitor itself.
    let whole = outcome.summary.recording.is_none_or(|recording| recording.whole);
    Ok(if whole || args.managed { Exit::Held } else { Exit::RoleDied })
}
