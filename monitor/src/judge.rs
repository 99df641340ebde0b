//! The bound, tick by tick: V, promise (a), diagnosis (b), Ψ against C1, with the certificate of whoever was in charge.
//!
//! Promise and diagnosis need no history but the sample that a torque answers, so a monitor may join at any time. Not
//! checked, and not counted as checked: ticks at rest, ticks before the first torque has acted (nothing answers a sample
//! there), ticks whose torques come from two laws (a swap, a blend), and whatever has no certificate.

mod figures;

use loopbound_model::bound::coverage::{Surroundings, gaps};
use loopbound_model::bound::diagnose::{Diagnosis, IntervalDiagnosis, Segment, Verdict};
use loopbound_model::certificate::envelope::Assumptions;
use loopbound_model::certificate::{Certificate, Gains};
use loopbound_model::chain::Chain;
use loopbound_model::claim::Claim;
use loopbound_model::integrator::PlantState;
use loopbound_model::law::{Gain, Law, LawInput, LawKind, certify};
use loopbound_model::trajectory::SetpointValue;
use loopbound_model::truth::Truth;
use loopbound_scenario::system;
use loopbound_scenario::{Scenario, ScenarioError};
use loopbound_shared::event::{Decision, Role};
use loopbound_shared::runaway::{self, Runaway};
use loopbound_shared::sample::{Announce, SEGMENTS_MAX, TickRecord, record_flag, to_vector};

use self::figures::Figures;
use crate::event::{EventKind, EventLog};
use crate::members::name_of;
use crate::summary::{BoundSummary, Quantiles, finite};
use crate::tracker::segments;

/// Samples that are remembered: a torque that is older than this answers an unknown one.
const SAMPLES: usize = 1024;
/// A tick that claims to be longer is not integrated: that could take for ever.
const SPAN_MAX_NS: u64 = 60_000_000_000;
/// Controllers whose law is remembered.
const CLAIMS_MAX: usize = 64;

/// What is known of one controller's law.
#[derive(Clone, Debug)]
struct CertifiedLaw<const N: usize> {
    law: Law<N>,
    certificate: Certificate,
    shortfalls: Vec<String>,
    /// What of the plant lies outside of what the controller declares.
    outside: Vec<String>,
}

/// What one controller said of itself.
#[derive(Clone, Debug)]
struct Said<const N: usize> {
    id: u32,
    /// Its law, if it announced one.
    claim: Option<CertifiedLaw<N>>,
    /// What it calls itself.
    name: String,
}

/// Checks the bound of a group with N links.
#[derive(Debug)]
pub struct Judge<const N: usize> {
    truth: Truth<N>,
    assumptions: Assumptions<N>,
    /// What of the loop bears on whether the plant is covered.
    surroundings: Surroundings,
    /// The start that each law's certificate has to cover, if any.
    starts: [Option<LawInput<N>>; LawKind::ALL.len()],
    scenario_gains: [Gains; LawKind::ALL.len()],
    scenario_laws: [Claim; LawKind::ALL.len()],
    step_max_ns: u64,
    settle_ns: u64,
    period_ns: u64,
    late_ns: u64,
    actuation_delay_ns: u64,
    /// The scenario's own law, and the controllers that have it unless they say otherwise.
    own: Option<CertifiedLaw<N>>,
    own_ids_max: u32,
    claims: Vec<Said<N>>,
    samples: Box<[Option<(u64, Sample<N>)>]>,
    before: Option<Before>,
    /// The controller in charge, and whether V is outside its law's level.
    active: u32,
    outside: bool,
    /// The controller in charge, and V of its first tick, in its law.
    v_start: Option<(u32, f64)>,
    figures: Figures<N>,
}

/// A sample as the controllers got it, with the setpoint that the accepted torque used and the one of the tick.
#[derive(Clone, Copy, Debug)]
struct Sample<const N: usize> {
    answered: LawInput<N>,
    scheduled: LawInput<N>,
    /// Two laws answered it: the torque is neither's.
    blended: bool,
}

