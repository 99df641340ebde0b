//! `loopbound check`: verdicts on recorded runs, and what is written of any verdict.

use loopbound_model::quote;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use loopbound_monitor::Summary;
use loopbound_monitor::folder::{FolderError, Look, Manifest, known, recorded_scenario, refuse_file_of_a_run};
use loopbound_monitor::summary::Verdict;
use loopbound_monitor::verdict::blocks::{self, Blocks};
use loopbound_monitor::verdict::{expectations, judge_summary, reports};
use loopbound_scenario::ExpectSection;
use loopbound_scenario::input;
use loopbound_shared::headline::Headline;
use loopbound_shared::say;

use crate::commands::conclusion::conclude;
use crate::exit::{Exit, Failure};
use crate::supervise::{Record, write_whole};

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

pub(crate) fn read(folder: &Path, name: &str) -> Result<String, Failure> {
    let path = folder.join(name);
    input::read_file_text(&path, input::FIGURES_BYTES_MAX)
        .map_err(|e| Failure::usage(format!("{}: {e}", quote::path(&path))))
}

/// The blocks of a recorded run.
///
/// # Errors
/// If there are none, or they can't be understood.
pub fn read_blocks(folder: &Path) -> Result<Blocks, Failure> {
    let text = read(folder, blocks::FILE)?;
    Blocks::from_text(&text).map_err(|e| Failure::usage(format!("{}: {e}", quote::path(&folder.join(blocks::FILE)))))
}

/// Judges a recorded run.
///
/// # Errors
/// If its files or the expectations can't be read, or there is nothing to expect.
pub fn check(args: &CheckArgs) -> anyhow::Result<Exit> {
    let usage = |error: FolderError| Failure::usage(error.to_string());
    if let Some(path) = &args.junit {
        refuse_file_of_a_run(path, reports::FILE).map_err(usage)?;
    }
    let look = Look::at(&args.run).map_err(usage)?;
    if !look.is_whole() {
        return incomplete(args, &look);
    }
    let path = args.run.join("summary.json");
    let mut summary: Summary = serde_json::from_str(&read(&args.run, "summary.json")?)
        .map_err(|e| Failure::usage(format!("{}: {e}", quote::path(&path))))?;
    let section = match &args.expect {
        Some(path) => {
            let text = input::read_text(path, input::SCENARIO_BYTES_MAX)
                .map_err(|e| Failure::usage(format!("{}: {e}", quote::path(path))))?;
            ExpectSection::from_toml(&text, &quote::path(path))?
        }
        None => recorded_scenario(&read(&args.run, known::SCENARIO)?, &args.run)?.expect,
    };
    if section.conditions.is_empty() {
        return Err(Failure::usage("nothing is expected: give --expect FILE").into());
    }
    expectations::validate(&section).map_err(|e| Failure::usage(format!("expect: {e}")))?;
    let blocks = read_blocks(&args.run)?;
    summary.verdict = expectations::judge(&section, &summary, &blocks, judge_summary(&summary));
    // Absent in the files of a monitor that a user attached.
    if let Ok(record) = serde_json::from_value::<Record>(summary.supervision.clone()) {
        conclude(&mut summary, &record, None);
    }
    if let Some(path) = &args.junit {
        write_junit(path, &summary, &args.run)?;
    }
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", document(&summary.verdict, &look, &summary.written)?)?;
    } else {
        // A version that wrote no manifest drew no ids.
        let legacy = || format!("run of {}", summary.written);
        writeln!(out, "{}", look.manifest.as_ref().map_or_else(legacy, Manifest::whose))?;
        writeln!(out, "{}", reports::one_line(&summary.verdict))?;
        print_table(&mut out, &summary.verdict)?;
    }
    annotate(&summary.verdict);
    Ok(exit_of(&summary.verdict))
}

/// The verdict with the run that it is on.
fn document(verdict: &Verdict, look: &Look, written: &str) -> anyhow::Result<String> {
    let mut document = serde_json::to_value(verdict)?;
    let manifest = look.manifest.as_ref();
    document["run_id"] = serde_json::json!(manifest.map(|manifest| &manifest.run_id));
    document["begun"] = serde_json::json!(manifest.map_or(written, |manifest| &manifest.begun));
    Ok(serde_json::to_string_pretty(&document)?)
}

/// Nothing is judged by half a recording: the files may be those of two runs.
fn incomplete(args: &CheckArgs, look: &Look) -> anyhow::Result<Exit> {
    let mut summary = Summary::default();
    summary.verdict.status = Headline::Incomplete.word().to_owned();
    summary.verdict.reasons.clone_from(&look.faults);
    summary.run_id = look.manifest.as_ref().map(|manifest| manifest.run_id.clone()).unwrap_or_default();
    if let Some(path) = &args.junit {
        write_junit(path, &summary, &args.run)?;
    }
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", document(&summary.verdict, look, "")?)?;
    } else {
        writeln!(out, "{}", look.headline())?;
    }
    Ok(Headline::Incomplete.into())
}

/// The code that belongs to a verdict.
#[must_use]
pub fn exit_of(verdict: &Verdict) -> Exit {
    verdict.headline().into()
}

/// Writes the verdict on the run in `folder` for a build server.
///
/// # Errors
/// If it can't be written.
fn write_junit(path: &Path, summary: &Summary, folder: &Path) -> anyhow::Result<()> {
    let text = reports::junit(summary);
    let in_folder = std::path::absolute(path).ok() == std::path::absolute(folder.join(reports::FILE)).ok();
    if in_folder {
        return Ok(Look::rewrite(folder, reports::FILE, text.as_bytes()).map_err(|e| Failure::usage(e.to_string()))?);
    }
    write_whole(path, text.as_bytes()).with_context(|| quote::path(path))
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
