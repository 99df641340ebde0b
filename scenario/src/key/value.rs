//! The types of value that a key may have: what each is, and how its numbers are held to the key's limit.

use std::fmt::Display;
use std::path::PathBuf;

use super::{Key, Kind};
use crate::error::ScenarioError;
use crate::validate::{refuse, require};
use crate::{Cores, Expectation, Hertz, NamedFile, Nanos, PerLink, Scenario, SignedNanos, Target, When};
use loopbound_model::law::LawKind;
use loopbound_model::quote;

/// A type that a key may have.
pub trait Value {
    /// What it is, for documents and the schema.
    const KIND: Kind;

    /// Whether it stands there, and which word it is.
    fn presence(&self) -> Presence {
        Presence::Present
    }

    /// Holds its numbers to the limit of its key.
    ///
    /// # Errors
    /// The first one that is outside, by its dotted key.
    fn check(&self, _at: &At<'_>) -> Result<(), ScenarioError> {
        Ok(())
    }

    /// Puts in place what follows from other keys of the scenario.
    fn resolve(&mut self, _scenario: &Scenario) {}
}

/// Whether something stands behind a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// Nothing.
    Absent,
    /// Something.
    Present,
    /// This word of a closed list.
    Word(&'static str),
}

/// Where a value stands.
#[derive(Clone, Debug)]
pub struct At<'a> {
    /// Its dotted path.
    pub path: String,
    /// The key's declaration.
    pub key: &'a Key,
    /// How many links the chain has.
    pub links: usize,
}

impl At<'_> {
    /// The place of an entry of a list.
    fn entry(&self, index: usize) -> Self {
        Self { path: format!("{}[{index}]", self.path), ..self.clone() }
    }

    fn number(&self, value: f64, found: impl Display) -> Result<(), ScenarioError> {
        require(self.key.limit.allows(value), &self.path, found, self.key.limit.words)
    }

    fn each<T: Value>(&self, values: &[T]) -> Result<(), ScenarioError> {
        values.iter().enumerate().try_for_each(|(index, value)| value.check(&self.entry(index)))
    }
}

/// The keys of a section, gone through in the order of their declaration.
pub(crate) struct Fields {
    path: String,
    keys: std::slice::Iter<'static, Key>,
    links: usize,
}

impl Fields {
    /// Begins with the question which of the keys its kind needs, and which it can't have.
    pub(crate) fn of(kind: Kind, at: &At<'_>, written: &[Presence]) -> Result<Self, ScenarioError> {
        let fields = Self { path: at.path.clone(), keys: keys_of(kind).iter(), links: at.links };
        let Some(kind) = kind_of(fields.keys.as_slice(), written) else { return Ok(fields) };
        for (key, written) in fields.keys.clone().zip(written) {
            let (given, needed) = (*written != Presence::Absent, key.needed_by.contains(&kind));
            let needs = format_args!("a value, which kind \"{kind}\" needs").to_string();
            require(given || !needed, fields.path_of(key), "nothing", needs)?;
            if given && !key.applies(Some(kind)) {
                let all = fields.keys.as_slice();
                let needed = all.iter().filter(|key| key.needed_by.contains(&kind));
                let names = needed.chain(all.iter().filter(|key| key.of.contains(&kind))).map(|key| key.name);
                let names = names.collect::<Vec<_>>().join(", ");
                return refuse(
                    fields.path_of(key),
                    "a value",
                    format_args!("none with kind \"{kind}\", whose keys are {names}"),
                );
            }
        }
        Ok(fields)
    }

    fn path_of(&self, key: &Key) -> String {
        if self.path.is_empty() { key.name.to_owned() } else { format!("{}.{}", self.path, key.name) }
    }

    /// Checks the value of the next key.
    pub(crate) fn check<T: Value>(&mut self, value: &T) -> Result<(), ScenarioError> {
        let Some(key) = self.keys.next() else { return Ok(()) };
        value.check(&At { path: self.path_of(key), key, links: self.links })
    }
}

