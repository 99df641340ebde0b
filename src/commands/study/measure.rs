//! One lockstep run and the figures of it that studies compare.
//!
//! Errors, torque and chattering count from `loop.settle` on, the bound from the start.

use loopbound_model::chain::{Chain, Vector};
use loopbound_monitor::judge::Judge;
use loopbound_monitor::summary::BoundSummary;
use loopbound_monitor::tracker::{Config, Tracker, segments};
use loopbound_scenario::{Mode, Scenario, ScenarioError};
use loopbound_shared::sample::{TickRecord, record_flag, to_vector};

use crate::inprocess::InProcess;

/// A run ends when a link is further off than this, rad: half a turn, from where no law finds back as it was meant to; and
/// when the plant has stopped a loop that ran away.
const LOST_RAD: f64 = std::f64::consts::PI;

/// What a run came to. Vectors have one entry a link.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// When the motion was lost, s; the other figures are then those up to there.
    pub lost_at_s: Option<f64>,
    /// Largest |e_i|, rad.
    pub e_max_rad: Vec<f64>,
    /// Root mean square of e_i, rad.
    pub e_rms_rad: Vec<f64>,
    /// Largest |ė_i|, rad/s.
    pub ed_max_rad_s: Vec<f64>,
    /// Root mean square of ė_i, rad/s.
    pub ed_rms_rad_s: Vec<f64>,
    /// Largest |e| (the norm), rad.
    pub e_norm_max_rad: f64,
    /// Root mean square of |τ|, N·m.
    pub effort_nm: f64,
    /// Largest |τ_i| of the whole run, N·m.
    pub torque_peak_nm: f64,
    /// Way that the torque goes, ∑|τ_k − τ_{k−1}|, over the way of the torque that follows the reference exactly: 1 is
    /// perfectly smooth. Not a number where the reference needs no change of torque.
    pub chattering: f64,
    /// Share of the ticks in which an actuator met its limit.
    pub saturated: f64,
    /// The live check of the bound.
    pub bound: BoundSummary,
    /// The motion, where it was asked for.
    pub trace: Vec<TracePoint>,
}

impl Measured {
    /// The largest |e_i| of all links, rad; infinite when the motion was lost.
    #[must_use]
    pub fn worst_e_rad(&self) -> f64 {
        if self.lost_at_s.is_some() { f64::INFINITY } else { self.e_max_rad.iter().copied().fold(0.0, f64::max) }
    }

    /// Root mean square over all links, rad.
    #[must_use]
    pub fn rms_e_rad(&self) -> f64 {
        let links = self.e_rms_rad.len().max(1) as f64;
        (self.e_rms_rad.iter().map(|e| e * e).sum::<f64>() / links).sqrt()
    }

    /// Root mean square over all links, rad/s.
    #[must_use]
    pub fn rms_ed_rad_s(&self) -> f64 {
        let links = self.ed_rms_rad_s.len().max(1) as f64;
        (self.ed_rms_rad_s.iter().map(|e| e * e).sum::<f64>() / links).sqrt()
    }

    /// The largest |ė_i| of all links, rad/s.
    #[must_use]
    pub fn worst_ed_rad_s(&self) -> f64 {
        self.ed_max_rad_s.iter().copied().fold(0.0, f64::max)
    }

    /// Measured sup |e| over the certified limsup \[9]; none without a certificate.
    #[must_use]
    pub fn bound_used(&self) -> Option<f64> {
        let radius = self.bound.ultimate_bound.filter(|radius| *radius > 0.0)?;
        self.lost_at_s.is_none().then_some(self.e_norm_max_rad / radius)
    }

    /// Checked ticks with a verdict, by its name in the summary.
    #[must_use]
    pub fn verdicts(&self, name: &str) -> u64 {
        self.bound.verdicts.get(name).copied().unwrap_or(0)
    }
}

/// One instant of the motion.
#[derive(Clone, Debug, PartialEq)]
pub struct TracePoint {
    /// s.
    pub t_s: f64,
    /// rad.
    pub q: Vec<f64>,
    /// rad.
    pub q_d: Vec<f64>,
    /// rad.
    pub e: Vec<f64>,
    /// rad/s.
    pub ed: Vec<f64>,
}

/// The tracker's view of a scenario in lockstep.
#[must_use]
pub fn tracker_config(scenario: &Scenario) -> Config {
    Config { lockstep: true, ..Config::of(scenario) }
}

