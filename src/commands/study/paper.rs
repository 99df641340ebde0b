//! `loopbound study paper`: the paper's Figures 4 to 7, every law in every case, and a verdict on each claim.

use std::fmt::Write as _;
use std::io::Write as _;

use loopbound_model::certificate::sampling::sampling_budget;
use loopbound_model::law::LawKind;
use loopbound_model::quote;
use loopbound_model::with_links;
use loopbound_scenario::system;
use loopbound_scenario::{Hertz, PerLink, Scenario, ScenarioError};
use loopbound_shared::say;

use super::cases::{Base, Case, NOISE, Variant, nanos, variants};
use super::folder::{Asked, Folder, picture_files};
use super::measure::{Measured, measure};
use super::table::{Row, Table, short};
use super::{PaperArgs, figures, on_all_cores, verdicts};
use crate::exit::{Exit, Failure};

/// Limit of each actuator in the trade-off of C1, N·m: three times what gravity asks of the first link.
const TRADE_OFF_LIMIT_NM: f64 = 75.0;
/// Ticks between points of a picture.
const TRACE_EVERY: u64 = 20;

/// `robust` with one C1.
#[derive(Clone, Debug, PartialEq)]
pub struct TradeOff {
    /// C1, N·m.
    pub c1_nm: f64,
    /// Ticks per second.
    pub rate_hz: f64,
    /// K_t = K2 + κ + K3 C1², N·m·s.
    pub k_t: f64,
    /// What C1 must cover, N·m. \[6]
    pub c1_required_nm: f64,
    /// C1 at which \[11] has no room left at this rate, N·m; none if that is so for every C1.
    pub c1_at_boundary_nm: Option<f64>,
    /// What came out.
    pub measured: Measured,
}

/// Everything that the study found for one number of links.
#[derive(Clone, Debug, PartialEq)]
pub struct Findings {
    /// Number of links.
    pub links: usize,
    /// What all cases begin from.
    pub base: Base,
    /// Every law in every case.
    pub table: Table,
    /// C1 against error, chattering and saturation.
    pub trade_off: Vec<TradeOff>,
}

/// Runs the study, writes its folder and prints the verdicts.
///
/// # Errors
/// If the folder can't be written.
pub fn run(args: &PaperArgs) -> anyhow::Result<Exit> {
    let path_of =
        |links: usize| if args.links.len() == 1 { args.out.clone() } else { args.out.join(format!("n{links}")) };
    let asked = |&links: &usize| Asked::new(&path_of(links), "study-paper", &files()).map(|folder| (links, folder));
    // All of them before the first takes its minutes.
    let asked = args.links.iter().map(asked).collect::<Result<Vec<_>, _>>()?;
    for (links, folder) in asked {
        let found = with_links!(links, study::<N>(args.quick)).map_err(|e| Failure::usage(e.to_string()))?;
        let mut folder = folder.take()?;
        write(&mut folder, &found)?;
        let path = folder.finish()?;
        let mut out = say::stdout();
        writeln!(out, "{links} links\n\n{}\nwritten to {}", verdicts_text(&found), quote::path(&path))?;
    }
    Ok(Exit::Held)
}

/// Runs all cases of `N` links.
///
/// # Errors
/// If a scenario of the study describes no system.
pub fn study<const N: usize>(quick: bool) -> Result<Findings, ScenarioError> {
    let base = Base::new::<N>(quick)?;
    let table = table::<N>(&base, &variants(), &Case::ALL, TRACE_EVERY)?;
    let trade_off = trade_off::<N>(&base, quick)?;
    Ok(Findings { links: N, base, table, trade_off })
}

/// The laws in the cases.
///
/// # Errors
/// If a scenario of the study describes no system.
pub fn table<const N: usize>(
    base: &Base,
    laws: &[Variant],
    cases: &[Case],
    trace_every: u64,
) -> Result<Table, ScenarioError> {
    let pairs: Vec<(Case, &Variant)> = cases.iter().flat_map(|case| laws.iter().map(|law| (*case, law))).collect();
    let runs = on_all_cores(&pairs, |(case, law)| {
        let scenario = base.scenario::<N>(law, *case)?;
        let trace_every = if *case == Case::Exact { trace_every } else { 0 };
        Ok(Row { case: *case, law: law.name.clone(), measured: measure::<N>(&scenario, trace_every)? })
    });
    Ok(Table { rows: runs.into_iter().collect::<Result<_, ScenarioError>>()? })
}

