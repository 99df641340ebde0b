use super::*;
use crate::summary::{BoundSummary, LawSummary, MissingPrivilege, Quantiles};

fn full() -> Summary {
    let mut summary = Summary { links: 3, rate_hz: Some(1000.0), mode: "realtime".to_owned(), ..Summary::default() };
    summary.verdict.status = "held".to_owned();
    summary.ticks = 10_000;
    summary.latency_ns.round_trip =
        Quantiles { n: 9900, p50: Some(8_400.0), p99: Some(21_000.0), max: Some(1.5e6), ..Quantiles::default() };
    summary.late_ticks_by_cause.insert("run_queue_delay".to_owned(), 7);
    summary.processes = vec![crate::summary::ProcessSummary {
        role: "plant".to_owned(),
        missing: vec![MissingPrivilege {
            step: "sched_fifo".to_owned(),
            cost: "other processes can preempt the loop".to_owned(),
            remedy: "`sudo prlimit --rtprio=99 --pid $$`, or run as root, or find an administrator who does so"
                .to_owned(),
        }],
        ..crate::summary::ProcessSummary::default()
    }];
    summary
}

#[test]
fn the_screen_begins_with_the_verdict_and_no_line_is_wider_than_asked() {
    for width in [0, 60, 80, 100, 4000] {
        let text = render(&full(), width, false);
        assert!(text.starts_with("HELD: "), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= width.clamp(60, 100)), "{text}");
        assert!(!text.contains('\x1b'));
    }
    assert!(render(&full(), 100, true).starts_with("\x1b[1;32mHELD"));
}

#[test]
fn strangers_have_a_line_where_there_were_any() {
    let mut summary = full();
    summary.strangers = MessageKind::ALL.iter().map(|kind| (kind.name().to_owned(), 0)).collect();
    assert!(!render(&summary, 100, false).contains("strangers"));
    summary.strangers.insert("setpoint".to_owned(), 12);
    summary.strangers.insert("tick_record".to_owned(), 1);
    let text = render(&summary, 100, false);
    assert!(text.contains("strangers         12 setpoints, 1 tick record: refused"), "{text}");
}

#[test]
fn a_run_under_two_laws_shows_the_figures_of_each_with_its_ticks() {
    let mut summary = full();
    let of = |law: &str, controller: u32, c1: f64| LawSummary {
        controllers: vec![controller],
        ticks: 500,
        first_tick: Some(1),
        last_tick: Some(500),
        bound: BoundSummary {
            law: Some(law.to_owned()),
            checked: 500,
            c1: Some(c1),
            v_max: Some(2.0),
            ultimate_bound: Some(0.25),
            ultimate_bound_link: Some(0.125),
            ..BoundSummary::default()
        },
    };
    summary.bound = BoundSummary { laws: vec![of("robust", 1, 40.0), of("ctc", 2, 7.5)], ..of("ctc", 2, 7.5).bound };
    let text = render(&summary, 100, false);
    let one_line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    // V of `ctc` is no energy.
    for part in [
        "robust, controller 1: active for 500 ticks",
        "C1 = 40.0000 N·m;",
        "max 2.0000 J,",
        "ctc, controller 2",
        "η0 = 7.5000 rad/s²;",
        "max 2.0000 rad²/s²,",
    ] {
        assert_eq!(one_line.matches(part).count(), 1, "{part}: {text}");
    }
    let proven = "‖e‖ ≤ 0.2500 rad, and so each |e_i| ≤ 0.1250 rad";
    assert_eq!(one_line.matches(proven).count(), 2, "{text}");
}

#[test]
fn a_controller_of_ones_own_is_shown_by_its_name() {
    let mut summary = full();
    assert!(render(&summary, 100, false).contains("HELD: no announced law"));
    summary.bound.name = Some("my pd".to_owned());
    assert!(render(&summary, 100, false).contains("HELD: my pd (announced no law), n = 3"));
    summary.bound.law = Some("pd+g".to_owned());
    assert!(render(&summary, 100, false).contains("HELD: pd+g (my pd), n = 3"));
    summary.bound.name = summary.bound.law.clone();
    assert!(render(&summary, 100, false).contains("HELD: pd+g, n = 3"));
}

