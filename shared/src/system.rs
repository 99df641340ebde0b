//! From the scenario to the mathematics: the true chain, the controller's model, laws, motion and certificates.
//!
//! Every process and every study builds these here, so they can't disagree about what a scenario means.

use nalgebra::SVector;
use thiserror::Error;

use crate::bound::certificate::{Certificate, Certification, Gains, StartError, certificate, certify};
use crate::bound::envelope::Assumptions;
use crate::chain::{Chain, ChainError, LinkParameters, Matrix, Vector};
use crate::integrator::PlantState;
use crate::law::{Law, LawInput, LawKind};
use crate::scenario::{ChainSpec, DisturbanceTerm, Motion, Scenario};
use crate::trajectory::{
    Circle, CircleParameters, SetpointValue, SineTerm, Trajectory, TrajectoryError, Waypoints,
};
use crate::truth::{Disturbance, Truth};

/// Why a scenario describes no system.
#[derive(Debug, Error)]
pub enum SystemError {
    /// The chain is none.
    #[error("{section}: {source}")]
    Chain {
        /// `plant` or `controller.model`.
        section: &'static str,
        /// What is wrong.
        source: ChainError,
    },
    /// The motion is none.
    #[error("reference: {0}")]
    Reference(#[from] TrajectoryError),
}

/// The first N of a list that the scenario has checked to be N long.
fn fixed<const N: usize>(values: &[f64]) -> [f64; N] {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))
}

fn chain<const N: usize>(spec: &ChainSpec, section: &'static str) -> Result<Chain<N>, SystemError> {
    match spec {
        ChainSpec::Links { mass_kg, length_m, inertia_kg_m2, gravity_m_s2 } => Chain::from_links(&LinkParameters {
            mass_kg: fixed(mass_kg),
            length_m: fixed(length_m),
            inertia_kg_m2: Some(fixed(inertia_kg_m2)),
            gravity_m_s2: *gravity_m_s2,
        }),
        ChainSpec::Coefficients { a, b } => Chain::from_coefficients(
            Matrix::from_fn(|i, j| a[i][j]),
            Vector::from_column_slice(&fixed::<N>(b)),
        ),
    }
    .map_err(|source| SystemError::Chain { section, source })
}

/// The chain that the plant integrates.
///
/// # Errors
/// If the scenario's numbers are no chain.
pub fn true_chain<const N: usize>(scenario: &Scenario) -> Result<Chain<N>, SystemError> {
    chain(&scenario.plant_chain(), "plant")
}

/// The chain that the controller believes in.
///
/// # Errors
/// If the scenario's numbers are no chain.
pub fn nominal_chain<const N: usize>(scenario: &Scenario) -> Result<Chain<N>, SystemError> {
    chain(&scenario.model_chain(), "controller.model")
}

/// Everything that is true of the plant.
///
/// # Errors
/// If the scenario's numbers are no chain.
pub fn truth<const N: usize>(scenario: &Scenario) -> Result<Truth<N>, SystemError> {
    let plant = &scenario.plant;
    let seed = plant.seed;
    let term = |(index, spec): (usize, &crate::scenario::DisturbanceSpec)| match spec.term(N) {
        DisturbanceTerm::Constant { value_nm } => Disturbance::constant(fixed(&value_nm)),
        DisturbanceTerm::Sine { amplitude_nm, omega_rad_s, phase_rad } => {
            Disturbance::sine(fixed(&amplitude_nm), fixed(&omega_rad_s), fixed(&phase_rad))
        }
        DisturbanceTerm::Step { at_s, value_nm } => Disturbance::step(at_s, fixed(&value_nm)),
        DisturbanceTerm::Noise { rms_nm, low_hz, high_hz } => {
            Disturbance::noise(fixed(&rms_nm), low_hz, high_hz, seed, index as u64)
        }
    };
    Ok(Truth {
        chain: true_chain(scenario)?,
        viscous_nm_s: fixed(&plant.viscous_nm_s()),
        coulomb_nm: fixed(&plant.coulomb_nm()),
        disturbance: plant.disturbance.iter().enumerate().map(term).collect(),
        noise_q_rad: plant.noise.q_rad,
        noise_v_rad_s: plant.noise.v_rad_s,
        quantum_q_rad: plant.noise.quantum_q_rad,
        quantum_v_rad_s: plant.noise.quantum_v_rad_s,
        torque_limit_nm: fixed(&plant.torque_limit_nm()),
        seed,
    })
}

/// Where the plant starts.
#[must_use]
pub fn start_state<const N: usize>(scenario: &Scenario) -> PlantState<N> {
    PlantState {
        q: SVector::from_column_slice(&fixed::<N>(&scenario.plant.start_q_rad())),
        v: SVector::from_column_slice(&fixed::<N>(&scenario.plant.start_v_rad_s())),
    }
}

/// A setpoint of standing still where the plant is: used until the first real one comes.
#[must_use]
pub fn rest_at<const N: usize>(state: &PlantState<N>) -> SetpointValue<N> {
    SetpointValue { q_d: state.q, v_d: Vector::zeros(), a_d: Vector::zeros() }
}

