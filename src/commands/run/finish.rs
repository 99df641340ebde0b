//! The end of a run's folder: the launcher adds its part to what the monitor wrote.

use loopbound_monitor::Summary;
use loopbound_monitor::files::summary_text;
use loopbound_monitor::folder::{Results, known};
use loopbound_monitor::summary::RecordingSummary;
use loopbound_monitor::verdict::reports;

use crate::commands::report;

/// Adds the launcher's part to what the monitor wrote, and marks the folder finished if all of it is there. What can't
/// be written goes into the summary and costs neither the screen nor the verdict.
pub(super) fn finish(mut results: Results, summary: &mut Summary) {
    let written = results.reload().map_err(|error| error.to_string()).and_then(|()| write(&mut results, summary));
    let monitor = summary.recording.take().unwrap_or_default();
    let why = monitor.error.clone().or_else(|| written.err());
    let whole = monitor.whole && why.is_none();
    let finished = if whole {
        results.finish().map_err(|error| format!("{}: {error}", loopbound_monitor::folder::FILE))
    } else {
        results.leave_unfinished(&why.clone().unwrap_or_else(|| summary.dropped.to_string()));
        Ok(())
    };
    let error = why.or_else(|| finished.err());
    summary.recording = Some(RecordingSummary { whole: whole && error.is_none(), error });
}

fn write(results: &mut Results, summary: &Summary) -> Result<(), String> {
    let path = results.path().to_owned();
    let mut file = |name: &str, bytes: &[u8]| results.write(name, bytes).map_err(|error| format!("{name}: {error}"));
    file(known::SUMMARY, &summary_text(summary).map_err(|error| error.to_string())?)?;
    let page = report::page_of(&[&path]).map_err(|error| error.to_string())?;
    file(report::FILE, page.as_bytes())?;
    file(reports::FILE, reports::junit(summary).as_bytes())
}
