//! Axes: the range that shows all data, ticks at round numbers, and their labels.

use std::fmt::Write as _;

/// How values become distances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scale {
    /// Equal differences, equal distances.
    #[default]
    Linear,
    /// Equal ratios, equal distances; only positive values are drawn.
    Log,
}

/// An axis as it is asked for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Axis {
    /// What it measures, with its unit.
    pub label: String,
    /// How.
    pub scale: Scale,
    /// From, to; what lies outside is clipped. Absent: what the data need.
    pub range: Option<(f64, f64)>,
}

impl Axis {
    /// A linear axis as wide as its data.
    #[must_use]
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, range: None }
    }

    /// A logarithmic axis as wide as its data.
    #[must_use]
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Log, range: None }
    }

    /// The same axis from `low` to `high`.
    #[must_use]
    pub fn within(self, low: f64, high: f64) -> Self {
        Self { range: Some((low, high)), ..self }
    }

    /// The axis laid out for its data.
    pub(super) fn lay_out(&self, values: impl Iterator<Item = f64>, ticks: usize) -> Laid {
        let shown = values.filter(|x| x.is_finite() && (self.scale == Scale::Linear || *x > 0.0));
        let (low, high) = self.range.unwrap_or_else(|| {
            shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
        });
        match self.scale {
            Scale::Linear => linear(low, high, self.range.is_some(), ticks),
            Scale::Log => log(low, high, self.range.is_some()),
        }
    }
}

/// An axis with its range and ticks.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Laid {
    /// In the axis' own measure: the value, or its decimal logarithm.
    low: f64,
    high: f64,
    scale: Scale,
    /// Value and label; an empty label is a minor tick.
    pub(super) ticks: Vec<(f64, String)>,
}

impl Laid {
    /// Where a value lies: 0 at the low end, 1 at the high one; none for what can't be drawn.
    pub(super) fn place(&self, value: f64) -> Option<f64> {
        let measure = match self.scale {
            Scale::Linear => value,
            Scale::Log if value > 0.0 => libm::log10(value),
            Scale::Log => return None,
        };
        let place = (measure - self.low) / (self.high - self.low);
        place.is_finite().then_some(place)
    }
}

/// Ticks at multiples of 1, 2 or 5 times a power of ten, about `wanted` of them.
fn linear(low: f64, high: f64, fixed: bool, wanted: usize) -> Laid {
    let (low, high) = match (low, high) {
        (low, high) if !(low.is_finite() && high.is_finite()) => (0.0, 1.0),
        // One value alone, or rounding around one, still needs an axis around it.
        (low, high) if high - low <= 1e-12 * low.abs().max(high.abs()) => {
            let room = if low.abs() > 0.0 { 0.5 * low.abs() } else { 1.0 };
            (low - room, high + room)
        }
        range => range,
    };
    let step = round_step((high - low) / wanted.max(1) as f64);
    let (low, high) =
        if fixed { (low, high) } else { ((low / step + 1e-9).floor() * step, (high / step - 1e-9).ceil() * step) };
    let mut ticks = Vec::new();
    let mut at = (low / step - 1e-9).ceil();
    // A step is at least a tenth of the range over `wanted`: the loop is bounded.
    while at * step <= high + 1e-9 * step {
        ticks.push((at * step, decimal(at * step, step)));
        at += 1.0;
    }
    Laid { low, high, scale: Scale::Linear, ticks }
}

/// The smallest of 1, 2, 5 times a power of ten that is not below `raw`.
fn round_step(raw: f64) -> f64 {
    let power = libm::exp10(libm::log10(raw).floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|f| f * power >= raw * (1.0 - 1e-9)).unwrap_or(10.0);
    factor * power
}

