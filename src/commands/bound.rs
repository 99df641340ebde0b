//! `loopbound bound`: the certificate of a scenario, without running it.
//!
//! Responsible for what is printed; the certificate is `shared`'s, what latency leaves of it is in [`mod@sampling`].

pub mod sampling;

use std::io::Write as _;

use clap::Args;
use loopbound_model::bound::coverage::Gap;
use loopbound_model::certificate::requirement::Certification;
use loopbound_model::certificate::{Certificate, Gains, OnR};
use loopbound_model::law::{Gain, LawKind};
use loopbound_model::quote;
use loopbound_model::with_links;
use loopbound_scenario::system;
use loopbound_scenario::system::advice::{self, Remedy};
use loopbound_scenario::{Scenario, ScenarioError, parse_duration};
use loopbound_shared::say;
use serde_json::{Value, json};

use self::sampling::{Sampling, sampling};
use crate::commands::options::ScenarioArgs;
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
    gains: Gains,
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
    let gains = system::gains(scenario, law);
    Ok(Answer { law, gains, rate_hz, certification, sampling, gaps, remedies: Vec::new(), better: None })
}

/// The answer with what would do, or would do better.
fn advise<const N: usize>(scenario: &Scenario, latency_s: f64) -> Result<Answer, ScenarioError> {
    let mut answer = examine::<N>(scenario, latency_s)?;
    if answer.holds() {
        let proven_rad = answer.certification.certificate.ultimate_e;
        let best = advice::best_gains::<N>(scenario, answer.sampling.period_s, latency_s, advice::ROOM)?;
        answer.better = best.filter(|best| best.certificate.ultimate_e < proven_rad);
        // They are certified and stable; but with them the plant may be asked for more than it can do.
        if let Some(better) = &answer.better
            && !system::gaps::<N>(&scenario.with_sets(&better.settings)?, answer.law)?.is_empty()
        {
            answer.better = None;
        }
    } else {
        answer.remedies = advice::remedies::<N>(scenario, latency_s)?;
    }
    Ok(answer)
}

/// One number of a certificate.
struct Row {
    key: &'static str,
    /// None where the law has no such number.
    value: Option<f64>,
    unit: &'static str,
    meaning: &'static str,
}

/// Every number that a certificate can have, the same list for every law.
fn rows(law: LawKind, gains: &Gains, c: &Certificate) -> Vec<Row> {
    let on_r = |number: fn(&OnR) -> f64| c.on_r().map(number);
    let used = |gain, value| law.uses(gain).then_some(value);
    let units = law.units();
    let row = |key, value, unit, meaning| Row { key, value, unit, meaning };
    vec![
        row("beta", on_r(|r| r.beta), "1/s", "of r = e' + beta e"),
        row("p", on_r(|r| r.p), "N·m/rad", "weight of ‖e‖² in V"),
        row("k2", on_r(|r| r.k2), "N·m·s", "share of the gain that makes V fall"),
        row("k3", on_r(|r| r.k3), "1/(N·m·rad/s)", "ε = 1/(4 K3)"),
        row("c1", on_r(|r| r.c1), "N·m", "covers what does not vanish with the error"),
        row("c1_required", on_r(|r| r.c1_required), "N·m", "what it must cover at least"),
        row("kappa", on_r(|r| r.kappa), "N·m·s", "what the Coriolis and cross terms take"),
        row("k_t", on_r(|r| r.k_t), "N·m·s", "total gain: K2 + κ + K3 C1²"),
        row("k_p", used(Gain::KP, gains.k_p), units.k_p, "gain of the law"),
        row("k_d", used(Gain::KD, gains.k_d), units.k_d, "gain of the law"),
        row("level", Some(c.level), units.v, "c: certified where V ≤ c"),
        row("v_start", Some(c.v_start), units.v, "V(0), an upper bound"),
        row("v_ultimate", Some(c.v_ultimate()), units.v, "ε/α: where V settles at most"),
        row("alpha", Some(c.alpha), "1/s", "rate at which V falls"),
        row("epsilon", Some(c.epsilon), units.epsilon, "what V may rise by"),
        row("w_norm", Some(c.w_norm), "", "‖W‖, W = (e, r): V falls outside; depends on the unit of time"),
        row("ultimate_e_rad", Some(c.ultimate_e), "rad", "ultimate bound of ‖e‖, all links"),
        row("ultimate_e_link_rad", Some(c.ultimate_e_link()), "rad", "and so of |e_i|, each link"),
        row("ultimate_r_rad_s", Some(c.ultimate_s), "rad/s", "ultimate bound of ‖r‖, all links"),
        row("lambda_lo", Some(c.envelope.lambda_lo()), "kg·m²", "least eigenvalue of M"),
        row("lambda_hi", Some(c.envelope.lambda_hi()), "kg·m²", "largest eigenvalue of M"),
        row("mu", Some(c.envelope.mu), "", "mass mismatch covered"),
        row("disturbance_nm", Some(c.envelope.disturbance_nm), "N·m", "disturbance covered"),
    ]
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
        for Row { key, value, unit, meaning } in rows(self.law, &self.gains, &self.certification.certificate) {
            if let Some(value) = value {
                text.push_str(&format!("  {key:<20}{value:>12.5}  {unit:<14}  {meaning}\n"));
            }
        }
        text.push_str(&self.sampling.render(self.law));
        if let Some(better) = &self.better {
            let room = advice::ROOM * 100.0;
            text.push_str(&format!("  smallest proven ‖e‖ with {room:.0} % of the room: {}\n", advised(better)));
        }
        text
    }

    /// For programs.
    fn to_json(&self) -> Value {
        let certification = &self.certification;
        // A number that the law does not have is null, and so is one that is not finite, since nothing is proven.
        let all = rows(self.law, &self.gains, &certification.certificate);
        let numbers: serde_json::Map<String, Value> =
            all.iter().map(|row| (row.key.to_owned(), json!(row.value))).collect();
        let units: serde_json::Map<String, Value> =
            all.iter().map(|row| (row.key.to_owned(), json!(row.unit))).collect();
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
            "units": units,
            "sampling": self.sampling.to_json(),
        })
    }
}

/// A remedy as it is typed, with what it gives.
fn advised(remedy: &Remedy) -> String {
    let set: Vec<String> = remedy.settings.iter().map(|setting| format!("--set {setting}")).collect();
    let (ultimate_e, k_t) = (remedy.certificate.ultimate_e, remedy.certificate.k_t());
    let mut text = format!("{}  (‖e‖ proven to {ultimate_e:.4} rad", set.join(" "));
    if k_t > 0.0 {
        text.push_str(&format!(", gain {k_t:.4}"));
    }
    if let Some(used) = remedy.used {
        text.push_str(&format!(", {:.1} % of [11] used", used * 100.0));
    }
    text + ")"
}

fn remedy_to_json(remedy: &Remedy) -> Value {
    let (Certificate { ultimate_e, w_norm, .. }, k_t) = (remedy.certificate, remedy.certificate.k_t());
    json!({
        "set": remedy.settings, "ultimate_e_rad": ultimate_e, "w_norm": w_norm, "k_t": k_t, "used": remedy.used,
    })
}

#[cfg(test)]
mod tests;
