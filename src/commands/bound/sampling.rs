//! What period and latency leave of a certificate: \[11], \[12], \[13] and the spectral radius.

use std::fmt::Write as _;

use loopbound_model::bound::stability::radius::{Limit, SampledLoop};
use loopbound_model::certificate::Certificate;
use loopbound_model::certificate::sampling::{
    ProvenAge, SamplingBudget, hold_limit_s, hold_limit_ticks, sampling_budget,
};
use loopbound_model::law::LawKind;
use loopbound_scenario::system::{self, advice::CONFIGURATIONS};
use loopbound_scenario::{Scenario, ScenarioError};
use serde_json::{Value, json};

/// The latency side of a scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// h, s.
    pub period_s: f64,
    /// From a sample to the action of its torque, s.
    pub latency_s: f64,
    /// \[11]; none for `ctc`.
    pub budget: Option<SamplingBudget>,
    /// Largest spectral radius of the sampled loop over configurations; below 1 it is stable.
    pub radius: f64,
    /// What may be added to the latency by the spectral radius.
    pub radius_margin: Limit,
    /// The longest period at this latency by the spectral radius; none when no period is stable.
    pub radius_period: Option<Limit>,
    /// \[12].
    pub proven: Option<ProvenAge>,
    /// V and |τ| (N·m) for which the hold limit is given: where V settles, and the most that gravity asks.
    pub held: (f64, f64),
    /// \[13], s.
    pub hold_s: f64,
    /// \[13], whole ticks.
    pub hold_ticks: u32,
}

/// Computes the latency side of `scenario` for its certificate.
///
/// # Errors
/// If the scenario describes no system.
pub fn sampling<const N: usize>(
    scenario: &Scenario,
    certificate: &Certificate,
    latency_s: f64,
) -> Result<Sampling, ScenarioError> {
    let law_kind = scenario.controller.law;
    let period_s = scenario.period_ns() as f64 * 1e-9;
    let law = system::law::<N>(scenario, law_kind)?;
    let assumptions = system::assumptions::<N>(scenario)?;
    let sampled = SampledLoop::new(&law, &scenario.build_truth::<N>()?.chain, CONFIGURATIONS);
    let envelope = assumptions.envelope();
    let held = (certificate.v_ultimate(), (1.0 + envelope.mu) * envelope.b_hat);
    Ok(Sampling {
        period_s,
        latency_s,
        budget: sampling_budget(certificate, period_s, latency_s),
        radius: sampled.worst_radius(period_s, latency_s),
        radius_margin: sampled.delay_margin(period_s, latency_s),
        radius_period: sampled.longest_period(period_s, latency_s),
        proven: law_kind.proven_age(certificate),
        held,
        hold_s: hold_limit_s(certificate, held.0, held.1),
        hold_ticks: hold_limit_ticks(certificate, held.0, held.1, period_s),
    })
}

/// A limit to stay below, in ms: rounded down, so that what is printed holds when it is tried.
fn rounded_down_ms(limit_s: f64) -> String {
    format!("{:.4} ms", (limit_s * 1e7).floor() * 1e-4)
}

/// The smaller limit.
fn sooner(one: Limit, other: Limit) -> Limit {
    if one.seconds() < other.seconds() { one } else { other }
}

/// A period to stay below, with the rate to stay above, both rounded to the safe side.
fn longest_period(limit: Option<Limit>) -> String {
    match limit {
        Some(Limit::At(limit_s)) => {
            format!("period up to {} ({:.0} Hz and more)", rounded_down_ms(limit_s), (1.0 / limit_s).ceil())
        }
        Some(Limit::Beyond(_)) => "any period".to_owned(),
        None => "no period is stable with so much delay".to_owned(),
    }
}

