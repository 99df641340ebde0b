//! `loopbound doctor`: what this machine will do to a loop at kHz rates, what each shortcoming costs, what mends it.
//!
//! Responsible for findings and their form. What needs the running system is probed once in `live`; what stands in
//! files is read below a root folder that tests can fake. Nothing here changes the machine.
//! Where a cost carries figures, they were measured on one machine (a 2-core KVM guest, kernel 6.18, 250 Hz tick), and
//! are said to be: they show the order of magnitude, not what another machine will do.

mod cgroup;
mod hardware;
mod kernel;
mod live;
mod privileges;
mod tree;
mod wakeup;

use std::io::Write as _;
use std::path::Path;

use loopbound_shared::clock;
use loopbound_shared::say;
use serde::Serialize;

use crate::exit::Exit;

pub use live::{Live, Stalls};
use tree::Tree;
pub use wakeup::Lateness;

/// The version of the JSON form.
pub const REPORT_VERSION: u32 = 1;
/// The width that [`render`] keeps.
const COLUMNS: usize = 100;

/// How a finding bears on a real-time loop; the order is that of the report, worst first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Expect missed deadlines because of it.
    Bad,
    /// It costs, more or less rarely.
    Warn,
    /// It could not be found out.
    Unknown,
    /// As it should be.
    Good,
}

/// One thing looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// A stable name.
    pub key: &'static str,
    /// How it bears on a loop.
    pub status: Status,
    /// What was found.
    pub found: String,
    /// What it costs; none where it is good.
    pub cost: Option<String>,
    /// The command, or the advice where no command exists, that mends it.
    pub mend: Option<String>,
}

impl Finding {
    fn good(key: &'static str, found: impl Into<String>) -> Self {
        Self { key, status: Status::Good, found: found.into(), cost: None, mend: None }
    }

    fn new(key: &'static str, status: Status, found: impl Into<String>, cost: &str, mend: &str) -> Self {
        let (cost, mend) = (Some(cost.to_owned()), Some(mend.to_owned()));
        Self { key, status, found: found.into(), cost, mend }
    }

    fn unknown(key: &'static str, found: impl Into<String>, cost: &str) -> Self {
        Self { key, status: Status::Unknown, found: found.into(), cost: Some(cost.to_owned()), mend: None }
    }
}

/// All findings on one machine, worst first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Report {
    /// [`REPORT_VERSION`].
    pub version: u32,
    /// When it was taken: UTC, RFC 3339.
    pub taken_at: String,
    /// The release of the kernel, or "unknown".
    pub kernel: String,
    /// The status of the worst finding.
    pub worst: Status,
    /// Worst first; within a status in the order in which they were looked at.
    pub findings: Vec<Finding>,
}

/// Examines this machine; takes about a second, in part of which it keeps one core busy to notice stalls, and half a
/// second more where cyclictest is installed.
#[must_use]
pub fn examine() -> Report {
    report(Path::new("/"), &Live::probe())
}

/// The report on the machine whose files stand below `root`, with what was probed of the running system.
#[must_use]
pub fn report(root: &Path, live: &Live) -> Report {
    let tree = Tree::new(root);
    let mut findings = vec![
        privileges::sched_fifo(&tree, live),
        cgroup::rt_budget(&tree, live),
        cgroup::cpu_quota(&tree),
        privileges::dma_latency(&tree),
        privileges::memory_lock(&tree, live),
        privileges::shared_memory(&tree),
        kernel::throttling(&tree),
        live.stalls_finding(),
        wakeup::finding(live.wake_up, live.cyclictest),
        hardware::cores(&tree),
        hardware::load(&tree),
        hardware::virtualised(&tree),
        hardware::steal_time(&tree),
        kernel::preemption(&tree),
        kernel::isolated_cores(&tree),
        kernel::tick(&tree, live),
        kernel::huge_pages(&tree),
        hardware::clock_source(&tree, live),
        hardware::governor(&tree),
        hardware::idle_states(&tree),
        hardware::hyper_threading(&tree),
    ];
    // The sort is stable.
    findings.sort_by_key(|finding| finding.status);
    Report {
        version: REPORT_VERSION,
        taken_at: clock::wall_time(),
        kernel: tree.line("proc/sys/kernel/osrelease").unwrap_or_else(|| "unknown".to_owned()),
        worst: findings.first().map_or(Status::Unknown, |finding| finding.status),
        findings,
    }
}

/// The report as text of at most 100 columns; commands stay on one line each, to be copied.
#[must_use]
pub fn render(report: &Report) -> String {
    let mut text = format!("kernel {}, examined {}\n", report.kernel, report.taken_at);
    for finding in &report.findings {
        let status = match finding.status {
            Status::Bad => "BAD",
            Status::Warn => "warn",
            Status::Unknown => "?",
            Status::Good => "good",
        };
        text.push_str(&wrapped(&format!("{status:<5} {:<22} ", finding.key), &finding.found));
        if let Some(cost) = &finding.cost {
            text.push_str(&wrapped("        costs: ", cost));
        }
        if let Some(mend) = &finding.mend {
            text.push_str(&format!("        fix:   {mend}\n"));
        }
    }
    let count = |status| report.findings.iter().filter(|finding| finding.status == status).count();
    let (bad, warn, unknown) = (count(Status::Bad), count(Status::Warn), count(Status::Unknown));
    text.push_str(&format!("{bad} bad, {warn} to fix if you can, {unknown} unknown, {} good\n", count(Status::Good)));
    text
}

/// `text` in lines of at most [`COLUMNS`], the first after `head` and the others indented as far.
fn wrapped(head: &str, text: &str) -> String {
    let indent = head.chars().count();
    let (mut lines, mut column) = (head.to_owned(), indent);
    for word in text.split_whitespace() {
        let length = word.chars().count();
        if column > indent && column + 1 + length > COLUMNS {
            lines.push('\n');
            lines.extend(std::iter::repeat_n(' ', indent));
            column = indent;
        }
        if column > indent {
            lines.push(' ');
            column += 1;
        }
        lines.push_str(word);
        column += length;
    }
    lines.push('\n');
    lines
}

/// Examines the machine, and says what was found.
///
/// # Errors
/// If it can't be written.
pub fn run(json: bool) -> anyhow::Result<Exit> {
    let report = examine();
    let mut out = say::stdout();
    if json {
        writeln!(out, "{}", serde_json::to_string(&report)?)?;
    } else {
        write!(out, "{}", render(&report))?;
    }
    Ok(Exit::Held)
}

#[cfg(test)]
mod tests;
