//! One recorded tick, computed again: the same integrator, plant, laws and limits, fed with the recorded decisions.
//!
//! What is taken from the recording: when each torque began to act, whose it was and which sample it answers, the
//! setpoint that its controller used, what was injected. What is computed again: the true and the measured state, every
//! torque of a built-in law, the blends, the plant's own damping. A torque of a foreign controller is taken as recorded.

use std::collections::{BTreeMap, VecDeque};

use loopbound_controller::{Builtin, ControllerCore};
use loopbound_model::chain::Vector;
use loopbound_model::claim::Claim;
use loopbound_model::integrator::{PlantState, integrate};
use loopbound_model::law::{Law, LawInput, LawKind, fade_weight, faded};
use loopbound_model::truth::Truth;
use loopbound_plant::Damping;
use loopbound_scenario::controllers;
use loopbound_scenario::system;
use loopbound_scenario::{Scenario, ScenarioError};
use loopbound_shared::event::{CommandKind, Decision, HappeningKind, LiveFault, Role};
use loopbound_shared::fault::FaultPlan;
use loopbound_shared::opening;
use loopbound_shared::realtime::Privileges;
use loopbound_shared::sample::{Announce, SEGMENTS_MAX, Segment, TickRecord, record_flag, to_links, to_vector};

/// Ticks that a torque may be under way.
const HISTORY: usize = 4096;

/// A controller whose torques can be computed again.
struct Known<const N: usize> {
    id: u32,
    law: Law<N>,
    faults: FaultPlan,
    announcement: Announce,
}

/// What a torque of a tick is computed from.
#[derive(Clone, Copy)]
struct Answered<const N: usize> {
    tick: u64,
    input: LawInput<N>,
    active: u32,
    blends: bool,
}

/// A cross-fade that the scenario has scheduled.
#[derive(Clone, Copy)]
struct Fade {
    from: u32,
    tick: u64,
    ticks: u64,
}

/// Why a torque is taken as recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AsRecorded {
    /// A user's controller, or one with other gains than the scenario's.
    UnknownLaw,
    /// A cross-fade of a swap that was commanded by hand.
    Fade,
    /// A glitch that was injected by hand: how large it was is in no record.
    Glitch,
    /// The sample that it answers is not in the recording.
    NoSample,
}

impl AsRecorded {
    /// What a person is told, after the number of torques.
    #[must_use]
    pub const fn reason(self) -> &'static str {
        match self {
            Self::UnknownLaw => "of controllers whose law or gains are not the scenario's",
            Self::Fade => "in a cross-fade that was commanded by hand",
            Self::Glitch => "with a glitch that was injected by hand",
            Self::NoSample => "for samples that are not in the recording",
        }
    }
}

/// The plant and its controllers, driven by records.
pub struct Engine<const N: usize> {
    scenario: Scenario,
    truth: Truth<N>,
    damping: Damping<N>,
    controllers: Vec<Known<N>>,
    state: PlantState<N>,
    acting: Option<(Segment, Vector<N>)>,
    answered: VecDeque<Answered<N>>,
    fade: Option<Fade>,
    /// The controller whose torques have a glitch that was injected by hand, and the ticks in which.
    spoilt: Option<(u32, std::ops::Range<u64>)>,
    /// Segments whose torque was taken as recorded, by reason.
    pub as_recorded: BTreeMap<AsRecorded, u64>,
    /// Segments whose torque was computed again.
    pub recomputed: u64,
}

