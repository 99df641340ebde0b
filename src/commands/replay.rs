//! `loopbound replay`: a recorded run through the same code again, to the bit; or what it would have been with another
//! law or another plant.
//!
//! Responsible for reading the run, comparing, and saying what was found. One tick computed again is [`engine`]'s.

pub mod engine;

use loopbound_model::quote;
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use loopbound_model::law::LawKind;
use loopbound_model::with_links;
use loopbound_monitor::folder::{self as manifest, FolderError, Look, known, recorded_scenario};
use loopbound_monitor::judge::Judge;
use loopbound_monitor::recording::reader::{Item, ReadError, Recording};
use loopbound_monitor::verdict::expectations::judge;
use loopbound_monitor::verdict::judge_summary;
use loopbound_monitor::{Config, Summary, Tracker};
use loopbound_scenario::Scenario;
use loopbound_scenario::input;
use loopbound_shared::event::Role;
use loopbound_shared::headline::Headline;
use loopbound_shared::sample::{Announce, SEGMENTS_MAX, TickRecord};
use loopbound_shared::say;
use serde::Serialize;

use crate::exit::{Exit, Failure};
use engine::Engine;

/// `loopbound replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Folder of a run, as `run --out` wrote it, or a samples.mcap.
    pub run: PathBuf,
    /// What if: another law for the scenario's own controllers.
    #[arg(long, value_parser = crate::commands::options::word::<LawKind>, value_name = "LAW")]
    pub law: Option<LawKind>,
    /// What if: another value of a key of the scenario, such as plant.mass_error=0.1; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Print one JSON document instead of the report.
    #[arg(long)]
    pub json: bool,
}

/// The first thing that came out otherwise.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Where.
    pub tick: u64,
    /// What: `q`, `v`, `measured`, `torque`, `V`.
    pub what: &'static str,
    /// As recorded, and as computed.
    pub values: [f64; 2],
}

/// What a replay found.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Ticks computed again.
    pub ticks: u64,
    /// The run's id; none in recordings of versions that had none, and of a file without its folder.
    pub run_id: Option<String>,
    /// Why the recording is not whole: one line each.
    pub incomplete: Vec<String>,
    /// Torques computed again.
    pub torques_recomputed: u64,
    /// Torques taken as recorded.
    pub torques_as_recorded: u64,
    /// How many of them for which reason.
    pub as_recorded_because: BTreeMap<&'static str, u64>,
    /// Whether this was a what-if: then nothing is compared.
    pub what_if: bool,
    /// The first tick after a gap in the records, where the replay stopped.
    pub stopped_at_gap: Option<u64>,
    /// Whether the recording was cut off.
    pub cut_off: bool,
    /// The first difference.
    pub difference: Option<Difference>,
    /// Values that differ.
    pub differences: u64,
    /// The verdict of the recorded run, where it was written.
    pub verdict_recorded: Option<String>,
    /// The verdict computed again.
    pub verdict: String,
    /// Its reasons.
    pub reasons: Vec<String>,
    /// Largest |e_i| of one link once settled, rad.
    pub max_abs_e_rad: Option<f64>,
    /// Largest ‖e‖ of all links once settled, rad.
    pub max_norm_e_rad: Option<f64>,
    /// Largest V.
    pub v_max: Option<f64>,
    /// Its unit.
    pub v_unit: Option<String>,
}

