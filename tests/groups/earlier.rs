//! Recordings of every wake-up mode and every law, made before the code was cut along its layers: what is said of them
//! does not change. `UPDATE_RECORDINGS=1` writes it anew.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Map, Value, json};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings/modes-and-laws")
}

fn recordings() -> Vec<String> {
    let entries = std::fs::read_dir(folder()).expect("the recordings").map(|entry| entry.expect("an entry"));
    let mut names: Vec<String> = entries
        .filter(|entry| entry.path().is_dir())
        .map(|entry| entry.file_name().into_string().expect("a name in UTF-8"))
        .collect();
    names.sort();
    names
}

/// Exit code and document of a command; sentences, which may get better, are left out.
fn said(arguments: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_loopbound"))
        .args(arguments)
        .arg("--json")
        .current_dir(folder())
        .output()
        .expect("it runs");
    let document = serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|error| panic!("{arguments:?}: {error}: {}", String::from_utf8_lossy(&output.stderr)));
    json!({ "exit": output.status.code(), "document": without_sentences(document) })
}

fn without_sentences(value: Value) -> Value {
    match value {
        Value::Object(map) => {
            let kept = map.into_iter().filter(|(key, _)| key != "reason" && key != "reasons");
            Value::Object(kept.map(|(key, value)| (key, without_sentences(value))).collect())
        }
        Value::Array(values) => Value::Array(values.into_iter().map(without_sentences).collect()),
        other => other,
    }
}

#[test]
fn what_is_said_of_earlier_recordings_stays_the_same() {
    let names = recordings();
    assert_eq!(names.len(), 8);
    let mut found = Map::new();
    for (name, next) in names.iter().zip(names.iter().cycle().skip(1)) {
        found.insert(format!("check {name}"), said(&["check", name, "--expect", "expect.toml"]));
        found.insert(format!("replay {name}"), said(&["replay", name]));
        // Lockstep and real time are not compared.
        if name.split('-').next() == next.split('-').next() {
            found.insert(format!("compare {name} {next}"), said(&["compare", name, next]));
        }
    }
    let (file, found) = (folder().join("said.json"), Value::Object(found));
    if std::env::var_os("UPDATE_RECORDINGS").is_some() {
        std::fs::write(&file, format!("{found:#}\n")).unwrap();
        return;
    }
    let kept: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    let kept = kept.as_object().unwrap();
    assert_eq!(kept.keys().collect::<Vec<_>>(), found.as_object().unwrap().keys().collect::<Vec<_>>());
    for (command, kept) in kept {
        assert_eq!(&found[command], kept, "loopbound {command}");
    }
}
