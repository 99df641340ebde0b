//! The figures of the bound: of the run, and of each law by itself.

use std::collections::BTreeMap;

use loopbound_model::certificate::units::Units;
use loopbound_model::law::LawKind;
use serde::{Deserialize, Serialize};

/// What was seen under one law.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LawSummary {
    /// The controllers that had it.
    pub controllers: Vec<u32>,
    /// Ticks for which they were in charge; those at rest are left out.
    pub ticks: u64,
    /// The first of them …
    pub first_tick: Option<u64>,
    /// … and the last; others may have been in charge between them.
    pub last_tick: Option<u64>,
    /// The figures of these ticks alone.
    #[serde(flatten)]
    pub bound: BoundSummary,
}

/// The bound. Numbers in brackets are the equations of `docs/model-and-bound.md`. Counts are those of the run; V, what is
/// certified and what was observed of it are those of the law in charge last, and of each law in `laws`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BoundSummary {
    /// Law of the controller in charge at the end; none for an unknown one.
    pub law: Option<String>,
    /// What that controller calls itself.
    pub name: Option<String>,
    /// Whether that law with its gains is certified for the scenario's start.
    pub certified: bool,
    /// Requirements that are not met.
    pub shortfalls: Vec<String>,
    /// What of the scenario's plant lies outside of what the controller declares; empty: what is certified is true of it.
    pub outside: Vec<String>,
    /// Ticks checked with a certificate.
    pub checked: u64,
    /// Ticks with X above the tolerance while V ≤ c. \[10]
    pub violations: u64,
    /// Those of them that neither the age of the torques nor the plant's own fallback explains.
    pub violations_delay_aware: u64,
    /// Ticks that broke promise (a).
    pub violations_promise: u64,
    /// Checked ticks by what the diagnosis found.
    pub verdicts: BTreeMap<String, u64>,
    /// The ticks of verdict `fallback` by what kept the torque from coming.
    pub fallback_by_cause: BTreeMap<String, u64>,
    /// Unit of V, its level, its slack and, a second, of ε: `J`, or `rad²/s²` for `ctc`, whose V is no energy.
    pub v_unit: Option<String>,
    /// Unit of C1 and Ψ: `N·m`, or `rad/s²` for `ctc`.
    pub psi_unit: Option<String>,
    /// c, the certified level of V.
    pub level: Option<f64>,
    /// κ, N·m·s. \[7]
    pub kappa: Option<f64>,
    /// K_t, N·m·s.
    pub k_t: Option<f64>,
    /// V of the first tick seen.
    pub v_start: Option<f64>,
    /// Largest V.
    pub v_max: Option<f64>,
    /// V at the end.
    pub v_final: Option<f64>,
    /// α, 1/s. \[8]
    pub alpha: Option<f64>,
    /// ε, in `v_unit` a second. \[8]
    pub epsilon: Option<f64>,
    /// C1, N·m; η0 in rad/s² for `ctc`. \[6]
    pub c1: Option<f64>,
    /// Largest observed Ψ less its κ terms, in the unit of C1: sound assumptions keep it below C1.
    pub psi_max: Option<f64>,
    /// Least slack of promise (a): its right side less V, over checked ticks.
    pub slack_min: Option<f64>,
    /// Mean slack of promise (a).
    pub slack_mean: Option<f64>,
    /// ‖W‖, the radius outside which V falls. (20)
    pub uub_radius: Option<f64>,
    /// The ultimate bound of ‖e‖, the norm over all links, rad. \[9]
    pub ultimate_bound: Option<f64>,
    /// The ultimate bound of |e_i|, each link by itself, rad; it follows from that of the norm, and equals it.
    pub ultimate_bound_link: Option<f64>,
    /// Largest ‖W‖ observed once settled.
    pub w_norm_max_settled: Option<f64>,
    /// How much later the p99.9 torque could be before the sampled loop is unstable, ns. \[11]
    pub delay_margin_ns: Option<f64>,
    /// Share of the latency budget used, by the p99.9 of the loop latency and, since it jumps, by its least. \[11], \[14]
    pub budget_used: Option<f64>,
    /// Which of the two rules the share is of: `constant delay` \[11] or `jittering delay` \[14], the stricter one.
    pub budget_rule: Option<String>,
    /// The loop latency that it is computed from, p99.9, ns.
    pub loop_latency_ns: Option<f64>,
    /// The least loop latency, ns.
    pub loop_latency_min_ns: Option<f64>,
    /// The figures of each law, in the order in which they first were in charge.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub laws: Vec<LawSummary>,
}

impl BoundSummary {
    /// The law, with what its controller calls itself where that is something else.
    #[must_use]
    pub fn whose(&self) -> String {
        match (&self.law, &self.name) {
            (Some(law), Some(name)) if law != name && !name.is_empty() => format!("{law} ({name})"),
            (Some(law), _) => law.clone(),
            (None, Some(name)) if !name.is_empty() => format!("{name} (announced no law)"),
            (None, _) => "no announced law".to_owned(),
        }
    }

    /// The units of its figures; none for an unknown law.
    #[must_use]
    pub fn units(&self) -> Option<Units> {
        self.law.as_deref()?.parse().ok().map(LawKind::units)
    }

    /// Checked ticks of a verdict.
    #[must_use]
    pub fn verdicts(&self, name: &str) -> u64 {
        self.verdicts.get(name).copied().unwrap_or(0)
    }
}
