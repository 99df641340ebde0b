//! What the end of a run adds to the verdict on its figures: a signal, a lost role, an end before its time.

use loopbound_monitor::Summary;
use loopbound_scenario::Role;
use loopbound_shared::headline::Headline;

use crate::exit::Exit;
use crate::supervise::Record;

/// How often `count` of the plant stands in a summary.
fn count(summary: &Summary, name: &str) -> u64 {
    summary.counters.get(name).copied().unwrap_or(0)
}

/// What the launcher's account says of a run besides its figures; `stopped`: the signal that ended it, while it is being
/// concluded. A recorded run that a signal ended was ended by its user, and is whole as far as it goes.
fn findings(record: &Record, summary: Option<&Summary>, stopped: Option<Exit>) -> Vec<(Headline, String)> {
    let mut found = Vec::new();
    match stopped {
        Some(Exit::Interrupted) => found.push((Headline::Interrupted, "Ctrl-C ended the run".to_owned())),
        Some(_) => found.push((Headline::Terminated, "a signal ended the run".to_owned())),
        None => {}
    }
    if let Some(death) = record.unrecovered() {
        found.push((Headline::RoleLost, death.to_string()));
    }
    let by_its_user = stopped.is_some() || record.end == "interrupted" || record.end == "terminated";
    let Some(summary) = summary else {
        found.push((Headline::RoleLost, "the monitor left no summary".to_owned()));
        return found;
    };
    let run = count(summary, "ticks").saturating_add(count(summary, "skipped"));
    if run < record.ticks_planned && !by_its_user {
        let reason = format!("it ended after {run} of {} ticks, and nobody had asked for that", record.ticks_planned);
        found.push((Headline::Incomplete, reason));
    }
    // The launcher's monitor is there from the start: a later first tick is that of one that took its place.
    if let Some(first) = summary.first_tick.filter(|first| *first > 0 && record.ticks_planned > 0) {
        let skipped = summary.ticks_seen >= summary.ticks;
        if !skipped {
            let lost = record.deaths.iter().any(|death| death.role == Role::Monitor.name());
            let why = if lost { ": the monitor was lost and started again" } else { " by the monitor" };
            let reason = format!("no tick before {first} was seen{why}");
            found.push((Headline::Inconclusive, reason));
        }
    }
    found
}

/// Adds that to the verdict of a run; the headline that counts first is its headline.
pub(crate) fn conclude(summary: &mut Summary, record: &Record, stopped: Option<Exit>) {
    let found = findings(record, Some(summary), stopped);
    add(summary, found);
}

/// Adds that the recording is not what was asked for, once its files are written.
pub(crate) fn conclude_recording(summary: &mut Summary) {
    let shortfall = summary.recording.as_ref().and_then(|recording| recording.shortfall(&summary.dropped));
    add(summary, shortfall.into_iter().map(|why| (Headline::Incomplete, why)).collect());
}

fn add(summary: &mut Summary, found: Vec<(Headline, String)>) {
    let before = summary.verdict.headline();
    let Some(first) = Headline::first_of(found.iter().map(|(headline, _)| *headline)) else { return };
    let headline = first.min(before);
    let until_then = (headline != before).then(|| format!("as far as it went: {before}"));
    let reasons = found.into_iter().map(|(_, reason)| reason).chain(until_then);
    summary.verdict.reasons.splice(0..0, reasons);
    summary.verdict.status = headline.word().to_owned();
}

