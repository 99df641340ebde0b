//! What a key of a scenario is, and the macro that declares a section of them.
//!
//! A key is declared once, as a field of its section: name, type, default, unit, limit and description. `section!` makes the
//! field and the default of it, and a [`Key`] in the list of its [`Section`]. Everything else walks that list: the search for
//! unknown keys, the validation, the resolved scenario, `scenarios/paper.toml`, the tables of `docs/scenario.md`, and the JSON
//! schema. What a type of value contributes to these is its [`Value`].

mod limit;
mod value;

pub use limit::Limit;
pub(crate) use limit::{ABOVE_ZERO, AT_LEAST_ONE, FINITE, NOT_NEGATIVE, POSITIVE, POSITIVE_OR_INF};
pub use value::{At, Presence, Value};
pub(crate) use value::{Fields, applicable};

use crate::Scenario;

/// One key, as it is declared.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// The name in a file, the last part of the dotted key.
    pub name: &'static str,
    /// What may stand behind it.
    pub kind: Kind,
    /// The lines of its description. The first sentence alone is the comment of `scenarios/paper.toml`.
    about: &'static [&'static str],
    /// Unit of its numbers, where they have one.
    pub unit: &'static str,
    /// What its numbers may be.
    pub limit: Limit,
    /// The most entries of a list.
    pub entries_max: usize,
    /// The default in words, where it is not a plain value.
    pub otherwise: &'static str,
    /// A value as an example, where the default scenario has none.
    pub example: &'static str,
    /// Whether every entry must have it.
    pub needed: bool,
    /// The kinds of its section (values of the key `kind`) that can't do without it.
    pub needed_by: &'static [&'static str],
    /// The further kinds that may have it. With both lists empty every kind may.
    pub of: &'static [&'static str],
}

/// What may stand behind a key.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A number.
    Number,
    /// A whole number, not negative.
    Whole,
    /// `true` or `false`.
    Truth,
    /// A length of time.
    Time,
    /// A length of time with a sign.
    SignedTime,
    /// A length of time, or a number of ticks.
    When,
    /// A rate.
    Rate,
    /// One of these words.
    Words(fn() -> Vec<&'static str>),
    /// A number for all links, or a list with one a link.
    PerLink,
    /// A list of two numbers.
    Pair,
    /// The path of a file.
    Path,
    /// A role, or one process of a role.
    Target,
    /// `auto`, or a list of cores.
    Cores,
    /// A condition of `[expect]`: not a key of its own, but what any other key of its section is.
    Condition,
    /// A list.
    List(&'static Kind),
    /// A table of keys.
    Table(&'static Section),
}

/// A table of keys.
#[derive(Debug)]
pub struct Section {
    about: &'static [&'static str],
    /// Its keys, in the order in which they are declared.
    pub keys: &'static [Key],
}

/// A section with the place where it stands.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The dotted path, with `[]` behind a list of tables.
    pub path: String,
    /// What stands there.
    pub section: &'static Section,
}

/// A number without limits of its own, or whose limits depend on other keys (those are in `validate`).
pub(crate) const fn key() -> Key {
    Key {
        name: "",
        kind: Kind::Truth,
        about: &[],
        unit: "",
        limit: Limit::NONE,
        entries_max: usize::MAX,
        otherwise: "",
        example: "",
        needed: false,
        needed_by: &[],
        of: &[],
    }
}

impl Key {
    /// With this unit.
    pub(crate) const fn unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    /// With numbers that `limit` allows.
    pub(crate) const fn within(self, limit: Limit) -> Self {
        Self { limit, ..self }
    }

    /// With at most so many entries.
    pub(crate) const fn at_most(self, entries_max: usize) -> Self {
        Self { entries_max, ..self }
    }

    /// With a default in these words.
    pub(crate) const fn otherwise(self, otherwise: &'static str) -> Self {
        Self { otherwise, ..self }
    }

    /// Shown with this value, as TOML, where the default scenario has none.
    pub(crate) const fn example(self, example: &'static str) -> Self {
        Self { example, ..self }
    }

    /// Needed in every entry.
    pub(crate) const fn needed(self) -> Self {
        Self { needed: true, ..self }
    }

