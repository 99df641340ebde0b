//! A case of the study, what its runs came to, and how runs are added up.
//!
//! Histograms and counts are added, quantiles computed from the sum; a quantile is never averaged.

use std::collections::BTreeMap;

use clap::ValueEnum;
use loopbound_monitor::Summary;
use loopbound_monitor::hops::{Hop, Hops};
use loopbound_monitor::summary::{Latency, Quantiles};
use loopbound_monitor::verdict::blocks::Blocks;
use loopbound_monitor::verdict::comparison::{self, Estimate, QUANTILES};
use loopbound_scenario::{Hertz, Scenario, Wakeup};
use serde::{Deserialize, Serialize};

use super::cpu::CpuUse;
use super::options::Quantile;
use crate::commands::study::load::background::Kind;

/// The cause of a missed tick for which the guest has no explanation: the timer, or the host of a virtual machine.
pub const HOST: &str = "timer_or_host";

/// Whether a run asks for what only privileged users get.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rights {
    /// SCHED_FIFO, locked memory, no deep idle states.
    #[default]
    With,
    /// None of them.
    Without,
}

impl Rights {
    /// The word on the command line and in files.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::With => "with",
            Self::Without => "without",
        }
    }

    /// In a sentence after the mode.
    #[must_use]
    pub const fn phrase(self) -> &'static str {
        match self {
            Self::With => "with privileges",
            Self::Without => "without privileges",
        }
    }
}

/// One cell of the study.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Ticks per second.
    pub rate: Hertz,
    /// How the loop waits.
    pub wakeup: Wakeup,
    /// What it may ask for.
    pub rights: Rights,
    /// What runs beside it.
    pub load: Kind,
}

impl Case {
    /// The scenario with this case's setting.
    #[must_use]
    pub fn apply(&self, base: &Scenario) -> Scenario {
        let mut scenario = base.clone();
        scenario.loop_.rate = self.rate;
        scenario.loop_.wakeup = self.wakeup;
        if self.rights == Rights::Without {
            scenario.realtime.priority = 0;
            scenario.realtime.lock_memory = false;
            scenario.realtime.dma_latency = false;
        }
        scenario
    }

    /// Such as `1kHz hybrid with privileges, load cpu`.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{} {} {}, load {}", self.rate, self.wakeup, self.rights.phrase(), self.load.name())
    }
}

/// What one run left behind.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its figures.
    pub summary: Summary,
    /// Its histograms.
    pub hops: Hops,
    /// Its blocks, for intervals.
    pub blocks: Blocks,
    /// The CPU that its processes took.
    pub cpu: CpuUse,
}

/// All runs of a case so far.
#[derive(Clone, Debug, Default)]
pub struct Measured {
    /// Runs that were added.
    pub runs: u32,
    /// Why there are no figures, where the machine does not give what the case needs.
    pub refused: Option<String>,
    /// Runs that ended without figures, each with its reason.
    pub problems: Vec<String>,
    /// Ticks that were due: run or skipped.
    pub ticks: u64,
    missed_by_cause: BTreeMap<String, u64>,
    overruns: u64,
    hops: Hops,
    blocks: Option<Blocks>,
    cpu: CpuUse,
}

impl Measured {
    /// Adds a run.
    pub fn add(&mut self, run: Run) {
        let Run { summary, hops, blocks, cpu } = run;
        self.runs += 1;
        self.ticks += summary.ticks + summary.counters.get("skipped").copied().unwrap_or(0);
        self.overruns += summary.overruns;
        for (cause, count) in summary.missed_ticks_by_cause {
            *self.missed_by_cause.entry(cause).or_insert(0) += count;
        }
        for hop in Hop::ALL {
            // Both have the same range, so one can always be added to the other.
            let _ = self.hops.of_mut(hop).add(hops.of(hop).histogram());
            self.hops.of_mut(hop).note(&hops.of(hop).quantiles());
        }
        match &mut self.blocks {
            Some(all) => all.append(&blocks),
            None => self.blocks = Some(blocks),
        }
        self.cpu.add(&cpu);
    }

