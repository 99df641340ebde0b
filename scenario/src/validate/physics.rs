//! Limits of the plant, the controller and the reference.

use super::{TERMS_MAX, at_most, finite, not_negative, positive, refuse, require};
use crate::error::ScenarioError;
use crate::names::{DisturbanceKind, ReferenceKind};
use crate::physics::DisturbanceSpec;
use crate::reference::ReferenceSection;
use crate::values::PerLink;
use crate::{Nanos, Scenario};
use loopbound_model::chain::LINKS_MAX;
use loopbound_model::quote;

/// Checks one number of a list against its limits.
type Limit = fn(String, f64) -> Result<(), ScenarioError>;

pub(super) fn check(scenario: &Scenario) -> Result<(), ScenarioError> {
    let links = scenario.links();
    let key = if scenario.plant.links.is_some() { "plant.links" } else { "plant" };
    require(
        (1..=LINKS_MAX).contains(&links),
        key,
        format_args!("{links} links"),
        format_args!("1 to {LINKS_MAX} links"),
    )?;
    check_plant(scenario, links)?;
    check_controller(scenario, links)?;
    check_reference(&scenario.reference, links)
}

/// Checks the length and each value of a per-link key, if it is given.
fn per_link(key: &str, values: Option<&PerLink>, links: usize, limit: Limit) -> Result<(), ScenarioError> {
    let Some(values) = values else { return Ok(()) };
    if let Some(length) = values.len_if_list() {
        require(
            length == links,
            key,
            format_args!("{length} values"),
            format_args!("one number, or {links} (one a link)"),
        )?;
    }
    for (index, value) in values.written().iter().enumerate() {
        let place = if values.len_if_list().is_some() { format!("{key}[{index}]") } else { key.to_owned() };
        limit(place, *value)?;
    }
    Ok(())
}

fn check_plant(scenario: &Scenario, links: usize) -> Result<(), ScenarioError> {
    let plant = &scenario.plant;
    per_link("plant.mass", plant.mass.as_ref(), links, positive)?;
    per_link("plant.length", plant.length.as_ref(), links, positive)?;
    per_link("plant.inertia", plant.inertia.as_ref(), links, not_negative)?;
    finite("plant.gravity", plant.gravity)?;
    let by_links =
        plant.mass.is_some() || plant.length.is_some() || plant.inertia.is_some() || plant.mass_error.is_some();
    check_coefficients("plant", plant.a.as_deref(), plant.b.as_deref(), by_links, links)?;
    per_link("plant.mass_error", plant.mass_error.as_ref(), links, |key, s| {
        require(s > -1.0 && s <= 1e6, key, quote::number(s), "above -1 (the mass stays positive), at most 1e6")
    })?;
    per_link("plant.start_q_rad", plant.start_q_rad.as_ref(), links, finite)?;
    per_link("plant.start_v_rad_s", plant.start_v_rad_s.as_ref(), links, finite)?;
    per_link("plant.torque_limit_nm", plant.torque_limit_nm.as_ref(), links, |key, limit| {
        require(limit >= 1e-12, key, quote::number(limit), "a positive number, or inf")
    })?;
    require(plant.speed_limit > 0.0, "plant.speed_limit", plant.speed_limit, "a positive number, or inf")?;
    per_link("plant.friction.viscous_nm_s", Some(&plant.friction.viscous_nm_s), links, not_negative)?;
    per_link("plant.friction.coulomb_nm", Some(&plant.friction.coulomb_nm), links, not_negative)?;
    not_negative("plant.noise.q_rad", plant.noise.q_rad)?;
    not_negative("plant.noise.v_rad_s", plant.noise.v_rad_s)?;
    not_negative("plant.noise.quantum_q_rad", plant.noise.quantum_q_rad)?;
    not_negative("plant.noise.quantum_v_rad_s", plant.noise.quantum_v_rad_s)?;
    at_most("plant.disturbance", plant.disturbance.len(), TERMS_MAX)?;
    plant.disturbance.iter().enumerate().try_for_each(|(index, spec)| check_disturbance(index, spec, links))
}

