//! The plant without a clock: integrates the chain under the torques that act, and writes the record of each tick.
//!
//! Both loops, realtime and lockstep, and the single-process run drive this same code, so that what one proves of it
//! holds for the others. A tick goes: [`PlantCore::open`] (which closes the tick before), [`PlantCore::arrive`] for
//! each torque, [`PlantCore::grace_passed`] once, [`PlantCore::note_slack`] in the slack.

use std::collections::VecDeque;

use loopbound_model::integrator::{PlantState, integrate};
use loopbound_model::trajectory::SetpointValue;
use loopbound_model::truth::Truth;
use loopbound_scenario::system;
use loopbound_scenario::{ACTUATION_TICKS_MAX, Scenario, ScenarioError};
use loopbound_shared::clock;
use loopbound_shared::event::{CommandKind, Decision, HappeningKind, LiveFault, Refusal, Role};
use loopbound_shared::realtime::Evidence;
use loopbound_shared::runaway;
use loopbound_shared::sample::{
    Announce, Command, Origin, Reply, SEGMENTS_MAX, Segment, State, TickRecord, Torque, record_flag, to_links,
    to_vector,
};
use loopbound_shared::setpoints::SetpointBook;

use crate::authority::{Applied, Authority, SwapRules};
use crate::fallback::Fallback;
use crate::laws::Laws;
use crate::replies;

/// Torques under way at once in the transport line of the actuation delay.
const LINE_MAX: usize = 2 * ACTUATION_TICKS_MAX as usize;

/// When a tick opens. All in the loop's clock: CLOCK_MONOTONIC, or virtual in lockstep.
#[derive(Clone, Copy, Debug)]
pub struct Opening {
    /// The tick k.
    pub tick: u64,
    /// t_k.
    pub deadline_ns: u64,
    /// s_k.
    pub sampled_ns: u64,
    /// Torques are on time until then.
    pub grace_deadline_ns: u64,
    /// Ticks that were skipped before this one.
    pub skipped: u64,
    /// How late the kernel woke the plant before t_k; the largest number if it did not sleep.
    pub wake_late_ns: u64,
}

/// The plant without a clock. Allocates at construction only.
pub struct PlantCore<const N: usize> {
    truth: Truth<N>,
    laws: Laws<N>,
    /// Which controller's torque acts.
    pub authority: Authority,
    /// The setpoints that have come.
    pub setpoints: SetpointBook,
    fallback: Fallback<N>,
    state: PlantState<N>,
    /// t = 0 in the loop's clock.
    t_0_ns: u64,
    /// How far the state is integrated.
    plant_ns: u64,
    actuation_delay_ns: u64,
    step_max_ns: u64,
    speed_limit_rad_s: f64,
    rests: bool,
    /// The loop diverged in an earlier tick: the plant stands still for good.
    diverged: bool,
    acting: Segment,
    line: VecDeque<Segment>,
    record: Box<TickRecord>,
    closed: Box<TickRecord>,
    has_closed: bool,
    /// V at the start of the open tick, and in whose law, while a switch is being watched.
    watched_v: Option<(u32, f64)>,
}

impl<const N: usize> PlantCore<N> {
    /// The plant of a scenario at its start. `rests`: it is held there until the first torque acts (realtime).
    ///
    /// # Errors
    /// If the scenario's chain or motion is none.
    pub fn new(scenario: &Scenario, rests: bool) -> Result<Self, ScenarioError> {
        let truth = scenario.build_truth::<N>()?;
        let laws = Laws::new(scenario)?;
        let state = scenario.build_start::<N>()?;
        Ok(Self {
            truth,
            laws,
            authority: Authority::new(N, SwapRules::of(scenario)),
            setpoints: SetpointBook::new(scenario.period_ns()),
            fallback: Fallback::new(scenario)?,
            state,
            t_0_ns: 0,
            plant_ns: 0,
            actuation_delay_ns: scenario.plant.actuation_delay.ns(),
            step_max_ns: scenario.loop_.max_step.ns(),
            speed_limit_rad_s: scenario.plant.speed_limit,
            rests,
            diverged: false,
            acting: Segment::zeroed(),
            line: VecDeque::with_capacity(LINE_MAX),
            record: Box::new(TickRecord::zeroed()),
            closed: Box::new(TickRecord::zeroed()),
            has_closed: false,
            watched_v: None,
        })
    }

