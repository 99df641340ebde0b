//! The only module that reads clocks or sleeps; clippy bans the standard library's ways to do so elsewhere.
//!
//! All stamps of a group are nanoseconds of `CLOCK_MONOTONIC`, which every process of one machine shares, so stamps of
//! different processes may be subtracted. Wall time serves reports only and never enters a computation.

use rustix::thread::{NanosleepRelativeResult, nanosleep};
use rustix::time::{ClockId, Timespec, clock_gettime};

/// Nanoseconds in a second.
pub const NS_PER_S: u64 = 1_000_000_000;

/// Nanoseconds as seconds, for the mathematics. Exact below 104 days; the same division on every machine.
#[inline]
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "2^53 ns are 104 days")]
pub const fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}

/// Nanoseconds of `CLOCK_MONOTONIC`.
///
/// On Linux this is a read of the vdso (some 50 ns on a 2-core KVM guest, by tsc), not a system call: it may stand in a
/// spin loop.
#[inline]
#[must_use]
pub fn now_ns() -> u64 {
    to_ns(clock_gettime(ClockId::Monotonic))
}

/// Sleeps until `CLOCK_MONOTONIC` has reached `deadline_ns`, and returns at once when it already has.
///
/// The kernel gets the absolute deadline, so a preemption between the decision to sleep and the sleep itself adds no
/// error; a signal handler that interrupts the sleep doesn't end it.
pub fn sleep_until_ns(deadline_ns: u64) {
    while now_ns() < deadline_ns {
        sleep_once(deadline_ns);
    }
}

/// Like [`sleep_until_ns`], but a signal ends the sleep early: for loops that look at a stop flag.
///
/// Returns whether the deadline has been reached.
#[must_use]
pub fn sleep_until_ns_or_signal(deadline_ns: u64) -> bool {
    if now_ns() < deadline_ns {
        sleep_once(deadline_ns);
    }
    now_ns() >= deadline_ns
}

/// Sleeps for `duration_ns` from now.
pub fn sleep_ns(duration_ns: u64) {
    sleep_until_ns(now_ns().saturating_add(duration_ns));
}

/// How long before its deadline [`wait_until_ns`] begins to spin: longer than a sleep ends late, without real-time priority too.
pub const SPIN_LAST_NS: u64 = 200_000;

/// Waits until `CLOCK_MONOTONIC` has reached `deadline_ns`, and not a timer's lateness longer: sleeps while that is far, and
/// spins the last stretch. For injected times, which have to be as long as they were asked to be.
pub fn wait_until_ns(deadline_ns: u64) {
    sleep_until_ns(deadline_ns.saturating_sub(SPIN_LAST_NS));
    spin_until_ns(deadline_ns);
}

/// Spins until `CLOCK_MONOTONIC` has reached `deadline_ns`; returns the stamp that ended the spin.
#[inline]
pub fn spin_until_ns(deadline_ns: u64) -> u64 {
    loop {
        let now = now_ns();
        if now >= deadline_ns {
            return now;
        }
        spin_hint();
    }
}

/// Tells the processor that this is a spin loop, so that it saves power and leaves the core to a sibling thread.
#[inline(always)]
pub fn spin_hint() {
    core::hint::spin_loop();
}

/// The wall time now in UTC as RFC 3339 with milliseconds, such as `2026-01-31T12:00:00.250Z`.
#[must_use]
pub fn wall_time() -> String {
    rfc3339(clock_gettime(ClockId::Realtime))
}

/// Nanoseconds since the epoch of 1970 by the wall clock, for file formats that want them.
#[must_use]
pub fn wall_time_ns() -> u64 {
    to_ns(clock_gettime(ClockId::Realtime))
}

/// The period of the kernel's tick, whose interrupts fall on its whole multiples by [`now_ns`]; none where unknown.
///
/// The coarse clock advances once a tick, so its resolution is the tick's period (4 ms for `CONFIG_HZ=250`).
#[must_use]
pub fn kernel_tick_ns() -> Option<u64> {
    #[cfg(any(target_os = "linux", target_os = "android"))]
    return Some(to_ns(rustix::time::clock_getres(ClockId::MonotonicCoarse))).filter(|&tick_ns| tick_ns > 1);
    #[cfg(not(any(target_os = "linux", target_os = "android")))]
    return None;
}

#[inline]
fn to_ns(time: Timespec) -> u64 {
    // A monotonic clock starts at zero and the wall clock stands after 1970, so neither part is negative.
    time.tv_sec.unsigned_abs().wrapping_mul(NS_PER_S).wrapping_add(time.tv_nsec.unsigned_abs())
}

/// `ns` as the kernel takes it.
pub(crate) fn timespec(ns: u64) -> Timespec {
    let seconds = i64::try_from(ns / NS_PER_S).unwrap_or(i64::MAX);
    Timespec { tv_sec: seconds, tv_nsec: i32::try_from(ns % NS_PER_S).unwrap_or(0).into() }
}

