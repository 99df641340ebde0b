//! What a run is worth: in one word when nobody has said what was expected of it, else by its expectations.
//!
//! | module | responsible for |
//! |---|---|
//! | [`blocks`] | the latencies of a run in blocks of a quarter of a second, in memory and as a file |
//! | [`limits`] | confidence limits of quantiles from blocks, valid under clustered stalls and at every look |
//! | [`expectations`] | each expectation against its budget: pass, fail, or not decided yet |
//! | [`comparison`] | ratios of the quantiles of two runs, with their confidence intervals |
//! | [`reports`] | a verdict as a table, as `junit.xml` and as annotations |

pub mod blocks;
pub mod comparison;
pub mod expectations;
pub mod limits;
pub mod reports;

use loopbound_shared::event::Refusal;
use loopbound_shared::headline::Headline;
use serde::{Deserialize, Serialize};

use crate::cause::words_of;
use crate::counted::counted;
use crate::handover::Handover;
use crate::summary::{Summary, SwapSummary, Verdict};

/// The verdict so far, which the launcher's monitor leaves in the group's folder for the supervisor.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Interim {
    /// The last tick that it rests on.
    pub tick: u64,
    /// As in [`Verdict::status`].
    pub status: String,
}

impl Handover for Interim {
    const FILE: &str = "verdict.json";
}

/// The verdict of the figures alone: the headline that counts first, and every reason.
#[must_use]
pub fn judge_summary(summary: &Summary) -> Verdict {
    let found = findings(summary);
    let headline = Headline::first_of(found.iter().map(|(headline, _)| *headline)).unwrap_or(Headline::Held);
    Verdict::of(headline, found.into_iter().map(|(_, reason)| reason).collect())
}

/// Whether a swap was refused because a failover had already given its controller authority: it is in charge, as was asked.
fn failed_over_to(summary: &Summary, swap: &SwapSummary) -> bool {
    let earlier = |of: &&SwapSummary| of.kind == "failover" && of.to == swap.to && of.tick <= swap.tick;
    swap.reason.as_deref() == Some(Refusal::AlreadyActive.name()) && summary.swaps.iter().any(|of| earlier(&of))
}

/// What came of a swap that the scenario schedules, if not the swap.
fn unlike_scheduled(swap: &SwapSummary) -> String {
    let SwapSummary { tick, to, result, .. } = swap;
    let why = swap.reason.as_ref().map_or_else(String::new, |why| format!(": {why}"));
    format!("the swap to controller {to} that is scheduled for tick {tick} was {result}{why}")
}

/// Of so many ticks one may go unseen before nothing can be said of the run as a whole.
const UNSEEN_PER: u64 = 100;

/// All that is to be said of the figures, each with the headline that it makes.
fn findings(summary: &Summary) -> Vec<(Headline, String)> {
    let bound = &summary.bound;
    let mut found = Vec::new();
    let mut find = |holds: bool, headline, reason: String| {
        if holds {
            found.push((headline, reason));
        }
    };
    if let Some(diverged) = &summary.diverged {
        find(true, Headline::Diverged, format!("from tick {} on: {}", diverged.tick, diverged.words));
    }
    find(summary.ticks_seen == 0, Headline::NoData, "no tick was seen".to_owned());
    find(
        bound.violations_delay_aware > 0,
        Headline::Violated,
        format!(
            "{} broke the bound, and neither the age of the torque nor the plant's own fallback explains it",
            counted(bound.violations_delay_aware, "tick")
        ),
    );
    for swap in summary.swaps.iter().filter(|swap| swap.scheduled && swap.result != "done") {
        find(!failed_over_to(summary, swap), Headline::SwapRefused, unlike_scheduled(swap));
    }
    let by_age = bound.verdicts("latency");
    let reason =
        format!("{} broke the bound, and the age of the torque suffices as the cause", counted(by_age, "tick"));
    find(by_age > 0, Headline::Late, reason);
    let by_fallback = bound.verdicts("fallback");
    let why = words_of(&bound.fallback_by_cause);
    find(
        by_fallback > 0,
        Headline::Late,
        format!(
            "{} broke the bound under the plant's own fallback, as no torque came: {why}",
            counted(by_fallback, "tick")
        ),
    );
    let used_up = bound.budget_used.is_some_and(|used| used >= 1.0);
    let rule = bound.budget_rule.as_deref().unwrap_or("constant delay");
    find(used_up, Headline::Late, format!("the latency budget is used up, by the rule for a {rule}"));
    let uncertified = summary.ticks_seen > 0 && !bound.certified;
    let reason = "nothing is certified for this law, gains and start".to_owned();
    find(uncertified, Headline::NotCertified, reason);
    for shortfall in bound.shortfalls.iter().filter(|_| uncertified) {
        find(true, Headline::NotCertified, shortfall.clone());
    }
    let (gaps, run) = (summary.monitor_gaps, summary.ticks_seen.saturating_add(summary.monitor_gaps));
    find(
        gaps > run / UNSEEN_PER,
        Headline::Inconclusive,
        format!("{gaps} of {run} ticks were not seen by the monitor: nothing is known of them"),
    );
    find(
        bound.certified && bound.checked == 0 && summary.ticks_seen > 0,
        Headline::NotChecked,
        "the law is certified, and no tick could be checked".to_owned(),
    );
    found
}