    /// Sets the instant of t = 0; before the first tick.
    pub fn start_at(&mut self, t_0_ns: u64) {
        self.t_0_ns = t_0_ns;
    }

    /// Learns which law a controller claims to be.
    pub fn learn(&mut self, announce: &Announce) {
        let authority = &self.authority;
        self.laws.learn(announce, |id| authority.member_ids().any(|member| member == id));
    }

    /// Closes the tick before, changes authority where that is due, and opens a tick: what is to be published.
    /// `published_ns` is left for the loop to stamp, by [`PlantCore::stamp_published`].
    pub fn open(&mut self, at: Opening) -> State {
        let plant_ns = at.sampled_ns - self.t_0_ns;
        self.close(at.sampled_ns, plant_ns, at.skipped);
        let setpoint = self.setpoint_value(at.tick, at.sampled_ns - at.deadline_ns);
        let bound_held = self.bound_held(&setpoint);
        let levels = self.laws.at(&self.state, &setpoint);
        self.authority.switch_if_due(at.tick, bound_held, &levels);
        self.authority.open(at.tick, at.grace_deadline_ns);
        self.begin_record(&at, plant_ns);
        self.fall_back_if_due(at.tick);
        let record = &self.record;
        State {
            origin: record.origin,
            tick: at.tick,
            deadline_ns: at.deadline_ns,
            sampled_ns: at.sampled_ns,
            published_ns: 0,
            grace_deadline_ns: at.grace_deadline_ns,
            plant_ns,
            setpoint_offset_ns: record.setpoint_offset_ns,
            active: record.active,
            epoch: record.epoch,
            flags: 0,
            links: record.links,
            q: record.q_measured,
            v: record.v_measured,
        }
    }

    /// Stamps the publication of the open tick's state, from which the grace deadline counts.
    pub fn stamp_published(&mut self, published_ns: u64, grace_deadline_ns: u64, squeezed: bool) {
        self.record.published_ns = published_ns;
        self.record.grace_deadline_ns = grace_deadline_ns;
        self.authority.grace_until(grace_deadline_ns, squeezed);
    }

    /// Whether any tick was opened yet.
    #[must_use]
    pub fn has_opened(&self) -> bool {
        self.record.links != 0
    }

    /// Runs the code of a tick without effect, so that the first one finds it warm.
    pub fn rehearse(&mut self) {
        for _ in 0..256 {
            let tau = to_vector(&self.acting.tau);
            std::hint::black_box(integrate(&self.truth, &self.state, &tau, 0, 1_000_000, self.step_max_ns));
            std::hint::black_box(self.truth.measure(&self.state.q, &self.state.v, 0));
            std::hint::black_box(self.setpoints.at::<N>(0, 1));
        }
    }

    /// Judges a torque that arrived at `arrived_ns`; if it is to act, it does so from there (plus the actuation delay).
    pub fn arrive(&mut self, torque: &Torque, arrived_ns: u64) {
        if let Some(applied) = self.authority.offer(torque, arrived_ns) {
            self.apply(&applied);
        }
    }

    /// The grace deadline has passed: once a tick, also when all is settled.
    pub fn grace_passed(&mut self, now_ns: u64) {
        if let Some(applied) = self.authority.grace_passed(now_ns) {
            self.apply(&applied);
        }
    }

