//! `loopbound ps`: the running groups of this user. It looks at files only and disturbs nobody.

use std::io::Write as _;

use loopbound_shared::group::{self, file_of};
use loopbound_shared::realtime::ProcessHandle;
use loopbound_shared::say;

use crate::exit::Exit;
use crate::supervise::{ROSTER_FILE, Roster, pid_namespace};

/// Prints all groups with a living member, as a table or as one JSON document.
///
/// # Errors
/// If the runtime directory is not this user's own.
pub fn run(json: bool) -> anyhow::Result<Exit> {
    let rosters: Vec<Roster> = group::list()?.into_iter().filter(|g| g.alive).map(|g| roster_of(&g.name)).collect();
    let mut out = say::stdout();
    if json {
        writeln!(out, "{}", serde_json::to_string(&rosters)?)?;
    } else {
        write!(out, "{}", table(&rosters))?;
    }
    Ok(Exit::Held)
}

/// The supervisor's file, corrected by what it can't know: that the supervisor itself was killed.
fn roster_of(name: &str) -> Roster {
    let bytes = file_of(name, ROSTER_FILE).ok().and_then(|file| std::fs::read(file).ok()).unwrap_or_default();
    let mut roster: Roster = serde_json::from_slice(&bytes).unwrap_or_default();
    name.clone_into(&mut roster.group);
    // Seen from another PID namespace its numbers mean nobody, or others.
    let visible = roster.pid_namespace.is_none() || roster.pid_namespace == pid_namespace();
    for process in &mut roster.processes {
        let over = ["dead", "ended"].contains(&process.state.as_str());
        if !over && !visible {
            "unknown".clone_into(&mut process.state);
        } else if !over && ProcessHandle::open(process.pid).is_err_and(|e| e.raw_os_error() == Some(NO_SUCH_PROCESS)) {
            "dead".clone_into(&mut process.state);
        }
    }
    roster
}

const NO_SUCH_PROCESS: i32 = rustix::io::Errno::SRCH.raw_os_error();

fn table(rosters: &[Roster]) -> String {
    if rosters.is_empty() {
        return "no group is running\n".to_owned();
    }
    let mut text =
        format!("{:<20} {:<11} {:>3} {:>8}  {:<9} {:>8}\n", "GROUP", "ROLE", "ID", "PID", "STATE", "RESTARTS");
    for roster in rosters {
        for p in &roster.processes {
            let line = format!(
                "{:<20} {:<11} {:>3} {:>8}  {:<9} {:>8}\n",
                roster.group, p.role, p.id, p.pid, p.state, p.restarts
            );
            text.push_str(&line);
        }
        if roster.processes.is_empty() {
            text.push_str(&format!("{:<20} starting\n", roster.group));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::supervise::Entry;
    use loopbound_shared::group::Group;

    fn entry(pid: u32, state: &str) -> Entry {
        Entry { role: "controller".into(), id: 1, pid, state: state.into(), restarts: 0 }
    }

    #[test]
    fn a_process_that_is_gone_is_shown_as_dead_whatever_the_file_says() {
        let name = format!("test-ps-{}", std::process::id());
        let group = Group::create(&name).unwrap();
        let mut child = std::process::Command::new("true").spawn().unwrap();
        let gone = child.id();
        child.wait().unwrap();
        let written = Roster {
            group: name.clone(),
            pid_namespace: None,
            processes: vec![entry(std::process::id(), "active"), entry(gone, "standby")],
        };
        std::fs::write(group.file(ROSTER_FILE), serde_json::to_vec(&written).unwrap()).unwrap();
        let states: Vec<String> = roster_of(&name).processes.into_iter().map(|p| p.state).collect();
        assert_eq!(states, ["active", "dead"]);
    }

    #[test]
    fn what_runs_in_another_pid_namespace_is_unknown_and_not_dead() {
        let name = format!("test-ps-ns-{}", std::process::id());
        let group = Group::create(&name).unwrap();
        let written = Roster {
            group: name.clone(),
            pid_namespace: Some("pid:[1]".to_owned()),
            processes: vec![entry(4_000_000, "active"), entry(4_000_001, "ended")],
        };
        std::fs::write(group.file(ROSTER_FILE), serde_json::to_vec(&written).unwrap()).unwrap();
        let states: Vec<String> = roster_of(&name).processes.into_iter().map(|p| p.state).collect();
        assert_eq!(states, ["unknown", "ended"]);
    }

    #[test]
    fn a_group_without_a_file_is_shown_as_starting() {
        let name = format!("test-ps-new-{}", std::process::id());
        let group = Group::create(&name).unwrap();
        let text = table(&[roster_of(group.name())]);
        assert!(text.contains(&name) && text.contains("starting"), "{text}");
    }
}
