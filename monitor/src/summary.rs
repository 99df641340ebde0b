//! The figures of a run as they are written: `summary.json`, its keys and its version.
//!
//! A figure that does not exist (no samples, nothing certified, not finite) is `null`, never NaN and never zero.
//! Keys are only ever added within one [`SCHEMA`]; whoever reads a file ignores keys it does not know.

mod bound;

use std::collections::BTreeMap;

use loopbound_shared::headline::Headline;
use loopbound_shared::realtime::Privileges;
use loopbound_shared::sample::Counters;
use serde::{Deserialize, Serialize};

pub use self::bound::{BoundSummary, LawSummary};
use crate::hops::Hop;
pub use crate::hops::Latency;

/// Version of the keys below; raised when one is removed or changes its meaning.
pub const SCHEMA: u32 = 1;

/// A figure for the file: `None` unless finite.
#[must_use]
pub fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// All figures of one run, as seen by one monitor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Summary {
    /// [`SCHEMA`] of the writer.
    pub schema: u32,
    /// Version of the program that wrote it.
    pub version: String,
    /// Identifies what the executables exchange, in hexadecimal.
    pub build: String,
    /// Name of the group.
    pub group: String,
    /// The run's id, 16 hexadecimal digits; empty in files of versions that had none.
    pub run_id: String,
    /// When it was written, UTC.
    pub written: String,
    /// How the watching ended.
    pub ended: String,
    /// Links of the chain.
    pub links: u32,
    /// Ticks that the plant closed, since its start.
    pub ticks: u64,
    /// Ticks of which this monitor has the record.
    pub ticks_seen: u64,
    /// The first of them: later than 0 when the monitor attached to a running group.
    pub first_tick: Option<u64>,
    /// The last of them.
    pub last_tick: Option<u64>,
    /// Ticks per second.
    pub rate_hz: Option<f64>,
    /// `realtime` or `lockstep`.
    pub mode: String,
    /// In lockstep all latencies are virtual: what was injected, not what was measured.
    pub latency_is_virtual: bool,
    /// Plant time from the first record's start to the last one's end, s.
    pub duration_s: f64,
    /// Ticks left out of the latency statistics: at rest, and `loop.start_up` after the first accepted torque.
    pub start_up_ticks: u64,
    /// Skipped, or without an accepted torque by the grace deadline; since the start of the plant.
    pub missed_ticks: u64,
    /// The same by cause; those that this monitor did not see are `unknown`.
    pub missed_ticks_by_cause: BTreeMap<String, u64>,
    /// Deadline → torque above this counts as late, ns.
    pub late_limit_ns: u64,
    /// Late ticks that were seen, start-up left out.
    pub late_ticks: u64,
    /// The same by cause.
    pub late_ticks_by_cause: BTreeMap<String, u64>,
    /// Share of the late ticks whose cause is unknown.
    pub late_unknown_share: Option<f64>,
    /// Wake-ups after the next deadline.
    pub overruns: u64,
    /// Ticks whose setpoint was absent and extrapolated.
    pub setpoint_stale: u64,
    /// Ticks that the plant closed while this monitor watched, and whose record it did not get.
    pub monitor_gaps: u64,
    /// What the host alone does to a periodic thread: how late the kernel woke the plant before its deadline, ns. None
    /// in lockstep.
    pub floor: Option<Quantiles>,
    /// Latency of every hop, ns.
    pub latency_ns: Latency,
    /// Distance between successive sampling instants, ns.
    pub jitter_ns: Jitter,
    /// The first tick in which the loop ran away; `null` if it did not.
    pub diverged: Option<DivergedSummary>,
    /// The bound, checked live.
    pub bound: BoundSummary,
    /// Tracking error once settled.
    pub tracking: Tracking,
    /// Changes of the controller in charge, in order.
    pub swaps: Vec<SwapSummary>,
    /// Changes beyond what the list holds.
    pub swaps_not_listed: u64,
    /// The plant's own counts, since its start.
    pub counters: BTreeMap<String, u64>,
    /// What processes outside this run said in it, by kind: refused, and never obeyed or reported.
    pub strangers: BTreeMap<String, u64>,
    /// Events by kind.
    pub events: BTreeMap<String, u64>,
    /// Injected faults of the plant by kind, and of torques by their own account.
    pub faults_injected: BTreeMap<String, u64>,
    /// Who took part.
    pub processes: Vec<ProcessSummary>,
    /// What the disc could not take in time.
    pub dropped: Dropped,
    /// Whether the files of the run are whole; `null` where none were asked for.
    pub recording: Option<RecordingSummary>,
    /// The machine.
    pub host: BTreeMap<String, serde_json::Value>,
    /// The scenario with all defaults filled in.
    pub scenario: serde_json::Value,
    /// What the supervisor saw: deaths, restarts, exit reasons.
    pub supervision: serde_json::Value,
    /// What the run is worth in one word, and why.
    pub verdict: Verdict,
}

