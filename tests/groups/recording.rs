//! What `--out` writes: a run replays to the bit, an independent reader opens it, a damaged or foreign one is refused.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::harness::Case;
use crate::untested::not_tested;

/// A swap with a cross-fade that is rolled back, a standby, faults, noise: all that a torque can come from.
const SCENARIO: &str = "
[loop]
mode = \"lockstep\"
duration = \"800ms\"
[controller]
standby = 1
[plant.noise]
q_rad = 1e-5
[[swap]]
at = \"300ms\"
law = \"ctc\"
blend = \"20ms\"
force = true
[[fault]]
kind = \"glitch\"
at = \"150ms\"
value_nm = 5.0
[[fault]]
kind = \"drop\"
at = \"600ms\"
for = \"10ms\"
";

fn recorded(case: &Case, scenario: &str) -> PathBuf {
    let out = case.work.path().join("out");
    let ended = case.run(scenario, &["--out", out.to_str().expect("a path in UTF-8")]).wait();
    assert!(ended.code.is_some_and(|code| [0, 1, 3, 4].contains(&code)), "{ended:?}");
    out
}

fn replay(case: &Case, run: &Path, more: &[&str]) -> (Option<i32>, Value) {
    let mut arguments = vec!["replay", run.to_str().expect("a path in UTF-8"), "--json"];
    arguments.extend(more);
    let ended = case.output(&arguments);
    let report = serde_json::from_str(&ended.out).unwrap_or_else(|error| panic!("{error}: {ended:?}"));
    (ended.code, report)
}

#[test]
fn a_recorded_run_replays_to_the_bit_with_its_swap_its_standby_and_its_faults() {
    let case = Case::apart("replay");
    let out = recorded(&case, SCENARIO);
    let (code, report) = replay(&case, &out, &[]);
    assert_eq!((code, &report["differences"]), (Some(0), &Value::from(0)), "{report}");
    assert_eq!(report["ticks"], 800);
    assert_eq!(report["torques_as_recorded"], 0, "every torque was computed again: {report}");
    assert_eq!(report["verdict"], report["verdict_recorded"]);
    case.assert_nothing_left();
}

#[test]
fn a_run_in_real_time_replays_to_the_bit_too() {
    let case = Case::apart("replay-rt");
    let out = recorded(&case, "[loop]\nduration = \"500ms\"\n");
    let (code, report) = replay(&case, &out, &[]);
    // On a loaded machine the monitor may have lost records: then the rest can't be told.
    assert!(code == Some(0) || (code == Some(3) && !report["stopped_at_gap"].is_null()), "{code:?}: {report}");
    assert_eq!(report["differences"], 0, "{report}");
}

#[test]
fn what_if_changes_the_outcome_and_not_the_decisions() {
    let case = Case::apart("whatif");
    let out = recorded(&case, "[loop]\nmode = \"lockstep\"\nduration = \"400ms\"\n");
    let (code, same) = replay(&case, &out, &["--set", "controller.law=robust"]);
    assert_eq!((code, same["what_if"].as_bool()), (Some(0), Some(true)));
    let (_, other) = replay(&case, &out, &["--set", "plant.mass_error=0.3"]);
    assert_ne!(same["v_max"], Value::Null);
    assert_ne!((&same["v_max"], &same["max_abs_e_rad"]), (&other["v_max"], &other["max_abs_e_rad"]));
    for refused in ["loop.rate=2kHz", "reference.kind=hold", "plant.links=2"] {
        let ended = case.output(&["replay", out.to_str().expect("a path in UTF-8"), "--set", refused]);
        assert_eq!(ended.code, Some(2), "{refused}: {ended:?}");
    }
}

#[test]
fn a_changed_recording_is_found_a_cut_one_is_followed_to_its_end_and_a_foreign_one_is_refused() {
    let case = Case::apart("damage");
    let out = recorded(&case, "[loop]\nmode = \"lockstep\"\nduration = \"1500ms\"\n");
    let path = out.join("samples.mcap");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 3 / 4]).unwrap();
    let (code, report) = replay(&case, &out, &[]);
    assert_eq!((code, report["cut_off"].as_bool()), (Some(5), Some(true)));
    let ticks = report["ticks"].as_u64().unwrap();
    assert!((100..1500).contains(&ticks) && report["differences"] == 0, "{report}");
    let place = bytes.windows(13).position(|window| window == b"record_layout").unwrap() + 17;
    let mut foreign = bytes.clone();
    foreign[place] = if foreign[place] == b'0' { b'1' } else { b'0' };
    std::fs::write(&path, &foreign).unwrap();
    let ended = case.output(&["replay", out.to_str().expect("a path in UTF-8")]);
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.err.contains("layout of TickRecord"), "{}", ended.err);
}

/// Runs a script of the tests over a run's folder, where Python has the modules that it needs.
fn read_by_python(modules: &str, script: &str, out: &Path) {
    let python = std::env::var("LOOPBOUND_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has = Command::new(&python).args(["-c", &format!("import {modules}")]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        let needs = format!("{python} has no {modules}; tests/readers/requirements.txt names the packages");
        return not_tested(script, &needs);
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers").join(script);
    let read = Command::new(&python).arg(script).arg(out).output().expect("Python starts");
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
}

#[test]
fn an_independent_reader_opens_the_recording_and_finds_what_the_table_says() {
    let case = Case::apart("reader");
    read_by_python("mcap, mcap_protobuf", "read_mcap.py", &recorded(&case, SCENARIO));
}

#[test]
fn an_independent_reader_finds_the_figures_of_the_summary_in_the_interval_log() {
    let case = Case::apart("hlog");
    // Realtime, so that there is something to measure, and more than one interval.
    read_by_python("hdrh.log", "read_hlog.py", &recorded(&case, "[loop]\nduration = \"2500ms\"\n"));
}

#[test]
fn a_run_leaves_a_page_and_two_runs_make_one() {
    let case = Case::apart("page");
    let out = recorded(&case, "[loop]\nmode = \"lockstep\"\nduration = \"300ms\"\n");
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("\"summary\"") && page.len() > 50_000);
    let both = case.work.path().join("both.html");
    let folder = out.to_str().expect("a path in UTF-8");
    let ended = case.output(&["report", folder, folder, "--out", both.to_str().unwrap()]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(std::fs::metadata(&both).unwrap().len() > page.len() as u64 * 3 / 2);
    let ended = case.output(&["report", "nowhere"]);
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.err.contains("nowhere"), "{}", ended.err);
}
