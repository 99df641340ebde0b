//! From text to a scenario: files, assignments of the command line, and the way back to text.

use super::Scenario;
use super::error::{ScenarioError, WrittenAt};
use super::keys::{KeyMap, check_assigned};
use crate::input::{self, SCENARIO_BYTES_MAX};
use loopbound_model::quote;
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use toml::de::DeTable;
use toml::{Table, Value};

impl Scenario {
    /// Reads and validates a file.
    ///
    /// # Errors
    /// An unreadable file, or any error of [`Self::from_toml`].
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        Self::read::<&str>(Some(path), &[]).map(|(scenario, _)| scenario)
    }

    /// Reads and validates a file (none: all defaults) with several `key=value` in place, and keeps where each key was
    /// written, for what can be found wrong only later.
    ///
    /// # Errors
    /// Those of [`Self::load`] and of [`Self::with_sets`].
    pub fn read<S: AsRef<str>>(path: Option<&Path>, assignments: &[S]) -> Result<(Self, Source), ScenarioError> {
        let mut origin = Source::default();
        let mut scenario = Self::default();
        if let Some(path) = path {
            let text = input::read_text(path, SCENARIO_BYTES_MAX)
                .map_err(|source| ScenarioError::Read { path: path.to_owned(), source })?;
            scenario = Self::from_toml(&text, &quote::path(path))?;
            // What a scenario names lies beside it, wherever the command is started, and also for a role that reads a copy.
            scenario.anchor(path.parent().unwrap_or(Path::new("")));
            origin.file = Some((text, quote::path(path)));
        }
        let (scenario, set) = scenario.assign(assignments).map_err(|error| origin.locate(error))?;
        origin.set = set;
        Ok((scenario, origin))
    }

    /// Reads and validates a text; `origin` stands for its file name in messages.
    ///
    /// # Errors
    /// The first fault, in one line with its place: syntax, unknown keys, types, then values out of their limits.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, ScenarioError> {
        let (table, keys) = parse(text, origin)?;
        let place = |key: &str| keys.offset(key).map_or(WrittenAt::Nowhere, |offset| place_of(text, origin, offset));
        if let Some((offset, error)) = keys.first_unknown() {
            return Err(error.at(|_| place_of(text, origin, offset)));
        }
        let scenario: Self = typed(table).map_err(|error| error.at(place))?;
        scenario.validate().map_err(|error| error.at(place))?;
        Ok(scenario)
    }

    /// This scenario with one `key=value` in place; see [`Self::with_sets`].
    ///
    /// # Errors
    /// Those of [`Self::with_sets`].
    pub fn with_set(&self, assignment: &str) -> Result<Self, ScenarioError> {
        self.with_sets(&[assignment])
    }

    /// This scenario with several `key=value` in place, validated once they all are.
    ///
    /// Keys are dotted, entries of lists are `fault[0].delay` or `fault.0.delay`, and the entry after the last is created.
    /// Values are TOML; what is not TOML is taken as text, so that `loop.rate=2kHz` needs no quotes.
    ///
    /// # Errors
    /// A malformed assignment, an unknown key, a wrong type, or a value outside its limits.
    pub fn with_sets<S: AsRef<str>>(&self, assignments: &[S]) -> Result<Self, ScenarioError> {
        self.assign(assignments).map(|(scenario, _)| scenario)
    }

    /// [`Self::with_sets`], and which key was set by which assignment.
    fn assign<S: AsRef<str>>(&self, assignments: &[S]) -> Result<(Self, Vec<Assigned>), ScenarioError> {
        let mut table = Value::Table(Table::try_from(self)?);
        let mut set = Vec::new();
        for assignment in assignments {
            let assignment = assignment.as_ref();
            let malformed =
                |message: &str| ScenarioError::Set { assignment: assignment.to_owned(), message: message.to_owned() };
            let (key, value) = assignment.split_once('=').ok_or_else(|| malformed("allowed: KEY=VALUE"))?;
            let segments = segments_of(key.trim()).ok_or_else(|| malformed("the key is not a dotted key"))?;
            check_assigned(&segments).map_err(|error| error.at(|_| WrittenAt::Set(assignment.to_owned())))?;
            let is_word = segments.last().is_some_and(|last| last == "kind");
            assign(&mut table, &segments, parse_value(value.trim(), is_word)).map_err(malformed)?;
            set.push((dotted(&segments), assignment.to_owned()));
        }
        let Value::Table(table) = table else { return Ok((self.clone(), set)) };
        let place = |key: &str| place_of_assignment(&set, key);
        let mut scenario: Self = typed(table).map_err(|error| error.at(place))?;
        scenario.validate().map_err(|error| error.at(place))?;
        scenario.anchor(Path::new(""));
        // A file that was read already, and is still the one that is meant, need not be read again (a pipe can't be).
        if scenario.reference.file == self.reference.file {
            scenario.reference.file.clone_from(&self.reference.file);
        }
        Ok((scenario, set))
    }

    /// Makes the paths in this scenario absolute, as seen from `folder`; an executable's bare name is left to the search
    /// path of the shell.
    pub fn anchor(&mut self, folder: &Path) {
        let absolute = |file: &mut PathBuf| {
            // The working directory may be gone; then the path stays as it is, and opening it says so.
            if let Ok(path) = std::path::absolute(folder.join(&*file)) {
                *file = path;
            }
        };
        let executables = self.swap.iter_mut().filter_map(|swap| swap.exe.as_mut()).chain(self.controller.exe.as_mut());
        executables.filter(|exe| exe.components().count() > 1).for_each(absolute);
        if let Some(file) = &mut self.reference.file {
            let mut path = file.path().to_owned();
            absolute(&mut path);
            *file = file.at(path);
        }
    }

    /// The scenario as TOML with all defaults filled in; reading it gives [`Self::resolved`] again, bit for bit.
    ///
    /// # Errors
    /// A value that TOML cannot express, such as a seed beyond 2⁶³ − 1.
    pub fn to_toml(&self) -> Result<String, ScenarioError> {
        Ok(toml::to_string(&self.resolved())?)
    }
}

