//! A folder of results is one run's: no typo costs a recording, nothing of two runs is mixed, and what is not whole is
//! said by every command that reads it.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Case, wait_until};
use crate::untested::not_tested;

/// A change of the controller in charge leaves a file of its own.
const SWAPPED: &str = "[loop]\nmode = \"lockstep\"\nduration = \"300ms\"\n[[swap]]\nat = \"100ms\"\nlaw = \"ctc\"\n\
    force = true\n[expect]\nticks = \"== 300\"\n";
const PLAIN: &str = "[loop]\nmode = \"lockstep\"\nduration = \"300ms\"\n[expect]\nticks = \"== 300\"\n";

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

fn manifest(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("manifest.json")).expect("a manifest")).expect("JSON")
}

fn record(case: &Case, scenario: &str) -> PathBuf {
    let out = case.work.path().join("out");
    let ended = case.run(scenario, &["--out", text(&out)]).wait();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    out
}

/// The exit codes of every command that reads a recording.
fn codes(case: &Case, out: &Path) -> [Option<i32>; 4] {
    let out = text(out);
    [&["check", out] as &[&str], &["compare", out, out], &["report", out], &["replay", out]]
        .map(|command| case.output(command).code)
}

#[test]
fn a_run_that_is_refused_leaves_the_earlier_one_whole_and_check_names_it() {
    let case = Case::apart("typo");
    let out = record(&case, SWAPPED);
    let before = manifest(&out);
    let run_id = before["run_id"].as_str().expect("an id").to_owned();
    case.write("back.csv", "0,0,0,0\n2,1,1,1\n1,0,0,0\n");
    for refused in [
        "[reference]\nkind = \"waypoints\"\nfile = \"back.csv\"\n",
        "[reference]\nkind = \"waypoints\"\nfile = \"absent.csv\"\n",
        "[loop]\nrate = \"1 furlong\"\n",
        "[expect]\n'round_trip.p98' = '<= 1ms'\n",
    ] {
        let ended = case.run(refused, &["--out", text(&out)]).wait();
        assert_eq!(ended.code, Some(2), "{refused}: {ended:?}");
    }
    assert_eq!(case.output(&["run", "--mode", "lockstep", "--group", "no name", "--out", text(&out)]).code, Some(2));
    assert_eq!(manifest(&out), before);
    let checked = case.output(&["check", text(&out)]);
    assert!(checked.code == Some(0) && checked.out.contains(&run_id), "{checked:?}");
    let begun = before["begun"].as_str().expect("a time");
    assert!(checked.out.contains(begun), "{checked:?}");
    assert_eq!(case.output(&["check", text(&out), "--json"]).json()["run_id"], Value::from(run_id));
    case.assert_nothing_left();
}

#[test]
fn the_next_run_leaves_nothing_of_the_one_before_and_every_file_says_whose_it_is() {
    let case = Case::apart("next");
    let out = record(&case, SWAPPED);
    let first = manifest(&out)["run_id"].clone();
    assert!(out.join("changes/100.csv").exists());
    fs::write(out.join("notes.txt"), "mine").unwrap();
    record(&case, PLAIN);
    let run_id = manifest(&out)["run_id"].as_str().expect("an id").to_owned();
    assert_ne!(first, Value::from(run_id.as_str()));
    assert!(!out.join("changes").exists() && out.join("notes.txt").exists());
    let read = |name: &str| String::from_utf8_lossy(&fs::read(out.join(name)).unwrap()).into_owned();
    for (name, said) in [
        ("summary.json", format!("\"run_id\": \"{run_id}\"")),
        ("latency.hlog", format!("#run_id {run_id}\n")),
        ("junit.xml", format!("<property name=\"run_id\" value=\"{run_id}\"/>")),
        ("samples.mcap", run_id.clone()),
        ("report.html", run_id.clone()),
    ] {
        assert!(read(name).contains(&said), "{name}");
    }
    assert!(read("samples.csv").starts_with("tick,t_s,q1,"), "its columns are what they were");
    assert_eq!(codes(&case, &out), [Some(0); 4]);
    assert_eq!(codes(&case, &out), [Some(0); 4], "the page that `report` wrote again is as written");
    case.assert_nothing_left();
}

