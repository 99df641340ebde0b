//! Damaged and random input: whatever is read, nothing panics, nothing hangs, and a refusal says in one clean line what it
//! refuses.
//!
//! A case is a function of its number alone, so that a failure names the number that brings it back:
//! `LOOPBOUND_FUZZ_FROM=12345 cargo test --test fuzz`. Each test runs for seconds; the long form of all of them is
//! `cargo test --release --test fuzz -- --ignored`.

use std::fs;
use std::io::Write as _;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use loopbound::inprocess::InProcess;
use loopbound::supervise::prepare;
use loopbound_model::rng::{Stream, bits};
use loopbound_model::trajectory::Waypoints;
use loopbound_model::with_links;
use loopbound_monitor::verdict::expectations;
use loopbound_scenario::{ExpectSection, Scenario};
use loopbound_shared::clock;

/// How many times as many cases the long form runs.
const LONG: u64 = 200;
/// The longest that the executable may take over one damaged folder.
const PATIENCE_NS: u64 = 30 * clock::NS_PER_S;

/// Random numbers of one case.
struct Dice {
    case: u64,
    drawn: u32,
}

impl Dice {
    fn below(&mut self, end: usize) -> usize {
        self.drawn += 1;
        let wide = u128::from(bits(1, Stream::Test, self.case, self.drawn)[0]) * end as u128;
        usize::try_from(wide >> 64).expect("it is below the end")
    }

    fn of<'a, T: ?Sized>(&mut self, list: &[&'a T]) -> &'a T {
        list[self.below(list.len())]
    }
}

/// Runs cases until `count` are done; one that panics is named.
fn each(name: &str, count: u64, one: impl Fn(&mut Dice) + std::panic::RefUnwindSafe) {
    let from = std::env::var("LOOPBOUND_FUZZ_FROM").ok().and_then(|from| from.parse().ok()).unwrap_or(0);
    for case in from..from + count {
        let failed = catch_unwind(|| one(&mut Dice { case, drawn: 0 })).is_err();
        assert!(!failed, "{name}: LOOPBOUND_FUZZ_FROM={case}");
    }
}

#[track_caller]
fn assert_clean(message: &str, about: &str) {
    let clean = !message.is_empty() && !message.contains(|c: char| c.is_control()) && message.chars().count() < 2000;
    assert!(clean, "no clean line: {message:?} about {about:?}");
}

const WORDS: &[&str] = &[
    "0",
    "-1",
    "1",
    "1e160",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "18446744073709551615",
    "9223372036854775807",
    "1e12",
    "0.3",
    "\"1ns\"",
    "\"1h\"",
    "\"100000h\"",
    "\"1kHz\"",
    "\"50kHz\"",
    "\"1Hz\"",
    "[]",
    "[1]",
    "[1, 2, 3]",
    "[1, 2, 3, 4, 5, 6, 7]",
    "{}",
    "true",
    "\"\"",
    "\"robust\"",
    "\"ctc\"",
    "\"pd+g\"",
    "\"waypoints\"",
    "\"circle\"",
    "\"quintic\"",
    "\"/dev/zero\"",
    "\"\\u001b[2J\"",
    "\"controller:2\"",
    "\"<= 50us\"",
    "\"== 0\"",
    "\"lockstep\"",
];

/// A text with some of its characters, lines and values replaced.
fn damaged(text: &str, dice: &mut Dice) -> String {
    let mut text = text.to_owned();
    for _ in 0..=dice.below(3) {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let at = dice.below(lines.len().max(1));
        match dice.below(6) {
            0 if at < lines.len() => drop(lines.remove(at)),
            1 if at < lines.len() => {
                let other = dice.below(lines.len());
                lines.swap(at, other);
            }
            2 if at < lines.len() => lines.insert(at, lines[at].clone()),
            3 | 4 if at < lines.len() => {
                let word = dice.of(WORDS);
                let key = lines[at].split('=').next().unwrap_or_default().to_owned();
                lines[at] = format!("{key}= {word}");
            }
            _ => {
                let mut characters: Vec<char> = lines.join("\n").chars().collect();
                let at = dice.below(characters.len().max(1));
                let odd = ['\0', '\u{1b}', '[', ']', '"', '=', '\n', '9', '-', '\u{202e}', '\u{fffd}', ',', ';', '\t'];
                let new = odd[dice.below(odd.len())];
                if at < characters.len() && dice.below(2) == 0 {
                    characters[at] = new;
                } else {
                    characters.insert(at.min(characters.len()), new);
                }
                lines = characters.into_iter().collect::<String>().lines().map(str::to_owned).collect();
            }
        }
        text = lines.join("\n");
    }
    text
}

fn shipped() -> Vec<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios");
    let mut files: Vec<PathBuf> =
        fs::read_dir(folder).expect("the scenarios").map(|e| e.expect("an entry").path()).collect();
    files.sort();
    files.into_iter().map(|file| fs::read_to_string(file).expect("a scenario")).collect()
}

