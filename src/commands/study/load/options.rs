//! What the study is asked for: the command line, what it leaves open, and how long all of it will take.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use loopbound_model::law::{Gain, LawKind};
use loopbound_scenario::{Hertz, Mode, Nanos, Scenario, Wakeup, parse_duration, parse_rate};
use loopbound_shared::clock::{NS_PER_S, seconds};
use serde::{Deserialize, Serialize};

use super::case::{Case, Rights};
use crate::commands::options::word;
use crate::commands::study::load::background::Kind;
use crate::exit::Failure;
use crate::supervise::prepare;

/// The shortest run that still has latencies to show once its start-up is left out, ns.
const RUN_NS_MIN: u64 = 400_000_000;
/// What a run takes besides: starting four processes, ending them, writing files. Measured: 0.2 to 0.4 s.
const AROUND_NS: u64 = 400_000_000;
/// Rates that nobody asked for: where a loop can be at home on an ordinary machine.
const RATES: [Hertz; 4] = [Hertz(500.0), Hertz(1e3), Hertz(2e3), Hertz(5e3)];
/// Rounds at most.
const ROUNDS_MAX: u32 = 100;

/// `loopbound study load`.
#[derive(Clone, Debug, Args)]
pub struct LoadArgs {
    /// Scenario file (TOML) whose loop is measured; default the paper's case.
    pub scenario: Option<PathBuf>,
    /// Set any key of the scenario; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Folder for the page, the tables, the pictures and recommended.toml.
    #[arg(long, value_name = "DIR", default_value = "study-load")]
    pub out: PathBuf,
    /// One rate and one short round: under a minute, and no confidence intervals.
    #[arg(long)]
    pub quick: bool,
    /// Rates; default 500Hz,1kHz,2kHz,5kHz, with --quick 1kHz.
    #[arg(long, value_delimiter = ',', value_parser = rate, value_name = "RATE,…")]
    pub rates: Vec<Hertz>,
    /// Wake-up modes; default all.
    #[arg(long, value_delimiter = ',', value_parser = word::<Wakeup>, value_name = "HOW,…")]
    pub wakeups: Vec<Wakeup>,
    /// Background loads; default all.
    #[arg(long, value_delimiter = ',', value_enum, value_name = "LOAD,…")]
    pub loads: Vec<Kind>,
    /// With and without SCHED_FIFO, locked memory and /dev/cpu_dma_latency; default both.
    #[arg(long, value_delimiter = ',', value_enum, value_name = "RIGHTS,…")]
    pub privileges: Vec<Rights>,
    /// How long each case is measured, all rounds together; default 3s, with --quick 2400ms.
    #[arg(long, value_parser = duration, value_name = "TIME")]
    pub duration: Option<Nanos>,
    /// Rounds over all cases, so that a noisy minute hits all of them; default 3, with --quick 1.
    #[arg(long, value_name = "N")]
    pub rounds: Option<u32>,
    /// The latency that a setting is judged by: this quantile of deadline → torque.
    #[arg(long, value_enum, default_value = "p99", value_name = "QUANTILE")]
    pub quantile: Quantile,
    /// Share of missed ticks that is put up with, under every load.
    #[arg(long, value_parser = percent, default_value = "1%", value_name = "SHARE")]
    pub missed_max: Percent,
    /// CPU that all processes of the loop together may take, of one core; 200% are two cores.
    #[arg(long, value_parser = percent, default_value = "150%", value_name = "SHARE")]
    pub cpu_max: Percent,
    /// How much of the room that sampling and latency leave a recommended gain may use.
    #[arg(long, value_parser = percent, default_value = "60%", value_name = "SHARE")]
    pub room: Percent,
    /// Print table.json instead of the recommendation.
    #[arg(long)]
    pub json: bool,
}

/// A share, written in per cent.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Serialize)]
pub struct Percent(pub f64);

/// Which quantile of deadline → torque decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
pub enum Quantile {
    /// 99 % of the ticks.
    #[value(name = "p99")]
    P99,
    /// 99.9 % of the ticks; needs long runs.
    #[value(name = "p99.9")]
    P999,
}

impl Quantile {
    /// As people write it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::P99 => "p99",
            Self::P999 => "p99.9",
        }
    }

    /// The key in files.
    #[must_use]
    pub const fn key(self) -> &'static str {
        match self {
            Self::P99 => "p99",
            Self::P999 => "p99_9",
        }
    }

    /// The share of ticks that may be later.
    #[must_use]
    pub const fn rest(self) -> f64 {
        match self {
            Self::P99 => 0.01,
            Self::P999 => 0.001,
        }
    }
}

fn rate(text: &str) -> Result<Hertz, String> {
    parse_rate(text).map(Hertz).map_err(|e| e.to_string())
}

fn duration(text: &str) -> Result<Nanos, String> {
    parse_duration(text).map(Nanos).map_err(|e| e.to_string())
}

fn percent(text: &str) -> Result<Percent, String> {
    let number = text.strip_suffix('%').and_then(|number| number.trim().parse::<f64>().ok());
    match number {
        Some(value) if value.is_finite() && value >= 0.0 => Ok(Percent(value / 100.0)),
        _ => Err("allowed: a number with a per cent sign such as 1%, not negative".to_owned()),
    }
}

