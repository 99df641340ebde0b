//! `loopbound compare`: two recorded runs side by side, as far as they can be compared.
//!
//! Responsible for which runs may stand beside each other and for saying in what they differ; the ratios are
//! [`comparison`]'s.

use loopbound_model::quote;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use clap::Args;
use loopbound_monitor::Summary;
use loopbound_monitor::folder::{Look, known};
use loopbound_monitor::verdict::comparison;
use loopbound_shared::headline::Headline;
use loopbound_shared::say;
use serde::Serialize;
use serde_json::Value;

use crate::commands::check::{read, read_blocks};
use crate::exit::{Exit, Failure};

/// `loopbound compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Folder of the first run: the divisor.
    pub a: PathBuf,
    /// Folder of the second run.
    pub b: PathBuf,
    /// Print one JSON document instead of the table.
    #[arg(long)]
    pub json: bool,
}

/// A key of the scenario that the runs have differently.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Difference {
    key: String,
    a: Value,
    b: Value,
}

/// A figure of both runs that is no latency.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Figure {
    name: &'static str,
    /// Of `a`.
    unit: &'static str,
    /// Of `b`: another one where V is that of another law.
    unit_b: &'static str,
    a: Option<f64>,
    b: Option<f64>,
    /// b / a; none where one of them is zero or absent, or where it would compare the bounds of two certificates.
    ratio: Option<f64>,
    why_no_ratio: Option<&'static str>,
}

/// Differences that fit into the first line.
const NAMED_MAX: usize = 6;

/// Compares two recorded runs.
///
/// # Errors
/// If they can't be read, or have nothing that can be compared.
pub fn run(args: &CompareArgs) -> anyhow::Result<Exit> {
    let look = |folder: &Path| Look::at(folder).map_err(|error| Failure::usage(error.to_string()));
    let looks = [look(&args.a)?, look(&args.b)?];
    let mut out = say::stdout();
    if looks.iter().any(|look| !look.is_whole()) {
        let broken = looks.iter().filter(|look| !look.is_whole());
        if args.json {
            let reasons: Vec<String> = broken.map(Look::headline).collect();
            let nothing = serde_json::json!({"status": Headline::Incomplete.word(), "reasons": reasons});
            writeln!(out, "{}", serde_json::to_string_pretty(&nothing)?)?;
        } else {
            broken.map(Look::headline).try_for_each(|line| writeln!(out, "{line}"))?;
        }
        return Ok(Headline::Incomplete.into());
    }
    let (a, b) = (summary(&args.a)?, summary(&args.b)?);
    refuse_two_clocks(&a, &b)?;
    let differences = differences(&a, &b);
    let ratios = comparison::compare(&read_blocks(&args.a)?, &read_blocks(&args.b)?);
    let figures = figures(&a, &b, &differences);
    if args.json {
        let document = serde_json::json!({"differences": differences, "ratios": ratios, "figures": figures});
        writeln!(out, "{}", serde_json::to_string_pretty(&document)?)?;
    } else {
        writeln!(out, "{}", first_line(&differences))?;
        write!(out, "{}", comparison::table(&ratios))?;
        write!(out, "{}", table(&figures))?;
    }
    Ok(Exit::Held)
}

fn summary(folder: &Path) -> Result<Summary, Failure> {
    serde_json::from_str(&read(folder, known::SUMMARY)?)
        .map_err(|error| Failure::usage(format!("{}: {error}", quote::path(&folder.join(known::SUMMARY)))))
}

/// Virtual latencies are what was injected; those of a machine are what was measured.
fn refuse_two_clocks(a: &Summary, b: &Summary) -> Result<(), Failure> {
    if a.latency_is_virtual == b.latency_is_virtual {
        return Ok(());
    }
    let (lockstep, realtime) = if a.latency_is_virtual { ("A", "B") } else { ("B", "A") };
    Err(Failure::usage(format!(
        "{lockstep} ran in lockstep, on virtual time: its latencies are those that were injected, {realtime}'s were \
         measured; allowed: two runs in lockstep, or two in real time"
    )))
}