/// What is accepted can be built or is refused, and then runs some ticks.
fn build_and_step(scenario: &Scenario) {
    fn step<const N: usize>(scenario: &Scenario) {
        let mut group = InProcess::<N>::new(scenario).expect("it was built before");
        for _ in 0..3.min(scenario.loop_.ticks()) {
            group.step();
        }
    }
    match prepare::system_of(scenario) {
        Ok(()) => with_links!(scenario.links(), step::<N>(scenario)),
        Err(error) => assert_clean(&error.to_string(), "a system"),
    }
}

fn scenarios(count: u64) {
    let texts = shipped();
    each("scenarios", count, |dice| {
        let text = damaged(&texts[dice.below(texts.len())], dice);
        match Scenario::from_toml(&text, "s.toml") {
            Ok(scenario) => build_and_step(&scenario),
            Err(error) => assert_clean(&error.to_string(), &text),
        }
    });
}

/// Every key of the paper's scenario, as `--set` names it.
fn keys() -> Vec<String> {
    let (mut section, mut keys) = (String::new(), Vec::new());
    for line in
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/paper.toml")).expect("it").lines()
    {
        let line = line.trim_start_matches("# ");
        if line.starts_with('[') {
            let name = line.split('#').next().unwrap_or(line).trim();
            section = name.trim_matches(['[', ']']).to_owned() + if name.starts_with("[[") { ".0" } else { "" };
        } else if let Some((key, _)) = line.split_once(" = ") {
            keys.push(format!("{section}.{key}"));
        }
    }
    assert!(keys.len() > 100, "{keys:?}");
    keys
}

fn settings(count: u64) {
    let keys = keys();
    each("settings", count, |dice| {
        let sets: Vec<String> = (0..=dice.below(3))
            .map(|_| {
                let key = &keys[dice.below(keys.len())];
                let word = dice.of(WORDS).trim_matches('"');
                damage_rarely(&format!("{key}={word}"), dice)
            })
            .collect();
        match Scenario::default().with_sets(&sets) {
            Ok(scenario) => build_and_step(&scenario),
            Err(error) => assert_clean(&error.to_string(), &sets.join(" ")),
        }
    });
}

fn damage_rarely(text: &str, dice: &mut Dice) -> String {
    if dice.below(8) == 0 { damaged(text, dice) } else { text.to_owned() }
}

const EXPECTED: &str = "\"round_trip.p99\" = [\"<= 200us\", \"<= 10 floor\"]\nmissed_ticks = \"== 0\"\nbound.certified = true\n\
    \"late_ticks_by_cause.preemption\" = 0\n\"counters.fenced\" = \"<= 1\"\nconfidence = 0.99\nmax_duration = \"60s\"\n\
    duration_s = \">= 1\"\n\"tracking.max_abs_e_rad\" = \"< 0.1\"\n";

fn expectations(count: u64) {
    each("expectations", count, |dice| {
        let text = damaged(EXPECTED, dice);
        match ExpectSection::from_toml(&text, "e.toml") {
            Ok(section) => {
                if let Err(why) = expectations::validate(&section) {
                    assert_clean(&why, &text);
                }
            }
            Err(error) => assert_clean(&error.to_string(), &text),
        }
    });
}

fn waypoints(count: u64) {
    let text = "# by hand\nt_s,q1,q2_deg,q3\n0,0.1,2,0.3\n0.5,0.2,-3,0.4\n1,1,1,1\n2.5,0,0,0\n";
    each("waypoints", count, |dice| {
        let text = damaged(text, dice);
        match Waypoints::<3>::from_csv_text(&text, "w.csv") {
            Ok(waypoints) => {
                let finite = |t_s: f64| waypoints.at(t_s).q_d.iter().all(|q| q.is_finite());
                assert!([-1.0, 0.25, 1.7, 1e9].into_iter().all(finite), "{text:?}");
            }
            Err(error) => assert_clean(&error.to_string(), &text),
        }
    });
}

fn loopbound(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_loopbound"));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn model_lines(count: u64) {
    let line =
        r#"{"q":[0.3,-0.2,0.25],"v":[0,1,0],"tau":[1,0,0],"chain":{"mass":[1,1,1],"length":[1,2,1],"gravity":9.81}}"#;
    let from: u64 = std::env::var("LOOPBOUND_FUZZ_FROM").ok().and_then(|from| from.parse().ok()).unwrap_or(0);
    let asked: Vec<String> = (from..from + count)
        .map(|case| damaged(line, &mut Dice { case, drawn: 0 }).replace('\n', " "))
        .filter(|line| !line.trim().is_empty())
        .collect();
    let mut child = loopbound(&["model"]).stdin(Stdio::piped()).spawn().expect("it starts");
    let mut input = child.stdin.take().expect("a pipe");
    let text = asked.join("\n");
    let writer = std::thread::spawn(move || input.write_all(text.as_bytes()));
    let output = child.wait_with_output().expect("it ends");
    writer.join().expect("the writer").expect("it takes all lines");
    assert!(matches!(output.status.code(), Some(0 | 2)), "{:?}", output.status);
    let answers = String::from_utf8(output.stdout).expect("text");
    assert_eq!(answers.lines().count(), asked.len());
    for (line, answer) in asked.iter().zip(answers.lines()) {
        let value: serde_json::Value =
            serde_json::from_str(answer).unwrap_or_else(|e| panic!("{line:?}: {answer}: {e}"));
        assert!(value["error"].is_string() || value["bias"].is_array(), "{line:?}: {answer}");
    }
}

