//! `loopbound study delay` and `loopbound study rate`: the stability boundary over the gain, measured and predicted.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use loopbound_model::certificate::Gains;
use loopbound_model::law::LawKind;
use loopbound_model::quote;
use loopbound_model::with_links;
use loopbound_monitor::chart::{Axis as ChartAxis, Figure, Panel, Series, Style};
use loopbound_scenario::ScenarioError;
use loopbound_shared::say;

use super::boundary::{Boundary, Probe};
use super::folder::{Asked, picture_files};
use super::table::short;
use super::{SweepArgs, on_all_cores};
use crate::exit::{Exit, Failure};

/// Period of the study of delays, s.
const PERIOD_S: f64 = 1e-3;
/// How far a prediction may be off without an explanation.
const AGREEMENT: f64 = 0.05;

/// What is swept beside the gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// The delay at a fixed period.
    Delay,
    /// The period at a fixed delay.
    Period,
}

/// A point of the boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Number of links.
    pub links: usize,
    /// K_t, or K_d of `pd+g`, N·m·s.
    pub gain: f64,
    /// Rate of the fastest mode, 1/s.
    pub rate: f64,
    /// The fixed one of period and delay, s.
    pub fixed_s: f64,
    /// The boundary of the other.
    pub boundary: Boundary,
}

/// Finds the boundary of `links` links under a law at 8 or 16 gains.
///
/// # Errors
/// If a scenario of the study describes no system.
pub fn points(links: usize, law: LawKind, axis: Axis, quick: bool) -> Result<Vec<Point>, ScenarioError> {
    // Rates times the period, evenly spread in their logarithm: the boundary then runs from 5 periods to a tenth of one.
    let steps = if quick { 8 } else { 16 };
    let spread = |low: f64, high: f64| {
        let at = move |step: u32| f64::from(step) / f64::from(steps - 1);
        (0..steps).map(move |step| low * libm::exp2(at(step) * libm::log2(high / low))).collect::<Vec<f64>>()
    };
    let jobs: Vec<(f64, f64)> = match axis {
        Axis::Delay => spread(300.0, 3500.0).into_iter().map(|rate| (rate, 0.0)).collect(),
        Axis::Period => {
            let rates = spread(300.0, 6000.0);
            rates.into_iter().enumerate().map(|(at, rate)| (rate, if at % 2 == 0 { 0.0 } else { 0.5 / rate })).collect()
        }
    };
    let found = on_all_cores(&jobs, |&(rate, delay_s)| with_links!(links, at::<N>(law, axis, rate, delay_s)));
    Ok(found.into_iter().collect::<Result<Vec<_>, ScenarioError>>()?.concat())
}

fn at<const N: usize>(law: LawKind, axis: Axis, rate: f64, delay_s: f64) -> Result<Vec<Point>, ScenarioError> {
    let Some(probe) = Probe::<N>::new(law, rate)? else { return Ok(Vec::new()) };
    let (fixed_s, found) = match axis {
        Axis::Delay => (PERIOD_S, probe.delays(PERIOD_S)?),
        // At h = 1/a no delay up to 0.5/a matters.
        Axis::Period => (delay_s, probe.period(1.0 / rate, delay_s)?.into_iter().collect()),
    };
    let point = |boundary| Point { links: N, gain: probe.gain, rate: probe.rate, fixed_s, boundary };
    Ok(found.into_iter().map(point).collect())
}

/// Runs the study. Held when measurement and spectral radius agree.
///
/// # Errors
/// If the folder can't be written, or the law has no fast mode.
pub fn run(args: &SweepArgs, axis: Axis) -> anyhow::Result<Exit> {
    let has_fast_mode = |law: LawKind| law.gains_for_rate(1.0, 1.0, &Gains::of(law)).is_some();
    if !has_fast_mode(args.law) {
        let (law, allowed) = (args.law, LawKind::names(has_fast_mode));
        let why =
            format!("--law: found {law}, allowed: {allowed} ({law} has no fast mode, and no gain that scales it)");
        return Err(Failure::usage(why).into());
    }
    let name = if axis == Axis::Delay { "delay" } else { "rate" };
    let study = if axis == Axis::Delay { "study-delay" } else { "study-rate" };
    let mut files = vec![format!("{name}.csv"), format!("{name}.md")];
    files.extend(picture_files(name));
    let folder = Asked::new(args.out.as_deref().unwrap_or(Path::new(study)), study, &files)?;
    let mut all = Vec::new();
    for &links in &args.links {
        let found = points(links, args.law, axis, args.quick).map_err(|e| Failure::usage(e.to_string()))?;
        all.extend(found);
    }
    // An earlier study stays until there is something to take its place.
    let mut folder = folder.take()?;
    folder.picture(name, &figure(args.law, axis, &all))?;
    folder.write(&format!("{name}.csv"), to_csv(axis, &all))?;
    let text = report(args.law, axis, &all);
    folder.write(&format!("{name}.md"), &text)?;
    let mut out = say::stdout();
    writeln!(out, "{text}\nwritten to {}", quote::path(&folder.finish()?))?;
    Ok(if worst(&all, Boundary::radius_deviation) <= AGREEMENT { Exit::Held } else { Exit::Failed })
}

