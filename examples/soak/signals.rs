//! Many short groups under random signals, and what was wrong with any of them.

use std::path::PathBuf;

use loopbound_shared::realtime::Signal;
use loopbound_shared::say;

use crate::barrage::{Plan, count};
use crate::remains::Place;

/// Runs the groups from number `first` on.
pub(crate) fn run(groups: u64, first: u64, seed: u64) -> anyhow::Result<u32> {
    let executable = std::env::current_exe()?;
    let (mut faults, mut outcomes) = (0, Vec::new());
    for number in first..first.saturating_add(groups) {
        let name = format!("soak-signals{number}-{}", std::process::id());
        let folder = PathBuf::from(format!("/dev/shm/loopbound-{name}"));
        let place = Place { group: name, folder, word: format!("{}.{number}", 1_000_000 + std::process::id()) };
        let work = tempfile::tempdir()?;
        let plan = Plan::draw(seed, number);
        let outcome = plan.run(&executable, &place, work.path())?;
        if !outcome.faults.is_empty() {
            faults += 1;
            say::out!(
                "  --seed {seed} --first {number} --signals 1: {:?}\n    {plan:?}\n    {outcome:?}",
                outcome.faults
            );
        }
        outcomes.push(outcome);
    }
    let hits = || outcomes.iter().flat_map(|outcome| &outcome.hits);
    let slowest_ns = outcomes.iter().map(|outcome| outcome.took_ns).max().unwrap_or(0);
    say::out!("groups under random signals: {groups} (seed {seed}, from {first}), signals sent {}", hits().count());
    say::out!("  to {:?}", count(hits().map(|hit| hit.role.as_str())));
    say::out!("  of {:?}", count(hits().map(|hit| word(hit.signal))));
    say::out!("  ends: {:?}", count(outcomes.iter().map(|outcome| outcome.exit.as_str())));
    let cleaned = outcomes.iter().filter(|outcome| outcome.cleaned).count();
    say::out!("  launcher and keeper both gone, the rest swept by `clean`: {cleaned}");
    say::out!("  the longest took {:.2} s; groups with faults: {faults}", slowest_ns as f64 * 1e-9);
    Ok(faults)
}

fn word(signal: Signal) -> String {
    format!("{signal:?}").replace("Signal::", "").replace('"', "")
}
