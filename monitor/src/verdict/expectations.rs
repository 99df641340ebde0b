//! Expectations against the figures of a run: each passes, fails, or is not decided yet.
//!
//! A quantile of a hop is judged by its confidence limits ([`super::limits`]): it passes when the whole interval keeps
//! the budget, fails when the whole interval breaks it, and is inconclusive in between. The confidence of the section is
//! that of the verdict as a whole: each of k such expectations gets 1/k of the error allowed, and one relative to the
//! floor divides its part between the quantile and the floor's. Every other key is what it is, and is compared directly;
//! so are all keys in lockstep, where a latency is what the scenario says and not a sample.

use loopbound_model::quote;
use loopbound_model::quote::nearest;
use loopbound_scenario::{Budget, Comparator, ExpectSection, Expectation};
use loopbound_shared::headline::Headline;
use loopbound_shared::sample::Counters;
use serde_json::Value;

use super::blocks::{Blocks, LAST_BUCKET, NEVER_NS};
use super::limits::{Limits, are_enough, estimate, limits};
use crate::cause::Cause;
use crate::counted::counted;
use crate::hops::Hop;
use crate::summary::{Finding, Judgement, Summary, Verdict, counters_by_name};

/// Quantiles that have a key.
const QUANTILES: [(&str, f64); 4] = [("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("p99_9", 0.999)];
/// Tables of the summary whose keys are not known beforehand; what does not occur in them has occurred zero times.
const COUNTED: [&str; 6] =
    ["late_ticks_by_cause", "missed_ticks_by_cause", "counters", "events", "faults_injected", "strangers"];
/// Tables in which anything may stand.
const OPEN: [&str; 3] = ["host", "scenario", "supervision"];

/// `round_trip.p99` → the hop and 0.99, also with `latency_ns.` in front.
#[must_use]
pub fn quantile_of(key: &str) -> Option<(Hop, f64)> {
    let key = key.strip_prefix("latency_ns.").unwrap_or(key);
    let (hop, quantile) = key.split_once('.')?;
    let hop = Hop::ALL.into_iter().find(|known| known.name() == hop)?;
    let (_, quantile) = QUANTILES.into_iter().find(|(name, _)| *name == quantile)?;
    Some((hop, quantile))
}

/// Whether the keys exist and the budgets suit them: to be asked before a run is begun.
///
/// # Errors
/// One line: the first expectation that could never be judged, and why.
pub fn validate(section: &ExpectSection) -> Result<(), String> {
    let mut summary = Summary { floor: Some(crate::summary::Quantiles::default()), ..Summary::default() };
    summary.verdict = Verdict::default();
    let value = serde_json::to_value(summary).map_err(|e| e.to_string())?;
    for expectation in &section.conditions {
        let key = expectation.key.as_str();
        let first = key.split('.').next().unwrap_or(key);
        let open = COUNTED.contains(&first) || OPEN.contains(&first);
        if !open && lookup(&value, key).is_none() {
            let mut known = Vec::new();
            keys_below(&value, "", &mut known);
            let near = nearest(key, known.iter().map(String::as_str));
            let hint = near.map(|near| format!(", did you mean `{near}`?")).unwrap_or_default();
            return Err(format!("`{expectation}`: the summary has no key `{}`{hint}", quote::text(key)));
        }
        known_entry(key).map_err(|why| format!("`{expectation}`: {why}"))?;
        match &expectation.budget {
            Budget::Floor(_) if floor_key(key).is_none_or(|floor| lookup(&value, &floor).is_none()) => {
                return Err(format!("`{expectation}`: the floor has no `{}`", key.rsplit('.').next().unwrap_or(key)));
            }
            Budget::Number(_) if is_latency(key) => {
                return Err(format!("`{expectation}`: a latency needs a unit, such as 200us"));
            }
            Budget::Time(_) if !open && unit_ns(key).is_none() => {
                return Err(format!("`{expectation}`: `{key}` is not a time"));
            }
            _ => {}
        }
        if quantile_of(key).is_some() && matches!(expectation.comparator, Comparator::Equal | Comparator::NotEqual) {
            return Err(format!("`{expectation}`: a measured quantile is never exactly a number; use <= or >="));
        }
    }
    Ok(())
}

/// Refuses an entry that a table can never have: what never occurs would count as zero.
fn known_entry(key: &str) -> Result<(), String> {
    let Some((table, entry)) = key.split_once('.') else { return Ok(()) };
    let known: Vec<String> = match table {
        "late_ticks_by_cause" | "missed_ticks_by_cause" => Cause::ALL.iter().map(|c| c.name().to_owned()).collect(),
        "counters" => counters_by_name(&Counters::zeroed()).into_keys().collect(),
        _ => return Ok(()),
    };
    if known.iter().any(|known| known == entry) {
        return Ok(());
    }
    let near = nearest(entry, known.iter().map(String::as_str));
    let hint = near.map(|near| format!(", did you mean `{table}.{near}`?")).unwrap_or_default();
    Err(format!("`{table}` has no `{}`, allowed: {}{hint}", quote::text(entry), known.join(", ")))
}

/// The dotted keys of all figures; those of a latency with and without `latency_ns.` in front.
fn keys_below(value: &Value, above: &str, found: &mut Vec<String>) {
    for (key, value) in value.as_object().into_iter().flatten() {
        let dotted = if above.is_empty() { key.clone() } else { format!("{above}.{key}") };
        found.extend(dotted.strip_prefix("latency_ns.").map(str::to_owned));
        keys_below(value, &dotted, found);
        found.push(dotted);
    }
}

/// The verdict of a run that was expected to show something; `natural` is what it is worth without.
#[must_use]
pub fn judge(section: &ExpectSection, summary: &Summary, blocks: &Blocks, natural: Verdict) -> Verdict {
    if section.conditions.is_empty() {
        return natural;
    }
    let value = serde_json::to_value(summary).unwrap_or_default();
    let sampled = |e: &&Expectation| quantile_of(&e.key).is_some();
    let many = section.conditions.iter().filter(sampled).count().max(1);
    let alpha = (1.0 - section.confidence) / many as f64;
    let one = |expectation: &Expectation| match quantile_of(&expectation.key) {
        Some(which) if !summary.latency_is_virtual => by_limits(expectation, which, blocks, alpha),
        which => directly(expectation, &value, which, blocks),
    };
    let expectations: Vec<Judgement> = section.conditions.iter().map(one).collect();
    let any = |finding| expectations.iter().any(|judgement| judgement.outcome == finding);
    // What breaks the stability proof fails whatever was expected, and what was not looked at passes nothing.
    let of_itself = match natural.headline() {
        Headline::Late | Headline::NotCertified | Headline::Held => Headline::Passed,
        Headline::NoData | Headline::NotChecked => Headline::Inconclusive,
        graver => graver,
    };
    let of_expectations =
        [any(Finding::Fail).then_some(Headline::Failed), any(Finding::Inconclusive).then_some(Headline::Inconclusive)];
    let headline = of_expectations.into_iter().flatten().fold(of_itself, Headline::min);
    let mut reasons: Vec<String> =
        expectations.iter().filter(|j| j.outcome != Finding::Pass).map(|j| j.reason.clone()).collect();
    reasons.extend(natural.reasons);
    Verdict { expectations, ..Verdict::of(headline, reasons) }
}

fn by_limits(expectation: &Expectation, (hop, quantile): (Hop, f64), blocks: &Blocks, alpha: f64) -> Judgement {
    let relative = matches!(expectation.budget, Budget::Floor(_));
    let alpha = if relative { alpha / 2.0 } else { alpha };
    let limits_of = |hop| limits(quantile, alpha, blocks.nominal(), blocks.of(hop));
    let found = limits_of(hop);
    let measured = estimate(quantile, blocks.of(hop)).map(|ns| ns as f64);
    // The budget itself as an interval: one number, or what is known of the floor.
    let (budget, low, high) = match &expectation.budget {
        Budget::Number(ns) => (Some(*ns), Some(*ns), Some(*ns)),
        Budget::Time(time) => (Some(time.0 as f64), Some(time.0 as f64), Some(time.0 as f64)),
        Budget::Floor(factor) => {
            let Limits { lower_ns, upper_ns } = limits_of(Hop::Floor);
            let times = |ns: Option<u64>| ns.map(|ns| factor * ns as f64);
            (times(estimate(quantile, blocks.of(Hop::Floor))), times(lower_ns), times(upper_ns))
        }
        Budget::Text(_) => (None, None, None),
    };
    let (lower, upper) = (found.lower_ns.map(|ns| ns as f64), found.upper_ns.map(|ns| ns as f64));
    let before = |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| a <= b);
    let beyond = |a: Option<f64>, b: Option<f64>| a.zip(b).is_some_and(|(a, b)| a > b);
    let (pass, fail) = match expectation.comparator {
        Comparator::Less | Comparator::LessOrEqual => (before(upper, low), beyond(lower, high)),
        Comparator::Greater | Comparator::GreaterOrEqual => (before(high, lower), beyond(low, upper)),
        Comparator::Equal | Comparator::NotEqual => (false, false),
    };
    let outcome = if pass {
        Finding::Pass
    } else if fail {
        Finding::Fail
    } else {
        Finding::Inconclusive
    };
    let mut reason = format!("{expectation}: measured {} in [{}, {}]", time(measured), time(lower), time(upper));
    let absent = absent(hop, blocks);
    if absent > 0 {
        reason = format!("{reason}, with {} without a torque above every budget", counted(absent, "tick"));
    }
    if relative {
        reason = format!("{reason}, budget {} in [{}, {}]", time(budget), time(low), time(high));
    }
    Judgement { expectation: expectation.to_string(), outcome, measured, lower, upper, budget, reason }
}

/// Whether a key is a latency of a hop that is given without its unit.
fn is_latency(key: &str) -> bool {
    !key.starts_with("latency_ns.") && key.contains('.') && unit_ns(key).is_some() && !key.ends_with("_ns")
}

/// Ticks without an accepted torque: in these two hops they are above every budget.
fn absent(hop: Hop, blocks: &Blocks) -> u64 {
    if !matches!(hop, Hop::RoundTrip | Hop::DeadlineToTorque) {
        return 0;
    }
    let never = blocks.of(hop).flatten().filter(|(bucket, _)| *bucket == LAST_BUCKET);
    never.map(|(_, count)| u64::from(*count)).sum()
}

/// What a key is compared as where nothing is sampled, and what is said of it: a figure of a hop includes the ticks that had
/// no torque, and late ticks include them.
fn with_absent(key: &str, found: Option<Value>, which: Option<(Hop, f64)>, blocks: &Blocks) -> (Option<Value>, String) {
    let bare = key.strip_prefix("latency_ns.").unwrap_or(key);
    let (first, figure) = bare.split_once('.').unwrap_or((bare, ""));
    let hop = Hop::ALL.into_iter().find(|hop| hop.name() == first);
    let absent = absent(hop.unwrap_or(Hop::DeadlineToTorque), blocks);
    let said = format!(", and {} had no torque", counted(absent, "tick"));
    match (hop, figure) {
        (None, "") if key == "late_ticks" && absent > 0 => {
            let all = found.as_ref().and_then(Value::as_u64).map(|late| Value::from(late.saturating_add(absent)));
            (all, said)
        }
        (Some(_), "max" | "mean") if absent > 0 => (found.map(|_| Value::from(NEVER_NS)), said),
        (Some(hop), _) => {
            let Some((_, quantile)) = which else { return (found, String::new()) };
            let samples: u64 = blocks.of(hop).flatten().map(|(_, n)| u64::from(*n)).sum();
            if samples > 0 && !are_enough(samples, quantile) {
                return (None, format!(" of {}, too few for this quantile", counted(samples, "sample")));
            }
            if absent == 0 {
                return (found, String::new());
            }
            (estimate(quantile, blocks.of(hop)).map(Value::from), said)
        }
        _ => (found, String::new()),
    }
}

fn directly(expectation: &Expectation, summary: &Value, which: Option<(Hop, f64)>, blocks: &Blocks) -> Judgement {
    let key = expectation.key.as_str();
    let (found, said) = with_absent(key, lookup(summary, key).cloned(), which, blocks);
    let of_counts = COUNTED.contains(&key.split('.').next().unwrap_or(key));
    let found = found.or_else(|| of_counts.then(|| Value::from(0)));
    let measured = found.as_ref().and_then(Value::as_f64);
    let budget = match &expectation.budget {
        Budget::Number(value) => Some(*value),
        Budget::Time(time) => Some(time.0 as f64 / unit_ns(key).unwrap_or(1.0)),
        Budget::Floor(factor) => {
            let floor = floor_key(key).and_then(|floor| lookup(summary, &floor)?.as_f64());
            floor.map(|floor| factor * floor)
        }
        Budget::Text(_) => None,
    };
    let holds = match (&expectation.budget, &found) {
        (Budget::Text(text), Some(found)) if !found.is_null() => {
            let word = found.as_str().map_or_else(|| found.to_string(), str::to_owned);
            let same = word == *text;
            Some(same == (expectation.comparator == Comparator::Equal))
        }
        _ => measured.zip(budget).map(|(measured, budget)| expectation.comparator.holds(measured, budget)),
    };
    // A torque that never came is not slow enough for anything either.
    let at_least = matches!(expectation.comparator, Comparator::Greater | Comparator::GreaterOrEqual);
    let never = found.as_ref().and_then(Value::as_u64) == Some(NEVER_NS);
    let unseen = unseen(key, summary);
    let outcome = match holds {
        Some(true) if (at_least && never) || unseen.is_some() => Finding::Inconclusive,
        Some(true) => Finding::Pass,
        Some(false) => Finding::Fail,
        None => Finding::Inconclusive,
    };
    let shown = match found.filter(|found| !found.is_null()) {
        None => "nothing".to_owned(),
        Some(_) if never => "never".to_owned(),
        Some(found) => found.to_string(),
    };
    let unseen = unseen.filter(|_| outcome == Finding::Inconclusive).unwrap_or_default();
    let reason = format!("{expectation}: found {shown}{said}{unseen}");
    Judgement { expectation: expectation.to_string(), outcome, measured, budget, reason, ..Judgement::default() }
}

/// Why a figure of the records that were seen says nothing of the whole run: no tick was checked, or records are missing. Counts
/// of the plant are whole whatever was seen.
fn unseen(key: &str, summary: &Value) -> Option<String> {
    let number = |key: &str| lookup(summary, key).and_then(Value::as_u64).unwrap_or(0);
    let of_checks = ["bound.violations", "bound.verdicts", "bound.slack", "bound.psi_max"];
    if of_checks.iter().any(|of| key.starts_with(of)) && number("bound.checked") == 0 {
        return Some(", and no tick was checked".to_owned());
    }
    let of_records = key.starts_with("bound.") || key.starts_with("tracking.") || key.starts_with("late_ticks");
    let gaps = number("monitor_gaps");
    (of_records && gaps > 0).then(|| format!(", and {gaps} ticks were not seen"))
}

/// The value behind a dotted key, `latency_ns.` may be left out.
fn lookup<'a>(summary: &'a Value, key: &str) -> Option<&'a Value> {
    let within = |value: &'a Value| key.split('.').try_fold(value, |value, part| value.get(part));
    within(summary).or_else(|| within(summary.get("latency_ns")?))
}

