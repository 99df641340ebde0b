//! The study's table as CSV and as Markdown, and how its figures are written.

use std::fmt::Write as _;

use loopbound_monitor::summary::Quantiles;
pub use loopbound_monitor::verdict::expectations::time;
use loopbound_scenario::format_rate;

use super::Report;
use super::advice::Setting;
use super::case::Row;
use super::design::is_never;

/// A share for people, with the digits that it deserves; `?` where there is none.
#[must_use]
pub fn percent(share: Option<f64>) -> String {
    match share.map(|share| share * 100.0) {
        None => "?".to_owned(),
        Some(0.0) => "0 %".to_owned(),
        Some(value) if value < 0.01 => "<0.01 %".to_owned(),
        Some(value) if value < 1.0 => format!("{value:.2} %"),
        Some(value) if value < 10.0 => format!("{value:.1} %"),
        Some(value) => format!("{value:.0} %"),
    }
}

/// The table for programs: a line a case, times in ns, shares of 1; `inf` is a torque that never came. A figure that doesn't exist is an empty cell.
#[must_use]
pub fn csv(report: &Report) -> String {
    let mut csv = "rate_hz,wakeup,privileges,load,status,runs,ticks".to_owned();
    for hop in ["round_trip", "deadline_to_torque", "wakeup", "floor"] {
        let _ = write!(csv, ",{hop}_n,{hop}_p50_ns,{hop}_p99_ns,{hop}_p99_9_ns,{hop}_max_ns");
    }
    let quantile = report.quantile.key();
    let _ = write!(csv, ",latency_{quantile}_ns,latency_{quantile}_lower_ns,latency_{quantile}_upper_ns");
    csv.push_str(",missed_share,missed_by_host_share");
    let causes = causes(&report.rows);
    causes.iter().for_each(|cause| csv.push_str(&format!(",missed_{cause}")));
    csv.push_str(",overruns,cpu");
    let roles = roles(&report.rows);
    roles.iter().for_each(|role| csv.push_str(&format!(",cpu_{role}")));
    csv.push_str(",e_proven_rad,e_proven_lower_rad,e_proven_upper_rad,k_t,budget_used\n");
    for row in &report.rows {
        let status = format!("\"{}\"", status(row).replace('"', "\"\""));
        let _ = write!(csv, "{},{},{}", row.rate_hz, row.wakeup, row.privileges.word());
        let _ = write!(csv, ",{},{status},{},{}", row.load.name(), row.runs, row.ticks);
        let latency = &row.latency_ns;
        for q in [&latency.round_trip, &latency.deadline_to_torque, &latency.wakeup, &row.floor_ns] {
            let _ = write!(csv, ",{}", q.n);
            [q.p50, q.p99, q.p99_9, q.max].into_iter().for_each(|value| cell(&mut csv, value));
        }
        let estimate = row.latency.as_ref();
        let limits = [estimate.and_then(|e| e.lower_ns), estimate.and_then(|e| e.upper_ns)];
        for value in std::iter::once(estimate.map(|e| e.value_ns)).chain(limits) {
            match value {
                Some(value) if is_never(value) => csv.push_str(",inf"),
                value => cell(&mut csv, value),
            }
        }
        cell(&mut csv, row.missed_share);
        cell(&mut csv, row.missed_by_host_share);
        for cause in &causes {
            let _ = write!(csv, ",{}", row.missed_ticks_by_cause.get(*cause).copied().unwrap_or(0));
        }
        let _ = write!(csv, ",{}", row.overruns);
        cell(&mut csv, row.cpu);
        roles.iter().for_each(|role| cell(&mut csv, row.cpu_by_role.get(*role).copied()));
        for value in [row.e_proven_rad, row.e_proven_lower_rad, row.e_proven_upper_rad, row.k_t, row.budget_used] {
            cell(&mut csv, value);
        }
        csv.push('\n');
    }
    csv
}

fn cell(csv: &mut String, value: Option<f64>) {
    csv.push(',');
    if let Some(value) = value.filter(|value| value.is_finite()) {
        let _ = write!(csv, "{value}");
    }
}

/// Every name that is a key in some row, once.
fn names<'a>(all: impl Iterator<Item = &'a String>) -> Vec<&'a str> {
    let mut names: Vec<&str> = all.map(String::as_str).collect();
    names.sort_unstable();
    names.dedup();
    names
}

fn causes(rows: &[Row]) -> Vec<&str> {
    names(rows.iter().flat_map(|row| row.missed_ticks_by_cause.keys()))
}

fn roles(rows: &[Row]) -> Vec<&str> {
    names(rows.iter().flat_map(|row| row.cpu_by_role.keys()))
}

/// Whether a row has figures, and why not.
#[must_use]
pub fn status(row: &Row) -> String {
    match (&row.not_to_be_had, row.problems.last()) {
        (Some(why), _) => format!("not to be had: {why}"),
        (None, Some(why)) if row.runs == 0 => format!("failed: {why}"),
        (None, Some(why)) => format!("measured; {} run(s) failed: {why}", row.problems.len()),
        (None, None) if row.runs == 0 => "not measured".to_owned(),
        (None, None) => "measured".to_owned(),
    }
}

