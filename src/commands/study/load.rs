//! `loopbound study load`: which rate, wake-up mode and privileges this machine can keep, under which load, measured
//! on real process groups one after the other; and the setting with the smallest proven |e| among them.
//!
//! | module | responsible for |
//! |---|---|
//! | [`options`] | the command line, what it leaves open, and how long all of it takes |
//! | [`case`] | one case: its scenario, its runs added up, its row of the table |
//! | [`group`], [`cpu`] | one run of a real group, and the CPU that it took |
//! | [`design`] | from a latency to the gains that it allows |
//! | [`advice`], [`check`] | from the table to a recommendation, and the run that tries it |
//! | [`text`], [`pictures`], [`page`] | the table, heat maps, one page |

pub mod advice;
pub mod background;
pub mod case;
pub mod check;
pub mod cpu;
pub mod design;
pub mod group;
pub mod options;
pub mod page;
pub mod pictures;
pub mod text;

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

use anyhow::Context as _;
use loopbound_model::quote;
use loopbound_monitor::hops::Hop;
use loopbound_monitor::verdict::comparison::compare_hop;
use loopbound_scenario::system::advice::Remedy;
use loopbound_scenario::{Nanos, Scenario};
use loopbound_shared::clock;
use loopbound_shared::say;
use serde::Serialize;
use serde_json::Value;

use self::advice::{Advice, ForLoad, Limits, Ratio, advise, for_each_load};
use self::case::{Case, Measured, Row};
use self::check::{Check, recommended};
use self::design::{Designer, budget_used};
use self::group::{RunError, Runner};
pub use self::options::LoadArgs;
use self::options::{Plan, Quantile};
use self::text::percent;
use super::folder::{Asked, Folder, picture_files};
use crate::exit::Exit;
use crate::progress::Progress;
use crate::signals::Stop;
use crate::supervise::needs;

/// Version of `table.json`.
const REPORT_VERSION: u32 = 2;
/// Below this many ticks beyond a quantile, it is little more than the largest values.
const TICKS_BEYOND_MIN: f64 = 10.0;

/// All that the study found, as `table.json` has it.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Version of the keys.
    pub version: u32,
    /// When it ended, UTC.
    pub written: String,
    /// The command that made it.
    pub command: String,
    /// The machine, as the first run saw it.
    pub host: BTreeMap<String, Value>,
    /// Rounds that were asked for.
    pub rounds: u32,
    /// Length of a run, s, its start-up included.
    pub run_s: f64,
    /// Runs that were asked for.
    pub runs_planned: usize,
    /// Whether a signal ended it early.
    pub interrupted: bool,
    /// The quantile of deadline → torque that decides.
    pub quantile: Quantile,
    /// What a setting must keep.
    pub limits: Limits,
    /// Share of \[11] that a recommended gain uses.
    pub room: f64,
    /// A line a case.
    pub rows: Vec<Row>,
    /// What follows, if any of the loads may come.
    pub advice: Advice,
    /// What follows for each load by itself.
    pub for_each_load: Vec<ForLoad>,
    /// The recommendation, measured again.
    pub check: Option<Check>,
}

/// Runs the study, writes its folder, prints the recommendation.
///
/// # Errors
/// If an option or the scenario is refused, or the folder can't be written.
pub fn run(args: &LoadArgs) -> anyhow::Result<Exit> {
    let plan = args.plan()?;
    let folder = Asked::new(&args.out, "study-load", &files())?;
    needs::check(&plan.base)?;
    let stop = Stop::install().context("signals")?;
    // An earlier study's recommendation would pass for this one's.
    let mut folder = folder.take()?;
    // A name of its own: it is removed with all that is in it.
    let runner = Runner { folder: folder.path().join(format!("run-{}", std::process::id())), stop: &stop };
    announce(&plan, &folder);
    let designer = Designer::new(plan.base.clone(), plan.room);
    let mut study = Study {
        plan: &plan,
        designer: &designer,
        all: vec![Measured::default(); plan.cases.len()],
        host: BTreeMap::new(),
    };
    study.measure(&runner)?;
    let mut report = study.report(stop.requested().is_some());
    if let Some(setting) = report.advice.choice.map(|at| report.advice.settings[at].clone()) {
        let (case, scenario) = recommended(&plan, &designer, &report.rows, &setting);
        folder.write("recommended.toml", scenario.to_toml()?)?;
        if stop.requested().is_none() {
            report.check = check::run(&plan, &runner, &case, &scenario, &setting);
        }
    }
    write(&mut folder, &report)?;
    print(args, &report, &folder.finish()?)?;
    let found = report.check.as_ref().is_some_and(|check| check.against.is_empty());
    Ok(stop.requested().unwrap_or(if found { Exit::Held } else { Exit::Inconclusive }))
}