#[test]
fn a_file_that_is_not_as_written_is_named_by_every_reader() {
    let case = Case::apart("edited");
    let out = record(&case, PLAIN);
    let path = out.join("summary.json");
    let summary = fs::read_to_string(&path).unwrap();
    fs::write(&path, summary.replacen("\"missed_ticks\": 0", "\"missed_ticks\": 1", 1)).unwrap();
    assert_eq!(codes(&case, &out), [Some(5); 4]);
    let checked = case.output(&["check", text(&out), "--junit", "j.xml"]);
    assert!(checked.out.contains("INCOMPLETE") && checked.out.contains("summary.json is not what its run wrote"));
    assert!(fs::read_to_string(case.work.path().join("j.xml")).unwrap().contains("failures=\"1\""));
    fs::write(&path, "{").unwrap();
    assert_eq!(case.output(&["check", text(&out)]).code, Some(5));
    // Another run's file of the same kind.
    fs::write(&path, &summary).unwrap();
    assert_eq!(case.output(&["check", text(&out)]).code, Some(0));
    let samples = fs::read(out.join("samples.csv")).unwrap();
    fs::write(out.join("samples.csv"), &samples[..samples.len() / 2]).unwrap();
    let replayed = case.output(&["replay", text(&out)]);
    assert!(replayed.code == Some(5) && replayed.out.starts_with("INCOMPLETE"), "{replayed:?}");
    assert!(replayed.out.contains("samples.csv has"), "{replayed:?}");
}

#[test]
fn what_is_left_of_a_killed_run_is_shown_as_incomplete_and_gives_way_to_the_next() {
    let case = Case::apart("killed");
    let out = record(&case, SWAPPED);
    let endless = "[loop]\nmode = \"lockstep\"\nduration = \"10000s\"\n";
    let mut running = case.run(endless, &["--out", text(&out)]);
    let samples = out.join("samples.mcap");
    let is_new = || manifest(&out)["state"] == "unfinished" && manifest(&out)["earlier"].is_null();
    wait_until("the folder is the new run's", is_new);
    wait_until("a chunk is on the disk", || samples.metadata().is_ok_and(|file| file.len() > 100_000));
    let second = case.output(&["run", "--mode", "lockstep", "--duration", "1s", "--out", text(&out)]);
    assert!(second.code == Some(2) && second.err.contains("is writing there"), "{second:?}");
    let checked = case.output(&["check", text(&out)]);
    assert!(checked.code == Some(5) && checked.out.contains("still under way"), "{checked:?}");
    // The monitor first, so that it can't write its end.
    let monitor = running.process("monitor", 1, &["running", "ready", "active"]);
    crate::harness::send(monitor, Signal::KILL);
    running.signal(Signal::KILL);
    running.wait();
    wait_until("nobody is left", || !case.is_mentioned());
    assert_eq!(codes(&case, &out), [Some(5); 4]);
    let replayed = case.output(&["replay", text(&out), "--json"]).json();
    assert!(replayed["ticks"].as_u64() > Some(100) && replayed["differences"] == 0, "{replayed}");
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("incomplete") && page.contains("recording cut off"), "figures of what there is");
    record(&case, PLAIN);
    assert_eq!(codes(&case, &out), [Some(0); 4]);
}