    /// The blocks of all its runs.
    #[must_use]
    pub fn blocks(&self) -> Option<&Blocks> {
        self.blocks.as_ref()
    }

    /// The latency that decides, with its interval. A tick that got no torque counts as one that never came.
    #[must_use]
    pub fn latency(&self, quantile: Quantile) -> Option<Estimate> {
        let at = QUANTILES.iter().position(|(key, _)| *key == quantile.key())?;
        comparison::estimates(Hop::DeadlineToTorque, self.blocks()?)?.get(at).copied()
    }

    /// Its line of the table, without what is computed from the latency.
    #[must_use]
    pub fn row(&self, case: &Case, quantile: Quantile) -> Row {
        let of = |hop| self.hops.of(hop).quantiles();
        let missed: u64 = self.missed_by_cause.values().sum();
        let share = |count: u64| (self.ticks > 0).then(|| count as f64 / self.ticks as f64);
        Row {
            rate_hz: case.rate.0,
            wakeup: case.wakeup.to_string(),
            privileges: case.rights,
            load: case.load,
            runs: self.runs,
            not_to_be_had: self.refused.clone(),
            problems: self.problems.clone(),
            ticks: self.ticks,
            latency_ns: self.hops.latency(),
            floor_ns: of(Hop::Floor),
            latency: self.latency(quantile),
            missed_ticks: missed,
            missed_share: share(missed),
            missed_by_host_share: share(self.missed_by_cause.get(HOST).copied().unwrap_or(0)),
            missed_ticks_by_cause: self.missed_by_cause.clone(),
            overruns: self.overruns,
            cpu: self.cpu.share(),
            cpu_by_role: self.cpu.by_role(),
            ..Row::default()
        }
    }
}

/// A line of the table. Latencies in ns; a figure that doesn't exist is `null`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Row {
    /// Ticks per second.
    pub rate_hz: f64,
    /// How the loop waited.
    pub wakeup: String,
    /// What it asked for.
    pub privileges: Rights,
    /// What ran beside it.
    pub load: Kind,
    /// Runs that the figures are of.
    pub runs: u32,
    /// Why the machine doesn't allow this case.
    pub not_to_be_had: Option<String>,
    /// Runs without figures, each with its reason.
    pub problems: Vec<String>,
    /// Ticks that were due.
    pub ticks: u64,
    /// Every hop, over all runs.
    pub latency_ns: Latency,
    /// The bare wake-up.
    pub floor_ns: Quantiles,
    /// The quantile of deadline → torque that decides; a tick without a torque counts as never, which is
    /// [`NEVER_NS`](loopbound_monitor::verdict::blocks::NEVER_NS).
    pub latency: Option<Estimate>,
    /// Skipped, or without a torque in time.
    pub missed_ticks: u64,
    /// The same over the ticks that were due.
    pub missed_share: Option<f64>,
    /// Of these the ones that only the timer or the host explains, over the ticks that were due.
    pub missed_by_host_share: Option<f64>,
    /// All of them by cause.
    pub missed_ticks_by_cause: BTreeMap<String, u64>,
    /// Wake-ups after the next deadline.
    pub overruns: u64,
    /// CPU of all processes over time, of one core; none where it could not be read.
    pub cpu: Option<f64>,
    /// The same by role.
    pub cpu_by_role: BTreeMap<String, f64>,
    /// The smallest proven |e| that the latency allows (rad), with the limits that belong to those of the latency.
    pub e_proven_rad: Option<f64>,
    /// That for the lower limit of the latency.
    pub e_proven_lower_rad: Option<f64>,
    /// That for its upper limit; none also where that allows no certificate.
    pub e_proven_upper_rad: Option<f64>,
    /// Gain with which it is proven, N·m·s.
    pub k_t: Option<f64>,
    /// Share of \[11] that the gains in the run used at this latency.
    pub budget_used: Option<f64>,
}
