//! `loopbound bound`: the certificate of a scenario, without running it.
//!
//! Responsible for what is printed; the certificate is `shared`'s, what latency leaves of it is in [`mod@sampling`].

pub mod sampling;

use std::io::Write as _;

use clap::Args;
use loopbound_shared::bound::certificate::{Certificate, Certification};
use loopbound_shared::say;
use loopbound_shared::scenario::{Scenario, ScenarioError, parse_duration};
use loopbound_shared::system;
use loopbound_shared::with_links;
use serde_json::{Value, json};

use self::sampling::{Sampling, sampling};
use crate::cli::ScenarioArgs;
use crate::exit::{Exit, Failure};

/// `loopbound bound`.
#[derive(Debug, Args)]
pub struct BoundArgs {
    /// Whose certificate.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// From a sample to the action of its torque, such as 100us; default the scenario's actuation delay.
    #[arg(long, value_parser = parse_duration, value_name = "TIME")]
    pub latency: Option<u64>,
    /// Print one JSON document.
    #[arg(long)]
    pub json: bool,
}

/// Prints the certificate. Held if the scenario's law is certified, failed if not.
///
/// # Errors
/// If the scenario is refused or describes no system.
pub fn run(args: &BoundArgs) -> anyhow::Result<Exit> {
    let scenario = args.scenario.load_system(false)?;
    let latency_ns = args.latency.unwrap_or(scenario.plant.actuation_delay.ns());
    let latency_s = latency_ns as f64 * 1e-9;
    let (certification, sampling) =
        with_links!(scenario.links(), examine::<N>(&scenario, latency_s)).map_err(|e| Failure::usage(e.to_string()))?;
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", to_json(&scenario, &certification, &sampling))?;
    } else {
        let law = scenario.controller.law;
        write!(out, "{}{}", render(&scenario, &certification), sampling.render(law))?;
    }
    Ok(if certification.certificate.is_certified() { Exit::Held } else { Exit::Failed })
}

fn examine<const N: usize>(scenario: &Scenario, latency_s: f64) -> Result<(Certification, Sampling), ScenarioError> {
    let certification = system::certification::<N>(scenario, scenario.controller.law)?;
    let sampling = sampling::<N>(scenario, &certification.certificate, latency_s)?;
    Ok((certification, sampling))
}

/// Symbol, value, unit and meaning of every number that the law's certificate has.
fn rows(c: &Certificate) -> Vec<(&'static str, f64, &'static str, &'static str)> {
    let all = [
        ("beta", c.beta, "1/s", "of r = e' + beta e"),
        ("p", c.p, "N·m/rad", "weight of |e|² in V"),
        ("k2", c.k2, "N·m·s", "share of the gain that makes V fall"),
        ("k3", c.k3, "1/(N·m·rad/s)", "ε = 1/(4 K3)"),
        ("c1", c.c1, "N·m", "covers what does not vanish with the error"),
        ("c1_required", c.c1_required, "N·m", "what it must cover at least"),
        ("kappa", c.kappa, "N·m·s", "what the Coriolis and cross terms take"),
        ("k_t", c.k_t, "N·m·s", "total gain: K2 + κ + K3 C1²"),
        ("k_p", c.k_p, "", "gain of the law"),
        ("k_d", c.k_d, "", "gain of the law"),
        ("level", c.level, "", "c: certified where V ≤ c"),
        ("v_start", c.v_start, "", "V(0), an upper bound"),
        ("v_ultimate", c.v_ultimate(), "", "ε/α: where V settles at most"),
        ("alpha", c.alpha, "1/s", "rate at which V falls"),
        ("epsilon", c.epsilon, "1/s", "what V may rise by"),
        ("w_norm", c.w_norm, "", "radius of (e, r) outside which V falls"),
        ("ultimate_e_rad", c.ultimate_e, "rad", "ultimate bound of |e|"),
        ("ultimate_r_rad_s", c.ultimate_r, "rad/s", "ultimate bound of |r|"),
        ("lambda_lo", c.lambda_lo, "kg·m²", "least eigenvalue of M"),
        ("lambda_hi", c.lambda_hi, "kg·m²", "largest eigenvalue of M"),
        ("mu", c.mu, "", "mass mismatch covered"),
        ("disturbance_nm", c.disturbance_nm, "N·m", "disturbance covered"),
    ];
    // A number that the law's certificate does not have is exactly 0; μ, D and what is required may rightly be.
    let kept = ["mu", "disturbance_nm", "c1_required", "v_start"];
    all.into_iter().filter(|(key, value, ..)| value.abs() > 0.0 || value.is_nan() || kept.contains(key)).collect()
}

