//! A verdict as a table, as `junit.xml`, and as annotations of a build.

use std::fmt::Write as _;

use loopbound_model::quote;
use loopbound_shared::headline::Headline;

use crate::summary::{Finding, Summary, Verdict};

/// Name of the verdict's file for build servers in the folder of a run.
pub const FILE: &str = "junit.xml";

/// A readable table, one line an expectation; empty without any.
#[must_use]
pub fn table(verdict: &Verdict) -> String {
    let mut text = String::new();
    for judgement in &verdict.expectations {
        let word = match judgement.outcome {
            Finding::Pass => "pass",
            Finding::Fail => "FAIL",
            Finding::Inconclusive => "inconclusive",
        };
        let _ = writeln!(text, "{word:<14}{}", judgement.reason);
    }
    text
}

/// One test case an expectation; an inconclusive one is skipped, which is neither success nor failure. What fails besides
/// all expectations, and a run of which nothing was expected, is a case of its own.
#[must_use]
pub fn junit(summary: &Summary) -> String {
    let verdict = &summary.verdict;
    let mut cases: Vec<(&str, Finding, &str)> =
        verdict.expectations.iter().map(|j| (j.expectation.as_str(), j.outcome, j.reason.as_str())).collect();
    let why = verdict.reasons.join("; ");
    cases.extend(case_of_the_run(verdict).map(|(name, outcome)| (name, outcome, why.as_str())));
    let count = |finding| cases.iter().filter(|(_, outcome, _)| *outcome == finding).count();
    let (failures, skipped) = (count(Finding::Fail), count(Finding::Inconclusive));
    let mut text = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let _ = writeln!(
        text,
        "<testsuite name=\"loopbound\" tests=\"{}\" failures=\"{failures}\" skipped=\"{skipped}\" errors=\"0\" time=\"{:.3}\">",
        cases.len(),
        summary.duration_s,
    );
    if !summary.run_id.is_empty() {
        let run_id = escape(&summary.run_id);
        let _ = writeln!(text, "  <properties><property name=\"run_id\" value=\"{run_id}\"/></properties>");
    }
    for (name, outcome, reason) in cases {
        let (name, reason) = (escape(name), escape(reason));
        let inner = match outcome {
            Finding::Pass => String::new(),
            Finding::Fail => format!("<failure message=\"{reason}\"/>"),
            Finding::Inconclusive => format!("<skipped message=\"{reason}\"/>"),
        };
        let _ = writeln!(text, "  <testcase classname=\"loopbound\" name=\"{name}\">{inner}</testcase>");
    }
    text.push_str("</testsuite>\n");
    text
}

/// What is said of the run as a whole: always without expectations, else where it fails though they may all hold.
fn case_of_the_run(verdict: &Verdict) -> Option<(&'static str, Finding)> {
    let headline = verdict.headline();
    let name = match headline {
        Headline::Diverged => "the loop does not diverge",
        Headline::RoleLost | Headline::Incomplete | Headline::Internal => "the run is complete",
        Headline::SwapRefused => "the scheduled swaps are carried out",
        _ => "the bound holds",
    };
    let outcome = match headline {
        Headline::Failed => return None,
        headline if headline.is_bad() => Finding::Fail,
        _ if !verdict.expectations.is_empty() => return None,
        headline if headline.is_open() => Finding::Inconclusive,
        _ => Finding::Pass,
    };
    Some((name, outcome))
}

/// Lines that a build of GitHub's shows beside its steps.
#[must_use]
pub fn annotations(verdict: &Verdict) -> String {
    let mut text = String::new();
    for judgement in &verdict.expectations {
        let level = match judgement.outcome {
            Finding::Pass => continue,
            Finding::Fail => "error",
            Finding::Inconclusive => "warning",
        };
        let message = judgement.reason.replace('%', "%25").replace('\n', "%0A");
        let _ = writeln!(text, "::{level} title=loopbound::{message}");
    }
    text
}