fn announce(plan: &Plan, folder: &Folder) {
    let minutes = plan.estimate_s() / 60.0;
    let long = if minutes < 1.5 { format!("{:.0} s", plan.estimate_s()) } else { format!("{minutes:.0} min") };
    say::err!(
        "loopbound: {} cases in {} round(s) of {}, one group at a time: about {long}; results in {}",
        plan.cases.len(),
        plan.rounds,
        Nanos(plan.run_ns),
        quote::path(folder.path())
    );
}

/// What is being measured.
struct Study<'a> {
    plan: &'a Plan,
    designer: &'a Designer,
    all: Vec<Measured>,
    host: BTreeMap<String, Value>,
}

impl Study<'_> {
    /// Runs every case in every round, until a signal comes; what was measured until then stays.
    fn measure(&mut self, runner: &Runner<'_>) -> anyhow::Result<()> {
        let progress = progress(self.plan.runs())?;
        'rounds: for round in 0..self.plan.rounds {
            for at in self.plan.round(round) {
                let case = self.plan.cases[at];
                progress.message(case.name());
                if self.refusal(&case).is_none() {
                    match runner.run(&case, &self.scenario(&case)?, self.plan.run_ns) {
                        Ok(run) => {
                            if self.host.is_empty() {
                                self.host.clone_from(&run.summary.host);
                            }
                            self.all[at].add(run);
                        }
                        Err(RunError::Refused(why)) => self.all[at].refused = Some(why),
                        Err(RunError::Failed(why)) => self.all[at].problems.push(why),
                        Err(RunError::Stopped(_)) => break 'rounds,
                    }
                } else {
                    self.all[at].refused = self.refusal(&case);
                }
                progress.advance();
            }
        }
        progress.finish();
        Ok(())
    }

    /// What one case was refused, every case with the same rights is.
    fn refusal(&self, case: &Case) -> Option<String> {
        let same = self.plan.cases.iter().zip(&self.all).filter(|(other, _)| other.rights == case.rights);
        same.into_iter().find_map(|(_, measured)| measured.refused.clone())
    }

    /// What is run for a case: the same for every mode and load.
    fn scenario(&self, case: &Case) -> anyhow::Result<Scenario> {
        Ok(self.designer.to_measure(&case.apply(&self.plan.base))?)
    }

    fn report(&self, interrupted: bool) -> Report {
        let plan = self.plan;
        let row = |(case, measured): (&Case, &Measured)| {
            let row = measured.row(case, plan.quantile);
            judged(row, self.designer, self.scenario(case).ok().as_ref())
        };
        let rows: Vec<Row> = plan.cases.iter().zip(&self.all).map(row).collect();
        let limits = Limits { missed_max: plan.missed_max, cpu_max: plan.cpu_max };
        let advice = advise(&rows, plan.quantile, limits, |a, b| self.ratio(a, b));
        Report {
            version: REPORT_VERSION,
            written: clock::wall_time(),
            command: std::env::args().skip(1).fold("loopbound".to_owned(), |line, word| format!("{line} {word}")),
            host: self.host.clone(),
            rounds: plan.rounds,
            run_s: clock::seconds(plan.run_ns),
            runs_planned: plan.runs(),
            interrupted,
            quantile: plan.quantile,
            limits,
            room: plan.room,
            for_each_load: for_each_load(&rows, plan.quantile, limits, |a, b| self.ratio(a, b)),
            rows,
            advice,
            check: None,
        }
    }

    /// The latency of case `b` over that of case `a`, by resampling their blocks.
    fn ratio(&self, a: usize, b: usize) -> Option<Ratio> {
        let ratios = compare_hop(Hop::DeadlineToTorque, self.all[a].blocks()?, self.all[b].blocks()?);
        let found = ratios.into_iter().find(|ratio| ratio.quantile == self.plan.quantile.key())?;
        Some(Ratio { ratio: found.ratio?, lower: found.lower, upper: found.upper })
    }
}

