//! From the keys of a scenario to the mathematics they describe, for a chain of N links known at compile time.

use super::error::{ScenarioError, WrittenAt};
use super::{ChainSpec, DisturbanceTerm, Motion, Scenario};
use crate::input::WAYPOINTS_BYTES_MAX;
use loopbound_model::chain::{Chain, LinkParameters, Matrix, Vector};
use loopbound_model::integrator::PlantState;
use loopbound_model::quote;
use loopbound_model::trajectory::{Circle, CircleParameters, SineTerm, Trajectory, Waypoints};
use loopbound_model::truth::{BandNoise, Disturbance, Truth};
use std::fmt::Display;

/// A refusal by the mathematics itself, under the section that it concerns.
fn refused(key: &str, message: impl Display) -> ScenarioError {
    ScenarioError::Type { place: WrittenAt::Nowhere, key: key.to_owned(), message: message.to_string() }
}

/// One value a link.
fn array<const N: usize>(key: &str, values: &[f64]) -> Result<[f64; N], ScenarioError> {
    values.try_into().map_err(|_| refused(key, format_args!("found {} values, allowed: {N}", values.len())))
}

impl ChainSpec {
    /// The chain; `key` is the section that a refusal names.
    fn build<const N: usize>(&self, key: &str) -> Result<Chain<N>, ScenarioError> {
        let chain = match self {
            Self::Links { mass_kg, length_m, inertia_kg_m2, gravity_m_s2 } => Chain::from_links(&LinkParameters {
                mass_kg: array(key, mass_kg)?,
                length_m: array(key, length_m)?,
                inertia_kg_m2: Some(array(key, inertia_kg_m2)?),
                gravity_m_s2: *gravity_m_s2,
            }),
            Self::Coefficients { a, b } => {
                let rows = a.iter().map(|row| array::<N>(key, row)).collect::<Result<Vec<_>, _>>()?;
                let rows: [[f64; N]; N] =
                    rows.try_into().map_err(|_| refused(key, "a has the wrong number of rows"))?;
                Chain::from_coefficients(Matrix::from_fn(|i, j| rows[i][j]), Vector::from(array(key, b)?))
            }
        };
        chain.map_err(|error| refused(key, error))
    }
}

impl Scenario {
    /// The nominal chain, that of the controller.
    ///
    /// # Errors
    /// A chain that is none, or a number of links other than `N`.
    pub fn build_model<const N: usize>(&self) -> Result<Chain<N>, ScenarioError> {
        self.model_chain().build("controller.model")
    }

    /// The true plant: the chain with its mass errors, friction, disturbance, measurement and limits.
    ///
    /// # Errors
    /// A plant that is none, or a number of links other than `N`.
    pub fn build_truth<const N: usize>(&self) -> Result<Truth<N>, ScenarioError> {
        let plant = &self.plant;
        let truth = Truth {
            chain: self.plant_chain().build("plant")?,
            viscous_nm_s: array("plant.friction.viscous_nm_s", &plant.viscous_nm_s())?,
            coulomb_nm: array("plant.friction.coulomb_nm", &plant.coulomb_nm())?,
            disturbance: self.build_disturbance()?,
            noise_q_rad: plant.noise.q_rad,
            noise_v_rad_s: plant.noise.v_rad_s,
            quant_q_rad: plant.noise.quantum_q_rad,
            quant_v_rad_s: plant.noise.quantum_v_rad_s,
            torque_limit_nm: array("plant.torque_limit_nm", &plant.torque_limit_nm())?,
            seed: plant.seed,
        };
        truth.validate().map_err(|error| refused("plant", error))?;
        Ok(truth)
    }

    /// The state at the start.
    ///
    /// # Errors
    /// A number of links other than `N`.
    pub fn build_start<const N: usize>(&self) -> Result<PlantState<N>, ScenarioError> {
        Ok(PlantState {
            q: Vector::from(array("plant.start_q_rad", &self.plant.start_q_rad())?),
            v: Vector::from(array("plant.start_v_rad_s", &self.plant.start_v_rad_s())?),
        })
    }

