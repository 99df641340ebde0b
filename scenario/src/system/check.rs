//! The whole system of a scenario, built and tried before anything starts: what can't be run is found here, by its key.
//!
//! [`check`] refuses; [`remarks`] are for what can be run and is probably not what was meant.

use crate::controllers;
use crate::input::WAYPOINTS_BYTES_MAX;
use crate::{Nanos, ReferenceKind, Role, Scenario, ScenarioError, WrittenAt};
use loopbound_model::chain::Vector;
use loopbound_model::quote;
use loopbound_model::trajectory::{SetpointValue, Trajectory, Waypoints};
use loopbound_model::with_links;

/// Builds every part of the system that a scenario describes, and asks each for its first numbers.
///
/// # Errors
/// The first part that can't be built, or whose numbers are not finite, by the key that decides it.
pub fn check(scenario: &Scenario) -> Result<(), ScenarioError> {
    // The processes read the scenario with all defaults filled in.
    scenario.resolved().validate().map_err(followed)?;
    with_links!(scenario.links(), check_for::<N>(scenario))
}

/// Lines about what can be run and is probably not what was meant; none for an ordinary scenario.
///
/// # Errors
/// If the scenario describes no system.
pub fn remarks(scenario: &Scenario) -> Result<Vec<String>, ScenarioError> {
    let mut lines = with_links!(scenario.links(), remarks_on_waypoints::<N>(scenario))?;
    lines.extend(remarks_on_faults(scenario));
    Ok(lines)
}

/// An error of a value that nobody wrote.
fn followed(error: ScenarioError) -> ScenarioError {
    match error {
        ScenarioError::Value { place, key, found, allowed } => {
            ScenarioError::Value { place, key, found: format!("{found}, which follows from other keys"), allowed }
        }
        other => other,
    }
}

fn not_finite(key: &str, what: &str) -> ScenarioError {
    let message = format!("{what} is not a finite number, allowed: smaller numbers");
    ScenarioError::Type { place: WrittenAt::Nowhere, key: key.to_owned(), message }
}

fn check_for<const N: usize>(scenario: &Scenario) -> Result<(), ScenarioError> {
    let (truth, start) = (scenario.build_truth::<N>()?, scenario.build_start::<N>()?);
    let trajectory = scenario.build_trajectory::<N>()?;
    check_motion(scenario, &trajectory)?;
    let measured = truth.measure(&start.q, &start.v, 0);
    let acceleration = truth.chain.acceleration(&start.q, &start.v, &Vector::zeros());
    if !all_finite(&acceleration) || !all_finite(&measured.0) || !all_finite(&measured.1) {
        return Err(not_finite("plant", "the acceleration or the measurement at the start"));
    }
    let input = super::input(&start, &trajectory.at(0.0));
    for part in controllers::of(scenario) {
        let law = super::law::<N>(scenario, part.law)?;
        if !all_finite(&law.torque(&input)) {
            return Err(not_finite("controller.gains", &format!("the torque of {} at the start", part.law)));
        }
    }
    Ok(())
}

/// A motion is finite at all times if it is so at both ends of the time, its bounds are finite, and so is its phase.
fn check_motion<const N: usize>(scenario: &Scenario, trajectory: &Trajectory<N>) -> Result<(), ScenarioError> {
    let key = if scenario.reference.kind == ReferenceKind::Waypoints { "reference.file" } else { "reference" };
    let norms = trajectory.sup_norms();
    if ![norms.v_inf, norms.v_2, norms.a_2].iter().all(|norm| norm.is_finite()) {
        return Err(not_finite(key, "the largest velocity or acceleration of the motion"));
    }
    let end_ns = scenario.max_duration_ns().saturating_add(scenario.setpoint_lead_ns());
    let finite = |SetpointValue { q_d, v_d, a_d }: SetpointValue<N>| [q_d, v_d, a_d].iter().all(all_finite);
    for t_s in [0.0, Nanos(scenario.period_ns()).seconds(), Nanos(end_ns).seconds()] {
        if !finite(trajectory.at(t_s)) {
            return Err(not_finite(key, &format!("the setpoint at {} s", quote::number(t_s))));
        }
    }
    Ok(())
}

fn all_finite<const N: usize>(values: &Vector<N>) -> bool {
    values.iter().all(|value| value.is_finite())
}

/// Faults of processes that the scenario does not start; one of that number may still join a running group.
fn remarks_on_faults(scenario: &Scenario) -> Vec<String> {
    let controllers = controllers::of(scenario).iter().map(|part| part.id).max().unwrap_or(1);
    let without_target = scenario.fault.iter().enumerate().filter_map(|(index, fault)| {
        let target = fault.target?;
        let most = match target.role {
            Role::Controller => controllers,
            Role::Reference | Role::Plant => 1,
            Role::Monitor => return None,
        };
        let id = target.id.filter(|id| *id > most)?;
        let role = target.role;
        Some(format!("fault[{index}] is for {role} {id}, and the scenario starts no {role} beyond {most}: it may never be injected"))
    });
    without_target.collect()
}

