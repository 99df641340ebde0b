use std::os::unix::fs::PermissionsExt;

use loopbound_shared::realtime::Outcome;
use loopbound_shared::say;

use super::*;

const CPUS: &str = "sys/devices/system/cpu";

/// A key, the files that make it worse, and how bad that is.
type Case<'a> = (&'a str, &'a [(&'a str, &'a str)], Status);

/// A running system on which all is well.
fn well() -> Live {
    Live {
        fifo: Outcome::Had,
        fifo_priority: 80,
        lockable_bytes: None,
        tick_ns: Some(4_000_000),
        stalls: Stalls { spun_ns: 300_000_000, clock_read_ns: 30, ..Stalls::default() },
        wake_up: Lateness { min_ns: 2_000, mean_ns: 4_000, max_ns: 9_000 },
        cyclictest: None,
    }
}

fn write(root: &Path, files: &[(&str, &str)]) {
    for (path, text) in files {
        let path = root.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
}

/// The files of an isolated PREEMPT_RT machine of eight cores.
fn tuned() -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    write(
        root.path(),
        &[
            ("dev/cpu_dma_latency", ""),
            ("dev/shm/present", ""),
            ("proc/sys/kernel/osrelease", "6.12.1-rt\n"),
            ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
            ("proc/sys/kernel/sched_rt_period_us", "1000000\n"),
            ("proc/version", "Linux version 6.12.1-rt #1 SMP PREEMPT_RT\n"),
            ("proc/loadavg", "0.10 0.20 0.30 1/92 17444\n"),
            ("proc/cpuinfo", "flags\t\t: fpu vme\n"),
            ("proc/stat", "cpu  63286 0 15367 199370 1149 0 92 0 0 0\n"),
            ("sys/devices/system/cpu/online", "0-7\n"),
            ("sys/devices/system/cpu/isolated", "2-3\n"),
            ("sys/devices/system/cpu/nohz_full", "2-3\n"),
            ("sys/devices/system/cpu/smt/active", "0\n"),
            ("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance\n"),
            ("sys/devices/system/cpu/cpu0/cpuidle/state0/latency", "0\n"),
            ("sys/devices/system/cpu/cpu0/cpuidle/state0/name", "POLL\n"),
            ("sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc\n"),
            ("sys/kernel/mm/transparent_hugepage/enabled", "always [madvise] never\n"),
        ],
    );
    root
}

fn finding<'a>(report: &'a Report, key: &str) -> &'a Finding {
    report.findings.iter().find(|finding| finding.key == key).unwrap()
}

fn status_after(key: &str, files: &[(&str, &str)]) -> Status {
    let root = tuned();
    write(root.path(), files);
    finding(&report(root.path(), &well()), key).status
}

#[test]
fn a_tuned_machine_has_nothing_to_mend() {
    let root = tuned();
    let report = report(root.path(), &well());
    assert_eq!(report.worst, Status::Good, "{}", render(&report));
    assert_eq!(report.kernel, "6.12.1-rt");
    assert!(report.findings.iter().all(|finding| finding.cost.is_none() && finding.mend.is_none()));
}

