//! The sections of a scenario about what is controlled and by what: the plant, the controller's gains and its model.

use super::key::{FINITE, Limit, NOT_NEGATIVE, POSITIVE, POSITIVE_OR_INF, key, section};
use super::names::DisturbanceKind;
use super::units::Nanos;
use super::values::PerLink;
use loopbound_model::law::LawKind;
use std::path::PathBuf;

/// The paper's start, off a reference that begins at zero (rad); longer chains repeat it.
const START_Q_RAD: [f64; 3] = [0.3, -0.2, 0.25];

/// Speed of a joint (rad/s) at which no robot arm is meant to be: 16 turns a second. The joints of the shipped scenarios and of
/// the studies' sound loops stay below 3 rad/s, and a loop that is lost passes it within milliseconds.
const SPEED_LIMIT_RAD_S: f64 = 100.0;

/// Torques of disturbance, which are added up every tick.
const DISTURBANCES_MAX: usize = 100;

const MASS_ERROR: Limit =
    Limit::range(-1.0, 1e6, "above -1 (the mass stays positive), at most 1e6").without_least().brief("above -1");
/// As many as the wire has publishers for, less the active controller and one that comes in by a swap.
const STANDBYS: Limit = Limit::range(0.0, 6.0, "0 to 6");
const BELOW_ONE: Limit = Limit::range(0.0, 1.0, "0 to below 1").without_most();

/// The matrix and the vector of a chain as examples.
const EXAMPLE_A: &str = "[[2.3333, 1.5, 0.5], [1.5, 1.3333, 0.5], [0.5, 0.5, 0.3333]]";
const EXAMPLE_B: &str = "[24.525, 14.715, 4.905]";

section! {
    /// The chain as it really is: give either `a` and `b`, or masses, lengths and inertias.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct PlantSection {
        /// Number of links, 1 to 7.
        links: Option<usize> = None, resolved |s, _| Some(s.links())
            => key().otherwise("the length of the first list given, else 3");
        /// Link masses, as the drawings have them.
        mass: Option<PerLink> = None, resolved |s, _| s.plant_without_error().mass()
            => key().unit("kg").within(POSITIVE).otherwise("`1`");
        /// Link lengths.
        length: Option<PerLink> = None, resolved |s, _| s.plant_without_error().length()
            => key().unit("m").within(POSITIVE).otherwise("`1`");
        /// Inertias about the centres of mass. The default is a uniform rod.
        inertia: Option<PerLink> = None, resolved |s, _| s.plant_without_error().inertia()
            => key().unit("kg·m²").within(NOT_NEGATIVE).otherwise("m l²/12");
        /// Gravity.
        gravity: f64 = 9.81 => key().unit("m/s²").within(FINITE);
        /// Coefficients a_ij, symmetric and positive definite; with `b`.
        a: Option<Vec<Vec<f64>>> = None
            => key().unit("kg·m²").within(FINITE).otherwise("from mass, length, inertia").example(EXAMPLE_A);
        /// Coefficients b_i; with `a`.
        b: Option<Vec<f64>> = None
            => key().unit("N·m").within(FINITE).otherwise("from mass, length, gravity").example(EXAMPLE_B);
        /// Relative error s of masses and inertias. The true masses are mass (1 + s), while the model of the controller keeps mass.
        mass_error: Option<PerLink> = None, resolved |s, own| own.a.is_none().then(|| PerLink::Each(s.plant.mass_error()))
            => key().within(MASS_ERROR).otherwise("`0`");
        /// Angles at the start. Longer chains repeat the default.
        start_q_rad: Option<PerLink> = None, resolved |s, _| Some(PerLink::Each(s.plant.start_q_rad()))
            => key().unit("rad").within(FINITE).otherwise("`[0.3, -0.2, 0.25]`");
        /// Velocities at the start.
        start_v_rad_s: Option<PerLink> = None, resolved |s, _| Some(PerLink::Each(s.plant.start_v_rad_s()))
            => key().unit("rad/s").within(FINITE).otherwise("`0`");
        /// Largest torque of each link.
        torque_limit_nm: Option<PerLink> = None, resolved |s, _| Some(PerLink::Each(s.plant.torque_limit_nm()))
            => key().unit("N·m").within(POSITIVE_OR_INF).otherwise("`inf`");
        /// Speed of a joint beyond which the run has diverged and the plant stops for good. The speed of a joint is the difference of its
        /// links' speeds; a state that is not finite is beyond it, too. The default is 16 turns a second; the joints of the shipped
        /// scenarios stay below 3 rad/s.
        speed_limit: f64 = SPEED_LIMIT_RAD_S => key().unit("rad/s").within(POSITIVE_OR_INF);
        /// Time from the acceptance of a torque to its action. At most 2048 periods.
        actuation_delay: Nanos = Nanos(0) => key();
        /// Friction.
        friction: FrictionSection = FrictionSection::default() => key();
        /// Imperfect measurement.
        noise: NoiseSection = NoiseSection::default() => key();
        /// Disturbance torques, added up.
        disturbance: Vec<DisturbanceSpec> = Vec::new() => key().at_most(DISTURBANCES_MAX);
        /// Seed of noise and disturbances.
        seed: u64 = 1 => key();
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

section! {
    /// Friction in the joints.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct FrictionSection {
        /// Proportional to the velocity.
        viscous_nm_s: PerLink = PerLink::All(0.0), resolved |s, _| PerLink::Each(s.plant.viscous_nm_s())
            => key().unit("N·m·s").within(NOT_NEGATIVE);
        /// Against the direction of motion.
        coulomb_nm: PerLink = PerLink::All(0.0), resolved |s, _| PerLink::Each(s.plant.coulomb_nm())
            => key().unit("N·m").within(NOT_NEGATIVE);
    }
}

