//! The standard streams: whatever becomes of them, nothing said ends the one who says it, and the exit code is the outcome's.

use std::fs::File;
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command, Stdio};

use loopbound_shared::clock;

use crate::harness::{Case, PATIENCE_S, wait_until};

const KILLED: &str = "\
[loop]
mode = \"lockstep\"
duration = \"200ms\"
[[fault]]
kind = \"kill\"
target = \"controller\"
at = 1
";

fn full() -> Stdio {
    File::options().write(true).open("/dev/full").expect("/dev/full").into()
}

/// A pipe whose reader has gone.
fn closed_pipe() -> Stdio {
    std::io::pipe().expect("a pipe").1.into()
}

/// The exit code, none after a signal; panics if it hangs.
fn code_of(mut child: Child) -> Option<i32> {
    let until_ns = clock::now_ns() + PATIENCE_S * clock::NS_PER_S;
    loop {
        if let Some(status) = child.try_wait().expect("the state of a child") {
            return status.code();
        }
        if clock::now_ns() >= until_ns {
            let _ = child.kill();
            let _ = child.wait();
            panic!("it hangs");
        }
        clock::sleep_ns(2_000_000);
    }
}

fn quiet(mut command: Command) -> Command {
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command
}

#[test]
fn a_standard_error_that_is_full_or_has_no_reader_changes_no_exit_code() {
    let case = Case::new("full-err");
    let file = case.write("k.toml", KILLED);
    let path = file.to_str().expect("a path in UTF-8");
    for stream in [full, closed_pipe] {
        let mut run = quiet(case.command(&["run", path, "--group", &case.group]));
        assert_eq!(code_of(run.stderr(stream()).spawn().expect("it starts")), Some(5));
        let mut refused = quiet(case.command(&["run", "nowhere.toml"]));
        assert_eq!(code_of(refused.stderr(stream()).spawn().expect("it starts")), Some(2));
        let mut mistyped = quiet(case.command(&["frobnicate"]));
        assert_eq!(code_of(mistyped.stderr(stream()).spawn().expect("it starts")), Some(2));
        case.assert_nothing_left();
    }
}

#[test]
fn in_real_time_a_note_that_nobody_reads_ends_no_loop() {
    let case = Case::new("gone-err");
    // The standby stands in; of the death a note is said.
    let scenario =
        "[loop]\nduration = \"600ms\"\n[controller]\nstandby = 1\n[[fault]]\nkind = \"kill\"\nat = \"100ms\"\n";
    let file = case.write("k.toml", scenario);
    let out = case.work.path().join("out.json");
    let arguments = ["run", file.to_str().expect("a path in UTF-8"), "--group", &case.group, "--json"];
    let mut run = quiet(case.command(&arguments));
    run.stdout(File::create(&out).expect("a file")).stderr(closed_pipe());
    let code = code_of(run.spawn().expect("it starts"));
    let text = std::fs::read_to_string(&out).expect("the document");
    let document: serde_json::Value = serde_json::from_str(&text).expect("one JSON document");
    assert_eq!(document["supervision"]["end"], "done", "exit code {code:?}: {}", document["supervision"]);
    let deaths = document["supervision"]["deaths"].as_array().map_or(0, Vec::len);
    assert!(deaths > 0, "there was something to say: {}", document["supervision"]);
    case.assert_nothing_left();
}

#[test]
fn a_group_is_brought_to_its_end_though_nobody_empties_the_pipe_of_its_notes() {
    let case = Case::new("stuck-err");
    let file = case.write("k.toml", KILLED);
    let (reader, writer) = std::io::pipe().expect("a pipe");
    // So full that not one line fits in.
    rustix::fs::fcntl_setfl(&writer, rustix::fs::OFlags::NONBLOCK).expect("a pipe that does not block");
    while rustix::io::write(&writer, &[b'.'; 4096]).is_ok() {}
    while rustix::io::write(&writer, b".").is_ok() {}
    rustix::fs::fcntl_setfl(&writer, rustix::fs::OFlags::empty()).expect("a pipe that blocks");
    let mut run = quiet(case.command(&["run", file.to_str().expect("a path in UTF-8"), "--group", &case.group]));
    let child = run.stderr(writer).spawn().expect("it starts");
    drop(run);
    wait_until("the group is there", || case.group_folder().join("bell").exists());
    wait_until("the group has ended", || !case.group_folder().exists());
    // Its last words wait for a reader, as anybody's do.
    let reading = std::thread::spawn(move || std::io::read_to_string(reader).expect("what it said"));
    assert_eq!(code_of(child), Some(5));
    let said = reading.join().expect("the reader ends");
    assert!(said.contains("controller 1 (pid"), "the note came after all: {}", said.trim_start_matches('.'));
    case.assert_nothing_left();
}

