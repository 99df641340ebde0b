//! What the paper claims, and what the table says of it. Every number and every verdict is computed from the findings.

use super::cases::Case;
use super::measure::Measured;
use super::paper::{Findings, TradeOff};
use super::table::{Table, short};

/// "Much more", as a ratio of errors.
const MUCH: f64 = 2.0;
/// Above this chattering index a loop oscillates; those that don't stay below 2 without noise.
const OSCILLATES: f64 = 5.0;

/// The judgement of one claim.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// What the paper says, and where.
    pub claim: String,
    /// True, false, or under which condition.
    pub answer: String,
    /// The numbers.
    pub why: String,
}

/// The verdicts on all claims.
#[must_use]
pub fn of(found: &Findings) -> Vec<Verdict> {
    let table = &found.table;
    let mut all = Vec::new();
    for ctc in table.laws().iter().filter(|law| law.starts_with("ctc")) {
        all.push(superiority(table, ctc));
    }
    all.push(noise_and_disturbance(table));
    all.push(stability(table));
    all.push(convergence(table));
    all.push(ultimate_bound(table));
    all.push(no_model(table));
    all.push(feed_forward(table));
    all.push(high_c1(&found.trade_off));
    all.push(low_c1(&found.trade_off));
    all
}

fn verdict(claim: impl Into<String>, answer: impl Into<String>, why: impl Into<String>) -> Verdict {
    Verdict { claim: claim.into(), answer: answer.into(), why: why.into() }
}

fn truth(holds: bool) -> &'static str {
    if holds { "true" } else { "false" }
}

/// The smallest ratio over the links of the error of `law` to that of `robust`: above 1 it is worse on each link.
fn ratio(table: &Table, case: Case, law: &str) -> Option<f64> {
    let (other, robust) = (table.get(case, law)?, table.get(case, "robust")?);
    match (other.lost_at_s.is_some(), robust.lost_at_s.is_some()) {
        (true, true) => None,
        (true, false) => Some(f64::INFINITY),
        (false, true) => Some(0.0),
        (false, false) => other.e_max_rad.iter().zip(&robust.e_max_rad).map(|(a, b)| a / b).min_by(f64::total_cmp),
    }
}

fn superiority(table: &Table, ctc: &str) -> Verdict {
    let claim =
        format!("\"Error in case of CTC is much more than robust … for each link\" (Figures 6, 7), against {ctc}");
    let (mut holds, mut slightly, mut fails) = (Vec::new(), Vec::new(), Vec::new());
    for case in table.cases() {
        let Some(ratio) = ratio(table, case, ctc) else { continue };
        let text = match ratio {
            lost if lost.is_infinite() => format!("{} (lost)", case.name()),
            0.0 => format!("{} (robust is lost)", case.name()),
            _ => format!("{} ({}×)", case.name(), short(ratio)),
        };
        match ratio {
            much if much >= MUCH => holds.push(text),
            more if more > 1.0 => slightly.push(text),
            _ => fails.push(text),
        }
    }
    let total = holds.len() + slightly.len() + fails.len();
    let answer = match (holds.len(), fails.len() + slightly.len()) {
        (0, _) => "false in every case".to_owned(),
        (_, 0) => "true in every case".to_owned(),
        (count, _) => format!("true in {count} of {total} cases"),
    };
    let part = |name: &str, list: &[String]| {
        if list.is_empty() { String::new() } else { format!("{name}: {}. ", list.join(", ")) }
    };
    let why = format!(
        "Error of {ctc} over that of robust, least ratio of all links. {}{}{}",
        part("Much more", &holds),
        part("More", &slightly),
        part("Not more on every link", &fails)
    );
    verdict(claim, answer, why.trim_end())
}

/// How much a law's error grows from the exact case.
fn growth(table: &Table, case: Case, law: &str) -> f64 {
    let worst = |case| table.get(case, law).map_or(f64::NAN, Measured::worst_e_rad);
    worst(case) / worst(Case::Exact)
}

