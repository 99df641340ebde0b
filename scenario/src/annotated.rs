//! The default scenario as a file with every key, its meaning and its limits: `loopbound scenario`, `scenarios/paper.toml`.

use super::Scenario;
use super::key::{Key, Placed};
use toml::{Table, Value};

const HEAD: &str = "\
# The paper's case: a triple link follows q_d = sin 0.1 t under the robust law, from a start that is off the reference.
#
# This file is also the reference of all keys; `loopbound scenario` prints it. Every key is optional and shown with its
# default; a key behind `# ` has a derived default or none. Durations and rates carry their unit: \"20ms\", \"1.5s\",
# \"1kHz\". A key \"one a link\" takes a list, or one number for all links. Any key can be set from the command line:
#     loopbound run scenarios/paper.toml --set loop.rate=2kHz --set plant.mass=[1,1.2,0.8]
";

/// Comments begin here, or where the value ends.
const COMMENT_COLUMN: usize = 24;
/// A value that ends beyond has its comment above.
const VALUE_COLUMNS: usize = 52;
const COLUMNS: usize = 120;

impl Scenario {
    /// The default scenario as TOML, with a comment for each key.
    #[must_use]
    pub fn annotated() -> String {
        let of = |scenario: &Self| Table::try_from(scenario).map_or(Value::Table(Table::new()), Value::Table);
        let (written, resolved) = (of(&Self::default()), of(&Self::default().resolved()));
        let mut text = HEAD.to_owned();
        for placed in Placed::all() {
            let off = if placed.path.ends_with("[]") { "# " } else { "" };
            text.push('\n');
            line(&mut text, &format!("{off}{}", placed.header()), &placed.section.sentence());
            for key in placed.section.keys.iter().filter(|key| key.section().is_none()) {
                if key.is_open() {
                    key.example.lines().for_each(|example| text.push_str(&format!("# {example}\n")));
                    continue;
                }
                let default = value_at(&written, &placed.path, key.name).map(|value| format!("{} = {value}", key.name));
                let shown = default.unwrap_or_else(|| {
                    let derived = value_at(&resolved, &placed.path, key.name).map(Value::to_string);
                    format!("# {} = {}", key.name, derived.as_deref().unwrap_or(key.example))
                });
                line(&mut text, &shown, &comment(key));
            }
        }
        text
    }

    /// The default of a key as TOML, where it is a plain value.
    #[must_use]
    pub fn default_of(path: &str, key: &str) -> Option<String> {
        let written = Table::try_from(Self::default()).ok().map(Value::Table)?;
        value_at(&written, path, key).map(Value::to_string)
    }
}

/// The value of a key below a dotted path.
fn value_at<'a>(root: &'a Value, path: &str, key: &str) -> Option<&'a Value> {
    path.split('.').chain([key]).try_fold(root, |here, part| here.get(part))
}

/// The meaning of a key, what it may be, and where its default comes from.
fn comment(key: &Key) -> String {
    let default = key.default_in_words().replace('`', "");
    let default = match default.as_str() {
        "" | "none" => String::new(),
        needed if needed.starts_with("needed") => default,
        _ => format!("default {default}"),
    };
    let details =
        [key.restriction(), default].into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("; ");
    let details = if details.is_empty() { details } else { format!(" ({details})") };
    let kinds = key.kinds().join(", ");
    let kinds = if kinds.is_empty() { kinds } else { format!("{kinds}: ") };
    format!("{kinds}{}{details}", key.sentence())
}

/// Adds a line with its comment, which goes on below if it is long, or stands above if there is no room for it.
fn line(text: &mut String, value: &str, comment: &str) {
    let width = value.chars().count();
    let above = width > VALUE_COLUMNS;
    let column = if above { 0 } else { COMMENT_COLUMN.max(width + 1) };
    let mut lines = vec![String::new()];
    for word in comment.split(' ') {
        let last = lines.last().map_or(0, |last| last.chars().count());
        if column + 2 + last + 1 + word.chars().count() > COLUMNS {
            lines.push(String::new());
        }
        if let Some(last) = lines.last_mut() {
            last.push(' ');
            last.push_str(word);
        }
    }
    let indent = " ".repeat(column);
    if above {
        lines.iter().for_each(|comment| text.push_str(&format!("#{comment}\n")));
        text.push_str(&format!("{value}\n"));
    } else {
        text.push_str(&format!("{value}{}#{}\n", " ".repeat(column - width), lines[0]));
        lines[1..].iter().for_each(|comment| text.push_str(&format!("{indent}#{comment}\n")));
    }
}
