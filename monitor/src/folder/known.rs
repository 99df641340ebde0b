//! The files that a run writes, by name, and how each is told from somebody else's of the same name.

use std::path::Path;

use crate::hops::Hop;
use crate::recording::reader::Recording;

/// What the scenario's file of waypoints is called in the folder of a run.
pub const WAYPOINTS: &str = "waypoints.csv";
/// The scenario with all defaults filled in.
pub const SCENARIO: &str = "scenario.toml";
/// The recording.
pub const SAMPLES: &str = "samples.mcap";
/// All figures.
pub const SUMMARY: &str = "summary.json";
/// Its subfolders.
pub const FOLDERS: [&str; 2] = ["latency", "changes"];
/// What is needed of a file to recognise it.
pub const HEAD_BYTES: usize = 4096;

const FILES: [&str; 10] = [
    SUMMARY,
    SCENARIO,
    WAYPOINTS,
    SAMPLES,
    "samples.csv",
    "events.jsonl",
    "latency.hlog",
    "blocks.jsonl",
    "report.html",
    "junit.xml",
];

/// All names that a run may write, but for those of `changes`, which [`is_change`] knows.
pub fn names() -> impl Iterator<Item = String> {
    let latency =
        Hop::ALL.into_iter().flat_map(|hop| ["hgrm", "svg"].map(|kind| format!("latency/{}.{kind}", hop.name())));
    FILES.into_iter().map(str::to_owned).chain(latency)
}

/// Whether a file in `changes` is called as those of a run.
#[must_use]
pub fn is_change(name: &str) -> bool {
    name.strip_suffix(".csv").is_some_and(|tick| !tick.is_empty() && tick.bytes().all(|c| c.is_ascii_digit()))
}

/// Whether the file of this name in `folder` that begins with `head` was written by a run of this program. Waypoints
/// and scenarios are files that people write themselves: only a recording beside it, or a manifest, says whose it is.
#[must_use]
pub fn is_ours(folder: &Path, name: &str, head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let begins = |with: &str| text.starts_with(with);
    match name {
        SUMMARY => begins("{\n  \"schema\": ") && text.contains("\"build\": \"") && text.contains("\"latency"),
        SAMPLES => head.starts_with(b"\x89MCAP0\r\n") && text.contains("loopbound "),
        "samples.csv" => begins("tick,t_s,q1,"),
        "events.jsonl" => {
            begins("{")
                && text.lines().next().is_some_and(|line| line.contains("\"kind\":") && line.contains("\"tick\":"))
        }
        "latency.hlog" => begins("#latencies in ns, one tag a hop"),
        "blocks.jsonl" => begins("{\"blocks\":"),
        "report.html" => text.contains("– loopbound</title>"),
        "junit.xml" => text.contains("<testsuite name=\"loopbound\""),
        SCENARIO => is_the_recordings_scenario(folder, &text),
        WAYPOINTS => false,
        _ if name.starts_with("changes/") => begins("tick,t_s,q1,"),
        _ if name.ends_with(".hgrm") => text.trim_start().starts_with("Value ") && text.contains("1/(1-Percentile)"),
        _ => begins("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 720 400\""),
    }
}

fn is_the_recordings_scenario(folder: &Path, text: &str) -> bool {
    Recording::scenario_of(&folder.join(SAMPLES)).is_some_and(|scenario| scenario.starts_with(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_other_people_are_not_taken_for_a_run_s() {
        let folder = Path::new("/nowhere");
        for (name, head) in [
            (SUMMARY, "{\"total\": 3}"),
            (SUMMARY, ""),
            (SAMPLES, "no container"),
            (SAMPLES, "\u{89}MCAP0\r\n another recorder's"),
            ("samples.csv", "time,value\n"),
            ("events.jsonl", "{\"event\":1}\n"),
            ("report.html", "<!doctype html><title>my report</title>"),
            ("junit.xml", "<testsuite name=\"pytest\">"),
            (SCENARIO, "[loop]\nrate = \"1kHz\"\n"),
            (WAYPOINTS, "t_s,q1\n0,0\n"),
            ("changes/5.csv", "a,b\n"),
            ("latency/compute.svg", "<svg/>"),
        ] {
            assert!(!is_ours(folder, name, head.as_bytes()), "{name}: {head}");
        }
        assert!(is_change("500.csv") && !is_change("x.csv") && !is_change(".csv") && !is_change("5.csv.bak"));
    }
}