/// What the tick before promised.
#[derive(Clone, Copy, Debug)]
struct Before {
    end_plant_ns: u64,
    active: u32,
    v: f64,
    v_bound: f64,
    checked: bool,
}

/// V and what was promised for it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Judged {
    /// V at s_k, in the V of whoever is in charge.
    pub v: Option<f64>,
    /// The right side of promise (a) from the tick before.
    pub v_bound: Option<f64>,
    /// c, the certified level of V; none where nothing is certified.
    pub level: Option<f64>,
    /// What the diagnosis found; none for a tick that was not checked.
    pub verdict: Option<Verdict>,
    /// Whether V ran away.
    pub runaway: Option<Runaway>,
}

impl<const N: usize> Judge<N> {
    /// Takes from the scenario what is true and what is assumed.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let assumptions = system::assumptions::<N>(scenario)?;
        let scenario_gains = LawKind::ALL.map(|law| system::gains(scenario, law));
        let mut starts = [None; LawKind::ALL.len()];
        for law in LawKind::ALL {
            starts[law as usize] = system::start_of(scenario, law)?;
        }
        let mut judge = Self {
            truth: scenario.build_truth()?,
            assumptions,
            starts,
            scenario_gains,
            scenario_laws: system::laws::<N>(scenario)?,
            surroundings: system::surroundings(scenario),
            step_max_ns: scenario.loop_.max_step.ns(),
            settle_ns: scenario.loop_.settle_ns(),
            period_ns: scenario.period_ns(),
            late_ns: scenario.loop_.late_ns(),
            actuation_delay_ns: scenario.plant.actuation_delay.ns(),
            own: None,
            own_ids_max: scenario.controller.standby.saturating_add(1),
            claims: Vec::with_capacity(CLAIMS_MAX),
            samples: vec![None; SAMPLES].into_boxed_slice(),
            before: None,
            active: 0,
            outside: false,
            v_start: None,
            figures: Figures::default(),
        };
        let law = scenario.controller.law;
        // A user's own executable has no law but the one that it announces.
        judge.own = scenario.controller.exe.is_none().then(|| judge.law_of(law, &scenario_gains[law as usize]));
        Ok(judge)
    }

    fn law_of(&self, kind: LawKind, gains: &Gains) -> CertifiedLaw<N> {
        let certification = certify(kind, &self.assumptions, gains, self.starts[kind as usize].as_ref());
        let certificate = certification.certificate;
        let law = Law::new(kind, self.assumptions.nominal, gains, &certificate);
        let shortfalls = certification.failures.iter().map(ToString::to_string).collect();
        let gaps = gaps(&self.truth, &self.assumptions, &law, &certificate, &self.surroundings);
        let outside = gaps.iter().map(ToString::to_string).collect();
        CertifiedLaw { law, certificate, shortfalls, outside }
    }

    /// Takes what a controller says of its law. Gains other than the scenario's get a certificate of their own.
    pub fn learn(&mut self, announce: &Announce) {
        if announce.role != Role::Controller.code() {
            return;
        }
        let claim = announce.claim().map(|claim| self.certified(&claim));
        let said = Said { id: announce.id, claim, name: name_of(announce) };
        match self.claims.iter().position(|known| known.id == announce.id) {
            Some(at) => self.claims[at] = said,
            None => {
                // Numbers are never given twice, so the oldest is the likeliest to be gone.
                if self.claims.len() == CLAIMS_MAX {
                    self.claims.remove(0);
                }
                self.claims.push(said);
            }
        }
    }

    /// Whether controller `id` has said what it is.
    #[must_use]
    pub fn knows(&self, id: u32) -> bool {
        self.claims.iter().any(|said| said.id == id)
    }

    /// A claim with its certificate: the scenario's if it is the scenario's law, else one of its own.
    fn certified(&self, claim: &Claim) -> CertifiedLaw<N> {
        let kind = claim.law;
        let gains = self.scenario_gains[kind as usize];
        if claim.is_same_law(&self.scenario_laws[kind as usize]) {
            return self.law_of(kind, &gains);
        }
        let Claim { beta, k_p, k_d, .. } = *claim;
        let k_t = kind.uses(Gain::KTotal).then_some(claim.k_t);
        let mut law = self.law_of(kind, &Gains { beta, k_p, k_d, k_t, ..gains });
        law.law.k_t = claim.k_t;
        law
    }

    fn claim_for(&self, id: u32) -> Option<&CertifiedLaw<N>> {
        claim_in(&self.claims, self.own.as_ref(), self.own_ids_max, id)
    }

    /// Judges the tick of a record.
    pub fn feed(&mut self, record: &TickRecord, events: &mut EventLog) -> Judged {
        let x = true_input::<N>(record);
        self.remember(record);
        let active = if record.active == 0 { self.active } else { record.active };
        self.active = active;
        // With nobody in charge yet, V is that of the scenario's law.
        let (own, said) = (self.own.as_ref(), self.claims.iter().find(|said| said.id == active));
        let claim = if active == 0 { own } else { claim_in(&self.claims, own, self.own_ids_max, active) };
        self.figures.turn_to(active, claim, said.map(|said| said.name.as_str()));
        if record.flags & record_flag::AT_REST == 0
            && let Some(of) = self.figures.current()
        {
            of.note_tick(record.tick);
        }
        let Some(claim) = claim else {
            self.before = None;
            return Judged::default();
        };
        let certificate = claim.certificate;
        let v = certificate.v(&self.truth.chain, &x);
        let diagnosis = self.diagnose(record, claim, &x);
        let before = self
            .before
            .filter(|before| before.end_plant_ns == record.start_plant_ns && before.active == active && before.checked);
        self.note_v(record, v, &certificate, &x, events);
        let runaway = self.runaway(record, v, active, certificate.level);
        if let Some(before) = before {
            self.note_promise(record, v, &before, &certificate, events);
        }
        if let Some(diagnosis) = &diagnosis {
            self.note_diagnosis(record, diagnosis, events);
        }
        let h_s = record.end_plant_ns.saturating_sub(record.start_plant_ns) as f64 * 1e-9;
        self.before = Some(Before {
            end_plant_ns: record.end_plant_ns,
            active,
            v,
            v_bound: certificate.promised(v, h_s),
            checked: diagnosis.is_some() && v <= certificate.level,
        });
        Judged {
            v: finite(v),
            v_bound: before.and_then(|before| finite(before.v_bound)),
            level: finite(certificate.level).filter(|_| certificate.is_certified()),
            verdict: diagnosis.map(|diagnosis| diagnosis.verdict),
            runaway,
        }
    }

    fn remember(&mut self, record: &TickRecord) {
        let (q, v) = (to_vector(&record.q_measured), to_vector(&record.v_measured));
        let scheduled =
            LawInput { q, v, q_d: to_vector(&record.q_d), v_d: to_vector(&record.v_d), a_d: to_vector(&record.a_d) };
        let used = LawInput {
            q,
            v,
            q_d: to_vector(&record.used_q_d),
            v_d: to_vector(&record.used_v_d),
            a_d: to_vector(&record.used_a_d),
        };
        // Without an accepted torque nobody said which setpoint was used.
        let answered =
            if record.accepted_ns == 0 && record.decision != Decision::Active.code() { scheduled } else { used };
        let blended = record.decision == Decision::Blend.code();
        self.samples[place(record.tick)] = Some((record.tick, Sample { answered, scheduled, blended }));
    }

    fn sample(&self, tick: u64) -> Option<&Sample<N>> {
        self.samples[place(tick)].as_ref().filter(|(of, _)| *of == tick).map(|(_, sample)| sample)
    }

    fn diagnose(&self, record: &TickRecord, claim: &CertifiedLaw<N>, x: &LawInput<N>) -> Option<IntervalDiagnosis<N>> {
        let used = segments(record);
        let span_ns = record.end_plant_ns.checked_sub(record.start_plant_ns);
        let unfit = span_ns.is_none_or(|span_ns| span_ns > SPAN_MAX_NS)
            || record.flags & (record_flag::AT_REST | record_flag::DIVERGED) != 0
            || !claim.certificate.v(&self.truth.chain, x).is_finite()
            || record.decision == Decision::Blend.code()
            || !claim.certificate.is_certified()
            || used.is_empty()
            || used.iter().any(|segment| is_before_the_first(segment) || !self.is_same_law(segment.writer, claim));
        if unfit {
            return None;
        }
        // With a delay on the way to the actuator the schedule has another sample, and often two in a tick.
        let scheduled =
            self.sample(record.tick).filter(|_| self.actuation_delay_ns == 0).map(|sample| sample.scheduled);
        let nothing = Segment { to_ns: 0, tau: to_vector(&[0.0; 7]), answered: None, scheduled: None, late: false };
        let mut parts = [nothing; SEGMENTS_MAX];
        for (at, segment) in used.iter().enumerate() {
            let to_ns = used.get(at + 1).map_or(record.end_plant_ns, |next| next.from_plant_ns);
            let answered = self.sample(segment.answered_tick).filter(|_| segment.writer != 0);
            // A torque that answers a sample which this monitor did not see, or two laws, can't be recomputed.
            if segment.writer != 0 && answered.is_none_or(|sample| sample.blended) {
                return None;
            }
            parts[at] = Segment {
                to_ns: to_ns.clamp(record.start_plant_ns, record.end_plant_ns.max(record.start_plant_ns)),
                tau: to_vector(&segment.tau),
                answered: answered.map(|sample| sample.answered),
                scheduled,
                late: segment.writer == 0 || to_ns > self.due_plant_ns(segment.answered_tick.saturating_add(1)),
            };
        }
        let diagnosis = Diagnosis {
            truth: &self.truth,
            certificate: &claim.certificate,
            law: Some(&claim.law),
            step_max_ns: self.step_max_ns,
        };
        let setpoint = SetpointValue { q_d: x.q_d, v_d: x.v_d, a_d: x.a_d };
        let state = PlantState { q: x.q, v: x.v };
        Some(diagnosis.interval(&state, &setpoint, record.start_plant_ns, &parts[..used.len()]))
    }

    /// When the torque of a tick acts at the latest if it is not late.
    fn due_plant_ns(&self, tick: u64) -> u64 {
        tick.saturating_mul(self.period_ns).saturating_add(self.late_ns + self.actuation_delay_ns)
    }

    fn is_same_law(&self, writer: u32, claim: &CertifiedLaw<N>) -> bool {
        let one = |of: &CertifiedLaw<N>| Claim::of_law(&of.law);
        writer == 0 || self.claim_for(writer).is_some_and(|other| one(other).is_same_law(&one(claim)))
    }

    fn note_v(
        &mut self,
        record: &TickRecord,
        v: f64,
        certificate: &Certificate,
        x: &LawInput<N>,
        events: &mut EventLog,
    ) {
        let level = certificate.level;
        // At rest the setpoint may not have come yet, and V says nothing of the law.
        if record.flags & record_flag::AT_REST != 0 {
            return;
        }
        if let Some(of) = self.figures.current() {
            of.note_v(v);
            if record.start_plant_ns >= self.settle_ns {
                of.note_w(certificate.w_of(x));
            }
        }
        let outside = v.is_nan() || v > level;
        if outside != self.outside {
            self.outside = outside;
            events.push(record.tick, record.start_plant_ns, EventKind::Level { v, level, inside: !outside });
        }
    }

    /// Whether V ran away. At rest, without a setpoint and once the plant has stopped it says nothing of the loop.
    fn runaway(&mut self, record: &TickRecord, v: f64, active: u32, level: f64) -> Option<Runaway> {
        let mute = record_flag::AT_REST | record_flag::SETPOINT_NONE | record_flag::DIVERGED;
        if record.flags & mute != 0 {
            return None;
        }
        let known = self.v_start.filter(|(of, _)| *of == active);
        let (_, v_start) = *self.v_start.insert(known.unwrap_or((active, v)));
        runaway::of_v(v, level, v_start)
    }

    fn note_promise(
        &mut self,
        record: &TickRecord,
        v: f64,
        before: &Before,
        certificate: &Certificate,
        events: &mut EventLog,
    ) {
        debug_assert!(certificate.is_certified(), "only checked ticks promise");
        let slack = before.v_bound - v;
        // The tolerance of the diagnosis; a V that is not a number breaks every promise.
        let broken = slack.is_nan() || slack < -1e-6 * (1.0 + before.v);
        self.figures.note_promise(slack, broken);
        if broken {
            let kind = EventKind::Promise { v, v_bound: before.v_bound };
            events.push(record.tick, record.start_plant_ns, kind);
        }
    }

    fn note_diagnosis(&mut self, record: &TickRecord, found: &IntervalDiagnosis<N>, events: &mut EventLog) {
        if self.figures.note_diagnosis(found) {
            let (verdict, int_f) = (figures::name_of(found.verdict), found.int_f_own + found.int_f);
            let kind = EventKind::Bound { verdict, x: found.x, int_l: found.int_l, int_f };
            events.push(record.tick, record.start_plant_ns, kind);
        }
    }

    /// The figures so far. `loop_latency`: of deadline → torque, whose least and p99.9 are the range of the delay.
    #[must_use]
    pub fn summary(&self, period_ns: u64, loop_latency: &Quantiles) -> BoundSummary {
        let mut summary = self.figures.summary(self.own.as_ref());
        let claim = if self.active == 0 { self.own.as_ref() } else { self.claim_for(self.active) };
        if let Some(claim) = claim {
            let delay_ns = |latency_ns: Option<f64>| latency_ns.map(|ns| ns + self.actuation_delay_ns as f64);
            let range_ns = delay_ns(loop_latency.min).zip(delay_ns(loop_latency.p99_9));
            figures::put_budget(&mut summary, &claim.certificate, period_ns, range_ns);
        }
        summary
    }

    /// The plant's chain.
    #[must_use]
    pub fn true_chain(&self) -> &Chain<N> {
        &self.truth.chain
    }
}

/// The claim of a controller: its own, or the scenario's for those that have its law unless they say otherwise.
fn claim_in<'a, const N: usize>(
    claims: &'a [Said<N>],
    own: Option<&'a CertifiedLaw<N>>,
    own_ids_max: u32,
    id: u32,
) -> Option<&'a CertifiedLaw<N>> {
    match claims.iter().find(|said| said.id == id) {
        Some(said) => said.claim.as_ref(),
        None => own.filter(|_| (1..=own_ids_max).contains(&id)),
    }
}

/// Whether nothing has acted yet: also the plant's own torques have the epoch of whoever should have answered.
fn is_before_the_first(segment: &loopbound_shared::sample::Segment) -> bool {
    segment.writer == 0 && segment.epoch == 0
}

fn place(tick: u64) -> usize {
    usize::try_from(tick % SAMPLES as u64).unwrap_or(0)
}

fn true_input<const N: usize>(record: &TickRecord) -> LawInput<N> {
    LawInput {
        q: to_vector(&record.q),
        v: to_vector(&record.v),
        q_d: to_vector(&record.q_d),
        v_d: to_vector(&record.v_d),
        a_d: to_vector(&record.a_d),
    }
}
