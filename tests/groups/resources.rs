//! What a host lacks is named at once, with the remedy, and nobody is killed by it.

use std::process::Command;

use crate::harness::{Case, Ended};
use crate::untested::not_tested;

/// Runs shell lines with a shared memory of its own of so many KiB; `$LB` is the executable. None where that can't be.
fn with_shared_memory(case: &Case, kib: u32, lines: &str) -> Option<Ended> {
    let own = |lines: &str| {
        let mount = format!("mount -t tmpfs -o size={kib}k tmpfs /dev/shm && {lines}");
        let plain = case.command(&[]);
        let mut command = Command::new("unshare");
        command.current_dir(case.work.path()).args(["-m", "sh", "-c", &mount]).env("LB", plain.get_program());
        // The default runtime directory, which lies in that memory.
        command.env_remove("LOOPBOUND_RUNTIME_DIR");
        command
    };
    if !own("true").output().is_ok_and(|probe| probe.status.success()) {
        not_tested("a small /dev/shm", "only root with namespaces can mount one");
        return None;
    }
    Some(case.start_command(own(lines)).wait())
}

#[test]
fn a_shared_memory_of_any_size_holds_the_group_or_is_named_with_the_remedy() {
    let case = Case::new("small-shm");
    let mut held = 0;
    for kib in [64, 1024, 8192, 20_480, 24_576, 26_112, 26_624, 28_672, 40_960] {
        let line = "\"$LB\" run --mode lockstep --duration 60ms -q --group small; code=$?; ls /dev/shm; exit $code";
        let Some(ended) = with_shared_memory(&case, kib, line) else { return };
        assert_eq!(ended.out, "", "nothing is left with {kib} KiB: {ended:?}");
        if ended.code == Some(0) {
            held += 1;
            continue;
        }
        assert_eq!((ended.code, held), (Some(70), 0), "{kib} KiB: {ended:?}");
        for part in ["/dev/shm has no room", "MB are needed", "--shm-size"] {
            assert!(ended.err.contains(part), "{kib} KiB: {part}: {ended:?}");
        }
    }
    assert!(held >= 2, "the larger ones are large enough");
}

#[test]
fn a_shared_memory_with_few_places_for_files_holds_the_group_or_is_named() {
    let case = Case::new("few-inodes");
    let mut held = 0;
    for places in [3, 20, 60, 100, 150, 190, 210, 400] {
        let line = format!(
            "mount -o remount,nr_inodes={places} /dev/shm; \"$LB\" run --mode lockstep --duration 60ms -q --group few; \
             code=$?; ls /dev/shm; exit $code"
        );
        let Some(ended) = with_shared_memory(&case, 40_960, &line) else { return };
        assert_eq!(ended.out, "", "nothing is left with {places}: {ended:?}");
        if ended.code == Some(0) {
            held += 1;
            continue;
        }
        assert_eq!((ended.code, held), (Some(70), 0), "{places}: {ended:?}");
        assert!(ended.err.contains("/dev/shm has no room") && ended.err.contains("nr_inodes"), "{places}: {ended:?}");
    }
    assert!(held >= 1, "the larger ones are large enough");
}

#[test]
fn a_shared_memory_that_fills_up_under_a_run_ends_nobody_and_lets_nobody_in() {
    let case = Case::new("full-shm");
    let lines = "\
\"$LB\" run --duration 3s --group full --set controller.standby=1 --json >run.json 2>run.err & run=$!
while ! grep -q active /dev/shm/loopbound-*/full/processes.json 2>/dev/null; do sleep 0.05; done
dd if=/dev/zero of=/dev/shm/filler bs=4k 2>/dev/null
\"$LB\" monitor --group full --duration 100ms; echo monitor $?
\"$LB\" swap --group full --law ctc >swap.out; echo swap $?
\"$LB\" run --mode lockstep --duration 60ms --group second; echo second $?
wait $run; echo run $?";
    let Some(ended) = with_shared_memory(&case, 40_960, lines) else { return };
    assert!(ended.out.contains("monitor 70") && ended.out.contains("second 70"), "{ended:?}");
    assert_eq!(ended.err.matches("/dev/shm has no room").count(), 2, "{ended:?}");
    let swap = std::fs::read_to_string(case.work.path().join("swap.out")).expect("the swap's report");
    assert!(ended.out.contains("swap 4") && swap.contains("refused"), "{ended:?}");
    // The report is broken into lines.
    let words: String = swap.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(words.contains("/dev/shm has no room") && words.contains("--shm-size"), "{words}");
    let text = std::fs::read_to_string(case.work.path().join("run.json")).expect("the document");
    let document: serde_json::Value = serde_json::from_str(&text).expect("one JSON document");
    assert_eq!(document["supervision"]["end"], "done", "{}", document["supervision"]);
    assert_eq!(document["supervision"]["deaths"].as_array().map(Vec::len), Some(0), "{}", document["supervision"]);
    assert_eq!(document["ended"], "last record");
}

