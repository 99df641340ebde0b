//! `loopbound report`: the page of a recorded run, or of two side by side.

use loopbound_model::quote;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use loopbound_monitor::folder::{Look, refuse_file_of_a_run};
use loopbound_monitor::report::{Run, page, read_run};
use loopbound_shared::headline::Headline;

use loopbound_shared::say;

use crate::exit::{Exit, Failure};
use crate::supervise::write_whole;

/// Name of the page in the folder of its run.
pub const FILE: &str = "report.html";

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

/// Writes the page; of recordings that are not whole it shows what there is.
///
/// # Errors
/// If a run can't be read, or the page can't be written.
pub fn run(args: &ReportArgs) -> anyhow::Result<Exit> {
    let usage = |error: loopbound_monitor::folder::FolderError| Failure::usage(error.to_string());
    if let Some(path) = &args.out {
        refuse_file_of_a_run(path, FILE).map_err(usage)?;
    }
    let folders = std::iter::once(&args.run).chain(&args.other);
    let looks = folders.map(|folder| Look::at(folder).map_err(usage)).collect::<Result<Vec<_>, _>>()?;
    let runs = looks.iter().map(|look| read(&look.folder, look)).collect::<Result<Vec<_>, _>>()?;
    let path = args.out.clone().unwrap_or_else(|| args.run.join(FILE));
    let text = page(&runs);
    if path == args.run.join(FILE) {
        Look::rewrite(&args.run, FILE, text.as_bytes()).map_err(usage)?;
    } else {
        write_whole(&path, text.as_bytes()).with_context(|| quote::path(&path))?;
    }
    say::out!("{}", quote::whole_path(&path));
    for look in looks.iter().filter(|look| !look.is_whole()) {
        say::err!("loopbound: {}", look.headline());
    }
    // The headline of a run whose figures are not those of a whole control loop.
    let headlines = runs.iter().filter_map(|run| Headline::of_word(run.summary["verdict"]["status"].as_str()?));
    let partial =
        |headline: &Headline| matches!(headline, Headline::Diverged | Headline::RoleLost | Headline::Incomplete);
    let broken = looks.iter().any(|look| !look.is_whole()).then_some(Headline::Incomplete);
    let worst = Headline::first_of(headlines.filter(partial).chain(broken));
    Ok(worst.map_or(Exit::Held, Exit::from))
}

fn read(folder: &Path, look: &Look) -> Result<Run, Failure> {
    read_run(folder, &look.faults).map_err(|error| Failure::usage(error.to_string()))
}

/// The page of some runs, the files of which are there.
///
/// # Errors
/// If a run can't be read.
pub fn page_of(folders: &[&Path]) -> Result<String, Failure> {
    let read = |folder: &&Path| read_run(folder, &[]).map_err(|error| Failure::usage(error.to_string()));
    Ok(page(&folders.iter().map(read).collect::<Result<Vec<_>, _>>()?))
}
