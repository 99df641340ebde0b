//! The figures as a table, or as JSON.

use anyhow::Result;
use serde::Serialize;

use loopbound_shared::say;

use crate::host::Host;
use crate::kernels::Kernel;
use crate::statistics::{Ratio, Row};

/// Everything that a run has found.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    pub(crate) version: u32,
    pub(crate) host: Host,
    pub(crate) privileges: [String; 2],
    /// 0: back to back.
    pub(crate) period_ns: u64,
    pub(crate) rounds: u64,
    pub(crate) rows: Vec<Row>,
    pub(crate) kernels: Vec<Kernel>,
}

impl Report {
    pub(crate) fn new(host: Host) -> Self {
        let privileges = [String::new(), String::new()];
        Self { version: 1, host, privileges, period_ns: 0, rounds: 0, rows: Vec::new(), kernels: Vec::new() }
    }

    pub(crate) fn print(&self, json: bool) -> Result<()> {
        if json {
            say::out!("{}", serde_json::to_string_pretty(self)?);
            return Ok(());
        }
        self.print_host();
        if !self.rows.is_empty() {
            self.print_rows();
        }
        if !self.kernels.is_empty() {
            self.print_kernels();
        }
        Ok(())
    }

    fn print_host(&self) {
        let Host { taken_at, machine, cpu, cores, virtualised, kernel, clock_source, governor, load, commit } =
            &self.host;
        say::out!("{taken_at}, commit {commit}");
        say::out!("{cpu}, {machine}, {cores} cores{}", if *virtualised { ", virtualised" } else { "" });
        say::out!("kernel {kernel}, clock {clock_source}, governor {governor}, load {load}");
        for privileges in self.privileges.iter().filter(|text| !text.is_empty()) {
            say::out!("{privileges}");
        }
    }

    fn print_rows(&self) {
        let pace = if self.period_ns == 0 {
            "back to back".to_owned()
        } else {
            format!("one every {} µs", self.period_ns / 1000)
        };
        say::out!("\nState out, torque back, {pace}; blocks of all interleaved over {} rounds. µs.", self.rounds);
        say::out!(
            "{:<26}{:>8}{:>9}{:>9}{:>9}{:>10}  ratio of p50 to its baseline",
            "",
            "n",
            "p50",
            "p99",
            "p99.9",
            "max"
        );
        for row in &self.rows {
            let ratio = row.ratio.as_ref().map_or_else(String::new, describe);
            say::out!(
                "{:<26}{:>8}{:>9}{:>9}{:>9}{:>10}  {ratio}",
                row.name,
                row.n,
                micros(row.p50_ns),
                micros(row.p99_ns),
                micros(row.p99_9_ns),
                micros(row.max_ns),
            );
        }
    }

    fn print_kernels(&self) {
        say::out!("\nKernels, ns a call: median over batches (10 % … 90 %).");
        say::out!("{:<22}{:>24}{:>24}{:>24}", "", "1 link", "3 links", "7 links");
        let names: Vec<_> = self.kernels.iter().filter(|kernel| kernel.links == 1).map(|kernel| kernel.name).collect();
        for name in names {
            let cells = self.kernels.iter().filter(|kernel| kernel.name == name).map(|kernel| {
                let Kernel { median_ns, p10_ns, p90_ns, .. } = kernel;
                format!("{:>24}", format!("{median_ns:.1} ({p10_ns:.1} … {p90_ns:.1})"))
            });
            say::out!("{name:<22}{}", cells.collect::<String>());
        }
        for Kernel { name, links, median_ns, aim_ns, .. } in &self.kernels {
            if let Some(aim_ns) = aim_ns {
                let verdict = if median_ns < aim_ns { "met" } else { "missed" };
                say::out!("{name}, {links} links: {median_ns:.1} ns, aim < {aim_ns} ns: {verdict}");
            }
        }
    }
}

fn micros(ns: u64) -> String {
    format!("{}.{:02}", ns / 1000, ns % 1000 / 10)
}

fn describe(ratio: &Ratio) -> String {
    let Ratio { baseline, median, low, high, confidence, aim, met } = ratio;
    let verdict = match (aim, met) {
        (None, _) => String::new(),
        (Some(aim), Some(true)) => format!(", aim {aim}: met"),
        (Some(aim), Some(false)) => format!(", aim {aim}: missed"),
        (Some(aim), None) => format!(", aim {aim}: undecided"),
    };
    format!("{median:.3} × {baseline} [{low:.3}, {high:.3}] at {:.1} %{verdict}", 100.0 * confidence)
}