/// The headline of a run that left no summary.
#[must_use]
pub(crate) fn without_summary(record: &Record, stopped: Option<Exit>) -> (Headline, Vec<String>) {
    let found = findings(record, None, stopped);
    let headline = Headline::first_of(found.iter().map(|(headline, _)| *headline)).unwrap_or(Headline::RoleLost);
    (headline, found.into_iter().map(|(_, reason)| reason).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::supervise::Death;
    use loopbound_monitor::summary::RecordingSummary;

    fn died(recovered: bool) -> Record {
        let death =
            Death { role: "controller".into(), id: 1, pid: 1, tick: 5, how: "killed (SIGKILL)".into(), recovered };
        Record { end: "done".into(), deaths: vec![death], ticks_planned: 100, ..Record::default() }
    }

    fn judged(headline: Headline, ticks: u64) -> Summary {
        let mut summary = Summary { ticks, ticks_seen: ticks, first_tick: Some(0), ..Summary::default() };
        summary.verdict.status = headline.word().to_owned();
        summary.counters.insert("ticks".to_owned(), ticks);
        summary
    }

    fn concluded(mut summary: Summary, record: &Record, stopped: Option<Exit>) -> Headline {
        conclude(&mut summary, record, stopped);
        summary.verdict.headline()
    }

    #[test]
    fn where_several_apply_the_first_of_the_table_counts() {
        let whole = Record { end: "done".into(), ticks_planned: 100, ..Record::default() };
        for headline in [Headline::Held, Headline::Passed, Headline::Late, Headline::Inconclusive, Headline::Violated] {
            assert_eq!(concluded(judged(headline, 100), &whole, None), headline);
        }
        assert_eq!(concluded(judged(Headline::Held, 100), &died(true), None), Headline::Held);
        assert_eq!(concluded(judged(Headline::Held, 100), &died(false), None), Headline::RoleLost);
        assert_eq!(concluded(judged(Headline::Failed, 40), &died(false), None), Headline::RoleLost);
        assert_eq!(concluded(judged(Headline::Diverged, 40), &died(false), None), Headline::Diverged);
        assert_eq!(concluded(judged(Headline::Failed, 40), &whole, None), Headline::Incomplete);
        assert_eq!(concluded(judged(Headline::Passed, 99), &whole, None), Headline::Incomplete);
        assert_eq!(
            concluded(judged(Headline::Diverged, 40), &died(false), Some(Exit::Interrupted)),
            Headline::Interrupted
        );
        assert_eq!(concluded(judged(Headline::Held, 40), &whole, Some(Exit::Terminated)), Headline::Terminated);
        let recorded = Record { end: "interrupted".into(), ..whole };
        assert_eq!(concluded(judged(Headline::Passed, 40), &recorded, None), Headline::Passed, "its user ended it");
        assert_eq!(without_summary(&died(true), None).0, Headline::RoleLost);
    }

    #[test]
    fn a_run_that_held_and_is_not_recorded_as_it_was_asked_to_be_is_incomplete() {
        for (whole, before, after) in [
            (true, Headline::Held, Headline::Held),
            (false, Headline::Held, Headline::Incomplete),
            (false, Headline::Interrupted, Headline::Interrupted),
        ] {
            let mut summary = judged(before, 100);
            summary.recording = Some(RecordingSummary { whole, error: None });
            conclude_recording(&mut summary);
            assert_eq!(summary.verdict.headline(), after);
            let why =
                "the recording is not whole: the disk was too slow; 0 rows, 0 events, 0 intervals were not recorded";
            assert_eq!(summary.verdict.reasons.iter().any(|reason| reason == why), !whole, "{:?}", summary.verdict);
        }
    }

    #[test]
    fn skipped_ticks_are_part_of_a_whole_run_and_ticks_that_a_lost_monitor_saw_alone_decide_nothing() {
        let whole = Record { end: "done".into(), ticks_planned: 100, ..Record::default() };
        let mut skipped = judged(Headline::Held, 95);
        skipped.counters.insert("skipped".to_owned(), 5);
        skipped.first_tick = Some(2);
        assert_eq!(concluded(skipped, &whole, None), Headline::Held);
        let mut late = judged(Headline::Held, 100);
        (late.first_tick, late.ticks_seen) = (Some(60), 40);
        assert_eq!(concluded(late, &whole, None), Headline::Inconclusive);
    }
}