fn keys_of(kind: Kind) -> &'static [Key] {
    if let Kind::Table(section) = kind { section.keys } else { &[] }
}

/// The word behind the key `kind`, if the section has one.
fn kind_of(keys: &[Key], written: &[Presence]) -> Option<&'static str> {
    keys.iter().zip(written).find_map(|(key, written)| match written {
        Presence::Word(word) if key.name == "kind" => Some(*word),
        _ => None,
    })
}

/// Which of its keys a section of this kind may have.
pub(crate) fn applicable(kind: Kind, written: &[Presence]) -> Vec<bool> {
    let keys = keys_of(kind);
    keys.iter().map(|key| key.applies(kind_of(keys, written))).collect()
}

impl Value for bool {
    const KIND: Kind = Kind::Truth;
}

impl Value for f64 {
    const KIND: Kind = Kind::Number;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        at.number(*self, quote::number(*self))
    }
}

impl Value for u32 {
    const KIND: Kind = Kind::Whole;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        at.number(f64::from(*self), self)
    }
}

impl Value for u64 {
    const KIND: Kind = Kind::Whole;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        at.number(*self as f64, self)
    }
}

impl Value for usize {
    const KIND: Kind = Kind::Whole;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        at.number(*self as f64, self)
    }
}

impl Value for Nanos {
    const KIND: Kind = Kind::Time;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        at.number(self.ns() as f64, self)
    }
}

impl Value for SignedNanos {
    const KIND: Kind = Kind::SignedTime;
}

impl Value for When {
    const KIND: Kind = Kind::When;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        at.number(self.tick(1) as f64, self)
    }
}

impl Value for Hertz {
    const KIND: Kind = Kind::Rate;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        at.number(self.0, self)
    }
}

impl Value for LawKind {
    const KIND: Kind = Kind::Words(|| Self::ALL.map(Self::name).to_vec());
}

impl Value for PathBuf {
    const KIND: Kind = Kind::Path;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        require(!self.as_os_str().is_empty(), &at.path, "\"\"", "the path of an executable")
    }
}

impl Value for NamedFile {
    const KIND: Kind = Kind::Path;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        require(!self.path().as_os_str().is_empty(), &at.path, "\"\"", "the path of a file")
    }
}

impl Value for Target {
    const KIND: Kind = Kind::Target;
}

impl Value for Cores {
    const KIND: Kind = Kind::Cores;
}

impl Value for Expectation {
    const KIND: Kind = Kind::Condition;
}

impl Value for PerLink {
    const KIND: Kind = Kind::PerLink;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        match self {
            Self::All(value) => value.check(at),
            Self::Each(values) => {
                let (found, links) = (values.len(), at.links);
                let allowed = format_args!("one number, or {links} (one a link)").to_string();
                require(found == links, &at.path, format_args!("{found} values"), allowed)?;
                at.each(values)
            }
        }
    }
}

impl Value for [f64; 2] {
    const KIND: Kind = Kind::Pair;

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        at.each(self)
    }
}

impl<T: Value> Value for Option<T> {
    const KIND: Kind = T::KIND;

    fn presence(&self) -> Presence {
        self.as_ref().map_or(Presence::Absent, T::presence)
    }

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        self.as_ref().map_or(Ok(()), |value| value.check(at))
    }
}

impl<T: Value> Value for Vec<T> {
    const KIND: Kind = Kind::List(&T::KIND);

    fn presence(&self) -> Presence {
        if self.is_empty() { Presence::Absent } else { Presence::Present }
    }

    fn check(&self, at: &At<'_>) -> Result<(), ScenarioError> {
        let (found, most) = (self.len(), at.key.entries_max);
        require(found <= most, &at.path, format_args!("{found} of them"), format_args!("at most {most}"))?;
        at.each(self)
    }

    fn resolve(&mut self, scenario: &Scenario) {
        self.iter_mut().for_each(|entry| entry.resolve(scenario));
    }
}
