//! The live view as one screen: the chain with its reference, V and its bounds, latencies, events.

use loopbound_shared::event::HappeningKind;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::canvas::{Canvas, Circle, Line as Stroke};
use ratatui::widgets::{Axis, Block, Cell, Chart, Clear, Dataset, GraphType, List, ListItem, Paragraph, Row, Table};

use super::model::{FAULTS, Model, STRIP_S};
use crate::counted::counted;
use crate::event::words::words;
use crate::event::{Event, EventKind, cause_of, fault};
use crate::hops::Hop;
use crate::recording::scene::joints;

const CHAIN: Color = Color::Cyan;
const GHOST: Color = Color::DarkGray;
const SPARKS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Draws all of it.
pub fn draw<const N: usize>(frame: &mut Frame, model: &Model<N>) {
    let rows = Layout::vertical([
        Constraint::Length(3),
        Constraint::Min(10),
        Constraint::Length(u16::try_from(Hop::ALL.len()).unwrap_or(7) + 3),
        Constraint::Length(1),
    ])
    .split(frame.area());
    header(frame, rows[0], model);
    let middle = Layout::horizontal([Constraint::Percentage(40), Constraint::Percentage(60)]).split(rows[1]);
    chain(frame, middle[0], model);
    strip(frame, middle[1], model);
    let bottom = Layout::horizontal([Constraint::Length(66), Constraint::Min(30)]).split(rows[2]);
    latencies(frame, bottom[0], model);
    events(frame, bottom[1], model);
    let keys = " q quit   space pause   s swap to a standby, or to the next law   f fault   ";
    frame.render_widget(Line::from(vec![keys.into(), Span::styled(model.answer.as_str(), Color::Yellow)]), rows[3]);
    if model.choosing {
        menu(frame, rows[1]);
    }
}

/// The faults to choose from, each by its digit.
fn menu(frame: &mut Frame, area: Rect) {
    let lines: Vec<Line> =
        FAULTS.iter().zip(1..).map(|((_, words), digit)| Line::from(format!(" {digit}  {words} "))).collect();
    let title = " a fault for the active controller: digit, or Esc ";
    let width = u16::try_from(title.len() + 2).unwrap_or(u16::MAX);
    let height = u16::try_from(lines.len() + 2).unwrap_or(u16::MAX);
    let place = area.centered(Constraint::Length(width), Constraint::Length(height));
    frame.render_widget(Clear, place);
    let style = Style::default().fg(Color::Yellow);
    frame.render_widget(Paragraph::new(lines).block(Block::bordered().title(title).border_style(style)), place);
}

fn header<const N: usize>(frame: &mut Frame, area: Rect, model: &Model<N>) {
    let (active, epoch) = model.in_charge();
    let (tick, t_s) = model.newest.as_ref().map_or((0, 0.0), |(record, row)| (record.tick, row.t_s));
    let missed = model.newest.as_ref().map_or(0, |(record, _)| record.counters.missed);
    let bold = Style::default().add_modifier(Modifier::BOLD);
    let mut spans = vec![
        Span::styled(format!(" controller {active} ({}) ", model.name(active)), bold.fg(CHAIN)),
        format!("active, epoch {epoch}").into(),
    ];
    let standbys: Vec<String> = model.standbys().iter().map(|id| format!("{id} ({})", model.name(*id))).collect();
    spans.push(if standbys.is_empty() {
        "   no standby".into()
    } else {
        format!("   standby {}", standbys.join(", ")).into()
    });
    spans.push(format!("   missed {missed}").into());
    if model.paused {
        spans.push(Span::styled("   PAUSED", bold.fg(Color::Yellow)));
    }
    let time = if model.lockstep { "virtual time" } else { "real time" };
    let title = format!(" {}   {time}, {:.0} Hz   tick {tick}   t = {t_s:.3} s ", model.group, model.rate_hz);
    frame.render_widget(Paragraph::new(Line::from(spans)).block(Block::bordered().title(title)), area);
}

