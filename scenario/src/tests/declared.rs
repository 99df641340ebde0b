//! What is made from the declarations of the keys agrees with them.

use super::*;
use crate::key::{Kind, Placed};

fn papers_file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/paper.toml")
}

#[test]
fn the_papers_file_is_made_from_the_declarations() {
    let right = Scenario::annotated();
    if std::env::var_os("UPDATE_DOCUMENTS").is_some() {
        std::fs::write(papers_file(), &right).expect("it can be written");
    }
    let written = std::fs::read_to_string(papers_file()).expect("it can be read");
    assert!(
        written == right,
        "scenarios/paper.toml is out of date: UPDATE_DOCUMENTS=1 cargo test -p loopbound-scenario"
    );
    assert!(right.lines().all(|line| line.chars().count() <= 120), "a line is too long");
}

#[test]
fn the_papers_file_is_the_default_and_names_every_key() {
    let file = papers_file();
    assert_eq!(Scenario::load(&file).expect("it loads"), Scenario::default());
    let text = std::fs::read_to_string(file).expect("it can be read");
    let mut section = String::new();
    let mut named = Vec::new();
    for line in text.lines() {
        let line = line.trim_start_matches("# ").trim();
        if let Some((header, _)) = line.strip_prefix("[[").and_then(|rest| rest.split_once("]]")) {
            section = format!("{header}[]");
        } else if let Some((header, _)) = line.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            section = header.to_owned();
        } else if let Some((key, _)) = line.split_once(" = ") {
            named.push(format!("{section}.{key}"));
        }
    }
    for key in keys::known_keys() {
        assert!(named.contains(&key), "scenarios/paper.toml does not mention `{key}`");
    }
}

#[test]
fn the_commented_defaults_of_the_papers_file_are_the_defaults() {
    // The lines of derived defaults, uncommented, must not change the resolved scenario.
    let file = papers_file();
    let text = std::fs::read_to_string(file).expect("it can be read");
    let derived = [
        "grace",
        "lead",
        "phase",
        "late",
        "settle",
        "links",
        "mass",
        "length",
        "inertia",
        "mass_error",
        "start_q_rad",
        "start_v_rad_s",
        "torque_limit_nm",
        "max_duration",
    ];
    let mut uncommented = 0;
    let mut lines = Vec::new();
    for line in text.lines() {
        let key = line.strip_prefix("# ").and_then(|rest| rest.split_once(" = ")).map(|(key, _)| key);
        let on = key.is_some_and(|key| derived.contains(&key));
        uncommented += usize::from(on);
        lines.push(if on { line.trim_start_matches("# ") } else { line });
    }
    assert!(uncommented >= derived.len(), "{uncommented} lines");
    let scenario = accepted(&lines.join("\n"));
    assert_ne!(scenario, Scenario::default());
    assert_eq!(scenario.resolved(), Scenario::default().resolved());
}

#[test]
fn every_key_of_the_table_is_a_key_of_its_section() {
    for pattern in keys::known_keys() {
        // The section exists with this key exactly if the deserialiser does not call it an unknown field.
        let (section, key) = pattern.rsplit_once('.').expect("a section and a key");
        let header = section.strip_suffix("[]").map_or(format!("[{section}]"), |list| format!("[[{list}]]"));
        let text = format!("{header}\n{key} = {{ not = \"a value\" }}");
        let table: toml::Table = toml::from_str(&text).expect("valid TOML");
        let error = toml::Value::Table(table).try_into::<Scenario>().expect_err("no key takes such a table");
        assert!(!error.to_string().contains("unknown field"), "{pattern}: {error}");
    }
}

#[test]
fn every_key_that_is_written_is_in_the_table() {
    let text = "
        [[plant.disturbance]]\nkind = 'sine'\namplitude_nm = 1\nomega_rad_s = 1
        [[swap]]\nat = 1\nlaw = 'ctc'\n[[fault]]\nkind = 'drop'\nat = 1
        [reference]\nkind = 'multi-sine'\nterm = [{ amplitude_rad = 1, omega_rad_s = 2 }]";
    // Reading back checks each key against the table, and refuses those that are not in it.
    let written = accepted(text).to_toml().expect("it can be written");
    assert!(written.lines().count() > 80, "{written}");
    accepted(&written);
}

#[test]
fn a_key_is_declared_for_kinds_that_there_are_and_shown_by_a_value_that_it_takes() {
    for Placed { path, section } in Placed::all() {
        let kinds = section.kinds();
        for key in section.own_keys() {
            let dotted = format!("{path}.{}", key.name);
            for kind in [key.needed_by, key.of].concat() {
                assert!(kinds.contains(&kind), "{dotted} is of {kind}, which {path} does not have");
            }
            assert!(!key.sentence().is_empty() && key.sentence().len() <= 140, "{dotted}: {}", key.sentence());
            if !key.example.is_empty() {
                let shown: toml::Table = toml::from_str(&format!("shown = {}", key.example)).expect("a value");
                let text = matches!(shown["shown"], toml::Value::String(_));
                let is_text = !matches!(
                    key.kind,
                    Kind::Number | Kind::Whole | Kind::Truth | Kind::PerLink | Kind::Pair | Kind::List(_)
                );
                assert!(text == is_text || matches!(key.kind, Kind::When), "{dotted} = {}", key.example);
            }
        }
    }
}

#[test]
fn a_key_that_an_entry_needs_is_missed_and_one_of_another_kind_is_refused() {
    let message = refused("[[fault]]\nat = 1");
    assert!(message.contains("`fault[0].kind`: is missing"), "{message}");
    let message = refused("[reference]\nkind = 'multi-sine'");
    assert!(
        message.contains("`reference.term`: found nothing, allowed: a value, which kind \"multi-sine\" needs"),
        "{message}"
    );
    let message = refused("[[fault]]\nkind = 'drop'\nstep = '1ms'");
    assert!(message.contains("`fault[0].step`: found a value, allowed: none with kind \"drop\""), "{message}");
}