/// The motion to be followed.
///
/// # Errors
/// If the motion's numbers or its file are refused.
pub fn trajectory<const N: usize>(scenario: &Scenario) -> Result<Trajectory<N>, SystemError> {
    let trajectory = match scenario.reference.motion(N) {
        Motion::Sine { amplitude_rad, omega_rad_s } => {
            Trajectory::Sine { amplitude_rad: fixed(&amplitude_rad), omega_rad_s: fixed(&omega_rad_s) }
        }
        Motion::MultiSine { terms } => Trajectory::MultiSine {
            offset_rad: [0.0; N],
            terms: std::array::from_fn(|i| {
                let of_link = |(amplitude, omega, phase): &(Vec<f64>, Vec<f64>, Vec<f64>)| SineTerm {
                    amplitude_rad: amplitude[i],
                    omega_rad_s: omega[i],
                    phase_rad: phase[i],
                };
                terms.iter().map(of_link).collect()
            }),
        },
        Motion::Quintic { from_rad, to_rad, at_s, duration_s } => {
            Trajectory::Quintic { from_rad: fixed(&from_rad), to_rad: fixed(&to_rad), start_s: at_s, duration_s }
        }
        Motion::Chirp { amplitude_rad, omega_start_rad_s, omega_end_rad_s, duration_s } => Trajectory::Chirp {
            amplitude_rad: fixed(&amplitude_rad),
            omega_from_rad_s: omega_start_rad_s,
            omega_to_rad_s: omega_end_rad_s,
            duration_s,
        },
        Motion::Circle { centre_m, radius_m, omega_rad_s } => {
            let ChainSpec::Links { length_m, .. } = scenario.plant_chain() else {
                return Err(TrajectoryError::CircleOfOneLink.into());
            };
            Trajectory::Circle(Circle::new(CircleParameters {
                length_m: fixed(&length_m),
                centre_m,
                radius_m,
                omega_rad_s,
                phase_rad: 0.0,
                elbow_positive: true,
            })?)
        }
        Motion::Waypoints { file } => Trajectory::Waypoints(Waypoints::from_csv(&file)?),
    };
    trajectory.validate()?;
    Ok(trajectory)
}

/// The gains of a law in a scenario.
#[must_use]
pub fn gains(scenario: &Scenario, law: LawKind) -> Gains {
    let gains = &scenario.controller.gains;
    Gains {
        beta: gains.beta,
        k2: gains.k2,
        k3: gains.k3,
        // The other laws know more of the plant and need less: as much as their certificates require.
        c1: (law == LawKind::Robust).then_some(gains.c1),
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
pub fn assumptions<const N: usize>(scenario: &Scenario) -> Result<Assumptions<N>, SystemError> {
    Ok(Assumptions {
        nominal: nominal_chain(scenario)?,
        mass_mismatch: scenario.controller.uncertainty.mass,
        disturbance_bound_nm: scenario.controller.uncertainty.disturbance_nm,
        sup: trajectory::<N>(scenario)?.sup_norms(),
    })
}

/// The true start and the setpoint at t = 0.
///
/// # Errors
/// If the scenario describes no system.
pub fn start<const N: usize>(scenario: &Scenario) -> Result<LawInput<N>, SystemError> {
    let (state, setpoint) = (start_state::<N>(scenario), trajectory::<N>(scenario)?.at(0.0));
    Ok(input(&state, &setpoint))
}

/// State and setpoint as a law sees them.
#[must_use]
pub fn input<const N: usize>(state: &PlantState<N>, setpoint: &SetpointValue<N>) -> LawInput<N> {
    LawInput { q: state.q, v: state.v, q_d: setpoint.q_d, v_d: setpoint.v_d, a_d: setpoint.a_d }
}

/// The certificate of a law in a scenario; searches for remedies where it does not hold (milliseconds).
///
/// # Errors
/// If the scenario describes no system.
pub fn certification<const N: usize>(scenario: &Scenario, law: LawKind) -> Result<Certification, SystemError> {
    Ok(certify(law, &assumptions::<N>(scenario)?, &gains(scenario, law), Some(&start(scenario)?)))
}

/// The certificate alone.
///
/// # Errors
/// If the scenario describes no system.
pub fn certificate_of<const N: usize>(scenario: &Scenario, law: LawKind) -> Result<Certificate, SystemError> {
    let assumptions = assumptions::<N>(scenario)?;
    let start = StartError::of(&assumptions.nominal, &start(scenario)?);
    Ok(certificate(law, &assumptions.envelope(), &gains(scenario, law), Some(&start)))
}

/// A law with its model and the gains that its certificate gives it.
///
/// # Errors
/// If the scenario describes no system.
pub fn law<const N: usize>(scenario: &Scenario, kind: LawKind) -> Result<Law<N>, SystemError> {
    let certificate = certificate_of::<N>(scenario, kind)?;
    Ok(Law {
        kind,
        model: nominal_chain(scenario)?,
        beta: scenario.controller.gains.beta,
        k_t: certificate.k_t,
        k_p: scenario.controller.gains.kp,
        k_d: scenario.controller.gains.kd,
    })
}
