//! The figures of a run, from its records one by one: no clock, no input or output.
//!
//! Responsible for what a record means to each figure. What a late tick means is `late`'s, what V means is `judge`'s.
//! Numbers from a record are never trusted: counts are clamped to their arrays and differences saturate.

use loopbound_model::bound::diagnose::Verdict;
use loopbound_scenario::controllers::{self, Scheduled};
use loopbound_scenario::{Mode, Scenario};
use loopbound_shared::event::{Acceptance, Decision};
use loopbound_shared::sample::{
    Announce, Counters, Happening, Links, Receipt, Segment, TickRecord, record_flag, to_vector,
};

use crate::divergence::Divergence;
use crate::event::{Event, EventKind, EventLog};
use crate::hops::{Hop, Hops};
use crate::jitter::JitterStatistics;
use crate::judge::{Judge, Judged};
use crate::late::{Causes, Planned};
use crate::summary::{Summary, Tracking, counters_by_name, finite};
use crate::swaps::Swaps;
use crate::verdict::blocks::Blocks;

/// What a tracker must know of the scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// h, ns.
    pub period_ns: u64,
    /// Deadline → torque above this is late, ns.
    pub late_ns: u64,
    /// Tracking counts from this plant time on, ns.
    pub settle_ns: u64,
    /// Latencies count from this long after the first accepted torque, ns.
    pub start_up_ns: u64,
    /// A late tick is decided at most this long after it, ns.
    pub finalise_ns: u64,
    /// Virtual time: there is no start-up, and no host.
    pub lockstep: bool,
    /// A joint that is faster has run away, rad/s.
    pub speed_limit_rad_s: f64,
    /// The swaps that the scenario schedules.
    pub scheduled_swaps: Vec<Scheduled>,
    /// How long after a swap the plant may roll it back, in ticks.
    pub rollback_ticks: u64,
    /// The faults that the scenario injects.
    pub planned: Planned,
}

impl Config {
    /// What a scenario says of it.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        Self {
            period_ns: scenario.period_ns(),
            late_ns: scenario.loop_.late_ns(),
            settle_ns: scenario.loop_.settle_ns(),
            start_up_ns: scenario.loop_.start_up.ns(),
            finalise_ns: scenario.monitor.finalise.ns(),
            lockstep: scenario.loop_.mode == Mode::Lockstep,
            speed_limit_rad_s: scenario.plant.speed_limit,
            scheduled_swaps: controllers::scheduled_swaps(scenario),
            planned: Planned::of(scenario),
            rollback_ticks: scenario.swap_gate.rollback_for.ns().div_ceil(scenario.period_ns()),
        }
    }
}

/// What one record came to, for `samples.csv` and live views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// The tick.
    pub tick: u64,
    /// s_k since t = 0, s.
    pub t_s: f64,
    /// True angles, rad.
    pub q: Links,
    /// True velocities, rad/s.
    pub v: Links,
    /// Setpoint at s_k, rad.
    pub q_d: Links,
    /// Its velocity, rad/s.
    pub v_d: Links,
    /// Its acceleration, rad/s².
    pub a_d: Links,
    /// The last torque applied within the tick, N·m.
    pub tau: Links,
    /// V at s_k.
    pub lyapunov: Option<f64>,
    /// The right side of promise (a) from the tick before.
    pub lyapunov_bound: Option<f64>,
    /// c, the certified level of V.
    pub lyapunov_level: Option<f64>,
    /// Round trip, ns; none on a missed tick.
    pub round_trip_ns: Option<u64>,
    /// The controller in charge.
    pub active: u32,
}

/// The entries of `segments` that count.
#[must_use]
pub fn segments(record: &TickRecord) -> &[Segment] {
    let used = usize::try_from(record.segments_used).unwrap_or(usize::MAX);
    &record.segments[..used.min(record.segments.len())]
}

/// The entries of `receipts` that count.
#[must_use]
pub fn receipts(record: &TickRecord) -> &[Receipt] {
    let used = usize::try_from(record.receipts_used).unwrap_or(usize::MAX);
    &record.receipts[..used.min(record.receipts.len())]
}

/// The entries of `happenings` that count.
#[must_use]
pub fn happenings(record: &TickRecord) -> &[Happening] {
    let used = usize::try_from(record.happenings_used).unwrap_or(usize::MAX);
    &record.happenings[..used.min(record.happenings.len())]
}