impl<const N: usize> Engine<N> {
    /// The plant of a scenario, where `first` finds it: at the start of the scenario when that is tick 0.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn new(scenario: &Scenario, first: &TickRecord) -> Result<Self, ScenarioError> {
        let mut state = scenario.build_start::<N>()?;
        if first.tick > 0 {
            state = PlantState { q: to_vector(&first.q), v: to_vector(&first.v) };
        }
        let mut controllers = Vec::new();
        for part in controllers::of(scenario).into_iter().filter(|part| part.exe.is_none()) {
            controllers.push(Known::new(scenario, part.id, part.law)?);
        }
        Ok(Self {
            truth: scenario.build_truth()?,
            damping: Damping::new(scenario)?,
            controllers,
            state,
            acting: None,
            answered: VecDeque::with_capacity(HISTORY),
            fade: None,
            spoilt: None,
            scenario: scenario.clone(),
            as_recorded: BTreeMap::new(),
            recomputed: 0,
        })
    }

    /// Learns of a controller that the scenario does not name: one that was brought in by hand. Its law is known if it
    /// says one and has the scenario's gains.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn learn(&mut self, announce: &Announce) -> Result<(), ScenarioError> {
        let known = self.controllers.iter().any(|known| known.id == announce.id);
        let named = controllers::of(&self.scenario).iter().any(|part| part.id == announce.id);
        if announce.role != Role::Controller.code() || known || named {
            return Ok(());
        }
        let Some(claim) = announce.claim() else { return Ok(()) };
        let found = Known::new(&self.scenario, announce.id, claim.law)?;
        if claim.is_same_law(&Claim::of_law(&found.law)) {
            self.controllers.push(found);
        }
        Ok(())
    }

    /// What the controllers of this scenario say of themselves.
    pub fn announcements(&self) -> impl Iterator<Item = &Announce> {
        self.controllers.iter().map(|known| &known.announcement)
    }

    /// The record of the tick as this code finds it: state, torques and disturbance computed, the rest as recorded.
    pub fn tick(&mut self, recorded: &TickRecord) -> TickRecord {
        let (q, v) = self.truth.measure(&self.state.q, &self.state.v, recorded.tick);
        let mut record = TickRecord {
            q: to_links(&self.state.q),
            v: to_links(&self.state.v),
            q_measured: to_links(&q),
            v_measured: to_links(&v),
            disturbance: to_links(&self.truth.disturbance(loopbound_shared::clock::seconds(recorded.start_plant_ns))),
            ..*recorded
        };
        self.note_fade(recorded);
        self.note_glitch(recorded);
        if self.answered.len() == HISTORY {
            self.answered.pop_front();
        }
        self.answered.push_back(Answered {
            tick: recorded.tick,
            input: LawInput {
                q,
                v,
                q_d: to_vector(&recorded.used_q_d),
                v_d: to_vector(&recorded.used_v_d),
                a_d: to_vector(&recorded.used_a_d),
            },
            active: recorded.active,
            blends: recorded.decision == Decision::Blend.code(),
        });
        let start = self.state;
        let used = (recorded.segments_used as usize).min(SEGMENTS_MAX);
        let mut plant_ns = recorded.start_plant_ns;
        for at in 0..used {
            let segment = recorded.segments[at];
            let tau = self.torque(&segment);
            record.segments[at].tau = to_links(&tau);
            let to_ns = if at + 1 < used { recorded.segments[at + 1].from_plant_ns } else { recorded.end_plant_ns };
            let rests = at == 0 && recorded.flags & record_flag::AT_REST != 0 && segment.writer == 0;
            if !rests && to_ns > plant_ns {
                let step_max_ns = self.scenario.loop_.max_step.ns();
                self.state = integrate(&self.truth, &self.state, &tau, plant_ns, to_ns, step_max_ns);
            }
            plant_ns = plant_ns.max(to_ns);
        }
        if recorded.flags & record_flag::DIVERGED != 0 {
            // The plant took the tick back in which it ran away, and stood still from then on.
            self.state = PlantState { q: start.q, v: Vector::zeros() };
        }
        record
    }

    /// τ of a segment. One that acted before goes on as it was; a new one is computed from what it answers.
    fn torque(&mut self, segment: &Segment) -> Vector<N> {
        let same = |of: &Segment| {
            (of.from_plant_ns, of.answered_tick, of.writer, of.epoch)
                == (segment.from_plant_ns, segment.answered_tick, segment.writer, segment.epoch)
        };
        if let Some((_, tau)) = self.acting.filter(|(acting, _)| same(acting)) {
            return tau;
        }
        // Before the first torque nothing acts, and nothing is computed.
        let nothing = Segment { from_plant_ns: segment.from_plant_ns, ..Segment::zeroed() };
        let tau = if *segment == nothing {
            Vector::zeros()
        } else {
            match self.compute(segment) {
                Ok(tau) => {
                    self.recomputed += 1;
                    self.truth.saturate(&tau).0
                }
                Err(why) => {
                    *self.as_recorded.entry(why).or_default() += 1;
                    to_vector(&segment.tau)
                }
            }
        };
        self.acting = Some((*segment, tau));
        tau
    }

    fn compute(&self, segment: &Segment) -> Result<Vector<N>, AsRecorded> {
        let answered = self.answered.iter().rev().find(|answered| answered.tick == segment.answered_tick);
        let answered = answered.ok_or(AsRecorded::NoSample)?;
        if segment.writer == 0 {
            return Ok(self.damping.torque(&answered.input.q, &answered.input.v));
        }
        // How large it was is in no record.
        if self.spoilt.as_ref().is_some_and(|(id, ticks)| *id == segment.writer && ticks.contains(&answered.tick)) {
            return Err(AsRecorded::Glitch);
        }
        let new = self.law_torque(segment.writer, answered).ok_or(AsRecorded::UnknownLaw)?;
        if !answered.blends || answered.active != segment.writer {
            return Ok(new);
        }
        let fade = self.fade.ok_or(AsRecorded::Fade)?;
        let old = self.law_torque(fade.from, answered).ok_or(AsRecorded::UnknownLaw)?;
        let weight = fade_weight(answered.tick.checked_sub(fade.tick).ok_or(AsRecorded::Fade)?, fade.ticks);
        Ok(Vector::from_fn(|i, _| faded(weight, new[i], old[i])))
    }

    fn law_torque(&self, id: u32, answered: &Answered<N>) -> Option<Vector<N>> {
        let known = self.controllers.iter().find(|known| known.id == id)?;
        let mut tau = known.law.torque(&answered.input);
        known.faults.at_tick(answered.tick).spoil(tau.as_mut_slice());
        Some(tau)
    }

    /// The first tick of a fault that was injected by hand says for how many it lasts.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a number of ticks, and the cast saturates"
    )]
    fn note_glitch(&mut self, record: &TickRecord) {
        let used = (record.happenings_used as usize).min(record.happenings.len());
        let glitch = record.happenings[..used].iter().find(|happening| {
            let injected = happening.kind == HappeningKind::FaultInjected.code();
            injected && happening.detail == u64::from(LiveFault::Glitch.code())
        });
        if let Some(glitch) = glitch {
            let end = record.tick.saturating_add(glitch.value as u64);
            self.spoilt = Some((glitch.subject, record.tick..end));
        }
    }

    /// A cross-fade is known where the scenario has scheduled the swap.
    fn note_fade(&mut self, record: &TickRecord) {
        let used = (record.happenings_used as usize).min(record.happenings.len());
        for happening in &record.happenings[..used] {
            if happening.kind != HappeningKind::Swap.code() {
                continue;
            }
            // It is noted in the tick that it begins with.
            let commands = opening::commands(&self.scenario, 0);
            let scheduled = commands.iter().find(|command| {
                command.kind == CommandKind::Swap.code()
                    && (command.controller, command.tick) == (happening.subject, record.tick)
            });
            self.fade = scheduled.and_then(|command| {
                let ticks = command.ns.div_ceil(self.scenario.period_ns());
                Some(Fade { from: u32::try_from(happening.detail).ok()?, tick: record.tick, ticks })
            });
        }
    }
}

