//! Durations and rates as people write them, and as the loops use them: whole nanoseconds and hertz.

use loopbound_model::quote;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// The units of a duration with their length in nanoseconds, longest first.
const DURATION_UNITS: [(&str, u64); 6] = [
    ("h", 3_600_000_000_000),
    ("min", 60_000_000_000),
    ("s", 1_000_000_000),
    ("ms", 1_000_000),
    ("us", 1_000),
    ("ns", 1),
];
/// The longest time of a scenario, 100 000 hours: sums of a few of them, and stamps after them, still fit.
pub(super) const LONGEST_NS: u64 = 100_000 * 3_600_000_000_000;
/// The units of a rate with their size in hertz, largest first.
const RATE_UNITS: [(&str, f64); 3] = [("MHz", 1e6), ("kHz", 1e3), ("Hz", 1.0)];

/// A duration or an instant since the start, in whole nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Nanos(pub u64);

impl Nanos {
    /// `value` milliseconds.
    #[must_use]
    pub const fn from_ms(value: u64) -> Self {
        Self(value * 1_000_000)
    }

    /// `value` seconds.
    #[must_use]
    pub const fn from_s(value: u64) -> Self {
        Self(value * 1_000_000_000)
    }

    /// The nanoseconds.
    #[must_use]
    pub const fn ns(self) -> u64 {
        self.0
    }

    /// The same in seconds, rounded to the nearest double.
    #[must_use]
    pub fn seconds(self) -> f64 {
        self.0 as f64 / 1e9
    }
}

impl fmt::Display for Nanos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&format_duration(self.0))
    }
}

impl FromStr for Nanos {
    type Err = UnitError;

    fn from_str(text: &str) -> Result<Self, UnitError> {
        parse_duration(text).map(Self)
    }
}

/// A rate in hertz.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct Hertz(pub f64);

impl fmt::Display for Hertz {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&format_rate(self.0))
    }
}

impl FromStr for Hertz {
    type Err = UnitError;

    fn from_str(text: &str) -> Result<Self, UnitError> {
        parse_rate(text).map(Self)
    }
}

/// A duration or a rate that cannot be understood.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnitError {
    /// The number or the unit is missing or unknown.
    #[error("found \"{}\", allowed: a number with a unit such as {example}", quote::text(found))]
    Malformed {
        /// The text as written.
        found: String,
        /// A correct example.
        example: &'static str,
    },
    /// A duration that is not a whole number of nanoseconds.
    #[error("found \"{}\", allowed: whole nanoseconds", quote::text(.0))]
    Fraction(String),
    /// A value that does not fit.
    #[error("found \"{}\", which is too large", quote::text(.0))]
    TooLarge(String),
    /// A time that no run lasts.
    #[error("found \"{}\", allowed: at most 100000h", quote::text(.0))]
    TooLong(String),
    /// A negative duration or rate.
    #[error("found \"{}\", allowed: not negative", quote::text(.0))]
    Negative(String),
}

/// Parses a duration: `20ms`, `100 us`, `1.5s`, `250ns`, `10min`; `µs` is `us`.
///
/// The decimal digits are read exactly, so that no duration is rounded on its way.
///
/// # Errors
/// A missing or unknown unit, a negative value, a fraction of a nanosecond, or more than 2⁶⁴ − 1 ns.
pub fn parse_duration(text: &str) -> Result<u64, UnitError> {
    let malformed = || UnitError::Malformed { found: text.to_owned(), example: "\"20ms\" (ns, us, ms, s, min, h)" };
    let (number, unit) = split_unit(text).ok_or_else(malformed)?;
    let unit = if matches!(unit, "µs" | "μs") { "us" } else { unit };
    let (_, scale) = DURATION_UNITS.iter().find(|(name, _)| *name == unit).ok_or_else(malformed)?;
    if number.starts_with('-') {
        return Err(UnitError::Negative(text.to_owned()));
    }
    let number = number.strip_prefix('+').unwrap_or(number);
    let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
    let digits = |part: &str| part.chars().all(|c| c.is_ascii_digit());
    if (whole.is_empty() && fraction.is_empty()) || !digits(whole) || !digits(fraction) {
        return Err(malformed());
    }
    let too_large = || UnitError::TooLarge(text.to_owned());
    let fraction = fraction.trim_end_matches('0');
    // Nothing longer can be a whole number of nanoseconds, and everything shorter fits in 128 bits.
    if fraction.len() > 18 {
        return Err(UnitError::Fraction(text.to_owned()));
    }
    let whole: u64 = if whole.is_empty() { 0 } else { whole.parse().map_err(|_| too_large())? };
    let numerator: u128 = if fraction.is_empty() { 0 } else { fraction.parse().map_err(|_| too_large())? };
    let denominator = fraction.bytes().fold(1_u128, |power, _| power * 10);
    let scaled = numerator * u128::from(*scale);
    if !scaled.is_multiple_of(denominator) {
        return Err(UnitError::Fraction(text.to_owned()));
    }
    let ns = u128::from(whole) * u128::from(*scale) + scaled / denominator;
    u64::try_from(ns).map_err(|_| too_large())
}

