//! What the keys of the plant, the controller's model and the reference must agree on.

use super::{refuse, require};
use crate::Scenario;
use crate::error::ScenarioError;
use crate::names::ReferenceKind;
use crate::values::PerLink;
use loopbound_model::quote;

pub(super) fn check(scenario: &Scenario) -> Result<(), ScenarioError> {
    let (links, plant, model) = (scenario.links(), &scenario.plant, &scenario.controller.model);
    let of_plant = [&plant.mass, &plant.length, &plant.inertia, &plant.mass_error];
    check_coefficients("plant", plant.a.as_deref(), plant.b.as_deref(), &of_plant, links)?;
    let of_model = [&model.mass, &model.length, &model.inertia];
    check_coefficients("controller.model", model.a.as_deref(), model.b.as_deref(), &of_model, links)?;
    check_gravity(scenario)?;
    for (index, spec) in plant.disturbance.iter().enumerate() {
        if let (Some(low), Some(high)) = (spec.low_hz, spec.high_hz) {
            let allowed = format_args!("above low_hz, {}", quote::number(low)).to_string();
            require(high > low, format_args!("plant.disturbance[{index}].high_hz"), quote::number(high), allowed)?;
        }
    }
    let reference = &scenario.reference;
    let list = reference.omega_rad_s.as_ref().and_then(PerLink::len_if_list);
    let one_tip = reference.kind != ReferenceKind::Circle || list.is_none();
    require(one_tip, "reference.omega_rad_s", "a list", "one number: there is one tip")
}

/// Coefficients hold the weight of the links already: gravity beside them would change nothing.
fn check_gravity(scenario: &Scenario) -> Result<(), ScenarioError> {
    let (plant, model) = (&scenario.plant, &scenario.controller.model);
    let allowed = "no gravity beside a and b, which hold the weight already";
    let standard = crate::PlantSection::default().gravity;
    let same = plant.gravity.to_bits() == standard.to_bits();
    require(plant.b.is_none() || same, "plant.gravity", quote::number(plant.gravity), allowed)?;
    let of_coefficients = matches!(scenario.model_chain(), crate::ChainSpec::Coefficients { .. });
    let found = model.gravity.map_or_else(String::new, quote::number);
    require(!of_coefficients || model.gravity.is_none(), "controller.model.gravity", found, allowed)
}

/// Checks a chain given by its coefficients: a symmetric and positive definite, b as long.
fn check_coefficients(
    section: &str,
    a: Option<&[Vec<f64>]>,
    b: Option<&[f64]>,
    of_links: &[&Option<PerLink>],
    links: usize,
) -> Result<(), ScenarioError> {
    let (a, b) = match (a, b) {
        (None, None) => return Ok(()),
        (Some(_), None) => return refuse(format_args!("{section}.b"), "nothing", "b together with a"),
        (None, Some(_)) => return refuse(format_args!("{section}.a"), "nothing", "a together with b"),
        (Some(a), Some(b)) => (a, b),
    };
    let key = format!("{section}.a");
    require(
        of_links.iter().all(|key| key.is_none()),
        &key,
        "a beside link parameters",
        "either a and b, or mass, length, inertia, mass_error",
    )?;
    require(a.len() == links, &key, format_args!("{} rows", a.len()), format_args!("{links} rows"))?;
    for (i, row) in a.iter().enumerate() {
        let row_key = format!("{key}[{i}]");
        require(row.len() == links, &row_key, format_args!("{} values", row.len()), format_args!("{links} values"))?;
        for (j, value) in row.iter().enumerate() {
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
    let found = format_args!("{} values", b.len()).to_string();
    require(b.len() == links, format_args!("{section}.b"), found, format_args!("{links} values"))
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