/// The receipt of the torque that was accepted for this tick: in time before late, the one in charge before others,
/// a standby's where it took over.
#[must_use]
pub fn accepted(record: &TickRecord) -> Option<&Receipt> {
    let with = |acceptance: Acceptance| {
        let mut found = receipts(record).iter().filter(|receipt| receipt.acceptance == acceptance.code());
        let first = found.clone().next();
        found.find(|receipt| receipt.writer == record.active).or(first)
    };
    let standby = record.decision == Decision::Standby.code();
    let taken_over = || if standby { with(Acceptance::Standby) } else { None };
    with(Acceptance::Applied).or_else(|| with(Acceptance::Late)).or_else(taken_over)
}

/// Running figures of a group with N links.
#[derive(Debug)]
pub struct Tracker<const N: usize> {
    config: Config,
    judge: Option<Judge<N>>,
    hops: Hops,
    interval: Hops,
    blocks: Blocks,
    jitter: JitterStatistics,
    causes: Causes,
    divergence: Divergence,
    swaps: Swaps,
    events: EventLog,
    errors: Errors,
    counters: Counters,
    seen: Seen,
    first_accepted_plant_ns: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    records: u64,
    first_tick: Option<u64>,
    last_tick: Option<u64>,
    gaps: u64,
    out_of_order: u64,
    start_up: u64,
    first_start_plant_ns: u64,
    last_end_plant_ns: u64,
}

/// Sums over tracking errors.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    ticks: u64,
    e_max_rad: f64,
    e_norm_max_rad: f64,
    e_sum_rad2: f64,
    ed_max_rad_s: f64,
    ed_norm_max_rad_s: f64,
    ed_sum_rad2_s2: f64,
}

impl<const N: usize> Tracker<N> {
    /// A tracker that has seen nothing; without a judge it leaves the bound out. All of its memory is allocated here.
    #[must_use]
    pub fn new(config: Config, judge: Option<Judge<N>>) -> Self {
        Self {
            judge,
            hops: Hops::default(),
            interval: Hops::default(),
            blocks: Blocks::new(config.period_ns),
            jitter: JitterStatistics::default(),
            causes: Causes::new(config.planned.clone()),
            divergence: Divergence::new(config.speed_limit_rad_s),
            swaps: Swaps::new(config.scheduled_swaps.clone(), config.rollback_ticks),
            events: EventLog::default(),
            errors: Errors::default(),
            counters: Counters::zeroed(),
            seen: Seen::default(),
            first_accepted_plant_ns: None,
            config,
        }
    }

    /// Takes the record of the next tick. None for one that is not newer than the last: it was counted already.
    pub fn feed(&mut self, record: &TickRecord) -> Option<Row> {
        // The plant's warm-up records have no links; another number than the scenario's is no record of this group.
        if record.links as usize != N || !self.is_next(record) {
            return None;
        }
        let settled = self.is_past_start_up(record);
        let receipt = accepted(record);
        if settled {
            self.hops.record(record, receipt, self.config.period_ns);
            self.interval.record(record, receipt, self.config.period_ns);
            self.blocks.record(record, receipt, self.config.period_ns);
            self.jitter.record(record, self.config.period_ns);
        } else {
            self.seen.start_up += 1;
            self.jitter.skip();
        }
        self.note_happenings(record);
        let missed = self.causes.feed(&self.config, record, settled, &mut self.events);
        let judged = self.judge.as_mut().map_or_else(Judged::default, |judge| judge.feed(record, &mut self.events));
        if judged.verdict == Some(Verdict::Fallback) {
            self.causes.note_fallback();
        }
        self.divergence.feed::<N>(record, judged.runaway);
        self.swaps.feed(record, self.config.period_ns, missed, judged.v);
        self.errors.record::<N>(&self.config, record);
        self.counters = record.counters;
        Some(row(record, receipt, judged))
    }

    /// Takes what a process says of itself: the law of a controller.
    pub fn learn(&mut self, announce: &Announce) {
        if let Some(judge) = &mut self.judge {
            judge.learn(announce);
        }
    }

    /// Whether controller `id` has said what it is, as far as anybody here asks.
    #[must_use]
    pub fn knows(&self, id: u32) -> bool {
        id == 0 || self.judge.as_ref().is_none_or(|judge| judge.knows(id))
    }

    /// Changes of the controller in charge so far.
    #[must_use]
    pub fn swaps(&self) -> &Swaps {
        &self.swaps
    }

