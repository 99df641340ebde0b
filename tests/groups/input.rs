//! What a run is given means what it says, is read once, and is refused before anything starts.

use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

use rustix::fs::{CWD, Mode, mkfifoat};

use crate::harness::{Case, Ended};

const NAMED: &str = "t_s,q1,q2,q3\n0,0.3,-0.2,0.25\n0.3,0.4,0,0.1\n";

/// A lockstep run of waypoints with all its files, which lie in `name`.
fn run(case: &Case, file: &Path, name: &str) -> (Ended, PathBuf) {
    let out = case.work.path().join(name);
    let scenario = format!(
        "[loop]\nmode = \"lockstep\"\nduration = \"300ms\"\n[reference]\nkind = \"waypoints\"\nfile = \"{}\"\n",
        file.display()
    );
    let ended = case.run(&scenario, &["--out", out.to_str().expect("a path in UTF-8")]).wait();
    (ended, out)
}

fn samples(out: &Path) -> String {
    fs::read_to_string(out.join("samples.csv")).expect("the samples")
}

fn fifo(case: &Case, name: &str) -> PathBuf {
    let path = case.work.path().join(name);
    mkfifoat(CWD, &path, Mode::from_raw_mode(0o644)).expect("a pipe");
    path
}

/// Writes a text into a pipe, once somebody reads it.
fn feed(path: &Path, text: &'static str) -> std::thread::JoinHandle<()> {
    let path = path.to_owned();
    std::thread::spawn(move || {
        let mut pipe = OpenOptions::new().write(true).open(path).expect("the pipe is read");
        pipe.write_all(text.as_bytes()).expect("the pipe takes it");
    })
}

#[test]
fn columns_of_waypoints_are_told_by_their_names_and_a_file_without_gets_a_line() {
    let case = Case::apart("columns");
    let (ended, plain) = run(&case, &case.write("plain.csv", NAMED), "plain");
    assert!(ended.code.is_some_and(|code| code < 2), "{ended:?}");
    assert!(!ended.err.contains("names no columns"), "{}", ended.err);
    let expected = samples(&plain);
    let turned = "q3_rad,t_ms,q2,q1\n0.25,0,-0.2,0.3\n0.1,300,0,0.4\n";
    let bare = "0,0.3,-0.2,0.25\n0.3,0.4,0,0.1\n";
    for (name, text) in [("turned", turned), ("bare", bare)] {
        let (ended, out) = run(&case, &case.write("other.csv", text), name);
        assert!(ended.code.is_some_and(|code| code < 2), "{ended:?}");
        assert_eq!(
            ended.err.contains("other.csv names no columns: taken as t_s, q1 … q3 in s and rad"),
            name == "bare"
        );
        assert!(samples(&out) == expected, "{name}: another motion");
    }
    case.assert_nothing_left();
}

#[test]
fn waypoints_come_from_a_pipe_and_replay_needs_neither_it_nor_the_original() {
    let case = Case::apart("pipe");
    let (_, plain) = run(&case, &case.write("plain.csv", NAMED), "plain");
    let path = fifo(&case, "points");
    let writer = feed(&path, NAMED);
    let (ended, out) = run(&case, &path, "piped");
    assert!(ended.code.is_some_and(|code| code < 2), "{ended:?}");
    writer.join().expect("it was read");
    assert!(samples(&out) == samples(&plain), "another motion");
    assert_eq!(fs::read_to_string(out.join("waypoints.csv")).expect("the copy"), NAMED);
    fs::remove_file(&path).expect("the pipe");
    let moved = case.work.path().join("moved");
    fs::rename(&out, &moved).expect("the folder of the run");
    let replay = case.output(&["replay", moved.to_str().expect("a path in UTF-8")]);
    assert!(replay.code == Some(0) && replay.out.contains("identical"), "{replay:?}");
}

#[test]
fn a_scenario_and_expectations_may_be_pipes() {
    let case = Case::apart("pipes");
    let (scenario, expect) = (fifo(&case, "scenario"), fifo(&case, "expect"));
    let writers =
        [feed(&scenario, "[loop]\nmode = \"lockstep\"\nduration = \"50ms\"\n"), feed(&expect, "missed_ticks = 0\n")];
    let ended = case.output(&["run", scenario.to_str().unwrap(), "--expect", expect.to_str().unwrap(), "--json"]);
    assert_eq!(ended.json_with(0)["verdict"]["status"], "passed");
    writers.into_iter().for_each(|writer| writer.join().expect("it was read"));
    case.assert_nothing_left();
}

/// Refused as usage: one line, which says all of `parts`; the folder of the run is as it was.
#[track_caller]
fn assert_refused(case: &Case, arguments: &[&str], parts: &[&str]) {
    let out = case.work.path().join("untouched");
    let mut all = vec!["run", "--out", out.to_str().expect("a path in UTF-8")];
    all.extend(arguments);
    let ended = case.output(&all);
    assert_eq!(ended.code, Some(2), "{arguments:?}: {ended:?}");
    assert!(ended.out.is_empty() && ended.err.trim_end().lines().count() == 1, "{ended:?}");
    for part in parts {
        assert!(ended.err.contains(part), "{part:?} is not in {:?}", ended.err);
    }
    assert!(!ended.err.contains(['\u{1b}', '\0', '\u{9b}']) && ended.err.len() < 1000, "{:?}", ended.err);
    assert!(!out.exists(), "the folder was made");
    case.assert_nothing_left();
}

