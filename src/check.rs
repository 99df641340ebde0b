//! `loopbound check` and `loopbound compare`: verdicts on recorded runs, and what is written of any verdict.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use loopbound_monitor::Summary;
use loopbound_monitor::summary::Verdict;
use loopbound_monitor::verdict::blocks::{self, Blocks};
use loopbound_monitor::verdict::{comparison, expectations, judge_summary, reports};
use loopbound_shared::say;
use loopbound_shared::scenario::{ExpectSection, Scenario};

use crate::exit::{Exit, Failure};

/// `loopbound check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Folder of a run (`run --out DIR`).
    pub run: PathBuf,
    /// What it must show (TOML); default the `expect` section of its scenario.
    #[arg(long, value_name = "FILE")]
    pub expect: Option<PathBuf>,
    /// Write the verdict as JUnit XML too.
    #[arg(long, value_name = "FILE")]
    pub junit: Option<PathBuf>,
    /// Print one JSON document instead of the table.
    #[arg(long)]
    pub json: bool,
}

/// `loopbound compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Folder of the first run: the divisor.
    pub a: PathBuf,
    /// Folder of the second run.
    pub b: PathBuf,
    /// Print one JSON document instead of the table.
    #[arg(long)]
    pub json: bool,
}

fn read(folder: &Path, name: &str) -> Result<String, Failure> {
    let path = folder.join(name);
    std::fs::read_to_string(&path).map_err(|e| Failure::usage(format!("{}: {e}", path.display())))
}

/// The blocks of a recorded run.
///
/// # Errors
/// If there are none, or they can't be understood.
pub fn read_blocks(folder: &Path) -> Result<Blocks, Failure> {
    let text = read(folder, blocks::FILE)?;
    Blocks::from_text(&text).map_err(|e| Failure::usage(format!("{}: {e}", folder.join(blocks::FILE).display())))
}

/// Judges a recorded run.
///
/// # Errors
/// If its files or the expectations can't be read, or there is nothing to expect.
pub fn check(args: &CheckArgs) -> anyhow::Result<Exit> {
    let path = args.run.join("summary.json");
    let mut summary: Summary = serde_json::from_str(&read(&args.run, "summary.json")?)
        .map_err(|e| Failure::usage(format!("{}: {e}", path.display())))?;
    let section = match &args.expect {
        Some(path) => {
            let text = std::fs::read_to_string(path).map_err(|e| Failure::usage(format!("{}: {e}", path.display())))?;
            ExpectSection::from_toml(&text, &path.display().to_string())?
        }
        None => Scenario::load(&args.run.join("scenario.toml"))?.expect,
    };
    if section.conditions.is_empty() {
        return Err(Failure::usage("nothing is expected: give --expect FILE").into());
    }
    expectations::validate(&section).map_err(|e| Failure::usage(format!("expect: {e}")))?;
    let blocks = read_blocks(&args.run)?;
    summary.verdict = expectations::judge(&section, &summary, &blocks, judge_summary(&summary));
    if let Some(path) = &args.junit {
        write_junit(path, &summary)?;
    }
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&summary.verdict)?)?;
    } else {
        writeln!(out, "{}", reports::one_line(&summary.verdict))?;
        print_table(&mut out, &summary.verdict)?;
    }
    annotate(&summary.verdict);
    Ok(exit_of(&summary.verdict))
}

/// Compares two recorded runs.
///
/// # Errors
/// If their blocks can't be read.
pub fn compare(args: &CompareArgs) -> anyhow::Result<Exit> {
    let ratios = comparison::compare(&read_blocks(&args.a)?, &read_blocks(&args.b)?);
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&ratios)?)?;
    } else {
        write!(out, "{}", comparison::table(&ratios))?;
    }
    Ok(Exit::Held)
}

/// The code that belongs to a verdict.
#[must_use]
pub fn exit_of(verdict: &Verdict) -> Exit {
    verdict.headline().into()
}

/// Writes the verdict for a build server.
///
/// # Errors
/// If it can't be written.
pub fn write_junit(path: &Path, summary: &Summary) -> anyhow::Result<()> {
    std::fs::write(path, reports::junit(summary)).with_context(|| path.display().to_string())
}

/// The table of expectations, if there are any.
///
/// # Errors
/// If it can't be printed.
pub fn print_table(out: &mut impl Write, verdict: &Verdict) -> std::io::Result<()> {
    write!(out, "{}", reports::table(verdict))
}

/// On a build host of GitHub's, which reads standard error too: standard output may hold a document.
pub fn annotate(verdict: &Verdict) {
    if std::env::var_os("GITHUB_ACTIONS").is_some_and(|value| value == "true") {
        reports::annotations(verdict).lines().for_each(|line| say::err!("{line}"));
    }
}