impl Summary {
    /// The figures of one hop, ns.
    #[must_use]
    pub fn hop(&self, hop: Hop) -> Option<&Quantiles> {
        if hop == Hop::Floor { self.floor.as_ref() } else { self.latency_ns.of(hop) }
    }
}

/// Quantiles of one distribution. All but the counts are `null` without samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Quantiles {
    /// Samples.
    pub n: u64,
    /// Least.
    pub min: Option<f64>,
    /// Median.
    pub p50: Option<f64>,
    /// 90 %.
    pub p90: Option<f64>,
    /// 99 %.
    pub p99: Option<f64>,
    /// 99.9 %.
    pub p99_9: Option<f64>,
    /// Largest; exact also beyond the range of the histogram.
    pub max: Option<f64>,
    /// Mean.
    pub mean: Option<f64>,
    /// Samples beyond the range of the histogram, counted at its upper end.
    pub overflow: u64,
    /// Pairs of stamps in the wrong order: not a latency, left out.
    pub negative: u64,
}

/// How regularly the plant samples: s_{k+1} − s_k over pairs of neighbouring ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Jitter {
    /// Intervals.
    pub n: u64,
    /// Mean interval.
    pub mean: Option<f64>,
    /// Its standard deviation.
    pub std: Option<f64>,
    /// Shortest interval.
    pub min: Option<f64>,
    /// Longest interval.
    pub max: Option<f64>,
    /// Median of |interval − period|.
    pub deviation_p50: Option<f64>,
    /// 99 % of |interval − period|.
    pub deviation_p99: Option<f64>,
    /// 99.9 % of |interval − period|.
    pub deviation_p99_9: Option<f64>,
}

/// Where a loop ran away, and by what.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct DivergedSummary {
    /// The first tick.
    pub tick: u64,
    /// Its start in plant time, s.
    pub t_s: f64,
    /// `q`, `v` (not finite), `speed` of a joint, or `V`.
    pub quantity: String,
    /// The joint, from 1; `null` for V.
    pub joint: Option<u32>,
    /// Its value, rad/s or V; `null` if it was not finite.
    pub value: Option<f64>,
    /// The largest value allowed.
    pub limit: Option<f64>,
    /// The same as a sentence without a full stop.
    pub words: String,
}

/// Tracking error over the ticks after `loop.settle`; `null` for a run that ended before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Tracking {
    /// Ticks after `loop.settle`.
    pub n: u64,
    /// Largest |e_i|, over links and ticks, rad.
    pub max_abs_e_rad: Option<f64>,
    /// Largest ‖e‖, the norm over all links, over ticks, rad: what `bound.ultimate_bound` bounds.
    pub max_norm_e_rad: Option<f64>,
    /// Root mean square of e_i, over links and ticks, rad.
    pub rms_e_rad: Option<f64>,
    /// Largest |ė_i|, over links and ticks, rad/s.
    pub max_abs_ed_rad_s: Option<f64>,
    /// Largest ‖ė‖, over ticks, rad/s.
    pub max_norm_ed_rad_s: Option<f64>,
    /// Root mean square of ė_i, rad/s.
    pub rms_ed_rad_s: Option<f64>,
}

/// One change of the controller in charge, or one that was refused.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SwapSummary {
    /// The first tick of the new one.
    pub tick: u64,
    /// Controller before.
    pub from: u32,
    /// Controller after.
    pub to: u32,
    /// `swap` or `failover`.
    pub kind: String,
    /// Whether the scenario scheduled it (`[[swap]]`); else it was asked for by command, or is a failover.
    pub scheduled: bool,
    /// Ticks missed from that tick on, for 50 ms.
    pub missed_ticks: u64,
    /// Largest step of one joint at the change, from the torque that acted before to the first one of the new controller, N·m. Of
    /// a swap that was refused for its step, the step it would have been.
    pub torque_step_nm: Option<f64>,
    /// The same for each joint, with signs.
    pub torque_steps_nm: Vec<f64>,
    /// Largest difference of the two controllers' torques when the swap was let through, N·m: what a cross-fade fades.
    pub torque_difference_nm: Option<f64>,
    /// Ticks of the cross-fade.
    pub blended_ticks: u64,
    /// The number for which a swap was refused.
    pub value: Option<f64>,
    /// V at the end of the first tick of the new one, less V at its start.
    pub delta_v: Option<f64>,
    /// `done`, `refused` or `rolled back`.
    pub result: String,
    /// Why, where it was refused or rolled back.
    pub reason: Option<String>,
}