/// Checks a chain given by its coefficients: a symmetric and positive definite, b as long.
fn check_coefficients(
    section: &str,
    a: Option<&[Vec<f64>]>,
    b: Option<&[f64]>,
    by_links: bool,
    links: usize,
) -> Result<(), ScenarioError> {
    let (a, b) = match (a, b) {
        (None, None) => return Ok(()),
        (Some(_), None) => return refuse(format_args!("{section}.b"), "nothing", "b together with a"),
        (None, Some(_)) => return refuse(format_args!("{section}.a"), "nothing", "a together with b"),
        (Some(a), Some(b)) => (a, b),
    };
    let key = format!("{section}.a");
    require(!by_links, &key, "a beside link parameters", "either a and b, or mass, length, inertia, mass_error")?;
    require(a.len() == links, &key, format_args!("{} rows", a.len()), format_args!("{links} rows"))?;
    for (i, row) in a.iter().enumerate() {
        let row_key = format!("{key}[{i}]");
        require(row.len() == links, &row_key, format_args!("{} values", row.len()), format_args!("{links} values"))?;
        for (j, value) in row.iter().enumerate() {
            finite(format_args!("{row_key}[{j}]"), *value)?;
            // Exactly symmetric: an almost symmetric matrix is a typing error.
            let mirrored = a.get(j).and_then(|other| other.get(i)).copied();
            let symmetric = mirrored.is_none_or(|other| other.to_bits() == value.to_bits());
            require(
                symmetric,
                format_args!("{row_key}[{j}]"),
                quote::number(*value),
                format_args!("a symmetric matrix: a[{j}][{i}]"),
            )?;
        }
    }
    require(is_positive_definite(a), &key, "a matrix that is not", "a positive definite matrix")?;
    require(
        b.len() == links,
        format_args!("{section}.b"),
        format_args!("{} values", b.len()),
        format_args!("{links} values"),
    )?;
    b.iter().enumerate().try_for_each(|(i, value)| finite(format_args!("{section}.b[{i}]"), *value))
}

/// Whether Cholesky's factorisation of a square matrix exists.
fn is_positive_definite(a: &[Vec<f64>]) -> bool {
    let n = a.len();
    let mut factor = vec![vec![0.0; n]; n];
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            let rest = a[i][j] - dot;
            if i == j {
                if rest.is_nan() || rest <= 0.0 {
                    return false;
                }
                factor[i][i] = rest.sqrt();
            } else {
                factor[i][j] = rest / factor[j][j];
            }
        }
    }
    true
}

/// Demands the keys of a kind and refuses those of the others.
pub(super) fn check_applicable(
    section: &str,
    kind: &str,
    required: &[&str],
    optional: &[&str],
    written: &[(&str, bool)],
) -> Result<(), ScenarioError> {
    for (key, given) in written {
        let (needed, possible) = (required.contains(key), required.contains(key) || optional.contains(key));
        let dotted = format!("{section}.{key}");
        require(*given || !needed, &dotted, "nothing", format_args!("a value, which kind \"{kind}\" needs"))?;
        let keys = required.iter().chain(optional).copied().collect::<Vec<_>>().join(", ");
        require(
            possible || !*given,
            &dotted,
            "a value",
            format_args!("none with kind \"{kind}\", whose keys are {keys}"),
        )?;
    }
    Ok(())
}

fn check_disturbance(index: usize, spec: &DisturbanceSpec, links: usize) -> Result<(), ScenarioError> {
    let section = format!("plant.disturbance[{index}]");
    let (required, optional): (&[&str], &[&str]) = match spec.kind {
        DisturbanceKind::Constant => (&["value_nm"], &[]),
        DisturbanceKind::Sine => (&["amplitude_nm", "omega_rad_s"], &["phase_rad"]),
        DisturbanceKind::Step => (&["value_nm", "at"], &[]),
        DisturbanceKind::Noise => (&["rms_nm", "low_hz", "high_hz"], &[]),
    };
    let written = [
        ("value_nm", spec.value_nm.is_some()),
        ("amplitude_nm", spec.amplitude_nm.is_some()),
        ("omega_rad_s", spec.omega_rad_s.is_some()),
        ("phase_rad", spec.phase_rad.is_some()),
        ("at", spec.at.is_some()),
        ("rms_nm", spec.rms_nm.is_some()),
        ("low_hz", spec.low_hz.is_some()),
        ("high_hz", spec.high_hz.is_some()),
    ];
    check_applicable(&section, spec.kind.name(), required, optional, &written)?;
    let vectors: [(&str, &Option<PerLink>, Limit); 5] = [
        ("value_nm", &spec.value_nm, finite),
        ("amplitude_nm", &spec.amplitude_nm, finite),
        ("omega_rad_s", &spec.omega_rad_s, finite),
        ("phase_rad", &spec.phase_rad, finite),
        ("rms_nm", &spec.rms_nm, not_negative),
    ];
    for (key, values, limit) in vectors {
        per_link(&format!("{section}.{key}"), values.as_ref(), links, limit)?;
    }
    if let (Some(low), Some(high)) = (spec.low_hz, spec.high_hz) {
        not_negative(format_args!("{section}.low_hz"), low)?;
        let above = high > low && high.is_finite();
        let allowed = format_args!("above low_hz, {}", quote::number(low)).to_string();
        require(above, format_args!("{section}.high_hz"), quote::number(high), allowed)?;
        finite(format_args!("{section}.high_hz"), high)?;
    }
    Ok(())
}

