//! What a run can't do without on this host: asked for before anything is touched or started, and named with the remedy.
//!
//! What only makes a run better is no need: the privileges of real time are noted and reported, and cores that are not
//! there are named in [`notes`].

use loopbound_model::quote;
use std::path::Path;

use loopbound_scenario::controllers;
use loopbound_scenario::{Cores, Mode, Scenario};
use loopbound_shared::group::room;
use loopbound_shared::realtime::Step;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::{CpuSet, sched_getaffinity};

use crate::exit::{Exit, Failure};

/// Monitors besides the launcher's own that there is room for at the start.
const GUESTS: u64 = 2;
/// Descriptors of the process that has the most, the plant, with one controller; 108 were seen with seven.
const DESCRIPTORS: u64 = 80;
/// More of them for each further controller or monitor.
const DESCRIPTORS_MEMBER: u64 = 6;
/// What the limit on descriptors is raised to where that is allowed.
const DESCRIPTORS_WANTED: u64 = 1024;

/// Address space of the process that has the most, bytes: 80 MB seen.
const SPACE_BYTES: u64 = 128 << 20;

/// Raises the limits on this process's descriptors and on the length of its files, which its children inherit, as far as
/// needs no privilege.
pub fn raise_limits() {
    let limit = getrlimit(Resource::Nofile);
    let wanted = limit.maximum.map_or(DESCRIPTORS_WANTED, |most| most.min(DESCRIPTORS_WANTED));
    if limit.current.is_some_and(|current| current < wanted) {
        let _ = setrlimit(Resource::Nofile, Rlimit { current: Some(wanted), maximum: limit.maximum });
    }
    let maximum = getrlimit(Resource::Fsize).maximum;
    let _ = setrlimit(Resource::Fsize, Rlimit { current: maximum, maximum });
}

/// Whether this host has what a run of `scenario` needs.
///
/// # Errors
/// If not; nothing was touched.
pub fn check(scenario: &Scenario) -> anyhow::Result<()> {
    let controllers = controllers::of(scenario).len() as u64;
    check_proc(Path::new("/proc/self/exe"))?;
    check_descriptors(controllers.saturating_sub(1) + GUESTS)?;
    // The samples of a group are files in memory.
    let bytes = room::needed(controllers, GUESTS).bytes;
    check_bytes(Resource::Fsize, "write files of", "ulimit -f", bytes)?;
    check_bytes(Resource::As, "have an address space of", "ulimit -v", SPACE_BYTES)?;
    Ok(room::require(room::needed(controllers, GUESTS))?)
}

/// Whether this process may have the descriptors of a member of a group with so many members above the least.
///
/// # Errors
/// If not.
pub fn check_descriptors(further_members: u64) -> Result<(), Failure> {
    let needed = DESCRIPTORS + DESCRIPTORS_MEMBER * further_members;
    match getrlimit(Resource::Nofile).current {
        Some(limit) if limit < needed => Err(lacking(format!(
            "a process may have {limit} open files here, and a group of this size needs {needed}: raise the limit (ulimit -n {DESCRIPTORS_WANTED}; a container: --ulimit nofile={DESCRIPTORS_WANTED})"
        ))),
        _ => Ok(()),
    }
}

fn check_bytes(resource: Resource, may: &str, command: &str, needed: u64) -> Result<(), Failure> {
    match getrlimit(resource).current {
        Some(limit) if limit < needed => Err(lacking(format!(
            "a process may {may} {:.1} MB here, and a group of this size needs {:.1}: raise the limit ({command} unlimited)",
            limit as f64 * 1e-6,
            needed as f64 * 1e-6
        ))),
        _ => Ok(()),
    }
}

fn check_proc(own: &Path) -> Result<(), Failure> {
    let found = std::fs::read_link(own).map(|_| ());
    found.map_err(|error| {
        let mount = "mount it (mount -t proc proc /proc), in the PID namespace of this process";
        lacking(format!(
            "/proc is needed to start the processes of a group, and {}: {error}: {mount}",
            quote::path(own)
        ))
    })
}

fn lacking(message: String) -> Failure {
    Failure { exit: Exit::Internal, message }
}

/// What a run of `scenario` asks for in vain and goes on without.
#[must_use]
pub fn notes(scenario: &Scenario) -> Vec<String> {
    let Ok(allowed) = sched_getaffinity(None) else { return Vec::new() };
    cores_lacking(scenario, |core| core < CpuSet::MAX_CPU && allowed.is_set(core))
}

fn cores_lacking(scenario: &Scenario, allowed: impl Fn(usize) -> bool) -> Vec<String> {
    let Cores::List(cores) = &scenario.realtime.cores else { return Vec::new() };
    if scenario.loop_.mode == Mode::Lockstep {
        return Vec::new();
    }
    let lacking = cores.iter().filter(|core| !allowed(**core));
    let cost = Step::Affinity.cost();
    lacking
        .map(|core| {
            format!("realtime.cores: core {core} is none that this process may use (taskset -cp $$ lists them): {cost}")
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_core_that_is_not_there_is_named_with_its_cost_where_cores_matter() {
        let scenario = Scenario::default().with_set("realtime.cores=[0,5]").unwrap();
        let notes = cores_lacking(&scenario, |core| core < 2);
        assert!(notes.len() == 1 && notes[0].contains("core 5") && notes[0].contains("caches"), "{notes:?}");
        assert!(cores_lacking(&scenario.with_set("loop.mode=lockstep").unwrap(), |_| false).is_empty());
        assert!(cores_lacking(&Scenario::default(), |_| false).is_empty());
    }

    #[test]
    fn what_is_lacking_is_named_with_the_remedy() {
        let error = check_descriptors(1_000_000_000).unwrap_err();
        assert!(error.exit == Exit::Internal && error.message.contains("ulimit -n"), "{error}");
        let error = check_proc(Path::new("/nowhere/self/exe")).unwrap_err();
        assert!(error.message.contains("mount -t proc"), "{error}");
    }
}