section! {
    /// Noise of the measurement; zero is perfect.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct NoiseSection {
        /// Standard deviation of angles.
        q_rad: f64 = 0.0 => key().unit("rad").within(NOT_NEGATIVE);
        /// Standard deviation of velocities.
        v_rad_s: f64 = 0.0 => key().unit("rad/s").within(NOT_NEGATIVE);
        /// Resolution of angles.
        quantum_q_rad: f64 = 0.0 => key().unit("rad").within(NOT_NEGATIVE);
        /// Resolution of velocities.
        quantum_v_rad_s: f64 = 0.0 => key().unit("rad/s").within(NOT_NEGATIVE);
    }
}

section! {
    /// A torque that acts in addition to the controller's; any number of them add up.
    #[serde(deny_unknown_fields, expecting = "a table")]
    pub struct DisturbanceSpec {
        /// Its shape.
        kind: DisturbanceKind => key().needed().example("\"sine\"");
        /// Torque of a constant, or of a step from `at` on.
        value_nm: Option<PerLink> => key().unit("N·m").needed_by(&["constant", "step"]).within(FINITE).example("[1, 0, 0]");
        /// Amplitude.
        amplitude_nm: Option<PerLink> => key().unit("N·m").needed_by(&["sine"]).within(FINITE).example("2");
        /// Angular frequency.
        omega_rad_s: Option<PerLink> => key().unit("rad/s").needed_by(&["sine"]).within(FINITE).example("[3, 2, 5]");
        /// Phase.
        phase_rad: Option<PerLink> => key().unit("rad").of(&["sine"]).within(FINITE).otherwise("`0`").example("0");
        /// When it begins.
        at: Option<Nanos> => key().needed_by(&["step"]).example("\"2s\"");
        /// Root mean square, within the band.
        rms_nm: Option<PerLink> => key().unit("N·m").needed_by(&["noise"]).within(NOT_NEGATIVE).example("0.5");
        /// Lower end of the band.
        low_hz: Option<f64> => key().unit("Hz").needed_by(&["noise"]).within(NOT_NEGATIVE).example("0.5");
        /// Upper end of the band, above the lower.
        high_hz: Option<f64> => key().unit("Hz").needed_by(&["noise"]).within(FINITE).example("20");
    }
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

section! {
    /// The controllers, with their gains and their model.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct ControllerSection {
        /// The law of the active controller at the start.
        #[serde(deserialize_with = "super::names::law")]
        law: LawKind = LawKind::Robust => key();
        /// Your own controller, started as `EXE --group G --id N --scenario FILE --parent PID`. A script may start it, and has to wait for it;
        /// everything else that the script starts ends with the run. See [swap.md](swap.md#your-own-controller).
        exe: Option<PathBuf> = None => key().otherwise("none").example("\"path\"");
        /// Standbys: controllers that compute along and take over within the same tick.
        standby: u32 = 0 => key().within(STANDBYS);
        /// Gains of all laws.
        gains: GainsSection = GainsSection::default() => key();
        /// The nominal chain.
        model: ModelSection = ModelSection::default() => key();
        /// What the certificate must allow for.
        uncertainty: UncertaintySection = UncertaintySection::default() => key();
    }
}

