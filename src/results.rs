//! The folder of a run as the launcher has it: asked for before anything starts, taken when nothing can be refused any
//! more, and finished when the monitor is done with its part.

use std::path::Path;

use loopbound_monitor::Summary;
use loopbound_monitor::files::summary_text;
use loopbound_monitor::folder::{Begin, Claim, Kind, Results, known, self_contained, waypoints_of};
use loopbound_monitor::summary::RecordingSummary;
use loopbound_monitor::verdict::reports;
use loopbound_scenario::Scenario;
use loopbound_shared::group::Group;

use crate::exit::Failure;
use crate::report;

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

/// Adds the launcher's part to what the monitor wrote, and marks the folder finished if all of it is there. What can't
/// be written goes into the summary and costs neither the screen nor the verdict.
pub fn finish(mut results: Results, summary: &mut Summary) {
    let written = results.reload().map_err(|error| error.to_string()).and_then(|()| write(&mut results, summary));
    let monitor = summary.recording.take().unwrap_or_default();
    let why = monitor.error.clone().or_else(|| written.err());
    let whole = monitor.whole && why.is_none();
    let finished = if whole {
        results.finish().map_err(|error| format!("{}: {error}", loopbound_monitor::folder::FILE))
    } else {
        results.leave_unfinished(&why.clone().unwrap_or_else(|| summary.dropped.to_string()));
        Ok(())
    };
    let error = why.or_else(|| finished.err());
    summary.recording = Some(RecordingSummary { whole: whole && error.is_none(), error });
}

fn write(results: &mut Results, summary: &Summary) -> Result<(), String> {
    let path = results.path().to_owned();
    let mut file = |name: &str, bytes: &[u8]| results.write(name, bytes).map_err(|error| format!("{name}: {error}"));
    file(known::SUMMARY, &summary_text(summary).map_err(|error| error.to_string())?)?;
    let page = report::page_of(&[&path]).map_err(|error| error.to_string())?;
    file(report::FILE, page.as_bytes())?;
    file(reports::FILE, reports::junit(summary).as_bytes())
}