    /// Notes the loop's evidence of the open tick.
    pub fn note_slack(&mut self, evidence: Evidence, spin_gap_ns: u64) {
        self.record.evidence = evidence;
        self.record.spin_gap_ns = self.record.spin_gap_ns.max(spin_gap_ns);
    }

    /// Notes in the open tick's record that it took so long to map what joined.
    pub fn note_join(&mut self, took_ns: u64) {
        self.record.flags |= record_flag::JOINED;
        self.authority.journal.note(HappeningKind::Joined, 0, took_ns, 0.0);
    }

    /// Marks the open tick as one with an injected fault. `begins`: in the first one, the fault, its target, and for how
    /// many ticks.
    pub fn note_fault(&mut self, begins: Option<(LiveFault, u32, u64)>) {
        self.record.flags |= record_flag::FAULT_INJECTED;
        if let Some((kind, target, ticks)) = begins {
            self.authority.journal.note(HappeningKind::FaultInjected, target, u64::from(kind.code()), ticks as f64);
        }
    }

    /// The record of the tick that was closed last; none before the first.
    #[must_use]
    pub fn closed(&self) -> Option<&TickRecord> {
        self.has_closed.then_some(&*self.closed)
    }

    /// Counts an overrun of so many ticks, none if 0. Those before a tick that is opened are counted by
    /// [`PlantCore::open`]; the loop counts those that the end of the run cuts off.
    pub fn count_skipped(&mut self, ticks: u64) {
        let counters = &mut self.authority.journal.counters;
        counters.skipped += ticks;
        counters.missed += ticks;
        counters.overruns += u64::from(ticks > 0);
    }

    /// Ends the last tick at `end_ns`; its record is marked as the last.
    pub fn finish(&mut self, end_ns: u64) -> &TickRecord {
        self.record.flags |= record_flag::LAST;
        self.close(end_ns, end_ns - self.t_0_ns, 0);
        &self.closed
    }

    /// Where the plant is now.
    #[must_use]
    pub fn state(&self) -> &PlantState<N> {
        &self.state
    }

    /// Carries out what concerns authority; the loop handles start, stop and faults.
    pub fn command(&mut self, command: &Command) -> Reply {
        let outcome = match CommandKind::from_code(command.kind) {
            Some(CommandKind::AddMember) => self.authority.add(command.controller),
            // One that is to retire stays if a failover has made it active again.
            Some(CommandKind::RemoveMember)
                if command.option != 0 && self.authority.active().0 == command.controller =>
            {
                Err(Refusal::AlreadyActive)
            }
            Some(CommandKind::RemoveMember) => {
                self.laws.forget(command.controller);
                self.authority.remove(command.controller)
            }
            Some(CommandKind::Swap) => return self.authority.request_swap(command),
            Some(CommandKind::SwapStatus) => return self.authority.swap_status(command.controller),
            Some(CommandKind::CancelSwap) => return self.authority.cancel_swap(command.controller),
            Some(CommandKind::Start | CommandKind::StopAt | CommandKind::Fault) | None => Err(Refusal::BadCommand),
        };
        outcome.map_or_else(replies::refused, |()| replies::done(self.authority.tick()))
    }

    fn apply(&mut self, applied: &Applied) {
        let record = &mut self.record;
        record.accepted_ns = applied.from_ns;
        [record.used_q_d, record.used_v_d, record.used_a_d] = applied.setpoint;
        if self.diverged {
            // The answer came, and that is noted; no torque acts on the plant any more.
            return;
        }
        let (tau, saturated) = self.truth.saturate(&to_vector::<N>(&applied.tau));
        if saturated {
            record.flags |= record_flag::SATURATED;
            self.authority.journal.counters.saturated += 1;
        }
        if let Some(ticks) = self.fallback.answered() {
            self.authority.journal.note(HappeningKind::Fallback, Decision::Active.code(), ticks, 0.0);
        }
        self.enqueue(Segment {
            from_plant_ns: applied.from_ns - self.t_0_ns + self.actuation_delay_ns,
            answered_tick: self.authority.tick(),
            writer: applied.writer,
            epoch: applied.epoch,
            tau: to_links(&tau),
        });
    }

