//! Of other users: nothing of theirs is removed, nothing of theirs is believed, and nothing here is theirs to command.

use std::fs;
use std::io::{Read as _, Write as _};
use std::os::unix::fs::{PermissionsExt as _, chown, symlink};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;

use loopbound_shared::group::object_prefix;
use rustix::process::{Signal, getuid};

use crate::harness::{Case, Ended, NOBODY};
use crate::untested::not_tested;

const LONG: &str = "[loop]\nduration = \"1h\"\nwakeup = \"event\"\n";

fn refused(ended: &Ended, words: &[&str]) {
    assert_eq!(ended.code, Some(2), "{ended:?}");
    for word in words {
        assert!(ended.err.contains(word), "no `{word}`: {ended:?}");
    }
}

/// A folder with something in it that somebody wants to keep.
fn precious(folder: &Path) {
    fs::create_dir_all(folder.join("below")).expect("a folder");
    fs::write(folder.join("data"), "mine").expect("a file");
    fs::write(folder.join("below/data"), "mine").expect("a file");
}

fn assert_kept(folder: &Path) {
    for file in ["data", "below/data"] {
        assert_eq!(fs::read_to_string(folder.join(file)).ok().as_deref(), Some("mine"), "{}", folder.display());
    }
}

fn close_to_others(folder: &Path) {
    fs::set_permissions(folder, fs::Permissions::from_mode(0o700)).expect("permissions");
}

#[test]
fn a_strangers_folder_in_the_place_of_ours_is_refused_and_what_its_links_lead_to_is_kept() {
    let case = Case::apart("foreign");
    if !getuid().is_root() {
        return not_tested("a folder of another user's", "only root can make one");
    }
    let target = case.work.path().join("target");
    precious(&target);
    let folder = case.runtime_folder();
    fs::create_dir(folder).expect("the stranger's folder");
    symlink(&target, folder.join(&case.group)).expect("the stranger's link");
    chown(folder, Some(NOBODY), Some(NOBODY)).expect("a change of owner");
    let way_out = ["belongs to user 65534", "LOOPBOUND_RUNTIME_DIR"];
    for arguments in
        [&["clean"][..], &["ps"], &["run", "--quiet", "--group", &case.group], &["monitor", "--group", "a"]]
    {
        refused(&case.output(arguments), &way_out);
        assert_kept(&target);
    }
    // Nor through a link in the folder's own place.
    fs::remove_dir_all(folder).expect("the end of the stranger's folder");
    let real = case.work.path().join("real");
    fs::create_dir(&real).expect("a folder");
    close_to_others(&real);
    symlink(&target, real.join(&case.group)).expect("a link");
    symlink(&real, folder).expect("a link");
    for arguments in [&["clean"][..], &["run", "--quiet", "--group", &case.group]] {
        refused(&case.output(arguments), &["symbolic link", "LOOPBOUND_RUNTIME_DIR"]);
        assert_kept(&target);
    }
    fs::remove_file(folder).expect("the end of the link");
}

