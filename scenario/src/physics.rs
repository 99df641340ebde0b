//! The sections of a scenario about what is controlled and by what: the plant, the controller's gains and its model.

use super::names::DisturbanceKind;
use super::units::Nanos;
use super::values::PerLink;
use loopbound_model::law::LawKind;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The paper's start, off a reference that begins at zero (rad); longer chains repeat it.
const START_Q_RAD: [f64; 3] = [0.3, -0.2, 0.25];

/// Speed of a joint (rad/s) at which no robot arm is meant to be: 16 turns a second. The joints of the shipped scenarios and of
/// the studies' sound loops stay below 3 rad/s, and a loop that is lost passes it within milliseconds.
const SPEED_LIMIT_RAD_S: f64 = 100.0;

/// `[plant]`: the true chain, its start, and what is not ideal about it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct PlantSection {
    /// Number of links; default the length of the first list given, else 3.
    pub links: Option<usize>,
    /// Link masses as the drawings have them (kg); default 1.
    pub mass: Option<PerLink>,
    /// Link lengths (m); default 1.
    pub length: Option<PerLink>,
    /// Inertias about the centres of mass (kg·m²); default m l²/12, a uniform rod.
    pub inertia: Option<PerLink>,
    /// Gravity (m/s²).
    pub gravity: f64,
    /// Rows of a_ij (kg·m²), instead of masses and lengths.
    pub a: Option<Vec<Vec<f64>>>,
    /// b_i (N·m), together with `a`.
    pub b: Option<Vec<f64>>,
    /// Relative error s of the masses and, in proportion, the inertias: the true mass is `mass`·(1 + s), while the
    /// controller's model keeps `mass`; default 0.
    pub mass_error: Option<PerLink>,
    /// Angles at the start (rad).
    pub start_q_rad: Option<PerLink>,
    /// Velocities at the start (rad/s); default 0.
    pub start_v_rad_s: Option<PerLink>,
    /// Largest torque of each link (N·m); default no limit.
    pub torque_limit_nm: Option<PerLink>,
    /// Speed of a joint (rad/s) above which the plant stops for good and the run has diverged; infinite: none.
    pub speed_limit: f64,
    /// From the acceptance of a torque to its action.
    pub actuation_delay: Nanos,
    /// Friction.
    pub friction: FrictionSection,
    /// Imperfect measurement.
    pub noise: NoiseSection,
    /// Disturbance torques, added up.
    pub disturbance: Vec<DisturbanceSpec>,
    /// Seed of noise and disturbances.
    pub seed: u64,
}

impl Default for PlantSection {
    fn default() -> Self {
        Self {
            links: None,
            mass: None,
            length: None,
            inertia: None,
            gravity: 9.81,
            a: None,
            b: None,
            mass_error: None,
            start_q_rad: None,
            start_v_rad_s: None,
            torque_limit_nm: None,
            speed_limit: SPEED_LIMIT_RAD_S,
            actuation_delay: Nanos(0),
            friction: FrictionSection::default(),
            noise: NoiseSection::default(),
            disturbance: Vec::new(),
            seed: 1,
        }
    }
}

impl PlantSection {
    /// Number of links: as given, else as long as the first list, else 3.
    #[must_use]
    pub fn links(&self) -> usize {
        let lists = [&self.mass, &self.length, &self.inertia, &self.start_q_rad, &self.mass_error];
        let first_list = lists.into_iter().flatten().find_map(PerLink::len_if_list);
        let coefficients = self.a.as_ref().map(Vec::len).or(self.b.as_ref().map(Vec::len));
        self.links.or(coefficients).or(first_list).unwrap_or(3)
    }

    /// Angles at the start (rad), one a link.
    #[must_use]
    pub fn start_q_rad(&self) -> Vec<f64> {
        let default = || START_Q_RAD.iter().copied().cycle().take(self.links()).collect();
        self.start_q_rad.as_ref().map_or_else(default, |q| q.to_vec(self.links()))
    }

    /// Velocities at the start (rad/s), one a link.
    #[must_use]
    pub fn start_v_rad_s(&self) -> Vec<f64> {
        self.per_link(self.start_v_rad_s.as_ref(), 0.0)
    }

    /// Largest torques (N·m), one a link, infinite where there is no limit.
    #[must_use]
    pub fn torque_limit_nm(&self) -> Vec<f64> {
        self.per_link(self.torque_limit_nm.as_ref(), f64::INFINITY)
    }

