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
fn a_shared_memory_that_fills_up_under_a_run_ends_nobody_and_lets_nobody_in() {
    let case = Case::new("full-shm");
    let lines = "\
\"$LB\" run --duration 3s --group full --set controller.standby=1 --json >run.json 2>run.err & run=$!
while ! grep -q active /dev/shm/loopbound-*/full/processes.json 2>/dev/null; do sleep 0.05; done
dd if=/dev/zero of=/dev/shm/filler bs=4k 2>/dev/null
\"$LB\" monitor --group full --duration 100ms; echo monitor $?
\"$LB\" run --mode lockstep --duration 60ms --group second; echo second $?
wait $run; echo run $?";
    let Some(ended) = with_shared_memory(&case, 40_960, lines) else { return };
    assert!(ended.out.contains("monitor 70") && ended.out.contains("second 70"), "{ended:?}");
    assert_eq!(ended.err.matches("/dev/shm has no room").count(), 2, "{ended:?}");
    let text = std::fs::read_to_string(case.work.path().join("run.json")).expect("the document");
    let document: serde_json::Value = serde_json::from_str(&text).expect("one JSON document");
    assert_eq!(document["supervision"]["end"], "done", "{}", document["supervision"]);
    assert_eq!(document["supervision"]["deaths"].as_array().map(Vec::len), Some(0), "{}", document["supervision"]);
    assert_eq!(document["ended"], "last record");
}
