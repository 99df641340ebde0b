//! What the user gets wrong costs one clear line and exit code 2, starts nothing and leaves nothing; the small commands.

use std::io::Write as _;
use std::process::Stdio;

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Case, Ended};

#[track_caller]
fn assert_refused(ended: &Ended, names: &[&str]) {
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.out.is_empty(), "nothing on standard output: {ended:?}");
    for name in names {
        assert!(ended.err.contains(name), "`{name}` is not named: {}", ended.err);
    }
}

#[test]
fn a_scenario_that_can_not_be_run_is_refused_in_one_line_and_starts_nothing() {
    let refused: &[(&str, &[&str])] = &[
        ("[plant]\nlinks = 3\nmass = [1, 2]\n", &["mass", "3"]),
        ("[plant]\nmass = [1, 0, 1]\n", &["mass"]),
        ("[plant]\nmass = -1\n", &["mass"]),
        ("[plant]\nlength = nan\n", &["length"]),
        ("[plant]\nlinks = 8\n", &["links"]),
        ("[plant]\ninertia = -0.1\n", &["inertia"]),
        ("[loop]\nrate = \"1MHz\"\n", &["rate"]),
        ("[loop]\nrate = \"0Hz\"\n", &["rate"]),
        ("[loop]\nduration = \"10\"\n", &["duration"]),
        ("[loop]\ngrace = \"2ms\"\n", &["grace"]),
        ("[controller]\nlaw = \"robst\"\n", &["robst", "robust"]),
        ("[loop]\nraet = \"1kHz\"\n", &["raet", "rate"]),
        ("[pland]\nlinks = 3\n", &["pland", "plant"]),
        ("[controller]\nstandby = 99\n", &["standby"]),
        ("[[fault]]\nkind = \"kil\"\n", &["kil", "kill"]),
        ("[[fault]]\nkind = \"drop\"\nprobability = 2\n", &["probability"]),
        ("[[fault]]\nkind = \"clock-step\"\ntarget = \"monitor\"\nstep = \"1ms\"\n", &["fault[0].target", "monitor"]),
        (
            "[loop]\nmode = \"lockstep\"\n[[fault]]\nkind = \"drop\"\ntarget = \"plant\"\n",
            &["fault[0].target", "plant", "realtime"],
        ),
        ("[[swap]]\nat = \"1s\"\n", &["swap"]),
        ("[loop\nrate = 1", &["scenario.toml"]),
    ];
    let case = Case::apart("refused");
    for (scenario, names) in refused {
        let ended = case.run(scenario, &[]).wait();
        assert_refused(&ended, names);
        let lines = ended.err.trim_end().lines().count();
        assert!(lines == 1, "{lines} lines for {scenario:?}: {}", ended.err);
        case.assert_nothing_left();
    }
}

#[test]
fn a_command_line_that_can_not_be_understood_is_refused_and_starts_nothing() {
    let case = Case::apart("line");
    let refused: &[(&[&str], &[&str])] = &[
        (&["run", "--rate", "fast"], &["--rate", "fast"]),
        (&["run", "--wakeup", "snooze"], &["hybrid"]),
        (&["run", "--set", "plant.gravty=1"], &["gravty", "gravity"]),
        (&["run", "--set", "plant.gravity"], &["plant.gravity"]),
        (&["run", "nowhere.toml"], &["nowhere.toml"]),
        (&["run", "--group", "a/b"], &["a/b"]),
        (&["run", "--expect", "nowhere.toml"], &["nowhere.toml"]),
        (&["monitor", "--group", "nobody-there"], &["nobody-there"]),
        (&["frobnicate"], &["frobnicate"]),
    ];
    for (arguments, names) in refused {
        assert_refused(&case.output(arguments), names);
        case.assert_nothing_left();
    }
}

#[test]
fn a_controller_that_is_not_there_is_refused_and_one_that_never_gets_ready_is_named() {
    let case = Case::new("exe");
    let ended = case.run("[controller]\nexe = \"/nowhere/controller\"\n", &[]).wait();
    assert_refused(&ended, &["/nowhere/controller"]);
    case.assert_nothing_left();
    let ended = case.run("[controller]\nexe = \"/bin/false\"\n", &[]).wait();
    assert_eq!(ended.code, Some(5), "{ended:?}");
    assert!(ended.err.contains("controller 1") && ended.err.contains("exit code 1"), "{}", ended.err);
    case.assert_nothing_left();
}