/// Runs a scenario in lockstep, whatever its mode says. `trace_every`: ticks between points of the trace, 0: none.
///
/// # Errors
/// If the scenario describes no system.
pub fn measure<const N: usize>(scenario: &Scenario, trace_every: u64) -> Result<Measured, ScenarioError> {
    let mut scenario = scenario.clone();
    scenario.loop_.mode = Mode::Lockstep;
    let mut tracker = Tracker::<N>::new(tracker_config(&scenario), Some(Judge::new(&scenario)?));
    let mut group = InProcess::<N>::new(&scenario)?;
    let mut sums = Sums::<N>::new(&scenario)?;
    for _ in 0..scenario.loop_.ticks() {
        if let Some(record) = group.step() {
            tracker.feed(record);
            sums.add(record, trace_every);
            if sums.lost_at_s.is_some() {
                break;
            }
        }
    }
    tracker.finish();
    Ok(sums.measured(tracker.summarise().bound))
}

struct Sums<const N: usize> {
    chain: Chain<N>,
    settle_ns: u64,
    ticks: u64,
    e_max: Vector<N>,
    e_squares: Vector<N>,
    ed_max: Vector<N>,
    ed_squares: Vector<N>,
    e_norm_max: f64,
    torque_squares: f64,
    torque_peak: f64,
    way: f64,
    way_needed: f64,
    before: Option<(Vector<N>, Vector<N>)>,
    saturated: u64,
    lost_at_s: Option<f64>,
    trace: Vec<TracePoint>,
}

impl<const N: usize> Sums<N> {
    fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let zero = Vector::<N>::zeros();
        Ok(Self {
            chain: scenario.build_truth::<N>()?.chain,
            settle_ns: scenario.loop_.settle_ns(),
            ticks: 0,
            e_max: zero,
            e_squares: zero,
            ed_max: zero,
            ed_squares: zero,
            e_norm_max: 0.0,
            torque_squares: 0.0,
            torque_peak: 0.0,
            way: 0.0,
            way_needed: 0.0,
            before: None,
            saturated: 0,
            lost_at_s: None,
            trace: Vec::new(),
        })
    }

    fn add(&mut self, record: &TickRecord, trace_every: u64) {
        let t_s = record.start_plant_ns as f64 * 1e-9;
        let (q, q_d) = (to_vector::<N>(&record.q), to_vector::<N>(&record.q_d));
        let (v_d, a_d) = (to_vector::<N>(&record.v_d), to_vector::<N>(&record.a_d));
        let (e, ed) = (q_d - q, v_d - to_vector::<N>(&record.v));
        let tau = segments(record).last().map_or_else(Vector::<N>::zeros, |segment| to_vector(&segment.tau));
        // Written so that what is not a number counts as lost.
        let diverged = record.flags & record_flag::DIVERGED != 0;
        if diverged || !e.iter().all(|e| e.abs() < LOST_RAD) {
            self.lost_at_s = Some(t_s);
            return;
        }
        if trace_every > 0 && record.tick.is_multiple_of(trace_every) {
            let list = |x: &Vector<N>| x.iter().copied().collect::<Vec<f64>>();
            self.trace.push(TracePoint { t_s, q: list(&q), q_d: list(&q_d), e: list(&e), ed: list(&ed) });
        }
        self.torque_peak = self.torque_peak.max(tau.amax());
        if record.start_plant_ns < self.settle_ns {
            return;
        }
        self.ticks += 1;
        self.e_max = self.e_max.sup(&e.abs());
        self.e_squares += e.component_mul(&e);
        self.ed_max = self.ed_max.sup(&ed.abs());
        self.ed_squares += ed.component_mul(&ed);
        self.e_norm_max = self.e_norm_max.max(e.norm());
        self.torque_squares += tau.norm_squared();
        self.saturated += u64::from(record.flags & record_flag::SATURATED != 0);
        let needed = self.chain.torque_for(&q_d, &v_d, &v_d, &a_d) - to_vector::<N>(&record.disturbance);
        if let Some((tau_before, needed_before)) = self.before.replace((tau, needed)) {
            self.way += (tau - tau_before).norm();
            self.way_needed += (needed - needed_before).norm();
        }
    }

    fn measured(self, bound: BoundSummary) -> Measured {
        let ticks = self.ticks.max(1) as f64;
        let list = |x: Vector<N>| x.iter().copied().collect::<Vec<f64>>();
        let rms = |squares: Vector<N>| squares.iter().map(|x| (x / ticks).sqrt()).collect();
        Measured {
            lost_at_s: self.lost_at_s,
            e_max_rad: list(self.e_max),
            e_rms_rad: rms(self.e_squares),
            ed_max_rad_s: list(self.ed_max),
            ed_rms_rad_s: rms(self.ed_squares),
            e_norm_max_rad: self.e_norm_max,
            effort_nm: (self.torque_squares / ticks).sqrt(),
            torque_peak_nm: self.torque_peak,
            chattering: if self.way_needed > 0.0 { self.way / self.way_needed } else { f64::NAN },
            saturated: self.saturated as f64 / ticks,
            bound,
            trace: self.trace,
        }
    }
}
