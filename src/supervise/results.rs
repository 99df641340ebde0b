//! The folder of a run before it is the monitor's: asked for before anything starts, taken when nothing can be refused any
//! more.

use std::path::Path;

use loopbound_monitor::folder::{Begin, Claim, Kind, Results, self_contained, waypoints_of};
use loopbound_scenario::Scenario;
use loopbound_shared::group::Group;

use crate::exit::Failure;

/// A folder that is locked for a run and not touched yet, with what goes into it first.
#[derive(Debug)]
pub struct Asked {
    claim: Claim,
    scenario: String,
    waypoints: Option<Vec<u8>>,
}

impl Asked {
    /// Asks for `folder`.
    ///
    /// # Errors
    /// Whatever a run there has to be refused for.
    pub fn for_run(folder: &Path, scenario: &Scenario) -> anyhow::Result<Self> {
        let refuse = |error: &dyn std::fmt::Display| Failure::usage(format!("--out {error}"));
        let waypoints = waypoints_of(scenario).map_err(|error| refuse(&error))?;
        let scenario = self_contained(scenario).to_toml()?;
        let claim = Claim::prepare(folder, Kind::Run).map_err(|error| refuse(&error))?;
        Ok(Self { claim, scenario, waypoints })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.claim.path()
    }

    /// Takes it: what an earlier run wrote there is gone after this.
    ///
    /// # Errors
    /// If the folder can't be written.
    pub fn take(self, group: &Group) -> Result<Results, Failure> {
        let (scenario, waypoints) = (Some(self.scenario.as_str()), self.waypoints.as_deref());
        let begin = Begin { run_id: group.run_id(), group: group.name(), scenario, waypoints };
        self.claim.begin(&begin).map_err(|error| Failure::usage(format!("--out {error}")))
    }
}
