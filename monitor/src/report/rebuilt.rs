//! The figures of a run that left none, from what there is of its recording.

use std::path::Path;

use loopbound_model::with_links;
use loopbound_scenario::Scenario;

use crate::folder::{known, recorded_scenario};
use crate::hops::Hops;
use crate::judge::Judge;
use crate::recording::reader::{Item, ReadError, Recording};
use crate::summary::Summary;
use crate::tracker::{Config, Tracker};
use crate::verdict::judge_summary;

/// The summary and the latencies of what was recorded in `folder`.
///
/// # Errors
/// One line: why nothing can be said of it.
pub(super) fn figures(folder: &Path) -> Result<(Summary, Hops), String> {
    let recording = Recording::open(&folder.join(known::SAMPLES)).map_err(|error| error.to_string())?;
    let scenario = recorded_scenario(&recording.header().scenario, folder).map_err(|error| error.to_string())?;
    let links = scenario.links();
    with_links!(links, follow::<N>(recording, &scenario))
}

fn follow<const N: usize>(mut recording: Recording, scenario: &Scenario) -> Result<(Summary, Hops), String> {
    let judge = Judge::new(scenario).map_err(|error| error.to_string())?;
    let mut tracker = Tracker::<N>::new(Config::of(scenario), Some(judge));
    let unreadable = |error: ReadError| error.to_string();
    while let Some(item) = recording.next_item().map_err(unreadable)? {
        match item {
            Item::Announce(announce) => tracker.learn(&announce),
            Item::Record(record) => {
                tracker.feed(&record);
                tracker.drain_events().for_each(drop);
            }
            Item::Figures(_) => {}
        }
    }
    tracker.finish();
    let mut summary = tracker.summarise();
    summary.group.clone_from(&recording.header().group);
    summary.run_id.clone_from(&recording.header().run_id);
    summary.ended = "recording cut off".to_owned();
    summary.scenario = serde_json::to_value(scenario).unwrap_or_default();
    summary.verdict = judge_summary(&summary);
    Ok((summary, tracker.hops().clone()))
}
