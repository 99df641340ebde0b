//! The figures of a run as one screen of text.

mod bound;

use std::fmt::Write as _;

use loopbound_shared::counters::Counters;
use loopbound_shared::event::MessageKind;

use crate::cause::words_of;
use crate::counted::counted;
use crate::hops::Hop;
use crate::summary::Summary;

/// The report, at most `width` (at least 60, at most 100) columns wide; `colour` only on a terminal.
#[must_use]
pub fn render(summary: &Summary, width: usize, colour: bool) -> String {
    let mut screen = Screen { text: String::new(), width: width.clamp(60, 100), colour };
    headline(&mut screen, summary);
    latencies(&mut screen, summary);
    ticks(&mut screen, summary);
    control(&mut screen, summary);
    bound::lines(&mut screen, summary);
    swaps(&mut screen, summary);
    privileges(&mut screen, summary);
    recording(&mut screen, summary);
    screen.text
}

struct Screen {
    text: String,
    width: usize,
    colour: bool,
}

impl Screen {
    /// A line, cut at the width. Writing to a string cannot fail.
    fn line(&mut self, line: &str) {
        self.painted(line, "");
    }

    fn painted(&mut self, line: &str, paint: &str) {
        let cut: String = line.chars().take(self.width).collect();
        let cut = cut.trim_end();
        let _ = if self.colour && !paint.is_empty() {
            writeln!(self.text, "\x1b[{paint}m{cut}\x1b[0m")
        } else {
            writeln!(self.text, "{cut}")
        };
    }

