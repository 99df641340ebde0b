//! From the scenario to what is certified of it: gains, assumptions, certificates, laws.
//!
//! Chain, plant and motion come from the scenario's own `build_…`; every process and every study builds the rest here,
//! so they can't disagree about what a scenario means.

pub mod advice;

mod check;

pub use check::{check, remarks};

use crate::{Nanos, Scenario, ScenarioError};
use loopbound_model::bound::coverage::{Gap, Surroundings, gaps as gaps_of};
use loopbound_model::certificate::envelope::Assumptions;
use loopbound_model::certificate::requirement::Certification;
use loopbound_model::certificate::start::StartError;
use loopbound_model::certificate::{Certificate, Gains};
use loopbound_model::chain::Vector;
use loopbound_model::claim::Claim;
use loopbound_model::integrator::PlantState;
use loopbound_model::law::{Law, LawInput, LawKind, certificate, certify};
use loopbound_model::trajectory::SetpointValue;

/// A setpoint of standing still where the plant is: used until the first real one comes.
#[must_use]
pub fn rest_at<const N: usize>(state: &PlantState<N>) -> SetpointValue<N> {
    SetpointValue { q_d: state.q, v_d: Vector::zeros(), a_d: Vector::zeros() }
}

/// The gains of a law in a scenario.
#[must_use]
pub fn gains(scenario: &Scenario, law: LawKind) -> Gains {
    let gains = &scenario.controller.gains;
    Gains {
        beta: gains.beta,
        k2: gains.k2,
        k3: gains.k3,
        c1: gains.c1.or(law.c1_nm()),
        level: gains.level,
        k_p: gains.kp,
        k_d: gains.kd,
        k_t: gains.k_t,
        analyst_beta: gains.analyst_beta,
        analyst_k2: None,
        shared_v: gains.shared_v,
    }
}

/// What certificates assume in a scenario.
///
/// # Errors
/// If the scenario describes no system.
pub fn assumptions<const N: usize>(scenario: &Scenario) -> Result<Assumptions<N>, ScenarioError> {
    Ok(Assumptions {
        nominal: scenario.build_model()?,
        mass_mismatch: scenario.controller.uncertainty.mass,
        disturbance_bound_nm: scenario.controller.uncertainty.disturbance_nm,
        sup: scenario.build_trajectory::<N>()?.sup_norms(),
    })
}

/// The true start and the setpoint at t = 0.
///
/// # Errors
/// If the scenario describes no system.
pub fn start<const N: usize>(scenario: &Scenario) -> Result<LawInput<N>, ScenarioError> {
    let (state, setpoint) = (scenario.build_start::<N>()?, scenario.build_trajectory::<N>()?.at(0.0));
    Ok(input(&state, &setpoint))
}

/// The start that the certificate of a law has to cover: that of the law which is in charge then. Any other law takes over
/// later, from wherever the gate of the swap lets it in: inside its level.
///
/// # Errors
/// If the scenario describes no system.
pub fn start_of<const N: usize>(scenario: &Scenario, law: LawKind) -> Result<Option<LawInput<N>>, ScenarioError> {
    if law == scenario.controller.law { start(scenario).map(Some) } else { Ok(None) }
}

/// State and setpoint as a law sees them.
#[must_use]
pub fn input<const N: usize>(state: &PlantState<N>, setpoint: &SetpointValue<N>) -> LawInput<N> {
    LawInput { q: state.q, v: state.v, q_d: setpoint.q_d, v_d: setpoint.v_d, a_d: setpoint.a_d }
}

/// The certificate of a law in a scenario, with what it lacks.
///
/// # Errors
/// If the scenario describes no system.
pub fn certification<const N: usize>(scenario: &Scenario, law: LawKind) -> Result<Certification, ScenarioError> {
    let start = start_of(scenario, law)?;
    Ok(certify(law, &assumptions::<N>(scenario)?, &gains(scenario, law), start.as_ref()))
}

/// The certificate alone.
///
/// # Errors
/// If the scenario describes no system.
pub fn certificate_of<const N: usize>(scenario: &Scenario, law: LawKind) -> Result<Certificate, ScenarioError> {
    let assumptions = assumptions::<N>(scenario)?;
    let start = start_of(scenario, law)?.map(|start| StartError::of(&assumptions.nominal, &start));
    Ok(certificate(law, &assumptions.envelope(), &gains(scenario, law), start.as_ref()))
}

/// A law with its model and the gains that its certificate gives it.
///
/// # Errors
/// If the scenario describes no system.
pub fn law<const N: usize>(scenario: &Scenario, kind: LawKind) -> Result<Law<N>, ScenarioError> {
    let certificate = certificate_of::<N>(scenario, kind)?;
    Ok(Law::new(kind, scenario.build_model()?, &gains(scenario, kind), &certificate))
}

/// What of a scenario's own plant the certificate of a law does not cover.
///
/// # Errors
/// If the scenario describes no system.
pub fn gaps<const N: usize>(scenario: &Scenario, kind: LawKind) -> Result<Vec<Gap>, ScenarioError> {
    let (truth, assumptions) = (scenario.build_truth::<N>()?, assumptions::<N>(scenario)?);
    Ok(gaps_of(
        &truth,
        &assumptions,
        &law::<N>(scenario, kind)?,
        &certificate_of::<N>(scenario, kind)?,
        &surroundings(scenario),
    ))
}

/// What of a scenario's loop bears on whether its plant is covered.
#[must_use]
pub fn surroundings(scenario: &Scenario) -> Surroundings {
    Surroundings {
        period_s: Nanos(scenario.period_ns()).seconds(),
        actuation_delay_s: scenario.plant.actuation_delay.seconds(),
        speed_limit_rad_s: scenario.plant.speed_limit,
    }
}

/// What the controllers of a scenario claim: its laws, in the order of [`LawKind::ALL`].
///
/// # Errors
/// If the scenario describes no system.
pub fn laws<const N: usize>(scenario: &Scenario) -> Result<[Claim; LawKind::ALL.len()], ScenarioError> {
    let mut laws = [Claim::of_law(&law::<N>(scenario, LawKind::Robust)?); LawKind::ALL.len()];
    for (place, kind) in laws.iter_mut().zip(LawKind::ALL) {
        *place = Claim::of_law(&law::<N>(scenario, kind)?);
    }
    Ok(laws)
}

#[cfg(test)]
mod tests;
