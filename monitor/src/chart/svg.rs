//! A figure as SVG.

use std::fmt::Write as _;

use super::axis::Laid;
use super::theme::{self, COLOURS, FONTS};
use super::{Content, Figure, HeatMap, Panel, Series, Style, Theme};

const WIDTH_PX: f64 = 860.0;
const PANEL_HEIGHT_PX: f64 = 200.0;
const LEFT_PX: f64 = 74.0;
const RIGHT_PX: f64 = 18.0;
const TOP_PX: f64 = 14.0;
const FIGURE_TITLE_PX: f64 = 30.0;
const PANEL_TITLE_PX: f64 = 24.0;
const BELOW_PX: f64 = 48.0;
const LEGEND_LINE_PX: f64 = 20.0;
const LEGEND_SAMPLE_PX: f64 = 30.0;
const ROW_PX: f64 = 26.0;
/// Mean width of a letter of the 12 px font.
const LETTER_PX: f64 = 7.0;
/// More points than this in a line are not told apart on any screen.
const POINTS_MAX: usize = 2000;

/// Where the data of a panel lie.
#[derive(Clone, Copy)]
struct Area {
    x: f64,
    y: f64,
    width: f64,
    height: f64,
}

/// The figure as an SVG document.
#[must_use]
pub fn to_svg(figure: &Figure, theme: Theme) -> String {
    let legend = legend_of(figure);
    let longest = legend.iter().map(|series| series.name.chars().count()).max().unwrap_or(0);
    let legend_width = if legend.is_empty() { 0.0 } else { longest as f64 * LETTER_PX + LEGEND_SAMPLE_PX + 22.0 };
    let width = if figure.width_px > 0 { f64::from(figure.width_px) } else { WIDTH_PX };
    let panel_height = if figure.panel_height_px > 0 { f64::from(figure.panel_height_px) } else { PANEL_HEIGHT_PX };
    let top = TOP_PX + if figure.title.is_empty() { 0.0 } else { FIGURE_TITLE_PX };
    let (mut body, mut y) = (String::new(), top);
    if !figure.title.is_empty() {
        text(&mut body, Place { x: LEFT_PX, y: TOP_PX + 14.0, anchor: "start" }, "lb-t", 15.0, true, &figure.title);
    }
    let first_data_y = y + figure.panels.first().map_or(0.0, title_height);
    for (at, panel) in figure.panels.iter().enumerate() {
        y += title_height(panel);
        let left = LEFT_PX.max(heat_left(panel));
        let mut area = Area { x: left, y, width: width - left - RIGHT_PX - legend_width, height: panel_height };
        if !panel.title.is_empty() {
            text(&mut body, Place { x: area.x, y: y - 8.0, anchor: "start" }, "lb-t", 12.5, true, &panel.title);
        }
        match &panel.content {
            Content::Lines(series) => lines(&mut body, at, panel, series, area),
            Content::Heat(map) => {
                area.height = map.rows.len() as f64 * ROW_PX;
                heat(&mut body, map, area);
            }
        }
        y += area.height + BELOW_PX;
    }
    let mut legend_y = first_data_y + 6.0;
    for series in &legend {
        legend_entry(&mut body, series, width - legend_width, legend_y);
        legend_y += LEGEND_LINE_PX;
    }
    let height = y.max(legend_y + 8.0);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} \
         {height:.0}\" font-family=\"{FONTS}\" class=\"lb-chart\" role=\"img\">\n<title>{}</title>\n<style>\n{}</style>\n\
         <rect class=\"lb-p\" width=\"100%\" height=\"100%\"/>\n{body}</svg>\n",
        escape(&figure.title),
        theme::style(theme)
    )
}

fn title_height(panel: &Panel) -> f64 {
    if panel.title.is_empty() { 0.0 } else { PANEL_TITLE_PX }
}

fn heat_left(panel: &Panel) -> f64 {
    let Content::Heat(map) = &panel.content else { return 0.0 };
    let longest = map.rows.iter().map(|row| row.chars().count()).max().unwrap_or(0);
    longest as f64 * LETTER_PX + 16.0
}

/// The series that the legend lists, each name once.
fn legend_of(figure: &Figure) -> Vec<&Series> {
    let mut listed: Vec<&Series> = Vec::new();
    for panel in &figure.panels {
        let Content::Lines(series) = &panel.content else { continue };
        for one in series.iter().filter(|one| !one.name.is_empty()) {
            if !listed.iter().any(|other| other.name == one.name) {
                listed.push(one);
            }
        }
    }
    listed
}