/// The names of the columns that people see.
#[must_use]
pub fn headings(report: &Report) -> Vec<String> {
    let quantile = report.quantile.name();
    let mut headings: Vec<String> = ["rate", "mode", "privileges", "load", "n"].map(str::to_owned).into();
    headings.push("round trip p50 / p99 / p99.9 / max".to_owned());
    headings.push("deadline → torque p50 / p99 / p99.9 / max".to_owned());
    headings.push(format!("that {quantile} with unanswered ticks, 95 %"));
    headings.extend(["floor p99", "missed", "by host", "causes", "overruns"].map(str::to_owned));
    headings.extend(["CPU", "proven |e|, rad", "[11] used"].map(str::to_owned));
    headings
}

/// A row as people see it.
#[must_use]
pub fn cells(row: &Row) -> Vec<String> {
    let four = |q: &Quantiles| [q.p50, q.p99, q.p99_9, q.max].map(time).join(" / ");
    let mut cells = vec![
        format_rate(row.rate_hz),
        row.wakeup.clone(),
        row.privileges.word().to_owned(),
        row.load.name().to_owned(),
        row.latency_ns.round_trip.n.to_string(),
    ];
    if row.runs == 0 {
        cells.push(status(row));
        cells.resize(16, "—".to_owned());
        return cells;
    }
    let mut by_cause: Vec<(&String, &u64)> = row.missed_ticks_by_cause.iter().filter(|(_, n)| **n > 0).collect();
    by_cause.sort_by(|a, b| b.1.cmp(a.1));
    let by_cause: Vec<String> = by_cause.iter().map(|(cause, n)| format!("{n} {}", cause.replace('_', " "))).collect();
    let number = |value: Option<f64>, digits| value.map_or("—".to_owned(), |value| format!("{value:.digits$}"));
    cells.extend([
        four(&row.latency_ns.round_trip),
        four(&row.latency_ns.deadline_to_torque),
        row.latency.map_or("—".to_owned(), |e| match (e.lower_ns, e.upper_ns) {
            _ if is_never(e.value_ns) => "never".to_owned(),
            (Some(lower), Some(upper)) => {
                format!("{} [{}, {}]", time(Some(e.value_ns)), time(Some(lower)), time(Some(upper)))
            }
            _ => time(Some(e.value_ns)),
        }),
        time(row.floor_ns.p99),
        percent(row.missed_share),
        percent(row.missed_by_host_share),
        by_cause.join(", "),
        row.overruns.to_string(),
        percent(row.cpu),
        number(row.e_proven_rad, 4),
        percent(row.budget_used),
    ]);
    cells
}

/// The names of the columns of [`setting_cells`].
pub const SETTING_HEADINGS: [&str; 8] =
    ["rate", "mode", "worst load", "latency", "missed", "CPU", "proven |e|, rad", "against it"];

/// A setting over all loads as people see it.
#[must_use]
pub fn setting_cells(report: &Report, setting: &Setting) -> Vec<String> {
    let row = report.rows.get(setting.worst_row);
    vec![
        format_rate(setting.rate_hz),
        setting.name(),
        row.map_or("—", |row| row.load.name()).to_owned(),
        time(row.and_then(|row| row.latency).map(|latency| latency.value_ns)),
        percent(Some(setting.missed_share)),
        percent(setting.cpu),
        setting.e_proven_rad.map_or("—".to_owned(), |w| format!("{w:.4}")),
        if setting.against.is_empty() { "nothing".to_owned() } else { setting.against.join("; ") },
    ]
}

/// The whole study for people.
#[must_use]
pub fn markdown(report: &Report) -> String {
    let mut text = format!("# Which setting for this machine\n\n{}\n", report.head().join("  \n"));
    let _ = writeln!(text, "\n## Recommendation\n\n{}\n", report.advice.words);
    if let Some(check) = &report.check {
        let _ = writeln!(text, "{}\n\n`loopbound run recommended.toml` runs it.\n", check.words);
    }
    text.push_str("## The best at each rate\n\n| rate | |\n|---|---|\n");
    for rate in &report.advice.rates {
        let _ = writeln!(text, "| {} | {} |", format_rate(rate.rate_hz), rate.words);
    }
    if !report.for_each_load.is_empty() {
        text.push_str("\n## If one load alone is to be expected\n\n| load | |\n|---|---|\n");
        for only in &report.for_each_load {
            let _ = writeln!(text, "| {} | {} |", only.load.name(), only.words);
        }
    }
    let _ = writeln!(text, "\n{}\n\n## Every setting\n\n| {} |", report.rules(), SETTING_HEADINGS.join(" | "));
    let _ = writeln!(text, "|{}", "---|".repeat(SETTING_HEADINGS.len()));
    for setting in &report.advice.settings {
        let _ = writeln!(text, "| {} |", setting_cells(report, setting).join(" | "));
    }
    text.push_str("\n## Every case\n\n![Every case](load.svg)\n\n");
    let headings = headings(report);
    let _ = writeln!(text, "| {} |\n|{}", headings.join(" | "), "---|".repeat(headings.len()));
    for row in &report.rows {
        let _ = writeln!(text, "| {} |", cells(row).join(" | "));
    }
    text
}
