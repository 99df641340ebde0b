//! Findings on how the kernel is built and set: preemption, tick, throttling, isolation, huge pages.

use loopbound_shared::realtime::{DUTY_MAX, Throttle};

use super::live::Live;
use super::tree::{Tree, chosen};
use super::{Finding, Status};

pub(super) fn throttling(tree: &Tree) -> Finding {
    let key = "rt_throttling";
    let throttle = Throttle::read(tree.root());
    let percent = |share: f64| format!("{:.0} %", share * 100.0);
    let server = throttle.fair_server_share.map_or_else(
        || "the fair server is not visible (its default reserves 5 %)".to_owned(),
        |share| format!("the fair server reserves {}", percent(share)),
    );
    let cost = "at 100 % duty under SCHED_FIFO a loop loses 50 ms in every second (seen on a 2-core KVM guest); \
                below 90 % it loses nothing";
    let Some(share) = throttle.share else {
        return Finding::unknown(key, format!("limits of real-time threads not readable; {server}"), cost);
    };
    let found = format!("real-time threads may use {} of a core; {server}", percent(share));
    if throttle.duty_max() < DUTY_MAX - 1e-9 {
        Finding::new(key, Status::Warn, found, cost, "sudo sysctl kernel.sched_rt_runtime_us=950000")
    } else {
        Finding::good(key, format!("{found}; loops keep below {}", percent(DUTY_MAX)))
    }
}

pub(super) fn preemption(tree: &Tree) -> Finding {
    let key = "preemption";
    let version = tree.line("proc/version").unwrap_or_default();
    let config = tree.kernel_config().unwrap_or_default();
    let has = |option: &str| config.lines().any(|line| line.strip_prefix(option) == Some("=y"));
    if tree.line("sys/kernel/realtime").as_deref() == Some("1") || version.contains("PREEMPT_RT") {
        return Finding::good(key, "PREEMPT_RT");
    }
    let debug = tree.line("sys/kernel/debug/sched/preempt");
    let in_force = debug.as_deref().and_then(|choice| chosen(choice, '(', ')')).map(str::to_owned);
    let built_in = [
        ("CONFIG_PREEMPT_NONE", "none"),
        ("CONFIG_PREEMPT_VOLUNTARY", "voluntary"),
        ("CONFIG_PREEMPT_LAZY", "lazy"),
        ("CONFIG_PREEMPT", "full"),
    ];
    let default = built_in.iter().find(|(option, _)| has(option)).map(|(_, model)| (*model).to_owned());
    let dynamic = version.contains("PREEMPT_DYNAMIC") || has("CONFIG_PREEMPT_DYNAMIC");
    let cost = "a long system call or soft interrupt of another process delays the wake-up of the loop, by up to \
                milliseconds; only PREEMPT_RT bounds it";
    let model = in_force.or_else(|| tree.boot_option("preempt")).or(default);
    let how = if dynamic { "PREEMPT_DYNAMIC, can be chosen at boot" } else { "fixed when the kernel was built" };
    match model {
        Some(model) if model == "full" => Finding::new(
            key,
            Status::Warn,
            format!("full, but not PREEMPT_RT ({how})"),
            "interrupts and sections that hold a spin lock still delay the loop",
            "sudo apt install linux-image-rt-amd64  # Debian; elsewhere: its PREEMPT_RT kernel",
        ),
        Some(model) => {
            let mend = if dynamic {
                "boot with preempt=full on the kernel's command line, or use a PREEMPT_RT kernel"
            } else {
                "use a kernel with PREEMPT_DYNAMIC or PREEMPT_RT"
            };
            Finding::new(key, Status::Warn, format!("{model} ({how})"), cost, mend)
        }
        None => Finding::unknown(key, "the preemption model is not visible", cost),
    }
}

pub(super) fn isolated_cores(tree: &Tree) -> Finding {
    let key = "isolated_cores";
    let isolated = tree.line("sys/devices/system/cpu/isolated");
    let no_tick = tree.line("sys/devices/system/cpu/nohz_full").filter(|list| list != "(null)");
    match (isolated, no_tick) {
        (Some(isolated), Some(no_tick)) => {
            Finding::good(key, format!("isolated: {isolated}; without tick: {no_tick}; name them in realtime.cores"))
        }
        (Some(isolated), None) => Finding::good(key, format!("isolated: {isolated}; all cores tick")),
        (None, _) => Finding::new(
            key,
            Status::Warn,
            "none",
            "kernel threads and other processes share the loop's core; each visit cools its caches or delays it",
            "boot with isolcpus=N nohz_full=N (N: the loop's cores; leave one for the rest)",
        ),
    }
}

pub(super) fn tick(tree: &Tree, live: &Live) -> Finding {
    let key = "kernel_tick";
    let cost = "a deadline that falls on the tick waits for it: 10 to 40 us on a 2-core KVM guest, where a phase of \
                100 us took the 90th percentile of the lateness from 22 to 0.08 us";
    let Some(tick_ns) = live.tick_ns.filter(|&tick_ns| tick_ns > 0) else {
        return Finding::unknown(key, "the period of the kernel's tick is not visible", cost);
    };
    // Kernels round the period to the timer's resolution, so the rate is rounded back.
    let rate_hz = (1_000_000_000 + tick_ns / 2) / tick_ns;
    let found = format!("{rate_hz} Hz, on whole multiples of {} us", tick_ns / 1000);
    if tree.boot_option("skew_tick").as_deref() == Some("1") {
        let found = format!("{found}, skewed from core to core (skew_tick=1)");
        return Finding::new(key, Status::Warn, found, cost, "boot without skew_tick=1, or choose loop.phase by trial");
    }
    Finding::good(key, format!("{found}; the default loop.phase keeps deadlines off it"))
}

pub(super) fn huge_pages(tree: &Tree) -> Finding {
    let key = "huge_pages";
    let path = "sys/kernel/mm/transparent_hugepage/enabled";
    let cost = "the kernel may move pages together behind the program's back, and a touch waits meanwhile";
    let text = tree.line(path);
    match text.as_deref().and_then(|choice| chosen(choice, '[', ']')) {
        Some("always") => {
            let mend = "echo madvise | sudo tee /sys/kernel/mm/transparent_hugepage/enabled";
            Finding::new(key, Status::Warn, "always", cost, mend)
        }
        Some(choice) => Finding::good(key, choice),
        None => Finding::unknown(key, "the setting is not visible", cost),
    }
}
