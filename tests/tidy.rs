//! What holds of the whole tree and no compiler checks: who may depend on whom, and where delicate things may stand.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use toml::{Table, Value};

/// Packages of the workspace, as folders below its root, each with the packages it stands on. The launcher is the root itself
/// and may know all.
const LAYERS: [(&str, &[&str]); 7] = [
    ("model", &[]),
    ("scenario", &["model"]),
    ("shared", &["model", "scenario"]),
    ("plant", &["model", "scenario", "shared"]),
    ("controller", &["model", "scenario", "shared"]),
    ("reference", &["model", "scenario", "shared"]),
    ("monitor", &["model", "scenario", "shared"]),
];
/// What the mathematics may never know: the operating system, by whatever door.
const OPERATING_SYSTEM: [&str; 10] = [
    "std::env",
    "std::fs",
    "std::io",
    "std::net",
    "std::os",
    "std::process",
    "std::sync",
    "std::thread",
    "std::time",
    "rustix",
];

/// Where code may be unsafe, each place with its proof: system calls, mapped memory, the plain-data promise of samples,
/// the baselines that the benchmarks compare with, and the allocator that counts.
const UNSAFE_ALLOWED: [&str; 7] = [
    "shared/src/alarm.rs",
    "shared/src/doorbell.rs",
    "shared/src/layout.rs",
    "shared/src/ports.rs",
    "shared/src/realtime/system.rs",
    "benches/exchange/raw.rs",
    "tests/allocation.rs",
];
/// Where the transport may be named: `ports` uses it; the others only promise it that their types may be shared, and
/// a test comes as a stranger by it.
const TRANSPORT_ALLOWED: [&str; 7] = [
    "shared/src/ports.rs",
    "shared/src/topics.rs",
    "shared/src/layout.rs",
    "shared/src/realtime/evidence.rs",
    "shared/src/realtime/privileges.rs",
    "tests/groups/impostors.rs",
    "tests/groups/strangers.rs",
];
const CLOCK: &str = "shared/src/clock.rs";
const SPAWN: &str = "shared/src/spawn.rs";
const SAY: &str = "shared/src/say.rs";

const LINES_MAX: usize = 600;
/// Files that are longer, each with the reason: none so far.
const LONGER: [&str; 0] = [];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn manifest(folder: &str) -> Table {
    let path = format!("{folder}/Cargo.toml");
    read(&path).parse().unwrap_or_else(|error| panic!("{path}: {error}"))
}

fn members() -> impl Iterator<Item = &'static str> {
    ["."].into_iter().chain(LAYERS.map(|(member, _)| member))
}

/// The names in a dependency section; empty if there is no such section.
fn names(manifest: &Table, section: &str) -> BTreeSet<String> {
    manifest.get(section).and_then(Value::as_table).into_iter().flat_map(|table| table.keys().cloned()).collect()
}

/// Every Rust file below some folders of the root, by its path from the root.
fn sources(folders: &[&str]) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut open: Vec<PathBuf> =
        folders.iter().map(|folder| root().join(folder)).filter(|path| path.exists()).collect();
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of the tree can be listed") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(root()).expect("it lies below the root").display().to_string();
                found.insert(name.clone(), read(&name));
            }
        }
    }
    found
}

/// All Rust files of all members, tests and benches included.
fn all_sources() -> BTreeMap<String, String> {
    let members: Vec<String> = members().map(|member| format!("{member}/src")).collect();
    let mut folders: Vec<&str> = members.iter().map(String::as_str).collect();
    folders.extend(["tests", "benches", "examples"]);
    let found = sources(&folders);
    assert!(found.len() > 60, "only {} files: the tree is not where this test looks", found.len());
    found
}

/// The code alone: comments and the insides of string literals become blanks, so that what is only talked about doesn't
/// count. Lines stay lines.
fn code_of(text: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    let mut code = String::with_capacity(text.len());
    let mut at = 0;
    while at < chars.len() {
        let end = end_of_prose(&chars, at);
        if end > at {
            code.extend(chars[at..end].iter().map(|c| if *c == '\n' { '\n' } else { ' ' }));
            at = end;
        } else {
            code.push(chars[at]);
            at += 1;
        }
    }
    code
}

