//! `loopbound report`: the page of a recorded run, or of two side by side.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use loopbound_monitor::report::{page, read_run};
use loopbound_shared::headline::Headline;

use loopbound_shared::say;

use crate::exit::{Exit, Failure};
use crate::supervise::write_whole;

/// `loopbound report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Folder of a run, as `run --out` wrote it.
    pub run: PathBuf,
    /// A second one, to be shown beside it.
    pub other: Option<PathBuf>,
    /// Where the page goes; default report.html in the (first) folder.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// Writes the page.
///
/// # Errors
/// If a run can't be read, or the page can't be written.
pub fn run(args: &ReportArgs) -> anyhow::Result<Exit> {
    let folders: Vec<&Path> = std::iter::once(args.run.as_path()).chain(args.other.as_deref()).collect();
    let path = args.out.clone().unwrap_or_else(|| args.run.join("report.html"));
    let worst = write(&folders, &path)?;
    say::out!("{}", path.display());
    Ok(worst.map_or(Exit::Held, Exit::from))
}

/// Writes the page of some runs to `path`. The headline of a run whose figures are not those of a whole control loop.
///
/// # Errors
/// If a run can't be read, or the page can't be written.
pub fn write(folders: &[&Path], path: &Path) -> anyhow::Result<Option<Headline>> {
    let read = |folder: &&Path| read_run(folder).map_err(|error| Failure::usage(error.to_string()));
    let runs = folders.iter().map(read).collect::<Result<Vec<_>, _>>()?;
    write_whole(path, page(&runs).as_bytes()).with_context(|| path.display().to_string())?;
    let headlines = runs.iter().filter_map(|run| Headline::of_word(run.summary["verdict"]["status"].as_str()?));
    let partial =
        |headline: &Headline| matches!(headline, Headline::Diverged | Headline::RoleLost | Headline::Incomplete);
    Ok(Headline::first_of(headlines.filter(partial)))
}
