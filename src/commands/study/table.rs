//! The paper's study as a table: for programs as CSV, for people as Markdown.

use std::fmt::Write as _;

use super::cases::Case;
use super::measure::Measured;

/// A law in a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The case.
    pub case: Case,
    /// Name of the law with its gains.
    pub law: String,
    /// What came out.
    pub measured: Measured,
}

/// Every law in every case.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// By case, then by law.
    pub rows: Vec<Row>,
}

/// Columns of the CSV. Errors count from `loop.settle` on; an empty cell is a number that doesn't exist. `ticks_latency` are
/// those that the age of the torque explains: all of the studies' delays are declared, so most are the designed hold.
pub const COLUMNS: [&str; 19] = [
    "case",
    "law",
    "lost_at_s",
    "e_max_rad",
    "e_rms_rad",
    "ed_max_rad_s",
    "ed_rms_rad_s",
    "effort_nm",
    "torque_peak_nm",
    "chattering",
    "certified",
    "ultimate_e_rad",
    "bound_used",
    "v_max",
    "level",
    "ticks_latency",
    "ticks_controller_fault",
    "ticks_uncertainty_exceeded",
    "sampling_budget_used",
];

impl Table {
    /// The row of a law in a case.
    #[must_use]
    pub fn get(&self, case: Case, law: &str) -> Option<&Measured> {
        self.rows.iter().find(|row| row.case == case && row.law == law).map(|row| &row.measured)
    }

    /// The cases, each once, in order.
    #[must_use]
    pub fn cases(&self) -> Vec<Case> {
        let mut cases: Vec<Case> = Vec::new();
        for row in &self.rows {
            if !cases.contains(&row.case) {
                cases.push(row.case);
            }
        }
        cases
    }

    /// The laws, each once, in order.
    #[must_use]
    pub fn laws(&self) -> Vec<String> {
        let mut laws: Vec<String> = Vec::new();
        for row in &self.rows {
            if !laws.contains(&row.law) {
                laws.push(row.law.clone());
            }
        }
        laws
    }

    /// One line a row below [`COLUMNS`] and the largest error of each link.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let links = self.rows.first().map_or(0, |row| row.measured.e_max_rad.len());
        let mut csv = COLUMNS.join(",");
        for link in 1..=links {
            let _ = write!(csv, ",e{link}_max_rad");
        }
        csv.push('\n');
        for row in &self.rows {
            let m = &row.measured;
            let some = |x: Option<f64>| x.map_or_else(String::new, number);
            let cells = [
                row.case.name(),
                row.law.clone(),
                some(m.lost_at_s),
                number(m.worst_e_rad()),
                number(m.rms_e_rad()),
                number(m.worst_ed_rad_s()),
                number(m.rms_ed_rad_s()),
                number(m.effort_nm),
                number(m.torque_peak_nm),
                number(m.chattering),
                m.bound.certified.to_string(),
                some(m.bound.ultimate_bound),
                some(m.bound_used()),
                some(m.bound.v_max),
                some(m.bound.level),
                (m.verdicts("latency") + m.verdicts("designed_hold")).to_string(),
                m.verdicts("controller_fault").to_string(),
                m.verdicts("uncertainty_exceeded").to_string(),
                some(m.bound.budget_used),
            ];
            csv.push_str(&cells.join(","));
            for e in &m.e_max_rad {
                let _ = write!(csv, ",{}", number(*e));
            }
            csv.push('\n');
        }
        csv
    }

    /// A table of the columns that people compare.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = String::from(
            "| case | law | max \\|e_i\\| rad | RMS e rad | max \\|ė_i\\| rad/s | RMS ė rad/s | effort N·m | peak N·m | \
             chattering | certified limsup \\|e\\| rad | used | V max / c | [11] used |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
        );
        for row in &self.rows {
            let m = &row.measured;
            let case = row.case.name();
            if let Some(at) = m.lost_at_s {
                let _ = writeln!(text, "| {case} | {} | lost at {at:.2} s | | | | | | | | | | |", row.law);
                continue;
            }
            let bound = m.bound.ultimate_bound.map_or_else(|| "none".to_owned(), short);
            let used = m.bound_used().map_or_else(String::new, |used| format!("{:.1} %", used * 100.0));
            let budget = m.bound.budget_used.map_or_else(String::new, |used| format!("{:.0} %", used * 100.0));
            let level = m.bound.v_max.zip(m.bound.level).filter(|_| m.bound.certified);
            let level = level.map_or_else(String::new, |(v, c)| format!("{} / {}", short(v), short(c)));
            let _ = writeln!(
                text,
                "| {case} | {} | {} | {} | {} | {} | {} | {} | {} | {bound} | {used} | {level} | {budget} |",
                row.law,
                short(m.worst_e_rad()),
                short(m.rms_e_rad()),
                short(m.worst_ed_rad_s()),
                short(m.rms_ed_rad_s()),
                short(m.effort_nm),
                short(m.torque_peak_nm),
                short(m.chattering),
            );
        }
        text
    }
}

/// Three significant digits, for people.
#[must_use]
pub fn short(value: f64) -> String {
    let size = value.abs();
    match size {
        _ if !value.is_finite() => "–".to_owned(),
        _ if size >= 100.0 => format!("{value:.0}"),
        _ if size >= 10.0 => format!("{value:.1}"),
        _ if size >= 1.0 => format!("{value:.2}"),
        _ if size >= 0.001 => format!(
            "{value:.*}",
            if size >= 0.1 {
                3
            } else if size >= 0.01 {
                4
            } else {
                5
            }
        ),
        _ if size > 0.0 => format!("{value:.1e}"),
        _ => "0".to_owned(),
    }
}

/// Six significant digits, for programs; empty for what is not a number.
fn number(value: f64) -> String {
    if value.is_finite() { format!("{value:.5e}") } else { String::new() }
}