/// Replays a run, and reports.
///
/// # Errors
/// If the run can't be read, is of another build, or the changed scenario is refused.
pub fn run(args: &ReplayArgs) -> anyhow::Result<Exit> {
    let path = recording_path(&args.run);
    let look = look(&args.run)?;
    let incomplete = look.as_ref().map(|look| look.faults.clone()).unwrap_or_default();
    let mut report = if incomplete.is_empty() || path.exists() {
        again(args, &path)?
    } else {
        // Its run ended before the first record was on the disk.
        Report::default()
    };
    if !report.what_if {
        report.verdict_recorded = verdict_recorded(&args.run, incomplete.is_empty())?;
    }
    report.run_id = look.as_ref().and_then(|look| look.manifest.as_ref()).map(|manifest| manifest.run_id.clone());
    report.incomplete = incomplete;
    if report.cut_off && report.incomplete.is_empty() {
        report.incomplete.push("the recording was cut off".to_owned());
    }
    let mut stdout = say::stdout();
    if args.json {
        writeln!(stdout, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        write!(stdout, "{}", render(&report))?;
    }
    Ok(exit_of(&report))
}

/// What is known of the folder; none for a recording that stands for itself.
fn look(run: &Path) -> Result<Option<Look>, Failure> {
    let usage = |error: FolderError| Failure::usage(error.to_string());
    if run.is_dir() {
        return Look::at(run).map(Some).map_err(usage);
    }
    let named_so = run.file_name().is_some_and(|name| name == known::SAMPLES);
    let folder = run.parent().filter(|folder| named_so && folder.join(manifest::FILE).exists());
    folder.map(Look::at).transpose().map_err(usage)
}

fn again(args: &ReplayArgs, path: &Path) -> anyhow::Result<Report> {
    let recording = Recording::open(path).map_err(|error| refuse(path, &error))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let recorded = recorded_scenario(&recording.header().scenario, folder)?;
    let scenario = changed(args, &recorded)?;
    let what_if = !args.set.is_empty() || args.law.is_some();
    let links = recorded.links();
    with_links!(links, replay::<N>(recording, &scenario, what_if, path))
}

/// The verdict in the folder of the run. Where files are not as written it may be unreadable, and is no more than
/// a hint.
fn verdict_recorded(run: &Path, whole: bool) -> Result<Option<String>, Failure> {
    let path = run.join(known::SUMMARY);
    if !path.exists() {
        return Ok(None);
    }
    let text = input::read_file(&path, input::SUMMARY_BYTES_MAX).map_err(|error| error.to_string());
    match text.and_then(|text| serde_json::from_slice::<Summary>(&text).map_err(|error| error.to_string())) {
        Ok(summary) => Ok(Some(summary.verdict.status)),
        Err(error) if whole => Err(Failure::usage(format!("{}: {error}", quote::path(&path)))),
        Err(_) => Ok(None),
    }
}

fn recording_path(run: &Path) -> PathBuf {
    if run.is_dir() { run.join("samples.mcap") } else { run.to_owned() }
}

fn refuse(path: &Path, error: &ReadError) -> Failure {
    Failure::usage(format!("{}: {error}", quote::path(path)))
}

/// The scenario with what is to be otherwise; the time grid, the motion and the number of links stay as recorded.
fn changed(args: &ReplayArgs, recorded: &Scenario) -> anyhow::Result<Scenario> {
    let law = args.law.map(|law| format!("controller.law={law}"));
    let settings: Vec<String> = law.into_iter().chain(args.set.iter().cloned()).collect();
    let mut scenario = recorded.clone().with_sets(&settings)?;
    if args.law.is_some() {
        scenario.controller.exe = None;
    }
    let kept = [
        ("the number of links", scenario.links() == recorded.links()),
        ("the rate", scenario.period_ns() == recorded.period_ns()),
        ("the mode", scenario.loop_.mode == recorded.loop_.mode),
        ("the reference", scenario.reference == recorded.reference),
    ];
    match kept.iter().find(|(_, same)| !same) {
        Some((what, _)) => Err(Failure::usage(format!("{what} can't be changed in a replay: it is recorded")).into()),
        None => Ok(scenario),
    }
}

struct Replay<const N: usize> {
    engine: Option<Engine<N>>,
    tracker: Tracker<N>,
    last: Option<(u64, u64)>,
    v: f64,
    report: Report,
}

fn replay<const N: usize>(
    mut recording: Recording,
    scenario: &Scenario,
    what_if: bool,
    path: &Path,
) -> anyhow::Result<Report> {
    let tracker = Tracker::new(Config::of(scenario), Some(Judge::new(scenario)?));
    let report = Report { what_if, ..Report::default() };
    let mut replay = Replay::<N> { engine: None, tracker, last: None, v: f64::NAN, report };
    let mut waiting: Vec<Announce> = Vec::new();
    while let Some(item) = recording.next_item().map_err(|error| refuse(path, &error))? {
        match item {
            Item::Announce(announce) => {
                if let Some(engine) = &mut replay.engine {
                    engine.learn(&announce)?;
                }
                // What if: the controllers of the scenario have the law that it says now.
                if !what_if || announce.role != Role::Controller.code() {
                    replay.tracker.learn(&announce);
                }
                waiting.push(*announce);
            }
            Item::Record(record) => {
                if replay.engine.is_none() {
                    let mut engine = Engine::new(scenario, &record)?;
                    for announce in waiting.drain(..) {
                        engine.learn(&announce)?;
                    }
                    if what_if {
                        engine.announcements().for_each(|announce| replay.tracker.learn(announce));
                    }
                    replay.engine = Some(engine);
                }
                if !replay.tick(&record) {
                    break;
                }
            }
            Item::Figures(figures) => replay.compare_v(figures.tick, figures.v),
        }
    }
    replay.report.cut_off = recording.is_cut_off();
    Ok(replay.finish(scenario))
}

impl<const N: usize> Replay<N> {
    /// One record; false where the run can't be followed any further.
    fn tick(&mut self, recorded: &TickRecord) -> bool {
        let follows = |(tick, end_ns): (u64, u64)| {
            recorded.tick == tick.saturating_add(1).saturating_add(recorded.skipped_before)
                && recorded.start_plant_ns == end_ns
        };
        let whole = recorded.segments_used as usize <= SEGMENTS_MAX && recorded.links as usize == N;
        let Some(engine) = self.engine.as_mut().filter(|_| whole && self.last.is_none_or(follows)) else {
            self.report.stopped_at_gap = Some(recorded.tick);
            return false;
        };
        let record = engine.tick(recorded);
        self.last = Some((recorded.tick, recorded.end_plant_ns));
        let row = self.tracker.feed(&record);
        self.tracker.drain_events().for_each(drop);
        self.v = row.and_then(|row| row.lyapunov).unwrap_or(f64::NAN);
        self.report.ticks += 1;
        if !self.report.what_if {
            self.compare(recorded, &record);
        }
        true
    }

    fn compare(&mut self, recorded: &TickRecord, record: &TickRecord) {
        for (what, was, is) in [
            ("q", &recorded.q, &record.q),
            ("v", &recorded.v, &record.v),
            ("measured", &recorded.q_measured, &record.q_measured),
            ("measured", &recorded.v_measured, &record.v_measured),
            ("disturbance", &recorded.disturbance, &record.disturbance),
        ] {
            was.iter().zip(is).for_each(|(was, is)| self.compare_one(recorded.tick, what, *was, *is));
        }
        for (was, is) in recorded.segments.iter().zip(&record.segments) {
            was.tau.iter().zip(&is.tau).for_each(|(was, is)| self.compare_one(recorded.tick, "torque", *was, *is));
        }
    }

    fn compare_v(&mut self, tick: u64, v: f64) {
        let is_last = self.last.is_some_and(|(last, _)| last == tick);
        if is_last && !self.report.what_if && !(v.is_nan() && self.v.is_nan()) {
            self.compare_one(tick, "V", v, self.v);
        }
    }

    fn compare_one(&mut self, tick: u64, what: &'static str, was: f64, is: f64) {
        if was.to_bits() != is.to_bits() {
            self.report.differences += 1;
            self.report.difference.get_or_insert(Difference { tick, what, values: [was, is] });
        }
    }

    fn finish(mut self, scenario: &Scenario) -> Report {
        self.tracker.finish();
        let mut summary = self.tracker.summarise();
        let natural = judge_summary(&summary);
        summary.verdict = judge(&scenario.expect, &summary, self.tracker.blocks(), natural);
        if let Some(engine) = &self.engine {
            self.report.torques_recomputed = engine.recomputed;
            self.report.torques_as_recorded = engine.as_recorded.values().sum();
            self.report.as_recorded_because = engine.as_recorded.iter().map(|(why, n)| (why.reason(), *n)).collect();
        }
        self.report.max_abs_e_rad = summary.tracking.max_abs_e_rad;
        self.report.max_norm_e_rad = summary.tracking.max_norm_e_rad;
        (self.report.v_max, self.report.v_unit) = (summary.bound.v_max, summary.bound.v_unit);
        self.report.verdict = summary.verdict.status;
        self.report.reasons = summary.verdict.reasons;
        self.report
    }
}

impl Report {
    /// Whether all of the run could be followed.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.ticks > 0 && self.stopped_at_gap.is_none() && !self.cut_off
    }
}