#[test]
fn a_reader_who_leaves_is_no_error_and_the_exit_code_is_that_of_the_outcome() {
    let case = Case::new("gone-out");
    let run = ["run", "--mode", "lockstep", "--duration", "100ms", "--group", &case.group];
    let json = [run.as_slice(), &["--json"]].concat();
    let commands: &[&[&str]] = &[
        &run,
        &json,
        &["ps"],
        &["ps", "--json"],
        &["bound"],
        &["bound", "--json"],
        &["clean"],
        &["doctor"],
        &["completions", "bash"],
        &["man"],
        &["--help"],
        &["run", "--help"],
        &["--version"],
    ];
    for arguments in commands {
        let mut command = quiet(case.command(arguments));
        assert_eq!(code_of(command.stdout(closed_pipe()).spawn().expect("it starts")), Some(0), "{arguments:?}");
        case.assert_nothing_left();
    }
    // A run that failed says so by its code, whoever listens.
    let file = case.write("k.toml", KILLED);
    let mut run = quiet(case.command(&["run", file.to_str().expect("a path in UTF-8"), "--group", &case.group]));
    assert_eq!(code_of(run.stdout(closed_pipe()).spawn().expect("it starts")), Some(5));
    // Questions without an end, answers without a reader.
    let mut model = quiet(case.command(&["model"]));
    let (questions, mut asker) = std::io::pipe().expect("a pipe");
    let child = model.stdin(questions).stdout(closed_pipe()).spawn().expect("it starts");
    drop(model);
    let asking = std::thread::spawn(move || {
        use std::io::Write as _;
        while asker.write_all(b"{\"q\":[0.1,0.2,0.3]}\n").is_ok() {}
    });
    assert_eq!(code_of(child), Some(0));
    asking.join().expect("the asker ends");
}

#[test]
fn a_lost_result_is_said_and_is_an_error_of_a_command_that_only_prints() {
    let case = Case::new("full-out");
    let run = ["run", "--mode", "lockstep", "--duration", "100ms", "--group", &case.group];
    let json = [run.as_slice(), &["--json"]].concat();
    // A run's verdict stands; so does what `clean` has done.
    let commands: &[(&[&str], i32)] = &[
        (&run, 0),
        (&json, 0),
        (&["clean"], 0),
        (&["ps"], 70),
        (&["ps", "--json"], 70),
        (&["bound"], 70),
        (&["completions", "zsh"], 70),
        (&["man"], 70),
        (&["--help"], 70),
        (&["--version"], 70),
    ];
    for (arguments, code) in commands {
        let mut command = case.command(arguments);
        command.stdin(Stdio::null()).stdout(full()).stderr(Stdio::piped());
        let ended = command.spawn().and_then(Child::wait_with_output).expect("it starts");
        let said = String::from_utf8_lossy(&ended.stderr);
        assert_eq!(ended.status.code(), Some(*code), "{arguments:?}: {said}");
        assert!(said.contains("standard output can't be written: No space left on device"), "{arguments:?}: {said}");
        case.assert_nothing_left();
    }
}

#[test]
fn streams_that_are_closed_at_the_start_become_nothing_else() {
    let case = Case::new("closed");
    let scenario = "[loop]\nduration = \"300ms\"\nmode = \"lockstep\"\n";
    let file = case.write("s.toml", scenario);
    let shell = |closing: &str| {
        let mut command = Command::new("sh");
        let exe = env!("CARGO_BIN_EXE_loopbound");
        command.args(["-c", &format!("exec \"$0\" \"$@\" {closing}"), exe, "run"]);
        command.arg(&file).args(["--group", &case.group, "--json"]);
        command.env("LOOPBOUND_RUNTIME_DIR", case.group_folder().parent().expect("the runtime folder"));
        command.process_group(0);
        quiet(command)
    };
    for closing in [">&-", "2>&-", "<&-", "<&- >&- 2>&-"] {
        let child = shell(closing).spawn().expect("it starts");
        let pid = child.id();
        wait_until("the group is there", || case.group_folder().join("bell").exists());
        for stream in 0..3 {
            // It may have ended meanwhile.
            if let Ok(target) = std::fs::read_link(format!("/proc/{pid}/fd/{stream}")) {
                assert_eq!(target.to_str(), Some("/dev/null"), "stream {stream} with {closing}");
            }
        }
        assert_eq!(code_of(child), Some(0), "{closing}");
        case.assert_nothing_left();
    }
}