/// Parses a rate in hertz: `1kHz`, `500 Hz`, `0.01MHz`.
///
/// # Errors
/// A missing or unknown unit, a negative or a non-finite value.
pub fn parse_rate(text: &str) -> Result<f64, UnitError> {
    let malformed = || UnitError::Malformed { found: text.to_owned(), example: "\"1kHz\" (Hz, kHz, MHz)" };
    let (number, unit) = split_unit(text).ok_or_else(malformed)?;
    let (_, scale) = RATE_UNITS.iter().find(|(name, _)| *name == unit).ok_or_else(malformed)?;
    let value: f64 = number.parse().map_err(|_| malformed())?;
    match value * scale {
        hz if !hz.is_finite() => Err(UnitError::TooLarge(text.to_owned())),
        hz if hz < 0.0 => Err(UnitError::Negative(text.to_owned())),
        hz => Ok(hz),
    }
}

/// Parses a rise or fall in time, a duration with an optional sign: `-5ms`, `+2us`.
///
/// # Errors
/// Those of [`parse_duration`], and more than 2⁶³ − 1 ns either way.
pub fn parse_signed_duration(text: &str) -> Result<i64, UnitError> {
    let trimmed = text.trim();
    let (magnitude, sign) = trimmed.strip_prefix('-').map_or((trimmed, 1), |rest| (rest, -1));
    let ns = parse_duration(magnitude)?;
    i64::try_from(ns).map(|ns| sign * ns).map_err(|_| UnitError::TooLarge(text.to_owned()))
}

/// Refuses a time beyond [`LONGEST_NS`], which no run lasts.
pub(super) fn not_too_long(ns: u64, text: &str) -> Result<(), UnitError> {
    if ns <= LONGEST_NS { Ok(()) } else { Err(UnitError::TooLong(text.to_owned())) }
}

/// Writes a duration exactly, in the largest unit that leaves a whole number: `20ms`, `1500us`, `0s`.
#[must_use]
pub fn format_duration(ns: u64) -> String {
    // Minutes and hours are read but never written: seconds are what the reports compare.
    let units = &DURATION_UNITS[2..];
    let unit = units.iter().find(|(_, scale)| ns.is_multiple_of(*scale)).unwrap_or(&("ns", 1));
    format!("{}{}", ns / unit.1, unit.0)
}

/// Writes a rate so that reading it back gives the same double: `1kHz`, `12.5Hz`.
#[must_use]
pub fn format_rate(hz: f64) -> String {
    let exact = RATE_UNITS.iter().find(|(_, scale)| hz >= *scale && (hz / scale).fract().abs() < f64::EPSILON);
    let in_unit = exact.map(|(name, scale)| (format!("{}{name}", hz / scale), hz / scale * scale));
    match in_unit {
        Some((text, back)) if back.to_bits() == hz.to_bits() => text,
        _ => format!("{hz}Hz"),
    }
}

/// Splits `20 ms` into the number and its unit.
fn split_unit(text: &str) -> Option<(&str, &str)> {
    let text = text.trim();
    let at = text.find(|c: char| !(c.is_ascii_digit() || matches!(c, '.' | '+' | '-')))?;
    let (number, unit) = text.split_at(at);
    (!number.is_empty()).then_some((number, unit.trim_start()))
}

/// Reads the text of a quantity, and tells the writer of a bare number that it lacks its unit.
struct QuantityVisitor(&'static str);

impl serde::de::Visitor<'_> for QuantityVisitor {
    type Value = String;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "text with a unit such as \"{}\"", self.0)
    }

    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<String, E> {
        Ok(text.to_owned())
    }
}

impl Serialize for Nanos {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Nanos {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = deserializer.deserialize_any(QuantityVisitor("20ms"))?;
        text.parse().and_then(|time: Self| not_too_long(time.0, &text).map(|()| time)).map_err(serde::de::Error::custom)
    }
}

impl Serialize for Hertz {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Hertz {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(QuantityVisitor("1kHz"))?.parse().map_err(serde::de::Error::custom)
    }
}