/// `robust` with C1 from an eighth of what \[6] requires to eight times that, or to twice what \[11] allows if that is
/// more, under noise and with limited actuators, at the study's rate and at four times that.
///
/// # Errors
/// If a scenario of the study describes no system.
fn trade_off<const N: usize>(base: &Base, quick: bool) -> Result<Vec<TradeOff>, ScenarioError> {
    let rate_hz = base.scenario.loop_.rate.0;
    let required = system::certificate_of::<N>(&base.scenario, LawKind::Robust)?.c1_required();
    // The certificate's level, and with it κ, does not depend on C1.
    let (_, boundary_nm) = at_boundary::<N>(&trade_off_scenario(base, rate_hz, required))?;
    let (low, high) = (1.0 / 8.0, boundary_nm.map_or(8.0, |c1| (2.0 * c1 / required).max(8.0)));
    let steps = if quick { 13 } else { 25 };
    let factors =
        (0..steps).map(|step| low * libm::exp2(libm::log2(high / low) * f64::from(step) / f64::from(steps - 1)));
    let points: Vec<(f64, f64)> = [1.0, 4.0]
        .iter()
        .flat_map(|rate| factors.clone().map(move |factor| (rate * rate_hz, factor * required)))
        .collect();
    let found = on_all_cores(&points, |&(rate_hz, c1_nm)| {
        let scenario = trade_off_scenario(base, rate_hz, c1_nm);
        let (k_t, c1_at_boundary_nm) = at_boundary::<N>(&scenario)?;
        Ok(TradeOff {
            c1_nm,
            rate_hz,
            k_t,
            c1_required_nm: required,
            c1_at_boundary_nm,
            measured: measure::<N>(&scenario, 0)?,
        })
    });
    found.into_iter().collect()
}

/// K_t of a scenario, and the C1 at which \[11] without delay has no room left.
fn at_boundary<const N: usize>(scenario: &Scenario) -> Result<(f64, Option<f64>), ScenarioError> {
    let certificate = system::certificate_of::<N>(scenario, LawKind::Robust)?;
    let used = sampling_budget(&certificate, scenario.period_ns() as f64 * 1e-9, 0.0).map(|budget| budget.used);
    let left = used.zip(certificate.on_r()).map(|(used, of)| (of.k_t / used - of.k2 - of.kappa) / of.k3);
    Ok((certificate.k_t(), left.filter(|left| *left > 0.0).map(f64::sqrt)))
}

fn trade_off_scenario(base: &Base, rate_hz: f64, c1_nm: f64) -> Scenario {
    let mut scenario = base.scenario.clone();
    scenario.loop_.rate = Hertz(rate_hz);
    scenario.loop_.duration = nanos(12.0f64.min(scenario.loop_.duration.seconds()));
    scenario.loop_.settle = Some(nanos(scenario.loop_.duration.seconds() / 2.0));
    scenario.controller.gains.c1 = Some(c1_nm);
    scenario.plant.noise.q_rad = NOISE;
    scenario.plant.noise.v_rad_s = NOISE;
    let links = scenario.links() as f64;
    scenario.plant.torque_limit_nm = Some(PerLink::All(TRADE_OFF_LIMIT_NM * links / 3.0));
    scenario
}

const PICTURES: [&str; 7] = ["figure-4", "figure-5", "figure-6", "figure-7", "errors", "map", "trade-off"];
const TEXTS: [&str; 3] = ["table.csv", "trade-off.csv", "report.md"];

fn files() -> Vec<String> {
    let texts = TEXTS.into_iter().map(str::to_owned);
    texts.chain(PICTURES.into_iter().flat_map(picture_files)).collect()
}

