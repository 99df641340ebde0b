//! `loopbound run`: from a scenario to one screen.

mod finish;
mod guests;

use std::io::Write as _;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use loopbound_model::quote;
use loopbound_monitor::Summary;
use loopbound_monitor::live::{Address, Origin};
use loopbound_monitor::verdict::expectations;
use loopbound_scenario::input;
use loopbound_scenario::{ExpectSection, Scenario};
use loopbound_shared::headline::Headline;
use loopbound_shared::realtime::die_with_parent;
use loopbound_shared::say;
use serde_json::Value;

use crate::commands::check;
use crate::commands::conclusion;
use crate::commands::options::ScenarioArgs;
use crate::exit::{Exit, Failure, one_line};
use crate::progress::Progress;
use crate::signals::Stop;
use crate::supervise::needs;
use crate::supervise::results::Asked;
use crate::supervise::{self, Options, Outcome, ProcessRecord, Record};

use guests::Guest;

/// Width of the report.
const SCREEN_COLUMNS: usize = 100;

/// `loopbound run`.
#[derive(Debug, Default, Args)]
pub struct RunArgs {
    /// What is run.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// Name of the group; default one of its own.
    #[arg(long, value_name = "NAME")]
    pub group: Option<String>,
    /// Folder for summary.json, samples.csv, histograms, events and the scenario.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print one JSON document instead of the report.
    #[arg(long)]
    pub json: bool,
    /// What the run must show (TOML), in place of the scenario's `expect` section.
    #[arg(long, value_name = "FILE")]
    pub expect: Option<PathBuf>,
    /// Draw the run on the terminal while it lasts.
    #[arg(long, conflicts_with_all = ["json", "quiet"])]
    pub tui: bool,
    /// Serve the run live over the Foxglove WebSocket protocol at HOST:PORT, HOST or PORT; default host 127.0.0.1, default
    /// port 8765.
    #[arg(long, value_name = "ADDR")]
    pub foxglove: Option<Address>,
    /// Let web pages of this origin look too, such as `https://viewer.example:8080`. Those of Foxglove and of this machine may
    /// anyway.
    #[arg(long = "foxglove-origin", value_name = "ORIGIN", requires = "foxglove")]
    pub foxglove_origins: Vec<Origin>,
    /// The study that this run is a part of: the run ends when it does.
    #[arg(long, hide = true)]
    pub parent: Option<u32>,
    /// No progress, no notes and no report: only files, the exit code and errors.
    #[arg(long, short)]
    pub quiet: bool,
}

/// Starts the group, waits for its end, and reports.
///
/// # Errors
/// If the scenario or the group is refused, or the group could not start.
pub fn run(args: &RunArgs) -> anyhow::Result<Exit> {
    let scenario = scenario(args)?;
    let asked = args.out.as_deref().map(|folder| Asked::for_run(folder, &scenario)).transpose()?;
    needs::check(&scenario)?;
    // From here on a signal ends the group in order.
    let stop = Stop::install().context("signals")?;
    run_until(&stop, args, &scenario, asked).map_err(|error| match stop.requested() {
        Some(signal) => met_by(signal, error),
        None => error,
    })
}

/// A group that a signal meets in the middle of its start fails in many ways: the reason is the signal unless the error is graver,
/// and what went wrong is said all the same.
fn met_by(signal: Exit, error: anyhow::Error) -> anyhow::Error {
    let (of_signal, of_error) = (signal.headline(), Exit::of(&error).headline());
    if Headline::first_of([of_signal, of_error]) == Some(of_error) {
        return error;
    }
    Failure { exit: signal, message: format!("{}; {}", of_signal.sentence(), one_line(&error)) }.into()
}

fn run_until(stop: &Stop, args: &RunArgs, scenario: &Scenario, asked: Option<Asked>) -> anyhow::Result<Exit> {
    if let Some(parent) = args.parent {
        die_with_parent(parent)?;
    }
    let options = Options {
        group: args.group.clone().unwrap_or_else(|| format!("lb-{}", std::process::id())),
        progress: progress(args, scenario).context("progress")?,
        quiet: args.quiet || args.tui,
        stop,
    };
    let quiet = options.quiet;
    if !quiet {
        needs::notes(scenario).into_iter().for_each(|note| options.progress.note(note));
        scenario.in_vain().iter().for_each(|line| say::err!("loopbound: {line}"));
    }
    let server = args
        .foxglove
        .as_ref()
        .map(|address| Guest::server(&options.group, address, &args.foxglove_origins, quiet))
        .transpose()?;
    let view = args.tui.then(|| Guest::view(&options.group)).transpose()?;
    let outcome = supervise::supervise(scenario, &options, asked)?;
    [view, server].into_iter().flatten().for_each(Guest::leave);
    report(args, outcome)
}

fn scenario(args: &RunArgs) -> anyhow::Result<Scenario> {
    let mut scenario = args.scenario.load_system(args.quiet)?;
    if let Some(path) = &args.expect {
        let text = input::read_text(path, input::SCENARIO_BYTES_MAX)
            .map_err(|e| Failure::usage(format!("{}: {e}", quote::path(path))))?;
        scenario.expect = ExpectSection::from_toml(&text, &quote::path(path))?;
    }
    expectations::validate(&scenario.expect).map_err(|e| Failure::usage(format!("expect: {e}")))?;
    Ok(scenario)
}