/// Sleeps once towards the deadline; the callers look at the clock again, so an early return is harmless.
#[cfg(not(any(target_vendor = "apple", target_os = "openbsd", target_os = "dragonfly")))]
fn sleep_once(deadline_ns: u64) {
    let outcome = rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &timespec(deadline_ns));
    if matches!(outcome, Err(error) if error != rustix::io::Errno::INTR) {
        // A sandbox may forbid the absolute sleep; a relative one still keeps the caller from burning its core.
        relative_sleep_once(deadline_ns);
    }
}

/// Sleeps once towards the deadline, on systems that have no absolute sleep.
#[cfg(any(target_vendor = "apple", target_os = "openbsd", target_os = "dragonfly"))]
fn sleep_once(deadline_ns: u64) {
    relative_sleep_once(deadline_ns);
}

fn relative_sleep_once(deadline_ns: u64) {
    match nanosleep(&timespec(deadline_ns.saturating_sub(now_ns()))) {
        // The callers' loops measure what remains.
        NanosleepRelativeResult::Ok | NanosleepRelativeResult::Interrupted(_) | NanosleepRelativeResult::Err(_) => {}
    }
}

fn rfc3339(time: Timespec) -> String {
    let days = time.tv_sec.div_euclid(86_400);
    let second_of_day = time.tv_sec.rem_euclid(86_400);
    let (year, month, day) = civil_from_days(days);
    let (hour, minute, second) = (second_of_day / 3600, second_of_day / 60 % 60, second_of_day % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{:03}Z", time.tv_nsec / 1_000_000)
}

/// The Gregorian date of a count of days since 1970-01-01.
///
/// Eras of 400 years (146,097 days) that begin on 1 March put the leap day last, so that months follow from one
/// linear formula (Howard Hinnant, "chrono-compatible low-level date algorithms", `civil_from_days`).
fn civil_from_days(days: i64) -> (i64, i64, i64) {
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    (year_of_era + era * 400 + i64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sleep_never_ends_before_its_deadline() {
        for duration_ns in [0, 1, 50_000, 2_000_000] {
            let deadline_ns = now_ns() + duration_ns;
            sleep_until_ns(deadline_ns);
            assert!(now_ns() >= deadline_ns);
        }
    }

    #[test]
    fn a_deadline_in_the_past_returns_and_a_spin_reports_the_stamp_that_ended_it() {
        sleep_until_ns(0);
        assert!(sleep_until_ns_or_signal(0));
        let deadline_ns = now_ns() + 20_000;
        let ended_ns = spin_until_ns(deadline_ns);
        assert!(ended_ns >= deadline_ns && ended_ns <= now_ns());
    }

    #[test]
    fn a_precise_wait_never_ends_early_and_is_as_a_rule_less_late_than_a_sleep() {
        let lateness = |duration_ns: u64, wait: fn(u64)| {
            let mut late: Vec<u64> = (0..101)
                .map(|_| {
                    let deadline_ns = now_ns() + duration_ns;
                    wait(deadline_ns);
                    now_ns().checked_sub(deadline_ns).expect("it ended early")
                })
                .collect();
            late.sort_unstable();
            late[50]
        };
        for duration_ns in [3_000, 20_000, 300_000] {
            let (precise, slept) = (lateness(duration_ns, wait_until_ns), lateness(duration_ns, sleep_until_ns));
            assert!(precise < slept, "{duration_ns} ns: {precise} ns late, a sleep {slept}");
        }
    }

    #[test]
    fn the_clock_never_runs_backwards() {
        let mut before = now_ns();
        for _ in 0..10_000 {
            let now = now_ns();
            assert!(now >= before);
            before = now;
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn the_tick_of_the_kernel_is_one_that_kernels_are_built_with() {
        let tick_ns = kernel_tick_ns().unwrap();
        // CONFIG_HZ is between 24 (alpha's simulators) and 1200, and the stored period is rounded.
        assert!((800_000..=42_000_000).contains(&tick_ns), "{tick_ns}");
    }

    #[test]
    fn dates_match_those_of_the_calendar() {
        let at = |seconds, nanoseconds| rfc3339(Timespec { tv_sec: seconds, tv_nsec: nanoseconds });
        assert_eq!(at(0, 0), "1970-01-01T00:00:00.000Z");
        assert_eq!(at(951_782_400, 999_999_999), "2000-02-29T00:00:00.999Z");
        assert_eq!(at(1_709_251_199, 0), "2024-02-29T23:59:59.000Z");
        assert_eq!(at(4_107_542_400, 0), "2100-03-01T00:00:00.000Z");
        assert_eq!(at(-1, 0), "1969-12-31T23:59:59.000Z");
    }
}
