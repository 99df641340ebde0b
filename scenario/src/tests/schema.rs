//! The schema takes what the scenario takes, and refuses what it can see of the rest.

use super::*;
use serde_json::Value;

/// Everything in `value` that `schema` refuses, as `path: keyword`. It knows the keywords that the schema uses, but for patterns.
fn refusals(schema: &Value, value: &Value, path: &str) -> Vec<String> {
    let Some(rules) = schema.as_object() else {
        return if *schema == Value::Bool(false) { vec![format!("{path}: refused")] } else { Vec::new() };
    };
    let accepts = |schema: &Value| refusals(schema, value, path).is_empty();
    let list = |rule: &Value| rule.as_array().cloned().unwrap_or_default();
    let number = |limit: &Value, ok: fn(f64, f64) -> bool| {
        value.as_f64().is_none_or(|value| ok(value, limit.as_f64().expect("a number")))
    };
    let mut found = Vec::new();
    for (keyword, rule) in rules {
        let ok = match keyword.as_str() {
            "type" if rule.is_array() => list(rule).iter().any(|one| is_of_type(one, value)),
            "type" => is_of_type(rule, value),
            "const" => rule == value,
            "enum" => list(rule).contains(value),
            "anyOf" => list(rule).iter().any(accepts),
            "minimum" => number(rule, |value, limit| value >= limit),
            "exclusiveMinimum" => number(rule, |value, limit| value > limit),
            "maximum" => number(rule, |value, limit| value <= limit),
            "exclusiveMaximum" => number(rule, |value, limit| value < limit),
            "minItems" => value.as_array().is_none_or(|list| list.len() as u64 >= rule.as_u64().expect("a number")),
            "maxItems" => value.as_array().is_none_or(|list| list.len() as u64 <= rule.as_u64().expect("a number")),
            "minLength" => value.as_str().is_none_or(|text| text.len() as u64 >= rule.as_u64().expect("a number")),
            "required" => list(rule).iter().all(|key| value.get(key.as_str().expect("a name")).is_some()),
            "items" => {
                let each = |(index, one): (usize, &Value)| refusals(rule, one, &format!("{path}[{index}]"));
                found.extend(value.as_array().into_iter().flatten().enumerate().flat_map(each));
                true
            }
            "properties" => {
                for (key, rule) in rule.as_object().expect("a table") {
                    found.extend(
                        value.get(key).map_or_else(Vec::new, |one| refusals(rule, one, &format!("{path}.{key}"))),
                    );
                }
                true
            }
            "additionalProperties" => {
                let known = |key: &str| rules["properties"].get(key).is_some();
                let others = value.as_object().into_iter().flatten().filter(|(key, _)| !known(key));
                found.extend(others.flat_map(|(key, one)| refusals(rule, one, &format!("{path}.{key}"))));
                true
            }
            "allOf" => {
                found.extend(list(rule).iter().flat_map(|one| refusals(one, value, path)));
                true
            }
            "if" => !accepts(rule) || accepts(&rules["then"]),
            "then" | "description" | "title" | "$schema" | "pattern" => true,
            other => panic!("the schema has the keyword {other}"),
        };
        if !ok {
            found.push(format!("{path}: {keyword}"));
        }
    }
    found
}

fn is_of_type(name: &Value, value: &Value) -> bool {
    match name.as_str().expect("a type") {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.is_u64() || value.is_i64(),
        "boolean" => value.is_boolean(),
        other => panic!("the schema has the type {other}"),
    }
}

fn refused_by_the_schema(text: &str) -> Vec<String> {
    let table: toml::Table = toml::from_str(text).expect("TOML");
    refusals(&Scenario::json_schema(), &serde_json::to_value(table).expect("values"), "")
}

#[test]
fn the_schema_takes_every_shipped_scenario() {
    for file in shipped() {
        let text = std::fs::read_to_string(&file).expect("it can be read");
        assert_eq!(refused_by_the_schema(&text), Vec::<String>::new(), "{file:?}");
    }
    assert_eq!(refused_by_the_schema("[expect]\nmissed_ticks = 0\nround_trip.p99 = ['<= 1ms']"), Vec::<String>::new());
}

#[test]
fn the_schema_refuses_what_the_declaration_of_one_key_refuses() {
    for (text, expected) in [
        ("[loop]\nrat = 1", ".loop.rat: refused"),
        ("[loop]\nmode = 'lockstp'", ".loop.mode: enum"),
        ("[loop]\nrate = 1000", ".loop.rate: type"),
        ("[plant]\nmass = 0", ".plant.mass: anyOf"),
        ("[plant]\nmass = [1, -1]", ".plant.mass: anyOf"),
        ("[plant]\nspeed_limit = -1", ".plant.speed_limit: minimum"),
        ("[controller]\nstandby = 9", ".controller.standby: maximum"),
        ("[controller.uncertainty]\nmass = 1.0", ".controller.uncertainty.mass: exclusiveMaximum"),
        ("[realtime]\npriority = -1", ".realtime.priority: minimum"),
        ("[reference]\nkind = 'quintic'\nduration = '1s'", ".reference: if"),
        ("[[fault]]\nkind = 'drop'\nstep = '1ms'", ".fault[0]: if"),
        ("[[fault]]\nat = 1", ".fault[0]: required"),
        ("[expect]\nconfidence = 1", ".expect.confidence: exclusiveMaximum"),
    ] {
        let found = refused_by_the_schema(text);
        assert!(found.iter().any(|one| one == expected), "{text}: {found:?}");
        refused(text);
    }
}