fn write(folder: &mut Folder, found: &Findings) -> anyhow::Result<()> {
    let mut picture = |name: &str, figure| folder.picture(name, &figure);
    let nothing = Measured::default();
    let exact = |law: &str| found.table.get(Case::Exact, law).unwrap_or(&nothing);
    let (robust, ctc) = (exact("robust"), exact("ctc 25/10"));
    let limits = figures::error_limits(&[robust, ctc]);
    picture("figure-4", figures::tracking("Figure 4. Tracking, robust law, exact model", "robust", robust))?;
    picture("figure-5", figures::tracking("Figure 5. Tracking, computed torque, exact model", "ctc 25/10", ctc))?;
    picture("figure-6", figures::errors("Figure 6. Errors, computed torque, exact model", ctc, limits))?;
    picture("figure-7", figures::errors("Figure 7. Errors, robust law, exact model", robust, limits))?;
    let laws = found.table.laws();
    let all: Vec<(&str, &Measured)> = laws.iter().map(|law| (law.as_str(), exact(law))).collect();
    picture("errors", figures::settled_errors("Error of every law, exact model", &all))?;
    picture("map", figures::error_map("Largest error of a link once settled (rad)", &found.table))?;
    picture("trade-off", figures::trade_off("The uncertainty bound C1 has a price at both ends", &found.trade_off))?;
    folder.write("table.csv", found.table.to_csv())?;
    folder.write("trade-off.csv", trade_off_csv(&found.trade_off))?;
    folder.write("report.md", report(found))
}

fn trade_off_csv(points: &[TradeOff]) -> String {
    let mut csv = String::from(
        "rate_hz,c1_nm,k_t,c1_required_nm,c1_at_boundary_nm,e_max_rad,chattering,saturated,torque_peak_nm\n",
    );
    for p in points {
        let boundary = p.c1_at_boundary_nm.map_or_else(String::new, |c1| format!("{c1:.4e}"));
        let m = &p.measured;
        let _ = writeln!(
            csv,
            "{:.0},{:.4e},{:.4e},{:.4e},{boundary},{:.4e},{:.4e},{:.4e},{:.4e}",
            p.rate_hz,
            p.c1_nm,
            p.k_t,
            p.c1_required_nm,
            m.worst_e_rad(),
            m.chattering,
            m.saturated,
            m.torque_peak_nm
        );
    }
    csv
}

fn verdicts_text(found: &Findings) -> String {
    let mut text = String::new();
    for verdict in verdicts::of(found) {
        let _ = writeln!(text, "{}\n  {}: {}\n", verdict.claim, verdict.answer, verdict.why);
    }
    text
}

fn report(found: &Findings) -> String {
    let loop_ = &found.base.scenario.loop_;
    let mut text = format!(
        "# The paper's case with {} link(s)\n\nLockstep at {:.0} Hz for {:.0} s; errors, effort and chattering count from \
         {:.0} s on. Both robust laws have K_t = {} N·m·s and β = {} 1/s in every case.\n\n## The paper's claims\n\n\
         | claim | verdict | measured |\n|---|---|---|\n",
        found.links,
        loop_.rate_hz(),
        loop_.duration.seconds(),
        loop_.settle_ns() as f64 * 1e-9,
        short(found.base.k_t),
        found.base.scenario.controller.gains.beta,
    );
    for verdict in verdicts::of(found) {
        let cell = |text: &str| text.replace('|', "\\|");
        let _ = writeln!(text, "| {} | **{}** | {} |", cell(&verdict.claim), verdict.answer, cell(&verdict.why));
    }
    text.push_str("\n## Pictures\n\n");
    for (name, alt) in [
        ("figure-4", "Tracking, robust law"),
        ("figure-5", "Tracking, computed torque"),
        ("figure-6", "Errors, computed torque"),
        ("figure-7", "Errors, robust law"),
        ("errors", "Error of every law, exact model"),
        ("map", "Largest error, every law and case"),
        ("trade-off", "C1 against error, chattering and saturation"),
    ] {
        let _ = writeln!(text, "![{alt}]({name}.svg)\n");
    }
    text.push_str("## Every law in every case\n\n");
    text.push_str(&found.table.to_markdown());
    text.push_str(
        "\n*effort*: RMS of |τ|. *peak*: largest |τ_i| of the whole run, start included. *chattering*: way that the torque \
         goes, over the way of the torque that follows the reference exactly; 1 is perfectly smooth. *used*: measured \
         sup |e| over the certified limsup [9]. *[11] used*: share of the room that period and latency take.\n",
    );
    text
}