fn noise_and_disturbance(table: &Table) -> Verdict {
    let (disturbed, noisy) = (growth(table, Case::Disturbance, "robust"), growth(table, Case::Noise, "robust"));
    let chatter = |law: &str| table.get(Case::Noise, law).map_or(f64::NAN, |m| m.chattering);
    let smooth = chatter("robust") <= chatter("ctc 25/10");
    let answer = match (disturbed < MUCH && noisy < MUCH, smooth) {
        (true, true) => "true",
        (true, false) => "true of the error, false of the torque",
        (false, _) => "false",
    };
    let why = format!(
        "The error grows to {}× under disturbance (ctc 25/10: {}×) and {}× under noise; but noise makes the torque chatter \
         with index {} (ctc 25/10: {}).",
        short(disturbed),
        short(growth(table, Case::Disturbance, "ctc 25/10")),
        short(noisy),
        short(chatter("robust")),
        short(chatter("ctc 25/10")),
    );
    verdict("\"Robust term takes care of noise and disturbances\" (Figure 1)", answer, why)
}

/// The largest latency up to which a law does not oscillate, s.
fn latency_borne(table: &Table, law: &str) -> f64 {
    let mut borne = 0.0;
    for case in table.cases() {
        if let Case::Latency(s) = case {
            let calm = |m: &Measured| m.lost_at_s.is_none() && m.chattering < OSCILLATES;
            if !table.get(case, law).is_some_and(calm) {
                break;
            }
            borne = s;
        }
    }
    borne
}

fn stability(table: &Table) -> Verdict {
    let borne: Vec<(String, f64)> =
        table.laws().into_iter().map(|law| (law.clone(), latency_borne(table, &law))).collect();
    let of = |name: &str| borne.iter().find(|(law, _)| law == name).map_or(f64::NAN, |(_, s)| *s);
    let list: Vec<String> = borne.iter().map(|(law, s)| format!("{law} {} ms", s * 1e3)).collect();
    let answer = if of("robust") < of("ctc 25/10") {
        "false where latency counts"
    } else {
        truth(of("robust") > of("ctc 25/10"))
    };
    let why = format!(
        "Largest latency of the table without oscillation: {}. The high gain that makes the error small uses up [11].",
        list.join(", ")
    );
    verdict("\"The proposed robust control law improved … stability of the system\" (conclusion)", answer, why)
}

fn convergence(table: &Table) -> Verdict {
    let Some(exact) = table.get(Case::Exact, "robust") else { return verdict("e → 0", "not run", "") };
    let why = format!(
        "With an exact model and no disturbance robust keeps an error of {} rad (RMS {}): it has no model, so gravity is a \
         lasting disturbance. (18) says ultimate boundedness, no more.",
        short(exact.worst_e_rad()),
        short(exact.rms_e_rad())
    );
    verdict("\"Error dynamics e → 0\" (after (2))", truth(exact.worst_e_rad() < 1e-6), why)
}

fn ultimate_bound(table: &Table) -> Verdict {
    let used: Vec<(String, f64)> = table
        .rows
        .iter()
        .filter(|row| !matches!(row.case, Case::Latency(_)))
        .filter_map(|row| Some((format!("{}, {}", row.law, row.case.name()), row.measured.bound_used()?)))
        .collect();
    let worst = used.iter().max_by(|a, b| a.1.total_cmp(&b.1));
    let Some((name, most)) = worst else { return verdict("ultimate bound", "no case is certified", "") };
    let why = format!(
        "{} of the runs without latency are certified; the measured error uses at most {:.0} % of the certified one \
         ({name}), so the bound is sound and not tight. (20) is the radius outside which V falls, [9] the bound.",
        used.len(),
        most * 100.0
    );
    let answer = if *most <= 1.0 { "true, with [9] in place of (20)" } else { "false" };
    verdict("The error is ultimately bounded by a number known beforehand ((18) to (20))", answer, why)
}

fn no_model(table: &Table) -> Verdict {
    let masses: Vec<Case> = table.cases().into_iter().filter(|case| matches!(case, Case::Mass(_))).collect();
    let worst = |law: &str| masses.iter().map(|case| growth(table, *case, law)).fold(0.0, f64::max);
    let (robust, ctc) = (worst("robust"), worst("ctc 25/10"));
    let why = format!(
        "Wrong masses multiply the error by at most {} (robust) and {} (ctc 25/10).",
        short(robust),
        short(ctc)
    );
    verdict("The robust law needs no model of the plant (16)", truth(robust < MUCH), why)
}