impl<const N: usize> Known<N> {
    fn new(scenario: &Scenario, id: u32, kind: LawKind) -> Result<Self, ScenarioError> {
        let core = ControllerCore::new(scenario, id, Builtin::<N>::new(scenario, kind)?);
        Ok(Self {
            id,
            law: system::law(scenario, kind)?,
            faults: FaultPlan::for_target(scenario, loopbound_scenario::Role::Controller, id),
            announcement: core.announcement(Privileges::default()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_controller_brought_in_by_hand_is_computed_again_if_its_law_is_the_scenarios() {
        let scenario = Scenario::default();
        let [robust, _, ctc, _] = system::laws::<3>(&scenario).unwrap();
        let known = |claim: Claim| {
            let mut engine = Engine::<3>::new(&scenario, &TickRecord::zeroed()).unwrap();
            let mut announce = Announce { role: Role::Controller.code(), id: 9, ..Announce::zeroed() };
            announce.set_claim(&claim);
            engine.learn(&announce).unwrap();
            engine.announcements().any(|announce| announce.id == 9)
        };
        assert!(known(robust) && known(ctc));
        assert!(!known(Claim { beta: 1.0, ..robust }), "another beta is another law");
        assert!(known(Claim { beta: 1.0, ..ctc }), "it has no beta");
        assert!(!known(Claim { k_p: 1.0, ..ctc }));
    }
}