/// Where the comment or literal that begins at `at` ends; `at` itself if none begins there.
fn end_of_prose(chars: &[char], at: usize) -> usize {
    let is = |i: usize, c: char| chars.get(i) == Some(&c);
    let after = |from: usize, pattern: &[char]| {
        let found = chars.get(from..).and_then(|rest| rest.windows(pattern.len()).position(|window| window == pattern));
        found.map_or(chars.len(), |offset| from + offset + pattern.len())
    };
    match chars[at] {
        '/' if is(at + 1, '/') => after(at, &['\n']) - usize::from(after(at, &['\n']) < chars.len()),
        '/' if is(at + 1, '*') => after(at + 2, &['*', '/']),
        '"' => {
            let mut i = at + 1;
            while i < chars.len() && chars[i] != '"' {
                i += if chars[i] == '\\' { 2 } else { 1 };
            }
            (i + 1).min(chars.len())
        }
        'r' if at == 0 || !(chars[at - 1].is_alphanumeric() || chars[at - 1] == '_') => {
            let hashes = chars[at + 1..].iter().take_while(|c| **c == '#').count();
            if !is(at + 1 + hashes, '"') {
                return at;
            }
            let mut close = vec!['"'];
            close.extend(std::iter::repeat_n('#', hashes));
            after(at + 2 + hashes, &close)
        }
        // A character, not a lifetime: the only literals that can hold a quote or a slash.
        '\'' if is(at + 1, '\\') => after(at + 3, &['\'']),
        '\'' if is(at + 2, '\'') => at + 3,
        _ => at,
    }
}

/// Whether `word` stands in `code` by itself, not as a part of a longer name.
fn has_word(code: &str, word: &str) -> bool {
    let joins = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    code.match_indices(word)
        .any(|(at, _)| !joins(code[..at].chars().next_back()) && !joins(code[at + word.len()..].chars().next()))
}

/// The files whose code has any of `words`, but for those that may.
fn offenders(words: &[&str], allowed: &[&str]) -> Vec<String> {
    let has = |text: &str| words.iter().any(|word| has_word(&code_of(text), word));
    all_sources()
        .into_iter()
        .filter(|(name, text)| !allowed.contains(&name.as_str()) && has(text))
        .map(|(n, _)| n)
        .collect()
}

const NONE: Vec<String> = Vec::new();

/// The code of the programs, without their tests.
fn programs() -> impl Iterator<Item = (String, String)> {
    let of_a_program = |name: &String| name.split('/').any(|part| part == "src") && !name.ends_with("tests.rs");
    let sources = all_sources().into_iter().filter(move |(name, _)| of_a_program(name));
    sources.map(|(name, text)| (name, code_of(text.split("\n#[cfg(test)]").next().unwrap_or_default())))
}

#[test]
fn a_member_stands_on_the_layers_below_it_alone() {
    for (member, below) in LAYERS {
        let manifest = manifest(member);
        for section in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let ours: Vec<String> = names(&manifest, section)
                .into_iter()
                .filter_map(|name| Some(name.strip_prefix("loopbound-")?.to_owned()))
                .collect();
            let unknown: Vec<&String> = ours.iter().filter(|name| !below.contains(&name.as_str())).collect();
            assert!(unknown.is_empty(), "{member} may not know {unknown:?}");
        }
        let transport = names(&manifest, "dependencies").contains("iceoryx2");
        assert_eq!(transport, member == "shared", "{member}: the transport is the contract's");
    }
}

#[test]
fn the_mathematics_knows_no_operating_system() {
    let inside = |name: &String| name.starts_with("model/");
    assert_eq!(offenders(&OPERATING_SYSTEM, &[]).into_iter().filter(inside).collect::<Vec<_>>(), NONE);
}

#[test]
fn the_folders_of_the_mathematics_know_only_those_before_them() {
    const ORDER: [&str; 3] = ["certificate", "law", "bound"];
    for (name, code) in programs().filter(|(name, _)| !name.contains("/tests/")) {
        let place = ORDER.iter().position(|of| {
            name.strip_prefix("model/src/").is_some_and(|name| name.split(['/', '.']).next() == Some(of))
        });
        for later in place.map_or(&[][..], |place| &ORDER[place + 1..]) {
            assert!(!has_word(&code, &format!("crate::{later}")), "{name} may not know `{later}`");
        }
    }
}