fn feed_forward(table: &Table) -> Verdict {
    let (mut better, mut total) = (0, 0);
    for case in table.cases() {
        let worst = |law: &str| table.get(case, law).map(Measured::worst_e_rad);
        if let (Some(ff), Some(robust)) = (worst("robust-ff"), worst("robust")) {
            total += 1;
            better += i32::from(ff < robust);
        }
    }
    let answer =
        if better == total { "false in every case".to_owned() } else { format!("false in {better} of {total} cases") };
    let ratio = |case| growth_between(table, case, "robust", "robust-ff");
    let why = format!(
        "The same gain with the model fed forward (robust-ff: (9) with its v_R) has the smaller error in {better} of {total} \
         cases: {}× smaller with an exact model, {}× with masses 20 % wrong, {}× under disturbance.",
        short(ratio(Case::Exact)),
        short(ratio(Case::Mass(0.2))),
        short(ratio(Case::Disturbance))
    );
    verdict("Dropping the model from (9) for (16) costs nothing", answer, why)
}

fn growth_between(table: &Table, case: Case, above: &str, below: &str) -> f64 {
    let worst = |law: &str| table.get(case, law).map_or(f64::NAN, Measured::worst_e_rad);
    worst(above) / worst(below)
}

/// The points of the lowest rate, by C1.
fn slowest(points: &[TradeOff]) -> Vec<&TradeOff> {
    let rate = points.iter().map(|p| p.rate_hz).fold(f64::INFINITY, f64::min);
    points.iter().filter(|p| (p.rate_hz - rate).abs() < 1e-9).collect()
}

fn high_c1(points: &[TradeOff]) -> Verdict {
    let claim = "\"Too high upper bound parameter can cause higher chattering, input saturation\" (introduction)";
    let slow = slowest(points);
    let (Some(first), Some(last)) = (slow.first(), slow.last()) else { return verdict(claim, "not run", "") };
    let saturates = slow.iter().find(|p| p.measured.saturated > 0.01);
    let chatters = last.measured.chattering > MUCH * first.measured.chattering;
    let boundary = first
        .c1_at_boundary_nm
        .map_or_else(String::new, |c1| format!("; [11] predicts the loss of stability at {} N·m", short(c1)));
    let why = format!(
        "At {:.0} Hz the chattering index goes from {} (C1 = {}) to {} (C1 = {}), and actuators saturate in more than 1 % \
         of the ticks {}{boundary}. The cause is the sampling: at four times the rate the same C1 does so later.",
        first.rate_hz,
        short(first.measured.chattering),
        short(first.c1_nm),
        short(last.measured.chattering),
        short(last.c1_nm),
        saturates.map_or_else(|| "nowhere".to_owned(), |p| format!("from C1 = {} N·m on", short(p.c1_nm))),
    );
    verdict(claim, truth(chatters && saturates.is_some()), why)
}

fn low_c1(points: &[TradeOff]) -> Verdict {
    let claim =
        "\"A proper uncertainty bound parameter is preferred in order to improve the performance\" (introduction)";
    let slow = slowest(points);
    let best = slow.iter().min_by(|a, b| a.measured.worst_e_rad().total_cmp(&b.measured.worst_e_rad()));
    let (Some(first), Some(best)) = (slow.first(), best) else { return verdict(claim, "not run", "") };
    let why = format!(
        "At {:.0} Hz the error falls from {} rad at C1 = {} N·m to {} rad at {} N·m, the best of the sweep; [6] asks for {} \
         N·m, beyond which C1 buys accuracy and not validity.",
        first.rate_hz,
        short(first.measured.worst_e_rad()),
        short(first.c1_nm),
        short(best.measured.worst_e_rad()),
        short(best.c1_nm),
        short(best.c1_required_nm),
    );
    let inside = (best.c1_nm - first.c1_nm).abs() > 0.0 && slow.last().is_some_and(|last| last.c1_nm > best.c1_nm);
    verdict(claim, truth(inside), why)
}
