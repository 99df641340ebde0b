//! Shell completions and manual pages, made from the definition of the command line.

use loopbound_model::quote;
use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;
use clap_complete::Shell;

use loopbound_shared::say;

use crate::exit::Exit;

/// Prints the completions of `shell`.
///
/// # Errors
/// Never: [`say::lost`] tells of a lost output.
pub fn completions(shell: Shell, command: &mut clap::Command) -> anyhow::Result<Exit> {
    let mut text = Vec::new();
    clap_complete::generate(shell, command, "loopbound", &mut text);
    say::stdout().write_all(&text)?;
    Ok(Exit::Held)
}

/// Prints the manual page, or writes those of all commands to `folder`.
///
/// # Errors
/// If the folder can't be written.
pub fn manual(folder: Option<&Path>, command: clap::Command) -> anyhow::Result<Exit> {
    if let Some(folder) = folder {
        std::fs::create_dir_all(folder).with_context(|| quote::path(folder))?;
        clap_mangen::generate_to(command, folder).with_context(|| quote::path(folder))?;
    } else {
        let mut text = Vec::new();
        clap_mangen::Man::new(command).render(&mut text)?;
        say::stdout().write_all(&text)?;
    }
    Ok(Exit::Held)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::args::Cli;
    use clap::CommandFactory as _;

    #[test]
    fn every_visible_command_has_a_page_and_the_roles_have_none() {
        let folder = tempfile::tempdir().unwrap();
        manual(Some(folder.path()), Cli::command()).unwrap();
        for page in ["loopbound.1", "loopbound-run.1", "loopbound-model.1"] {
            assert!(folder.path().join(page).exists(), "{page}");
        }
        assert!(!folder.path().join("loopbound-plant.1").exists());
    }
}
