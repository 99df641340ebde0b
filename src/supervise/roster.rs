//! `processes.json` in the group's folder: who is in the group and in which state, for `ps` and for whoever else asks.
//!
//! The supervisor keeps it up to date by renaming a whole new file over the old one, so a reader never sees half.

use loopbound_scenario::Role;
use loopbound_shared::event::Acceptance;
use loopbound_shared::group::Group;
use loopbound_shared::sample::TickRecord;
use serde::{Deserialize, Serialize};

use super::child::Child;

/// Name of the file.
pub const FILE: &str = "processes.json";

/// A group as `ps` shows it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Roster {
    /// Its name.
    pub group: String,
    /// The PID namespace that the numbers are of, as the kernel names it; none where it can't be told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pid_namespace: Option<String>,
    /// The launcher and its children.
    pub processes: Vec<Entry>,
}

/// A process as `ps` shows it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// Its role.
    pub role: String,
    /// Its id within the role.
    pub id: u32,
    /// Its process id.
    pub pid: u32,
    /// `starting`, `ready`, `active`, `standby`, `fenced` (it has failed, and nothing of it is applied until it shows itself
    /// again), `silent` (a standby that did not answer the last tick), `dead`, `ended`.
    pub state: String,
    /// How often it was started again.
    pub restarts: u32,
}

/// Writes the file when something has changed.
#[derive(Default)]
pub(super) struct RosterFile {
    written: Roster,
}

impl RosterFile {
    /// A failure to write costs `ps` its view, never the group its run.
    pub(super) fn update(&mut self, group: &Group, roster: Roster) {
        if roster != self.written {
            let text = serde_json::to_string(&roster).unwrap_or_default();
            if group.write(FILE, text.as_bytes()).is_ok() {
                self.written = roster;
            }
        }
    }
}

/// The present roster; `active` is the active controller, 0 before the start, and `newest` the last closed tick.
pub(super) fn roster(group: &str, children: &[Child], active: u32, newest: Option<&TickRecord>) -> Roster {
    let own = |state: &str| Entry {
        role: "supervisor".to_owned(),
        id: 0,
        pid: std::process::id(),
        state: state.to_owned(),
        restarts: 0,
    };
    let entry = |child: &Child| Entry {
        role: child.process.role.to_string(),
        id: child.process.id,
        pid: child.pid,
        state: state(child, active, newest).to_owned(),
        restarts: child.restarts,
    };
    let processes = std::iter::once(own("ready")).chain(children.iter().map(entry)).collect();
    Roster { group: group.to_owned(), pid_namespace: pid_namespace(), processes }
}

/// The PID namespace of this process.
pub(crate) fn pid_namespace() -> Option<String> {
    Some(std::fs::read_link("/proc/self/ns/pid").ok()?.to_string_lossy().into_owned())
}

fn state(child: &Child, active: u32, newest: Option<&TickRecord>) -> &'static str {
    match (&child.ended, &child.announce) {
        (Some((status, _)), _) if status.success() => "ended",
        (Some(_), _) => "dead",
        (None, None) => "starting",
        (None, Some(_)) if child.process.role != Role::Controller => "ready",
        (None, Some(_)) if child.process.id == active => "active",
        (None, Some(_)) if !child.member => "ready",
        (None, Some(_)) => newest.map_or("standby", |record| standing(child.process.id, record)),
    }
}

/// What the receipts of a tick say of a controller that is not active.
fn standing(id: u32, record: &TickRecord) -> &'static str {
    let answer = record.receipts.iter().find(|receipt| receipt.writer == id);
    match answer.and_then(|receipt| Acceptance::from_code(receipt.acceptance)) {
        Some(Acceptance::Fenced | Acceptance::NotFinite | Acceptance::Malformed) => "fenced",
        Some(Acceptance::Stale) => "late",
        // A tick that the plant slept through says nothing of anybody.
        None if record.receipts.iter().any(|receipt| receipt.writer == record.active) => "silent",
        _ => "standby",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_controller_that_answers_well_is_called_a_standby() {
        let mut record = TickRecord { active: 1, ..TickRecord::zeroed() };
        assert_eq!(standing(2, &record), "standby", "an empty tick says nothing");
        (record.receipts[0].writer, record.receipts[0].acceptance) = (1, Acceptance::Applied.code());
        assert_eq!(standing(2, &record), "silent");
        for (acceptance, state) in [
            (Acceptance::Standby, "standby"),
            (Acceptance::LateUnused, "standby"),
            (Acceptance::Stale, "late"),
            (Acceptance::Fenced, "fenced"),
            (Acceptance::NotFinite, "fenced"),
        ] {
            (record.receipts[1].writer, record.receipts[1].acceptance) = (2, acceptance.code());
            assert_eq!(standing(2, &record), state, "{acceptance:?}");
        }
    }
}
