//! What the report says of the machine. Whatever can't be read is left out.

use std::collections::BTreeMap;
use std::fs;

use serde_json::{Value, json};

fn line(path: &str) -> Option<String> {
    fs::read_to_string(path).ok().map(|text| text.trim().to_owned()).filter(|text| !text.is_empty())
}

/// The machine: kernel, processor, governor, load, by stable keys.
#[must_use]
pub(crate) fn describe() -> BTreeMap<String, Value> {
    let cpuinfo = line("/proc/cpuinfo").unwrap_or_default();
    let field = |name: &str| {
        let found = cpuinfo.lines().find(|line| line.starts_with(name))?;
        found.split_once(':').map(|(_, value)| value.trim().to_owned())
    };
    let flags = field("flags");
    let version = line("/proc/version");
    let found = [
        ("kernel", line("/proc/sys/kernel/osrelease").map(|text| json!(text))),
        ("kernel_realtime", version.map(|text| json!(text.contains("PREEMPT_RT")))),
        ("machine", Some(json!(std::env::consts::ARCH))),
        ("processor", field("model name").map(|text| json!(text))),
        ("cores", std::thread::available_parallelism().ok().map(|cores| json!(cores.get()))),
        ("virtualised", flags.map(|flags| json!(flags.split(' ').any(|flag| flag == "hypervisor")))),
        ("governor", line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").map(|text| json!(text))),
        ("clock_source", line("/sys/devices/system/clocksource/clocksource0/current_clocksource").map(|t| json!(t))),
        ("isolated_cores", line("/sys/devices/system/cpu/isolated").map(|text| json!(text))),
        ("load_average", line("/proc/loadavg").map(|text| json!(text))),
    ];
    found.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?))).collect()
}