fn lines(out: &mut String, at: usize, panel: &Panel, series: &[Series], area: Area) {
    let all = |pick: fn(&(f64, f64)) -> f64| series.iter().flat_map(move |one| one.points.iter().map(pick));
    let x = panel.x.lay_out(all(|p| p.0), 8);
    let y = panel.y.lay_out(all(|p| p.1), if area.height < 130.0 { 3 } else { 5 });
    axes(out, panel, &x, &y, area);
    let _ = writeln!(
        out,
        "<clipPath id=\"lb-c{at}\"><rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\"/></clipPath>\n<g \
         clip-path=\"url(#lb-c{at})\">",
        area.x - 4.0,
        area.y - 4.0,
        area.width + 8.0,
        area.height + 8.0
    );
    for one in series {
        let placed = |(px, py): &(f64, f64)| {
            let (px, py) = (x.place(*px)?, y.place(*py)?);
            // Far outside is as good as just outside, and needs fewer digits.
            let (px, py) = (px.clamp(-2.0, 3.0), py.clamp(-2.0, 3.0));
            Some((area.x + px * area.width, area.y + (1.0 - py) * area.height))
        };
        draw(out, one, &thinned(&one.points).iter().map(placed).collect::<Vec<_>>());
    }
    out.push_str("</g>\n");
    let _ = writeln!(out, "<path class=\"lb-axis\" d=\"{}\"/>", frame(area));
}

fn frame(area: Area) -> String {
    let Area { x, y, width, height } = area;
    format!("M{x:.1} {y:.1}V{:.1}H{:.1}", y + height, x + width)
}

/// At most [`POINTS_MAX`] points, keeping the least and the largest y of each stretch, so that no peak is lost.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= POINTS_MAX {
        return points.to_vec();
    }
    let stretch = points.len().div_ceil(POINTS_MAX / 2);
    let mut kept = Vec::with_capacity(POINTS_MAX + 2);
    for chunk in points.chunks(stretch) {
        let place = |better: fn(f64, f64) -> bool| {
            let mut best = 0;
            for (at, point) in chunk.iter().enumerate() {
                if better(point.1, chunk[best].1) {
                    best = at;
                }
            }
            best
        };
        let (low, high) = (place(|a, b| a < b), place(|a, b| a > b));
        kept.push(chunk[low.min(high)]);
        if low != high {
            kept.push(chunk[low.max(high)]);
        }
    }
    kept
}

fn draw(out: &mut String, series: &Series, points: &[Option<(f64, f64)>]) {
    let class = series.colour % COLOURS;
    if series.style != Style::Marks {
        let mut path = String::new();
        let mut pen_down = false;
        for point in points {
            if let Some((x, y)) = point {
                let _ = write!(path, "{}{x:.1} {y:.1}", if pen_down { 'L' } else { 'M' });
            }
            pen_down = point.is_some();
        }
        let dash = if series.style == Style::Dashed { " stroke-dasharray=\"6 4\"" } else { "" };
        let _ = writeln!(
            out,
            "<path class=\"lb-s{class}\" stroke-width=\"1.6\" stroke-linejoin=\"round\"{dash} d=\"{path}\"/>"
        );
    }
    if matches!(series.style, Style::Marks | Style::MarkedLine) {
        for (x, y) in points.iter().flatten() {
            mark(out, class, *x, *y);
        }
    }
}

/// A shape for each colour, so that a print without colours can be read.
fn mark(out: &mut String, class: usize, x: f64, y: f64) {
    let _ = match class % 4 {
        0 => writeln!(out, "<circle class=\"lb-ms{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.4\"/>"),
        1 => {
            writeln!(
                out,
                "<rect class=\"lb-ms{class}\" x=\"{:.1}\" y=\"{:.1}\" width=\"6\" height=\"6\"/>",
                x - 3.0,
                y - 3.0
            )
        }
        2 => writeln!(out, "<path class=\"lb-ms{class}\" d=\"M{x:.1} {:.1}l3.8 6.8h-7.6z\"/>", y - 4.2),
        _ => writeln!(out, "<path class=\"lb-ms{class}\" d=\"M{x:.1} {:.1}l4 4l-4 4l-4 -4z\"/>", y - 4.0),
    };
}

