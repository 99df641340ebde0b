//! The arguments that the launcher passes to the executable of a user's controller.

use std::path::PathBuf;

use loopbound_shared::role::{RoleArgs, RoleError};

/// Reads `--group G --id N --scenario FILE [--parent PID]` as the launcher passes it to a user's controller.
///
/// # Errors
/// Names the argument that is missing or not understood.
pub fn parse_args(args: impl Iterator<Item = String>) -> Result<RoleArgs, RoleError> {
    let mut args = args.skip(1);
    let (mut group, mut id, mut scenario, mut parent) = (None, None, None, None);
    while let Some(key) = args.next() {
        let value = args.next().ok_or_else(|| RoleError::Other(format!("{key} needs a value")))?;
        let number = || value.parse().map_err(|_| RoleError::Other(format!("{key}: `{value}` is no number")));
        match key.as_str() {
            "--group" => group = Some(value.clone()),
            "--id" => id = Some(number()?),
            "--scenario" => scenario = Some(PathBuf::from(&value)),
            "--parent" => parent = Some(number()?),
            _ => return Err(RoleError::Other(format!("argument {key} is not understood"))),
        }
    }
    let missing = |key: &str| RoleError::Other(format!("{key} is missing: the launcher passes it"));
    Ok(RoleArgs {
        group: group.ok_or_else(|| missing("--group"))?,
        id: id.ok_or_else(|| missing("--id"))?,
        scenario: scenario.ok_or_else(|| missing("--scenario"))?,
        parent,
    })
}