#[test]
fn too_few_descriptors_are_named_with_the_remedy_and_a_soft_limit_is_raised() {
    let case = Case::new("few-files");
    let with_limit = |limit: &str, also: &str| {
        let run = format!("ulimit {limit} && exec \"$0\" run --mode lockstep --duration 60ms -q --group \"$1\" {also}");
        let plain = case.command(&[]);
        let mut command = Command::new("sh");
        command.args(["-c", &run]).arg(plain.get_program()).arg(&case.group);
        command.envs(plain.get_envs().filter_map(|(key, value)| Some((key, value?))));
        case.start_command(command).wait()
    };
    for (limit, also) in
        [("-n 12", ""), ("-n 20", ""), ("-n 40", ""), ("-n 80", ""), ("-n 120", "--set controller.standby=6")]
    {
        let ended = with_limit(limit, also);
        assert_eq!(ended.code, Some(70), "{limit}: {ended:?}");
        assert!(ended.err.contains("open files") && ended.err.contains("ulimit -n"), "{limit}: {ended:?}");
        assert_eq!(ended.err.lines().count(), 1, "{limit}: {ended:?}");
        case.assert_nothing_left();
    }
    // As many as are asked for are enough, for the largest group too; and a soft limit is nobody's want.
    for (limit, also) in [("-n 92", ""), ("-n 128", "--set controller.standby=6"), ("-S -n 20", "")] {
        let ended = with_limit(limit, also);
        assert_eq!(ended.code, Some(0), "{limit}: {ended:?}");
        case.assert_nothing_left();
    }
}

#[test]
fn a_core_that_is_not_there_is_named_and_the_run_goes_on() {
    let case = Case::new("no-core");
    let ended = case.run("[loop]\nduration = \"100ms\"\n[realtime]\ncores = [0, 1023]\n", &[]).wait();
    assert!(ended.err.contains("core 1023") && ended.err.contains("caches"), "{ended:?}");
    assert_eq!(ended.json()["supervision"]["end"], "done");
    case.assert_nothing_left();
}

#[test]
fn without_proc_a_run_is_refused_with_the_remedy() {
    let case = Case::new("no-proc");
    let hidden = |lines: &str| {
        let lines = format!("mount -t tmpfs tmpfs /proc && {lines}");
        let plain = case.command(&[]);
        let mut command = Command::new("unshare");
        command.args(["-m", "-p", "-f", "sh", "-c", &lines]).arg(plain.get_program());
        command.envs(plain.get_envs().filter_map(|(key, value)| Some((key, value?))));
        command
    };
    if !hidden("true").output().is_ok_and(|probe| probe.status.success()) {
        not_tested("a host without proc", "only root with namespaces can hide it");
        return;
    }
    let ended = case.start_command(hidden("exec \"$0\" run --mode lockstep --duration 60ms -q")).wait();
    assert_eq!(ended.code, Some(70), "{ended:?}");
    assert!(ended.err.contains("mount -t proc"), "{ended:?}");
    case.assert_nothing_left();
}

#[test]
fn from_another_pid_namespace_a_running_group_is_unknown_and_not_dead() {
    let case = Case::new("other-pids");
    let mut running = case.run("[loop]\nduration = \"2s\"\n", &[]);
    running.wait_until_active();
    let plain = case.command(&["ps"]);
    let mut command = Command::new("unshare");
    command.args(["-p", "-f", "--mount-proc"]).arg(plain.get_program()).args(plain.get_args());
    command.envs(plain.get_envs().filter_map(|(key, value)| Some((key, value?))));
    let seen = case.start_command(command).wait();
    if seen.code == Some(0) {
        let line = seen.out.lines().find(|line| line.starts_with(&case.group) && line.contains("plant"));
        assert!(line.is_some_and(|line| line.contains("unknown")), "{seen:?}");
        assert!(!seen.out.contains("dead"), "{seen:?}");
    } else {
        not_tested("ps in another PID namespace", "only root can make one");
    }
    running.wait();
    case.assert_nothing_left();
}

