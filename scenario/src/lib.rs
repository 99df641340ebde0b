//! The scenario: everything that decides a run, as one TOML file with defaults.
//!
//! Responsible for the keys, their units and limits, and for messages that name the place, the key, what was found and
//! what is allowed, and for the parts of the mathematics that a scenario describes ([`system`]). Not responsible for what the
//! processes do with them. The default scenario is the paper's case. Nothing here may ever know a clock, the transport, or which
//! process it runs in.

pub mod controllers;
pub mod input;
pub mod key;
pub mod system;

mod annotated;
mod build;
mod error;
mod expect;
mod keys;
mod load;
mod named_file;
mod names;
mod notes;
mod physics;
mod reference;
mod resolve;
mod schema;
mod sections;
mod units;
mod validate;
mod values;

pub use error::{ScenarioError, WrittenAt};
pub use expect::{Budget, Comparator, ExpectSection, Expectation, parse_condition};
pub use load::Source;
pub use named_file::NamedFile;
pub use names::{Distribution, DisturbanceKind, FaultKind, Mode, ReferenceKind, Restart, Role, Wakeup};
pub use physics::{
    ChainSpec, ControllerSection, DisturbanceSpec, DisturbanceTerm, FrictionSection, GainsSection, ModelSection,
    NoiseSection, PlantSection, UncertaintySection,
};
pub use reference::{Motion, ReferenceSection, ReferenceTerm};
pub use sections::{
    FaultSpec, LoopSection, MonitorSection, RealtimeSection, SupervisorSection, SwapGateSection, SwapSpec,
};
pub use units::{
    Hertz, Nanos, UnitError, format_duration, format_rate, parse_duration, parse_rate, parse_signed_duration,
};
pub use values::{Cores, PerLink, SignedNanos, Target, When};

pub use validate::check_group_name;

use key::{key, section};

/// Exponent of heavy-tailed delays where none is given: a finite mean, an infinite variance.
pub const PARETO_SHAPE_DEFAULT: f64 = 1.5;

/// The copy of the waypoints in the folder of a group or of a run, beside its scenario.
pub const WAYPOINTS_FILE: &str = "waypoints.csv";
/// Members of a group: controllers, with their standbys and those of scheduled swaps.
pub const CONTROLLERS_MAX: usize = 8;
/// Ticks that setpoints may be published ahead: their readers keep 2048.
pub const SETPOINTS_AHEAD_MAX: u64 = 2000;
/// Ticks of torques under way in the actuation's delay.
pub const ACTUATION_TICKS_MAX: u32 = 2048;
/// Ticks that the rule of misses after a swap may look at.
pub const ROLLBACK_WINDOW_MAX: u32 = 1024;
/// Ticks, and time (ns), between two looks of a monitor: it has room for 2048 records.
pub const POLL_TICKS_MAX: u64 = 1000;
/// See [`POLL_TICKS_MAX`].
pub const POLL_NS_MAX: u64 = 1_000_000_000;
/// Ticks kept on either side of a change of the active controller.
pub const TRACE_TICKS_MAX: u32 = 65_536;
/// Scheduled swaps, all of which the plant is told before it starts.
const SWAPS_MAX: usize = 64;
/// Injected faults, which every process looks through every tick.
const FAULTS_MAX: usize = 1000;

section! {
    /// Everything that decides a run. Every key has a default; together they are the paper's case.
    #[serde(default, deny_unknown_fields, expecting = "a table")]
    pub struct Scenario {
        /// The time grid.
        #[serde(rename = "loop")]
        loop_: LoopSection = LoopSection::default() => key();
        /// The true chain.
        plant: PlantSection = PlantSection::default() => key();
        /// The controllers.
        controller: ControllerSection = ControllerSection::default() => key();
        /// The motion to be followed.
        reference: ReferenceSection = ReferenceSection::default() => key();
        /// What is asked of the kernel.
        realtime: RealtimeSection = RealtimeSection::default() => key();
        /// What the supervisor does about processes that died.
        supervisor: SupervisorSection = SupervisorSection::default() => key();
        /// What a new controller must show.
        swap_gate: SwapGateSection = SwapGateSection::default() => key();
        /// How the group is watched.
        monitor: MonitorSection = MonitorSection::default() => key();
        /// Scheduled swaps.
        swap: Vec<SwapSpec> = Vec::new() => key().at_most(SWAPS_MAX);
        /// Injected faults.
        fault: Vec<FaultSpec> = Vec::new() => key().at_most(FAULTS_MAX);
        /// What the run must show.
        expect: ExpectSection = ExpectSection::default() => key();
    }
}