fn remarks_on_waypoints<const N: usize>(scenario: &Scenario) -> Result<Vec<String>, ScenarioError> {
    let mut lines = Vec::new();
    let Some(file) = scenario.reference.file.as_ref().filter(|_| scenario.reference.kind == ReferenceKind::Waypoints)
    else {
        return Ok(lines);
    };
    let name = quote::path(file.path());
    if file.text(WAYPOINTS_BYTES_MAX).is_ok_and(|text| !Waypoints::<N>::has_names(&text)) {
        let joints = if N == 1 { "q1".to_owned() } else { format!("q1 … q{N}") };
        lines.push(format!("{name} names no columns: taken as t_s, {joints} in s and rad"));
    }
    if let Trajectory::Waypoints(waypoints) = scenario.build_trajectory::<N>()? {
        let ([from_s, to_s], end_s) = (waypoints.span_s(), scenario.loop_.duration.seconds());
        if from_s >= end_s || to_s <= 0.0 {
            let (from, to) = (quote::number(from_s), quote::number(to_s));
            let held = if from_s >= end_s { "first" } else { "last" };
            lines.push(format!(
                "{name}: its waypoints last from {from} s to {to} s, the run from 0 s to {end_s} s: the reference stands \
                 still at the {held} one (times count from the start of the run)"
            ));
        }
    }
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario(text: &str) -> Scenario {
        Scenario::from_toml(text, "my.toml").unwrap_or_else(|error| panic!("{error}"))
    }

    fn waypoints(text: &str) -> Scenario {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("w.csv");
        std::fs::write(&path, text).unwrap();
        let scenario = scenario(&format!("[reference]\nkind = 'waypoints'\nfile = '{}'", path.display()));
        scenario.reference.file.as_ref().unwrap().text(1000).unwrap();
        scenario
    }

    #[test]
    fn the_default_can_be_built_and_calls_for_no_remark() {
        check(&Scenario::default()).unwrap();
        assert_eq!(remarks(&Scenario::default()).unwrap(), Vec::<String>::new());
    }

    #[test]
    fn what_can_not_be_built_is_refused_by_its_key_and_place() {
        let file = waypoints("t_s,q1,q2,q3\n1,0,0,0\n0,0,0,0\n");
        let error = check(&file).unwrap_err().to_string();
        assert!(error.starts_with("`reference.file`: ") && error.contains("line 3: t_s is 0"), "{error}");
        let circle = scenario("[reference]\nkind = 'circle'\ncentre_m = [5, 0]\nradius_m = 0.2");
        assert!(check(&circle).unwrap_err().to_string().starts_with("`reference`: the circle"));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.toml");
        std::fs::write(&path, "[reference]\nkind = 'waypoints'\nfile = 'none.csv'\n").unwrap();
        let (read, origin) = Scenario::read::<&str>(Some(&path), &[]).unwrap();
        let error = origin.locate(check(&read).unwrap_err()).to_string();
        assert!(error.contains("s.toml:3:1: `reference.file`: ") && error.contains("none.csv: "), "{error}");
        let set = [format!("reference.file={}", folder.path().join("other.csv").display())];
        let (read, origin) = Scenario::read(Some(&path), &set).unwrap();
        let error = origin.locate(check(&read).unwrap_err()).to_string();
        assert!(error.starts_with("--set reference.file=") && error.contains("other.csv: "), "{error}");
    }

    #[test]
    fn waypoints_without_names_or_outside_the_run_get_a_line() {
        let lines = remarks(&waypoints("0,0,0,0\n1,0,0,0\n")).unwrap();
        assert!(lines.len() == 1 && lines[0].ends_with("taken as t_s, q1 … q3 in s and rad"), "{lines:?}");
        let epoch = remarks(&waypoints("t_s,q1,q2,q3\n1732630000,0,0,0\n1732630010,0,0,0\n")).unwrap();
        assert!(epoch.len() == 1 && epoch[0].contains("from 1732630000 s to 1732630010 s, the run from 0 s to 10 s"));
        assert!(epoch[0].contains("the first one"), "{epoch:?}");
        let past = remarks(&waypoints("t_s,q1,q2,q3\n-5,0,0,0\n0,0,0,0\n")).unwrap();
        assert!(past.len() == 1 && past[0].contains("the last one"), "{past:?}");
    }
}
