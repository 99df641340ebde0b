//! A percentile plot of one hop as SVG: latency over 1/(1 − quantile), both logarithmic, so that tails can be read.

use std::fmt::Write as _;

use hdrhistogram::Histogram;

const WIDTH: f64 = 720.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 80.0;
const RIGHT: f64 = 20.0;
const TOP: f64 = 40.0;
const BOTTOM: f64 = 50.0;

/// The plot; a histogram without values gives axes and the words "no values".
#[must_use]
pub fn percentile_plot(title: &str, histogram: &Histogram<u64>) -> String {
    let points: Vec<(f64, f64)> = histogram
        .iter_quantiles(8)
        .filter(|step| step.quantile_iterated_to() < 1.0)
        .map(|step| (-libm::log10(1.0 - step.quantile_iterated_to()), step.value_iterated_to().max(1) as f64))
        .collect();
    let nines = points.iter().fold(1.0, |most: f64, point| most.max(point.0)).ceil();
    let least = points.first().map_or(100.0, |point| point.1);
    let most = points.last().map_or(1e6, |point| point.1);
    let (bottom, top) = (libm::log10(least).floor(), (libm::log10(most) + 1e-9).ceil());
    let x = |nines_here: f64| LEFT + nines_here / nines * (WIDTH - LEFT - RIGHT);
    let y = |ns: f64| HEIGHT - BOTTOM - (libm::log10(ns) - bottom) / (top - bottom).max(1.0) * (HEIGHT - TOP - BOTTOM);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"white\"/>\n\
         <text x=\"{LEFT}\" y=\"24\" font-size=\"15\">{title}, n = {}; start-up left out</text>\n",
        histogram.len()
    );
    let mut decade = bottom;
    while decade <= top {
        let ns = libm::pow(10.0, decade);
        let at = y(ns);
        let label = crate::verdict::expectations::time(Some(ns));
        let _ = writeln!(
            svg,
            "<line x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#ccc\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
            WIDTH - RIGHT,
            LEFT - 6.0,
            at + 4.0
        );
        decade += 1.0;
    }
    let mut count = 0.0;
    while count <= nines {
        let percent = 100.0 * (1.0 - libm::pow(10.0, -count));
        let _ = writeln!(
            svg,
            "<line x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"{TOP}\" y2=\"{1:.1}\" stroke=\"#ccc\"/>\
             <text x=\"{0:.1}\" y=\"{2:.1}\" text-anchor=\"middle\">{percent} %</text>",
            x(count),
            HEIGHT - BOTTOM,
            HEIGHT - BOTTOM + 18.0
        );
        count += 1.0;
    }
    if points.is_empty() {
        let _ = writeln!(svg, "<text x=\"{}\" y=\"{}\">no values</text>", WIDTH / 2.0, HEIGHT / 2.0);
    }
    let line: String = points.iter().map(|(nines, ns)| format!("{:.1},{:.1} ", x(*nines), y(*ns))).collect();
    let _ = writeln!(svg, "<polyline fill=\"none\" stroke=\"#1f5fa8\" stroke-width=\"2\" points=\"{}\"/>", line.trim());
    svg.push_str("</svg>\n");
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plot_rises_from_left_to_right_and_names_its_count() {
        let mut histogram = Histogram::<u64>::new_with_bounds(1, 10_000_000_000, 3).unwrap();
        (1..=10_000u64).for_each(|value| histogram.record(value * value).unwrap());
        let svg = percentile_plot("round_trip", &histogram);
        assert!(svg.contains("n = 10000") && svg.contains("99.9"), "{svg}");
        let points = svg.split("points=\"").nth(1).unwrap().split('"').next().unwrap();
        let points: Vec<(f64, f64)> = points
            .split(' ')
            .map(|point| point.split_once(',').unwrap())
            .map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap()))
            .collect();
        assert!(points.len() > 20);
        assert!(points.windows(2).all(|pair| pair[0].0 <= pair[1].0 && pair[0].1 >= pair[1].1), "{points:?}");
    }

    #[test]
    fn no_values_give_a_plot_that_says_so() {
        let svg = percentile_plot("floor", &Histogram::<u64>::new_with_bounds(1, 1000, 3).unwrap());
        assert!(svg.contains("no values") && svg.ends_with("</svg>\n") && !svg.contains("NaN"), "{svg}");
    }
}