impl Scenario {
    /// Number of links, 1 to 7 in a valid scenario.
    #[must_use]
    pub fn links(&self) -> usize {
        self.plant.links()
    }

    /// The period h (ns).
    #[must_use]
    pub fn period_ns(&self) -> u64 {
        self.loop_.period_ns()
    }

    /// The chain that the plant integrates, `plant.mass_error` included.
    #[must_use]
    pub fn plant_chain(&self) -> ChainSpec {
        self.chain(&ModelSection::default(), &self.plant.mass_error())
    }

    /// The nominal chain that the controller believes in, without `plant.mass_error`.
    #[must_use]
    pub fn model_chain(&self) -> ChainSpec {
        self.chain(&self.controller.model, &vec![0.0; self.links()])
    }

    /// The plant's chain with the keys of `model` in place of its own, and its masses off by `mass_error`.
    fn chain(&self, model: &ModelSection, mass_error: &[f64]) -> ChainSpec {
        let (links, plant) = (self.links(), &self.plant);
        let own_links = model.mass.is_some() || model.length.is_some() || model.inertia.is_some();
        if let (Some(a), Some(b)) = (model.a.as_ref().or(plant.a.as_ref()), model.b.as_ref().or(plant.b.as_ref()))
            && !own_links
        {
            return ChainSpec::Coefficients { a: a.clone(), b: b.clone() };
        }
        let values = |own: &Option<PerLink>, plants: &Option<PerLink>| {
            own.as_ref().or(plants.as_ref()).map_or_else(|| vec![1.0; links], |values| values.to_vec(links))
        };
        let mass = values(&model.mass, &plant.mass);
        let length_m = values(&model.length, &plant.length);
        let rod = || mass.iter().zip(&length_m).map(|(m, l)| m * l * l / 12.0).collect();
        let inertia: Vec<f64> =
            model.inertia.as_ref().or(plant.inertia.as_ref()).map_or_else(rod, |values| values.to_vec(links));
        let off = |values: &[f64]| values.iter().zip(mass_error).map(|(value, s)| value * (1.0 + s)).collect();
        ChainSpec::Links {
            mass_kg: off(&mass),
            inertia_kg_m2: off(&inertia),
            length_m,
            gravity_m_s2: model.gravity.unwrap_or(plant.gravity),
        }
    }

    /// The same scenario with its waypoints in [`WAYPOINTS_FILE`] beside it, where a group and a recording keep their copy.
    #[must_use]
    pub fn with_own_waypoints(&self) -> Self {
        let mut own = self.clone();
        own.reference.file = own.reference.file.map(|file| file.at(WAYPOINTS_FILE.into()));
        own
    }

    /// How far ahead of the present setpoints are published (ns).
    #[must_use]
    pub fn setpoint_lead_ns(&self) -> u64 {
        self.reference.lead_ns(self.period_ns())
    }

    /// The longest that an undecided run may be prolonged to (ns); default three times its duration.
    #[must_use]
    pub fn max_duration_ns(&self) -> u64 {
        let default = self.loop_.duration.ns().saturating_mul(3);
        self.expect.max_duration.map_or(default, Nanos::ns).max(self.loop_.duration.ns())
    }

    /// Whether a run goes on beyond its duration while its expectations are undecided.
    #[must_use]
    pub fn may_be_prolonged(&self) -> bool {
        self.loop_.mode == Mode::Realtime && !self.expect.conditions.is_empty()
    }

    /// The first tick that is not run, however often the run is prolonged.
    #[must_use]
    pub fn end_tick_at_most(&self) -> u64 {
        let longest = if self.may_be_prolonged() { self.max_duration_ns() / self.period_ns() } else { 0 };
        self.loop_.ticks().max(longest)
    }
}

#[cfg(test)]
mod tests;