#[test]
fn what_no_process_could_use_is_refused_by_the_launcher_with_its_key_and_line() {
    let case = Case::apart("unusable");
    case.write("back.csv", "t_s,q1,q2,q3\n1,0,0,0\n0.5,0,0,0\n");
    case.write("names.csv", "t_s,q1,q2,q9\n0,0,0,0\n1,0,0,0\n");
    case.write("semicolons.csv", "t_s;q1;q2;q3\n0;0;0;0\n1;0;0;0\n");
    case.write("escape.csv", "t_s,\u{1b}]0;title\u{7},q2,q3\n0,0,0,0\n1,0,0,0\n");
    let scenario = case.write("s.toml", "[reference]\nkind = \"waypoints\"\nfile = \"back.csv\"\n");
    let scenario = scenario.to_str().expect("a path in UTF-8");
    assert_refused(&case, &[scenario], &["s.toml:3:1: `reference.file`", "back.csv, line 3: t_s is 0.5"]);
    let other = |file: &str| format!("reference.file={}", case.work.path().join(file).display());
    let with = |set: &str, parts: &[&str]| assert_refused(&case, &[scenario, "--set", set], parts);
    with(&other("names.csv"), &["--set reference.file=", "line 1: column 4 is named \"q9\""]);
    with(&other("semicolons.csv"), &["line 1: ';' separates nothing"]);
    with(&other("escape.csv"), &["`reference.file`", "line 1"]);
    with(&other("none.csv"), &["`reference.file`", "none.csv: No such file"]);
    with("reference.file=/dev/zero", &["`reference.file`", "longer than what is read"]);
    let set = |set: &str, parts: &[&str]| assert_refused(&case, &["--set", set], parts);
    set(
        "reference.omega_rad_s=1e160",
        &["`reference.omega_rad_s`: found 1e160, allowed: a finite number, -1e12 to 1e12"],
    );
    set("reference.amplitude_rad=-1e300", &["`reference.amplitude_rad`: found -1e300"]);
    set("plant.mass=1e-300", &["`plant.mass`: found 1e-300"]);
    set("controller.gains.c1=1e200", &["`controller.gains.c1`: found 1e200"]);
    set("plant.noise.quantum_q_rad=1e-310", &["`plant.noise.quantum_q_rad`"]);
    set("plant.actuation_delay=1h", &["`plant.actuation_delay`: found 3600s, allowed: at most 2048 periods"]);
    set("reference.lead=1h", &["`reference.lead`: found 3600s, allowed: at most 2000 periods"]);
    set("reference.lead=0s", &["`reference.lead`: found 0s, allowed: at least one period"]);
    set("monitor.trace=1000h", &["`monitor.trace`", "at most 65536 periods"]);
    set("loop.max_step=1ns", &["`loop.max_step`: found 1ns, allowed: at least 1us"]);
    set("loop.duration=18446744073709551615ns", &["`loop.duration`", "at most 100000h"]);
    set("loop.settle=11s", &["`loop.settle`: found 11s, allowed: at most the duration of 10s"]);
    set("controller.standby=1000", &["`controller.standby`: found 1000, allowed: 0 to 6"]);
    set("controller.exe=/nowhere/controller", &["`controller.exe`", "/nowhere/controller", "not there"]);
    set(&format!("plant.gravity={}", "9".repeat(400)), &["`plant.gravity`", "(409 characters)"]);
    set("plant.gra\u{1b}[2Jvity=1", &["unknown key `plant.gra\\u{1b}"]);
    set("controller.law=robst", &["found \"robst\"", "did you mean \"robust\"?"]);
    assert_refused(&case, &["/dev/zero"], &["/dev/zero: ", "longer than what is read"]);
    assert_refused(&case, &["--expect", "/dev/zero"], &["/dev/zero: ", "longer than what is read"]);
    let swaps = "[controller]\nstandby = 6\n[[swap]]\nat = 1\nlaw = \"ctc\"\n[[swap]]\nat = 2\nlaw = \"ctc\"\n";
    let swaps = case.write("swaps.toml", swaps);
    assert_refused(&case, &[swaps.to_str().unwrap()], &["swaps.toml", "`swap`", "8 controllers in all"]);
    let nobody = case.write("nobody.toml", "[[swap]]\nat = 1\nto = 9\n");
    assert_refused(
        &case,
        &[nobody.to_str().unwrap()],
        &["`swap[0].to`: found 9, allowed: the number of a controller, 1 to 1"],
    );
    let ended = case.output(&["bound", "--set", &other("none.csv"), "--set", "reference.kind=waypoints"]);
    assert!(ended.code == Some(2) && ended.err.contains("none.csv"), "{ended:?}");
}

#[test]
fn a_pipe_that_nobody_writes_to_is_given_up() {
    let case = Case::apart("silent");
    let path = fifo(&case, "silent");
    assert_refused(&case, &[path.to_str().expect("a path in UTF-8")], &["silent: nothing came of it for 5 s"]);
}
