//! What can be refused before anything starts: the scenario's whole system is built once, and its executables are there.
//!
//! Every process builds its own part again. That it can be built is settled here, with one message and one exit code,
//! instead of by whichever process comes to it first.

use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use loopbound_model::quote;
use loopbound_model::with_links;
use loopbound_monitor::judge::Judge;
use loopbound_scenario::input::WAYPOINTS_BYTES_MAX;
use loopbound_scenario::system;
use loopbound_scenario::{Scenario, ScenarioError, WAYPOINTS_FILE, WrittenAt};
use loopbound_shared::group::Group;

use crate::inprocess::InProcess;

/// Builds the whole system of a scenario, and looks for its executables.
///
/// # Errors
/// The first thing that would keep a process from starting, by its key.
pub fn system_of(scenario: &Scenario) -> Result<(), ScenarioError> {
    system::check(scenario)?;
    with_links!(scenario.links(), build::<N>(scenario))?;
    let own = scenario.controller.exe.iter().map(|exe| ("controller.exe".to_owned(), exe));
    let swaps = scenario.swap.iter().enumerate();
    let of_swaps = swaps.filter_map(|(index, swap)| Some((format!("swap[{index}].exe"), swap.exe.as_ref()?)));
    own.chain(of_swaps).try_for_each(|(key, exe)| check_executable(&key, exe))
}

/// Leaves the scenario in the group's folder, with a copy of the waypoints: what all processes read is the same, whatever
/// becomes of the user's file, and a pipe was read already.
pub(crate) fn write_scenario(group: &Group, scenario: &Scenario) -> anyhow::Result<()> {
    if let Some(file) = &scenario.reference.file {
        let text = file.text(WAYPOINTS_BYTES_MAX).with_context(|| quote::path(file.path()))?;
        group.write(WAYPOINTS_FILE, text.as_bytes())?;
    }
    let text = scenario.with_own_waypoints().to_toml()?;
    Ok(group.write("scenario.toml", text.as_bytes())?)
}

/// As the processes will: plant, controllers and reference as one, and the monitor's judge.
fn build<const N: usize>(scenario: &Scenario) -> Result<(), ScenarioError> {
    InProcess::<N>::new(scenario)?;
    Judge::<N>::new(scenario).map(drop)
}

fn check_executable(key: &str, exe: &Path) -> Result<(), ScenarioError> {
    let refuse = |found: &str| ScenarioError::Value {
        place: WrittenAt::Nowhere,
        key: key.to_owned(),
        found: format!("{}, {found}", quote::path(exe)),
        allowed: "an executable file".to_owned(),
    };
    // A bare name is looked for in the search path, as the start of the process will.
    let is_bare = exe.components().count() == 1 && !exe.is_absolute();
    let places: Vec<PathBuf> = match std::env::var_os("PATH") {
        Some(path) if is_bare => std::env::split_paths(&path).map(|folder| folder.join(exe)).collect(),
        _ => vec![exe.to_owned()],
    };
    let found: Vec<_> = places.iter().filter_map(|place| std::fs::metadata(place).ok()).collect();
    if found.iter().any(|file| file.is_file() && file.mode() & 0o111 != 0) {
        return Ok(());
    }
    Err(match found.first() {
        None if is_bare => refuse("which is in no folder of the search path"),
        None => refuse("which is not there"),
        Some(file) if !file.is_file() => refuse("which is no file"),
        Some(_) => refuse("which may not be executed"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_scenario_can_be_built() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            system_of(&Scenario::load(&path).unwrap()).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        }
    }

    #[test]
    fn an_executable_that_is_none_is_refused_by_its_key() {
        let refused = |text: &str| system_of(&Scenario::from_toml(text, "s").unwrap()).unwrap_err().to_string();
        for (exe, why) in [
            ("/nowhere/controller", "which is not there"),
            ("no-such-controller-of-loopbound", "which is in no folder of the search path"),
            ("/etc/passwd", "which may not be executed"),
            ("/etc", "which is no file"),
        ] {
            let own = refused(&format!("[controller]\nexe = '{exe}'"));
            assert!(own.starts_with("`controller.exe`: found ") && own.contains(why), "{own}");
            let swap = refused(&format!("[[swap]]\nat = 1\nexe = '{exe}'"));
            assert!(swap.starts_with("`swap[0].exe`: found ") && swap.contains(why), "{swap}");
        }
        system_of(&Scenario::from_toml("[controller]\nexe = 'sh'", "s").unwrap()).unwrap();
    }
}