    fn enqueue(&mut self, segment: Segment) {
        if self.line.len() < LINE_MAX {
            self.line.push_back(segment);
        } else {
            self.authority.journal.counters.segments_dropped += 1;
        }
    }

    /// Integrates to `to_ns` of plant time, each torque from its instant on, and notes the segments in the record.
    fn advance(&mut self, to_ns: u64) {
        while self.line.front().is_some_and(|next| next.from_plant_ns <= self.plant_ns) {
            self.act_next();
        }
        self.note_segment();
        while let Some(next_ns) = self.line.front().map(|next| next.from_plant_ns).filter(|ns| *ns < to_ns) {
            self.integrate_to(next_ns);
            self.act_next();
            self.note_segment();
        }
        self.integrate_to(to_ns);
    }

    fn act_next(&mut self) {
        if let Some(next) = self.line.pop_front() {
            self.acting = next;
            self.rests = false;
        }
    }

    fn integrate_to(&mut self, to_ns: u64) {
        if !self.rests && !self.diverged && to_ns > self.plant_ns {
            let tau = to_vector(&self.acting.tau);
            self.state = integrate(&self.truth, &self.state, &tau, self.plant_ns, to_ns, self.step_max_ns);
        }
        self.plant_ns = self.plant_ns.max(to_ns);
    }

    fn note_segment(&mut self) {
        let used = self.record.segments_used as usize;
        if used < SEGMENTS_MAX {
            self.record.segments[used] = self.acting;
            self.record.segments_used += 1;
        } else {
            self.authority.journal.counters.segments_dropped += 1;
        }
    }

    fn close(&mut self, end_ns: u64, end_plant_ns: u64, skipped: u64) {
        if self.record.links == 0 {
            // Nothing is open before the first tick, but ticks may have been skipped already.
            self.count_skipped(skipped);
            self.plant_ns = end_plant_ns;
            return;
        }
        let start = self.state;
        self.advance(end_plant_ns);
        let decided = if self.diverged { None } else { self.authority.decision() };
        let decision = decided.unwrap_or(if self.rests { Decision::Rest } else { self.fallback.decision() });
        if self.authority.decision().is_none() && !self.rests && !self.diverged {
            let v = self.laws.robust_v(&self.record);
            self.fallback.unanswered(&self.record, v, &self.acting.tau);
        }
        self.stop_if_diverged(&start);
        self.authority.journal.count_decision(decision);
        self.count_skipped(skipped);
        let record = &mut self.record;
        record.end_ns = end_ns;
        record.end_plant_ns = end_plant_ns;
        record.decision = decision.code();
        (record.active, record.epoch) = self.authority.active();
        self.authority.journal.enter(record);
        std::mem::swap(&mut self.record, &mut self.closed);
        self.has_closed = true;
    }

    /// The safe stop of a loop that diverged in the tick that closes: the tick is undone, so that no value of it that is not
    /// finite is ever published, and the plant stands where it began, for good.
    fn stop_if_diverged(&mut self, start: &PlantState<N>) {
        let found = runaway::of_state(&self.state.q, &self.state.v, self.speed_limit_rad_s);
        let Some(found) = found.filter(|_| !self.diverged) else { return };
        self.diverged = true;
        self.record.flags |= record_flag::DIVERGED;
        self.state = PlantState { q: start.q, v: to_vector(&[0.0; 7]) };
        self.line.clear();
        self.fallback.stop();
        let value = if found.value.is_finite() { found.value } else { 0.0 };
        self.authority.journal.note(HappeningKind::Diverged, found.joint, u64::from(found.kind.code()), value);
    }