fn axes(out: &mut String, panel: &Panel, x: &Laid, y: &Laid, area: Area) {
    let bottom = area.y + area.height;
    for (value, label) in &x.ticks {
        let Some(place) = x.place(*value) else { continue };
        let at = area.x + place * area.width;
        let opacity = if label.is_empty() { " opacity=\"0.5\"" } else { "" };
        let _ = writeln!(out, "<path class=\"lb-g\"{opacity} d=\"M{at:.1} {:.1}V{bottom:.1}\"/>", area.y);
        text(out, Place { x: at, y: bottom + 16.0, anchor: "middle" }, "lb-l", 11.0, false, label);
    }
    for (value, label) in &y.ticks {
        let Some(place) = y.place(*value) else { continue };
        let at = bottom - place * area.height;
        let opacity = if label.is_empty() { " opacity=\"0.5\"" } else { "" };
        let _ =
            writeln!(out, "<path class=\"lb-g\"{opacity} d=\"M{:.1} {at:.1}H{:.1}\"/>", area.x, area.x + area.width);
        text(out, Place { x: area.x - 7.0, y: at + 4.0, anchor: "end" }, "lb-l", 11.0, false, label);
    }
    let middle = area.x + area.width / 2.0;
    text(out, Place { x: middle, y: bottom + 35.0, anchor: "middle" }, "lb-t", 12.0, false, &panel.x.label);
    if !panel.y.label.is_empty() {
        let (at_x, at_y) = (area.x - LEFT_PX + 16.0, area.y + area.height / 2.0);
        let _ = writeln!(
            out,
            "<text class=\"lb-t\" font-size=\"12\" text-anchor=\"middle\" transform=\"translate({at_x:.1} {at_y:.1}) \
             rotate(-90)\">{}</text>",
            escape(&panel.y.label)
        );
    }
}

fn legend_entry(out: &mut String, series: &Series, x: f64, y: f64) {
    let sample = [Some((x, y)), Some((x + LEGEND_SAMPLE_PX - 6.0, y))];
    match series.style {
        Style::Line | Style::Dashed => draw(out, series, &sample),
        Style::Marks => mark(out, series.colour % COLOURS, x + 12.0, y),
        Style::MarkedLine => {
            draw(out, &Series { style: Style::Line, points: Vec::new(), ..series.clone() }, &sample);
            mark(out, series.colour % COLOURS, x + 12.0, y);
        }
    }
    text(out, Place { x: x + LEGEND_SAMPLE_PX, y: y + 4.0, anchor: "start" }, "lb-t", 12.0, false, &series.name);
}

fn heat(out: &mut String, map: &HeatMap, area: Area) {
    let measured = |value: &f64| theme::measure(map.scale, *value);
    let all = || map.values.iter().flatten().filter_map(measured);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    let width = area.width / map.columns.len().max(1) as f64;
    let bottom = area.y + map.rows.len() as f64 * ROW_PX;
    for (row, values) in map.values.iter().enumerate() {
        let y = area.y + row as f64 * ROW_PX;
        let name = map.rows.get(row).map_or("", String::as_str);
        text(out, Place { x: area.x - 8.0, y: y + 17.0, anchor: "end" }, "lb-t", 12.0, false, name);
        for (column, value) in values.iter().enumerate() {
            let x = area.x + column as f64 * width;
            let colour = measured(value).map(|m| theme::heat(if high > low { (m - low) / (high - low) } else { 0.5 }));
            let rect = format!(
                "x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\"",
                x + 1.0,
                y + 1.0,
                width - 2.0,
                ROW_PX - 2.0
            );
            // Cells have colours of their own in every theme, so the writing on them has too.
            let (cell, paint) = match colour {
                Some((colour, true)) => (format!("fill=\"{colour}\""), "fill=\"#ffffff\""),
                Some((colour, false)) => (format!("fill=\"{colour}\""), "fill=\"#1f2328\""),
                None => ("class=\"lb-none\"".to_owned(), "class=\"lb-t\""),
            };
            let _ = writeln!(out, "<rect {rect} rx=\"2\" {cell}/>");
            let label = map.labels.get(row).and_then(|labels| labels.get(column)).map_or("", String::as_str);
            let (x, y) = (x + width / 2.0, y + 17.0);
            let _ = writeln!(
                out,
                "<text {paint} font-size=\"11\" text-anchor=\"middle\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>",
                escape(label)
            );
        }
    }
    for (column, name) in map.columns.iter().enumerate() {
        let x = area.x + (column as f64 + 0.5) * width;
        for (line, part) in name.lines().enumerate() {
            let y = bottom + 15.0 + 13.0 * line as f64;
            text(out, Place { x, y, anchor: "middle" }, "lb-t", 11.0, false, part);
        }
    }
}

#[derive(Clone, Copy)]
struct Place {
    x: f64,
    y: f64,
    anchor: &'static str,
}

fn text(out: &mut String, at: Place, class: &str, size: f64, bold: bool, content: &str) {
    if content.is_empty() {
        return;
    }
    let weight = if bold { " font-weight=\"bold\"" } else { "" };
    let _ = writeln!(
        out,
        "<text class=\"{class}\" font-size=\"{size}\"{weight} text-anchor=\"{}\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
        at.anchor,
        at.x,
        at.y,
        escape(content)
    );
}

/// Text as XML may hold it; control characters, which it may not, are left out.
fn escape(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).fold(String::with_capacity(text.len()), |mut out, c| {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            other => out.push(other),
        }
        out
    })
}