fn chain<const N: usize>(frame: &mut Frame, area: Rect, model: &Model<N>) {
    let lengths = &model.length_m[..N];
    let reach = lengths.iter().sum::<f64>() * 1.05;
    let block = Block::bordered().title(" chain, and its reference in grey ");
    // A cell is about twice as high as wide; what is shown is as wide as it is high.
    let inner = block.inner(area);
    let aspect = f64::from(inner.width.max(1)) / (2.0 * f64::from(inner.height.max(1)));
    let (x, y) = if aspect > 1.0 { (reach * aspect, reach) } else { (reach, reach / aspect) };
    let picture =
        Canvas::default().block(block).marker(Marker::Braille).x_bounds([-x, x]).y_bounds([-y, y]).paint(|context| {
            let Some((record, _)) = &model.newest else { return };
            for (q, colour) in [(&record.q_d, GHOST), (&record.q, CHAIN)] {
                let at = joints(&q[..N], lengths);
                for pair in at.windows(2) {
                    context.draw(&Stroke {
                        x1: pair[0][0],
                        y1: pair[0][1],
                        x2: pair[1][0],
                        y2: pair[1][1],
                        color: colour,
                    });
                }
                for [x, y] in at {
                    context.draw(&Circle { x, y, radius: reach * 0.03, color: colour });
                }
                context.layer();
            }
        });
    frame.render_widget(picture, area);
}

fn strip<const N: usize>(frame: &mut Frame, area: Rect, model: &Model<N>) {
    let end_s = model.strip.back().map_or(0.0, |last| last.t_s).max(STRIP_S);
    let v: Vec<(f64, f64)> = model.strip.iter().filter_map(|p| Some((p.t_s, p.v?))).collect();
    let promised: Vec<(f64, f64)> = model.strip.iter().filter_map(|p| Some((p.t_s, p.promised?))).collect();
    let level = model.newest.as_ref().and_then(|(_, row)| row.lyapunov_level).map(libm::log10);
    let level: Vec<(f64, f64)> = level.map_or_else(Vec::new, |lg| vec![(end_s - STRIP_S, lg), (end_s, lg)]);
    let all = || v.iter().chain(&promised).chain(&level).map(|(_, lg)| *lg);
    let (low, high) = (all().fold(0.0, f64::min).floor(), all().fold(0.0, f64::max).ceil().max(1.0));
    let line = |name: &'static str, colour, points| {
        Dataset::default().name(name).marker(Marker::Braille).graph_type(GraphType::Line).style(colour).data(points)
    };
    let datasets = vec![
        line("c, certified", Color::Red, &level),
        line("certified bound", Color::Yellow, &promised),
        line("V", CHAIN, &v),
    ];
    let middle = (low + high) / 2.0;
    let value = |lg: f64| format!("{:8.1e}", libm::pow(10.0, lg));
    let chart = Chart::new(datasets)
        .block(Block::bordered().title(" V and its bounds "))
        .x_axis(
            Axis::default()
                .bounds([end_s - STRIP_S, end_s])
                .labels([format!("{:.0} s", end_s - STRIP_S), format!("{end_s:.0} s")]),
        )
        .y_axis(Axis::default().bounds([low, high]).labels([value(low), value(middle), value(high)]));
    frame.render_widget(chart, area);
}

fn latencies<const N: usize>(frame: &mut Frame, area: Rect, model: &Model<N>) {
    let us = |ns: Option<f64>| match ns {
        None => "–".to_owned(),
        Some(ns) if ns < 1e7 => format!("{:.1}", ns * 1e-3),
        Some(ns) => format!("{:.1}ms", ns * 1e-6),
    };
    let rows = Hop::ALL.iter().zip(&model.sparks).map(|(hop, sparks)| {
        let found = model.quantiles(*hop);
        let most = sparks.iter().copied().max().unwrap_or(1).max(1);
        let spark: String = sparks.iter().rev().take(14).rev().map(|ns| SPARKS[spark_height(*ns, most)]).collect();
        Row::new(
            [hop.words().to_owned(), us(found.p50), us(found.p99), us(found.p99_9), us(found.max), spark]
                .map(Cell::from),
        )
    });
    let widths = [21, 8, 8, 9, 9].map(Constraint::Length).into_iter().chain([Constraint::Min(4)]);
    let title = if model.lockstep { " latency, µs (virtual: what was injected) " } else { " latency, µs " };
    let table = Table::new(rows, widths)
        .header(Row::new(["hop", "p50", "p99", "p99.9", "max", "p99, over time"]).style(Color::DarkGray))
        .column_spacing(0)
        .block(Block::bordered().title(title));
    frame.render_widget(table, area);
}

fn spark_height(value: u64, most: u64) -> usize {
    usize::try_from(value.saturating_mul(7) / most).unwrap_or(7).min(7)
}

fn events<const N: usize>(frame: &mut Frame, area: Rect, model: &Model<N>) {
    let room = usize::from(area.height.saturating_sub(2));
    let lines = model.events.iter().rev().take(room).map(|event| {
        let colour = match event.kind {
            EventKind::Bound { verdict: "designed_hold", .. } => Color::Reset,
            EventKind::Bound { .. } | EventKind::Promise { .. } => Color::Red,
            EventKind::Late { .. } | EventKind::Missed { .. } | EventKind::Gap { .. } => Color::Yellow,
            _ => Color::Reset,
        };
        ListItem::new(Line::styled(describe(event), colour))
    });
    frame.render_widget(List::new(lines).block(Block::bordered().title(" events, the newest first ")), area);
}

