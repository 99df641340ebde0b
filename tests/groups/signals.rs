//! Random signals to random processes, also in the first 40 ms of a group and to all at once: a short form of
//! `cargo run --release --example soak -- --signals 500`, by the same code.

use std::path::Path;

use crate::barrage::{Plan, count};
use crate::harness::Case;
use crate::remains::Place;

const SEED: u64 = 13;
const GROUPS: u64 = 8;

#[test]
fn random_signals_end_every_run_in_bounded_time_with_a_documented_code_and_leave_nothing() {
    let mut hits = Vec::new();
    for number in 0..GROUPS {
        let case = Case::apart(&format!("signals-{number}"));
        let word = format!("{}.{number}", 2_000_000 + std::process::id());
        let place = Place { group: case.group.clone(), folder: case.runtime_folder().to_owned(), word };
        let plan = Plan::draw(SEED, number);
        let executable = Path::new(env!("CARGO_BIN_EXE_loopbound"));
        let outcome = plan.run(executable, &place, case.work.path()).expect("the group is started");
        assert!(outcome.faults.is_empty(), "seed {SEED}, number {number}: {plan:?}\n{outcome:?}");
        case.assert_nothing_left();
        hits.extend(outcome.hits);
    }
    let roles = count(hits.iter().map(|hit| hit.role.as_str()));
    // Who is there at an instant is the machine's affair; on one that is idle all roles are reached.
    assert!(roles.contains_key("launcher") && roles.len() >= 3, "who was reached: {roles:?}");
}