    /// Whether the record is newer than the last one; counts what lies between.
    fn is_next(&mut self, record: &TickRecord) -> bool {
        let seen = &mut self.seen;
        match seen.last_tick {
            Some(last) if record.tick <= last => {
                seen.out_of_order += 1;
                return false;
            }
            Some(last) => {
                // Also those that were skipped between records that did not come: their counts are cumulative.
                let skipped = record.counters.skipped.saturating_sub(self.counters.skipped).max(record.skipped_before);
                let ticks = (record.tick - last - 1).saturating_sub(skipped);
                if ticks > 0 {
                    seen.gaps = seen.gaps.saturating_add(ticks);
                    self.jitter.skip();
                    self.events.push(record.tick, record.start_plant_ns, EventKind::Gap { ticks });
                }
            }
            None => {
                seen.first_tick = Some(record.tick);
                seen.first_start_plant_ns = record.start_plant_ns;
                self.events.push(record.tick, record.start_plant_ns, EventKind::FirstSeen);
            }
        }
        seen.records += 1;
        seen.last_tick = Some(record.tick);
        seen.last_end_plant_ns = record.end_plant_ns;
        true
    }

    /// Lockstep has no start-up. A monitor that joins late takes the first torque to have come at t = 0.
    fn is_past_start_up(&mut self, record: &TickRecord) -> bool {
        if self.config.lockstep {
            return true;
        }
        if record.flags & record_flag::AT_REST != 0 {
            return false;
        }
        let joined_late = self.seen.records == 1 && record.tick > 0;
        let first_ns = if joined_late { 0 } else { record.start_plant_ns };
        let first_ns = *self.first_accepted_plant_ns.get_or_insert(first_ns);
        record.start_plant_ns.saturating_sub(first_ns) >= self.config.start_up_ns
    }

    fn note_happenings(&mut self, record: &TickRecord) {
        for happening in happenings(record) {
            self.events.push(record.tick, record.start_plant_ns, EventKind::Happening(*happening));
        }
        for receipt in receipts(record) {
            let kind = Acceptance::from_code(receipt.acceptance);
            let good = [Acceptance::None, Acceptance::Applied, Acceptance::Standby, Acceptance::Late];
            if !kind.is_some_and(|kind| good.contains(&kind) || kind == Acceptance::LateUnused) {
                let kind = EventKind::Rejected { writer: receipt.writer, acceptance: receipt.acceptance };
                self.events.push(record.tick, record.start_plant_ns, kind);
            }
        }
    }

    /// Decides what still waits for evidence; before the last [`summarise`](Self::summarise).
    pub fn finish(&mut self) {
        self.causes.finish(&self.config, self.seen.last_tick.unwrap_or(0), &mut self.events);
    }

    /// Hands out the events since the last call, in order.
    pub fn drain_events(&mut self) -> impl Iterator<Item = Event> + '_ {
        self.events.drain()
    }

    /// The latencies since the last [`start_interval`](Self::start_interval).
    #[must_use]
    pub fn interval(&self) -> &Hops {
        &self.interval
    }

    /// Forgets the interval's latencies, not the run's.
    pub fn start_interval(&mut self) {
        self.interval.clear();
    }

    /// The latencies of the run.
    #[must_use]
    pub fn hops(&self) -> &Hops {
        &self.hops
    }

    /// Closes the last block, after the last record.
    pub fn close_block(&mut self) {
        self.blocks.close();
    }

    /// The latencies block by block, for verdicts.
    #[must_use]
    pub fn blocks(&self) -> &Blocks {
        &self.blocks
    }

    /// Records taken so far.
    #[must_use]
    pub fn records(&self) -> u64 {
        self.seen.records
    }

    /// The last tick taken.
    #[must_use]
    pub fn last_tick(&self) -> Option<u64> {
        self.seen.last_tick
    }

    /// All figures so far. What only the process around knows (host, processes, names) is left at its default.
    #[must_use]
    pub fn summarise(&self) -> Summary {
        let (config, seen, counters) = (&self.config, &self.seen, &self.counters);
        let latency_ns = self.hops.latency();
        let late_ticks = self.causes.late.total();
        let unknown = self.causes.late.of(crate::cause::Cause::Unknown);
        let mut summary = Summary {
            schema: crate::summary::SCHEMA,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            links: u32::try_from(N).unwrap_or(0),
            ticks: counters.ticks,
            ticks_seen: seen.records,
            first_tick: seen.first_tick,
            last_tick: seen.last_tick,
            rate_hz: finite(1e9 / config.period_ns as f64),
            mode: if config.lockstep { "lockstep" } else { "realtime" }.to_owned(),
            latency_is_virtual: config.lockstep,
            duration_s: seen.last_end_plant_ns.saturating_sub(seen.first_start_plant_ns) as f64 * 1e-9,
            start_up_ticks: seen.start_up,
            missed_ticks: counters.missed,
            missed_ticks_by_cause: self.causes.missed_of(counters.missed).by_name(),
            late_limit_ns: config.late_ns,
            late_ticks,
            late_ticks_by_cause: self.causes.late.by_name(),
            late_unknown_share: (late_ticks > 0).then(|| unknown as f64 / late_ticks as f64),
            overruns: counters.overruns,
            setpoint_stale: counters.setpoint_stale,
            monitor_gaps: seen.gaps,
            floor: (!config.lockstep && self.hops.of(Hop::Floor).quantiles().n > 0)
                .then(|| self.hops.of(Hop::Floor).quantiles()),
            latency_ns,
            jitter_ns: self.jitter.summary(),
            tracking: self.errors.summary::<N>(),
            diverged: self.divergence.summary(),
            swaps: self.swaps.list().to_vec(),
            swaps_not_listed: self.swaps.not_listed(),
            counters: counters_by_name(counters),
            events: self.events.counts(),
            ..Summary::default()
        };
        if let Some(judge) = &self.judge {
            summary.bound = judge.summary(config.period_ns, &summary.latency_ns.deadline_to_torque);
            summary.bound.fallback_by_cause = self.causes.fallback_of(summary.bound.verdicts("fallback")).by_name();
        }
        summary.faults_injected.insert("torques_and_plant".to_owned(), counters.faults_injected);
        summary.dropped.events = self.events.dropped();
        summary
    }
}

