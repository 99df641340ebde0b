//! How late a periodic thread wakes here, beside what cyclictest says of the same machine, where that is installed.

use std::process::Command;

use loopbound_shared::clock::{now_ns, sleep_until_ns};
use loopbound_shared::realtime::set_priority;
use loopbound_shared::spawn;

use super::{Finding, Status};

/// Priority of both.
const PRIORITY: u32 = 80;
const PERIOD_NS: u64 = 1_000_000;
const WAKE_UPS: u32 = 500;
/// A mean above this says that something is amiss with the timer or the idle states.
const SLOW_NS: u64 = 100_000;

/// Least, mean and largest lateness of a wake-up, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lateness {
    /// The least.
    pub min_ns: u64,
    /// The mean.
    pub mean_ns: u64,
    /// The largest.
    pub max_ns: u64,
}

impl Lateness {
    /// Sleeps every millisecond, as the plant does before its deadline, for half a second, with `SCHED_FIFO` where that is
    /// granted.
    #[must_use]
    pub fn own() -> Self {
        spawn::thread("wake-up", Self::measure).ok().and_then(|thread| thread.join().ok()).unwrap_or_default()
    }

    fn measure() -> Self {
        // Without the privilege it is measured at the ordinary priority, as a run would be.
        let thread = u32::try_from(rustix::thread::gettid().as_raw_nonzero().get()).unwrap_or(0);
        let _ = set_priority(thread, PRIORITY);
        let (mut sum_ns, mut found) = (0, Self { min_ns: u64::MAX, ..Self::default() });
        let mut deadline_ns = now_ns() + PERIOD_NS;
        for _ in 0..WAKE_UPS {
            sleep_until_ns(deadline_ns);
            let late_ns = now_ns().saturating_sub(deadline_ns);
            sum_ns += late_ns;
            (found.min_ns, found.max_ns) = (found.min_ns.min(late_ns), found.max_ns.max(late_ns));
            deadline_ns = (deadline_ns + PERIOD_NS).max(now_ns());
        }
        Self { mean_ns: sum_ns / u64::from(WAKE_UPS), ..found }
    }

    /// The same by cyclictest; none where it is not installed or may not run.
    #[must_use]
    pub fn by_cyclictest() -> Option<Self> {
        let (priority, interval, loops) = (PRIORITY.to_string(), (PERIOD_NS / 1000).to_string(), WAKE_UPS.to_string());
        let arguments = ["--quiet", "--priority", &priority, "--interval", &interval, "--loops", &loops];
        let output =
            Command::new("cyclictest").args(arguments).output().ok().filter(|output| output.status.success())?;
        Self::parse(&String::from_utf8_lossy(&output.stdout))
    }

    /// Reads `T: 0 ( 4711) P:80 I:1000 C: 500 Min: 7 Act: 12 Avg: 11 Max: 40`, in µs.
    fn parse(text: &str) -> Option<Self> {
        let line = text.lines().rfind(|line| line.starts_with("T:"))?;
        let figure = |name: &str| {
            let (_, after) = line.split_once(name)?;
            Some(after.split_whitespace().next()?.parse::<u64>().ok()? * 1000)
        };
        Some(Self { min_ns: figure("Min:")?, mean_ns: figure("Avg:")?, max_ns: figure("Max:")? })
    }

    fn text(self) -> String {
        let Self { min_ns, mean_ns, max_ns } = self;
        format!("{} / {} / {} us", min_ns / 1000, mean_ns / 1000, max_ns / 1000)
    }
}

pub(super) fn finding(own: Lateness, cyclictest: Option<Lateness>) -> Finding {
    let beside = cyclictest.map_or_else(
        || "cyclictest is not installed or may not run (package rt-tests)".to_owned(),
        |found| format!("cyclictest right after: {}", found.text()),
    );
    let found = format!(
        "a thread that sleeps every millisecond wakes {} late (least, mean, largest of {WAKE_UPS}); {beside}",
        own.text()
    );
    if own.mean_ns <= SLOW_NS {
        return Finding::good("wake-up", found);
    }
    let cost = "every wake-up that is not spun for is late by that much: the floor of a run";
    Finding::new("wake-up", Status::Warn, found, cost, "hold /dev/cpu_dma_latency at 0; look at the other findings")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_line_of_cyclictest_is_read_and_nothing_else() {
        let text = "# /dev/cpu_dma_latency set to 0us\nT: 0 ( 4711) P:80 I:1000 C:    500 Min:      7 Act:   12 Avg:   11 Max:      40\n";
        let found = Lateness { min_ns: 7_000, mean_ns: 11_000, max_ns: 40_000 };
        assert_eq!(Lateness::parse(text), Some(found));
        for broken in ["", "T: 0 Min: x Avg: 1 Max: 2", "Min: 1 Avg: 2 Max: 3"] {
            assert_eq!(Lateness::parse(broken), None, "{broken}");
        }
        let finding = finding(found, Some(found));
        assert!(finding.status == Status::Good && finding.found.contains("cyclictest right after: 7 / 11 / 40 us"));
    }

    #[test]
    fn the_own_measurement_is_in_order() {
        let found = Lateness::own();
        assert!(found.min_ns <= found.mean_ns && found.mean_ns <= found.max_ns && found.max_ns > 0, "{found:?}");
    }
}