impl Sampling {
    /// Whether the loop is stable at this period and latency: by \[11] with the worst of the masses that are declared, and
    /// by the spectral radius with the plant's own.
    #[must_use]
    pub fn is_stable(&self) -> bool {
        self.radius < 1.0 && self.budget.is_none_or(|budget| budget.used < 1.0)
    }

    /// What may be added to the latency before the loop is unstable.
    #[must_use]
    pub fn delay_margin(&self) -> Limit {
        let by_rule = self.budget.map(|budget| Limit::At(budget.delay_margin_s));
        by_rule.map_or(self.radius_margin, |limit| sooner(limit, self.radius_margin))
    }

    /// The period that separates stable from unstable at this latency; none when no period is stable.
    #[must_use]
    pub fn longest_period(&self) -> Option<Limit> {
        match self.budget {
            Some(budget) => Some(sooner(Limit::At(budget.period_max_s?), self.radius_period?)),
            None => self.radius_period,
        }
    }

    /// For people.
    #[must_use]
    pub fn render(&self, law: LawKind) -> String {
        let state = |stable: bool| if stable { "stable" } else { "UNSTABLE" };
        let margin = self.delay_margin();
        let mut text = format!(
            "sampled every {:.4} ms, torques {:.4} ms late: {}, {}{} of delay left, {}\n",
            self.period_s * 1e3,
            self.latency_s * 1e3,
            state(self.is_stable()),
            if matches!(margin, Limit::Beyond(_)) { "more than " } else { "" },
            rounded_down_ms(margin.seconds()),
            longest_period(self.longest_period()),
        );
        match &self.budget {
            Some(budget) => {
                let _ = writeln!(
                    text,
                    "  [11] {}: the fastest mode uses {:.1} % of the room, with the worst masses that are declared",
                    state(budget.used < 1.0),
                    budget.used * 100.0,
                );
            }
            None => {
                text.push_str("  [11] says nothing of this law: it has no mode that is much faster than the chain\n")
            }
        }
        let _ = writeln!(
            text,
            "  spectral radius {:.5}: {}, linearised at rest, with the plant's own masses",
            self.radius,
            state(self.radius < 1.0),
        );
        match &self.proven {
            Some(proven) => {
                let age_s = self.period_s + self.latency_s;
                let _ = writeln!(
                    text,
                    "  [12] torques up to {:.4} ms old are proven beforehand; here they get {:.4} ms old: {}",
                    proven.age_s * 1e3,
                    age_s * 1e3,
                    if age_s <= proven.age_s { "proven" } else { "left to the live check" }
                );
            }
            None => text.push_str("  [12] proves no age here\n"),
        }
        let _ = writeln!(
            text,
            "  [13] a torque of {:.1} N·m may be held for {:.2} ms ({} ticks) from V = {:.4} {}",
            self.held.1,
            self.hold_s * 1e3,
            self.hold_ticks,
            self.held.0,
            law.units().v
        );
        text
    }

    /// For programs; times in s.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let budget = self.budget.map(|b| {
            json!({
                "used": b.used, "delay_ratio": b.delay_ratio, "hold_ratio": b.hold_ratio,
                "delay_margin_s": b.delay_margin_s, "period_max_s": b.period_max_s,
            })
        });
        let proven = self.proven.map(|p| json!({"age_s": p.age_s, "gain_share": p.gain_share, "epsilon": p.epsilon}));
        json!({
            "period_s": self.period_s,
            "latency_s": self.latency_s,
            "stable": self.is_stable(),
            "delay_margin_s": self.delay_margin().seconds(),
            "period_max_s": self.longest_period().map(Limit::seconds),
            "budget": budget,
            "spectral_radius": self.radius,
            "spectral_radius_margin_s": self.radius_margin.seconds(),
            "spectral_radius_period_max_s": self.radius_period.map(Limit::seconds),
            "proven_age": proven,
            "hold": {"v": self.held.0, "torque_nm": self.held.1, "limit_s": self.hold_s, "ticks": self.hold_ticks},
        })
    }
}