impl Errors {
    fn record<const N: usize>(&mut self, config: &Config, record: &TickRecord) {
        let counts_not = record_flag::AT_REST | record_flag::DIVERGED;
        if record.start_plant_ns < config.settle_ns || record.flags & counts_not != 0 {
            return;
        }
        let e = to_vector::<N>(&record.q_d) - to_vector::<N>(&record.q);
        let ed = to_vector::<N>(&record.v_d) - to_vector::<N>(&record.v);
        self.ticks += 1;
        self.e_max_rad = largest(self.e_max_rad, e.iter());
        self.e_norm_max_rad = largest(self.e_norm_max_rad, [e.norm()].iter());
        self.e_sum_rad2 += e.norm_squared();
        self.ed_max_rad_s = largest(self.ed_max_rad_s, ed.iter());
        self.ed_norm_max_rad_s = largest(self.ed_norm_max_rad_s, [ed.norm()].iter());
        self.ed_sum_rad2_s2 += ed.norm_squared();
    }

    fn summary<const N: usize>(&self) -> Tracking {
        let some = |value: f64| if self.ticks > 0 { finite(value) } else { None };
        let count = (self.ticks * N as u64) as f64;
        Tracking {
            n: self.ticks,
            max_abs_e_rad: some(self.e_max_rad),
            max_norm_e_rad: some(self.e_norm_max_rad),
            rms_e_rad: some((self.e_sum_rad2 / count).sqrt()),
            max_abs_ed_rad_s: some(self.ed_max_rad_s),
            max_norm_ed_rad_s: some(self.ed_norm_max_rad_s),
            rms_ed_rad_s: some((self.ed_sum_rad2_s2 / count).sqrt()),
        }
    }
}

/// The largest magnitude; NaN, once in, stays, where `f64::max` would drop it.
fn largest<'a>(so_far: f64, values: impl Iterator<Item = &'a f64>) -> f64 {
    values.fold(so_far, |most, value| if value.abs() > most || value.is_nan() { value.abs() } else { most })
}

fn row(record: &TickRecord, receipt: Option<&Receipt>, judged: Judged) -> Row {
    Row {
        tick: record.tick,
        t_s: record.start_plant_ns as f64 * 1e-9,
        q: record.q,
        v: record.v,
        q_d: record.q_d,
        v_d: record.v_d,
        a_d: record.a_d,
        tau: segments(record).last().map_or([0.0; 7], |segment| segment.tau),
        lyapunov: judged.v,
        lyapunov_bound: judged.v_bound,
        lyapunov_level: judged.level,
        round_trip_ns: receipt.and_then(|receipt| receipt.arrived_ns.checked_sub(record.published_ns)),
        active: record.active,
    }
}

#[cfg(test)]
mod tests;