#[test]
fn ps_shows_a_running_group_and_nothing_after_it() {
    let case = Case::apart("ps");
    assert_eq!(case.output(&["ps", "--json"]).json_with(0), Value::Array(Vec::new()));
    let mut running = case.run("[loop]\nduration = \"1h\"\n[controller]\nstandby = 1\n", &[]);
    running.wait_until_active();
    let groups = case.output(&["ps", "--json"]).json_with(0);
    assert_eq!(groups[0]["group"], case.group.as_str());
    let mut found: Vec<(String, u64, String)> = Vec::new();
    for process in groups[0]["processes"].as_array().expect("a list of processes") {
        let word = |key: &str| process[key].as_str().unwrap_or_default().to_owned();
        assert!(process["pid"].as_u64().is_some_and(|pid| pid > 1));
        found.push((word("role"), process["id"].as_u64().expect("an id"), word("state")));
    }
    found.sort();
    let expected = [
        ("controller", 1, "active"),
        ("controller", 2, "standby"),
        ("monitor", 1, "ready"),
        ("plant", 1, "ready"),
        ("reference", 1, "ready"),
        ("supervisor", 0, "ready"),
    ];
    assert_eq!(found, expected.map(|(role, id, state)| (role.to_owned(), id, state.to_owned())));
    let table = case.output(&["ps"]).out;
    assert!(table.contains(&case.group) && table.contains("standby"), "{table}");
    let cleaned = case.output(&["clean"]);
    assert_eq!((cleaned.code, cleaned.out.as_str()), (Some(0), "nothing to clean\n"), "a running group is not touched");
    running.signal(Signal::TERM);
    assert_eq!(running.wait().code, Some(143));
    assert_eq!(case.output(&["ps", "--json"]).json_with(0), Value::Array(Vec::new()));
    case.assert_nothing_left();
}

#[test]
fn doctor_gives_one_document_of_checks_and_leaves_nothing() {
    let case = Case::apart("doctor");
    let report = case.output(&["doctor", "--json"]).json_with(0);
    assert!(report.as_object().is_some_and(|report| !report.is_empty()), "{report}");
    assert_eq!(case.output(&["doctor"]).code, Some(0));
    case.assert_nothing_left();
}

#[test]
fn model_answers_each_line_with_one_line() {
    let case = Case::apart("model");
    let mut child = case
        .command(&["model"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the executable starts");
    let mut input = child.stdin.take().expect("a pipe");
    let lines = "{\"q\":[0,0,0],\"v\":[0,0,0],\"tau\":[0,0,0]}\n{\"q\":[0.3,-0.2]}\nnonsense\n\
                 {\"q\":[0.5],\"v\":[0],\"tau\":[1],\"chain\":{\"mass\":[1],\"length\":[1],\"inertia\":[0.1],\"gravity\":9.81}}\n";
    input.write_all(lines.as_bytes()).expect("the lines go in");
    drop(input);
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(2), "one line at least can't be answered");
    let answers: Vec<Value> = String::from_utf8_lossy(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{line}: {e}")))
        .collect();
    assert_eq!(answers.len(), 4);
    assert_eq!(answers[0]["acceleration"], serde_json::json!([0.0, 0.0, 0.0]), "a chain that hangs rests");
    assert!(answers[1]["error"].is_string() && answers[2]["error"].is_string());
    // One link about its hinge: (m (L/2)² + I) q̈ = τ − m g (L/2) sin q.
    let by_hand = (1.0 - 9.81 * 0.5 * libm::sin(0.5)) / (0.25 + 0.1);
    let answered = answers[3]["acceleration"][0].as_f64().expect("a number");
    assert!((answered - by_hand).abs() < 1e-12, "{answered} is not {by_hand}");
}

#[test]
fn every_command_with_a_scenario_refuses_what_can_not_be_built_before_any_output() {
    let case = Case::new("not-built");
    case.write("back.csv", "t_s,q1,q2,q3\n0,0,0,0\n2,1,1,1\n1,0,0,0\n");
    case.write("bad.toml", "[reference]\nkind = \"waypoints\"\nfile = \"back.csv\"\n");
    for arguments in [&["run", "bad.toml"][..], &["model", "bad.toml"], &["study", "load", "bad.toml", "--out", "out"]]
    {
        let ended = case.start(arguments).wait();
        assert_eq!((ended.code, ended.out.as_str()), (Some(2), ""), "{arguments:?}: {ended:?}");
        assert!(ended.err.contains("reference.file") || ended.err.contains("back.csv"), "{arguments:?}: {ended:?}");
    }
    assert!(!case.work.path().join("out").exists());
    case.assert_nothing_left();
}

#[test]
fn a_path_does_not_command_the_terminal_wherever_it_is_said() {
    let case = Case::new("rude-path");
    let rude = "a\u{1b}]0;owned\u{7}\r\nb";
    case.write(rude, "no = 1\n");
    for arguments in [
        &["run", rude][..],
        &["run", "--out", rude],
        &["run", "--expect", rude],
        &["bound", rude],
        &["model", rude],
        &["check", rude],
        &["compare", rude, rude],
        &["report", rude],
        &["replay", rude],
        &["study", "load", rude],
        &["study", "rate", "--quick", "--out", rude],
        &["swap", "--group", "g", "--exe", rude],
        &["monitor", "--group", rude],
        &["clean", rude],
    ] {
        let ended = case.start(arguments).wait();
        assert!(ended.code.is_some_and(|code| code != 0 && code != 101), "{arguments:?}: {ended:?}");
        let raw = |text: &str| text.contains(['\u{1b}', '\u{7}', '\r']);
        assert!(!raw(&ended.out) && !raw(&ended.err), "{arguments:?}: {ended:?}");
    }
}