/// Whole decades around the data; where there are few, lines at 2 … 9 too.
fn log(low: f64, high: f64, fixed: bool) -> Laid {
    let usable = low.is_finite() && high.is_finite() && low > 0.0;
    let (low, high) = if usable { (libm::log10(low), libm::log10(high)) } else { (0.0, 1.0) };
    let around = if high - low < 3.0 { near_decade } else { whole_decade };
    let (mut from, mut to) = if fixed { (low, high) } else { (around(low, f64::floor), around(high, f64::ceil)) };
    if to - from < 1e-9 {
        (from, to) = (from - 0.5, to + 0.5);
    }
    let (low, high) = (from, to);
    let labels_every = ((high - low) / 8.0).ceil().max(1.0);
    let few = high - low <= 2.5;
    let mut ticks = Vec::new();
    let mut decade = (low - 1.0).floor();
    while decade <= high {
        for factor in 1..10 {
            let measure = decade + libm::log10(f64::from(factor));
            if measure < low - 1e-9 || measure > high + 1e-9 {
                continue;
            }
            let value = f64::from(factor) * libm::exp10(decade);
            // Counted from 1, not from the low end, which need not be a power of ten.
            let on_grid = few || (decade / labels_every).fract().abs() < 1e-9;
            let labelled = on_grid && (factor == 1 || few && (factor == 2 || factor == 5));
            if labelled || high - low <= 4.0 {
                ticks.push((value, if labelled { logarithmic(value, few) } else { String::new() }));
            }
        }
        decade += 1.0;
    }
    Laid { low, high, scale: Scale::Log, ticks }
}

/// The nearest power of ten in the direction of `round`; measures are decimal logarithms.
fn whole_decade(measure: f64, round: fn(f64) -> f64) -> f64 {
    // A value on a decade, but for rounding, is its own neighbour.
    if (measure - measure.round()).abs() < 1e-9 { measure.round() } else { round(measure) }
}

/// The nearest of 1, 2, 5 times a power of ten in the direction of `round`: whole decades would leave half of a short
/// axis empty.
fn near_decade(measure: f64, round: fn(f64) -> f64) -> f64 {
    let decade = measure.floor();
    let marks = [0.0, libm::log10(2.0), libm::log10(5.0), 1.0].map(|part| decade + part);
    let up = round(0.5) > 0.5;
    let beyond = |mark: &&f64| if up { **mark >= measure - 1e-9 } else { **mark <= measure + 1e-9 };
    let found = if up { marks.iter().find(beyond) } else { marks.iter().rev().find(beyond) };
    found.copied().unwrap_or(measure)
}

/// A value with as many decimals as the step needs.
fn decimal(value: f64, step: f64) -> String {
    let largest = value.abs().max(step);
    if !(1e-4..1e6).contains(&largest) || step < 1e-5 {
        return plain_exponent(value);
    }
    let decimals = (0..7).find(|d| is_whole(step * libm::exp10(f64::from(*d)))).unwrap_or(7);
    let text = format!("{value:.*}", usize::try_from(decimals).unwrap_or(7));
    if text.trim_matches(['-', '0', '.']).is_empty() { "0".to_owned() } else { text.replace('-', "\u{2212}") }
}

fn is_whole(value: f64) -> bool {
    (value - value.round()).abs() < 1e-6 * value.abs().max(1.0)
}

fn plain_exponent(value: f64) -> String {
    if value.abs() > 0.0 { format!("{value:.1e}").replace('-', "\u{2212}") } else { "0".to_owned() }
}

/// Powers of ten as such, unless the axis spans so little that plain numbers read better.
fn logarithmic(value: f64, few: bool) -> String {
    if few || (0.009..2e4).contains(&value) {
        let mut text = format!("{value:.6}");
        while text.contains('.') && (text.ends_with('0') || text.ends_with('.')) {
            text.pop();
        }
        if value >= 1e-5 {
            return text;
        }
    }
    let mut text = "10".to_owned();
    let _ = write!(text, "{:.0}", libm::log10(value));
    let raised = |c: char| match c {
        '-' => '\u{207b}',
        '1' => '\u{b9}',
        '2' => '\u{b2}',
        '3' => '\u{b3}',
        digit => char::from_u32(0x2070 + digit.to_digit(10).unwrap_or(0)).unwrap_or(digit),
    };
    text.char_indices().map(|(at, c)| if at < 2 { c } else { raised(c) }).collect()
}