/// On a terminal only. Nothing when piped or with `--json`.
fn progress(args: &RunArgs, scenario: &Scenario) -> std::io::Result<Progress> {
    let hidden = args.quiet || args.json || args.tui || !say::err_to_terminal();
    let bar = (!hidden).then_some("{bar:40} {percent:>3} %  tick {human_pos} of {human_len}  {elapsed}");
    Progress::start(scenario.loop_.ticks(), bar)
}

fn report(args: &RunArgs, outcome: Outcome) -> anyhow::Result<Exit> {
    let Outcome { record, summary, results, stopped } = outcome;
    let mut summary = summary.map(|value| complete(value, &record)).transpose()?;
    if let Some(summary) = &mut summary {
        conclusion::conclude(summary, &record, stopped);
    }
    match (results, &mut summary) {
        (Some(results), Some(summary)) => finish::finish(results, summary),
        (Some(results), None) => results.leave_unfinished("the monitor left no summary"),
        (None, _) => {}
    }
    if let Some(summary) = &mut summary {
        conclusion::conclude_recording(summary);
    }
    let (headline, reasons) = summary.as_ref().map_or_else(
        || conclusion::without_summary(&record, stopped),
        |summary| (summary.verdict.headline(), Vec::new()),
    );
    let mut stdout = say::stdout();
    match &summary {
        Some(summary) if args.json => writeln!(stdout, "{}", serde_json::to_string_pretty(summary)?)?,
        Some(summary) if !args.quiet => {
            let colour = say::in_colour(say::to_terminal());
            write!(stdout, "{}", loopbound_monitor::render(summary, SCREEN_COLUMNS, colour))?;
            check::print_table(&mut stdout, &summary.verdict)?;
        }
        // Whoever waits for a document gets one, even if the monitor could not write its part.
        None if args.json => {
            let verdict = serde_json::json!({"status": headline.word(), "reasons": reasons});
            let nothing = serde_json::json!({"supervision": record, "verdict": verdict});
            writeln!(stdout, "{}", serde_json::to_string_pretty(&nothing)?)?;
        }
        _ => {}
    }
    if let Some(summary) = &summary {
        check::annotate(&summary.verdict);
    }
    let notes = if args.quiet { Vec::new() } else { said(&record) };
    for line in errors(&record, summary.as_ref()).into_iter().chain(notes) {
        say::err!("loopbound: {line}");
    }
    Ok(headline.into())
}

/// The monitor's summary with the launcher's part in it.
fn complete(mut value: Value, record: &Record) -> anyhow::Result<Summary> {
    value["supervision"] = serde_json::to_value(record)?;
    serde_json::from_value(value).context("the monitor's summary")
}

/// What went wrong with the group itself, said in every case.
fn errors(record: &Record, summary: Option<&Summary>) -> Vec<String> {
    let mut errors = Vec::new();
    if record.end != "done" {
        errors.push(format!("the group ended early: {}", record.end));
    }
    // Those that were recovered were noted when it happened.
    errors.extend(record.deaths.iter().filter(|death| !death.recovered).map(ToString::to_string));
    let Some(summary) = summary else {
        errors.push("the monitor left no summary".to_owned());
        return errors;
    };
    errors.extend(summary.recording.as_ref().and_then(|recording| recording.shortfall(&summary.dropped)));
    errors
}

/// What the processes said, which the report does not show.
fn said(record: &Record) -> Vec<String> {
    let lines = |process: &ProcessRecord| {
        let who = format!("{} {}", process.role, process.id);
        process.said.iter().map(|line| format!("{who}: {line}")).collect::<Vec<_>>()
    };
    record.processes.iter().flat_map(lines).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::supervise::Death;

    fn died(recovered: bool) -> Record {
        let death =
            Death { role: "controller".into(), id: 1, pid: 1, tick: 5, how: "killed (SIGKILL)".into(), recovered };
        Record { end: "done".into(), deaths: vec![death], ..Record::default() }
    }

    #[test]
    fn a_signal_in_the_middle_of_a_start_counts_by_its_place_in_the_table_and_hides_no_error() {
        let lost =
            || anyhow::Error::new(Failure { exit: Exit::RoleDied, message: "controller 1 did not start".into() });
        let met = met_by(Exit::Terminated, lost().context("starting"));
        assert_eq!(Exit::of(&met), Exit::Terminated);
        let words = met.to_string();
        assert!(words.contains("SIGTERM") && words.ends_with("starting: controller 1 did not start"), "{words}");
        assert_eq!(Exit::of(&met_by(Exit::Interrupted, anyhow::anyhow!("no port"))), Exit::Interrupted);
        let usage = met_by(Exit::Interrupted, Failure::usage("a typo").into());
        assert_eq!((Exit::of(&usage), usage.to_string()), (Exit::Usage, "a typo".to_owned()));
    }

    #[test]
    fn an_unrecovered_death_is_named_with_its_tick() {
        let errors = errors(&died(false), None);
        assert!(errors[0].contains("controller 1: killed (SIGKILL) in tick 5, not recovered"), "{errors:?}");
    }
}
