//! `[expect]`: what a run must show, on any key of its summary.

use loopbound_model::quote;

use super::key::{Limit, key, section};
use super::units::{Nanos, parse_duration};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

/// Comparison of a measured value with its budget.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comparator {
    /// `<`
    Less,
    /// `<=`
    LessOrEqual,
    /// `==`
    Equal,
    /// `!=`
    NotEqual,
    /// `>=`
    GreaterOrEqual,
    /// `>`
    Greater,
}

impl Comparator {
    /// All of them; where one is the beginning of another, the longer comes first.
    const ALL: [(&'static str, Self); 6] = [
        ("<=", Self::LessOrEqual),
        (">=", Self::GreaterOrEqual),
        ("==", Self::Equal),
        ("!=", Self::NotEqual),
        ("<", Self::Less),
        (">", Self::Greater),
    ];

    /// Whether `measured` stands in this relation to `budget`.
    #[must_use]
    #[expect(clippy::float_cmp, reason = "== in an expectation is meant exactly, mostly for counts")]
    pub fn holds(self, measured: f64, budget: f64) -> bool {
        match self {
            Self::Less => measured < budget,
            Self::LessOrEqual => measured <= budget,
            Self::Equal => measured == budget,
            Self::NotEqual => measured != budget,
            Self::GreaterOrEqual => measured >= budget,
            Self::Greater => measured > budget,
        }
    }
}

impl fmt::Display for Comparator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::ALL.iter().find(|(_, value)| value == self).map_or("", |(name, _)| name);
        f.write_str(name)
    }
}

/// What a measured value is compared with.
#[derive(Clone, Debug, PartialEq)]
pub enum Budget {
    /// A plain number in the unit of the key.
    Number(f64),
    /// A time.
    Time(Nanos),
    /// So many times what the host alone did to a periodic thread in the same run.
    Floor(f64),
    /// A word or a truth value, for `==` and `!=`.
    Text(String),
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => f.write_str(&quote::number(*value)),
            Self::Time(time) => write!(f, "{time}"),
            Self::Floor(factor) => write!(f, "{factor} floor"),
            Self::Text(text) => f.write_str(text),
        }
    }
}

/// One condition: a key's value against a budget.
#[derive(Clone, Debug, PartialEq)]
pub struct Expectation {
    /// Dotted key of the summary, such as `round_trip.p99`.
    pub key: String,
    /// The relation.
    pub comparator: Comparator,
    /// The other side.
    pub budget: Budget,
}

impl fmt::Display for Expectation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} {}", quote::text(&self.key), self.comparator, quote::text(&self.budget.to_string()))
    }
}

/// Parses `<= 50us`, `<= 3 floor`, `== 0`, `== true`.
///
/// # Errors
/// One line that says what was found and what is allowed.
pub fn parse_condition(text: &str) -> Result<(Comparator, Budget), String> {
    let trimmed = text.trim();
    let malformed = || {
        format!("found \"{}\", allowed: a comparison such as \"<= 50us\", \"<= 3 floor\", \"== 0\"", quote::text(text))
    };
    let comparator = Comparator::ALL.iter().find_map(|(name, value)| Some((trimmed.strip_prefix(name)?, *value)));
    let (rest, comparator) = comparator.ok_or_else(malformed)?;
    let rest = rest.trim();
    let finite = |number: &str| number.trim().parse::<f64>().ok().filter(|value| value.is_finite());
    let budget = if let Some(factor) = rest.strip_suffix("floor") {
        Budget::Floor(finite(factor).filter(|factor| *factor > 0.0).ok_or_else(malformed)?)
    } else if let Some(value) = finite(rest) {
        Budget::Number(value)
    } else if let Ok(ns) = parse_duration(rest) {
        Budget::Time(Nanos(ns))
    } else if rest.starts_with(|c: char| c.is_ascii_alphabetic())
        && !rest.eq_ignore_ascii_case("nan")
        && !rest.eq_ignore_ascii_case("inf")
        && matches!(comparator, Comparator::Equal | Comparator::NotEqual)
    {
        Budget::Text(rest.to_owned())
    } else {
        return Err(malformed());
    };
    Ok((comparator, budget))
}