    /// Viscous friction (N·m·s), one a link.
    #[must_use]
    pub fn viscous_nm_s(&self) -> Vec<f64> {
        self.friction.viscous_nm_s.to_vec(self.links())
    }

    /// Coulomb friction (N·m), one a link.
    #[must_use]
    pub fn coulomb_nm(&self) -> Vec<f64> {
        self.friction.coulomb_nm.to_vec(self.links())
    }

    /// The relative mass errors, one a link.
    #[must_use]
    pub fn mass_error(&self) -> Vec<f64> {
        self.per_link(self.mass_error.as_ref(), 0.0)
    }

    fn per_link(&self, values: Option<&PerLink>, default: f64) -> Vec<f64> {
        values.map_or_else(|| vec![default; self.links()], |values| values.to_vec(self.links()))
    }
}

/// `[plant.friction]`, one value a link.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct FrictionSection {
    /// Proportional to the velocity (N·m·s).
    pub viscous_nm_s: PerLink,
    /// Against the direction of motion (N·m).
    pub coulomb_nm: PerLink,
}

impl Default for FrictionSection {
    fn default() -> Self {
        Self { viscous_nm_s: PerLink::All(0.0), coulomb_nm: PerLink::All(0.0) }
    }
}

/// `[plant.noise]`: standard deviations and resolutions of the measurement; zero is perfect.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct NoiseSection {
    /// Standard deviation of angles (rad).
    pub q_rad: f64,
    /// Standard deviation of velocities (rad/s).
    pub v_rad_s: f64,
    /// Resolution of angles (rad).
    pub quantum_q_rad: f64,
    /// Resolution of velocities (rad/s).
    pub quantum_v_rad_s: f64,
}

/// `[[plant.disturbance]]`: one torque that acts on the links beside the controller's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table")]
pub struct DisturbanceSpec {
    /// Its shape.
    pub kind: DisturbanceKind,
    /// Size of a constant or a step (N·m).
    #[serde(default)]
    pub value_nm: Option<PerLink>,
    /// Amplitude of a sine (N·m).
    #[serde(default)]
    pub amplitude_nm: Option<PerLink>,
    /// Angular frequency of a sine (rad/s).
    #[serde(default)]
    pub omega_rad_s: Option<PerLink>,
    /// Phase of a sine (rad); default 0.
    #[serde(default)]
    pub phase_rad: Option<PerLink>,
    /// Beginning of a step.
    #[serde(default)]
    pub at: Option<Nanos>,
    /// Root mean square of noise (N·m).
    #[serde(default)]
    pub rms_nm: Option<PerLink>,
    /// Lower edge of the band of noise (Hz).
    #[serde(default)]
    pub low_hz: Option<f64>,
    /// Upper edge of the band of noise (Hz).
    #[serde(default)]
    pub high_hz: Option<f64>,
}

/// One disturbance torque with every value in place, one a link.
#[derive(Clone, Debug, PartialEq)]
pub enum DisturbanceTerm {
    /// The same at all times.
    Constant {
        /// N·m.
        value_nm: Vec<f64>,
    },
    /// amplitude · sin(omega t + phase).
    Sine {
        /// N·m.
        amplitude_nm: Vec<f64>,
        /// rad/s.
        omega_rad_s: Vec<f64>,
        /// rad.
        phase_rad: Vec<f64>,
    },
    /// `value_nm` from `at_s` on.
    Step {
        /// s.
        at_s: f64,
        /// N·m.
        value_nm: Vec<f64>,
    },
    /// Band-limited noise.
    Noise {
        /// N·m.
        rms_nm: Vec<f64>,
        /// Hz.
        low_hz: f64,
        /// Hz.
        high_hz: f64,
    },
}

impl DisturbanceSpec {
    /// The typed form for a chain of `links`; values that the kind does not have are ignored.
    #[must_use]
    pub fn term(&self, links: usize) -> DisturbanceTerm {
        let vector = |values: &Option<PerLink>| values.as_ref().map_or_else(|| vec![0.0; links], |v| v.to_vec(links));
        match self.kind {
            DisturbanceKind::Constant => DisturbanceTerm::Constant { value_nm: vector(&self.value_nm) },
            DisturbanceKind::Sine => DisturbanceTerm::Sine {
                amplitude_nm: vector(&self.amplitude_nm),
                omega_rad_s: vector(&self.omega_rad_s),
                phase_rad: vector(&self.phase_rad),
            },
            DisturbanceKind::Step => {
                DisturbanceTerm::Step { at_s: self.at.unwrap_or_default().seconds(), value_nm: vector(&self.value_nm) }
            }
            DisturbanceKind::Noise => DisturbanceTerm::Noise {
                rms_nm: vector(&self.rms_nm),
                low_hz: self.low_hz.unwrap_or(0.0),
                high_hz: self.high_hz.unwrap_or(0.0),
            },
        }
    }
}

