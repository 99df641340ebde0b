//! Who comes to a running group and dies there leaves room for the next, and whoever asks for a swap and leaves, too.

use rustix::process::Signal;
use serde_json::Value;

use crate::harness::{Case, Running, wait_until};

const LONG: &str = "[loop]\nduration = \"120s\"\n";

/// A monitor that is in the group and judges: it has all of a monitor's ports by then.
fn attached(case: &Case, name: &str) -> Running {
    let mut monitor = case.start(&["monitor", "--group", &case.group, "--json", "--out", name]);
    let samples = case.work.path().join(name).join("samples.csv");
    wait_until("the monitor is in the group", || {
        assert!(monitor.runs() || samples.exists(), "it did not get in: {}", monitor.said());
        samples.exists()
    });
    monitor
}

fn swapped(case: &Case, arguments: &[&str]) -> (Option<i32>, Value) {
    let ended = case.output(&[&["swap", "--group", &case.group, "--json"], arguments].concat());
    (ended.code, serde_json::from_str(&ended.out).unwrap_or(Value::Null))
}

/// A swap that was carried out: on a busy machine it may have been rolled back since.
fn assert_carried_out(case: &Case) {
    let (code, report) = swapped(case, &["--law", "robust-ff", "--force"]);
    let outcome = (code, report["result"].as_str());
    assert!([(Some(0), Some("done")), (Some(4), Some("rolled back"))].contains(&outcome), "{report}");
}

fn end(running: Running, case: &Case) {
    running.signal(Signal::INT);
    assert_eq!(running.wait().code, Some(130));
    case.output(&["clean"]);
    case.assert_nothing_left();
}

#[test]
fn forty_monitors_that_were_killed_one_after_the_other_and_twelve_at_once_lock_nobody_out() {
    let case = Case::apart("killed-guests");
    let mut running = case.run(LONG, &[]);
    running.wait_until_active();
    for number in 0..40 {
        let monitor = attached(&case, &format!("seen-{number}"));
        monitor.signal(Signal::KILL);
        assert_eq!(monitor.wait().code, None, "it was killed");
    }
    // As many as there is room for, and all of them gone at once.
    let together: Vec<Running> = (0..12).map(|number| attached(&case, &format!("at-once-{number}"))).collect();
    together.iter().for_each(|monitor| monitor.signal(Signal::KILL));
    // Nobody has reaped them yet.
    let next = case.output(&["monitor", "--group", &case.group, "--json", "--duration", "100ms"]);
    assert_eq!(next.json_with(0)["ended"], "duration");
    assert_carried_out(&case);
    drop(together);
    end(running, &case);
}

#[test]
fn a_swap_that_the_run_leaves_no_time_for_is_refused_and_blocks_no_other() {
    let case = Case::apart("swap-late");
    let mut running = case.run(LONG, &[]);
    running.wait_until_active();
    wait_until("the run is past its fifth tick", || {
        swapped(&case, &["--law", "ctc", "--at-tick", "1"]).1["tick"].as_u64() > Some(5)
    });
    for (arguments, reason) in [
        (&["--law", "ctc", "--at-tick", "99999999"][..], "the run ends before that"),
        (&["--law", "ctc", "--at-tick", "120000"], "the run ends before that"),
        (&["--law", "ctc", "--blend", "200s"], "the run ends before that"),
        (&["--law", "ctc", "--at-tick", "119999", "--blend", "20ms"], "the run ends before that"),
        (&["--law", "ctc", "--at-tick", "3"], "the tick named has passed"),
    ] {
        let (code, report) = swapped(&case, arguments);
        assert_eq!((code, report["result"].as_str()), (Some(4), Some("refused")), "{arguments:?}: {report}");
        assert_eq!(report["reason"].as_str(), Some(reason), "{arguments:?}: {report}");
        assert!(report["limit"].is_number() && report["value"].is_number(), "{report}");
    }
    assert_carried_out(&case);
    end(running, &case);
}

#[test]
fn a_swap_that_waits_is_forgotten_when_its_client_leaves_and_its_candidate_goes() {
    let case = Case::apart("swap-left");
    let mut running = case.run(LONG, &[]);
    running.wait_until_active();
    for (signal, candidate) in [(Signal::INT, 2), (Signal::KILL, 3)] {
        let client = case.start(&["swap", "--group", &case.group, "--law", "ctc", "--at-tick", "119000"]);
        running.process("controller", candidate, &["standby", "silent", "late"]);
        let (code, busy) = swapped(&case, &["--law", "ctc"]);
        assert_eq!((code, busy["reason"].as_str()), (Some(4), Some("another swap is under way")), "{busy}");
        client.signal(signal);
        client.wait();
        wait_until("the candidate has gone", || {
            !running.roster().iter().any(|p| p["role"] == "controller" && p["id"] == candidate)
        });
    }
    assert_carried_out(&case);
    end(running, &case);
}

#[test]
fn a_run_says_which_of_its_swaps_and_faults_it_will_not_live_to_see() {
    let case = Case::apart("in-vain");
    let scenario = "[loop]\nmode = \"lockstep\"\nduration = \"100ms\"\n[[swap]]\nat = \"20s\"\nlaw = \"ctc\"\n\
                    [[fault]]\nkind = \"drop\"\nat = 100\n";
    let ended = case.run(scenario, &[]).wait();
    for line in ["swap[0].at = 20s: the run ends before that, after 100ms", "fault[0].at = 100: the run ends"] {
        assert!(ended.err.contains(line), "{}", ended.err);
    }
    case.assert_nothing_left();
}