#[test]
fn a_recording_needs_no_file_outside_of_its_folder() {
    let case = Case::apart("moved");
    let points = case.write("points.csv", "0,0,0,0\n0.1,0.1,0.1,0.1\n0.2,0,0,0\n");
    let out = record(&case, &format!("{PLAIN}[reference]\nkind = \"waypoints\"\nfile = \"points.csv\"\n"));
    fs::write(&points, "0,0,0,0\n5,3,3,3\n").unwrap();
    assert_eq!(case.output(&["replay", text(&out)]).code, Some(0), "the original was edited");
    fs::remove_file(&points).unwrap();
    let elsewhere = case.work.path().join("elsewhere");
    fs::rename(&out, &elsewhere).unwrap();
    assert_eq!(codes(&case, &elsewhere), [Some(0); 4]);
    let again = case.output(&["run", text(&elsewhere.join("scenario.toml")), "--group", &case.group, "--out", "again"]);
    assert_eq!(again.code, Some(0), "{again:?}");
    case.assert_nothing_left();
}

#[test]
fn folders_that_can_not_be_had_are_refused_before_anything_starts() {
    let case = Case::apart("refused");
    let run = |out: &str| {
        case.output(&["run", "--mode", "lockstep", "--duration", "50ms", "--group", &case.group, "--out", out])
    };
    case.write("file", "mine");
    fs::create_dir(case.work.path().join("theirs")).unwrap();
    case.write("theirs/summary.json", "{\"total\": 3}");
    for (out, said) in [
        ("file", "it is a file"),
        ("file/below", "file/below"),
        ("/proc/none", "/proc/none"),
        ("theirs", "summary.json is not of loopbound's"),
    ] {
        let ended = run(out);
        assert!(ended.code == Some(2) && ended.err.contains(said), "{out}: {ended:?}");
    }
    assert_eq!(fs::read_to_string(case.work.path().join("theirs/summary.json")).unwrap(), "{\"total\": 3}");
    assert_eq!(run("new/and/deep").code, Some(0));
    // The folder in which one is: what is there of the test's own stays.
    let here = run(".");
    assert_eq!(here.code, Some(0), "{here:?}");
    assert!(case.work.path().join("manifest.json").exists() && case.work.path().join("file").exists());
    case.assert_nothing_left();
}

#[test]
fn a_monitor_that_attaches_does_not_get_the_folder_of_the_run() {
    let case = Case::new("attached-out");
    let out = case.work.path().join("out");
    let mut running = case.run("[loop]\nduration = \"2s\"\n", &["--out", text(&out)]);
    running.wait_until_active();
    let refused = case.output(&["monitor", "--group", &case.group, "--out", text(&out)]);
    assert!(refused.code == Some(2) && refused.err.contains("is writing there"), "{refused:?}");
    let attached = case.output(&["monitor", "--group", &case.group, "--duration", "300ms", "--json", "--out", "seen"]);
    assert_eq!(attached.code, Some(0), "{attached:?}");
    let run_id = running.wait().json()["run_id"].clone();
    assert_eq!(manifest(&case.work.path().join("seen"))["run_id"], run_id, "both saw the same run");
    assert_eq!(manifest(&out)["state"], "finished");
    case.assert_nothing_left();
}

/// A filesystem of this size, unmounted at its end.
struct Tiny(PathBuf);

impl Tiny {
    fn mount(case: &Case, kib: u32) -> Option<Self> {
        let path = case.work.path().join("tiny");
        fs::create_dir(&path).expect("a folder to mount on");
        let size = format!("size={kib}k");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(&path).status();
        if mounted.is_ok_and(|status| status.success()) {
            return Some(Self(path));
        }
        not_tested("a recording on a full disk", "a small filesystem can't be mounted");
        None
    }
}