#[test]
fn figures_appear_in_the_units_that_suit_them_and_absent_ones_as_a_dash() {
    let text = render(&full(), 100, false);
    let row = text.lines().find(|line| line.trim_start().starts_with("round trip")).unwrap();
    let cells: Vec<&str> = row.split("  ").map(str::trim).filter(|cell| !cell.is_empty()).collect();
    assert_eq!(cells, ["round trip", "8.40 µs", "21.00 µs", "–", "1.50 ms", "9900"]);
    assert!(text.contains("7 run-queue delay") && text.contains("1 kHz"), "{text}");
    assert!(text.contains("no sched_fifo: other processes can preempt the loop"), "{text}");
}

#[test]
fn one_tick_is_no_ticks_anywhere_on_the_screen() {
    let mut summary = full();
    (summary.start_up_ticks, summary.tracking.n) = (1, 1);
    summary.bound = BoundSummary {
        certified: true,
        checked: 1,
        violations: 1,
        violations_promise: 1,
        verdicts: [("latency".to_owned(), 1)].into(),
        ..BoundSummary::default()
    };
    let text = render(&summary, 100, false);
    assert!(text.contains("1 tick of start-up is left out"), "{text}");
    let one_line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    let bound =
        "1 of 1 tick violated: 1 by the age of the torque, 0 otherwise; V above its certified bound after 1 tick;";
    assert!(one_line.contains(bound), "{text}");
    assert!(!one_line.contains(" 1 ticks") && !one_line.contains("(1 ticks"), "{text}");
}

#[test]
fn no_certified_figure_stands_beside_a_larger_one_without_the_reason() {
    let law = BoundSummary {
        certified: true,
        checked: 500,
        uub_radius: Some(0.8),
        w_norm_max_settled: Some(0.2),
        ultimate_bound: Some(0.25),
        ..BoundSummary::default()
    };
    let shown = |bound: &BoundSummary, norm_e_rad: f64| {
        let mut summary = Summary { bound: bound.clone(), ..full() };
        summary.tracking.max_norm_e_rad = Some(norm_e_rad);
        render(&summary, 100, false).split_whitespace().collect::<Vec<_>>().join(" ")
    };
    assert!(shown(&law, 0.1).contains("‖W‖ settled 0.2000 of 0.8000; certified in the long run: ‖e‖ ≤ 0.2500 rad"));
    assert!(!shown(&law, 0.1).contains("above this"));
    assert!(shown(&law, 0.3).contains("above this: V was still falling"));
    let far = BoundSummary { w_norm_max_settled: Some(0.9), ..law.clone() };
    let old = BoundSummary { violations: 3, ..far.clone() };
    for beyond in [&old, &BoundSummary { budget_used: Some(1.2), ..far.clone() }] {
        assert!(shown(beyond, 0.1).contains("the certificate is for continuous time, and this loop is sampled"));
    }
    let violated = BoundSummary { violations_delay_aware: 1, ..old };
    assert!(shown(&violated, 0.1).contains("above this, since the bound was violated"));
    // An exact model: nothing but that the error vanishes is certified, and a sampled loop keeps a rest of it.
    let exact = BoundSummary { ultimate_bound: Some(0.0), uub_radius: Some(0.0), ..far };
    let text = shown(&exact, 0.0014);
    assert!(text.contains("‖W‖ settled 0.9000; certified: ‖e‖ and ‖W‖ tend to 0 in continuous time"), "{text}");
    assert!(!text.contains('≤') && !text.contains("of 0.0000"), "{text}");
}

#[test]
fn every_count_that_has_no_line_of_its_own_appears_beside_the_overruns_with_its_words() {
    let mut summary = full();
    summary.counters = Counters::ALL.iter().map(|counter| (counter.name.to_owned(), 1)).collect();
    let text = render(&summary, 100, false).split_whitespace().collect::<Vec<_>>().join(" ");
    for counter in Counters::ALL.iter().filter(|counter| !COUNTED_ABOVE.contains(&counter.name)) {
        let shown = format!(", 1 {} {}", counter.unit, counter.words);
        assert!(text.contains(shown.trim_end()), "{shown}: {text}");
    }
}
