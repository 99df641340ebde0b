//! `loopbound bound`: the certificate of a scenario, without running it.
//!
//! Responsible for what is printed; the certificate is `shared`'s, what latency leaves of it is in [`mod@sampling`].

pub mod sampling;

use std::io::Write as _;

use clap::Args;
use loopbound_model::bound::certificate::{Certificate, Certification};
use loopbound_model::bound::coverage::Gap;
use loopbound_model::law::LawKind;
use loopbound_model::quote;
use loopbound_model::with_links;
use loopbound_scenario::system;
use loopbound_scenario::{Scenario, ScenarioError, parse_duration};
use loopbound_shared::say;
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

/// Prints the certificate. Held if the scenario's law is certified, its loop is stable at its rate and latency, and its
/// plant is within what the controller declares; failed if not.
///
/// # Errors
/// If the scenario is refused or describes no system.
pub fn run(args: &BoundArgs) -> anyhow::Result<Exit> {
    let scenario = args.scenario.load_system(false)?;
    let latency_ns = args.latency.unwrap_or(scenario.plant.actuation_delay.ns());
    let latency_s = latency_ns as f64 * 1e-9;
    let answer =
        with_links!(scenario.links(), examine::<N>(&scenario, latency_s)).map_err(|e| Failure::usage(e.to_string()))?;
    let mut out = say::stdout();
    if args.json {
        writeln!(out, "{}", answer.to_json())?;
    } else {
        write!(out, "{}", answer.render())?;
    }
    Ok(if answer.holds() { Exit::Held } else { Exit::Failed })
}

/// All that there is to say of a scenario's law, without running it.
#[derive(Clone, Debug)]
struct Answer {
    law: LawKind,
    rate_hz: f64,
    certification: Certification,
    sampling: Sampling,
    /// What of the plant lies outside of what the controller declares.
    gaps: Vec<Gap>,
}

fn examine<const N: usize>(scenario: &Scenario, latency_s: f64) -> Result<Answer, ScenarioError> {
    let law = scenario.controller.law;
    let certification = system::certification::<N>(scenario, law)?;
    let sampling = sampling::<N>(scenario, &certification.certificate, latency_s)?;
    let gaps = system::gaps::<N>(scenario, law)?;
    Ok(Answer { law, rate_hz: scenario.loop_.rate.0, certification, sampling, gaps })
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

impl Answer {
    fn is_certified(&self) -> bool {
        self.certification.certificate.is_certified()
    }

    /// Whether what is certified is true of this plant in this loop.
    fn holds(&self) -> bool {
        self.is_certified() && self.sampling.is_stable() && self.gaps.is_empty()
    }

    /// The first line: everything that decides the exit code.
    fn headline(&self) -> String {
        let mut line = format!("{}: ", self.law);
        line.push_str(match (self.is_certified(), self.sampling.is_stable()) {
            (false, _) => "NOT certified",
            (true, true) => "certified",
            (true, false) => "certified in continuous time",
        });
        if !self.sampling.is_stable() {
            line.push_str(&format!(", UNSTABLE at {} Hz", quote::number(self.rate_hz)));
            if self.sampling.latency_s > 0.0 {
                line.push_str(&format!(" with torques {:.4} ms late", self.sampling.latency_s * 1e3));
            }
        }
        if !self.gaps.is_empty() {
            line.push_str(", and the plant is OUTSIDE of what the controller declares");
        }
        line
    }

    /// For people.
    fn render(&self) -> String {
        let mut text = format!("{}\n", self.headline());
        for gap in &self.gaps {
            text.push_str(&format!("  outside: {gap}\n"));
        }
        for failure in &self.certification.failures {
            text.push_str(&format!("  missing: {failure}\n"));
        }
        for remedy in &self.certification.remedies {
            text.push_str(&format!("  would do: {remedy}\n"));
        }
        for (key, value, unit, meaning) in rows(&self.certification.certificate) {
            text.push_str(&format!("  {key:<17}{value:>12.5}  {unit:<14}  {meaning}\n"));
        }
        text.push_str(&self.sampling.render(self.law));
        text
    }

    /// For programs.
    fn to_json(&self) -> Value {
        let certification = &self.certification;
        let numbers: serde_json::Map<String, Value> = rows(&certification.certificate)
            .into_iter()
            .map(|(key, value, ..)| (key.to_owned(), json!(value)))
            .collect();
        json!({
            "law": self.law.name(),
            "headline": self.headline(),
            "holds": self.holds(),
            "certified": self.is_certified(),
            "stable": self.sampling.is_stable(),
            "within_declared": self.gaps.is_empty(),
            "outside": self.gaps.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "missing": certification.failures.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "remedies": certification.remedies.iter().map(ToString::to_string).collect::<Vec<_>>(),
            "certificate": numbers,
            "sampling": self.sampling.to_json(),
        })
    }
}

#[cfg(test)]
mod tests;