#[test]
fn where_no_further_process_may_be_started_the_limit_is_named_and_nothing_is_left() {
    let case = Case::new("few-processes");
    // A user of its own, since the limit counts all of a user's processes, and root has none.
    let limited = |most: u32, arguments: &[&str]| {
        let plain = case.command(arguments);
        let mut command = Command::new("setpriv");
        command.args(["--reuid=65531", "--regid=65531", "--clear-groups", "prlimit", &format!("--nproc={most}")]);
        command.arg(plain.get_program()).args(plain.get_args()).current_dir("/");
        command.env_remove("LOOPBOUND_RUNTIME_DIR");
        command
    };
    if !limited(64, &["ps"]).output().is_ok_and(|probe| probe.status.success()) {
        not_tested("a limit on processes", "only root can become another user, who has to be able to run the program");
        return;
    }
    let run = |most| limited(most, &["run", "--mode", "lockstep", "--duration", "60ms", "-q", "--group", &case.group]);
    for most in 1..=12 {
        let ended = case.start_command(run(most)).wait();
        if ended.code != Some(0) {
            assert!(ended.code == Some(70) && most < 10, "{most}: {ended:?}");
            assert!(ended.err.contains("ulimit -u") && ended.err.contains("--pids-limit"), "{most}: {ended:?}");
            assert_eq!(ended.err.lines().count(), 1, "{most}: {ended:?}");
        }
        let left = limited(64, &["ps"]).output().expect("ps");
        assert_eq!(String::from_utf8_lossy(&left.stdout), "no group is running\n", "{most}");
    }
    // What needs no thread but its own does without.
    let examined = case.start_command(limited(1, &["doctor"])).wait();
    assert!(examined.code == Some(0) && examined.err.is_empty(), "{examined:?}");
}

/// What is refused before anything was started: one line, exit code 2, no group.
fn assert_refused_for_its_folder(case: &Case, command: Command, words: &str) {
    let ended = case.start_command(command).wait();
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.err.starts_with("loopbound: --out ") && ended.err.contains(words), "{words}: {ended:?}");
    assert_eq!((ended.err.lines().count(), ended.out.as_str()), (1, ""), "{ended:?}");
    case.assert_nothing_left();
}

#[test]
fn results_that_a_mount_or_a_users_rights_keep_from_being_written_are_refused_before_anything_starts() {
    let case = Case::new("no-write");
    let folder = case.work.path().join("out");
    std::fs::create_dir(&folder).expect("a folder");
    let out = folder.to_str().expect("a path in UTF-8");
    let commands = |out: &str| {
        let run = ["run", "--mode", "lockstep", "--duration", "60ms", "--group", &case.group, "--out"];
        [[&run[..], &[out]].concat(), vec!["study", "delay", "--quick", "--out", out]]
            .map(|arguments| case.command(&arguments))
    };
    let behind = |before: &[&str], plain: &Command| {
        let mut command = Command::new(before[0]);
        command.args(&before[1..]).arg(plain.get_program()).args(plain.get_args()).current_dir("/");
        command
    };
    let read_only = format!("mount --bind {out} {out} && mount -o remount,ro,bind {out} && exec \"$0\" \"$@\"");
    let before = ["unshare", "-m", "sh", "-c", &read_only];
    let user = ["setpriv", "--reuid=65531", "--regid=65531", "--clear-groups"];
    let possible =
        |before: &[&str]| behind(before, &case.command(&["ps"])).output().is_ok_and(|probe| probe.status.success());
    if !possible(&before) || !possible(&user) {
        not_tested("results that can't be written", "only root can mount and become another user");
        return;
    }
    let below = format!("{out}/a/b");
    for plain in commands(out).iter().chain(&commands(&below)) {
        assert_refused_for_its_folder(&case, behind(&before, plain), "Read-only file system");
        let mut command = behind(&user, plain);
        command.env_remove("LOOPBOUND_RUNTIME_DIR");
        assert_refused_for_its_folder(&case, command, "Permission denied");
    }
    assert!(std::fs::read_dir(&folder).expect("the folder").next().is_none(), "nothing was touched");
}

#[test]
fn limits_on_the_length_of_files_and_on_address_space_are_named() {
    let case = Case::new("few-bytes");
    let limited = |limit: &str, arguments: &[&str]| {
        let plain = case.command(arguments);
        let mut command = Command::new("prlimit");
        command.arg(limit).arg(plain.get_program()).args(plain.get_args()).current_dir(case.work.path());
        command.envs(plain.get_envs().filter_map(|(key, value)| Some((key, value?))));
        case.start_command(command)
    };
    let run = ["run", "--mode", "lockstep", "--duration", "60ms", "-q", "--group", &case.group];
    for (limit, remedy) in
        [("--fsize=100000", "ulimit -f"), ("--fsize=3000000", "ulimit -f"), ("--as=70000000", "ulimit -v")]
    {
        let ended = limited(limit, &run).wait();
        assert!(ended.code == Some(70) && ended.err.contains(remedy), "{limit}: {ended:?}");
        assert_eq!(ended.err.lines().count(), 1, "{limit}: {ended:?}");
        case.assert_nothing_left();
    }
}
