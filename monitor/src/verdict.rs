//! What a run is worth in one word when nobody has said what was expected of it.

use crate::summary::{Summary, Verdict};

/// The verdict, the gravest finding first.
#[must_use]
pub fn judge_summary(summary: &Summary) -> Verdict {
    let bound = &summary.bound;
    let mut reasons = Vec::new();
    let mut status = "held";
    let mut find = |found: bool, word: &'static str, reason: String| {
        if found {
            if status == "held" {
                status = word;
            }
            reasons.push(reason);
        }
    };
    find(summary.ticks_seen == 0, "no data", "no tick was seen".to_owned());
    find(
        bound.violations_delay_aware > 0,
        "violated",
        format!("{} ticks broke the bound for another reason than latency", bound.violations_delay_aware),
    );
    let by_latency = bound.violations.saturating_sub(bound.violations_delay_aware);
    find(by_latency > 0, "late", format!("{by_latency} ticks broke the bound, and latency suffices as the cause"));
    find(bound.budget_used.is_some_and(|used| used >= 1.0), "late", "the latency budget [11] is used up".to_owned());
    let uncertified = summary.ticks_seen > 0 && !bound.certified;
    find(uncertified, "not certified", "nothing is certified for this law, gains and start".to_owned());
    for shortfall in bound.shortfalls.iter().filter(|_| uncertified) {
        find(true, "not certified", shortfall.clone());
    }
    find(
        bound.certified && bound.checked == 0 && summary.ticks_seen > 0,
        "not checked",
        "the law is certified, and no tick could be checked".to_owned(),
    );
    Verdict { status: status.to_owned(), reasons }
}
