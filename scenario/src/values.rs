//! Values that a scenario may write in more than one way.

use super::names::Role;
use super::units::{Nanos, not_too_long, parse_duration, parse_signed_duration};
use loopbound_model::quote;
use serde::de::{SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// A number for every link alike, or a list with one number a link.
#[derive(Clone, Debug, PartialEq)]
pub enum PerLink {
    /// The same for every link.
    All(f64),
    /// One a link.
    Each(Vec<f64>),
}

impl PerLink {
    /// One number a link; a list is returned as it stands, its length was checked by `Scenario::validate`.
    #[must_use]
    pub fn to_vec(&self, links: usize) -> Vec<f64> {
        match self {
            Self::All(value) => vec![*value; links],
            Self::Each(values) => values.clone(),
        }
    }

    /// The values as written.
    #[must_use]
    pub fn written(&self) -> &[f64] {
        match self {
            Self::All(value) => std::slice::from_ref(value),
            Self::Each(values) => values,
        }
    }

    /// The length of the list, if it is one.
    #[must_use]
    pub fn len_if_list(&self) -> Option<usize> {
        match self {
            Self::All(_) => None,
            Self::Each(values) => Some(values.len()),
        }
    }
}

impl Serialize for PerLink {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All(value) => serializer.serialize_f64(*value),
            Self::Each(values) => values.serialize(serializer),
        }
    }
}

struct PerLinkVisitor;

impl<'de> Visitor<'de> for PerLinkVisitor {
    type Value = PerLink;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, or a list with one number a link")
    }

    fn visit_f64<E>(self, value: f64) -> Result<PerLink, E> {
        Ok(PerLink::All(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<PerLink, E> {
        Ok(PerLink::All(value as f64))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<PerLink, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = list.next_element()? {
            values.push(value);
        }
        Ok(PerLink::Each(values))
    }
}

impl<'de> Deserialize<'de> for PerLink {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PerLinkVisitor)
    }
}

/// An instant or a length of time: a duration (`"2s"`) or a number of ticks (`2000`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// Time since tick 0, or its length.
    Time(Nanos),
    /// A tick, or a number of ticks.
    Tick(u64),
}

impl When {
    /// The first tick that does not lie before this instant, for a period of `period_ns`.
    #[must_use]
    pub fn tick(self, period_ns: u64) -> u64 {
        match self {
            Self::Time(time) => time.ns().div_ceil(period_ns.max(1)),
            Self::Tick(tick) => tick,
        }
    }
}

impl fmt::Display for When {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Time(time) => time.fmt(f),
            Self::Tick(tick) => tick.fmt(f),
        }
    }
}

impl Serialize for When {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Time(time) => time.serialize(serializer),
            Self::Tick(tick) => serializer.serialize_u64(*tick),
        }
    }
}

struct WhenVisitor;

impl Visitor<'_> for WhenVisitor {
    type Value = When;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a duration such as \"2s\", or a tick such as 2000")
    }

    fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<When, E> {
        let tick = u64::try_from(value).map_err(|_| E::custom(format!("found {value}, allowed: not negative")))?;
        Ok(When::Tick(tick))
    }

    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<When, E> {
        let parsed = parse_duration(text).and_then(|ns| not_too_long(ns, text).map(|()| ns));
        parsed.map(|ns| When::Time(Nanos(ns))).map_err(E::custom)
    }
}

impl<'de> Deserialize<'de> for When {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(WhenVisitor)
    }
}

/// A jump in time, forwards or backwards (ns).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SignedNanos(pub i64);

impl Serialize for SignedNanos {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let sign = if self.0 < 0 { "-" } else { "" };
        serializer.collect_str(&format_args!("{sign}{}", Nanos(self.0.unsigned_abs())))
    }
}

impl<'de> Deserialize<'de> for SignedNanos {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let parsed = parse_signed_duration(&text).and_then(|ns| not_too_long(ns.unsigned_abs(), &text).map(|()| ns));
        parsed.map(Self).map_err(serde::de::Error::custom)
    }
}

/// Whom a fault befalls: every process of a role (`controller`), or one of them (`controller:2`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// The role.
    pub role: Role,
    /// The process within the role, counted from 1; all of them if absent.
    pub id: Option<u32>,
}

impl Target {
    /// Whether the process `id` of `role` is meant.
    #[must_use]
    pub fn matches(self, role: Role, id: u32) -> bool {
        self.role == role && self.id.is_none_or(|wanted| wanted == id)
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.id {
            Some(id) => write!(f, "{}:{id}", self.role),
            None => write!(f, "{}", self.role),
        }
    }
}

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (role, id) = text.split_once(':').map_or((text, None), |(role, id)| (role, Some(id)));
        let id = id.map(|id| match id.parse::<u32>() {
            Ok(id) if id >= 1 => Ok(id),
            _ => Err(format!(
                "found \"{}\", allowed: a role and a number from 1, such as \"controller:2\"",
                quote::text(text)
            )),
        });
        Ok(Self { role: role.parse()?, id: id.transpose()? })
    }
}

impl Serialize for Target {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Target {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// The cores a group may use.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Cores {
    /// Chosen from what the machine offers.
    #[default]
    Auto,
    /// These, the first for the plant, the next for the controllers.
    List(Vec<usize>),
}

impl Serialize for Cores {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::List(cores) => cores.serialize(serializer),
        }
    }
}

struct CoresVisitor;

impl<'de> Visitor<'de> for CoresVisitor {
    type Value = Cores;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"auto\", or a list of cores such as [2, 3]")
    }

    fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Cores, E> {
        if text == "auto" { Ok(Cores::Auto) } else { Err(E::invalid_value(serde::de::Unexpected::Str(text), &self)) }
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Cores, A::Error> {
        let mut cores = Vec::new();
        while let Some(core) = list.next_element()? {
            cores.push(core);
        }
        Ok(Cores::List(cores))
    }
}

impl<'de> Deserialize<'de> for Cores {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(CoresVisitor)
    }
}
