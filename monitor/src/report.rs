//! `report.html`: a run, or two side by side, as one page that needs no network and no server.
//!
//! Responsible for what the page is told; how it looks is in `report/page.{html,css,js}`. The figures come from the
//! files of the run alone, so that a page can be written again at any time.

mod decimate;
mod rebuilt;

use loopbound_model::quote;
use std::io::{self, BufReader};
use std::path::Path;

use loopbound_scenario::input::{self, Line};
use loopbound_shared::headline::Headline;
use loopbound_shared::sample::{Links, TickRecord};
use serde::Serialize;
use serde_json::{Value, json};

use crate::cause::Cause;
use crate::event::words::complete;
use crate::hops::Hop;
use crate::recording::proto::Figures;
use crate::recording::reader::{Item, ReadError, Recording};
use crate::tracker::{accepted, segments};
use decimate::Decimated;

/// Events that a page shows; all of them are in `events.jsonl`.
const EVENTS_MAX: usize = 4000;

/// What a page is told of one run.
#[derive(Debug, Serialize)]
pub struct Run {
    /// Name of the run: its folder's.
    pub name: String,
    /// `summary.json`.
    pub summary: Value,
    /// How the page shows the verdict: `good`, `warn` or `bad`.
    pub mood: &'static str,
    /// What the verdict means, in one sentence without a full stop; empty for the word of another version.
    pub meaning: &'static str,
    /// Lines of `events.jsonl`.
    pub events: Vec<Value>,
    /// Lines beyond what a page shows.
    pub events_left_out: u64,
    /// Over time: q, q_d, e (rad) and τ (N·m) of each link, then V, the promised V, its certified level, round trip (µs).
    series: Decimated,
    /// Whether the recording was cut off, or why there is none.
    pub recording: String,
    /// Why the recording is not whole: one line each.
    pub incomplete: Vec<String>,
    /// For each hop: the value (µs) at each 1/(1 − percentile).
    pub percentiles: Vec<(&'static str, Vec<[f64; 2]>)>,
}

/// Reads what a page needs from the folder of a run. `incomplete`: why it is not whole, if it is not; then figures that
/// its run did not write are computed from what there is of the recording.
///
/// # Errors
/// If there is no `summary.json` where there should be one, or a file can't be read.
pub fn read_run(folder: &Path, incomplete: &[String]) -> io::Result<Run> {
    let named =
        |name: &str, e: io::Error| io::Error::new(e.kind(), format!("{}: {e}", quote::path(&folder.join(name))));
    let (mut summary, rebuilt): (Value, _) =
        match input::read_file(&folder.join("summary.json"), input::SUMMARY_BYTES_MAX) {
            Ok(text) => (serde_json::from_slice(&text).map_err(|e| named("summary.json", e.into()))?, None),
            Err(error) if error.kind() == io::ErrorKind::NotFound && !incomplete.is_empty() => {
                rebuilt::figures(folder).map_or((json!({}), None), |(summary, hops)| (json!(summary), Some(hops)))
            }
            Err(error) => return Err(named("summary.json", error)),
        };
    if !summary.is_object() {
        let why = io::Error::new(io::ErrorKind::InvalidData, "found something else than a JSON object");
        return Err(named("summary.json", why));
    }
    if !incomplete.is_empty() {
        if !summary["verdict"].is_object() {
            summary["verdict"] = json!({});
        }
        // A loop that ran away outweighs a recording of it that is not whole.
        if summary["verdict"]["status"] != Headline::Diverged.word() {
            summary["verdict"]["status"] = json!(Headline::Incomplete.word());
        }
        summary["verdict"]["reasons"] = json!(incomplete);
    }
    let links = summary["links"].as_u64().and_then(|n| usize::try_from(n).ok()).unwrap_or(0).min(7);
    let (events, events_left_out) = read_events(&folder.join("events.jsonl"))?;
    let mut series = Decimated::new(4 * links + 5);
    let recording = match read_series(&folder.join("samples.mcap"), links, &mut series) {
        Ok(false) => "whole".to_owned(),
        Ok(true) => "cut off".to_owned(),
        Err(error) => error.to_string(),
    };
    let percentiles = Hop::ALL.map(|hop| {
        let file = || {
            input::read_file_text(&folder.join(format!("latency/{}.hgrm", hop.name())), input::SUMMARY_BYTES_MAX)
                .unwrap_or_default()
        };
        let text = rebuilt.as_ref().map_or_else(file, |hops| crate::files::percentiles(hops.of(hop).histogram()));
        (hop.name(), percentile_steps(&text))
    });
    let name = folder.canonicalize().ok().and_then(|path| Some(path.file_name()?.to_string_lossy().into_owned()));
    Ok(Run {
        name: name.unwrap_or_else(|| quote::path(folder)),
        mood: mood(&summary),
        meaning: headline(&summary).map(Headline::sentence).unwrap_or_default(),
        summary,
        events,
        events_left_out,
        series,
        recording,
        incomplete: incomplete.to_vec(),
        percentiles: percentiles.into(),
    })
}

/// The headline of the verdict; none for a word of another version.
fn headline(summary: &Value) -> Option<Headline> {
    summary["verdict"]["status"].as_str().and_then(Headline::of_word)
}

/// By the headline of the verdict; a word of another version decides nothing.
fn mood(summary: &Value) -> &'static str {
    match headline(summary) {
        Some(headline) if headline.is_good() => "good",
        Some(headline) if headline.is_bad() => "bad",
        _ => "warn",
    }
}