    /// Needed by these kinds of its section.
    pub(crate) const fn needed_by(self, needed_by: &'static [&'static str]) -> Self {
        Self { needed_by, ..self }
    }

    /// Possible with these kinds of its section.
    pub(crate) const fn of(self, of: &'static [&'static str]) -> Self {
        Self { of, ..self }
    }

    /// Completed by what the field itself says; a trailing underscore of the field belongs to Rust.
    pub(crate) const fn declared(self, field: &'static str, kind: Kind, about: &'static [&'static str]) -> Self {
        let name = match field.as_bytes() {
            [.., b'_'] => field.split_at(field.len() - 1).0,
            _ => field,
        };
        Self { name, kind, about, ..self }
    }

    /// The whole description.
    #[must_use]
    pub fn description(&self) -> String {
        joined(self.about)
    }

    /// Its first sentence, without the full stop.
    #[must_use]
    pub fn sentence(&self) -> String {
        first_sentence(self.about)
    }

    /// Whether a section of this kind (`None`: its section has no kinds) may have the key.
    #[must_use]
    pub fn applies(&self, kind: Option<&str>) -> bool {
        let Some(kind) = kind else { return true };
        (self.of.is_empty() && self.needed_by.is_empty()) || self.of.contains(&kind) || self.needed_by.contains(&kind)
    }

    /// The kinds of its section that may have it, where others may not.
    #[must_use]
    pub fn kinds(&self) -> Vec<&'static str> {
        if self.of.is_empty() { Vec::new() } else { [self.needed_by, self.of].concat() }
    }

    /// The default, where it is not a plain value: who needs the key, or what follows without it.
    #[must_use]
    pub fn default_in_words(&self) -> String {
        let needed_by = self.needed_by.join(", ");
        match (self.needed, needed_by.is_empty()) {
            (true, _) => "needed".to_owned(),
            (false, true) => self.otherwise.to_owned(),
            (false, false) if self.otherwise.is_empty() => format!("needed by {needed_by}"),
            (false, false) => format!("needed by {needed_by}; {}", self.otherwise),
        }
    }

    /// The section below the key, if it has one, and whether there may be several.
    #[must_use]
    pub fn section(&self) -> Option<(&'static Section, bool)> {
        match self.kind {
            Kind::Table(section) => Some((section, false)),
            Kind::List(Kind::Table(section)) => Some((section, true)),
            _ => None,
        }
    }

    /// Whether any key that is not declared stands for this one: the conditions of `[expect]`.
    #[must_use]
    pub fn is_open(&self) -> bool {
        matches!(self.kind, Kind::List(Kind::Condition))
    }

    /// What may stand behind it: type, unit and limit, in words.
    #[must_use]
    pub fn allowed(&self) -> String {
        self.with_kind(&self.kind.in_words())
    }

    /// The same without a type that every value shows.
    #[must_use]
    pub fn restriction(&self) -> String {
        let plain =
            matches!(self.kind, Kind::Number | Kind::Whole | Kind::Truth | Kind::Time | Kind::Rate | Kind::Path);
        self.with_kind(&if plain { String::new() } else { self.kind.in_words() })
    }

    fn with_kind(&self, kind: &str) -> String {
        [kind, self.unit, self.limit.brief].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ")
    }
}

impl Kind {
    /// The type, in words.
    fn in_words(&self) -> String {
        match self {
            Self::Number | Self::Condition => "number".to_owned(),
            Self::Whole => "whole number".to_owned(),
            Self::Truth => "true or false".to_owned(),
            Self::Time => "time".to_owned(),
            Self::SignedTime => "time with a sign".to_owned(),
            Self::When => "time or ticks".to_owned(),
            Self::Rate => "rate".to_owned(),
            Self::Words(words) => words().join(" | "),
            Self::PerLink | Self::List(Self::Number) => "one a link".to_owned(),
            Self::Pair => "two numbers".to_owned(),
            Self::Path => "path".to_owned(),
            Self::Target => "role, or role:number".to_owned(),
            Self::Cores => "\"auto\", or a list".to_owned(),
            Self::List(Self::List(_)) => "matrix".to_owned(),
            Self::List(_) | Self::Table(_) => String::new(),
        }
    }
}