    /// The sum of all disturbances; each noise is told apart by its place in the list.
    fn build_disturbance<const N: usize>(&self) -> Result<Disturbance<N>, ScenarioError> {
        let mut parts = Vec::with_capacity(self.plant.disturbance.len());
        for (index, spec) in (0_u64..).zip(&self.plant.disturbance) {
            let key = format!("plant.disturbance[{index}]");
            parts.push(match spec.term(self.links()) {
                DisturbanceTerm::Constant { value_nm } => Disturbance::Constant { value_nm: array(&key, &value_nm)? },
                DisturbanceTerm::Sine { amplitude_nm, omega_rad_s, phase_rad } => Disturbance::Sine {
                    amplitude_nm: array(&key, &amplitude_nm)?,
                    omega_rad_s: array(&key, &omega_rad_s)?,
                    phase_rad: array(&key, &phase_rad)?,
                },
                DisturbanceTerm::Step { at_s, value_nm } => {
                    Disturbance::Step { at_s, value_nm: array(&key, &value_nm)? }
                }
                DisturbanceTerm::Noise { rms_nm, low_hz, high_hz } => {
                    let noise = BandNoise::with_rms(array(&key, &rms_nm)?, low_hz, high_hz, self.plant.seed, index);
                    Disturbance::Noise(noise.map_err(|error| refused(&key, error))?)
                }
            });
        }
        Ok(match parts.len() {
            0 => Disturbance::None,
            _ => Disturbance::Sum(parts),
        })
    }

    /// The reference motion; reads the file of waypoints, if that is what it is.
    ///
    /// # Errors
    /// A motion that the links cannot follow, an unreadable or malformed file, or a number of links other than `N`.
    pub fn build_trajectory<const N: usize>(&self) -> Result<Trajectory<N>, ScenarioError> {
        let key = "reference";
        let trajectory = match self.motion() {
            Motion::Sine { amplitude_rad, omega_rad_s } => {
                Trajectory::Sine { amplitude_rad: array(key, &amplitude_rad)?, omega_rad_s: array(key, &omega_rad_s)? }
            }
            Motion::MultiSine { offset_rad, terms } => {
                let mut of_link: [Vec<SineTerm>; N] = std::array::from_fn(|_| Vec::new());
                for (amplitude, omega, phase) in &terms {
                    let values: [[f64; N]; 3] = [array(key, amplitude)?, array(key, omega)?, array(key, phase)?];
                    for (link, list) in of_link.iter_mut().enumerate() {
                        let [amplitude_rad, omega_rad_s, phase_rad] = values.map(|value| value[link]);
                        list.push(SineTerm { amplitude_rad, omega_rad_s, phase_rad });
                    }
                }
                Trajectory::MultiSine { offset_rad: array(key, &offset_rad)?, terms: of_link }
            }
            Motion::Quintic { from_rad, to_rad, at_s, duration_s } => Trajectory::Quintic {
                from_rad: array(key, &from_rad)?,
                to_rad: array(key, &to_rad)?,
                start_s: at_s,
                duration_s,
            },
            Motion::Chirp { amplitude_rad, omega_start_rad_s, omega_end_rad_s, duration_s } => Trajectory::Chirp {
                amplitude_rad: array(key, &amplitude_rad)?,
                omega_from_rad_s: omega_start_rad_s,
                omega_to_rad_s: omega_end_rad_s,
                duration_s,
            },
            Motion::Circle { centre_m, radius_m, omega_rad_s, phase_rad, elbow_positive } => {
                let length_m = self.circle_lengths()?;
                let parameters =
                    CircleParameters { length_m, centre_m, radius_m, omega_rad_s, phase_rad, elbow_positive };
                Trajectory::Circle(Circle::new(parameters).map_err(|error| refused(key, error))?)
            }
            Motion::Waypoints { file } => {
                let name = quote::path(file.path());
                let text = file
                    .text(WAYPOINTS_BYTES_MAX)
                    .map_err(|error| refused("reference.file", format_args!("{name}: {error}")))?;
                let waypoints =
                    Waypoints::from_csv_text(&text, &name).map_err(|error| refused("reference.file", error))?;
                Trajectory::Waypoints(waypoints)
            }
        };
        trajectory.validate().map_err(|error| refused(key, error))?;
        Ok(trajectory)
    }

    /// The lengths with which a circle is planned: those of the nominal chain.
    fn circle_lengths<const N: usize>(&self) -> Result<[f64; N], ScenarioError> {
        match self.model_chain() {
            ChainSpec::Links { length_m, .. } => array("reference", &length_m),
            ChainSpec::Coefficients { .. } => {
                Err(refused("reference.kind", "found circle, allowed: any other kind beside a chain without lengths"))
            }
        }
    }
}