fn render(scenario: &Scenario, certification: &Certification) -> String {
    let law = scenario.controller.law;
    let mut text = if certification.certificate.is_certified() {
        format!("{law}: certified\n")
    } else {
        format!("{law}: NOT certified\n")
    };
    for failure in &certification.failures {
        text.push_str(&format!("  missing: {failure}\n"));
    }
    for remedy in &certification.remedies {
        text.push_str(&format!("  would do: {remedy}\n"));
    }
    for (key, value, unit, meaning) in rows(&certification.certificate) {
        text.push_str(&format!("  {key:<17}{value:>12.5}  {unit:<14}  {meaning}\n"));
    }
    text
}

fn to_json(scenario: &Scenario, certification: &Certification, sampling: &Sampling) -> Value {
    let numbers: serde_json::Map<String, Value> =
        rows(&certification.certificate).into_iter().map(|(key, value, ..)| (key.to_owned(), json!(value))).collect();
    json!({
        "law": scenario.controller.law.name(),
        "certified": certification.certificate.is_certified(),
        "missing": certification.failures.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "remedies": certification.remedies.iter().map(ToString::to_string).collect::<Vec<_>>(),
        "certificate": numbers,
        "sampling": sampling.to_json(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_shared::law::LawKind;

    #[test]
    fn the_papers_case_is_certified_and_a_small_c1_is_named_with_what_would_do() {
        let scenario = Scenario::default();
        let (good, sampling) = examine::<3>(&scenario, 0.0).unwrap();
        assert!(render(&scenario, &good).starts_with("robust: certified\n"));
        let json = to_json(&scenario, &good, &sampling);
        // K_t of the defaults as the documentation states it: 106.8.
        assert!((json["certificate"]["k_t"].as_f64().unwrap() - 106.8).abs() < 0.05, "{json}");
        let scenario = scenario.with_set("controller.gains.c1=10").unwrap();
        let text = render(&scenario, &examine::<3>(&scenario, 0.0).unwrap().0);
        assert!(text.contains("NOT certified") && text.contains("C1") && text.contains("would do"), "{text}");
    }

    #[test]
    fn the_latency_side_has_the_documented_room_age_and_hold_limit() {
        let (_, sampling) = examine::<3>(&Scenario::default(), 0.0).unwrap();
        let budget = sampling.budget.unwrap();
        // Figures of the documentation: d < 0.948 ms, h < 1.90 ms without delay.
        assert!(
            (budget.delay_margin_s - 0.948e-3).abs() < 5e-7 && (budget.period_max_s.unwrap() - 1.9e-3).abs() < 5e-6
        );
        assert!(sampling.radius < 1.0 && sampling.hold_ticks > 0);
        // 1 kHz is not proven beforehand.
        assert!(sampling.proven.is_some_and(|p| p.age_s < 1e-3), "{:?}", sampling.proven);
        assert!(sampling.render(LawKind::Robust).contains("left to the live check"));
    }

    #[test]
    fn a_latency_beyond_the_boundary_is_called_unstable_by_rule_and_radius_and_costs_the_smallest_w() {
        let scenario = Scenario::default();
        let (_, late) = examine::<3>(&scenario, 2e-3).unwrap();
        assert!(
            late.budget.unwrap().used > 1.0 && late.radius > 1.0 && late.render(LawKind::Robust).contains("UNSTABLE")
        );
        let w = |latency_s: f64| examine::<3>(&scenario, latency_s).unwrap().1.smallest_w.unwrap().w_norm;
        assert!(w(1e-4) < w(1e-3), "a lower latency allows a larger gain and so a smaller radius");
    }

    #[test]
    fn computed_torque_is_judged_by_its_spectral_radius_alone() {
        let scenario = Scenario::default().with_set("controller.law=ctc").unwrap();
        let (_, sampling) = examine::<3>(&scenario, 1e-3).unwrap();
        assert!(sampling.budget.is_none() && sampling.smallest_w.is_none() && sampling.radius < 1.0);
        assert!(sampling.to_json()["budget"].is_null() && sampling.radius_margin.seconds() > 1e-3);
    }
}