/// What will be run: every case in every round.
#[derive(Clone, Debug)]
pub struct Plan {
    /// What every case begins from.
    pub base: Scenario,
    /// By rate, privileges, wake-up mode and load.
    pub cases: Vec<Case>,
    /// How often each is run.
    pub rounds: u32,
    /// Length of one run, ns.
    pub run_ns: u64,
    /// The quantile that decides.
    pub quantile: Quantile,
    /// Largest share of missed ticks.
    pub missed_max: f64,
    /// Most CPU, of one core.
    pub cpu_max: f64,
    /// Share of \[11] that a gain may use.
    pub room: f64,
}

impl LoadArgs {
    /// Fills in what was left open.
    ///
    /// # Errors
    /// If the scenario is refused, or an option is out of its range; the message names it.
    pub fn plan(&self) -> anyhow::Result<Plan> {
        let base = self.base()?;
        let rates = or(&self.rates, if self.quick { &[Hertz(1e3)] } else { &RATES });
        let rounds = self.rounds.unwrap_or(if self.quick { 1 } else { 3 });
        if !(1..=ROUNDS_MAX).contains(&rounds) {
            return Err(Failure::usage(format!("--rounds: found {rounds}, allowed: 1 to {ROUNDS_MAX}")).into());
        }
        let default_ns = if self.quick { 2_400_000_000 } else { 3 * NS_PER_S };
        let duration_ns = self.duration.map_or(default_ns, Nanos::ns);
        let run_ns = duration_ns / u64::from(rounds);
        if run_ns < RUN_NS_MIN {
            let least = Nanos(RUN_NS_MIN * u64::from(rounds));
            let found = Nanos(duration_ns);
            let why = format!("--duration: found {found} for {rounds} round(s), allowed: at least {least}");
            return Err(Failure::usage(why).into());
        }
        if !(self.room.0 > 0.0 && self.room.0 <= 1.0) {
            return Err(Failure::usage(format!("--room: found {} %, allowed: up to 100 %", self.room.0 * 100.0)).into());
        }
        let plan = Plan {
            cases: self.cases(&rates),
            rounds,
            run_ns,
            quantile: self.quantile,
            missed_max: self.missed_max.0,
            cpu_max: self.cpu_max.0,
            room: self.room.0,
            base,
        };
        for case in &plan.cases {
            // Setting the rate again is what checks it, with all that follows from it.
            let set = [format!("loop.rate={}", case.rate)];
            plan.base.clone().with_sets(&set).map_err(|e| Failure::usage(format!("--rates: {e}")))?;
        }
        Ok(plan)
    }

    fn base(&self) -> anyhow::Result<Scenario> {
        let (mut scenario, origin) = Scenario::read(self.scenario.as_deref(), &self.set)?;
        prepare::system_of(&scenario).map_err(|error| origin.locate(error))?;
        let law = scenario.controller.law;
        let has_k_t = |law: LawKind| law.uses(Gain::KTotal);
        if !has_k_t(law) {
            let allowed = LawKind::names(has_k_t);
            let why = format!("controller.law: found {law}, allowed: {allowed} (‖W‖ is searched for these)");
            return Err(Failure::usage(why).into());
        }
        // Lockstep has no latency, and what a run is expected to show is not the question here.
        scenario.loop_.mode = Mode::Realtime;
        scenario.expect = Default::default();
        Ok(scenario)
    }

    fn cases(&self, rates: &[Hertz]) -> Vec<Case> {
        let wakeups = or(&self.wakeups, &[Wakeup::Hybrid, Wakeup::Block, Wakeup::Spin, Wakeup::Event]);
        let loads = or(&self.loads, &[Kind::None, Kind::Cpu, Kind::MemoryIo]);
        let rights = or(&self.privileges, &[Rights::With, Rights::Without]);
        let mut cases = Vec::new();
        for rate in rates {
            for rights in &rights {
                for wakeup in &wakeups {
                    cases.extend(loads.iter().map(|load| Case {
                        rate: *rate,
                        wakeup: *wakeup,
                        rights: *rights,
                        load: *load,
                    }));
                }
            }
        }
        cases
    }
}

/// What was given, each once; the default if nothing was.
fn or<T: Copy + PartialEq>(given: &[T], default: &[T]) -> Vec<T> {
    let mut once: Vec<T> = Vec::new();
    for value in if given.is_empty() { default } else { given } {
        if !once.contains(value) {
            once.push(*value);
        }
    }
    once
}

impl Plan {
    /// Runs in all.
    #[must_use]
    pub fn runs(&self) -> usize {
        self.cases.len() * usize::try_from(self.rounds).unwrap_or(usize::MAX)
    }

    /// How long the study will take, s: every run, and the last one that checks the recommendation.
    #[must_use]
    pub fn estimate_s(&self) -> f64 {
        let measured_ns = self.run_ns * u64::from(self.rounds);
        seconds(self.runs() as u64 * (self.run_ns + AROUND_NS) + measured_ns + AROUND_NS)
    }

    /// The cases of a round, begun elsewhere in each: what the machine does every few minutes hits no case twice.
    pub fn round(&self, round: u32) -> impl Iterator<Item = usize> {
        let (all, round) = (self.cases.len(), usize::try_from(round).unwrap_or(0));
        let first = round * all / usize::try_from(self.rounds).unwrap_or(1).max(1);
        (0..all).map(move |at| (first + at) % all)
    }
}
