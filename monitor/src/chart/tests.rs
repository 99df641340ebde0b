//! The pictures: ticks where a person would put them, nothing lost, nothing that breaks the XML.

use super::axis::Laid;
use super::*;

fn labels(axis: &Axis, values: &[f64]) -> Vec<String> {
    let laid: Laid = axis.lay_out(values.iter().copied(), 5);
    laid.ticks.into_iter().map(|(_, label)| label).filter(|label| !label.is_empty()).collect()
}

fn one_line(points: Vec<(f64, f64)>, y: Axis) -> Figure {
    let panel = Panel::lines("", Axis::linear("t (s)"), y, vec![Series::line("e", 0, points)]);
    Figure { panels: vec![panel], ..Figure::default() }
}

#[test]
fn linear_ticks_stand_at_round_numbers_around_the_data() {
    assert_eq!(labels(&Axis::linear(""), &[0.03, 0.97]), ["0", "0.2", "0.4", "0.6", "0.8", "1"].map(to_one(1)));
    assert_eq!(labels(&Axis::linear(""), &[-12.0, 31.0]), ["\u{2212}20", "\u{2212}10", "0", "10", "20", "30", "40"]);
    assert_eq!(labels(&Axis::linear(""), &[5.0]), ["2", "3", "4", "5", "6", "7", "8"], "one value alone has room");
    assert_eq!(labels(&Axis::linear(""), &[]).len(), 6, "no value at all is an empty axis, not an error");
}

/// "0" stays as it is, the others keep the decimals that the step needs.
fn to_one(decimals: usize) -> impl Fn(&str) -> String {
    move |text| if text == "0" { text.to_owned() } else { format!("{:.decimals$}", text.parse::<f64>().unwrap()) }
}

#[test]
fn logarithmic_ticks_stand_at_powers_of_ten_and_within_one_decade_at_2_and_5() {
    assert_eq!(labels(&Axis::log(""), &[2e-5, 30.0]), ["10⁻⁵", "10⁻⁴", "10⁻³", "0.01", "0.1", "1", "10", "100"]);
    assert_eq!(labels(&Axis::log(""), &[2.1, 9.0]), ["2", "5", "10"]);
    let laid = Axis::log("").lay_out([1.0, 100.0].into_iter(), 5);
    assert!((laid.place(10.0).unwrap() - 0.5).abs() < 1e-12 && laid.place(0.0).is_none());
}

#[test]
fn a_value_that_cannot_be_drawn_breaks_the_line_and_nothing_else() {
    let svg =
        to_svg(&one_line(vec![(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0), (3.0, 2.0)], Axis::linear("")), Theme::Light);
    let path = svg.lines().find(|line| line.contains("stroke-linejoin")).unwrap();
    assert_eq!(path.matches('M').count(), 2, "{path}");
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    let svg = to_svg(&one_line(vec![(0.0, 1.0), (1.0, 0.0), (2.0, 3.0)], Axis::log("")), Theme::Light);
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
}

#[test]
fn thinning_a_long_line_keeps_its_single_peak() {
    let mut points: Vec<(f64, f64)> = (0..100_000).map(|k| (f64::from(k), 0.0)).collect();
    points[70_001].1 = 1.0;
    let svg = to_svg(&one_line(points, Axis::linear("").within(0.0, 1.0)), Theme::Light);
    let path = svg.lines().find(|line| line.contains("stroke-linejoin")).unwrap();
    assert!(path.len() < 40_000, "{} bytes", path.len());
    // The top of the only panel lies 14 px below that of the picture.
    assert!(path.contains(" 14.0L"), "the peak is gone");
}

#[test]
fn every_theme_is_well_formed_with_any_text_in_it() {
    let mut figure = one_line(vec![(0.0, 1.0), (1.0, 2.0)], Axis::linear("|e| < \"1\" & more\u{7}"));
    figure.title = "<script>".to_owned();
    for theme in [Theme::Light, Theme::Dark, Theme::Auto] {
        let svg = to_svg(&figure, theme);
        assert!(svg.contains("&lt;script&gt;") && svg.contains("&amp; more") && !svg.contains('\u{7}'), "{svg}");
        assert_eq!(svg.contains("prefers-color-scheme"), theme == Theme::Auto);
    }
}

#[test]
fn a_png_has_the_size_of_its_svg_and_letters_on_a_machine_without_fonts() {
    let mut figure = one_line(vec![(0.0, 1.0), (1.0, 2.0)], Axis::linear("e (rad)"));
    let bare = to_png(&figure, 1.0).unwrap();
    assert_eq!(bare[..8], *b"\x89PNG\r\n\x1a\n");
    assert_eq!(u32::from_be_bytes(bare[16..20].try_into().unwrap()), 860);
    figure.panels[0].y.label.clear();
    let mute = to_png(&figure, 1.0).unwrap();
    assert_ne!(bare, mute, "the label is drawn");
}

#[test]
fn a_heat_map_writes_every_label_and_greys_what_has_no_value() {
    let map = HeatMap {
        columns: vec!["robust".into(), "ctc".into()],
        rows: vec!["exact".into()],
        values: vec![vec![0.1, f64::NAN]],
        labels: vec![vec!["0.1".into(), "diverges".into()]],
        scale: Scale::Log,
    };
    let svg = to_svg(&Figure { panels: vec![Panel::heat("error", map)], ..Figure::default() }, Theme::Light);
    assert!(svg.contains(">diverges</text>") && svg.contains("class=\"lb-none\"") && svg.contains(">exact</text>"));
}
