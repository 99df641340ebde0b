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
use loopbound_scenario::system::advice::{self, Remedy};
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
        with_links!(scenario.links(), advise::<N>(&scenario, latency_s)).map_err(|e| Failure::usage(e.to_string()))?;
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
    /// Settings that would make everything hold; none where it does.
    remedies: Vec<Remedy>,
    /// Where everything holds: gains that prove a smaller |e| at this period and latency.
    better: Option<Remedy>,
}

fn examine<const N: usize>(scenario: &Scenario, latency_s: f64) -> Result<Answer, ScenarioError> {
    let law = scenario.controller.law;
    let certification = system::certification::<N>(scenario, law)?;
    let sampling = sampling::<N>(scenario, &certification.certificate, latency_s)?;
    let gaps = system::gaps::<N>(scenario, law)?;
    let rate_hz = scenario.loop_.rate.0;
    Ok(Answer { law, rate_hz, certification, sampling, gaps, remedies: Vec::new(), better: None })
}

/// The answer with what would do, or would do better.
fn advise<const N: usize>(scenario: &Scenario, latency_s: f64) -> Result<Answer, ScenarioError> {
    let mut answer = examine::<N>(scenario, latency_s)?;
    if answer.holds() {
        let proven_rad = answer.certification.certificate.ultimate_e;
        let best = advice::best_gains::<N>(scenario, answer.sampling.period_s, latency_s, advice::ROOM)?;
        answer.better = best.filter(|best| best.certificate.ultimate_e < proven_rad);
    } else {
        answer.remedies = advice::remedies::<N>(scenario, latency_s)?;
    }
    Ok(answer)
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
        ("w_norm", c.w_norm, "", "radius of (e, r) outside which V falls; depends on the unit of time"),
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
        for remedy in &self.remedies {
            text.push_str(&format!("  would do: {}\n", advised(remedy)));
        }
        if self.remedies.is_empty() && !self.holds() {
            text.push_str("  no single change and no gains of the grid were found that would do\n");
        }
        for (key, value, unit, meaning) in rows(&self.certification.certificate) {
            text.push_str(&format!("  {key:<17}{value:>12.5}  {unit:<14}  {meaning}\n"));
        }
        text.push_str(&self.sampling.render());
        if let Some(better) = &self.better {
            let room = advice::ROOM * 100.0;
            text.push_str(&format!("  smallest proven |e| with {room:.0} % of the room: {}\n", advised(better)));
        }
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
            "remedies": self.remedies.iter().map(remedy_to_json).collect::<Vec<_>>(),
            "better": self.better.as_ref().map(remedy_to_json),
            "certificate": numbers,
            "sampling": self.sampling.to_json(),
        })
    }
}

/// A remedy as it is typed, with what it gives.
fn advised(remedy: &Remedy) -> String {
    let set: Vec<String> = remedy.settings.iter().map(|setting| format!("--set {setting}")).collect();
    let Certificate { ultimate_e, k_t, .. } = remedy.certificate;
    let mut text = format!("{}  (|e| proven to {ultimate_e:.4} rad", set.join(" "));
    if k_t > 0.0 {
        text.push_str(&format!(", gain {k_t:.4}"));
    }
    if let Some(used) = remedy.used {
        text.push_str(&format!(", {:.1} % of [11] used", used * 100.0));
    }
    text + ")"
}

fn remedy_to_json(remedy: &Remedy) -> Value {
    let Certificate { ultimate_e, w_norm, k_t, .. } = remedy.certificate;
    json!({
        "set": remedy.settings, "ultimate_e_rad": ultimate_e, "w_norm": w_norm, "k_t": k_t, "used": remedy.used,
    })
}

#[cfg(test)]
mod tests;