impl super::ExpectSection {
    /// Reads a file of expectations: an `[expect]` table, or its keys alone.
    ///
    /// # Errors
    /// Syntax, or a condition that cannot be understood.
    pub fn from_toml(text: &str, origin: &str) -> Result<Self, ScenarioError> {
        let (mut table, keys) = parse(text, origin)?;
        let place = |key: &str| keys.offset(key).map_or(WrittenAt::Nowhere, |offset| place_of(text, origin, offset));
        let inner = table.remove("expect");
        let (table, prefix) = match inner {
            Some(Value::Table(inner)) => (inner, "expect."),
            _ => (table, ""),
        };
        let section: Self = typed(table).map_err(|error| match error {
            ScenarioError::Type { key, message, .. } => {
                let key = format!("{prefix}{key}");
                ScenarioError::Type { place: place(&key), key, message }
            }
            other => other,
        })?;
        let scenario = Scenario { expect: section, ..Scenario::default() };
        let unprefixed =
            |key: &str| place(if prefix.is_empty() { key.strip_prefix("expect.").unwrap_or(key) } else { key });
        scenario.validate().map_err(|error| error.at(unprefixed))?;
        Ok(scenario.expect)
    }
}

/// A key and the assignment that set it.
type Assigned = (String, String);

/// The last assignment that reaches the key, or a part of it, is the one to blame.
fn place_of_assignment(set: &[Assigned], key: &str) -> WrittenAt {
    let reaches = |set: &str| key == set || key.strip_prefix(set).is_some_and(|rest| rest.starts_with(['.', '[']));
    let last = set.iter().rev().find(|(path, _)| reaches(path) || path.starts_with(key));
    last.map_or(WrittenAt::Nowhere, |(_, assignment)| WrittenAt::Set(assignment.clone()))
}

/// Where the keys of a scenario were written: a file, and what the command line set.
#[derive(Clone, Debug, Default)]
pub struct Source {
    /// Text and name of the file.
    file: Option<(String, String)>,
    set: Vec<Assigned>,
}

impl Source {
    /// The same error with the place of its key, if it has none yet and the key was written anywhere.
    #[must_use]
    pub fn locate(&self, error: ScenarioError) -> ScenarioError {
        error.at(|key| {
            let set = place_of_assignment(&self.set, key);
            match &self.file {
                Some((text, origin)) if set == WrittenAt::Nowhere => {
                    let keys = parse(text, origin).map(|(_, keys)| keys).unwrap_or_default();
                    keys.offset(key).map_or(WrittenAt::Nowhere, |offset| place_of(text, origin, offset))
                }
                _ => set,
            }
        })
    }
}

/// The document as plain values, and where its keys stand.
fn parse(text: &str, origin: &str) -> Result<(Table, KeyMap), ScenarioError> {
    let syntax = |error: toml::de::Error| ScenarioError::Syntax {
        place: place_of(text, origin, error.span().map_or(0, |span| span.start)),
        message: error.message().replace('\n', ", "),
    };
    let document = DeTable::parse(text).map_err(syntax)?;
    let table: Table = toml::from_str(text).map_err(syntax)?;
    Ok((table, KeyMap::of(document.get_ref())))
}

