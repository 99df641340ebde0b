//! The pictures of the paper's study: its Figures 4 to 7, the table as a map, and the trade-off of C1.

use loopbound_monitor::chart::{Axis, Figure, HeatMap, Panel, Scale, Series, Style};

use super::measure::{Measured, TracePoint};
use super::paper::TradeOff;
use super::table::{Table, short};

/// Figures 4 and 5: each link and its reference.
#[must_use]
pub fn tracking(title: &str, law: &str, run: &Measured) -> Figure {
    let links = run.e_max_rad.len();
    let series = |name: &str, colour, pick: &dyn Fn(&TracePoint) -> f64| {
        Series::line(name, colour, run.trace.iter().map(|p| (p.t_s, pick(p))).collect())
    };
    let panels = (0..links).map(|link| {
        let label = if link + 1 == links { "t (s)" } else { "" };
        Panel::lines(
            format!("({}) link {}", letter(link), link + 1),
            Axis::linear(label).within(0.0, last_s(run)),
            Axis::linear("angle (rad)"),
            vec![series(law, 0, &|p| p.q[link]), series("reference", 1, &|p| p.q_d[link]).styled(Style::Dashed)],
        )
    });
    Figure { title: title.to_owned(), panels: panels.collect(), panel_height_px: 140, ..Figure::default() }
}

/// Figures 6 and 7: errors of position and velocity. `limits`: largest |e| and |ė| of the axes, so that two figures
/// can be compared.
#[must_use]
pub fn errors(title: &str, run: &Measured, limits: (f64, f64)) -> Figure {
    let links = run.e_max_rad.len();
    let series = |pick: fn(&TracePoint) -> &Vec<f64>| {
        (0..links)
            .map(|link| {
                let points = run.trace.iter().map(|p| (p.t_s, pick(p)[link])).collect();
                Series::line(format!("link {}", link + 1), link, points)
            })
            .collect::<Vec<_>>()
    };
    let x = |label: &str| Axis::linear(label).within(0.0, last_s(run));
    let panels = vec![
        Panel::lines("(a) position", x(""), Axis::linear("e (rad)").within(-limits.0, limits.0), series(|p| &p.e)),
        Panel::lines(
            "(b) velocity",
            x("t (s)"),
            Axis::linear("ė (rad/s)").within(-limits.1, limits.1),
            series(|p| &p.ed),
        ),
    ];
    Figure { title: title.to_owned(), panels, ..Figure::default() }
}

/// What axes of [`errors`] need for some runs.
#[must_use]
pub fn error_limits(runs: &[&Measured]) -> (f64, f64) {
    let largest = |pick: fn(&TracePoint) -> &Vec<f64>| {
        let all = runs.iter().flat_map(|run| run.trace.iter()).flat_map(|p| pick(p).iter());
        1.05 * all.fold(1e-6, |most: f64, x| most.max(x.abs()))
    };
    (largest(|p| &p.e), largest(|p| &p.ed))
}

/// The absolute error once settled, on a logarithmic axis: what Figures 6 and 7 can't show.
#[must_use]
pub fn settled_errors(title: &str, runs: &[(&str, &Measured)]) -> Figure {
    let series = runs.iter().enumerate().map(|(colour, (name, run))| {
        let norm = |e: &[f64]| e.iter().map(|e| e * e).sum::<f64>().sqrt();
        Series::line(*name, colour, run.trace.iter().map(|p| (p.t_s, norm(&p.e))).collect())
    });
    let end = runs.first().map_or(1.0, |(_, run)| last_s(run));
    let panel = Panel::lines("", Axis::linear("t (s)").within(0.0, end), Axis::log("|e| (rad)"), series.collect());
    Figure { title: title.to_owned(), panels: vec![panel], panel_height_px: 260, ..Figure::default() }
}

/// The largest error of every law in every case.
#[must_use]
pub fn error_map(title: &str, table: &Table) -> Figure {
    let (cases, laws) = (table.cases(), table.laws());
    let cell = |case, law: &String| table.get(case, law).map_or(f64::NAN, Measured::worst_e_rad);
    let values: Vec<Vec<f64>> = cases.iter().map(|case| laws.iter().map(|law| cell(*case, law)).collect()).collect();
    let label = |value: &f64| if value.is_finite() { short(*value) } else { "lost".to_owned() };
    let map = HeatMap {
        rows: cases.iter().map(|case| case.name()).collect(),
        labels: values.iter().map(|row| row.iter().map(label).collect()).collect(),
        columns: laws,
        values,
        scale: Scale::Log,
    };
    Figure { title: title.to_owned(), panels: vec![Panel::heat("", map)], ..Figure::default() }
}

/// C1 against error, chattering and saturation; dashed verticals where \[6] begins to hold and where \[11] ends.
#[must_use]
pub fn trade_off(title: &str, points: &[TradeOff]) -> Figure {
    let mut rates: Vec<f64> = points.iter().map(|p| p.rate_hz).collect();
    rates.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    let panel = |name: &str, x: &str, y: Axis, pick: &dyn Fn(&TradeOff) -> f64| {
        let of_rate = |rate: f64| points.iter().filter(move |p| (p.rate_hz - rate).abs() < 1e-9);
        let mut series: Vec<Series> = rates
            .iter()
            .enumerate()
            .map(|(colour, rate)| {
                let line = of_rate(*rate).map(|p| (p.c1_nm, pick(p))).collect();
                Series::line(format!("{:.0} kHz", rate / 1e3), colour, line).styled(Style::MarkedLine)
            })
            .collect();
        let drawn = || points.iter().map(pick).filter(|y| y.is_finite() && *y > 0.0);
        let (low, high) = (drawn().fold(f64::INFINITY, f64::min), drawn().fold(0.0, f64::max));
        let mut vertical = |name: String, colour, at: f64| {
            series.push(Series::line(name, colour, vec![(at, low), (at, high)]).styled(Style::Dashed));
        };
        if let Some(point) = points.first() {
            vertical("[6]: C1 needed".to_owned(), 7, point.c1_required_nm);
        }
        for (colour, rate) in rates.iter().enumerate() {
            if let Some(at) = of_rate(*rate).find_map(|p| p.c1_at_boundary_nm) {
                vertical(format!("[11] at {:.0} kHz", rate / 1e3), colour, at);
            }
        }
        Panel::lines(name, Axis::log(x), y, series)
    };
    let panels = vec![
        panel("(a) tracking error once settled", "", Axis::log("max |e| (rad)"), &|p| p.measured.worst_e_rad()),
        panel("(b) chattering index", "", Axis::log("1 = smooth"), &|p| p.measured.chattering),
        panel("(c) saturation", "C1 (N·m)", Axis::linear("% of ticks"), &|p| p.measured.saturated * 100.0),
    ];
    Figure { title: title.to_owned(), panels, panel_height_px: 150, ..Figure::default() }
}

fn last_s(run: &Measured) -> f64 {
    run.trace.last().map_or(1.0, |p| p.t_s.ceil())
}

fn letter(at: usize) -> char {
    char::from(b'a' + u8::try_from(at).unwrap_or(25).min(25))
}