/// `[controller]`: who computes the torque, with which gains and which beliefs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct ControllerSection {
    /// The law in charge at the start.
    #[serde(deserialize_with = "super::names::law")]
    pub law: LawKind,
    /// A user's own controller instead, started as `EXE --group G --id N --scenario FILE`.
    pub exe: Option<PathBuf>,
    /// Number of standbys.
    pub standby: u32,
    /// Gains of all laws.
    pub gains: GainsSection,
    /// The nominal chain.
    pub model: ModelSection,
    /// What the certificate must allow for.
    pub uncertainty: UncertaintySection,
}

impl Default for ControllerSection {
    fn default() -> Self {
        Self {
            law: LawKind::Robust,
            exe: None,
            standby: 0,
            gains: GainsSection::default(),
            model: ModelSection::default(),
            uncertainty: UncertaintySection::default(),
        }
    }
}

/// `[controller.gains]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct GainsSection {
    /// β (1/s), of r = ė + β e.
    pub beta: f64,
    /// K2 (N·m·s).
    pub k2: f64,
    /// K3 (1/(N·m·s⁻¹)), of the robust term.
    pub k3: f64,
    /// C1 (N·m), the bound of the uncertainty; default 40 for `robust`, and what the certificate requires for the
    /// other laws, which know more of the plant.
    pub c1: Option<f64>,
    /// c, the certified level of V.
    pub level: f64,
    /// K_p of `ctc` (1/s²) and `pd+g` (N·m).
    pub kp: f64,
    /// K_d of `ctc` (1/s) and `pd+g` (N·m·s).
    pub kd: f64,
    /// The total gain K_t (N·m·s) given directly; default K2 + κ + K3 C1².
    pub k_t: Option<f64>,
    /// β (1/s) of the analysis of `pd+g`; default found by search.
    pub analyst_beta: Option<f64>,
    /// Whether `robust-ff` takes the V of `robust`, so that their cross-fades are certified.
    pub shared_v: bool,
}

impl Default for GainsSection {
    fn default() -> Self {
        Self {
            beta: 5.0,
            k2: 10.0,
            k3: 0.04,
            c1: None,
            level: 6.0,
            kp: 25.0,
            kd: 10.0,
            k_t: None,
            analyst_beta: None,
            shared_v: false,
        }
    }
}

/// `[controller.model]`: the chain that the controller believes in; each key defaults to the plant's, without its
/// `mass_error`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct ModelSection {
    /// Link masses (kg).
    pub mass: Option<PerLink>,
    /// Link lengths (m).
    pub length: Option<PerLink>,
    /// Inertias (kg·m²).
    pub inertia: Option<PerLink>,
    /// Gravity (m/s²).
    pub gravity: Option<f64>,
    /// Rows of a_ij (kg·m²), instead of masses and lengths.
    pub a: Option<Vec<Vec<f64>>>,
    /// b_i (N·m), together with `a`.
    pub b: Option<Vec<f64>>,
}

/// `[controller.uncertainty]`: the declared bounds that the certificate allows for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, expecting = "a table")]
pub struct UncertaintySection {
    /// μ: largest relative error of a mass, 0 to below 1.
    pub mass: f64,
    /// D: largest norm of the disturbance (N·m).
    pub disturbance_nm: f64,
}

/// A chain by its links or by its coefficients, every value in place.
#[derive(Clone, Debug, PartialEq)]
pub enum ChainSpec {
    /// Masses, lengths, inertias and gravity, one a link.
    Links {
        /// kg.
        mass_kg: Vec<f64>,
        /// m.
        length_m: Vec<f64>,
        /// kg·m².
        inertia_kg_m2: Vec<f64>,
        /// m/s².
        gravity_m_s2: f64,
    },
    /// The coefficients of the equations of motion.
    Coefficients {
        /// Rows of a_ij (kg·m²).
        a: Vec<Vec<f64>>,
        /// b_i (N·m).
        b: Vec<f64>,
    },
}