impl Drop for Tiny {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_disk_that_fills_up_ends_the_recording_and_neither_the_run_nor_its_verdict() {
    let case = Case::apart("full");
    let Some(disk) = Tiny::mount(&case, 2048) else { return };
    let out = disk.0.join("out");
    let ended = case.run("[loop]\nmode = \"lockstep\"\nduration = \"10s\"\n", &["--out", text(&out)]).wait();
    let summary = ended.json_with(5);
    // The headline is the one of its exit code; what the figures are worth stands below it.
    assert_eq!((&summary["ticks"], &summary["verdict"]["status"]), (&Value::from(10_000), &Value::from("incomplete")));
    let reasons = summary["verdict"]["reasons"].to_string();
    assert!(reasons.contains("as far as it went: held") && reasons.contains("the recording is not whole"), "{reasons}");
    assert_eq!(summary["recording"]["whole"], false);
    let dropped = summary["dropped"]["samples"].as_u64().expect("a count");
    let told = ended.err.lines().filter(|line| line.contains("the recording has ended")).count();
    assert!(told == 1 && ended.err.contains("No space left"), "{ended:?}");
    // What is counted as dropped and what is in the recording are all ticks.
    let replayed = case.output(&["replay", text(&out), "--json"]).json_with(5);
    assert_eq!(replayed["ticks"].as_u64().expect("a count") + dropped, 10_000, "{replayed}");
    assert_eq!(case.output(&["check", text(&out)]).code, Some(5));
    let csv = fs::read_to_string(out.join("samples.csv")).unwrap();
    assert!(csv.ends_with('\n'), "it ends with a whole line");
    // With less than a run needs it is refused, and with the earlier files out of the way it fits.
    fs::write(disk.0.join("ballast"), vec![0; 1 << 20]).unwrap_err();
    let elsewhere = case.run(PLAIN, &["--out", text(&disk.0.join("other"))]).wait();
    assert!(elsewhere.code == Some(2) && elsewhere.err.contains("KiB left"), "{elsewhere:?}");
    fs::remove_file(disk.0.join("ballast")).unwrap();
    record_into(&case, &out);
    assert_eq!(codes(&case, &out), [Some(0); 4]);
    case.assert_nothing_left();
}

fn record_into(case: &Case, out: &Path) {
    let ended = case.run(PLAIN, &["--out", text(out)]).wait();
    assert_eq!(ended.code, Some(0), "{ended:?}");
}

#[test]
fn a_recording_of_a_version_without_manifests_is_read_as_before_and_gives_way() {
    let case = Case::apart("legacy");
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings/0.1.0");
    let copy = case.work.path().join("out");
    let copied = Command::new("cp").arg("-r").arg(&kept).arg(&copy).status().expect("cp");
    assert!(copied.success());
    assert_eq!(codes(&case, &copy), [Some(0); 4]);
    let checked = case.output(&["check", text(&copy)]);
    assert!(checked.out.starts_with("run of 2026-"), "{checked:?}");
    record(&case, PLAIN);
    assert!(!copy.join("changes/60.csv").exists(), "what the old version wrote was recognised");
    assert_eq!(codes(&case, &copy), [Some(0); 4]);
}

#[test]
fn runs_of_two_clocks_are_not_compared_and_what_differs_is_said_first() {
    let case = Case::apart("compared");
    let run = |name: &str, scenario: &str| {
        let out = case.work.path().join(name);
        case.run(scenario, &["--out", text(&out)]).wait();
        out
    };
    let lockstep = run("a", PLAIN);
    let other = run("b", &PLAIN.replace("duration", "rate = \"2kHz\"\nduration").replace("300\"", "600\""));
    let realtime = run("c", "[loop]\nduration = \"300ms\"\n");
    let refused = case.output(&["compare", text(&lockstep), text(&realtime)]);
    assert!(refused.code == Some(2) && refused.err.contains("A ran in lockstep, on virtual time"), "{refused:?}");
    let compared = case.output(&["compare", text(&lockstep), text(&other)]);
    let first = compared.out.lines().next().unwrap_or_default();
    assert!(
        compared.code == Some(0) && first.starts_with("A and B differ: ") && first.contains("loop.rate"),
        "{first}"
    );
    assert!(compared.out.lines().any(|line| line.contains("zero") && line.ends_with("none")), "{compared:?}");
    assert!(!compared.out.contains("never"), "{compared:?}");
}