    /// A label and its text, broken at words and indented below the label.
    fn entry(&mut self, label: &str, text: &str) {
        let room = self.width.saturating_sub(LABEL).max(20);
        let mut label = label;
        let mut line = String::new();
        for word in text.split(' ') {
            if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > room {
                self.line(&format!("{label:<LABEL$}{line}"));
                (label, line) = ("", String::new());
            }
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
        self.line(&format!("{label:<LABEL$}{line}"));
    }
}

/// Width of the column of labels.
const LABEL: usize = 18;

fn headline(screen: &mut Screen, summary: &Summary) {
    let status = summary.verdict.status.to_uppercase();
    let paint = match summary.verdict.headline() {
        // Green beside a reason against it would contradict itself.
        headline if headline.is_good() && summary.verdict.reasons.is_empty() => "1;32",
        headline if headline.is_bad() => "1;31",
        _ => "1;33",
    };
    let rate = summary.rate_hz.map_or_else(|| "?".to_owned(), hertz);
    let law = summary.bound.whose();
    let what = format!("{law}, n = {}, {rate} {}, {:.3} s", summary.links, summary.mode, summary.duration_s);
    screen.painted(&format!("{status}: {what}"), paint);
    for reason in &summary.verdict.reasons {
        screen.entry("", reason);
    }
    let ticks = format!("{} closed, {} seen", summary.ticks, summary.ticks_seen);
    let from = summary.first_tick.filter(|tick| *tick > 0);
    let from = from.map_or_else(String::new, |tick| format!(" (from tick {tick} on)"));
    let gaps =
        if summary.monitor_gaps > 0 { format!(", {} not received", summary.monitor_gaps) } else { String::new() };
    let ended = if summary.ended.is_empty() { String::new() } else { format!("; ended: {}", summary.ended) };
    screen.entry("ticks", &format!("{ticks}{from}{gaps}{ended}"));
    screen.line("");
}

fn latencies(screen: &mut Screen, summary: &Summary) {
    let heading = if summary.latency_is_virtual { "latency (virtual)" } else { "latency" };
    screen.painted(&format!("{heading:<22}{:>11}{:>11}{:>11}{:>11}{:>11}", "p50", "p99", "p99.9", "max", "n"), "1");
    for hop in Hop::ALL {
        let Some(quantiles) = summary.hop(hop) else { continue };
        let cells: String = [quantiles.p50, quantiles.p99, quantiles.p99_9, quantiles.max]
            .into_iter()
            .map(|value| format!("{:>11}", time(value)))
            .collect();
        let mut line = format!("  {:<20}{cells}{:>11}", hop.words(), quantiles.n);
        if quantiles.overflow > 0 {
            let _ = write!(line, "  {} > 10 s", quantiles.overflow);
        }
        screen.line(&line);
    }
    let jitter = &summary.jitter_ns;
    if jitter.n > 0 && !summary.latency_is_virtual {
        let text = format!(
            "interval {} ± {} (std), {} to {}; |interval − period| p99 {}, p99.9 {}",
            time(jitter.mean),
            time(jitter.std),
            time(jitter.min),
            time(jitter.max),
            time(jitter.deviation_p99),
            time(jitter.deviation_p99_9)
        );
        screen.entry("wake-up jitter", &text);
    }
    if summary.start_up_ticks > 0 {
        let verb = if summary.start_up_ticks == 1 { "is" } else { "are" };
        screen.entry("", &format!("{} of start-up {verb} left out", counted(summary.start_up_ticks, "tick")));
    }
    screen.line("");
}

/// Counts that have a place of their own on the screen.
const COUNTED_ABOVE: [&str; 4] = ["ticks", "overruns", "missed", "late"];

fn ticks(screen: &mut Screen, summary: &Summary) {
    let text = format!("{} of {}{}", summary.missed_ticks, summary.ticks, causes(&summary.missed_ticks_by_cause));
    screen.entry("missed ticks", &text);
    let limit = time(Some(summary.late_limit_ns as f64));
    let text = format!("{} (deadline → torque > {limit}){}", summary.late_ticks, causes(&summary.late_ticks_by_cause));
    screen.entry("late ticks", &text);
    let mut text = format!("{}", summary.overruns);
    for counter in Counters::ALL.iter().filter(|counter| !COUNTED_ABOVE.contains(&counter.name)) {
        let count = summary.counters.get(counter.name).copied().unwrap_or(0);
        if count > 0 {
            let _ = write!(text, ", {} {}", counted(count, counter.unit), counter.words);
        }
    }
    screen.entry("overruns", &text);
    strangers(screen, summary);
}

/// What others than this run's processes said in it, where anybody did.
fn strangers(screen: &mut Screen, summary: &Summary) {
    let said = |kind: &MessageKind| {
        let count = summary.strangers.get(kind.name()).copied().filter(|count| *count > 0)?;
        Some(counted(count, kind.words()))
    };
    let all: Vec<String> = MessageKind::ALL.iter().filter_map(said).collect();
    if !all.is_empty() {
        screen.entry("strangers", &format!("{}: refused, not of this run's processes", all.join(", ")));
    }
}

fn control(screen: &mut Screen, summary: &Summary) {
    let tracking = &summary.tracking;
    let text = if tracking.n == 0 {
        let what = if summary.diverged.is_some() { "the loop ran away" } else { "the run ended" };
        format!("{what} before it settled")
    } else {
        format!(
            "max |e_i| {} rad (one link), max ‖e‖ {} rad (all links), rms e_i {} rad; max |ė_i| {} rad/s, max ‖ė‖ {} rad/s, \
             rms ė_i {} rad/s ({}, settled)",
            number(tracking.max_abs_e_rad),
            number(tracking.max_norm_e_rad),
            number(tracking.rms_e_rad),
            number(tracking.max_abs_ed_rad_s),
            number(tracking.max_norm_ed_rad_s),
            number(tracking.rms_ed_rad_s),
            counted(tracking.n, "tick")
        )
    };
    screen.entry("tracking error", &text);
}

fn swaps(screen: &mut Screen, summary: &Summary) {
    let mut label = "swaps";
    for swap in &summary.swaps {
        let reason = swap.reason.as_ref().map_or_else(String::new, |reason| format!(" ({reason})"));
        let mut text = format!(
            "tick {}: {} {} → {}: {}{reason}, {} missed, torque step {} N·m, ΔV {}",
            swap.tick,
            swap.kind,
            swap.from,
            swap.to,
            swap.result,
            swap.missed_ticks,
            number(swap.torque_step_nm),
            number(swap.delta_v)
        );
        if swap.blended_ticks > 0 {
            let difference = number(swap.torque_difference_nm);
            let _ = write!(text, "; {difference} N·m faded over {}", counted(swap.blended_ticks, "tick"));
        }
        screen.entry(std::mem::take(&mut label), &text);
    }
}

fn privileges(screen: &mut Screen, summary: &Summary) {
    let mut label = "privileges";
    let of_the_loop = |role: &str| matches!(role, "plant" | "controller" | "reference");
    for process in summary.processes.iter().filter(|process| of_the_loop(&process.role)) {
        let had: Vec<&str> = process
            .privileges
            .as_object()
            .into_iter()
            .flatten()
            .filter(|(_, value)| value.as_str() == Some("had"))
            .map(|(name, _)| name.as_str())
            .collect();
        let had = if had.is_empty() { "none".to_owned() } else { had.join(", ") };
        screen.entry(std::mem::take(&mut label), &format!("{} {}: {had}", process.role, process.id));
    }
    // Each refusal once, whoever met it: the remedy is the same for all.
    let mut told: Vec<&str> = Vec::new();
    for missing in summary.processes.iter().flat_map(|process| &process.missing) {
        if !told.contains(&missing.step.as_str()) {
            told.push(&missing.step);
            screen.entry("", &format!("no {}: {}; {}", missing.step, missing.cost, missing.remedy));
        }
    }
}

/// The files of the run, where they are not whole.
fn recording(screen: &mut Screen, summary: &Summary) {
    let error = summary.recording.as_ref().and_then(|recording| recording.error.as_deref());
    let dropped = &summary.dropped;
    if error.is_none() && *dropped == crate::summary::Dropped::default() {
        return;
    }
    let why = error.map_or_else(String::new, |error| format!("{error}; "));
    screen.entry("recording", &format!("INCOMPLETE: {why}{dropped}"));
}

/// The causes that occurred, after a colon.
fn causes(by_name: &std::collections::BTreeMap<String, u64>) -> String {
    let list = words_of(by_name);
    if list.is_empty() { list } else { format!(": {list}") }
}

fn hertz(rate_hz: f64) -> String {
    if rate_hz >= 1000.0 { format!("{:.6} kHz", rate_hz / 1000.0) } else { format!("{rate_hz:.6} Hz") }
        .replacen(".000000 ", " ", 1)
}

/// Nanoseconds in the unit that suits them.
fn time(value_ns: Option<f64>) -> String {
    let Some(ns) = value_ns else { return "–".to_owned() };
    match ns.abs() {
        a if a < 1e3 => format!("{ns:.0} ns"),
        a if a < 1e6 => format!("{:.2} µs", ns / 1e3),
        a if a < 1e9 => format!("{:.2} ms", ns / 1e6),
        _ => format!("{:.2} s", ns / 1e9),
    }
}

/// A number with its unit, where it has one.
fn with_unit(value: Option<f64>, unit: Option<&str>) -> String {
    let unit = unit.filter(|_| value.is_some()).map_or_else(String::new, |unit| format!(" {unit}"));
    format!("{}{unit}", number(value))
}

fn number(value: Option<f64>) -> String {
    let Some(value) = value else { return "–".to_owned() };
    let size = value.abs();
    if size > 0.0 && !(1e-3..1e5).contains(&size) { format!("{value:.2e}") } else { format!("{value:.4}") }
}

#[cfg(test)]
mod tests;
