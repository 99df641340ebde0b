//! One exit code for each class of outcome, so that scripts need not read the text; the codes are those of the table of
//! headlines.

use std::process::ExitCode;

use loopbound_scenario::ScenarioError;
use loopbound_shared::group::GroupError;
use loopbound_shared::headline::Headline;
use loopbound_shared::role::RoleError;

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// Everything held.
    Held = Headline::Held.exit_code(),
    /// An expectation failed, the bound was violated other than by the age of the torque, or the loop diverged.
    Failed = Headline::Failed.exit_code(),
    /// The command line or the scenario is wrong; nothing was started.
    Usage = Headline::Usage.exit_code(),
    /// The run was too short to tell.
    Inconclusive = Headline::Inconclusive.exit_code(),
    /// A swap was refused or rolled back, or a fault was refused.
    SwapRefused = Headline::SwapRefused.exit_code(),
    /// A role died and was not recovered, or the run is incomplete.
    RoleDied = Headline::RoleLost.exit_code(),
    /// A fault of loopbound's own, or of the system under it.
    Internal = Headline::Internal.exit_code(),
    /// Ctrl-C.
    Interrupted = Headline::Interrupted.exit_code(),
    /// SIGTERM or SIGHUP.
    Terminated = Headline::Terminated.exit_code(),
}

impl From<Headline> for Exit {
    fn from(headline: Headline) -> Self {
        match headline {
            Headline::Usage => Self::Usage,
            Headline::Interrupted => Self::Interrupted,
            Headline::Terminated => Self::Terminated,
            Headline::Internal => Self::Internal,
            Headline::Diverged | Headline::Failed | Headline::Violated => Self::Failed,
            Headline::RoleLost | Headline::Incomplete => Self::RoleDied,
            Headline::SwapRefused => Self::SwapRefused,
            Headline::NoData | Headline::Inconclusive | Headline::NotChecked => Self::Inconclusive,
            Headline::Late | Headline::NotCertified | Headline::Passed | Headline::Held => Self::Held,
        }
    }
}

impl Exit {
    /// The code that a shell sees.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }

    /// The gravest headline that ends with it.
    #[must_use]
    pub fn headline(self) -> Headline {
        let same = |headline: &Headline| headline.exit_code() == self.code();
        Headline::first_of(Headline::ALL.into_iter().filter(same)).unwrap_or(Headline::Internal)
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

/// What was tried, then why it failed, without saying anything twice: some errors quote their cause themselves.
pub(crate) fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for part in error.chain().map(ToString::to_string) {
        if line.is_empty() {
            line = part;
        } else if !line.contains(&part) {
            line = format!("{line}: {part}");
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_headline_ends_with_the_code_of_its_table() {
        for headline in Headline::ALL {
            assert_eq!(Exit::from(headline).code(), headline.exit_code(), "{headline}");
        }
    }

    #[test]
    fn a_running_group_is_the_users_error_and_a_full_disc_is_not() {
        let running = anyhow::Error::new(GroupError::Running("a".into()));
        assert_eq!(Exit::of(&running), Exit::Usage);
        assert_eq!(Exit::of(&running.context("starting")), Exit::Usage);
        let folder = GroupError::Folder { path: "/x".into(), source: std::io::Error::other("full") };
        assert_eq!(Exit::of(&folder.into()), Exit::Internal);
        assert_eq!(Exit::of(&anyhow::Error::new(RoleError::Other("port".into()))), Exit::Internal);
    }

    #[test]
    fn an_error_line_says_no_cause_twice() {
        let quoted = anyhow::anyhow!("no such file").context("x.toml: no such file").context("reading");
        assert_eq!(one_line(&quoted), "reading: x.toml: no such file");
    }
}
