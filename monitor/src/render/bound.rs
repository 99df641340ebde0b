//! The lines of the screen on V, its certificate and the latency budget.

use loopbound_model::certificate::sampling::SamplingRule;

use super::{Screen, number, time, with_unit};
use crate::counted::counted;
use crate::summary::{BoundSummary, LawSummary, Summary};

pub(super) fn lines(screen: &mut Screen, summary: &Summary) {
    let bound = &summary.bound;
    // Figures of two laws are never mixed: each has its own V.
    if bound.laws.len() > 1 {
        for of in &bound.laws {
            screen.entry("law", &turn(of));
            of_one_law(screen, &of.bound, None);
        }
    } else {
        of_one_law(screen, bound, summary.tracking.max_norm_e_rad);
    }
    let text = match bound.budget_used {
        Some(used) if bound.budget_rule.as_deref() == Some(SamplingRule::JitteringDelay.name()) => format!(
            "{:.1} % of what sampling allows is used by the period of {} and a latency that jumps between {} (least) and {} \
             (p99.9), margin {}; by the rule for jitter [14], which is necessary, not sufficient",
            used * 100.0,
            time(summary.rate_hz.map(|rate_hz| 1e9 / rate_hz)),
            time(bound.loop_latency_min_ns),
            time(bound.loop_latency_ns),
            time(bound.delay_margin_ns)
        ),
        Some(used) => format!(
            "{:.1} % of what sampling allows is used by the period of {} and a latency of {} (p99.9), margin {}",
            used * 100.0,
            time(summary.rate_hz.map(|rate_hz| 1e9 / rate_hz)),
            time(bound.loop_latency_ns),
            time(bound.delay_margin_ns)
        ),
        None => "not known for this law".to_owned(),
    };
    screen.entry("latency budget", &text);
}

/// Who had a law, and when.
fn turn(of: &LawSummary) -> String {
    let ids: Vec<String> = of.controllers.iter().map(u32::to_string).collect();
    let who = if ids.len() == 1 { "controller" } else { "controllers" };
    let ticks = counted(of.ticks, "tick");
    let span = of.first_tick.zip(of.last_tick);
    let span = span.map_or_else(String::new, |(first, last)| format!(", between ticks {first} and {last}"));
    format!("{}, {who} {}: active for {ticks}{span}", of.bound.whose(), ids.join(", "))
}

/// `norm_e_rad`: largest ‖e‖ once settled, if all of the run was under this law.
fn of_one_law(screen: &mut Screen, bound: &BoundSummary, norm_e_rad: Option<f64>) {
    let units = bound.units();
    let v = |value: Option<f64>| with_unit(value, units.map(|units| units.v));
    let text = format!(
        "{} at first, max {}, {} at the end; {} c = {}",
        v(bound.v_start),
        v(bound.v_max),
        v(bound.v_final),
        if bound.certified { "certified level" } else { "not certified at level" },
        v(bound.level)
    );
    screen.entry("V", &text);
    for outside in bound.outside.iter().filter(|_| bound.certified) {
        screen.entry("not declared", outside);
    }
    if bound.checked == 0 {
        screen
            .entry("bound", if bound.certified { "certified, no tick checked" } else { "not certified: not checked" });
    } else {
        let text = format!(
            "{} of {} violated{}; V above its certified bound after {}; slack min {}, mean {}",
            bound.violations,
            counted(bound.checked, "tick"),
            violations(bound),
            counted(bound.violations_promise, "tick"),
            v(bound.slack_min),
            v(bound.slack_mean)
        );
        screen.entry("bound", &text);
        let text = format!(
            "Ψ max {} of {} = {}; {}; {}{}",
            number(bound.psi_max),
            units.map_or("C1", |units| units.psi_allowed),
            with_unit(bound.c1, units.map(|units| units.psi)),
            settled(bound),
            error_bound(bound),
            beyond(bound, norm_e_rad)
        );
        screen.entry("assumptions", &text);
    }
}

/// Whether nothing is certified but that the error vanishes: a bound of 0, which no sampled loop keeps to the last digit.
fn vanishes(bound: &BoundSummary) -> bool {
    bound.ultimate_bound == Some(0.0)
}

fn settled(bound: &BoundSummary) -> String {
    let found = number(bound.w_norm_max_settled);
    if vanishes(bound) {
        return format!("‖W‖ settled {found}");
    }
    format!("‖W‖ settled {found} of {}", number(bound.uub_radius))
}

/// What is certified of the tracking error in the long run.
fn error_bound(bound: &BoundSummary) -> String {
    if vanishes(bound) {
        return "certified: ‖e‖ and ‖W‖ tend to 0 in continuous time".to_owned();
    }
    let of_whom = if bound.outside.is_empty() { "" } else { ", of a plant as declared" };
    format!(
        "certified in the long run{of_whom}: ‖e‖ ≤ {} rad, and so each |e_i| ≤ {} rad",
        number(bound.ultimate_bound),
        number(bound.ultimate_bound_link.or(bound.ultimate_bound))
    )
}

/// Why a settled figure is above the certified one beside it, where it is.
fn beyond(bound: &BoundSummary, norm_e_rad: Option<f64>) -> &'static str {
    let above = |seen: Option<f64>, most: Option<f64>| seen.zip(most).is_some_and(|(seen, most)| seen > most);
    let is_above = above(bound.w_norm_max_settled, bound.uub_radius) || above(norm_e_rad, bound.ultimate_bound);
    if vanishes(bound) || !is_above {
        return "";
    }
    if bound.violations_delay_aware > 0 {
        return "; the settled figures are above this, since the bound was violated";
    }
    let used_up = bound.budget_used.is_some_and(|used| used >= 1.0);
    if used_up || bound.violations > 0 || bound.verdicts("outside_level") > 0 {
        return "; the settled figures are above this: the certificate is for continuous time, and this loop is sampled";
    }
    "; the settled figures are above this: V was still falling"
}

/// What explains the ticks that broke the bound, in the order in which the diagnosis asks.
fn violations(bound: &BoundSummary) -> String {
    let explained = [
        ("designed_hold", "by the designed hold"),
        ("latency", "by the age of the torque"),
        ("fallback", "under the plant's fallback"),
    ];
    let mut list: Vec<String> = explained
        .into_iter()
        .map(|(name, words)| (bound.verdicts(name), words))
        .filter(|(count, _)| *count > 0)
        .map(|(count, words)| format!("{count} {words}"))
        .collect();
    if bound.violations > 0 {
        list.push(format!("{} otherwise", bound.violations_delay_aware));
    }
    if list.is_empty() { String::new() } else { format!(": {}", list.join(", ")) }
}