/// The row with what its latency allows.
fn judged(mut row: Row, designer: &Designer, measured: Option<&Scenario>) -> Row {
    let Some(latency) = row.latency else { return row };
    let smallest = |latency_ns: f64| designer.smallest(row.rate_hz, latency_ns);
    let found = smallest(latency.value_ns);
    let proven = |found: &Remedy| found.certificate.ultimate_e;
    row.e_proven_lower_rad = latency.lower_ns.and_then(smallest).as_ref().map(proven);
    row.e_proven_upper_rad = latency.upper_ns.and_then(smallest).as_ref().map(proven);
    row.e_proven_rad = found.as_ref().map(proven);
    row.k_t = found.map(|found| found.certificate.k_t());
    row.budget_used = measured.and_then(|scenario| budget_used(scenario, latency.value_ns).ok().flatten());
    row
}

impl Report {
    /// Machine, kernel, command and counts: what the figures are of.
    #[must_use]
    pub fn head(&self) -> Vec<String> {
        let text = |key: &str| self.host.get(key).and_then(Value::as_str).unwrap_or("unknown").to_owned();
        let cores = self.host.get("cores").and_then(Value::as_u64).map_or("?".to_owned(), |cores| cores.to_string());
        let guest =
            if self.host.get("virtualised").and_then(Value::as_bool) == Some(true) { ", virtual machine" } else { "" };
        let ran: u32 = self.rows.iter().map(|row| row.runs).sum();
        let ticks = self.rows.iter().map(|row| row.latency_ns.round_trip.n);
        let (least, most) = (ticks.clone().filter(|n| *n > 0).min().unwrap_or(0), ticks.clone().max().unwrap_or(0));
        let mut head = vec![
            format!("Machine: {}, {cores} cores{guest}; kernel {}", text("processor"), text("kernel")),
            format!("Command: `{}`, {}", self.command, self.written),
            format!(
                "n = {} round trips in {ran} of {} runs of {:.1} s, {least} to {most} a case",
                ticks.sum::<u64>(),
                self.runs_planned,
                self.run_s
            ),
        ];
        if self.interrupted {
            head.push("Interrupted: the table holds what was measured until then.".to_owned());
        }
        let beyond = least as f64 * self.quantile.rest();
        if beyond < TICKS_BEYOND_MIN {
            let q = self.quantile.name();
            head.push(format!(
                "Few data: {q} of the shortest case rests on {beyond:.1} ticks; a longer --duration tells more."
            ));
        }
        head
    }

    /// By which rules the recommendation was computed.
    #[must_use]
    pub fn rules(&self) -> String {
        format!(
            "A setting counts by its worst load. It has to miss at most {} of its ticks, take at most {} of one core, and have a \
             certificate at its latency, the {} of deadline → torque. The proven |e| is the smallest whose gains use at most {} of \
             [11] with every constant delay up to that latency. Latencies are compared by resampling blocks of 250 ms. \
             Missed ticks that the host may have caused count like any other, and are shown apart.",
            percent(Some(self.limits.missed_max)),
            percent(Some(self.limits.cpu_max)),
            self.quantile.name(),
            percent(Some(self.room))
        )
    }
}

/// On a terminal only.
fn progress(runs: usize) -> anyhow::Result<Progress> {
    let bar = say::err_to_terminal().then_some("{bar:30} {pos} of {len}, {eta} left  {msg}");
    Progress::start(runs as u64, bar).context("progress")
}

fn files() -> Vec<String> {
    let texts = ["table.csv", "table.json", "report.md", "load.html", "recommended.toml"].map(str::to_owned);
    texts.into_iter().chain(picture_files("load")).collect()
}

fn write(folder: &mut Folder, report: &Report) -> anyhow::Result<()> {
    folder.write("table.csv", text::csv(report))?;
    folder.write("table.json", serde_json::to_string_pretty(report)?)?;
    folder.picture("load", &pictures::maps(report))?;
    folder.write("report.md", text::markdown(report))?;
    folder.write("load.html", page::page(report))
}

fn print(args: &LoadArgs, report: &Report, folder: &Path) -> anyhow::Result<()> {
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(report)?)?;
        return Ok(());
    }
    for line in report.head() {
        writeln!(out, "{line}")?;
    }
    for rate in &report.advice.rates {
        writeln!(out, "\n{}: {}", loopbound_scenario::format_rate(rate.rate_hz), rate.words)?;
    }
    writeln!(out)?;
    for only in &report.for_each_load {
        writeln!(out, "Under load {} alone: {}", only.load.name(), only.words)?;
    }
    writeln!(out, "\nRecommended: {}", report.advice.words)?;
    if let Some(check) = &report.check {
        writeln!(out, "{}", check.words)?;
    }
    writeln!(out, "\nwritten to {}", quote::path(folder))?;
    Ok(())
}

#[cfg(test)]
mod tests;
