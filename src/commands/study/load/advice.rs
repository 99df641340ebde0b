//! What to choose, computed from the table: for each rate the mode with the least latency, and among the rates the one
//! that allows the smallest proven |e|.
//!
//! A setting is judged by its worst load, since nobody chooses what else will run. It is feasible if under every load
//! something is certified at its latency, and misses and CPU stay within their limits. Two settings whose ratio of
//! latencies has 1 in its interval can't be told apart by these data: then the one that takes less CPU is taken. Where there
//! are too few data for an interval, nothing is recommended: one slow tick more or less would turn it over.

use serde::Serialize;

use super::case::{Rights, Row};
use super::options::Quantile;
use super::text::{percent, time};
use crate::commands::study::load::background::Kind;

/// Two proven errors this close, relative, are the same: searched on the same grid for the same delay.
const SAME_E: f64 = 1e-9;

/// Against a setting whose latency has no interval.
const TOO_FEW_DATA: &str = "too few data for an interval of its latency";

/// What a setting must keep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Largest share of missed ticks.
    pub missed_max: f64,
    /// Most CPU, of one core.
    pub cpu_max: f64,
}

/// A ratio of two latencies with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ratio {
    /// The other one's over the best one's.
    pub ratio: f64,
    /// Its lower limit; none with too few data.
    pub lower: Option<f64>,
    /// Its upper limit.
    pub upper: Option<f64>,
}

/// What somebody can choose, over all loads.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Setting {
    /// Ticks per second.
    pub rate_hz: f64,
    /// How the loop waits.
    pub wakeup: String,
    /// What it asks for.
    pub privileges: Rights,
    /// The row with the largest latency.
    pub worst_row: usize,
    /// That latency, ns.
    pub latency_ns: f64,
    /// The smallest proven |e| it allows, rad.
    pub e_proven_rad: Option<f64>,
    /// The limits of that.
    pub e_proven_limits: (Option<f64>, Option<f64>),
    /// Most missed ticks under any load, as a share.
    pub missed_share: f64,
    /// Most CPU under any load, of one core.
    pub cpu: Option<f64>,
    /// Why it can't be chosen; empty: it can.
    pub against: Vec<String>,
}

impl Setting {
    /// Such as `hybrid with privileges`, the mode as code.
    #[must_use]
    pub fn name(&self) -> String {
        format!("`{}` {}", self.wakeup, self.privileges.phrase())
    }

    fn feasible(&self) -> bool {
        self.against.is_empty()
    }

    /// Whether more data alone could make it feasible.
    fn wants_data(&self) -> bool {
        !self.against.is_empty() && self.against.iter().all(|why| why.starts_with(TOO_FEW_DATA))
    }

    fn figures(&self, quantile: Quantile, load: &str) -> String {
        format!(
            "deadline → torque {} {} (worst load: {load}), {} of ticks missed, {} of a core",
            quantile.name(),
            time(Some(self.latency_ns)),
            percent(Some(self.missed_share)),
            percent(self.cpu)
        )
    }
}

/// What is best at one rate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AtRate {
    /// Ticks per second.
    pub rate_hz: f64,
    /// Index of the chosen setting; none if nothing is feasible.
    pub best: Option<usize>,
    /// The next one by latency, and how many times as late it is.
    pub runner_up: Option<(usize, Ratio)>,
    /// Whether the best one differs from all others by more than chance.
    pub clear: bool,
    /// Whether too few data are why nothing is chosen.
    pub too_few_data: bool,
    /// All of this in words.
    pub words: String,
}

/// The recommendation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// Every setting.
    pub settings: Vec<Setting>,
    /// Each rate, in the order of the table.
    pub rates: Vec<AtRate>,
    /// Index of the setting to use; none if nothing is feasible.
    pub choice: Option<usize>,
    /// Whether ‖W‖ of the choice differs from that of the other rates by more than chance.
    pub clear: bool,
    /// The choice in words.
    pub words: String,
}

/// Computes the advice. `ratio` compares two rows: the latency of the second over that of the first.
pub fn advise(
    rows: &[Row],
    quantile: Quantile,
    limits: Limits,
    ratio: impl Fn(usize, usize) -> Option<Ratio>,
) -> Advice {
    let settings = settings(rows, limits);
    let mut rates: Vec<f64> = Vec::new();
    for setting in &settings {
        if !rates.iter().any(|rate| rate.to_bits() == setting.rate_hz.to_bits()) {
            rates.push(setting.rate_hz);
        }
    }
    let rates: Vec<AtRate> =
        rates.into_iter().map(|rate_hz| at_rate(rate_hz, &settings, rows, quantile, &ratio)).collect();
    let (choice, clear, mut words) = choose(&settings, &rates);
    if let Some(setting) = choice.map(|at| &settings[at]) {
        let figures = setting.figures(quantile, rows[setting.worst_row].load.name());
        words = format!("{words} In figures: {figures}.");
    }
    Advice { settings, rates, choice, clear, words }
}

