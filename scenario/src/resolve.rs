//! The scenario with every default written out, as it is stored beside a run.

use super::names::ReferenceKind;
use super::units::Nanos;
use super::values::PerLink;
use super::{ChainSpec, FaultSpec, ModelSection, PlantSection, ReferenceSection, Scenario};

impl Scenario {
    /// The same scenario with all derived defaults in place.
    ///
    /// Three kinds of key stay absent, since their absence is a statement of its own: gains that the certificate derives
    /// (`c1`, `k_t`, `analyst_beta`), the window of a fault, and the choice between `law`, `exe` and `to`.
    #[must_use]
    pub fn resolved(&self) -> Self {
        let mut full = self.clone();
        let time = &mut full.loop_;
        time.grace = Some(Nanos(self.loop_.grace_ns()));
        time.lead = Some(Nanos(self.loop_.lead_ns()));
        time.phase = Some(Nanos(self.loop_.phase_ns()));
        time.late = Some(Nanos(self.loop_.late_ns()));
        time.settle = Some(Nanos(self.loop_.settle_ns()));
        resolve_plant(&mut full.plant, &self.plant, self.plant_without_error());
        full.controller.model = model_keys(self.model_chain(), &self.controller.model);
        full.reference = resolved_reference(self);
        full.expect.max_duration = Some(Nanos(self.max_duration_ns()));
        for swap in &mut full.swap {
            swap.blend = Some(swap.blend.unwrap_or(self.swap_gate.blend));
        }
        full.fault.iter_mut().for_each(resolve_fault);
        full
    }

    /// The plant's chain as its keys have it, before `plant.mass_error`.
    fn plant_without_error(&self) -> ChainSpec {
        let mut nominal = self.clone();
        nominal.plant.mass_error = None;
        nominal.plant_chain()
    }
}

/// The chain as keys of a model; gravity stays absent beside coefficients, unless it was written.
fn model_keys(chain: ChainSpec, written: &ModelSection) -> ModelSection {
    match chain {
        ChainSpec::Coefficients { a, b } => {
            ModelSection { a: Some(a), b: Some(b), gravity: written.gravity, ..ModelSection::default() }
        }
        ChainSpec::Links { mass_kg, length_m, inertia_kg_m2, gravity_m_s2 } => ModelSection {
            mass: Some(PerLink::Each(mass_kg)),
            length: Some(PerLink::Each(length_m)),
            inertia: Some(PerLink::Each(inertia_kg_m2)),
            gravity: Some(gravity_m_s2),
            a: None,
            b: None,
        },
    }
}

fn resolve_plant(full: &mut PlantSection, written: &PlantSection, chain: ChainSpec) {
    let links = written.links();
    full.links = Some(links);
    if let ChainSpec::Links { mass_kg, length_m, inertia_kg_m2, .. } = chain {
        full.mass = Some(PerLink::Each(mass_kg));
        full.length = Some(PerLink::Each(length_m));
        full.inertia = Some(PerLink::Each(inertia_kg_m2));
        full.mass_error = Some(PerLink::Each(written.mass_error()));
    }
    full.start_q_rad = Some(PerLink::Each(written.start_q_rad()));
    full.start_v_rad_s = Some(PerLink::Each(written.start_v_rad_s()));
    full.torque_limit_nm = Some(PerLink::Each(written.torque_limit_nm()));
    full.friction.viscous_nm_s = PerLink::Each(written.viscous_nm_s());
    full.friction.coulomb_nm = PerLink::Each(written.coulomb_nm());
}

fn resolved_reference(scenario: &Scenario) -> ReferenceSection {
    let links = scenario.links();
    let mut full = scenario.reference.clone();
    full.lead = Some(Nanos(scenario.setpoint_lead_ns()));
    let fill = |values: &mut Option<PerLink>, default: f64| {
        let each = values.as_ref().map_or_else(|| vec![default; links], |values| values.to_vec(links));
        *values = Some(PerLink::Each(each));
    };
    match full.kind {
        ReferenceKind::Sine => {
            fill(&mut full.amplitude_rad, 1.0);
            fill(&mut full.omega_rad_s, 0.1);
        }
        ReferenceKind::Quintic => {
            fill(&mut full.from_rad, 0.0);
            full.at = Some(full.at.unwrap_or_default());
        }
        ReferenceKind::Chirp => {
            fill(&mut full.amplitude_rad, 1.0);
            full.omega_start_rad_s = Some(full.omega_start_rad_s.unwrap_or(0.1));
        }
        ReferenceKind::Circle => {
            full.omega_rad_s = Some(full.omega_rad_s.unwrap_or(PerLink::All(0.1)));
            full.phase_rad = Some(full.phase_rad.unwrap_or(0.0));
            full.elbow_positive = Some(full.elbow_positive.unwrap_or(true));
        }
        ReferenceKind::MultiSine => fill(&mut full.offset_rad, 0.0),
        ReferenceKind::Waypoints => {}
    }
    full
}

fn resolve_fault(fault: &mut FaultSpec) {
    use super::names::{Distribution, FaultKind};
    fault.target = Some(fault.target());
    fault.seed = Some(fault.seed.unwrap_or(1));
    if fault.kind == FaultKind::Delay {
        let distribution = fault.distribution.unwrap_or(Distribution::Constant);
        fault.distribution = Some(distribution);
        if distribution == Distribution::Pareto {
            fault.shape = Some(fault.shape.unwrap_or(super::PARETO_SHAPE_DEFAULT));
        }
    }
    if fault.kind == FaultKind::Glitch {
        fault.joint = Some(fault.joint.unwrap_or(1));
    }
}