/// The floor's figure of the same kind: `round_trip.max` → `floor.max`.
fn floor_key(key: &str) -> Option<String> {
    key.rsplit_once('.').map(|(_, figure)| format!("floor.{figure}"))
}

/// How many ns the unit of a key has; none for what is not a time.
fn unit_ns(key: &str) -> Option<f64> {
    let hop = key.strip_prefix("latency_ns.").unwrap_or(key).split('.').next().unwrap_or(key);
    // Counts of a distribution are no times.
    if [".n", ".overflow", ".negative"].iter().any(|count| key.ends_with(count)) {
        return None;
    }
    let in_ns = key.ends_with("_ns") || hop == "jitter_ns" || Hop::ALL.iter().any(|known| known.name() == hop);
    if in_ns {
        return Some(1.0);
    }
    key.ends_with("_s").then_some(1e9)
}

/// A time for people; `?` where there is none.
#[must_use]
pub fn time(ns: Option<f64>) -> String {
    match ns {
        None => "?".to_owned(),
        Some(ns) if ns >= 1.8e19 => "never".to_owned(),
        Some(ns) if ns >= 1e9 => format!("{:.2} s", ns * 1e-9),
        Some(ns) if ns >= 1e6 => format!("{:.2} ms", ns * 1e-6),
        Some(ns) if ns >= 1e3 => format!("{:.2} µs", ns * 1e-3),
        Some(ns) => format!("{ns:.0} ns"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::blocks::{Block, bucket, counts_of};
    use super::*;

    /// `seconds` of blocks in which the round trip is `us` and the bare wake-up 5 µs.
    fn run(seconds: u64, us: u64) -> Blocks {
        let mut blocks = Blocks::new(1_000_000);
        for index in 0..4 * seconds {
            let mut hops = vec![Vec::new(); Hop::ALL.len()];
            let around = |ns: u64| counts_of(&mut (0..250).map(|k| bucket(ns + k)).collect::<Vec<u16>>());
            hops[Hop::RoundTrip as usize] = around(us * 1000);
            hops[Hop::Floor as usize] = around(5000);
            blocks.push(Block { index, hops });
        }
        blocks
    }

    fn judged(toml: &str, blocks: &Blocks) -> Verdict {
        let section = ExpectSection::from_toml(toml, "test").unwrap();
        validate(&section).unwrap();
        let mut summary = Summary { missed_ticks: 3, ticks: 1000, ..Summary::default() };
        summary.bound.certified = true;
        summary.tracking.rms_e_rad = Some(0.01);
        judge(&section, &summary, blocks, Verdict::of(Headline::Held, Vec::new()))
    }

    fn status(toml: &str, blocks: &Blocks) -> String {
        judged(toml, blocks).status
    }

    #[test]
    fn a_quantile_is_decided_by_its_limits_and_undecided_where_data_are_few() {
        assert_eq!(status("'round_trip.p99' = '<= 30us'", &run(10, 10)), "passed");
        assert_eq!(status("'round_trip.p99' = '<= 30us'", &run(10, 40)), "failed");
        assert_eq!(status("'round_trip.p99' = '<= 30us'", &run(1, 10)), "inconclusive");
        assert_eq!(status("'round_trip.p99' = '>= 30us'", &run(10, 40)), "passed");
        assert_eq!(status("'round_trip.p99' = '>= 30us'", &run(10, 10)), "failed");
        // The estimate is right of the budget by less than its limits are apart.
        assert_eq!(status("'latency_ns.round_trip.p50' = '<= 10.1us'", &run(1, 10)), "inconclusive");
    }

    #[test]
    fn a_budget_in_floors_moves_with_what_the_host_did() {
        assert_eq!(status("'round_trip.p50' = '<= 3 floor'", &run(5, 10)), "passed");
        assert_eq!(status("'round_trip.p50' = '<= 3 floor'", &run(5, 20)), "failed");
        assert_eq!(status("'round_trip.p50' = '<= 3 floor'", &run(5, 15)), "inconclusive");
    }

    #[test]
    fn other_keys_are_compared_as_they_are_and_what_never_occurred_is_zero() {
        let none = Blocks::new(1_000_000);
        assert_eq!(status("missed_ticks = 3\n'bound.certified' = true\n'counters.fenced' = 0", &none), "passed");
        assert_eq!(status("missed_ticks = 0", &none), "failed");
        assert_eq!(status("'tracking.rms_e_rad' = ['> 0.005', '< 0.02']", &none), "passed");
        assert_eq!(status("'tracking.max_abs_e_rad' = '< 0.02'", &none), "inconclusive");
        let verdict = judged("missed_ticks = '== 0'\nticks = '>= 100'", &none);
        assert_eq!((verdict.reasons.len(), verdict.expectations.len()), (1, 2));
        assert!(verdict.reasons[0].contains("missed_ticks == 0: found 3"), "{verdict:?}");
    }

    #[test]
    fn one_failure_decides_and_a_broken_bound_is_never_hidden_by_what_was_expected() {
        let both = "'round_trip.p99' = '<= 30us'\nmissed_ticks = 0";
        assert_eq!(status(both, &run(1, 10)), "failed");
        let section = ExpectSection::from_toml("missed_ticks = 0", "test").unwrap();
        let violated = Verdict::of(Headline::Violated, Vec::new());
        let verdict = judge(&section, &Summary::default(), &Blocks::new(1), violated);
        assert_eq!(verdict.status, "violated");
    }

    #[test]
    fn a_tick_without_a_torque_keeps_no_budget_where_nothing_is_sampled_either() {
        // 28 round trips of 1 µs, then 372 ticks without one.
        let blocks = |answered: u32, absent: u32| {
            let mut blocks = Blocks::new(5_000_000);
            let mut hops = vec![Vec::new(); Hop::ALL.len()];
            for hop in [Hop::RoundTrip, Hop::DeadlineToTorque] {
                hops[hop as usize] = [(bucket(1000), answered), (LAST_BUCKET, absent)].map(|c| c).to_vec();
                hops[hop as usize].retain(|(_, count)| *count > 0);
            }
            hops[Hop::Compute as usize] = vec![(bucket(1000), answered)];
            blocks.push(Block { index: 0, hops });
            blocks
        };
        let judged = |toml: &str, blocks: &Blocks| {
            let section = ExpectSection::from_toml(toml, "test").unwrap();
            validate(&section).unwrap();
            let mut summary = Summary { latency_is_virtual: true, ticks: 400, ..Summary::default() };
            let all = crate::summary::Quantiles {
                n: 28,
                p50: Some(1000.0),
                p90: Some(1000.0),
                p99: Some(1000.0),
                p99_9: Some(1000.0),
                max: Some(1000.0),
                mean: Some(1000.0),
                ..crate::summary::Quantiles::default()
            };
            (summary.latency_ns.round_trip, summary.latency_ns.deadline_to_torque) = (all, all);
            summary.latency_ns.compute = all;
            judge(&section, &summary, blocks, Verdict::of(Headline::Held, Vec::new()))
        };
        let status = |toml: &str, blocks: &Blocks| judged(toml, blocks).status;
        let (some, none) = (blocks(28, 372), blocks(400, 0));
        for toml in [
            "late_ticks = 0",
            "'round_trip.p50' = '<= 200us'",
            "'round_trip.p99' = '<= 200us'",
            "'round_trip.max' = '<= 200us'",
            "'round_trip.mean' = '<= 200us'",
            "'deadline_to_torque.p99' = '<= 1s'",
            "'latency_ns.deadline_to_torque.max' = '<= 10s'",
        ] {
            assert_eq!(status(toml, &some), "failed", "{toml}");
            assert_eq!(status(toml, &none), "passed", "{toml}");
        }
        assert!(judged("late_ticks = 0", &some).reasons[0].contains("372 ticks had no torque"));
        // Nor is it slow; and a quantile of too few samples is none.
        assert_eq!(status("'round_trip.p99' = '>= 1ms'", &some), "inconclusive");
        assert_eq!(status("'round_trip.p99_9' = '<= 200us'", &none), "inconclusive");
        assert_eq!(status("'compute.p99' = '<= 200us'", &some), "inconclusive");
        assert_eq!(status("'compute.max' = '<= 200us'", &some), "passed");
    }

    #[test]
    fn what_could_never_be_judged_is_refused_before_the_run() {
        for (toml, named) in [
            ("'round_trip.p98' = '<= 1us'", "round_trip.p98"),
            ("'missed_ticks_by_cause.preempted_core' = 0", "`missed_ticks_by_cause` has no `preempted_core`"),
            ("'counters.fencd' = 0", "did you mean `counters.fenced`?"),
            ("'missed_tics' = 0", "did you mean `missed_ticks`?"),
            ("'round_trip.p98' = '<= 1us'", "did you mean `round_trip.p90`?"),
            ("'bound.violatons' = 0", "did you mean `bound.violations`?"),
            ("'missed_ticks' = '<= 3 floor'", "floor"),
            ("'missed_ticks' = '<= 3us'", "not a time"),
            ("'round_trip.p99' = '== 3us'", "never exactly"),
            ("'round_trip.p99' = '<= 200'", "needs a unit"),
            ("'deadline_to_torque.max' = '<= 200'", "needs a unit"),
            ("'jitter_ns.std' = '<= 200'", "needs a unit"),
            ("'round_trip.n' = '>= 3us'", "not a time"),
        ] {
            let section = ExpectSection::from_toml(toml, "test").unwrap();
            let error = validate(&section).unwrap_err();
            assert!(error.contains(named), "{error}");
        }
    }
}