/// The best setting for whoever expects one load alone.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ForLoad {
    /// That load.
    pub load: Kind,
    /// The setting; none if nothing is feasible.
    pub choice: Option<Setting>,
    /// The same in words.
    pub words: String,
}

/// The advice for each load by itself; nothing where there is one only.
pub fn for_each_load(
    rows: &[Row],
    quantile: Quantile,
    limits: Limits,
    ratio: impl Fn(usize, usize) -> Option<Ratio>,
) -> Vec<ForLoad> {
    let mut loads: Vec<Kind> = rows.iter().map(|row| row.load).collect();
    loads.sort_unstable();
    loads.dedup();
    let of_load = |load: Kind| {
        let places: Vec<usize> = (0..rows.len()).filter(|at| rows[*at].load == load).collect();
        let own: Vec<Row> = places.iter().map(|at| rows[*at].clone()).collect();
        let Advice { settings, choice, words, .. } = advise(&own, quantile, limits, |a, b| ratio(places[a], places[b]));
        let choice = choice.map(|at| settings[at].clone());
        let choice = choice.map(|setting| Setting { worst_row: places[setting.worst_row], ..setting });
        ForLoad { load, choice, words }
    };
    if loads.len() < 2 { Vec::new() } else { loads.into_iter().map(of_load).collect() }
}

/// Rows that differ in their load alone are one setting.
fn settings(rows: &[Row], limits: Limits) -> Vec<Setting> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    let same = |a: &Row, b: &Row| {
        a.rate_hz.to_bits() == b.rate_hz.to_bits() && a.wakeup == b.wakeup && a.privileges == b.privileges
    };
    for (at, row) in rows.iter().enumerate() {
        match groups.iter_mut().find(|group| same(&rows[group[0]], row)) {
            Some(group) => group.push(at),
            None => groups.push(vec![at]),
        }
    }
    groups.iter().map(|group| setting(rows, group, limits)).collect()
}

fn setting(rows: &[Row], group: &[usize], limits: Limits) -> Setting {
    let latency = |at: usize| rows[at].latency.map_or(f64::INFINITY, |latency| latency.value_ns);
    let worst = group.iter().copied().fold(group[0], |worst, at| if latency(at) > latency(worst) { at } else { worst });
    let of = |pick: fn(&Row) -> Option<f64>| group.iter().map(|at| pick(&rows[*at])).collect::<Option<Vec<f64>>>();
    let largest = |values: Vec<f64>| values.into_iter().fold(0.0, f64::max);
    let (missed, cpu) = (of(|row| row.missed_share).map(largest), of(|row| row.cpu).map(largest));
    let mut against: Vec<String> = Vec::new();
    if let Some(why) = group.iter().find_map(|at| rows[*at].not_to_be_had.as_ref()) {
        against.push(format!("not to be had: {why}"));
    } else {
        let mut under = |what: &str, with: fn(&Row) -> bool| {
            let loads: Vec<&str> =
                group.iter().filter(|at| with(&rows[**at])).map(|at| rows[*at].load.name()).collect();
            if !loads.is_empty() {
                against.push(format!("{what} under load {}", loads.join(", ")));
            }
        };
        under("not measured", |row| row.latency.is_none());
        under("nothing is certified at its latency", |row| row.latency.is_some() && row.e_proven_rad.is_none());
        under(TOO_FEW_DATA, |row| row.latency.is_some_and(|l| l.lower_ns.is_none() || l.upper_ns.is_none()));
    }
    if let Some(missed) = missed.filter(|missed| *missed > limits.missed_max) {
        let most = percent(Some(limits.missed_max));
        against.push(format!("{} of ticks missed, allowed: {most}", percent(Some(missed))));
    }
    match cpu {
        Some(cpu) if cpu > limits.cpu_max => {
            let most = percent(Some(limits.cpu_max));
            against.push(format!("{} of a core, allowed: {most}", percent(Some(cpu))));
        }
        None if against.is_empty() => against.push("its use of CPU could not be read".to_owned()),
        _ => {}
    }
    let row = &rows[worst];
    Setting {
        rate_hz: row.rate_hz,
        wakeup: row.wakeup.clone(),
        privileges: row.privileges,
        worst_row: worst,
        latency_ns: latency(worst),
        e_proven_rad: row.e_proven_rad,
        e_proven_limits: (row.e_proven_lower_rad, row.e_proven_upper_rad),
        missed_share: missed.unwrap_or(1.0),
        cpu,
        against,
    }
}