/// A file with bytes flipped, cut off, repeated, or nothing like it at all.
fn damage_file(path: &Path, dice: &mut Dice) {
    let mut bytes = fs::read(path).expect("a file of the run");
    match dice.below(7) {
        0 => bytes.truncate(dice.below(bytes.len() + 1)),
        1 => bytes.clear(),
        2 => {
            let (from, length) = (dice.below(bytes.len().max(1)), dice.below(4096));
            let part: Vec<u8> = bytes.iter().skip(from).take(length).copied().collect();
            let at = dice.below(bytes.len() + 1);
            bytes.splice(at..at, part);
        }
        3 => {
            fs::remove_file(path).expect("a file of the run");
            match dice.below(3) {
                0 => fs::create_dir(path).expect("a folder"),
                1 => std::os::unix::fs::symlink("/dev/zero", path).expect("a link"),
                _ => {
                    rustix::fs::mkfifoat(rustix::fs::CWD, path, rustix::fs::Mode::from_raw_mode(0o600)).expect("a pipe")
                }
            }
            return;
        }
        _ => {
            for _ in 0..=dice.below(8) {
                if !bytes.is_empty() {
                    let at = dice.below(bytes.len());
                    bytes[at] = u8::try_from(dice.below(256)).expect("a byte");
                }
            }
        }
    }
    fs::write(path, bytes).expect("a file of the run");
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder");
    for entry in fs::read_dir(from).expect("the folder of the run") {
        let path = entry.expect("an entry").path();
        let copy = to.join(path.file_name().expect("a name"));
        if path.is_dir() {
            copy_folder(&path, &copy);
        } else {
            fs::copy(&path, &copy).expect("a copy");
        }
    }
}

/// Runs a command on a folder; its exit code is that of an outcome or of bad input, and it says something.
fn ask(arguments: &[&str], case: u64) {
    let mut child = loopbound(arguments).stdout(Stdio::null()).spawn().expect("it starts");
    let until_ns = clock::now_ns() + PATIENCE_NS;
    while child.try_wait().expect("the state of a child").is_none() {
        if clock::now_ns() > until_ns {
            let _ = child.kill();
            panic!("case {case}: {arguments:?} hangs");
        }
        clock::sleep_ns(1_000_000);
    }
    let output = child.wait_with_output().expect("it has ended");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0..=3 | 5)), "case {case}: {arguments:?}: {:?}: {said}", output.status);
    if output.status.code() == Some(2) {
        assert_clean(said.trim_end(), "a folder");
    }
}

fn folders(count: u64) {
    let work = tempfile::tempdir().expect("a folder");
    let whole = work.path().join("whole");
    let name = |path: &Path| path.to_str().expect("a path in UTF-8").to_owned();
    let scenario = work.path().join("s.toml");
    fs::write(&scenario, "[loop]\nmode = \"lockstep\"\nduration = \"200ms\"\n[expect]\nmissed_ticks = 0\n")
        .expect("a scenario");
    let group = format!("input-fuzz-{}", std::process::id());
    let run = loopbound(&["run", &name(&scenario), "--quiet", "--group", &group, "--out", &name(&whole)])
        .output()
        .expect("it runs");
    assert!(run.status.success(), "{run:?}");
    let files = [
        "summary.json",
        "samples.mcap",
        "blocks.jsonl",
        "scenario.toml",
        "events.jsonl",
        "latency.hlog",
        "samples.csv",
    ];
    each("folders", count, |dice| {
        let folder = work.path().join(format!("case-{}", dice.case));
        copy_folder(&whole, &folder);
        damage_file(&folder.join(dice.of(&files)), dice);
        let (folder_name, case) = (name(&folder), dice.case);
        ask(&["check", &folder_name], case);
        ask(&["replay", &folder_name], case);
        ask(&["report", &folder_name], case);
        ask(&["compare", &name(&whole), &folder_name], case);
        fs::remove_dir_all(&folder).expect("the folder of the case");
    });
}

macro_rules! short_and_long {
    ($($name:ident: $long:ident, $cases:literal, $run:ident;)*) => { $(
        #[test]
        fn $name() {
            $run($cases);
        }

        #[test]
        #[ignore = "minutes: cargo test --release --test fuzz -- --ignored"]
        fn $long() {
            $run($cases * LONG);
        }
    )* };
}

short_and_long! {
    damaged_scenarios_are_run_or_refused: scenarios_for_long, 300, scenarios;
    settings_of_any_value_are_run_or_refused: settings_for_long, 300, settings;
    damaged_expectations_are_understood_or_refused: expectations_for_long, 1000, expectations;
    damaged_waypoints_are_read_or_refused: waypoints_for_long, 3000, waypoints;
    damaged_lines_are_answered_one_by_one: lines_for_long, 500, model_lines;
    damaged_folders_of_runs_are_read_or_refused: folders_for_long, 12, folders;
}
