//! A verdict as a table, as `junit.xml`, and as annotations of a build.

use std::fmt::Write as _;

use super::expectations::time;
use crate::summary::{Finding, Summary, Verdict};

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

/// One test case an expectation; an inconclusive one is skipped, which is neither success nor failure.
#[must_use]
pub fn junit(summary: &Summary) -> String {
    let all = &summary.verdict.expectations;
    let count = |finding| all.iter().filter(|judgement| judgement.outcome == finding).count();
    let mut text = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    let (failures, skipped) = (count(Finding::Fail), count(Finding::Inconclusive));
    let violated = usize::from(all.is_empty() || summary.verdict.status == "violated");
    let natural_failures = usize::from(violated > 0 && summary.verdict.status == "violated");
    let _ = writeln!(
        text,
        "<testsuite name=\"loopbound\" tests=\"{}\" failures=\"{}\" skipped=\"{skipped}\" errors=\"0\" time=\"{:.3}\">",
        all.len() + violated,
        failures + natural_failures,
        summary.duration_s,
    );
    for judgement in all {
        let name = escape(&judgement.expectation);
        let reason = escape(&judgement.reason);
        let _ = match judgement.outcome {
            Finding::Pass => writeln!(text, "  <testcase classname=\"loopbound\" name=\"{name}\"/>"),
            Finding::Fail => writeln!(
                text,
                "  <testcase classname=\"loopbound\" name=\"{name}\"><failure message=\"{reason}\"/></testcase>"
            ),
            Finding::Inconclusive => writeln!(
                text,
                "  <testcase classname=\"loopbound\" name=\"{name}\"><skipped message=\"{reason}\"/></testcase>"
            ),
        };
    }
    if violated > 0 {
        let why = escape(&summary.verdict.reasons.join("; "));
        let inner = if natural_failures > 0 { format!("<failure message=\"{why}\"/>") } else { String::new() };
        let _ = writeln!(text, "  <testcase classname=\"loopbound\" name=\"the bound holds\">{inner}</testcase>");
    }
    text.push_str("</testsuite>\n");
    text
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
    let worst = named(Finding::Fail).next().map_or_else(String::new, |judgement| {
        format!(", first: {} (measured {})", judgement.expectation, time(judgement.measured))
    });
    format!("{}: {passed} passed, {failed} failed, {open} inconclusive{worst}", verdict.status)
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
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
    fn a_broken_bound_is_a_failed_case_without_any_expectation() {
        let mut summary = Summary::default();
        summary.verdict.status = "violated".to_owned();
        summary.verdict.reasons = vec!["2 ticks broke the bound".to_owned()];
        let text = junit(&summary);
        assert!(text.contains("tests=\"1\" failures=\"1\"") && text.contains("2 ticks broke"), "{text}");
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