/// The keys of the two scenarios that differ, in the order of their names. What is expected of a run changes nothing in
/// it. Of two versions of the program only keys that both have are told.
fn differences(a: &Summary, b: &Summary) -> Vec<Difference> {
    let [mut of_a, mut of_b] = [leaves(&a.scenario), leaves(&b.scenario)];
    if a.build != b.build {
        of_a.retain(|key, _| of_b.contains_key(key));
        of_b.retain(|key, _| of_a.contains_key(key));
    }
    let mut keys: Vec<&String> = of_a.keys().chain(of_b.keys()).collect();
    keys.sort();
    keys.dedup();
    let value = |of: &BTreeMap<String, Value>, key: &str| of.get(key).cloned().unwrap_or(Value::Null);
    let all = keys.into_iter().map(|key| Difference { key: key.clone(), a: value(&of_a, key), b: value(&of_b, key) });
    all.filter(|difference| difference.a != difference.b).collect()
}

fn leaves(scenario: &Value) -> BTreeMap<String, Value> {
    fn walk(into: &mut BTreeMap<String, Value>, key: &str, value: &Value) {
        match value {
            Value::Object(map) => {
                let below = |name: &str| if key.is_empty() { name.to_owned() } else { format!("{key}.{name}") };
                map.iter().for_each(|(name, value)| walk(into, &below(name), value));
            }
            Value::Null => {}
            value => drop(into.insert(key.to_owned(), value.clone())),
        }
    }
    let mut found = BTreeMap::new();
    walk(&mut found, "", scenario);
    found.retain(|key, _| !key.starts_with("expect."));
    found
}

fn first_line(differences: &[Difference]) -> String {
    if differences.is_empty() {
        return "A and B are runs of the same scenario".to_owned();
    }
    let short = |value: &Value| {
        let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        let cut: String = text.chars().take(40).collect();
        if value.is_null() {
            "none".to_owned()
        } else if cut.len() < text.len() {
            format!("{cut}…")
        } else {
            text
        }
    };
    let named = differences.iter().take(NAMED_MAX);
    let named: Vec<String> = named.map(|d| format!("{} {} → {}", d.key, short(&d.a), short(&d.b))).collect();
    let more = differences.len().saturating_sub(NAMED_MAX);
    let more = if more > 0 { format!(", and {more} more keys") } else { String::new() };
    format!("A and B differ: {}{more}", named.join(", "))
}

/// Errors are physical and can always be compared; V and W are measured against a certificate, which another law or
/// other gains change.
fn figures(a: &Summary, b: &Summary, differences: &[Difference]) -> Vec<Figure> {
    let certificate = ["controller", "swap"];
    let other = a.bound.law != b.bound.law
        || differences.iter().any(|difference| certificate.iter().any(|key| difference.key.starts_with(key)));
    let figure = |name, unit: fn(&Summary) -> &'static str, of: fn(&Summary) -> Option<f64>, of_bound: bool| {
        let [unit, unit_b] = [a, b].map(unit);
        let (a, b) = (of(a), of(b));
        let why_no_ratio = match (a, b) {
            _ if of_bound && other => Some("two laws"),
            (None, _) | (_, None) => Some("absent"),
            (Some(a), Some(b)) if a.abs() < f64::MIN_POSITIVE || b.abs() < f64::MIN_POSITIVE => Some("zero"),
            _ => None,
        };
        let ratio = a.zip(b).map(|(a, b)| b / a).filter(|ratio| why_no_ratio.is_none() && ratio.is_finite());
        Figure { name, unit, unit_b, a, b, ratio, why_no_ratio }
    };
    let v_unit: fn(&Summary) -> &'static str = |s| s.bound.units().map_or("", |units| units.v);
    vec![
        figure("missed ticks", |_| "", |s| Some(s.missed_ticks as f64), false),
        figure("share of missed ticks", |_| "%", |s| share(s.missed_ticks, s.ticks), false),
        figure("largest |e_i|, settled", |_| "rad", |s| s.tracking.max_abs_e_rad, false),
        figure("largest ‖e‖, settled", |_| "rad", |s| s.tracking.max_norm_e_rad, false),
        figure("rms e_i, settled", |_| "rad", |s| s.tracking.rms_e_rad, false),
        figure("largest V", v_unit, |s| s.bound.v_max, true),
        figure("least slack of V", v_unit, |s| s.bound.slack_min, true),
        figure("largest ‖W‖, settled", |_| "", |s| s.bound.w_norm_max_settled, true),
    ]
}