fn exit_of(report: &Report) -> Exit {
    // Of the recorded verdict only that the run was not whole concerns what is computed here.
    let partial = |verdict: &Headline| matches!(verdict, Headline::RoleLost | Headline::Incomplete);
    let counts = |verdict: &Headline| *verdict == Headline::Diverged || (report.what_if && verdict.is_bad());
    let verdict = Headline::of_word(&report.verdict).filter(counts);
    let found = [
        (report.differences > 0).then_some(Headline::Failed),
        verdict,
        (!report.incomplete.is_empty()).then_some(Headline::Incomplete),
        report.verdict_recorded.as_deref().and_then(Headline::of_word).filter(partial),
        (!report.is_whole()).then_some(Headline::Inconclusive),
    ];
    Headline::first_of(found.into_iter().flatten()).unwrap_or(Headline::Held).into()
}

fn render(report: &Report) -> String {
    let mut lines = Vec::new();
    if !report.incomplete.is_empty() {
        let whose = report.run_id.as_ref().map_or_else(String::new, |run_id| format!("run {run_id}: "));
        lines.push(format!("INCOMPLETE: {whose}{}", report.incomplete.join("; ")));
    }
    let because = report.as_recorded_because.iter().map(|(why, count)| format!("{count} {why}"));
    let because = because.collect::<Vec<_>>().join(", ");
    let because = if because.is_empty() { String::new() } else { format!(" ({because})") };
    lines.push(format!(
        "{} ticks computed again; {} torques computed, {} taken as recorded{because}",
        report.ticks, report.torques_recomputed, report.torques_as_recorded
    ));
    match &report.difference {
        Some(Difference { tick, what, values: [was, is] }) => lines.push(format!(
            "DIFFERENT from tick {tick} on: {what} was {was:?} and is {is:?} ({} values differ)",
            report.differences
        )),
        None if report.what_if => {
            let shown = |value: Option<f64>, unit: &str| {
                value.map_or_else(|| "none".to_owned(), |value| format!("{value:.6} {unit}").trim_end().to_owned())
            };
            lines.push(format!(
                "what if: largest error once settled: |e_i| of one link {}, ‖e‖ of all links {}; largest V {}",
                shown(report.max_abs_e_rad, "rad"),
                shown(report.max_norm_e_rad, "rad"),
                shown(report.v_max, report.v_unit.as_deref().unwrap_or(""))
            ));
        }
        None if report.ticks == 0 => lines.push("nothing was recorded that could be compared".to_owned()),
        None => lines.push(format!(
            "identical to the bit: states, measurements, disturbances, V and {}",
            match (report.torques_recomputed, report.torques_as_recorded) {
                (0, _) => "no torque: none could be computed".to_owned(),
                (_, 0) => "all torques".to_owned(),
                (computed, _) => format!("the {computed} torques that were computed"),
            }
        )),
    }
    if let Some(tick) = report.stopped_at_gap {
        lines.push(format!("stopped before tick {tick}: records are missing there"));
    }
    if report.cut_off {
        lines.push("the recording was cut off; all of its whole chunks were replayed".to_owned());
    }
    let recorded = report.verdict_recorded.as_ref().map_or_else(String::new, |was| format!(" (recorded: {was})"));
    lines.push(format!("verdict: {}{recorded}", report.verdict));
    lines.extend(report.reasons.iter().map(|reason| format!("  {reason}")));
    lines.join("\n") + "\n"
}
