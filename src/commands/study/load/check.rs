//! The recommended setting in a run of its own, with the gains that its latency allows: does it keep what it promises?

use serde::Serialize;

use loopbound_scenario::{Nanos, Scenario};

use super::advice::Setting;
use super::case::{Case, Measured, Row};
use super::design::{Designer, budget_used};
use super::group::{RunError, Runner};
use super::options::Plan;
use super::text::{percent, time};

/// The recommended scenario in a run of its own.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Check {
    /// Its row; none if the run failed.
    pub row: Option<Row>,
    /// Largest |e_i| that was seen once settled, rad.
    pub max_abs_e_rad: Option<f64>,
    /// The verdict of the run by the bound.
    pub verdict: String,
    /// What it did not keep; empty: it kept everything.
    pub against: Vec<String>,
    /// All of it in words.
    pub words: String,
}

/// The worst case of the setting, and the scenario with the gains that its latency allows.
#[must_use]
pub fn recommended(plan: &Plan, designer: &Designer, rows: &[Row], setting: &Setting) -> (Case, Scenario) {
    let case = plan.cases[setting.worst_row];
    let scenario = case.apply(&plan.base);
    let latency_ns = rows[setting.worst_row].latency.map_or(0.0, |latency| latency.value_ns);
    let found = designer.smallest(case.rate.0, latency_ns);
    // The scenario took these gains when they were sought.
    let mended = found.and_then(|found| Designer::with_gains(&scenario, &found).ok());
    (case, mended.unwrap_or(scenario))
}

/// Runs the recommendation under the load that was worst for it, for as long as a case was measured; none if a signal
/// came.
pub fn run(plan: &Plan, runner: &Runner<'_>, case: &Case, scenario: &Scenario, setting: &Setting) -> Option<Check> {
    let run_ns = plan.run_ns * u64::from(plan.rounds);
    let run = match runner.run(case, scenario, run_ns) {
        Ok(run) => run,
        Err(RunError::Stopped(_)) => return None,
        Err(error) => {
            let (against, words) = (vec![error.to_string()], format!("Measured again with it: {error}."));
            return Some(Check { against, words, ..Check::default() });
        }
    };
    let (verdict, seen) = (run.summary.verdict.status.clone(), run.summary.tracking.max_abs_e_rad);
    let mut measured = Measured::default();
    measured.add(run);
    let mut row = measured.row(case, plan.quantile);
    row.budget_used = row.latency.and_then(|latency| budget_used(scenario, latency.value_ns).ok().flatten());
    let against = against(plan, setting, &row, seen);
    let kept = if against.is_empty() { "it keeps all limits".to_owned() } else { against.join(", ") };
    let words = format!(
        "Measured again with it, {} under load {}: {kept}. Verdict of the run: {verdict}; deadline → torque {} {} (in the \
         study {}), {} of ticks missed, {} of a core, {} of [11] used; largest |e_i| once settled {}.",
        Nanos(run_ns),
        case.load.name(),
        plan.quantile.name(),
        time(row.latency.map(|latency| latency.value_ns)),
        time(Some(setting.latency_ns)),
        percent(row.missed_share),
        percent(row.cpu),
        percent(row.budget_used),
        seen.map_or("?".to_owned(), |seen| format!("{seen:.4} rad")),
    );
    Some(Check { row: Some(row), max_abs_e_rad: seen, verdict, against, words })
}

/// What the run did not keep of what the recommendation promises.
fn against(plan: &Plan, setting: &Setting, row: &Row, seen: Option<f64>) -> Vec<String> {
    let mut against = Vec::new();
    let mut share = |found: Option<f64>, most: f64, what: &str| {
        if found.is_none_or(|found| found > most) {
            against.push(format!("{} {what}, allowed: {}", percent(found), percent(Some(most))));
        }
    };
    share(row.missed_share, plan.missed_max, "of ticks missed");
    share(row.cpu, plan.cpu_max, "of a core");
    share(row.budget_used, 1.0, "of [11] used");
    if let (Some(seen), Some(most)) = (seen, setting.e_proven_rad)
        && seen > most
    {
        against.push(format!("|e_i| reached {seen:.4} rad, proven: {most:.4} rad"));
    }
    against
}

#[cfg(test)]
mod tests {
    use super::super::tests::plan;
    use super::*;

    #[test]
    fn a_recommendation_that_does_not_keep_its_limits_says_which_and_by_how_much() {
        let plan = plan("--quick").unwrap();
        let setting = Setting { e_proven_rad: Some(0.3), ..Setting::default() };
        let good = Row { missed_share: Some(0.01), cpu: Some(0.5), budget_used: Some(0.6), ..Row::default() };
        assert!(against(&plan, &setting, &good, Some(0.3)).is_empty());
        let bad = Row { missed_share: Some(0.02), cpu: Some(1.6), budget_used: None, ..Row::default() };
        let found = against(&plan, &setting, &bad, Some(0.4)).join(", ");
        for part in
            ["2.0 % of ticks missed, allowed: 1.0 %", "160 % of a core", "? of [11]", "0.4000 rad, proven: 0.3000 rad"]
        {
            assert!(found.contains(part), "{found}");
        }
    }
}