fn describe(event: &Event) -> String {
    let cause = cause_of(event).map_or_else(String::new, |cause| format!(": {}", cause.name().replace('_', " ")));
    let what = match &event.kind {
        EventKind::Missed { ticks, .. } if *ticks > 1 => format!(", {ticks} ticks"),
        EventKind::Gap { ticks } => format!(", {}", counted(*ticks, "record")),
        EventKind::Late { deadline_to_torque_ns, .. } => format!(", {:.0} µs", *deadline_to_torque_ns as f64 * 1e-3),
        // A list is narrow: the shorter form, and of the others their beginning.
        EventKind::Happening(happening) if happening.kind == HappeningKind::FaultInjected.code() => {
            format!(", {}, {}", fault(happening.detail), happening.subject)
        }
        EventKind::Happening(happening) => format!(", {}", words(happening)),
        EventKind::Bound { verdict, .. } => format!(", {}", verdict.replace('_', " ")),
        _ => String::new(),
    };
    format!("{:>9.3} s  {}{what}{cause}", event.plant_ns as f64 * 1e-9, event.kind.name())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Loop, unanswered};
    use loopbound_model::law::LawKind;
    use loopbound_scenario::Scenario;
    use loopbound_shared::sample::Announce;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    fn screen(model: &Model<3>) -> String {
        let mut terminal = Terminal::new(TestBackend::new(120, 36)).unwrap();
        terminal.draw(|frame| draw(frame, model)).unwrap();
        let buffer = terminal.backend().buffer();
        let line = |y: u16| (0..120).map(|x| buffer[(x, y)].symbol()).collect::<String>() + "\n";
        (0..36).map(line).collect()
    }

    #[test]
    fn a_screen_shows_who_is_in_charge_the_chain_v_the_latencies_and_why_a_tick_was_missed() {
        let scenario = Scenario::default();
        let mut model = Model::<3>::new("g", &scenario).unwrap();
        assert!(screen(&model).contains("no standby"), "an empty view is drawn too");
        let mut plant = Loop::new(&scenario, LawKind::Robust);
        let mut name = [0; 32];
        name[..6].copy_from_slice(b"robust");
        model.learn(&Announce { role: 3, id: 1, name, ..crate::testing::controller(1, LawKind::Robust, &plant.law) });
        (0..400).for_each(|_| model.feed(&plant.next()));
        model.feed(&unanswered(400));
        model.close_interval();
        model.tracker.finish();
        model.feed(&plant.next());
        let screen = screen(&model);
        for shown in ["controller 1 (robust) active", "round trip", "8.0", "V and its bounds", "first seen", "tick 400"]
        {
            assert!(screen.contains(shown), "{shown}:\n{screen}");
        }
        assert!(screen.chars().filter(|c| ('\u{2801}'..='\u{28ff}').contains(c)).count() > 60, "{screen}");
    }

    #[test]
    fn the_menu_of_faults_shows_a_digit_for_each_and_an_injected_one_is_an_event() {
        let mut model = Model::<3>::new("g", &Scenario::default()).unwrap();
        assert!(screen(&model).contains("f fault") && !screen(&model).contains("Esc"));
        model.choosing = true;
        let drawn = screen(&model);
        for (digit, (_, words)) in (1..).zip(FAULTS) {
            assert!(drawn.contains(&format!("{digit}  {words}")), "{words}:\n{drawn}");
        }
        let mut record = crate::testing::good(0);
        let detail = u64::from(FAULTS[3].0.code());
        let kind = HappeningKind::FaultInjected.code();
        record.happenings[0] = loopbound_shared::sample::Happening { kind, subject: 2, detail, value: 9.0 };
        record.happenings_used = 1;
        model.feed(&record);
        model.choosing = false;
        assert!(screen(&model).contains("fault injected, kill, 2"), "{}", screen(&model));
    }

    #[test]
    fn a_pause_holds_the_picture_and_not_the_figures() {
        let mut model = Model::<3>::new("g", &Scenario::default()).unwrap();
        model.feed(&crate::testing::good(0));
        model.paused = true;
        model.feed(&crate::testing::good(1));
        assert_eq!(model.newest.as_ref().unwrap().0.tick, 0);
        assert_eq!(model.tracker.last_tick(), Some(1));
    }
}