#[test]
fn clean_removes_nothing_of_an_ordinary_folder_that_the_variable_names() {
    let case = Case::new("ordinary");
    let ordinary = case.work.path().join("ordinary");
    precious(&ordinary.join("project"));
    fs::write(ordinary.join("project/alive"), "").expect("a file of a common name");
    precious(&ordinary);
    let run = |arguments: &[&str], folder: &Path| {
        let mut command = case.command(arguments);
        command.env("LOOPBOUND_RUNTIME_DIR", folder);
        case.start_command(command).wait()
    };
    let kept = || {
        assert_kept(&ordinary);
        assert_kept(&ordinary.join("project"));
    };
    fs::set_permissions(&ordinary, fs::Permissions::from_mode(0o755)).expect("permissions");
    refused(&run(&["clean"], &ordinary), &["0755", "LOOPBOUND_RUNTIME_DIR"]);
    kept();
    close_to_others(&ordinary);
    let ended = run(&["clean"], &ordinary);
    assert_eq!((ended.code, ended.out.as_str()), (Some(0), "nothing to clean\n"), "{ended:?}");
    kept();
    refused(&run(&["run", "--quiet", "--group", "project"], &ordinary), &["project", "something else is in it"]);
    kept();
    // A group among them comes and goes, and the folder, which is not of our making, stays.
    let ended = run(&["run", "--quiet", "--group", "mine", "--mode", "lockstep", "--duration", "100ms"], &ordinary);
    assert!(ended.code.is_some_and(|code| code != 2), "{ended:?}");
    assert!(!ordinary.join("mine").exists());
    kept();
    fs::remove_dir_all(&ordinary).expect("the end of the folder");
    fs::create_dir(&ordinary).expect("an empty folder");
    close_to_others(&ordinary);
    run(&["run", "--quiet", "--group", "mine", "--mode", "lockstep", "--duration", "100ms"], &ordinary);
    assert!(ordinary.exists(), "an empty folder that somebody made is not ours to remove");
}

#[test]
fn clean_removes_what_a_launcher_left_that_was_killed_before_its_groups_mark() {
    let case = Case::apart("unmarked");
    let clean = || case.output(&["clean"]);
    // Somebody's own runtime directory may have empty folders.
    let unmarked = case.group_folder();
    fs::create_dir_all(&unmarked).expect("a folder");
    close_to_others(case.runtime_folder());
    assert_eq!(clean().out, "nothing to clean\n");
    assert!(unmarked.exists());
    // One that loopbound has made has none but those.
    fs::write(case.runtime_folder().join(".loopbound"), "").expect("the mark of the runtime directory");
    let full = case.runtime_folder().join("full");
    precious(&full);
    let ended = clean();
    assert_eq!((ended.code, ended.out), (Some(0), format!("cleaned {}\n", case.group)));
    assert_kept(&full);
    fs::remove_dir_all(&full).expect("the end of the folder");
    fs::create_dir(&unmarked).expect("a folder");
    clean();
    case.assert_nothing_left();
}

#[test]
fn a_runtime_folder_without_an_absolute_path_is_refused_by_every_command_that_needs_one() {
    let case = Case::new("relative");
    precious(case.work.path());
    for value in ["", ".", "here", "./here"] {
        for arguments in [
            &["run", "--quiet"][..],
            &["clean"],
            &["ps"],
            &["monitor", "--group", "a"],
            &["swap", "--group", "a", "--law", "ctc"],
            &["fault", "--group", "a", "delay"],
        ] {
            let mut command = case.command(arguments);
            command.env("LOOPBOUND_RUNTIME_DIR", value);
            refused(&case.start_command(command).wait(), &["LOOPBOUND_RUNTIME_DIR", "absolute", &format!("{value:?}")]);
        }
        assert_kept(case.work.path());
        assert!(!case.work.path().join("here").exists());
    }
}

/// Every entry that belongs to this case's group.
fn modes(case: &Case) -> Vec<(String, u32)> {
    let prefix = object_prefix(&case.group_folder());
    let mut found = Vec::new();
    let mut note = |path: &Path| {
        if let Ok(there) = fs::symlink_metadata(path) {
            found.push((path.display().to_string(), there.permissions().mode() & 0o777));
        }
    };
    note(case.runtime_folder());
    note(&case.group_folder());
    for folder in [Path::new("/dev/shm"), &case.group_folder()] {
        let entries = fs::read_dir(folder).expect("a folder").flatten();
        let ours = |name: &str| folder != Path::new("/dev/shm") || name.starts_with(&prefix);
        entries.filter(|entry| entry.file_name().to_str().is_some_and(ours)).for_each(|entry| note(&entry.path()));
    }
    found
}

