//! What the launcher itself knows of a run: who was started, with which privileges, who died, how each ended.

use std::collections::BTreeMap;

use loopbound_shared::realtime::{Privileges, STEPS};
use serde::{Deserialize, Serialize};

/// The launcher's part of `summary.json`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Record {
    /// Name of the group.
    pub group: String,
    /// From the first process started to the last one ready, ns.
    pub start_up_ns: u64,
    /// Why the group ended.
    pub end: String,
    /// Ticks that the run was to have, with what it was prolonged by; 0 in files of versions before.
    #[serde(default)]
    pub ticks_planned: u64,
    /// Everyone that was started.
    pub processes: Vec<ProcessRecord>,
    /// Deaths before the end of the run, in order of time.
    pub deaths: Vec<Death>,
}

/// One process of the table.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ProcessRecord {
    /// Role.
    pub role: String,
    /// Id within the role.
    pub id: u32,
    /// Process id of the last start.
    pub pid: u32,
    /// How often it was started again.
    pub restarts: u32,
    /// How the last one ended.
    pub end: String,
    /// What it asked of the kernel, step by step, and whether it had it.
    pub privileges: BTreeMap<String, String>,
    /// What it said on its standard output and error.
    pub said: Vec<String>,
}

/// A process that ended before the run did.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Death {
    /// Role.
    pub role: String,
    /// Id within the role.
    pub id: u32,
    /// Process id.
    pub pid: u32,
    /// The tick that the plant was in when it was noticed.
    pub tick: u64,
    /// How it ended.
    pub how: String,
    /// Whether another took its place.
    pub recovered: bool,
}

impl std::fmt::Display for Death {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { role, id, how, tick, .. } = self;
        let fate = if self.recovered { "recovered" } else { "not recovered" };
        write!(f, "{role} {id}: {how} in tick {tick}, {fate}")
    }
}

impl Record {
    /// Whether someone died whose place was not taken.
    #[must_use]
    pub fn unrecovered(&self) -> Option<&Death> {
        self.deaths.iter().find(|death| !death.recovered)
    }
}

/// Each step by name, with what came of it.
pub(super) fn privileges(privileges: &Privileges) -> BTreeMap<String, String> {
    STEPS.iter().map(|&step| (step.name().to_owned(), privileges.outcome(step).to_string())).collect()
}
