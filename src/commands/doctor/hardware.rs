//! Findings on the machine: cores, load, virtualisation, clock, frequency and idle states.

use super::live::Live;
use super::tree::{Tree, count_cores};
use super::{Finding, Status};

const CPUS: &str = "sys/devices/system/cpu";

/// Cores that are online; where the files don't say, those that this process may use.
fn core_count(tree: &Tree) -> u32 {
    let listed = tree.line(&format!("{CPUS}/online")).and_then(|list| count_cores(&list));
    listed.unwrap_or_else(|| {
        std::thread::available_parallelism().map_or(1, |count| u32::try_from(count.get()).unwrap_or(u32::MAX))
    })
}

/// The cores that this process may use: a cpuset or a mask may leave fewer than there are.
fn allowed_count(tree: &Tree) -> Option<u32> {
    let status = tree.text("proc/self/status")?;
    count_cores(status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:"))?)
}

pub(super) fn cores(tree: &Tree) -> Finding {
    let key = "cores";
    let mend = "a machine, or a virtual machine, with four cores or more";
    let present = core_count(tree);
    let allowed = allowed_count(tree).unwrap_or(present);
    let found =
        if allowed < present { format!("{allowed} of {present} may be used here") } else { allowed.to_string() };
    let mend = if allowed < present {
        "docker run --cpuset-cpus=…; taskset; systemd: AllowedCPUs=: more cores"
    } else {
        mend
    };
    match allowed {
        1 => Finding::new(
            key,
            Status::Bad,
            found,
            "plant, controller and everything else take turns; nothing may spin, and each exchange is a switch",
            mend,
        ),
        2..=3 => Finding::new(
            key,
            Status::Warn,
            found,
            "the plant and a controller fill two cores; the rest of the system runs in the gaps they leave",
            mend,
        ),
        _ => Finding::good(key, found),
    }
}

pub(super) fn load(tree: &Tree) -> Finding {
    let key = "load";
    let cost = "other processes want the cores; without SCHED_FIFO the loop waits for them";
    let text = tree.line("proc/loadavg");
    let Some(load) = text.as_deref().and_then(|text| text.split(' ').next()?.parse::<f64>().ok()) else {
        return Finding::unknown(key, "the load average is not readable", cost);
    };
    let cores = core_count(tree);
    let found = format!("{load:.2} over the last minute, on {cores} cores");
    let mend = "top  # end what need not run, or move it with taskset -p";
    let share = load / f64::from(cores.max(1));
    if share > 1.0 {
        Finding::new(key, Status::Bad, found, cost, mend)
    } else if share > 0.5 {
        Finding::new(key, Status::Warn, found, cost, mend)
    } else {
        Finding::good(key, found)
    }
}

/// What hypervisor this machine runs on, if any sign of one is found; none if nothing could be read at all.
fn hypervisor(tree: &Tree) -> Option<Option<String>> {
    let named = ["sys/class/dmi/id/sys_vendor", "sys/class/dmi/id/product_name"]
        .iter()
        .filter_map(|path| tree.line(path))
        .find(|name| {
            let known =
                ["QEMU", "KVM", "VMware", "VirtualBox", "Xen", "Amazon EC2", "Google", "Virtual Machine", "Bochs"];
            known.iter().any(|known| name.contains(known))
        });
    let cpuinfo = tree.text("proc/cpuinfo");
    let flagged = cpuinfo.as_deref().is_some_and(|text| {
        text.lines().any(|line| line.starts_with("flags") && line.split_whitespace().any(|flag| flag == "hypervisor"))
    });
    let sign = tree.line("sys/hypervisor/type").or(named).or_else(|| {
        let device_tree = tree.line("proc/device-tree/hypervisor/compatible");
        device_tree.or_else(|| flagged.then(|| "the processor's hypervisor flag is set".to_owned()))
    });
    if sign.is_none() && cpuinfo.is_none() { None } else { Some(sign) }
}

pub(super) fn virtualised(tree: &Tree) -> Finding {
    let key = "virtualised";
    let container = if tree.is_container() { ", in a container" } else { "" };
    let cost = "the host stops the guest without telling it: on a 2-core KVM guest 0.2 to 8 ms at a time, both cores, \
                under SCHED_FIFO, with no involuntary switch, while steal time read 0";
    match hypervisor(tree) {
        Some(Some(sign)) => {
            let mend = "bare metal; or pin the guest's virtual cores on the host (virsh vcpupin)";
            Finding::new(key, Status::Warn, format!("yes: {sign}{container}"), cost, mend)
        }
        Some(None) => Finding::good(key, format!("no sign of a hypervisor{container}")),
        None => Finding::unknown(key, format!("not visible{container}"), cost),
    }
}

pub(super) fn steal_time(tree: &Tree) -> Finding {
    let key = "steal_time";
    let cost = "the host ran something else on this machine's cores";
    let stat = tree.text("proc/stat").unwrap_or_default();
    let times: Vec<f64> = stat
        .lines()
        .find_map(|line| line.strip_prefix("cpu "))
        .map(|line| line.split_whitespace().filter_map(|word| word.parse().ok()).collect())
        .unwrap_or_default();
    // user, nice, system, idle, iowait, irq, softirq, steal; guest times are within user and nice.
    let Some(&steal) = times.get(7) else {
        return Finding::unknown(key, "not readable", cost);
    };
    let share = steal / times.iter().take(8).sum::<f64>().max(1.0);
    let found = format!("{:.2} % since boot", share * 100.0);
    if share > 0.001 {
        Finding::new(key, Status::Warn, found, cost, "a host that is less busy, or dedicated cores")
    } else {
        Finding::good(key, format!("{found} (a host need not report it)"))
    }
}

pub(super) fn clock_source(tree: &Tree, live: &Live) -> Finding {
    let key = "clock_source";
    let cost = "every stamp becomes a system call that reads a slow device, and spinning on the clock is coarse";
    let read_ns = live.stalls.clock_read_ns;
    match tree.line("sys/devices/system/clocksource/clocksource0/current_clocksource") {
        Some(name) => {
            let found = format!("{name}, {read_ns} ns a reading");
            let fast = ["tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page", "riscv_clocksource"];
            if fast.contains(&name.as_str()) {
                return Finding::good(key, found);
            }
            let mend = "echo tsc | sudo tee /sys/devices/system/clocksource/clocksource0/current_clocksource";
            Finding::new(key, Status::Bad, found, cost, mend)
        }
        None => Finding::unknown(key, format!("its name is not visible; {read_ns} ns a reading"), cost),
    }
}

pub(super) fn governor(tree: &Tree) -> Finding {
    let key = "governor";
    let cost = "the clock rate follows the load, so a loop that sleeps most of its period computes at a low rate";
    let mut governors: Vec<String> = tree
        .numbered(CPUS, "cpu")
        .iter()
        .filter_map(|cpu| tree.line(&format!("{CPUS}/{cpu}/cpufreq/scaling_governor")))
        .collect();
    governors.sort();
    governors.dedup();
    match governors.as_slice() {
        [] => Finding::unknown(key, "no frequency scaling visible (usual in a virtual machine)", cost),
        [only] if only == "performance" => Finding::good(key, "performance"),
        others => {
            let mend = "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor";
            Finding::new(key, Status::Warn, others.join(", "), cost, mend)
        }
    }
}

pub(super) fn idle_states(tree: &Tree) -> Finding {
    let key = "idle_states";
    let cost = "unless dma_latency is held at 0, the first wake-up after an idle stretch waits for the core to return";
    let folder = format!("{CPUS}/cpu0/cpuidle");
    let enabled = tree.numbered(&folder, "state").into_iter().filter_map(|state| {
        let read = |file: &str| tree.line(&format!("{folder}/{state}/{file}"));
        let latency_us: u64 = read("latency")?.parse().ok()?;
        (read("disable").as_deref() != Some("1")).then(|| (latency_us, read("name").unwrap_or(state.clone())))
    });
    match enabled.max_by_key(|(latency_us, _)| *latency_us) {
        None => Finding::unknown(key, "not visible (in a virtual machine the host decides)", cost),
        Some((latency_us, name)) if latency_us <= 2 => {
            // The kernel of a guest can't know what the host does with a halted core.
            let by_guest = if matches!(hypervisor(tree), Some(Some(_))) { ", as far as the guest knows" } else { "" };
            Finding::good(key, format!("the deepest is {name:?}, {latency_us} us to leave{by_guest}"))
        }
        Some((latency_us, name)) => Finding::new(
            key,
            Status::Warn,
            format!("the deepest is {name:?}, {latency_us} us to leave"),
            cost,
            "set realtime.dma_latency = true (the default) and give access: see dma_latency",
        ),
    }
}

pub(super) fn hyper_threading(tree: &Tree) -> Finding {
    let key = "hyper_threading";
    let cost = "the sibling of the loop's core takes its caches and execution units at any moment";
    match tree.line(&format!("{CPUS}/smt/active")).as_deref() {
        Some("0") => Finding::good(key, "off, or not visible to this guest"),
        Some("1") => {
            let mend = "echo off | sudo tee /sys/devices/system/cpu/smt/control";
            Finding::new(key, Status::Warn, "on", cost, mend)
        }
        _ => Finding::unknown(key, "not visible", cost),
    }
}
