//! The thin entries of the roles: signals become a flag, and the role's own crate does the rest.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::Context as _;
use clap::Args;
use loopbound_model::law::LawKind;
use loopbound_shared::realtime::die_with_parent;
use loopbound_shared::role::{RoleArgs, RoleError};

use crate::exit::Exit;
use crate::signals;

/// How the launcher starts its children.
#[derive(Debug, Args)]
pub struct ChildArgs {
    /// Name of the group.
    #[arg(long)]
    pub group: String,
    /// Id within the group.
    #[arg(long)]
    pub id: u32,
    /// The scenario with all defaults filled in.
    #[arg(long)]
    pub scenario: PathBuf,
    /// The launcher: the child ends when it does.
    #[arg(long)]
    pub parent: Option<u32>,
    /// The law of a controller; default the scenario's.
    #[arg(long)]
    pub law: Option<LawKind>,
}

impl ChildArgs {
    /// As the role crates take it.
    #[must_use]
    pub fn into_role(self) -> RoleArgs {
        RoleArgs { group: self.group, id: self.id, scenario: self.scenario, parent: self.parent }
    }
}

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
pub(super) fn begin(parent: Option<u32>) -> anyhow::Result<&'static AtomicBool> {
    let stop = signals::role_stop_flag().context("signals")?;
    if let Some(parent) = parent {
        die_with_parent(parent)?;
    }
    Ok(stop)
}
