//! The study as heat maps: a cell for each case, one map for each thing that one chooses by.

use loopbound_monitor::chart::{Figure, HeatMap, Panel, Scale};
use loopbound_scenario::format_rate;

use super::Report;
use super::case::{Rights, Row};
use super::design::is_never;

/// Room for twelve columns whose cells hold two figures.
const WIDTH_PX: u32 = 1080;
/// Shares below this look alike: one tick in ten thousand.
const SHARE_MIN: f64 = 1e-4;

/// All maps of a report, one above the other.
#[must_use]
pub fn maps(report: &Report) -> Figure {
    let quantile = report.quantile.name();
    let rows = &report.rows;
    let us = |row: &Row| row.latency.filter(|e| !is_never(e.value_ns)).map(|e| e.value_ns * 1e-3);
    let missed = |row: &Row| row.missed_share.map(|share| share.max(SHARE_MIN));
    let panels = vec![
        panel(rows, &format!("(a) deadline → torque, {quantile} (µs); unanswered ticks count as never"), us, |row| {
            us(row).map_or("never".to_owned(), short)
        }),
        panel(rows, "(b) ticks missed (%): by the loop + by the timer or the host", missed, |row| {
            let host = row.missed_by_host_share.unwrap_or(0.0);
            format!("{}+{}", hundredths(row.missed_share.unwrap_or(0.0) - host), hundredths(host))
        }),
        panel(
            rows,
            "(c) CPU of all processes (% of one core)",
            |row| row.cpu,
            |row| row.cpu.map_or("?".to_owned(), |cpu| format!("{:.0}", cpu * 100.0)),
        ),
        panel(
            rows,
            "(d) the smallest proven |e| that the latency allows (rad)",
            |row| row.e_proven_rad,
            |row| row.e_proven_rad.map_or("none".to_owned(), short),
        ),
    ];
    Figure { title: "Which setting for this machine".to_owned(), panels, width_px: WIDTH_PX, panel_height_px: 0 }
}

fn panel(rows: &[Row], title: &str, value: impl Fn(&Row) -> Option<f64>, label: impl Fn(&Row) -> String) -> Panel {
    let line = |row: &Row| match row.privileges {
        Rights::With => row.wakeup.clone(),
        Rights::Without => format!("{}, no privileges", row.wakeup),
    };
    let column = |row: &Row| format!("{}\n{}", format_rate(row.rate_hz), row.load.name());
    let (lines, columns) = (once(rows, line), once(rows, column));
    let at = |l: &String, c: &String| rows.iter().find(|row| line(row) == *l && column(row) == *c);
    let grid = |of: &dyn Fn(&Row) -> f64| -> Vec<Vec<f64>> {
        lines.iter().map(|l| columns.iter().map(|c| at(l, c).map_or(f64::NAN, of)).collect()).collect()
    };
    let values = grid(&|row| value(row).unwrap_or(f64::NAN));
    let written = |row: &Row| if row.runs == 0 { "—".to_owned() } else { label(row) };
    let labels =
        lines.iter().map(|l| columns.iter().map(|c| at(l, c).map_or("—".to_owned(), written)).collect()).collect();
    Panel::heat(title, HeatMap { columns, rows: lines, values, labels, scale: Scale::Log })
}

/// Every name once, in order.
fn once(rows: &[Row], name: impl Fn(&Row) -> String) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for name in rows.iter().map(name) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

/// Three digits.
fn short(value: f64) -> String {
    let decimals = if value >= 100.0 {
        0
    } else if value >= 10.0 {
        1
    } else if value >= 1.0 {
        2
    } else {
        3
    };
    format!("{value:.decimals$}")
}

/// A share in per cent, as short as a cell needs it.
fn hundredths(share: f64) -> String {
    let value = share * 100.0;
    if value < 0.005 {
        "0".to_owned()
    } else if value < 9.95 {
        format!("{value:.2}")
    } else {
        format!("{value:.0}")
    }
}