fn check_controller(scenario: &Scenario, links: usize) -> Result<(), ScenarioError> {
    let gains = &scenario.controller.gains;
    positive("controller.gains.beta", gains.beta)?;
    positive("controller.gains.k2", gains.k2)?;
    positive("controller.gains.k3", gains.k3)?;
    gains.c1.map_or(Ok(()), |c1| positive("controller.gains.c1", c1))?;
    positive("controller.gains.level", gains.level)?;
    positive("controller.gains.kp", gains.kp)?;
    positive("controller.gains.kd", gains.kd)?;
    gains.k_t.map_or(Ok(()), |k_t| positive("controller.gains.k_t", k_t))?;
    gains.analyst_beta.map_or(Ok(()), |beta| positive("controller.gains.analyst_beta", beta))?;
    let model = &scenario.controller.model;
    per_link("controller.model.mass", model.mass.as_ref(), links, positive)?;
    per_link("controller.model.length", model.length.as_ref(), links, positive)?;
    per_link("controller.model.inertia", model.inertia.as_ref(), links, not_negative)?;
    model.gravity.map_or(Ok(()), |gravity| finite("controller.model.gravity", gravity))?;
    let by_links = model.mass.is_some() || model.length.is_some() || model.inertia.is_some();
    check_coefficients("controller.model", model.a.as_deref(), model.b.as_deref(), by_links, links)?;
    let uncertainty = &scenario.controller.uncertainty;
    let mu = uncertainty.mass;
    require((0.0..1.0).contains(&mu), "controller.uncertainty.mass", quote::number(mu), "0 to below 1")?;
    not_negative("controller.uncertainty.disturbance_nm", uncertainty.disturbance_nm)
}

fn check_reference(section: &ReferenceSection, links: usize) -> Result<(), ScenarioError> {
    let (required, optional): (&[&str], &[&str]) = match section.kind {
        ReferenceKind::Sine => (&[], &["amplitude_rad", "omega_rad_s"]),
        ReferenceKind::MultiSine => (&["term"], &["offset_rad"]),
        ReferenceKind::Quintic => (&["to_rad", "duration"], &["from_rad", "at"]),
        ReferenceKind::Chirp => (&["omega_end_rad_s", "duration"], &["amplitude_rad", "omega_start_rad_s"]),
        ReferenceKind::Circle => (&["centre_m", "radius_m"], &["omega_rad_s", "phase_rad", "elbow_positive"]),
        ReferenceKind::Waypoints => (&["file"], &[]),
    };
    let written = [
        ("amplitude_rad", section.amplitude_rad.is_some()),
        ("omega_rad_s", section.omega_rad_s.is_some()),
        ("term", !section.term.is_empty()),
        ("offset_rad", section.offset_rad.is_some()),
        ("from_rad", section.from_rad.is_some()),
        ("to_rad", section.to_rad.is_some()),
        ("at", section.at.is_some()),
        ("duration", section.duration.is_some()),
        ("omega_start_rad_s", section.omega_start_rad_s.is_some()),
        ("omega_end_rad_s", section.omega_end_rad_s.is_some()),
        ("centre_m", section.centre_m.is_some()),
        ("radius_m", section.radius_m.is_some()),
        ("phase_rad", section.phase_rad.is_some()),
        ("elbow_positive", section.elbow_positive.is_some()),
        ("file", section.file.is_some()),
    ];
    check_applicable("reference", section.kind.name(), required, optional, &written)?;
    check_reference_values(section, links)
}

fn check_reference_values(section: &ReferenceSection, links: usize) -> Result<(), ScenarioError> {
    let vectors = [
        ("reference.amplitude_rad", &section.amplitude_rad),
        ("reference.omega_rad_s", &section.omega_rad_s),
        ("reference.offset_rad", &section.offset_rad),
        ("reference.from_rad", &section.from_rad),
        ("reference.to_rad", &section.to_rad),
    ];
    for (key, values) in vectors {
        per_link(key, values.as_ref(), links, finite)?;
    }
    at_most("reference.term", section.term.len(), TERMS_MAX)?;
    for (index, term) in section.term.iter().enumerate() {
        let values = [
            ("amplitude_rad", &term.amplitude_rad),
            ("omega_rad_s", &term.omega_rad_s),
            ("phase_rad", &term.phase_rad),
        ];
        for (key, values) in values {
            per_link(&format!("reference.term[{index}].{key}"), Some(values), links, finite)?;
        }
    }
    if let Some(duration) = section.duration {
        require(duration > Nanos(0), "reference.duration", duration, "above zero")?;
    }
    section.omega_start_rad_s.map_or(Ok(()), |omega| finite("reference.omega_start_rad_s", omega))?;
    section.omega_end_rad_s.map_or(Ok(()), |omega| finite("reference.omega_end_rad_s", omega))?;
    section.phase_rad.map_or(Ok(()), |phase| finite("reference.phase_rad", phase))?;
    section.radius_m.map_or(Ok(()), |radius| positive("reference.radius_m", radius))?;
    if section.kind == ReferenceKind::Circle {
        let one = section.omega_rad_s.as_ref().and_then(PerLink::len_if_list);
        require(one.is_none(), "reference.omega_rad_s", "a list", "one number: there is one tip")?;
    }
    let centre = section.centre_m.unwrap_or_default();
    centre.iter().enumerate().try_for_each(|(axis, value)| finite(format_args!("reference.centre_m[{axis}]"), *value))
}
