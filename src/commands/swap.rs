//! `loopbound swap`: asks a group's supervisor for another controller, and says what came of it.

use loopbound_model::quote;
use std::io::Write as _;
use std::path::PathBuf;

use clap::Args;
use loopbound_model::law::LawKind;
use loopbound_scenario::parse_duration;
use loopbound_shared::say;

use crate::exit::{Exit, Failure};
use crate::supervise::{Answer, Request, SwapReport, SwapRequest, connect};

/// `loopbound swap`.
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("successor").required(true).args(["law", "exe", "to"])))]
pub struct SwapArgs {
    /// Name of the group (see `loopbound ps`).
    #[arg(long)]
    pub group: String,
    /// To a new process with this law: robust, robust-ff, ctc or pd+g.
    #[arg(long, value_parser = law, value_name = "LAW")]
    pub law: Option<LawKind>,
    /// To a new process of a controller of your own.
    #[arg(long, value_name = "PATH")]
    pub exe: Option<PathBuf>,
    /// To the standby with this number.
    #[arg(long, value_name = "ID")]
    pub to: Option<u32>,
    /// Switch before this tick, or not at all; default as soon as the gate passes.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub at_tick: Option<u64>,
    /// Fade from the old torque to the new for so long, such as 20ms; default that of the scenario.
    #[arg(long, value_parser = parse_duration, value_name = "TIME")]
    pub blend: Option<u64>,
    /// Skip the gate, not the safety checks.
    #[arg(long)]
    pub force: bool,
    /// Print one JSON document.
    #[arg(long)]
    pub json: bool,
}

fn law(text: &str) -> Result<LawKind, String> {
    text.parse().map_err(|e| format!("{e}"))
}

/// Asks, waits, prints.
///
/// # Errors
/// If the group is not running or the request makes no sense.
pub fn run(args: &SwapArgs) -> anyhow::Result<Exit> {
    // The supervisor may have another working directory.
    let absolute =
        |path: &PathBuf| path.canonicalize().map_err(|e| Failure::usage(format!("--exe {}: {e}", quote::path(path))));
    let request = SwapRequest {
        law: args.law,
        exe: args.exe.as_ref().map(absolute).transpose()?,
        to: args.to,
        at_tick: args.at_tick,
        blend_ns: args.blend,
        force: args.force,
        run: None,
    };
    let report = match connect(&args.group, &Request::Swap(request))? {
        Some(Answer::Report(report)) => *report,
        Some(Answer::Usage(why)) => return Err(Failure::usage(why).into()),
        Some(Answer::Fault(_)) | None => SwapReport {
            group: args.group.clone(),
            result: "refused".to_owned(),
            reason: Some("the group ended".to_owned()),
            ..SwapReport::default()
        },
    };
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", serde_json::to_string(&report)?)?;
    } else {
        write!(out, "{}", text(&report))?;
    }
    Ok(if report.result == "done" { Exit::Held } else { Exit::SwapRefused })
}

fn text(report: &SwapReport) -> String {
    let SwapReport { from, to, tick, .. } = report;
    // A refusal before any process was started names none.
    let to = if *to == 0 { String::new() } else { format!(" to {to}") };
    let mut text = format!("swap from controller {from}{to}: {} in tick {tick}\n", report.result);
    let mut line = |name: &str, value: String| text.push_str(&format!("  {name:<22}{value}\n"));
    if let Some(reason) = &report.reason {
        let numbers = match (report.value, report.limit) {
            // Ticks are whole numbers.
            (Some(value), Some(limit)) if value.fract() == 0.0 && limit.fract() == 0.0 && limit != 0.0 => {
                format!(" ({value:.0}, allowed {limit:.0})")
            }
            (Some(value), Some(limit)) if value != 0.0 || limit != 0.0 => format!(" ({value:.4}, allowed {limit:.4})"),
            _ => String::new(),
        };
        line("because", format!("{reason}{numbers}"));
        if report.result != "done" {
            line("active", format!("controller {from}, as before"));
        }
    }
    if report.torque_step_nm.is_empty() {
        return text;
    }
    line("missed ticks", report.missed_ticks.to_string());
    let steps: Vec<String> = report.torque_step_nm.iter().map(|step| format!("{step:+.4}")).collect();
    line("torque step", format!("{} N·m", steps.join("  ")));
    if let Some(difference) = report.torque_difference_nm.filter(|_| report.blended_ticks > 0) {
        line("cross-fade", format!("{difference:.4} N·m over {} ticks", report.blended_ticks));
    }
    line("ΔV in the first tick", report.delta_v.map_or("not certified".to_owned(), |v| format!("{v:+.3e}")));
    let us = |ns: Option<u64>| ns.map_or("unknown".to_owned(), |ns| format!("{:.1} us", ns as f64 * 1e-3));
    let (before, after) = (us(report.latency_before_ns), us(report.latency_after_ns));
    line("round trip, median", format!("{before} before, {after} after"));
    if let Some(ns) = report.command_to_authority_ns {
        line("command to authority", format!("{:.1} ms", ns as f64 * 1e-6));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_says_why_with_its_numbers_and_who_is_in_charge() {
        let report = SwapReport {
            from: 1,
            to: 2,
            tick: 70,
            result: "refused".into(),
            reason: Some("the torque would step by more than allowed".into()),
            value: Some(7.5),
            limit: Some(5.0),
            ..SwapReport::default()
        };
        let text = text(&report);
        assert!(text.contains("refused in tick 70") && text.contains("(7.5000, allowed 5.0000)"), "{text}");
        assert!(text.contains("controller 1, as before") && !text.contains("missed"), "{text}");
    }

    #[test]
    fn a_swap_that_was_done_shows_every_joint() {
        let report = SwapReport {
            result: "done".into(),
            torque_step_nm: vec![0.25, -0.5],
            delta_v: Some(-1e-4),
            latency_before_ns: Some(12_300),
            torque_difference_nm: Some(2.5),
            blended_ticks: 20,
            ..SwapReport::default()
        };
        let text = text(&report);
        assert!(text.contains("2.5000 N·m over 20 ticks"), "{text}");
        assert!(text.contains("+0.2500  -0.5000 N·m") && text.contains("-1.000e-4"), "{text}");
        assert!(text.contains("12.3 us before, unknown after"), "{text}");
    }
}