/// A share of ticks, %; none of none.
fn share(some: u64, all: u64) -> Option<f64> {
    (all > 0).then(|| 100.0 * some as f64 / all as f64)
}

fn table(figures: &[Figure]) -> String {
    let mut text = String::new();
    for Figure { name, unit, unit_b, a, b, ratio, why_no_ratio } in figures {
        let value = |value: &Option<f64>, unit: &str| {
            value.map_or_else(|| "absent".to_owned(), |value| format!("{value:.4} {unit}").trim_end().to_owned())
        };
        let ratio = ratio.map_or_else(|| why_no_ratio.unwrap_or("–").to_owned(), |ratio| format!("{ratio:.3}"));
        let _ = writeln!(text, "{name:<25}{:>16}{:>16}{ratio:>9}", value(a, unit), value(b, unit_b));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn of(law: &str, rate: f64, v_max: Option<f64>) -> Summary {
        let mut summary = Summary { build: "1".into(), ..Summary::default() };
        summary.scenario = json!({"controller": {"law": law}, "loop": {"rate": rate}, "expect": {"x": rate}});
        summary.bound.law = Some(law.to_owned());
        (summary.bound.v_max, summary.tracking.max_abs_e_rad) = (v_max, Some(0.1));
        summary
    }

    #[test]
    fn what_differs_is_named_with_both_values_and_expectations_are_no_difference() {
        let line = |a: &Summary, b: &Summary| first_line(&differences(a, b));
        assert_eq!(line(&of("ctc", 1.0, None), &of("ctc", 1.0, None)), "A and B are runs of the same scenario");
        assert_eq!(
            line(&of("ctc", 1.0, None), &of("robust", 2.0, None)),
            "A and B differ: controller.law ctc → robust, loop.rate 1.0 → 2.0"
        );
    }

    #[test]
    fn bounds_of_two_laws_and_what_is_zero_or_absent_have_no_ratio() {
        let ratio = |a: &Summary, b: &Summary, name: &str| {
            let figures = figures(a, b, &differences(a, b));
            let figure = figures.into_iter().find(|figure| figure.name == name).unwrap();
            (figure.ratio, figure.why_no_ratio)
        };
        let (same, other) = (of("ctc", 1.0, Some(4.0)), of("robust", 1.0, Some(4.0)));
        assert_eq!(ratio(&of("ctc", 1.0, Some(2.0)), &same, "largest V"), (Some(2.0), None));
        assert_eq!(ratio(&same, &other, "largest V"), (None, Some("two laws")));
        assert_eq!(ratio(&same, &other, "largest |e_i|, settled"), (Some(1.0), None));
        assert_eq!(ratio(&same, &of("ctc", 1.0, Some(0.0)), "largest V"), (None, Some("zero")));
        assert_eq!(ratio(&same, &of("ctc", 1.0, None), "largest V"), (None, Some("absent")));
    }

    #[test]
    fn lockstep_and_real_time_are_not_compared() {
        let mut lockstep = of("ctc", 1.0, None);
        lockstep.latency_is_virtual = true;
        let failure = refuse_two_clocks(&of("ctc", 1.0, None), &lockstep).unwrap_err();
        assert!(failure.exit == Exit::Usage && failure.message.starts_with("B ran in lockstep"), "{failure}");
    }
}
