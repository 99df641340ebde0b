//! `loopbound clean`: removes what killed groups left behind.

use std::io::Write as _;

use loopbound_shared::group;
use loopbound_shared::say;

use crate::exit::Exit;

/// Sweeps every dead group of this user and names them.
///
/// # Errors
/// If the runtime directory is not this user's own.
pub fn run() -> anyhow::Result<Exit> {
    let swept = group::clean()?;
    let mut out = say::stdout();
    if swept.is_empty() {
        writeln!(out, "nothing to clean")?;
    }
    for name in swept {
        writeln!(out, "cleaned {name}")?;
    }
    for group in group::list()?.into_iter().filter(|g| !g.alive) {
        say::err!("loopbound: {} could not be cleaned: is it another user's?", group.name);
    }
    Ok(Exit::Held)
}
