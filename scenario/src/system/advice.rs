//! Changes of a scenario with which its law is certified, its sampled loop stable with room, and its plant covered.

use crate::{Nanos, Scenario, ScenarioError};
use loopbound_model::bound::coverage::{Gap, Surroundings, gaps};
use loopbound_model::bound::design::best;
use loopbound_model::bound::remedy;
use loopbound_model::bound::stability::radius::SampledLoop;
use loopbound_model::certificate::Certificate;
use loopbound_model::certificate::envelope::{Assumptions, Envelope};
use loopbound_model::certificate::sampling::sampling_budget;
use loopbound_model::certificate::search::{Candidate, Task, round_up};
use loopbound_model::certificate::start::StartError;
use loopbound_model::law::{Law, LawKind};
use loopbound_model::truth::Truth;

/// The share of the room that sampling leaves which advice uses: the loop stays stable when period and delay are 11 % longer.
pub const ROOM: f64 = 0.9;

/// Configurations, beside the aligned ones, over which spectral radii are taken.
pub const CONFIGURATIONS: u32 = 16;

/// Settings that make everything hold, with what they certify.
#[derive(Clone, Debug, PartialEq)]
pub struct Remedy {
    /// Such as `controller.gains.level=28.2`: what `--set` takes.
    pub settings: Vec<String>,
    /// The certificate with them.
    pub certificate: Certificate,
    /// The share of \[11] that they use; none for `ctc`.
    pub used: Option<f64>,
}

/// Everything that advice about one scenario rests on.
struct Case<const N: usize> {
    kind: LawKind,
    truth: Truth<N>,
    assumptions: Assumptions<N>,
    law: Law<N>,
    around: Surroundings,
    period_s: f64,
    delay_s: f64,
    room: f64,
}

impl<const N: usize> Case<N> {
    fn new(scenario: &Scenario, period_s: f64, delay_s: f64, room: f64) -> Result<Self, ScenarioError> {
        let kind = scenario.controller.law;
        Ok(Self {
            kind,
            truth: scenario.build_truth()?,
            assumptions: super::assumptions(scenario)?,
            law: super::law(scenario, kind)?,
            around: super::surroundings(scenario),
            period_s,
            delay_s,
            room,
        })
    }

    fn law_of(&self, candidate: &Candidate) -> Law<N> {
        Law::new(self.kind, self.law.model, &candidate.gains, &candidate.certificate)
    }

    /// Whether the sampled loop is stable, also with longer times.
    fn is_stable(&self, candidate: &Candidate) -> bool {
        let sampled = SampledLoop::new(&self.law_of(candidate), &self.truth.chain, CONFIGURATIONS);
        sampled.is_stable(self.period_s / self.room, self.delay_s / self.room)
            && sampled.is_stable(self.period_s, self.delay_s)
    }

    fn gaps(&self, candidate: &Candidate) -> Vec<Gap> {
        let assumptions = Assumptions {
            mass_mismatch: candidate.envelope.mu,
            disturbance_bound_nm: candidate.envelope.disturbance_nm,
            ..self.assumptions
        };
        gaps(&self.truth, &assumptions, &self.law_of(candidate), &candidate.certificate, &self.around)
    }

    /// What would have to be declared for the plant to be covered, as far as a declaration can.
    fn declared(&self, gaps: &[Gap]) -> Envelope {
        let mut envelope = self.assumptions.envelope();
        for gap in gaps {
            match *gap {
                Gap::Model { inertia, weight, .. } => envelope.mu = round_up(inertia.max(weight)),
                Gap::Disturbance { found_nm, .. } => envelope.disturbance_nm = round_up(found_nm),
                Gap::Friction { found_nm, .. } => {
                    envelope.disturbance_nm = round_up(self.truth.disturbance.sup_norm() + found_nm);
                }
                _ => {}
            }
        }
        envelope
    }

    fn task<'a>(
        &self,
        scenario: &Scenario,
        envelope: Envelope,
        fits: &'a dyn Fn(&Candidate) -> bool,
    ) -> Result<Task<'a>, ScenarioError> {
        let start = super::start::<N>(scenario)?;
        Ok(Task {
            rules: self.kind.rules(),
            envelope,
            gains: super::gains(scenario, self.kind),
            start: Some(StartError::of(&self.assumptions.nominal, &start)),
            period_s: self.period_s,
            delay_s: self.delay_s,
            room: self.room,
            fits,
        })
    }

    fn remedy(&self, scenario: &Scenario, candidate: &Candidate) -> Remedy {
        let now = (&self.assumptions.envelope(), &super::gains(scenario, self.kind));
        let changes = remedy::changes(now, candidate);
        let budget = sampling_budget(&candidate.certificate, self.period_s, self.delay_s);
        Remedy {
            settings: changes.into_iter().map(|(quantity, value)| format!("{}={value}", quantity.key())).collect(),
            certificate: candidate.certificate,
            used: budget.map(|budget| budget.used),
        }
    }
}

/// Settings that mend what a scenario lacks at a latency (s), the best gains of the grid last; empty if none were found.
///
/// # Errors
/// If the scenario describes no system.
pub fn remedies<const N: usize>(scenario: &Scenario, latency_s: f64) -> Result<Vec<Remedy>, ScenarioError> {
    let case = Case::<N>::new(scenario, Nanos(scenario.period_ns()).seconds(), latency_s, ROOM)?;
    let now = super::gaps::<N>(scenario, case.kind)?;
    let envelope = case.declared(&now);
    // No gains make sensors exact, and no declaration covers masses that may be anything.
    if envelope.mu >= 1.0 || now.iter().any(|gap| matches!(gap, Gap::Measurement { .. })) {
        return Ok(Vec::new());
    }
    let fits = |candidate: &Candidate| case.gaps(candidate).is_empty() && case.is_stable(candidate);
    let found = remedy::remedies(&case.task(scenario, envelope, &fits)?);
    Ok(found.iter().map(|candidate| case.remedy(scenario, candidate)).collect())
}

/// The gains that prove the smallest |e| for the plants that are declared, within a share of the room that a period and a
/// delay (s) leave; none if none were found.
///
/// # Errors
/// If the scenario describes no system.
pub fn best_gains<const N: usize>(
    scenario: &Scenario,
    period_s: f64,
    delay_s: f64,
    room: f64,
) -> Result<Option<Remedy>, ScenarioError> {
    let case = Case::<N>::new(scenario, period_s, delay_s, room)?;
    let fits = |candidate: &Candidate| case.is_stable(candidate);
    let found = best(&case.task(scenario, case.assumptions.envelope(), &fits)?);
    Ok(found.map(|candidate| case.remedy(scenario, &candidate)))
}
