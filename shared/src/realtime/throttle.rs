//! What share of a core the kernel leaves to real-time threads.

use std::path::Path;

/// The share of a core that a real-time loop may use at most.
///
/// The kernel keeps some 5 % for other threads, by throttling or by a fair server, and takes them as one block of 50 ms
/// a second when a loop leaves less. A loop below 90 % leaves room for both, and for the interrupts.
pub const DUTY_MAX: f64 = 0.9;

/// The kernel's settings against real-time threads that never sleep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Throttle {
    /// The share that throttling leaves, 0..=1; 1 if it is off; none if unknown.
    pub share: Option<f64>,
    /// The share that the fair server of the first core reserves for others; none if unknown or absent.
    pub fair_server_share: Option<f64>,
}

impl Throttle {
    /// Reads the settings below `root`, which is `/` but in tests.
    #[must_use]
    pub fn read(root: &Path) -> Self {
        let number = |path: &str| std::fs::read_to_string(root.join(path)).ok()?.trim().parse::<f64>().ok();
        let share_of = |runtime: &str, period: &str| Some(number(runtime)? / number(period)?);
        let share = share_of("proc/sys/kernel/sched_rt_runtime_us", "proc/sys/kernel/sched_rt_period_us");
        let server = "sys/kernel/debug/sched/fair_server/cpu0";
        Self {
            // A negative runtime turns throttling off.
            share: share.map(|share| if share < 0.0 { 1.0 } else { share.min(1.0) }),
            fair_server_share: share_of(&format!("{server}/runtime"), &format!("{server}/period")),
        }
    }

    /// The share of a core that a real-time loop may plan with: [`DUTY_MAX`], or less where the kernel leaves less.
    ///
    /// A fair server that can't be read is taken to be there with its default of 5 %.
    #[must_use]
    pub fn duty_max(&self) -> f64 {
        let left = self.share.unwrap_or(0.95).min(1.0 - self.fair_server_share.unwrap_or(0.05));
        // The margin that DUTY_MAX keeps from the defaults.
        (left - 0.05).clamp(0.0, DUTY_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(files: &[(&str, &str)]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = root.path().join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        root
    }

    const RUNTIME: &str = "proc/sys/kernel/sched_rt_runtime_us";
    const PERIOD: &str = "proc/sys/kernel/sched_rt_period_us";

    #[test]
    fn the_defaults_of_the_kernel_leave_ninety_per_cent() {
        let root = tree(&[(RUNTIME, "950000\n"), (PERIOD, "1000000\n")]);
        let throttle = Throttle::read(root.path());
        assert!((throttle.duty_max() - DUTY_MAX).abs() < 1e-12, "{throttle:?}");
    }

    #[test]
    fn a_stricter_kernel_leaves_less_and_an_unlimited_one_no_more() {
        let strict = Throttle::read(tree(&[(RUNTIME, "500000"), (PERIOD, "1000000")]).path());
        assert!((strict.duty_max() - 0.45).abs() < 1e-12, "{strict:?}");
        let off = Throttle::read(tree(&[(RUNTIME, "-1"), (PERIOD, "1000000")]).path());
        assert!(off.share.is_some_and(|share| (share - 1.0).abs() < 1e-12));
        assert!((off.duty_max() - DUTY_MAX).abs() < 1e-12, "{off:?}");
    }

    #[test]
    fn an_unreadable_proc_is_unknown_and_garbage_is_not_a_number() {
        let empty = Throttle::read(tree(&[]).path());
        assert_eq!(empty, Throttle { share: None, fair_server_share: None });
        let garbage = Throttle::read(tree(&[(RUNTIME, "x"), (PERIOD, "0")]).path());
        assert_eq!(garbage.share, None);
        assert!((0.0..=DUTY_MAX).contains(&garbage.duty_max()));
    }
}