/// The upper limit of what was measured, or the number itself, for a one-line note.
#[must_use]
pub fn one_line(verdict: &Verdict) -> String {
    let named = |finding: Finding| verdict.expectations.iter().filter(move |j| j.outcome == finding);
    let (passed, failed) = (named(Finding::Pass).count(), named(Finding::Fail).count());
    let open = named(Finding::Inconclusive).count();
    let worst =
        named(Finding::Fail).next().map_or_else(String::new, |judgement| format!(", first: {}", judgement.reason));
    format!("{}: {passed} passed, {failed} failed, {open} inconclusive{worst}", verdict.status)
}

/// For XML, which has no place for control characters at all.
fn escape(text: &str) -> String {
    quote::lines(text).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::Judgement;

    fn summary() -> Summary {
        let one = |expectation: &str, outcome| Judgement {
            expectation: expectation.to_owned(),
            outcome,
            reason: format!("{expectation}: \"measured\" 10 %"),
            ..Judgement::default()
        };
        let mut summary = Summary::default();
        summary.verdict.status = "failed".to_owned();
        summary.verdict.expectations = vec![
            one("missed_ticks == 0", Finding::Pass),
            one("round_trip.p99 <= 50us", Finding::Fail),
            one("round_trip.p50 >= 1us", Finding::Inconclusive),
        ];
        summary
    }

    #[test]
    fn the_build_file_counts_each_outcome_and_escapes_comparisons() {
        let text = junit(&summary());
        assert!(text.contains("tests=\"3\" failures=\"1\" skipped=\"1\""), "{text}");
        assert!(text.contains("name=\"round_trip.p99 &lt;= 50us\"><failure message="), "{text}");
        assert!(text.contains("&quot;measured&quot;") && !text.contains("<= "), "{text}");
    }

    #[test]
    fn the_build_file_names_its_run_before_its_cases() {
        assert!(!junit(&summary()).contains("<properties>"), "a version that had no ids wrote none");
        let mut summary = summary();
        summary.run_id = "00000000000000ab".to_owned();
        let text = junit(&summary);
        let at = text.find("<property name=\"run_id\" value=\"00000000000000ab\"/>").unwrap();
        assert!(at < text.find("<testcase").unwrap());
    }

    #[test]
    fn a_broken_bound_is_a_failed_case_without_any_expectation() {
        let mut summary = Summary::default();
        summary.verdict.status = "violated".to_owned();
        summary.verdict.reasons = vec!["2 ticks broke the bound".to_owned()];
        let text = junit(&summary);
        assert!(text.contains("tests=\"1\" failures=\"1\"") && text.contains("2 ticks broke"), "{text}");
    }

    #[test]
    fn a_run_that_fails_as_a_whole_fails_a_case_though_every_expectation_holds() {
        let mut summary = summary();
        summary.verdict.expectations.truncate(1);
        for (headline, name) in [
            (Headline::Diverged, "the loop does not diverge"),
            (Headline::Incomplete, "the run is complete"),
            (Headline::RoleLost, "the run is complete"),
        ] {
            summary.verdict.status = headline.word().to_owned();
            let text = junit(&summary);
            assert!(text.contains("tests=\"2\" failures=\"1\"") && text.contains(name), "{text}");
        }
    }

    #[test]
    fn a_run_without_data_and_without_expectations_is_skipped_and_does_not_pass() {
        let mut summary = Summary::default();
        summary.verdict.status = Headline::NoData.word().to_owned();
        assert!(junit(&summary).contains("tests=\"1\" failures=\"0\" skipped=\"1\""));
        summary.verdict.status = Headline::Held.word().to_owned();
        assert!(junit(&summary).contains("tests=\"1\" failures=\"0\" skipped=\"0\""));
    }

    #[test]
    fn annotations_are_errors_and_warnings_and_nothing_for_what_holds() {
        let text = annotations(&summary().verdict);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2);
        assert!(lines[0].starts_with("::error title=loopbound::round_trip.p99") && lines[0].ends_with("10 %25"));
        assert!(lines[1].starts_with("::warning "));
        assert_eq!(
            one_line(&summary().verdict).split(", first").next(),
            Some("failed: 1 passed, 1 failed, 1 inconclusive")
        );
    }
}
