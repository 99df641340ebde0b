//! `loopbound scenario`: every key of a scenario with its default, for people, or as a schema for editors.

use std::io::Write as _;

use clap::Args;
use loopbound_scenario::Scenario;
use loopbound_shared::say;

use crate::exit::Exit;

/// `loopbound scenario`.
#[derive(Debug, Args)]
pub struct KeysArgs {
    /// Print the JSON schema instead, by which editors complete keys and mark mistakes.
    #[arg(long)]
    pub schema: bool,
}

/// Prints the default scenario with a comment for each key, or the schema.
///
/// # Errors
/// Never: [`say::lost`] tells of a lost output.
pub fn run(args: &KeysArgs) -> anyhow::Result<Exit> {
    let text = if args.schema { format!("{:#}\n", Scenario::json_schema()) } else { Scenario::annotated() };
    say::stdout().write_all(text.as_bytes())?;
    Ok(Exit::Held)
}
