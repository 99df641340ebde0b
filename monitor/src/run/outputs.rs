//! Where a monitor puts what it sees: the folder of the run, the server for Foxglove, the report at the end.

use std::io::Write as _;
use std::path::Path;

use loopbound_model::chain::LINKS_MAX;
use loopbound_scenario::Mode;
use loopbound_shared::clock::{now_ns, wall_time_ns};
use loopbound_shared::role::{Joined, RoleError};
use loopbound_shared::say;

use super::{MonitorArgs, Outcome};
use crate::files::{Place, summary_text};
use crate::folder::{Begin, Claim, FolderError, Kind, self_contained, waypoints_of};
use crate::live::{Address, Live, LiveError};
use crate::recording::{About, Started};
use crate::render::render;

/// The folder of a monitor that a user has attached. The launcher takes that of its own monitor.
pub(super) fn claim(folder: &Path) -> Result<Claim, RoleError> {
    Claim::prepare(folder, Kind::Run).map_err(|error| RoleError::Usage(format!("--out {error}")))
}

pub(super) fn take(claim: Claim, joined: &Joined) -> Result<Place, RoleError> {
    let refuse = |error: FolderError| RoleError::Usage(format!("--out {error}"));
    let scenario = self_contained(&joined.scenario).to_toml()?;
    let waypoints = waypoints_of(&joined.scenario).map_err(refuse)?;
    let begin = Begin {
        run_id: joined.group.run_id(),
        group: joined.group.name(),
        scenario: Some(&scenario),
        waypoints: waypoints.as_deref(),
    };
    claim.begin(&begin).map(Place::Own).map_err(refuse)
}

/// Starts to serve, and says where: the port may have been left to the system.
pub(super) fn serve(address: &Address, args: &MonitorArgs, joined: &Joined) -> Result<Live, RoleError> {
    let scenario = &joined.scenario;
    let lockstep = scenario.loop_.mode == Mode::Lockstep;
    let live = Live::start(address, &args.foxglove_origins, &about(args, joined)?, scenario.period_ns(), lockstep);
    let live = live.map_err(refused)?;
    let whom = if address.is_loopback() { "this machine" } else { "every machine that can reach this one" };
    if !args.quiet {
        say::err!("loopbound: group {} is live for Foxglove on {whom} at {}", args.group, live.url());
    }
    Ok(live)
}

fn refused(error: LiveError) -> RoleError {
    match error {
        LiveError::Bind { .. } | LiveError::Absent => RoleError::Usage(error.to_string()),
        LiveError::Server(_) => RoleError::Other(error.to_string()),
    }
}

/// What a recording says of its run.
pub(super) fn about(args: &MonitorArgs, joined: &Joined) -> Result<About, RoleError> {
    let scenario = &joined.scenario;
    let virtual_time = scenario.loop_.mode == Mode::Lockstep;
    let mut length_m = [1.0; LINKS_MAX];
    // A chain that is given by coefficients has no lengths; links of 1 m show its angles.
    if let Some(lengths) = &scenario.plant.length {
        length_m.iter_mut().zip(lengths.to_vec(scenario.links())).for_each(|(place, length)| *place = length);
    }
    Ok(About {
        links: scenario.links(),
        length_m,
        started: Started { wall_ns: wall_time_ns(), monotonic_ns: (!virtual_time).then(now_ns) },
        group: args.group.clone(),
        scenario: self_contained(scenario).to_toml()?,
        run_id: joined.group.run_id().to_string(),
    })
}

/// Leaves the summary to the launcher, or prints it.
pub(super) fn report(args: &MonitorArgs, joined: &Joined, outcome: &Outcome) -> Result<(), RoleError> {
    if args.managed {
        let text = summary_text(&outcome.summary).map_err(|e| RoleError::Other(format!("summary.json: {e}")))?;
        return Ok(joined.group.write("summary.json", &text)?);
    }
    if args.json {
        let text = serde_json::to_string_pretty(&outcome.summary);
        say::out!("{}", text.map_err(|e| RoleError::Other(e.to_string()))?);
    } else {
        let _ = write!(say::stdout(), "{}", render(&outcome.summary, 100, say::in_colour(say::to_terminal())));
    }
    Ok(())
}