impl Section {
    /// The section of these keys, described by these lines.
    pub(crate) const fn declared(about: &'static [&'static str], keys: &'static [Key]) -> Self {
        Self { about, keys }
    }

    /// The first sentence of its description, without the full stop.
    #[must_use]
    pub fn sentence(&self) -> String {
        first_sentence(self.about)
    }

    /// The values of the key `kind`, if it has one.
    #[must_use]
    pub fn kinds(&self) -> Vec<&'static str> {
        let kind = self.keys.iter().find(|key| key.name == "kind");
        kind.map_or_else(Vec::new, |key| if let Kind::Words(words) = key.kind { words() } else { Vec::new() })
    }

    /// The keys that stand in the section itself: neither sections nor the conditions of `[expect]`.
    pub fn own_keys(&self) -> impl Iterator<Item = &'static Key> + use<> {
        self.keys.iter().filter(|key| key.section().is_none() && !key.is_open())
    }

    fn place(&'static self, path: String, found: &mut Vec<Placed>) {
        if !path.is_empty() {
            found.push(Placed { path: path.clone(), section: self });
        }
        for key in self.keys {
            if let Some((section, several)) = key.section() {
                let dot = if path.is_empty() { "" } else { "." };
                section.place(format!("{path}{dot}{}{}", key.name, if several { "[]" } else { "" }), found);
            }
        }
    }
}

impl Placed {
    /// All sections of a scenario, in the order in which they are declared.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut found = Vec::new();
        if let Kind::Table(root) = Scenario::KIND {
            root.place(String::new(), &mut found);
        }
        found
    }

    /// The header of the section in a file.
    #[must_use]
    pub fn header(&self) -> String {
        self.path.strip_suffix("[]").map_or_else(|| format!("[{}]", self.path), |list| format!("[[{list}]]"))
    }
}

/// The lines of a description as one text.
fn joined(about: &[&str]) -> String {
    about.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" ")
}

fn first_sentence(about: &[&str]) -> String {
    let text = joined(about);
    let end = text.find(". ").unwrap_or(text.len());
    text[..end].trim_end_matches('.').to_owned()
}

/// The value that a run uses, by the rule of a declaration.
pub(crate) fn resolved<S, T>(scenario: &Scenario, own: &S, rule: fn(&Scenario, &S) -> T) -> T {
    rule(scenario, own)
}

/// Declares a section: a struct whose fields are keys.
///
/// A field is `name: Type = default => key()…;`. Entries of lists, where something is always needed, have no defaults, and so no
/// `= default`. `resolved |scenario, own| …` before the arrow gives the value that a run uses, where that follows from other keys.
macro_rules! section {
    ($(#[doc = $about:literal])+ $(#[serde($($table:tt)*)])? pub struct $section:ident {$(
        $(#[doc = $doc:literal])+ $(#[serde($($serde:tt)*)])?
        $field:ident: $type:ty = $default:expr $(, resolved $resolved:expr)? => $key:expr;
    )+}) => {
        $crate::key::section! {
            $(#[doc = $about])+ $(#[serde($($table)*)])? pub struct $section {$(
                $(#[doc = $doc])+ $(#[serde($($serde)*)])? $field: $type $(, resolved $resolved)? => $key;
            )+}
        }

        impl Default for $section {
            fn default() -> Self {
                Self { $($field: $default),+ }
            }
        }
    };
    ($(#[doc = $about:literal])+ $(#[serde($($table:tt)*)])? pub struct $section:ident {$(
        $(#[doc = $doc:literal])+ $(#[serde($($serde:tt)*)])?
        $field:ident: $type:ty $(, resolved $resolved:expr)? => $key:expr;
    )+}) => {
        $(#[doc = $about])+
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        $(#[serde($($table)*)])?
        pub struct $section {$(
            $(#[doc = $doc])+
            $(#[serde($($serde)*)])?
            pub $field: $type,
        )+}

        impl $crate::key::Value for $section {
            const KIND: $crate::key::Kind = $crate::key::Kind::Table(&$crate::key::Section::declared(&[$($about),+], &[$(
                $key.declared(stringify!($field), <$type as $crate::key::Value>::KIND, &[$($doc),+])
            ),+]));

            fn check(&self, at: &$crate::key::At<'_>) -> Result<(), $crate::ScenarioError> {
                let mut fields = $crate::key::Fields::of(Self::KIND, at, &[$(self.$field.presence()),+])?;
                $(fields.check(&self.$field)?;)+
                Ok(())
            }

            fn resolve(&mut self, scenario: &$crate::Scenario) {
                let mut applicable = $crate::key::applicable(Self::KIND, &[$(self.$field.presence()),+]).into_iter();
                $(if applicable.next() == Some(true) {
                    $(
                        self.$field = $crate::key::resolved(scenario, self, $resolved);
                    )?
                    self.$field.resolve(scenario);
                })+
            }
        }
    };
}
pub(crate) use section;