#[test]
fn whatever_the_umask_nobody_else_may_look_at_a_group_or_command_it() {
    for umask in ["000", "002", "077"] {
        let case = Case::apart(&format!("umask-{umask}"));
        let file = case.write("scenario.toml", LONG);
        let mut command = Command::new("sh");
        command.args(["-c", &format!("umask {umask}; exec \"$@\""), "sh", env!("CARGO_BIN_EXE_loopbound"), "run"]);
        command.arg(&file).args(["--quiet", "--group", &case.group]);
        command.env("LOOPBOUND_RUNTIME_DIR", case.runtime_folder());
        let mut running = case.start_command(command);
        running.wait_until_active();
        let found = modes(&case);
        assert!(found.len() > 30, "files and objects of a group: {found:?}");
        let open: Vec<_> = found.iter().filter(|(_, mode)| mode & 0o077 != 0).collect();
        assert!(open.is_empty(), "under umask {umask} others may use {open:?}");
        assert!(found.iter().any(|(name, mode)| name.ends_with("/control") && *mode == 0o600), "{found:?}");
        // The one who reads the line gets no further than the folder.
        let program = case.write("program", "#!/bin/sh\ntouch started\n");
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("permissions");
        let swap = ["swap", "--group", &case.group, "--exe", program.to_str().expect("a path in UTF-8")];
        if let Some(stranger) = case.command_of_a_stranger(&swap) {
            refused(&case.start_command(stranger).wait(), &["belongs to user 0"]);
        }
        assert!(!case.work.path().join("started").exists());
        running.signal(Signal::INT);
        assert_eq!(running.wait().code, Some(130));
        case.assert_nothing_left();
    }
}

/// Where the helper connects, and what it writes.
const PART: &str = "LOOPBOUND_TEST_SOCKET";
const REQUEST: &str = "LOOPBOUND_TEST_REQUEST";

#[test]
#[ignore = "a helper of the next test, which starts it as another user"]
fn helper_that_asks_for_a_swap() {
    let Some(socket) = std::env::var_os(PART) else { return };
    let mut stream = UnixStream::connect(socket).expect("the socket was opened to all");
    stream.set_read_timeout(Some(std::time::Duration::from_secs(20))).expect("a time-out");
    // The supervisor may have hung up before or after that.
    let _ = stream.write_all(std::env::var(REQUEST).expect("a request").as_bytes());
    let mut answer = String::new();
    let heard = stream.read_to_string(&mut answer);
    assert!(answer.is_empty() && heard.map_err(|e| e.kind()) != Err(std::io::ErrorKind::WouldBlock), "{answer}");
}

#[test]
fn who_opened_the_folder_for_others_is_refused_and_a_strangers_peer_is_not_heard() {
    let case = Case::apart("opened");
    let arguments = ["--exact", "users::helper_that_asks_for_a_swap", "--ignored"];
    let own = std::env::current_exe().expect("this executable");
    let Some(mut stranger) = case.strangers_command_of(&own, &arguments) else { return };
    let mut running = case.run(LONG, &["--quiet"]);
    running.wait_until_active();
    // By hand, as no release of ours does it: then the socket's own check has to hold.
    for (path, mode) in [
        (case.runtime_folder().to_owned(), 0o755),
        (case.group_folder(), 0o755),
        (case.group_folder().join("control"), 0o777),
    ] {
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("permissions");
    }
    let program = case.write("program", "#!/bin/sh\ntouch started\n");
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("permissions");
    let control = case.group_folder().join("control");
    let request = format!("{{\"exe\": \"{}\", \"force\": false}}\n", program.display());
    stranger.env(PART, &control).env(REQUEST, request);
    let ended = case.start_command(stranger).wait();
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(!case.work.path().join("started").exists());
    assert!(UnixStream::connect(&control).is_ok(), "the supervisor still listens");
    refused(&case.output(&["ps"]), &["0755"]);
    close_to_others(case.runtime_folder());
    running.signal(Signal::INT);
    assert_eq!(running.wait().code, Some(130));
    case.assert_nothing_left();
}