impl FromStr for Expectation {
    type Err = String;

    /// Parses `round_trip.p99 <= 50us`.
    fn from_str(text: &str) -> Result<Self, String> {
        let at = text
            .find(['<', '>', '=', '!'])
            .ok_or_else(|| format!("found \"{}\", allowed: KEY <= VALUE", quote::text(text)))?;
        let (key, condition) = text.split_at(at);
        let (comparator, budget) = parse_condition(condition)?;
        Ok(Self { key: key.trim().to_owned(), comparator, budget })
    }
}

/// Both limits excluded: at one half nothing is known, and at 1 nothing is ever certain.
const CONFIDENCE: Limit = Limit::range(0.5, 1.0, "between 0.5 and 1, both excluded").without_least().without_most();

section! {
    /// What the run must show: keys of the summary with a condition, or a list of conditions.
    #[serde(default, expecting = "a table of summary keys with comparisons such as \"<= 50us\"")]
    pub struct ExpectSection {
        /// An undecided run is prolonged up to this.
        max_duration: Option<Nanos> = None, resolved |s, _| Some(Nanos(s.max_duration_ns()))
            => key().otherwise("three times the duration");
        /// Confidence of the limits by which a quantile passes or fails.
        confidence: f64 = 0.99 => key().within(CONFIDENCE);
        /// The conditions; all must hold. Sorted by key.
        #[serde(flatten, with = "conditions")]
        conditions: Vec<Expectation> = Vec::new()
            => key().example("\"round_trip.p99\" = [\"<= 200us\", \"<= 10 floor\"]\n\"missed_ticks\" = \"== 0\"");
    }
}

/// What may stand behind a key of `[expect]`; dotted keys without quotes arrive as nested tables.
#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Truth(bool),
    Number(f64),
    Text(String),
    List(Vec<String>),
    Table(BTreeMap<String, Written>),
}

/// The conditions of a table: any key, with what may stand behind it.
mod conditions {
    use super::{BTreeMap, Expectation, Written, parse_condition};
    use serde::de::{Error as _, MapAccess, Visitor};
    use serde::{Deserializer, Serialize as _, Serializer};
    use std::fmt;

    struct Conditions;

    impl<'de> Visitor<'de> for Conditions {
        type Value = Vec<Expectation>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a table of summary keys with comparisons such as \"<= 50us\"")
        }

        fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
            let mut found = Vec::new();
            while let Some(key) = map.next_key::<String>()? {
                let written: Written = map.next_value().map_err(|_| {
                    A::Error::custom(format!("`{key}`: allowed: a comparison such as \"<= 50us\", or a list of them"))
                })?;
                add(&mut found, &key, &written).map_err(A::Error::custom)?;
            }
            // A stable sort: conditions of one key keep the order of the file.
            found.sort_by(|a: &Expectation, b| a.key.cmp(&b.key));
            Ok(found)
        }
    }

    /// Adds what is written behind `key`, which may be a tree.
    fn add(found: &mut Vec<Expectation>, key: &str, written: &Written) -> Result<(), String> {
        let mut push = |text: &str| {
            let (comparator, budget) = parse_condition(text).map_err(|message| format!("`{key}`: {message}"))?;
            found.push(Expectation { key: key.to_owned(), comparator, budget });
            Ok(())
        };
        match written {
            Written::Truth(value) => push(&format!("== {value}")),
            Written::Number(value) => push(&format!("== {value}")),
            Written::Text(text) => push(text),
            Written::List(texts) => texts.iter().try_for_each(|text| push(text)),
            Written::Table(table) => {
                table.iter().try_for_each(|(part, written)| add(found, &format!("{key}.{part}"), written))
            }
        }
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Expectation>, D::Error> {
        deserializer.deserialize_map(Conditions)
    }

    pub(super) fn serialize<S: Serializer>(conditions: &[Expectation], serializer: S) -> Result<S::Ok, S::Error> {
        let mut by_key: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for Expectation { key, comparator, budget } in conditions {
            by_key.entry(key).or_default().push(format!("{comparator} {budget}"));
        }
        by_key.serialize(serializer)
    }
}
