//! One exit code for each class of outcome, so that scripts need not read the text.

use std::process::ExitCode;

use loopbound_shared::group::GroupError;
use loopbound_shared::role::RoleError;
use loopbound_shared::scenario::ScenarioError;

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Everything held.
    Held = 0,
    /// An expectation failed, or the bound was violated other than by latency.
    Failed = 1,
    /// The command line or the scenario is wrong; nothing was started.
    Usage = 2,
    /// The run was too short to tell.
    Inconclusive = 3,
    /// A swap was refused or rolled back, or a fault was refused.
    SwapRefused = 4,
    /// A role died and was not recovered.
    RoleDied = 5,
    /// A fault of loopbound's own, or of the system under it.
    Internal = 70,
    /// Ctrl-C.
    Interrupted = 130,
    /// SIGTERM or SIGHUP.
    Terminated = 143,
}

impl Exit {
    /// The code that a shell sees.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The class of an error: what the user wrote, or what went wrong here.
    #[must_use]
    pub fn of(error: &anyhow::Error) -> Self {
        let wrong_group = |e: &GroupError| !matches!(e, GroupError::Folder { .. });
        let wrong_role = |e: &RoleError| match e {
            RoleError::Scenario(_) | RoleError::Usage(_) => true,
            RoleError::Group(group) => wrong_group(group),
            _ => false,
        };
        if let Some(failure) = error.downcast_ref::<Failure>() {
            return failure.exit;
        }
        let usage = error.is::<ScenarioError>()
            || error.downcast_ref::<GroupError>().is_some_and(wrong_group)
            || error.downcast_ref::<RoleError>().is_some_and(wrong_role);
        if usage { Self::Usage } else { Self::Internal }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

/// What went wrong in one line, with the exit code that belongs to it.
#[derive(Debug, PartialEq, Eq)]
pub struct Failure {
    /// Its class.
    pub exit: Exit,
    /// The line.
    pub message: String,
}

impl Failure {
    /// Something the user wrote can't be done.
    #[must_use]
    pub fn usage(message: impl Into<String>) -> Self {
        Self { exit: Exit::Usage, message: message.into() }
    }
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Failure {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_running_group_is_the_users_error_and_a_full_disc_is_not() {
        let running = anyhow::Error::new(GroupError::Running("a".into()));
        assert_eq!(Exit::of(&running), Exit::Usage);
        assert_eq!(Exit::of(&running.context("starting")), Exit::Usage);
        let folder = GroupError::Folder { path: "/x".into(), source: std::io::Error::other("full") };
        assert_eq!(Exit::of(&folder.into()), Exit::Internal);
        assert_eq!(Exit::of(&anyhow::Error::new(RoleError::Other("port".into()))), Exit::Internal);
    }
}
