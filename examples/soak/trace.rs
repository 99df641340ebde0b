//! What a recorded run says, tick by tick: what was missed and why, and how far the torque stepped.

use std::collections::BTreeMap;
use std::path::Path;

use loopbound_shared::say;
use serde_json::Value;

/// Misses this soon after a change, in ticks, may be of it.
const WINDOW_TICKS: u64 = 50;

/// A recorded run.
pub(crate) struct Trace {
    /// Ticks missed, by the tick in which that was noticed, and their cause.
    missed: BTreeMap<u64, (u64, String)>,
    /// The largest step of a joint's torque from the tick before, N·m.
    steps: BTreeMap<u64, f64>,
}

impl Trace {
    pub(crate) fn read(folder: &Path) -> anyhow::Result<Self> {
        let mut missed = BTreeMap::new();
        for line in std::fs::read_to_string(folder.join("events.jsonl"))?.lines() {
            let event: Value = serde_json::from_str(line)?;
            if let ("missed", Some(tick)) = (event["kind"].as_str().unwrap_or(""), event["tick"].as_u64()) {
                let cause = event["cause"].as_str().unwrap_or("unknown").to_owned();
                missed.insert(tick, (event["ticks"].as_u64().unwrap_or(1), cause));
            }
        }
        Ok(Self { missed, steps: steps(&std::fs::read_to_string(folder.join("samples.csv"))?) })
    }

    /// The largest step within so many ticks from `tick` on.
    pub(crate) fn step(&self, tick: u64, within: u64) -> Option<f64> {
        self.steps.range(tick..tick + within).map(|(_, step)| *step).reduce(f64::max)
    }

    /// Steps of the ticks that are in no window of a change.
    pub(crate) fn ordinary_steps(&self, changes: &[u64]) -> Vec<f64> {
        self.steps.iter().filter(|(tick, _)| !within(**tick, changes)).map(|(_, step)| *step).collect()
    }

    /// Ticks missed near the changes, by cause, and how often the same happens elsewhere.
    pub(crate) fn print_missed(&self, what: &str, changes: &[u64]) {
        let (mut near, mut near_ticks, mut elsewhere_ticks) = (BTreeMap::<&str, u64>::new(), 0, 0);
        for (tick, (ticks, cause)) in &self.missed {
            if within(*tick, changes) {
                *near.entry(cause).or_default() += ticks;
                near_ticks += ticks;
            } else {
                elsewhere_ticks += ticks;
            }
        }
        let total = self.steps.len() as u64;
        let near_of = self.steps.keys().filter(|tick| within(**tick, changes)).count() as u64;
        let share = |ticks: u64, of: u64| 100.0 * ticks as f64 / of.max(1) as f64;
        say::out!(
            "  missed within {WINDOW_TICKS} ticks of {what}: {near_ticks} ({:.2} % of these ticks; elsewhere {:.2} %): {near:?}",
            share(near_ticks, near_of),
            share(elsewhere_ticks, total - near_of),
        );
    }
}

fn within(tick: u64, changes: &[u64]) -> bool {
    let before = changes.partition_point(|change| *change <= tick);
    before > 0 && tick - changes[before - 1] < WINDOW_TICKS
}

fn steps(samples: &str) -> BTreeMap<u64, f64> {
    let mut lines = samples.lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let columns: Vec<usize> = (0..header.len()).filter(|i| header[*i].starts_with("tau")).collect();
    let mut steps = BTreeMap::new();
    let mut before: Option<Vec<f64>> = None;
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let tau: Vec<f64> = columns.iter().filter_map(|i| cells.get(*i)?.parse().ok()).collect();
        let Some(tick) = cells.first().and_then(|tick| tick.parse().ok()) else { continue };
        if let Some(before) = before.replace(tau.clone()) {
            let step = tau.iter().zip(&before).map(|(new, old)| (new - old).abs()).fold(0.0, f64::max);
            steps.insert(tick, step);
        }
    }
    steps
}