/// Line and column, counted from 1, of a byte offset.
fn place_of(text: &str, origin: &str, offset: usize) -> WrittenAt {
    let before = text.get(..offset).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
    let line = before.matches('\n').count() + 1;
    WrittenAt::File { origin: origin.to_owned(), line, column: before[line_start..].chars().count() + 1 }
}

/// The typed form of a table; errors carry the dotted key.
fn typed<T: DeserializeOwned>(table: Table) -> Result<T, ScenarioError> {
    serde_path_to_error::deserialize(Value::Table(table)).map_err(|error| {
        let path = error.path().to_string();
        let message = error.into_inner().message().to_owned();
        let (key, message) = blame(&path, &message);
        ScenarioError::Type { place: WrittenAt::Nowhere, key, message }
    })
}

/// The key and the wording for a message of the deserialiser, which may name a key below `path` itself.
fn blame(path: &str, message: &str) -> (String, String) {
    let below = message.strip_prefix('`').and_then(|rest| rest.split_once("`: "));
    let missing = message.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`'));
    let (key, message) = match (below, missing) {
        (Some((key, rest)), _) => (Some(key), rest),
        (None, Some(key)) => (Some(key), "is missing"),
        (None, None) => (None, message),
    };
    let path = match (key, path) {
        (Some(key), "." | "") => key.to_owned(),
        (Some(key), path) => format!("{path}.{key}"),
        (None, path) => path.to_owned(),
    };
    let found = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    let worded = found.and_then(|rest| rest.split_once(", expected "));
    let message = worded.map_or_else(
        || message.to_owned(),
        |(found, allowed)| format!("found {}, allowed: {}", quote::text(found), type_in_words(allowed)),
    );
    (path, message.replace('\n', ", "))
}

/// What the deserialiser calls a type of the language, as a user would.
fn type_in_words(name: &str) -> &str {
    match name {
        "f64" => "a number",
        "u32" | "u64" | "usize" => "a whole number, not negative",
        "a boolean" => "true or false",
        other => other,
    }
}

/// Splits `fault[0].delay` and `fault.0.delay` into their parts; the rest behind `expect.` is one key.
fn segments_of(key: &str) -> Option<Vec<String>> {
    if let Some(condition) = key.strip_prefix("expect.") {
        return (!condition.is_empty()).then(|| vec!["expect".to_owned(), condition.trim_matches('"').to_owned()]);
    }
    let plain = key.replace('[', ".").replace(']', "");
    let segments: Vec<String> = plain.split('.').map(str::to_owned).collect();
    segments.iter().all(|segment| !segment.is_empty()).then_some(segments)
}

/// The parts as a dotted path with `[0]` for indices.
fn dotted(segments: &[String]) -> String {
    segments.iter().fold(String::new(), |path, segment| match (segment.parse::<usize>(), path.is_empty()) {
        (Ok(index), _) => format!("{path}[{index}]"),
        (Err(_), true) => segment.clone(),
        (Err(_), false) => format!("{path}.{segment}"),
    })
}

/// A value of the command line: TOML if it is, else text. `is_word`: of a key that takes a word, and one of the words is `nan`.
fn parse_value(text: &str, is_word: bool) -> Value {
    let words = || Value::String(text.to_owned());
    match toml::from_str::<Table>(&format!("value = {text}")) {
        Ok(mut table) if table.len() == 1 => {
            table.remove("value").filter(|value| !(is_word && value.is_float())).unwrap_or_else(words)
        }
        _ => words(),
    }
}

/// Puts `value` at the end of the path, creating tables and the entry after the last of a list on its way.
fn assign(root: &mut Value, segments: &[String], value: Value) -> Result<(), &'static str> {
    let mut here = root;
    for (depth, segment) in segments.iter().enumerate() {
        let next_is_index = segments.get(depth + 1).is_some_and(|next| next.parse::<usize>().is_ok());
        let empty = || if next_is_index { Value::Array(Vec::new()) } else { Value::Table(Table::new()) };
        here = match (here, segment.parse::<usize>()) {
            (Value::Array(list), Ok(index)) if index <= list.len() => {
                if index == list.len() {
                    list.push(empty());
                }
                &mut list[index]
            }
            (Value::Array(_), Ok(_)) => return Err("the list has fewer entries"),
            (Value::Table(table), Err(_)) => table.entry(segment.clone()).or_insert_with(empty),
            (Value::Table(_), Ok(_)) => return Err("there is no list here"),
            _ => return Err("a part of the key is not a table"),
        };
    }
    *here = value;
    Ok(())
}
