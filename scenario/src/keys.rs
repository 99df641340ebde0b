//! The search for a key that is not declared.

use super::error::{ScenarioError, WrittenAt};
use super::key::Placed;
use loopbound_model::quote::nearest;
use std::collections::BTreeMap;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Every key as a dotted pattern; `[]` stands for the index in a list of tables.
pub(super) fn known_keys() -> impl Iterator<Item = String> {
    let of = |placed: Placed| placed.section.own_keys().map(move |key| format!("{}.{}", placed.path, key.name));
    Placed::all().into_iter().flat_map(of)
}

/// Whether a dotted pattern is a key, a section, or leads to one.
fn is_known(pattern: &str) -> bool {
    Placed::all().iter().any(|Placed { path, section }| {
        let below = |longer: &str| longer.strip_prefix(pattern).is_some_and(|rest| rest.starts_with(['.', '[']));
        let key = pattern.strip_prefix(path.as_str()).and_then(|rest| rest.strip_prefix('.'));
        let is_key = |key: &str| section.keys.iter().any(|known| known.is_open() || known.name == key);
        path == pattern || below(path) || key.is_some_and(is_key)
    })
}

/// The first unknown key (`path`, written as the pattern `pattern`) as an error without a place.
fn unknown(path: &str, pattern: &str) -> ScenarioError {
    let known: Vec<String> = known_keys().collect();
    // A key in the wrong section is more often misplaced than misspelt beyond recognition.
    let leaf = pattern.rsplit('.').next().unwrap_or(pattern);
    let same_leaf = known.iter().find(|key| key.rsplit('.').next() == Some(leaf)).map(String::as_str);
    let near = nearest(pattern, known.iter().map(String::as_str)).or(same_leaf);
    ScenarioError::UnknownKey { place: WrittenAt::Nowhere, key: path.to_owned(), nearest: near.map(str::to_owned) }
}

/// Where each key stands in a text, and the unknown ones in the order of the text.
#[derive(Debug, Default)]
pub(super) struct KeyMap {
    /// Byte offset of each key or list entry, by dotted path.
    offsets: BTreeMap<String, usize>,
    /// Offset, path and pattern of unknown keys.
    unknown: Vec<(usize, String, String)>,
}

impl KeyMap {
    /// Walks the whole document.
    pub(super) fn of(document: &DeTable<'_>) -> Self {
        let mut map = Self::default();
        map.walk_table(document, "", "", None);
        map.unknown.sort();
        map
    }

    /// The first unknown key of the text with its offset.
    pub(super) fn first_unknown(&self) -> Option<(usize, ScenarioError)> {
        self.unknown.first().map(|(offset, path, pattern)| (*offset, unknown(path, pattern)))
    }

    /// The offset of a key, or of the nearest thing above it that is written.
    pub(super) fn offset(&self, path: &str) -> Option<usize> {
        let mut path = path;
        loop {
            if let Some(offset) = self.offsets.get(path) {
                return Some(*offset);
            }
            path = &path[..path.rfind(['.', '['])?];
        }
    }

    fn walk_table(&mut self, table: &DeTable<'_>, path: &str, pattern: &str, lost_at: Option<usize>) {
        for (key, value) in table {
            let join = |prefix: &str| {
                if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) }
            };
            let (path, pattern) = (join(path), join(pattern));
            let lost_at = lost_at.or_else(|| (!is_known(&pattern)).then_some(key.span().start));
            self.offsets.insert(path.clone(), key.span().start);
            self.walk_value(value, &path, &pattern, lost_at);
        }
    }

    fn walk_value(&mut self, value: &Spanned<DeValue<'_>>, path: &str, pattern: &str, lost_at: Option<usize>) {
        match value.get_ref() {
            DeValue::Table(table) if !table.is_empty() => self.walk_table(table, path, pattern, lost_at),
            DeValue::Array(list) if list.iter().any(|entry| entry.get_ref().is_table()) => {
                for (index, entry) in list.iter().enumerate() {
                    let path = format!("{path}[{index}]");
                    self.offsets.insert(path.clone(), entry.span().start);
                    self.walk_value(entry, &path, &format!("{pattern}[]"), lost_at);
                }
            }
            _ => {
                if let Some(offset) = lost_at {
                    self.unknown.push((offset, path.to_owned(), pattern.to_owned()));
                }
            }
        }
    }
}

/// Refuses an unknown key of an assignment, whose list indices may be written `[0]` or `.0`.
pub(super) fn check_assigned(segments: &[String]) -> Result<(), ScenarioError> {
    let (mut path, mut pattern) = (String::new(), String::new());
    for segment in segments {
        if segment.parse::<usize>().is_ok() {
            path.push_str(&format!("[{segment}]"));
            pattern.push_str("[]");
        } else {
            let dot = if path.is_empty() { "" } else { "." };
            path.push_str(&format!("{dot}{segment}"));
            pattern.push_str(&format!("{dot}{segment}"));
        }
    }
    // An entry of a plain list of numbers has no pattern of its own.
    let plain = pattern.trim_end_matches("[]");
    if is_known(&pattern) || is_known(plain) { Ok(()) } else { Err(unknown(&path, &pattern)) }
}