#[test]
fn a_law_is_named_in_its_file_and_in_the_list_alone() {
    // What is studied names the laws that it compares.
    const ALLOWED: [&str; 2] = ["model/src/law.rs", "src/commands/study/cases.rs"];
    let named = |code: &str| ["RobustFf", "Ctc", "PdG"].iter().any(|law| has_word(code, law));
    let allowed = |name: &str| name.starts_with("model/src/law/") || ALLOWED.contains(&name);
    let is_test = |name: &str| name.contains("/tests") || ["attack.rs", "paper.rs"].iter().any(|t| name.ends_with(t));
    let found: Vec<String> = programs()
        .filter(|(name, code)| !allowed(name) && !is_test(name) && named(code))
        .map(|(name, _)| name)
        .collect();
    assert_eq!(found, NONE);
}

#[test]
fn every_dependency_of_the_workspace_is_used_by_a_member() {
    let root = manifest(".");
    let workspace = root["workspace"].as_table().expect("the root is the workspace");
    let mut unused = names(workspace, "dependencies");
    for member in members() {
        let manifest = manifest(member);
        for section in ["dependencies", "dev-dependencies", "build-dependencies"] {
            unused.retain(|name| !names(&manifest, section).contains(name));
        }
    }
    assert_eq!(unused, BTreeSet::new());
}

#[test]
fn every_dependency_of_a_member_is_named_in_its_code() {
    for member in members() {
        let files = sources(&[&format!("{member}/src")]);
        let code: String = files.values().map(|text| code_of(text)).collect();
        for name in names(&manifest(member), "dependencies") {
            assert!(has_word(&code, &name.replace('-', "_")), "{member} depends on {name} and never names it");
        }
    }
}

#[test]
fn members_take_every_version_from_the_workspace() {
    for member in members() {
        let manifest = manifest(member);
        for section in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let table = manifest.get(section).and_then(Value::as_table).cloned().unwrap_or_default();
            for (name, value) in table {
                let inherits = value.get("workspace").and_then(Value::as_bool);
                assert_eq!(inherits, Some(true), "{member}: {name}");
            }
        }
    }
}

#[test]
fn the_transport_is_pinned_to_one_version() {
    let root = manifest(".");
    let pin = root["workspace"]["dependencies"]["iceoryx2"].as_str().expect("a version").to_owned();
    let version = pin.strip_prefix('=').expect("an exact one");
    assert_eq!(version.split('.').count(), 3, "`{pin}` leaves a part open");
    assert!(read("Cargo.lock").contains(&format!("name = \"iceoryx2\"\nversion = \"{version}\"")));
}

#[test]
fn nothing_that_picks_instructions_at_run_time_multiplies_matrices() {
    assert!(!read("Cargo.lock").contains("name = \"matrixmultiply\""), "results would differ between machines");
}

#[test]
fn only_the_clock_module_reads_clocks_or_sleeps() {
    let words = ["Instant::now", "SystemTime::now", "thread::sleep", "clock_gettime", "clock_nanosleep"];
    assert_eq!(offenders(&words, &[CLOCK]), NONE);
}

#[test]
fn one_module_writes_to_the_standard_streams() {
    let words = ["print!", "println!", "eprint!", "eprintln!", "dbg!", "io::stdout", "io::stderr"];
    // What a test prints is kept by the harness, and shown if it fails.
    let found: Vec<String> = offenders(&words, &[SAY]).into_iter().filter(|name| !name.starts_with("tests/")).collect();
    assert_eq!(found, NONE);
}

#[test]
fn one_module_starts_threads_and_processes() {
    let words = ["thread::spawn", "scope.spawn", "spawn_scoped", "Builder::new", "spawn()"];
    let found: Vec<String> =
        programs().filter(|(_, code)| words.iter().any(|word| has_word(code, word))).map(|(name, _)| name).collect();
    assert_eq!(found, [SPAWN]);
}

#[test]
fn paths_are_shown_without_what_a_terminal_would_obey() {
    let shown: Vec<String> = programs().filter(|(_, code)| has_word(code, "display")).map(|(name, _)| name).collect();
    assert_eq!(shown, NONE, "quote::path shows a path");
}

