//! The JSON schema of a scenario, by which editors complete keys and mark mistakes.
//!
//! It says what the declaration of each key says: name, type, words, range, and which kind of a section has which keys. What
//! depends on several keys is left to the validation.

use super::Scenario;
use super::key::{Key, Kind, Limit, Section, Value as _};
use loopbound_model::chain::LINKS_MAX;
use serde_json::{Map, Value, json};

const TIME: &str = "[0-9]*\\.?[0-9]*\\s*(ns|us|µs|μs|ms|s|min|h)$";

impl Scenario {
    /// The schema of a scenario's file: JSON Schema, draft 7, which editors of TOML read.
    #[must_use]
    pub fn json_schema() -> Value {
        let mut schema = of_kind(&Self::KIND, &Limit::NONE);
        schema["$schema"] = json!("http://json-schema.org/draft-07/schema#");
        schema["title"] = json!("A scenario of loopbound");
        schema
    }
}

fn of_key(key: &Key) -> Value {
    let mut schema = of_kind(&key.kind, &key.limit);
    let allowed = key.allowed();
    let allowed = if allowed.is_empty() { allowed } else { format!(" ({allowed})") };
    schema["description"] = json!(format!("{}{allowed}", key.description()));
    schema
}

fn of_kind(kind: &Kind, limit: &Limit) -> Value {
    let number = || ranged("number", limit);
    let several = |items: Value| json!({ "type": "array", "items": items });
    let text = |pattern: &str| json!({ "type": "string", "pattern": pattern });
    match kind {
        Kind::Number => number(),
        Kind::Whole => ranged("integer", &Limit { least: limit.least.max(0.0), ..*limit }),
        Kind::Truth => json!({ "type": "boolean" }),
        Kind::Time => text(&format!("^\\s*\\+?{TIME}")),
        Kind::SignedTime => text(&format!("^\\s*[+-]?{TIME}")),
        Kind::When => json!({ "anyOf": [{ "type": "integer", "minimum": 0 }, text(&format!("^\\s*\\+?{TIME}"))] }),
        Kind::Rate => text("^\\s*[0-9.]+\\s*(Hz|kHz|MHz)$"),
        Kind::Words(words) => json!({ "enum": words() }),
        Kind::PerLink => {
            json!({ "anyOf": [number(), { "type": "array", "items": number(), "minItems": 1, "maxItems": LINKS_MAX }] })
        }
        Kind::Pair => json!({ "type": "array", "items": number(), "minItems": 2, "maxItems": 2 }),
        Kind::Path => json!({ "type": "string", "minLength": 1 }),
        Kind::Target => text("^[a-z]+(:[1-9][0-9]*)?$"),
        Kind::Cores => json!({ "anyOf": [{ "const": "auto" }, several(json!({ "type": "integer", "minimum": 0 }))] }),
        // A dotted key without quotes is a tree of tables.
        Kind::Condition => json!({ "type": ["boolean", "number", "string", "array", "object"] }),
        Kind::List(kind) => several(of_kind(kind, limit)),
        Kind::Table(section) => of_section(section),
    }
}

/// A number within its limit; infinite ends are left out.
fn ranged(kind: &str, limit: &Limit) -> Value {
    let mut schema = json!({ "type": kind });
    let least = if limit.or_zero { limit.least.min(0.0) } else { limit.least };
    if least.is_finite() {
        schema[if limit.with_least || limit.or_zero { "minimum" } else { "exclusiveMinimum" }] = json!(least);
    }
    if limit.most.is_finite() {
        schema[if limit.with_most { "maximum" } else { "exclusiveMaximum" }] = json!(limit.most);
    }
    schema
}

fn of_section(section: &Section) -> Value {
    let declared = section.keys.iter().filter(|key| !key.is_open());
    let properties: Map<String, Value> = declared.map(|key| (key.name.to_owned(), of_key(key))).collect();
    let open = section.keys.iter().find(|key| key.is_open()).map(|_| of_kind(&Kind::Condition, &Limit::NONE));
    let needed: Vec<&str> = section.keys.iter().filter(|key| key.needed).map(|key| key.name).collect();
    let mut schema = json!({
        "type": "object",
        "description": section.sentence(),
        "properties": properties,
        "additionalProperties": open.unwrap_or(json!(false)),
        "required": needed,
    });
    // A list of no schemas is none.
    let kinds: Vec<Value> = section.kinds().into_iter().map(|kind| of_one_kind(section, kind)).collect();
    if !kinds.is_empty() {
        schema["allOf"] = json!(kinds);
    }
    schema
}

/// What a section of this kind must have, and may not have.
fn of_one_kind(section: &Section, kind: &str) -> Value {
    let names =
        |of: &dyn Fn(&Key) -> bool| section.keys.iter().filter(|key| of(key)).map(|key| key.name).collect::<Vec<_>>();
    let needed = names(&|key| key.needed_by.contains(&kind));
    let refused: Map<String, Value> =
        names(&|key| !key.applies(Some(kind))).into_iter().map(|name| (name.to_owned(), json!(false))).collect();
    json!({
        "if": { "properties": { "kind": { "const": kind } }, "required": ["kind"] },
        "then": { "required": needed, "properties": refused },
    })
}