fn read_events(path: &Path) -> io::Result<(Vec<Value>, u64)> {
    let (mut events, mut left_out) = (Vec::new(), 0);
    let Ok(file) = input::open_file(path) else { return Ok((events, 0)) };
    let mut lines = BufReader::new(file);
    while let Some(line) = input::next_line(&mut lines)? {
        // A line that a crash has cut off is no event.
        let Line::Whole(line) = line else { continue };
        let Ok(mut event) = serde_json::from_slice(&line) else { continue };
        if events.len() < EVENTS_MAX {
            complete(&mut event);
            events.push(event);
        } else {
            left_out += 1;
        }
    }
    Ok((events, left_out))
}

/// Reads the recording; whether it was cut off.
fn read_series(path: &Path, links: usize, series: &mut Decimated) -> Result<bool, ReadError> {
    let mut recording = Recording::open(path)?;
    let mut record: Option<Box<TickRecord>> = None;
    while let Some(item) = recording.next_item()? {
        match item {
            Item::Announce(_) => {}
            Item::Record(next) => record = Some(next),
            Item::Figures(figures) => {
                if let Some(record) = record.take().filter(|record| record.tick == figures.tick) {
                    push(series, links, &record, &figures);
                }
            }
        }
    }
    Ok(recording.is_cut_off())
}

fn push(series: &mut Decimated, links: usize, record: &TickRecord, figures: &Figures) {
    let tau = segments(record).last().map_or([0.0; 7], |segment| segment.tau);
    let error: Links = std::array::from_fn(|i| record.q_d[i] - record.q[i]);
    let vectors = [&record.q, &record.q_d, &error, &tau];
    let vectors = vectors.into_iter().flat_map(|values| values.iter().take(links).map(|value| Some(*value)));
    let receipt = accepted(record);
    let trip_ns = Hop::RoundTrip.stamps(record, receipt).and_then(|(from_ns, to_ns)| to_ns.checked_sub(from_ns));
    let slack = figures.promised - figures.v;
    let trip_us = trip_ns.map(|ns| ns as f64 * 1e-3);
    let scalars = [Some(figures.v), Some(figures.promised), Some(figures.level), trip_us, Some(slack)];
    series.push(record.start_plant_ns as f64 * 1e-9, vectors.chain(scalars));
}

/// The steps of a percentile file, but for the last, whose 1/(1 − p) is infinite.
fn percentile_steps(text: &str) -> Vec<[f64; 2]> {
    let step = |line: &str| {
        let cells: Vec<f64> = line.split_whitespace().map_while(|cell| cell.parse().ok()).collect();
        (cells.len() == 4).then(|| [cells[3], cells[0]])
    };
    text.lines().filter(|line| !line.starts_with('#')).filter_map(step).collect()
}

/// The hops of the charts, with their words. The age of a setpoint is the lead of the reference, no latency of the loop.
fn hops() -> Vec<(&'static str, &'static str)> {
    Hop::ALL.into_iter().filter(|hop| *hop != Hop::SetpointAge).map(|hop| (hop.name(), hop.words())).collect()
}

fn causes() -> Vec<(&'static str, &'static str)> {
    Cause::ALL.iter().map(|cause| (cause.name(), cause.words())).collect()
}

/// The page of one run or of several side by side.
#[must_use]
pub fn page(runs: &[Run]) -> String {
    let title = runs.iter().map(|run| run.name.as_str()).collect::<Vec<_>>().join(" | ");
    // Nothing in the data can end the script element that holds it.
    let data = json!({ "runs": runs, "hops": hops(), "causes": causes() }).to_string().replace('<', "\\u003c");
    include_str!("report/page.html")
        .replace("{{title}}", &escape(&title))
        .replace("{{style}}", include_str!("report/page.css"))
        .replace("{{script}}", include_str!("report/page.js"))
        .replace("{{data}}", &data)
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(name: &str) -> Run {
        Run {
            name: name.into(),
            summary: json!({"verdict": {"status": "held", "reasons": ["</script><b>"]}}),
            meaning: "",
            mood: "good",
            events: Vec::new(),
            events_left_out: 0,
            series: Decimated::new(5),
            recording: "whole".into(),
            incomplete: Vec::new(),
            percentiles: Vec::new(),
        }
    }

    #[test]
    fn nothing_in_the_data_ends_the_page_s_script_and_nothing_is_fetched() {
        let page = page(&[run("a<b"), run("b")]);
        assert_eq!(page.matches("</script>").count(), 2, "the data's and the code's own");
        assert!(page.contains("<title>a&lt;b | b"));
        assert!(!page.contains("{{"), "every place is filled");
        for fetched in ["src=", "http:", "https:", "@import", "url("] {
            let found = page.find(fetched);
            assert!(found.is_none(), "{fetched} at {found:?}");
        }
    }

    #[test]
    fn a_folder_without_a_summary_is_an_error_that_names_it() {
        let error = read_run(Path::new("/nowhere"), &[]).unwrap_err();
        assert!(error.to_string().contains("/nowhere/summary.json"), "{error}");
    }
}
