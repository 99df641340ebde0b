//! The table of all keys, and the search for a key that is not in it.

use super::error::{Place, ScenarioError};
use loopbound_model::quote::nearest;
use std::collections::BTreeMap;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Every section with its keys; `[]` stands for the index in a list of tables. `expect` is open.
pub(super) const SECTIONS: &[(&str, &[&str])] = &[
    (
        "loop",
        &["rate", "duration", "mode", "wakeup", "grace", "lead", "phase", "late", "settle", "start_up", "max_step"],
    ),
    (
        "plant",
        &[
            "links",
            "mass",
            "length",
            "inertia",
            "gravity",
            "a",
            "b",
            "mass_error",
            "start_q_rad",
            "start_v_rad_s",
            "torque_limit_nm",
            "speed_limit",
            "actuation_delay",
            "seed",
        ],
    ),
    ("plant.friction", &["viscous_nm_s", "coulomb_nm"]),
    ("plant.noise", &["q_rad", "v_rad_s", "quantum_q_rad", "quantum_v_rad_s"]),
    (
        "plant.disturbance[]",
        &["kind", "value_nm", "amplitude_nm", "omega_rad_s", "phase_rad", "at", "rms_nm", "low_hz", "high_hz"],
    ),
    ("controller", &["law", "exe", "standby"]),
    ("controller.gains", &["beta", "k2", "k3", "c1", "level", "kp", "kd", "k_t", "analyst_beta", "shared_v"]),
    ("controller.model", &["mass", "length", "inertia", "gravity", "a", "b"]),
    ("controller.uncertainty", &["mass", "disturbance_nm"]),
    (
        "reference",
        &[
            "kind",
            "lead",
            "amplitude_rad",
            "omega_rad_s",
            "offset_rad",
            "from_rad",
            "to_rad",
            "at",
            "duration",
            "omega_start_rad_s",
            "omega_end_rad_s",
            "centre_m",
            "radius_m",
            "phase_rad",
            "elbow_positive",
            "file",
        ],
    ),
    ("reference.term[]", &["amplitude_rad", "omega_rad_s", "phase_rad"]),
    ("realtime", &["priority", "cores", "lock_memory", "dma_latency"]),
    ("supervisor", &["controller", "reference", "monitor", "plant", "back_off", "back_off_max", "restarts_max"]),
    (
        "swap_gate",
        &[
            "consecutive",
            "torque_step_nm",
            "dwell",
            "blend",
            "timeout",
            "rollback_misses",
            "rollback_window",
            "rollback_for",
            "retire_after",
        ],
    ),
    ("monitor", &["poll", "finalise", "trace"]),
    ("swap[]", &["at", "law", "exe", "to", "blend", "force"]),
    (
        "fault[]",
        &[
            "kind",
            "target",
            "at",
            "for",
            "every",
            "probability",
            "delay",
            "delay_max",
            "distribution",
            "shape",
            "value_nm",
            "joint",
            "step",
            "seed",
        ],
    ),
    ("expect", &["max_duration", "confidence"]),
];

/// Every key as a dotted pattern.
pub(super) fn known_keys() -> impl Iterator<Item = String> {
    SECTIONS.iter().flat_map(|(section, keys)| keys.iter().map(move |key| format!("{section}.{key}")))
}

/// Whether a dotted pattern is a key, a section, or leads to one.
fn is_known(pattern: &str) -> bool {
    pattern.starts_with("expect.")
        || SECTIONS.iter().any(|(section, keys)| {
            let below = |longer: &str| longer.strip_prefix(pattern).is_some_and(|rest| rest.starts_with(['.', '[']));
            *section == pattern
                || below(section)
                || pattern
                    .strip_prefix(section)
                    .and_then(|rest| rest.strip_prefix('.'))
                    .is_some_and(|key| keys.contains(&key))
        })
}

/// The first unknown key (`path`, written as the pattern `pattern`) as an error without a place.
fn unknown(path: &str, pattern: &str) -> ScenarioError {
    let known: Vec<String> = known_keys().collect();
    // A key in the wrong section is more often misplaced than misspelt beyond recognition.
    let leaf = pattern.rsplit('.').next().unwrap_or(pattern);
    let same_leaf = known.iter().find(|key| key.rsplit('.').next() == Some(leaf)).map(String::as_str);
    let near = nearest(pattern, known.iter().map(String::as_str)).or(same_leaf);
    ScenarioError::UnknownKey { place: Place::Nowhere, key: path.to_owned(), nearest: near.map(str::to_owned) }
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