fn at_rate(
    rate_hz: f64,
    settings: &[Setting],
    rows: &[Row],
    quantile: Quantile,
    ratio: &impl Fn(usize, usize) -> Option<Ratio>,
) -> AtRate {
    let of_rate = || (0..settings.len()).filter(|at| settings[*at].rate_hz.to_bits() == rate_hz.to_bits());
    let mut feasible: Vec<usize> = of_rate().filter(|at| settings[*at].feasible()).collect();
    feasible.sort_by(|a, b| settings[*a].latency_ns.total_cmp(&settings[*b].latency_ns));
    let over = |fastest: usize, at: usize| ratio(settings[fastest].worst_row, settings[at].worst_row);
    let wants_data = |at: usize| settings[at].wants_data();
    let compared = |others: &[usize], fastest: usize| {
        others.iter().all(|at| over(fastest, *at).is_some_and(|ratio| ratio.lower.is_some() && ratio.upper.is_some()))
    };
    let too_few_data = match feasible.split_first() {
        Some((fastest, others)) => !compared(others, *fastest),
        None => of_rate().any(wants_data),
    };
    if too_few_data {
        let words = "no recommendation can be made from so few data: an interval takes 2 s (8 blocks of 250 ms) of every case; a \
                     longer --duration tells more."
            .to_owned();
        return AtRate { rate_hz, best: None, runner_up: None, clear: false, too_few_data, words };
    }
    let Some(&fastest) = feasible.first() else {
        // The others stand in the table of settings.
        let nearest = of_rate().min_by(|a, b| settings[*a].missed_share.total_cmp(&settings[*b].missed_share));
        let why = |at: usize| format!(": {}: {}", settings[at].name(), settings[at].against.join("; "));
        let words = format!("nothing is feasible. What misses the fewest ticks{}.", nearest.map_or(String::new(), why));
        return AtRate { rate_hz, best: None, runner_up: None, clear: true, too_few_data, words };
    };
    let over_fastest = |at: usize| over(fastest, at);
    let told_apart = |at: usize| over_fastest(at).and_then(|ratio| ratio.lower).is_some_and(|lower| lower > 1.0);
    let alike: Vec<usize> = feasible[1..].iter().copied().filter(|at| !told_apart(*at)).collect();
    let cpu = |at: usize| settings[at].cpu.unwrap_or(f64::INFINITY);
    let best = alike.iter().copied().fold(fastest, |best, at| if cpu(at) < cpu(best) { at } else { best });
    let runner_up = feasible.get(1).and_then(|at| Some((*at, over_fastest(*at)?)));
    let load = |at: usize| rows[settings[at].worst_row].load.name();
    let mut words = format!("{}: {}.", settings[best].name(), settings[best].figures(quantile, load(best)));
    match runner_up {
        Some((next, ratio)) if alike.is_empty() => {
            words.push_str(&format!(" Next is {}, {}.", settings[next].name(), times_as_late(&ratio)));
        }
        Some((next, ratio)) => {
            words.push_str(&format!(
                " No clear winner: {} has the least latency, next is {}, {}; of the {} that these data don't tell apart \
                 it takes the least CPU.",
                settings[fastest].name(),
                settings[next].name(),
                times_as_late(&ratio),
                alike.len() + 1
            ));
        }
        None => words.push_str(" No other setting is feasible at this rate."),
    }
    AtRate { rate_hz, best: Some(best), runner_up, clear: alike.is_empty(), too_few_data, words }
}

fn times_as_late(ratio: &Ratio) -> String {
    let interval = match (ratio.lower, ratio.upper) {
        (Some(lower), Some(upper)) => format!("95 %: {lower:.2} to {upper:.2}"),
        _ => "too few data for an interval".to_owned(),
    };
    format!("{:.2} times as late ({interval})", ratio.ratio)
}

/// Among the best of each rate the one with the smallest proven |e|; of equal ones that which takes less CPU.
fn choose(settings: &[Setting], rates: &[AtRate]) -> (Option<usize>, bool, String) {
    let proven = |at: usize| settings[at].e_proven_rad.unwrap_or(f64::INFINITY);
    let cpu = |at: usize| settings[at].cpu.unwrap_or(f64::INFINITY);
    let mut best: Vec<usize> = rates.iter().filter_map(|rate| rate.best).collect();
    best.sort_by(|a, b| proven(*a).total_cmp(&proven(*b)));
    let Some(&smallest) = best.first() else {
        let too_few_data = rates.iter().any(|rate| rate.too_few_data);
        let words = if too_few_data { "None: too few data." } else { "No setting of this study keeps the limits." };
        return (None, !too_few_data, words.to_owned());
    };
    let equal = best.iter().copied().filter(|at| proven(*at) <= proven(smallest) * (1.0 + SAME_E));
    let choice = equal.fold(smallest, |choice, at| if cpu(at) < cpu(choice) { at } else { choice });
    let rate = |at: usize| loopbound_scenario::format_rate(settings[at].rate_hz);
    let mut words = format!(
        "{}, {}: the smallest |e| that is proven at its latency is {:.4} rad.",
        rate(choice),
        settings[choice].name(),
        proven(choice)
    );
    let Some(next) = best.iter().copied().find(|at| *at != choice) else { return (Some(choice), true, words) };
    let limits = (settings[choice].e_proven_limits.1, settings[next].e_proven_limits.0);
    let clear = limits.0.zip(limits.1).is_some_and(|(upper, lower)| upper < lower);
    words.push_str(&format!(" The next rate is {}, {:.2} times that", rate(next), proven(next) / proven(choice)));
    words.push_str(if clear { "." } else { ": no clear winner, their intervals overlap or are not known." });
    (Some(choice), clear, words)
}
