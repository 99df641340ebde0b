//! The CPU time that the processes of a group take, from the scheduler's own counts in `/proc`.
//!
//! Read after the start of a run and before its end, so that starting, ending and writing files don't count.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use loopbound_shared::clock;

use crate::supervise::Roster;

/// CPU time of each process so far, ns, by role and id.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reading {
    at_ns: u64,
    taken_ns: BTreeMap<(String, u32), u64>,
}

impl Reading {
    /// Reads it for everyone in `roster`; who has ended is left out.
    #[must_use]
    pub fn take(roster: &Roster) -> Self {
        let of = |process: &crate::supervise::Entry| {
            let key = (process.role.clone(), process.id);
            Some((key, process_ns(Path::new("/proc"), process.pid)?))
        };
        Self { at_ns: clock::now_ns(), taken_ns: roster.processes.iter().filter_map(of).collect() }
    }
}

impl Reading {
    /// Whether everybody in `roster` was read.
    #[must_use]
    pub fn is_of_all(&self, roster: &Roster) -> bool {
        self.taken_ns.len() == roster.processes.len()
    }

    /// Whether everybody that `first` knows was read again; who has ended meanwhile would count as idle.
    #[must_use]
    pub fn has_all_of(&self, first: &Self) -> bool {
        first.taken_ns.keys().all(|key| self.taken_ns.contains_key(key))
    }
}

/// The time that all threads of a process have run, ns; none if it has ended or the kernel does not say.
fn process_ns(proc: &Path, pid: u32) -> Option<u64> {
    let threads = fs::read_dir(proc.join(pid.to_string()).join("task")).ok()?;
    let run_ns = |thread: fs::DirEntry| {
        // Time on a core, time in the queue, number of turns.
        let text = fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<u64>().ok()
    };
    let times: Vec<u64> = threads.flatten().filter_map(run_ns).collect();
    (!times.is_empty()).then(|| times.iter().sum())
}

/// CPU time over a time, summed over runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CpuUse {
    over_ns: u64,
    by_role_ns: BTreeMap<String, u64>,
}

impl CpuUse {
    /// What was taken between two readings; nothing where one of them is missing.
    #[must_use]
    pub fn between(first: Option<&Reading>, last: Option<&Reading>) -> Self {
        let (Some(first), Some(last)) = (first, last) else { return Self::default() };
        let mut by_role_ns = BTreeMap::new();
        for (key, then_ns) in &first.taken_ns {
            if let Some(now_ns) = last.taken_ns.get(key) {
                *by_role_ns.entry(key.0.clone()).or_insert(0) += now_ns.saturating_sub(*then_ns);
            }
        }
        Self { over_ns: last.at_ns.saturating_sub(first.at_ns), by_role_ns }
    }

    /// Adds another run.
    pub fn add(&mut self, other: &Self) {
        self.over_ns += other.over_ns;
        for (role, ns) in &other.by_role_ns {
            *self.by_role_ns.entry(role.clone()).or_insert(0) += ns;
        }
    }

    /// All processes together, of one core; none where nothing was read.
    #[must_use]
    pub fn share(&self) -> Option<f64> {
        let taken_ns: u64 = self.by_role_ns.values().sum();
        (self.over_ns > 0 && taken_ns > 0).then(|| taken_ns as f64 / self.over_ns as f64)
    }

    /// Each role, of one core.
    #[must_use]
    pub fn by_role(&self) -> BTreeMap<String, f64> {
        let share = |ns: &u64| *ns as f64 / self.over_ns.max(1) as f64;
        self.by_role_ns.iter().map(|(role, ns)| (role.clone(), share(ns))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::supervise::Entry;

    #[test]
    fn a_process_that_spins_takes_about_what_the_clock_says_and_one_that_is_gone_counts_nothing() {
        let entry = |role: &str, pid| Entry { role: role.into(), id: 1, pid, state: "ready".into(), restarts: 0 };
        let processes = vec![entry("plant", std::process::id()), entry("controller", u32::MAX)];
        let roster = Roster { group: "g".into(), pid_namespace: None, processes };
        let first = Reading::take(&roster);
        assert!(!first.is_of_all(&roster), "one of them is gone");
        clock::spin_until_ns(clock::now_ns() + 50_000_000);
        let last = Reading::take(&roster);
        let taken = CpuUse::between(Some(&first), Some(&last));
        assert!(last.has_all_of(&first) && !Reading::default().has_all_of(&first));
        assert_eq!(taken.by_role().keys().collect::<Vec<_>>(), ["plant"]);
        // The other tests run in threads of the same process, so only the least is sure: not even that on a busy core.
        assert!(taken.share().unwrap() > 0.0);
    }

    #[test]
    fn runs_add_up_by_time_and_not_by_the_mean_of_their_shares() {
        let over = |over_ns, ns| CpuUse { over_ns, by_role_ns: BTreeMap::from([("plant".to_owned(), ns)]) };
        let mut all = over(1_000, 1_000);
        all.add(&over(3_000, 1_000));
        assert_eq!((all.share(), all.by_role()["plant"].to_bits()), (Some(0.5), 0.5f64.to_bits()));
        assert_eq!(CpuUse::between(None, None).share(), None);
    }
}
