//! `loopbound fault`: asks a group's supervisor to let something go wrong with a controller, on purpose.

use std::io::Write as _;

use clap::Args;
use loopbound_scenario::parse_duration;
use loopbound_shared::event::LiveFault;
use loopbound_shared::say;

use crate::commands::options::word;
use crate::exit::{Exit, Failure};
use crate::supervise::{Answer, FaultReport, FaultRequest, Request, connect};

/// `loopbound fault`.
#[derive(Debug, Args)]
pub struct FaultArgs {
    /// Name of the group (see `loopbound ps`).
    #[arg(long)]
    pub group: String,
    /// What goes wrong: delay, drop, nan, glitch, kill or hang.
    #[arg(value_parser = word::<LiveFault>)]
    pub kind: LiveFault,
    /// The controller it is injected into; default the active one.
    #[arg(long, value_name = "ID")]
    pub controller: Option<u32>,
    /// How much later each torque comes, of a delay; default beyond the grace, so that it is missed.
    #[arg(long, value_parser = parse_duration, value_name = "TIME")]
    pub delay: Option<u64>,
    /// What is added to the torque of the first link, N·m, of a glitch; default 200.
    #[arg(long, value_name = "NM", allow_negative_numbers = true)]
    pub value: Option<f64>,
    /// How long it lasts; default 100ms.
    #[arg(long = "for", value_parser = parse_duration, value_name = "TIME")]
    pub length: Option<u64>,
    /// Print one JSON document.
    #[arg(long)]
    pub json: bool,
}

/// Asks, and prints what came of it.
///
/// # Errors
/// If the group is not running or the request makes no sense.
pub fn run(args: &FaultArgs) -> anyhow::Result<Exit> {
    let request = FaultRequest {
        kind: args.kind.name().to_owned(),
        controller: args.controller,
        delay_ns: args.delay,
        for_ns: args.length,
        value_nm: args.value,
        run: None,
    };
    let report = match connect(&args.group, &Request::Fault(request))? {
        Some(Answer::Fault(report)) => *report,
        Some(Answer::Usage(why)) => return Err(Failure::usage(why).into()),
        Some(Answer::Report(_)) | None => FaultReport {
            group: args.group.clone(),
            kind: args.kind.name().to_owned(),
            result: "refused".to_owned(),
            reason: Some("the group ended".to_owned()),
            ..FaultReport::default()
        },
    };
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", serde_json::to_string(&report)?)?;
    } else {
        writeln!(out, "{}", text(&report))?;
    }
    Ok(if report.result == "done" { Exit::Held } else { Exit::SwapRefused })
}

fn text(report: &FaultReport) -> String {
    let FaultReport { kind, controller, tick, .. } = report;
    if let Some(reason) = &report.reason {
        return format!("fault {kind}: refused in tick {tick}: {reason}");
    }
    let ms = |ns: u64| format!("{} ms", ns as f64 * 1e-6);
    let delay = report.delay_ns.map(|ns| format!(" by {}", ms(ns)));
    let by = delay.or_else(|| Some(format!(" by {} N·m", report.value_nm?))).unwrap_or_default();
    let length = report.for_ns.map_or_else(String::new, |ns| format!(" for {}", ms(ns)));
    let cut_short = if report.cut_short { "; the run is to end before that" } else { "" };
    format!("fault {kind}{by}: controller {controller} from tick {tick} on{length}{cut_short}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_says_whom_it_befalls_from_when_and_for_how_long_or_why_not() {
        let delay = FaultReport {
            kind: "delay".into(),
            controller: 2,
            tick: 70,
            for_ns: Some(100_000_000),
            delay_ns: Some(600_000),
            ..FaultReport::default()
        };
        assert_eq!(text(&delay), "fault delay by 0.6 ms: controller 2 from tick 70 on for 100 ms");
        let glitch = FaultReport { kind: "glitch".into(), delay_ns: None, value_nm: Some(-2.5), ..delay.clone() };
        assert!(text(&glitch).starts_with("fault glitch by -2.5 N·m: controller 2"), "{}", text(&glitch));
        let cut_short = FaultReport { cut_short: true, ..delay.clone() };
        assert!(text(&cut_short).ends_with("for 100 ms; the run is to end before that"), "{}", text(&cut_short));
        let refused = FaultReport { reason: Some("no such controller".into()), ..delay };
        assert_eq!(text(&refused), "fault delay: refused in tick 70: no such controller");
    }
}
