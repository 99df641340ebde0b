//! What can be wrong with a scenario, each in one line.

use loopbound_model::quote;
use std::fmt;
use std::path::PathBuf;

/// Where a fault of a scenario was found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum WrittenAt {
    /// Not written anywhere: a value set by a program.
    #[default]
    Nowhere,
    /// A file, line and column counted from 1.
    File {
        /// The file, or what stands for it.
        origin: String,
        /// Line.
        line: usize,
        /// Column, in characters.
        column: usize,
    },
    /// A `key=value` on the command line.
    Set(String),
}

impl fmt::Display for WrittenAt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nowhere => Ok(()),
            Self::File { origin, line, column } => write!(f, "{}:{line}:{column}: ", quote::lines(origin)),
            Self::Set(assignment) => write!(f, "--set {}: ", quote::text(assignment)),
        }
    }
}

/// A scenario that cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file cannot be read.
    #[error("{}: {source}", quote::path(path))]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is not TOML, or says a key twice.
    #[error("{place}{}", quote::lines(message))]
    Syntax {
        /// Where.
        place: WrittenAt,
        /// What the parser says, in one line.
        message: String,
    },
    /// A key that does not exist.
    #[error("{place}unknown key `{}`{}", quote::text(key), nearest.as_ref().map(|near| format!(", did you mean `{near}`?")).unwrap_or_default())]
    UnknownKey {
        /// Where.
        place: WrittenAt,
        /// The key as written, dotted.
        key: String,
        /// The known key nearest to it.
        nearest: Option<String>,
    },
    /// A value of the wrong type, unit or spelling.
    #[error("{place}`{}`: {}", quote::text(key), quote::lines(message))]
    Type {
        /// Where.
        place: WrittenAt,
        /// The key, dotted.
        key: String,
        /// What was found and what is allowed.
        message: String,
    },
    /// A value outside its limits.
    #[error("{place}`{}`: found {}, allowed: {allowed}", quote::text(key), quote::text(found))]
    Value {
        /// Where.
        place: WrittenAt,
        /// The key, dotted.
        key: String,
        /// What stands there.
        found: String,
        /// What may stand there.
        allowed: String,
    },
    /// An assignment that is not `key=value`.
    #[error("--set {}: {message}", quote::text(assignment))]
    Set {
        /// As written.
        assignment: String,
        /// What is wrong.
        message: String,
    },
    /// A scenario that cannot be written as TOML.
    #[error("the scenario cannot be written: {0}")]
    Write(#[from] toml::ser::Error),
}

impl ScenarioError {
    /// The same error with `place`, if it has none yet and can have one.
    #[must_use]
    pub(super) fn at(mut self, found: impl FnOnce(&str) -> WrittenAt) -> Self {
        if let Self::UnknownKey { place, key, .. } | Self::Type { place, key, .. } | Self::Value { place, key, .. } =
            &mut self
            && *place == WrittenAt::Nowhere
        {
            *place = found(key);
        }
        self
    }
}