#[test]
fn each_shortcoming_in_the_files_is_found_by_its_own_key() {
    let version = ("proc/version", "Linux version 6.18 #1 SMP PREEMPT_DYNAMIC\n");
    let cases: &[Case<'_>] = &[
        ("governor", &[("sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "powersave\n")], Status::Warn),
        ("idle_states", &[("sys/devices/system/cpu/cpu0/cpuidle/state3/latency", "133\n")], Status::Warn),
        ("cores", &[("sys/devices/system/cpu/online", "0\n")], Status::Bad),
        ("cores", &[("sys/devices/system/cpu/online", "0-1\n")], Status::Warn),
        ("cores", &[("proc/self/status", "Name:\tx\nCpus_allowed_list:\t2\n")], Status::Bad),
        ("load", &[("proc/loadavg", "5.00 1 1 1/1 1\n")], Status::Warn),
        ("load", &[("proc/loadavg", "9.00 1 1 1/1 1\n")], Status::Bad),
        ("virtualised", &[("proc/cpuinfo", "flags\t: fpu hypervisor\n")], Status::Warn),
        ("virtualised", &[("sys/class/dmi/id/sys_vendor", "QEMU\n")], Status::Warn),
        ("steal_time", &[("proc/stat", "cpu 100 0 100 100 0 0 0 10 0 0\n")], Status::Warn),
        ("clock_source", &[("sys/devices/system/clocksource/clocksource0/current_clocksource", "hpet")], Status::Bad),
        ("hyper_threading", &[("sys/devices/system/cpu/smt/active", "1\n")], Status::Warn),
        ("isolated_cores", &[("sys/devices/system/cpu/isolated", "\n")], Status::Warn),
        ("huge_pages", &[("sys/kernel/mm/transparent_hugepage/enabled", "[always] madvise never\n")], Status::Warn),
        ("kernel_tick", &[("proc/cmdline", "quiet skew_tick=1\n")], Status::Warn),
        ("rt_throttling", &[("proc/sys/kernel/sched_rt_runtime_us", "500000\n")], Status::Warn),
        ("preemption", &[version, ("proc/cmdline", "preempt=none\n")], Status::Warn),
        ("preemption", &[version], Status::Unknown),
    ];
    for (key, files, expected) in cases {
        assert_eq!(status_after(key, files), *expected, "{key} with {files:?}");
    }
}

#[test]
fn the_preemption_model_in_force_goes_before_the_one_built_in() {
    let root = tuned();
    write(
        root.path(),
        &[
            ("proc/version", "Linux version 6.12.1-rt #1 SMP PREEMPT_DYNAMIC\n"),
            ("boot/config-6.12.1-rt", "# CONFIG_PREEMPT is not set\nCONFIG_PREEMPT_VOLUNTARY=y\nCONFIG_HZ=250\n"),
        ],
    );
    let found = |root: &Path| finding(&report(root, &well()), "preemption").found.clone();
    assert!(found(root.path()).starts_with("voluntary (PREEMPT_DYNAMIC"), "{}", found(root.path()));
    write(root.path(), &[("sys/kernel/debug/sched/preempt", "none voluntary (full) lazy\n")]);
    assert!(found(root.path()).starts_with("full, but not PREEMPT_RT"), "{}", found(root.path()));
}

#[test]
fn what_was_refused_to_this_user_is_bad_and_names_the_command() {
    let root = tuned();
    let live = Live {
        fifo: Outcome::Refused(1),
        fifo_priority: 0,
        lockable_bytes: Some(8 << 20),
        stalls: Stalls { unexplained: 2, unexplained_max_ns: 3_000_000, ..well().stalls },
        ..well()
    };
    let report = report(root.path(), &live);
    let keys: Vec<_> = report.findings.iter().map(|finding| (finding.key, finding.status)).take(3).collect();
    assert_eq!(keys, [("sched_fifo", Status::Bad), ("stalls", Status::Bad), ("memory_lock", Status::Warn)]);
    let text = render(&report);
    assert!(text.contains("fix:   sudo prlimit --rtprio=99 --pid $$"), "{text}");
    assert!(text.contains("limited to 8192 KiB"), "{text}");
    assert!(text.contains("longest 3000 us"), "{text}");
    assert!(text.ends_with("2 bad, 1 to fix if you can, 0 unknown, 18 good\n"), "{text}");
}

#[test]
fn in_a_container_the_commands_are_those_of_its_engine() {
    let root = tuned();
    write(root.path(), &[(".dockerenv", "")]);
    let live = Live { fifo: Outcome::Refused(1), fifo_priority: 0, lockable_bytes: Some(0), ..well() };
    let report = report(root.path(), &live);
    for key in ["sched_fifo", "memory_lock"] {
        let mend = finding(&report, key).mend.as_deref().unwrap();
        assert!(mend.starts_with("docker run "), "{key}: {mend}");
    }
}

#[test]
fn a_latency_file_without_access_is_bad() {
    let root = tuned();
    let path = root.path().join("dev/cpu_dma_latency");
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o400)).unwrap();
    let writable = std::fs::OpenOptions::new().write(true).open(&path).is_ok();
    // To root, permissions are no obstacle; a folder in its place is one to everybody.
    if writable {
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
    }
    let report = report(root.path(), &well());
    assert_eq!(finding(&report, "dma_latency").status, Status::Bad);
}

#[test]
fn an_empty_container_is_examined_without_an_error_and_its_gaps_are_unknown() {
    let root = tempfile::tempdir().unwrap();
    let live = Live { tick_ns: None, stalls: Stalls::default(), ..well() };
    let report = report(root.path(), &live);
    assert_eq!(report.kernel, "unknown");
    for key in ["stalls", "rt_throttling", "kernel_tick", "clock_source", "governor", "virtualised", "steal_time"] {
        assert_eq!(finding(&report, key).status, Status::Unknown, "{key}");
    }
    assert_eq!(finding(&report, "shared_memory").status, Status::Bad);
}

#[test]
fn garbage_in_the_files_is_never_good_news_and_never_a_panic() {
    let root = tuned();
    let paths = [
        "proc/stat",
        "proc/loadavg",
        "proc/sys/kernel/sched_rt_runtime_us",
        "proc/sys/kernel/sched_rt_period_us",
        "sys/devices/system/cpu/smt/active",
        "sys/kernel/mm/transparent_hugepage/enabled",
    ];
    for path in paths {
        std::fs::write(root.path().join(path), b"\xff\xfe]9-[ cpu x").unwrap();
    }
    std::fs::write(root.path().join(CPUS).join("online"), "7-0,99999999999").unwrap();
    std::fs::write(root.path().join("proc/config.gz"), "not packed").unwrap();
    let report = report(root.path(), &well());
    for key in ["steal_time", "load", "rt_throttling", "hyper_threading"] {
        assert_eq!(finding(&report, key).status, Status::Unknown, "{key}: {:?}", finding(&report, key));
    }
}

#[test]
fn the_text_keeps_to_its_width_for_every_finding_at_its_worst() {
    let root = tempfile::tempdir().unwrap();
    write(
        root.path(),
        &[
            (".dockerenv", ""),
            ("proc/self/cgroup", "0::/\n1:cpu:/\n"),
            ("proc/self/mountinfo", "1 0 0:1 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu\n"),
            ("sys/fs/cgroup/cpu/cpu.rt_runtime_us", "0"),
            ("sys/fs/cgroup/cpu/cpu.cfs_quota_us", "1000"),
            ("sys/fs/cgroup/cpu/cpu.cfs_period_us", "100000"),
            ("proc/cpuinfo", "flags : hypervisor\n"),
            ("proc/version", "PREEMPT_DYNAMIC"),
            ("proc/cmdline", "preempt=full skew_tick=1"),
            ("proc/stat", "cpu 1 1 1 1 1 1 1 1"),
            ("proc/loadavg", "99999 1 1"),
            ("sys/devices/system/cpu/smt/active", "1"),
            ("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "schedutil"),
            ("sys/devices/system/cpu/cpu0/cpuidle/state9/latency", "100000"),
            ("sys/devices/system/clocksource/clocksource0/current_clocksource", "acpi_pm"),
            ("sys/kernel/mm/transparent_hugepage/enabled", "[always]"),
        ],
    );
    let live = Live { fifo: Outcome::Refused(1), lockable_bytes: Some(0), ..well() };
    let report = report(root.path(), &live);
    for line in render(&report).lines() {
        assert!(line.chars().count() <= COLUMNS, "{} columns: {line}", line.chars().count());
    }
    for mend in report.findings.iter().filter_map(|finding| finding.mend.as_deref()) {
        assert!(render(&report).contains(&format!("fix:   {mend}\n")), "broken over lines: {mend}");
    }
}

#[test]
fn the_json_form_has_stable_keys() {
    let json = serde_json::to_value(report(tuned().path(), &well())).unwrap();
    let keys = |value: &serde_json::Value| value.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(keys(&json), ["findings", "kernel", "taken_at", "version", "worst"]);
    assert_eq!(keys(&json["findings"][0]), ["cost", "found", "key", "mend", "status"]);
    assert_eq!(json["worst"], "good");
    assert_eq!(json["findings"].as_array().unwrap().len(), 21);
}

#[test]
fn this_machine_can_be_examined() {
    let report = examine();
    assert_eq!(report.findings.len(), 21);
    assert!(report.findings.is_sorted_by_key(|finding| finding.status));
    let stalls = finding(&report, "stalls");
    let spun_ms: u64 = stalls.found.split(' ').nth(2).unwrap().parse().unwrap();
    assert!(spun_ms >= 300, "{}", stalls.found);
    for finding in &report.findings {
        assert_eq!(finding.status == Status::Good, finding.cost.is_none(), "{finding:?}");
    }
    say::out!("{}", render(&report));
}