fn worst(points: &[Point], deviation: impl Fn(&Boundary) -> f64) -> f64 {
    points.iter().map(|p| deviation(&p.boundary).abs()).fold(0.0, f64::max)
}

fn to_csv(axis: Axis, points: &[Point]) -> String {
    let (fixed, sought) = if axis == Axis::Delay { ("period_s", "delay") } else { ("delay_s", "period") };
    let mut csv = format!("links,gain,rate_per_s,{fixed},{sought}_measured_s,{sought}_rule_11_s,{sought}_radius_s\n");
    for p in points {
        let Boundary { measured_s, rule_s, radius_s } = p.boundary;
        let _ = writeln!(
            csv,
            "{},{:.5e},{:.5e},{:.5e},{measured_s:.5e},{rule_s:.5e},{radius_s:.5e}",
            p.links, p.gain, p.rate, p.fixed_s
        );
    }
    csv
}

fn report(law: LawKind, axis: Axis, points: &[Point]) -> String {
    let (title, sought, fixed) = match axis {
        Axis::Delay => ("How late a torque may be", "delay", "h"),
        Axis::Period => ("How slow a loop may be", "period", "d"),
    };
    let mut text = format!(
        "# {title}: `{law}`\n\nBoundary of stability, measured in lockstep by bisection and predicted.\n\n| n | gain N·m·s | a \
         1/s | {fixed} ms | {sought} measured ms | by [11] ms | by spectral radius ms |\n|---|---|---|---|---|---|---|\n"
    );
    let percent = |x: f64| format!("{:+.1} %", x * 100.0);
    for p in points {
        let b = &p.boundary;
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {:.4} | {:.4} ({}) | {:.4} ({}) |",
            p.links,
            short(p.gain),
            short(p.rate),
            short(p.fixed_s * 1e3),
            b.measured_s * 1e3,
            b.rule_s * 1e3,
            percent(b.rule_deviation()),
            b.radius_s * 1e3,
            percent(b.radius_deviation())
        );
    }
    let _ = writeln!(text, "\n{}", conclusion(points));
    text
}

/// What the points say, and why where they don't agree.
fn conclusion(points: &[Point]) -> String {
    let (rule, radius) = (worst(points, Boundary::rule_deviation), worst(points, Boundary::radius_deviation));
    let mut text = format!(
        "Over {} points [11] is off by at most {:.1} %, the spectral radius by {:.1} %.",
        points.len(),
        rule * 100.0,
        radius * 100.0
    );
    if rule > AGREEMENT {
        let far: Vec<&Point> = points.iter().filter(|p| p.boundary.rule_deviation().abs() > AGREEMENT).collect();
        let safe = far.iter().filter(|p| p.boundary.rule_deviation() < 0.0).count();
        let fastest = far.iter().map(|p| p.rate).fold(0.0, f64::max);
        let _ = write!(
            text,
            " [11] knows the fastest mode alone, ṙ = −a r. At {} points, with a up to {} 1/s, it is more than {:.0} % off ({safe} \
             of them on the safe side): there the coupling of r with e and gravity, of relative size β/a and more, is not \
             small. The spectral radius keeps every mode.",
            far.len(),
            short(fastest),
            AGREEMENT * 100.0
        );
    }
    text
}

fn figure(law: LawKind, axis: Axis, points: &[Point]) -> Figure {
    let mut links: Vec<usize> = points.iter().map(|p| p.links).collect();
    links.dedup();
    let mut series = Vec::new();
    for (colour, n) in links.iter().enumerate() {
        let pick = |value: fn(&Boundary) -> f64, with: &dyn Fn(&Point) -> bool| {
            let chosen = points.iter().filter(|p| p.links == *n && with(p));
            let mut list: Vec<(f64, f64)> = chosen.map(|p| (p.rate, value(&p.boundary) * 1e3)).collect();
            list.sort_by(|a, b| a.0.total_cmp(&b.0));
            list
        };
        // Branches are drawn apart: upper and lower limit of the delay, or without and with a delay.
        let upper = |p: &Point| match axis {
            Axis::Delay => p.boundary.measured_s > p.fixed_s / 4.0,
            Axis::Period => p.fixed_s > 0.0,
        };
        for branch in [true, false] {
            let rule = pick(|b| b.rule_s, &|p| upper(p) == branch);
            series.push(Series::line(format!("n = {n}: [11]"), colour, rule).styled(Style::Dashed));
            let radius = pick(|b| b.radius_s, &|p| upper(p) == branch);
            series.push(Series::line(format!("n = {n}: radius"), colour, radius));
        }
        series.push(
            Series::line(format!("n = {n}: measured"), colour, pick(|b| b.measured_s, &|_| true)).styled(Style::Marks),
        );
    }
    let (title, y) = match axis {
        Axis::Delay => ("Largest and least delay at a period of 1 ms", "delay (ms)"),
        Axis::Period => ("Longest period, without delay and with d = 1/(2a)", "period (ms)"),
    };
    let panel = Panel::lines("", ChartAxis::log("rate a of the fastest mode (1/s)"), ChartAxis::log(y), series);
    Figure { title: format!("{title}, {law}"), panels: vec![panel], panel_height_px: 380, ..Figure::default() }
}