    fn begin_record(&mut self, at: &Opening, plant_ns: u64) {
        let offset_ns = at.sampled_ns - at.deadline_ns;
        let (active, epoch) = self.authority.active();
        let found = self.setpoints.at::<N>(at.tick, offset_ns);
        let mut flags = if self.rests { record_flag::AT_REST } else { 0 };
        if self.diverged {
            flags |= record_flag::DIVERGED;
        }
        match &found {
            None => flags |= record_flag::SETPOINT_NONE,
            Some(found) if found.stale => {
                flags |= record_flag::SETPOINT_STALE;
                self.authority.journal.counters.setpoint_stale += 1;
            }
            Some(_) => {}
        }
        let setpoint = found.map_or_else(|| system::rest_at(&self.state), |found| found.value);
        let (q, v) = self.truth.measure(&self.state.q, &self.state.v, at.tick);
        let record = &mut self.record;
        **record = TickRecord {
            // In a group the port puts the run's own in its place.
            origin: Origin::in_process(Role::Plant),
            tick: at.tick,
            deadline_ns: at.deadline_ns,
            sampled_ns: at.sampled_ns,
            grace_deadline_ns: at.grace_deadline_ns,
            start_plant_ns: plant_ns,
            setpoint_offset_ns: offset_ns,
            setpoint_tick: found.map_or(0, |found| found.tick),
            skipped_before: at.skipped,
            wake_late_ns: at.wake_late_ns,
            active,
            epoch,
            flags,
            links: u32::try_from(N).unwrap_or(0),
            q: to_links(&self.state.q),
            v: to_links(&self.state.v),
            q_measured: to_links(&q),
            v_measured: to_links(&v),
            q_d: to_links(&setpoint.q_d),
            v_d: to_links(&setpoint.v_d),
            a_d: to_links(&setpoint.a_d),
            disturbance: to_links(&self.truth.disturbance(clock::seconds(plant_ns))),
            ..TickRecord::zeroed()
        };
    }

    fn setpoint_value(&self, tick: u64, offset_ns: u64) -> SetpointValue<N> {
        self.setpoints.at(tick, offset_ns).map_or_else(|| system::rest_at(&self.state), |found| found.value)
    }

    /// With no answer for longer than the last torque may be held, the plant's own damping acts from s_k on.
    fn fall_back_if_due(&mut self, tick: u64) {
        let start_ns = self.record.start_plant_ns;
        let (q, v) = (to_vector(&self.record.q_measured), to_vector(&self.record.v_measured));
        let Some(tau) = self.fallback.own_torque(start_ns, &q, &v) else { return };
        if let Some((step, ticks)) = self.fallback.take_change() {
            self.authority.journal.note(HappeningKind::Fallback, step.code(), ticks, 0.0);
        }
        let (tau, _) = self.truth.saturate(&tau);
        self.line.clear();
        self.line.push_back(Segment {
            from_plant_ns: start_ns,
            answered_tick: tick,
            writer: 0,
            epoch: self.authority.active().1,
            tau: to_links(&tau),
        });
    }

    /// Whether V was within its certified bound in the tick that was just closed; looked at only while a switch is being
    /// watched. The bound is that of one law whose torque acts in time: nothing is certified of a tick with a cross-fade, a
    /// late torque or a second switch.
    fn bound_held(&mut self, setpoint: &SetpointValue<N>) -> bool {
        if !self.authority.is_on_probation() {
            self.watched_v = None;
            return true;
        }
        let active = self.authority.active().0;
        let Some((certificate, v)) = self.laws.v_of(active, &self.state, setpoint) else { return true };
        let before = self.watched_v.replace((active, v)).filter(|(of, _)| *of == active);
        let h_ns = self.closed.end_plant_ns - self.closed.start_plant_ns;
        self.closed.decision != Decision::Active.code()
            || before.is_none_or(|(_, before)| {
                before > certificate.level || Laws::<N>::bound_holds(certificate, before, v, h_ns)
            })
    }
}