#[test]
fn code_is_unsafe_in_the_listed_files_alone() {
    assert_eq!(offenders(&["unsafe"], &UNSAFE_ALLOWED), NONE);
    for file in UNSAFE_ALLOWED {
        assert!(has_word(&code_of(&read(file)), "unsafe"), "{file} is not unsafe any more: strike it from the list");
    }
}

#[test]
fn the_processes_and_the_launcher_touch_the_transport_through_ports_alone() {
    let in_benches = |name: &String| name.starts_with("benches/");
    let found: Vec<String> =
        offenders(&["iceoryx2"], &TRANSPORT_ALLOWED).into_iter().filter(|n| !in_benches(n)).collect();
    assert_eq!(found, NONE);
}

#[test]
fn files_stay_short_enough_to_read() {
    let lines = |text: &str| text.lines().count();
    let long: Vec<(String, usize)> = all_sources()
        .into_iter()
        .map(|(name, text)| (name, lines(&text)))
        .filter(|(name, lines)| *lines > LINES_MAX && !LONGER.contains(&name.as_str()))
        .collect();
    assert_eq!(long, []);
}

/// The names that code declares as public: functions, types, constants.
fn public_names(code: &str) -> Vec<&str> {
    const KINDS: [&str; 7] = ["fn ", "struct ", "enum ", "const ", "static ", "trait ", "type "];
    let mut names = Vec::new();
    for (at, found) in code
        .match_indices("pub")
        .filter(|(at, _)| has_word(&code[at.saturating_sub(1)..(at + 4).min(code.len())], "pub"))
    {
        let mut rest = &code[at + found.len()..];
        if rest.starts_with('(') {
            rest = &rest[rest.find(')').map_or(0, |end| end + 1)..];
        }
        rest = rest.trim_start();
        for qualifier in ["const ", "unsafe ", "async "] {
            rest = rest.strip_prefix(qualifier).filter(|rest| rest.starts_with("fn ")).unwrap_or(rest);
        }
        if let Some(name) = KINDS.iter().find_map(|kind| rest.strip_prefix(kind)) {
            names.push(&name[..name.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(name.len())]);
        }
    }
    names
}

/// The variants of enums that have a code of their own, `Name = 7,`.
fn coded_variants(code: &str) -> impl Iterator<Item = &str> {
    code.lines().filter_map(|line| {
        let (name, number) = line.trim().split_once(" = ")?;
        let is_name = name.starts_with(char::is_uppercase) && name.chars().all(char::is_alphanumeric);
        (is_name && number.starts_with(|c: char| c.is_ascii_digit()) && number.contains(',')).then_some(name)
    })
}

#[test]
fn nothing_is_public_that_nobody_names() {
    let code: BTreeMap<String, String> = all_sources().into_iter().map(|(name, text)| (name, code_of(&text))).collect();
    let mut times: BTreeMap<&str, usize> = BTreeMap::new();
    for word in code.values().flat_map(|code| code.split(|c: char| !(c.is_alphanumeric() || c == '_'))) {
        *times.entry(word).or_default() += 1;
    }
    // serde is given functions by their names.
    let sources = all_sources();
    let serdes = sources.values().flat_map(|text| text.lines().filter(|line| line.contains("with = \"")));
    for word in serdes.flat_map(|line| line.split(|c: char| !(c.is_alphanumeric() || c == '_'))) {
        *times.entry(word).or_default() += 1;
    }
    let unnamed: Vec<String> = code
        .iter()
        .flat_map(|(file, code)| {
            public_names(code).into_iter().chain(coded_variants(code)).map(move |name| (file, name))
        })
        .filter(|(_, name)| times.get(name) == Some(&1))
        .map(|(file, name)| format!("{file}: {name}"))
        .collect();
    assert_eq!(unnamed, NONE);
}

#[test]
fn words_in_comments_and_strings_are_not_code() {
    let text = "// unsafe\nlet a = \"unsafe \\\" unsafe\"; /* unsafe */ let b = r#\"unsafe \" unsafe\"#;\nlet c = ('\"', '\\'', 'x');";
    assert!(!has_word(&code_of(text), "unsafe"), "{}", code_of(text));
    assert!(has_word(&code_of(&format!("{text} unsafe {{}}")), "unsafe"), "what follows the literals is code again");
    assert!(!has_word("unsafe_code", "unsafe") && has_word("unsafe{", "unsafe"));
    assert_eq!(code_of(text).lines().count(), text.lines().count());
}