/// One process of the group.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ProcessSummary {
    /// Its role.
    pub role: String,
    /// Its id within the group.
    pub id: u32,
    /// Its process id.
    pub pid: u32,
    /// Law or executable.
    pub name: String,
    /// `ready`, `ended` or `failed`, as it announced last.
    pub phase: String,
    /// What it had of real-time privileges.
    pub privileges: serde_json::Value,
    /// What was refused, with its cost and what mends it.
    pub missing: Vec<MissingPrivilege>,
}

/// A privilege that was asked for and refused.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct MissingPrivilege {
    /// Which.
    pub step: String,
    /// What it costs.
    pub cost: String,
    /// What mends it.
    pub remedy: String,
}

/// Rows and events that found the writer's queue full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Dropped {
    /// Rows of `samples.csv`.
    pub samples: u64,
    /// Lines of `events.jsonl`.
    pub events: u64,
    /// Intervals of `latency.hlog`.
    pub intervals: u64,
}

impl std::fmt::Display for Dropped {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { samples, events, intervals } = self;
        write!(f, "{samples} rows, {events} events, {intervals} intervals were not recorded")
    }
}

/// What became of the recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct RecordingSummary {
    /// Whether everything that reached the monitor is in the files.
    pub whole: bool,
    /// What ended it before the run did: a full disk, say, and in which tick.
    pub error: Option<String>,
}

impl RecordingSummary {
    /// Why it is not whole, with what was lost; none if it is whole.
    #[must_use]
    pub fn shortfall(&self, dropped: &Dropped) -> Option<String> {
        let why = self.error.as_deref().unwrap_or("the disk was too slow");
        (!self.whole).then(|| format!("the recording is not whole: {why}; {dropped}"))
    }
}

/// What a run is worth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Verdict {
    /// The word of its [`Headline`].
    pub status: String,
    /// One sentence each.
    pub reasons: Vec<String>,
    /// Each expectation with what was found.
    pub expectations: Vec<Judgement>,
}

impl Verdict {
    /// A verdict of one headline.
    #[must_use]
    pub fn of(headline: Headline, reasons: Vec<String>) -> Self {
        Self { status: headline.word().to_owned(), reasons, expectations: Vec::new() }
    }

    /// Its headline. A word that this version does not know decides nothing.
    #[must_use]
    pub fn headline(&self) -> Headline {
        Headline::of_word(&self.status).unwrap_or(Headline::Inconclusive)
    }
}

/// One expectation, judged.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Judgement {
    /// The expectation as it was written, such as `round_trip.p99 <= 3 floor`.
    pub expectation: String,
    /// `pass`, `fail` or `inconclusive`.
    pub outcome: Finding,
    /// What was measured; `null` where there is no number.
    pub measured: Option<f64>,
    /// Confidence limits of a quantile; `null` where there are too few data for one, or where none is needed.
    pub lower: Option<f64>,
    /// The upper one.
    pub upper: Option<f64>,
    /// The budget in the unit of the key; of one relative to the floor its limits are in the sentence.
    pub budget: Option<f64>,
    /// One sentence with the numbers.
    pub reason: String,
}

/// What became of an expectation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Finding {
    /// It holds.
    Pass,
    /// It does not.
    Fail,
    /// The data do not say.
    #[default]
    Inconclusive,
}

/// The plant's counts by their names in the file.
#[must_use]
pub fn counters_by_name(counters: &Counters) -> BTreeMap<String, u64> {
    Counters::ALL.iter().map(|counter| (counter.name.to_owned(), (counter.of)(counters))).collect()
}

/// What was asked for and refused, in the order of the start-up.
#[must_use]
pub fn missing_privileges(privileges: &Privileges) -> Vec<MissingPrivilege> {
    privileges
        .refused()
        .map(|(step, _)| MissingPrivilege {
            step: step.name().to_owned(),
            cost: step.cost().to_owned(),
            remedy: step.remedy().to_owned(),
        })
        .collect()
}