section! {
    /// The gains of all laws.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct GainsSection {
        /// β, of r = ė + β e.
        beta: f64 = 5.0 => key().unit("1/s").within(POSITIVE);
        /// K2.
        k2: f64 = 10.0 => key().unit("N·m·s").within(POSITIVE);
        /// K3, of the robust term.
        k3: f64 = 0.04 => key().unit("1/(N·m·s⁻¹)").within(POSITIVE);
        /// C1, the uncertainty bound.
        c1: Option<f64> = None
            => key().unit("N·m").within(POSITIVE).otherwise("40 for `robust`, what is required for the others").example("40.0");
        /// c, the certified level: the certificate holds where V ≤ c.
        level: f64 = 6.0 => key().within(POSITIVE);
        /// K_p of ctc (1/s²) and pd+g (N·m).
        kp: f64 = 25.0 => key().within(POSITIVE);
        /// K_d of ctc (1/s) and pd+g (N·m·s).
        kd: f64 = 10.0 => key().within(POSITIVE);
        /// The total gain K_t, given directly.
        k_t: Option<f64> = None
            => key().unit("N·m·s").within(POSITIVE).otherwise("K2 + κ + K3 C1²").example("106.8");
        /// β in the analysis of pd+g.
        analyst_beta: Option<f64> = None
            => key().unit("1/s").within(POSITIVE).otherwise("found by search").example("0.6");
        /// Whether robust-ff uses the V of robust, so that cross-fades between them are certified.
        shared_v: bool = false => key();
    }
}

section! {
    /// The controller's model of the chain; each key defaults to the plant's, without `mass_error`.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct ModelSection {
        /// Link masses.
        mass: Option<PerLink> = None, resolved |s, _| s.model_chain().mass()
            => key().unit("kg").within(POSITIVE).otherwise("the plant's");
        /// Link lengths.
        length: Option<PerLink> = None, resolved |s, _| s.model_chain().length()
            => key().unit("m").within(POSITIVE).otherwise("the plant's");
        /// Inertias about the centres of mass.
        inertia: Option<PerLink> = None, resolved |s, _| s.model_chain().inertia()
            => key().unit("kg·m²").within(NOT_NEGATIVE).otherwise("the plant's");
        /// Gravity.
        gravity: Option<f64> = None, resolved |s, own| s.model_chain().gravity().or(own.gravity)
            => key().unit("m/s²").within(FINITE).otherwise("the plant's");
        /// Coefficients a_ij, instead of masses and lengths.
        a: Option<Vec<Vec<f64>>> = None, resolved |s, _| s.model_chain().coefficients().map(|(a, _)| a)
            => key().unit("kg·m²").within(FINITE).otherwise("the plant's").example(EXAMPLE_A);
        /// Coefficients b_i; with `a`.
        b: Option<Vec<f64>> = None, resolved |s, _| s.model_chain().coefficients().map(|(_, b)| b)
            => key().unit("N·m").within(FINITE).otherwise("the plant's").example(EXAMPLE_B);
    }
}

section! {
    /// What the certificate covers.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct UncertaintySection {
        /// μ: largest relative error of a mass.
        mass: f64 = 0.0 => key().within(BELOW_ONE);
        /// D: largest norm of the disturbance.
        disturbance_nm: f64 = 0.0 => key().unit("N·m").within(NOT_NEGATIVE);
    }
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

impl ChainSpec {
    /// The masses as the keys have them; none beside coefficients.
    fn mass(self) -> Option<PerLink> {
        if let Self::Links { mass_kg, .. } = self { Some(PerLink::Each(mass_kg)) } else { None }
    }

    /// The lengths, likewise.
    fn length(self) -> Option<PerLink> {
        if let Self::Links { length_m, .. } = self { Some(PerLink::Each(length_m)) } else { None }
    }

    /// The inertias, likewise.
    fn inertia(self) -> Option<PerLink> {
        if let Self::Links { inertia_kg_m2, .. } = self { Some(PerLink::Each(inertia_kg_m2)) } else { None }
    }

    /// Gravity, likewise.
    fn gravity(self) -> Option<f64> {
        if let Self::Links { gravity_m_s2, .. } = self { Some(gravity_m_s2) } else { None }
    }

    /// The coefficients a and b; none beside masses and lengths.
    fn coefficients(self) -> Option<(Vec<Vec<f64>>, Vec<f64>)> {
        if let Self::Coefficients { a, b } = self { Some((a, b)) } else { None }
    }
}
