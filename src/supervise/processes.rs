//! The table of processes: who is started for a scenario, how, and what becomes of it when it dies.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use loopbound_model::law::LawKind;
use loopbound_scenario::controllers;
use loopbound_scenario::{Restart, Role, Scenario};
use loopbound_shared::group::Group;

/// The variable by which everything that is started for a run can be told from all else: it holds the run's identity,
/// and is inherited.
pub const RUN_VARIABLE: &str = "LOOPBOUND_RUN";

/// One process of a group.
#[derive(Clone, Debug, PartialEq)]
pub struct Process {
    /// Its role.
    pub role: Role,
    /// Its id within the role; controllers count from 1, and the first is active at the start.
    pub id: u32,
    /// The law of a controller of ours.
    pub law: Option<LawKind>,
    /// The executable; `None` is this one.
    pub exe: Option<PathBuf>,
    /// The scenario it reads.
    pub scenario: PathBuf,
    /// What becomes of it when it dies.
    pub policy: Restart,
    /// The launcher's monitor alone: where its files go.
    pub out: Option<PathBuf>,
}

/// The processes of `scenario`, in the order in which they are started.
///
/// Who answers starts before who asks: when the plant is ready, all its partners have had the longest time to be.
#[must_use]
pub fn table(scenario: &Scenario, file: &std::path::Path, out: Option<&std::path::Path>) -> Vec<Process> {
    let one = |role: Role, id: u32| Process {
        role,
        id,
        law: None,
        exe: None,
        scenario: file.to_owned(),
        policy: scenario.supervisor.policy(role),
        out: (role == Role::Monitor).then(|| out.map(PathBuf::from)).flatten(),
    };
    let mut table = vec![one(Role::Monitor, 1), one(Role::Reference, 1)];
    table.extend(controllers::of(scenario).into_iter().map(|part| Process {
        law: part.exe.is_none().then_some(part.law),
        exe: part.exe,
        ..one(Role::Controller, part.id)
    }));
    table.push(one(Role::Plant, 1));
    table
}

impl Process {
    /// What a person calls it.
    #[must_use]
    pub fn name(&self) -> String {
        if self.role == Role::Controller { format!("controller {}", self.id) } else { self.role.to_string() }
    }

    /// Its name in file names.
    #[must_use]
    pub fn file_stem(&self) -> String {
        format!("{}-{}", self.role, self.id)
    }

    /// Its arguments. A user's own controller gets the same, without the role's name in front.
    #[must_use]
    pub fn arguments(&self, group: &str, parent_pid: u32) -> Vec<OsString> {
        let mut arguments: Vec<OsString> = Vec::new();
        if self.exe.is_none() {
            arguments.push(self.role.name().into());
        }
        let mut add = |key: &str, value: OsString| arguments.extend([key.into(), value]);
        add("--group", group.into());
        add("--id", self.id.to_string().into());
        add("--scenario", self.scenario.clone().into());
        add("--parent", parent_pid.to_string().into());
        if let Some(law) = self.law {
            add("--law", law.name().into());
        }
        if let Some(out) = &self.out {
            add("--out", out.clone().into());
        }
        if self.role == Role::Monitor {
            arguments.push("--managed".into());
        }
        arguments
    }

    /// The command that starts it, in a process group of its own: a terminal's Ctrl-C reaches the launcher alone.
    /// Whatever it prints goes to `log`, so that neither a full pipe can block it nor a word of it reach the launcher's
    /// standard output.
    ///
    /// # Errors
    /// If this executable can't be found, or the log can't be shared.
    pub fn command(&self, group: &Group, log: std::fs::File) -> std::io::Result<Command> {
        use std::os::unix::process::CommandExt as _;
        let program = match &self.exe {
            Some(exe) => exe.clone(),
            None => std::env::current_exe()?,
        };
        let mut command = Command::new(program);
        command
            .args(self.arguments(group.name(), std::process::id()))
            .env(RUN_VARIABLE, group.run_id().to_string())
            .stdin(Stdio::null())
            .stdout(log.try_clone()?)
            .stderr(log)
            .process_group(0);
        Ok(command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn words(process: &Process) -> Vec<String> {
        process.arguments("g", 7).into_iter().map(|a| a.into_string().unwrap()).collect()
    }

    #[test]
    fn the_papers_case_is_four_processes_and_the_plant_comes_last() {
        let table = table(&Scenario::default(), Path::new("/s.toml"), None);
        let roles: Vec<Role> = table.iter().map(|p| p.role).collect();
        assert_eq!(roles, [Role::Monitor, Role::Reference, Role::Controller, Role::Plant]);
        let plant = table.last().unwrap();
        assert_eq!(words(plant).join(" "), "plant --group g --id 1 --scenario /s.toml --parent 7");
        assert_eq!(plant.policy, Restart::End);
    }

    #[test]
    fn a_standby_is_a_second_controller_and_a_users_executable_gets_no_role_name() {
        let mut scenario = Scenario::default();
        scenario.controller.standby = 1;
        scenario.controller.exe = Some("/bin/mine".into());
        let table = table(&scenario, Path::new("/s.toml"), Some(Path::new("out")));
        let controllers: Vec<&Process> = table.iter().filter(|p| p.role == Role::Controller).collect();
        assert_eq!(controllers.iter().map(|p| p.id).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(words(controllers[1]).join(" "), "--group g --id 2 --scenario /s.toml --parent 7");
        assert_eq!(controllers[1].name(), "controller 2");
        let monitor = words(&table[0]).join(" ");
        assert_eq!(monitor, "monitor --group g --id 1 --scenario /s.toml --parent 7 --out out --managed");
    }
}
