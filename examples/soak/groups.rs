//! Many short groups; in each somebody is killed at a random moment, the launcher too.

use std::collections::BTreeMap;

use loopbound_model::rng::{Stream, uniform};
use loopbound_shared::clock;
use loopbound_shared::group::Group;
use loopbound_shared::say;

use crate::live::{Live, kill};

/// Length of a group's run.
const RUN_NS: u64 = 800_000_000;
/// A group that takes longer than its run by this hangs.
const HANG_NS: u64 = 2_000_000_000;
const SETTINGS: [&str; 3] = ["loop.duration=800ms", "controller.standby=1", "supervisor.back_off=20ms"];

pub(crate) fn run(count: u32, seed: u64) -> anyhow::Result<u32> {
    let (mut faults, mut slowest_ns, mut left_to_next) = (0, 0, 0);
    let mut victims: BTreeMap<String, u32> = BTreeMap::new();
    for number in 0..u64::from(count) {
        let mut live = Live::start(&format!("group{number}"), &SETTINGS)?;
        let from_ns = clock::now_ns();
        let (when, whom) = (uniform(seed, Stream::Fault, number, 0), uniform(seed, Stream::Fault, number, 1));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of the run, from 0 to 1")]
        clock::sleep_ns((when * RUN_NS as f64) as u64);
        let roster = live.roster();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index below the length")]
        let index = (whom * roster.processes.len() as f64) as usize;
        if let Some(victim) = roster.processes.get(index) {
            kill(victim.pid);
            *victims.entry(victim.role.clone()).or_default() += 1;
        }
        let left_ns = (from_ns + RUN_NS).saturating_sub(clock::now_ns());
        match live.wait_end(left_ns + HANG_NS)? {
            Some(_) => slowest_ns = slowest_ns.max(clock::now_ns().saturating_sub(from_ns + RUN_NS)),
            None => {
                faults += 1;
                say::out!("  {} hangs after a kill of {:?}", live.name, roster.processes.get(index));
            }
        }
        let mut left = live.left_behind(HANG_NS);
        if !left.is_empty() && roster.processes.get(index).is_some_and(|p| p.pid == live.launcher_pid()) {
            // Without a launcher the last member to leave sweeps, unless it was killed too: then the next group does.
            left_to_next += 1;
            drop(Group::create(&live.name)?);
            left = live.left_behind(HANG_NS);
        }
        if !left.is_empty() {
            faults += 1;
            say::out!("  {} left {left:?} after a kill of {:?}", live.name, roster.processes.get(index));
        }
    }
    say::out!("groups: {count}, one kill each: {victims:?}");
    say::out!("  left for the next group of the name to sweep, the launcher being dead: {left_to_next}");
    say::out!("  ended at most {:.2} s after their time; faults: {faults}", slowest_ns as f64 * 1e-9);
    Ok(faults)
}
