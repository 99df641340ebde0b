//! The study without a group: options, the order of the runs, runs added up, and the recommendation on tables with
//! known answers.

use clap::Parser;
use loopbound_monitor::Summary;
use loopbound_monitor::hops::Hops;
use loopbound_monitor::verdict::blocks::Blocks;
use loopbound_monitor::verdict::comparison::Estimate;

use super::advice::*;
use super::case::*;
use super::cpu::CpuUse;
use super::*;
use crate::commands::study::load::background::Kind;

#[derive(Debug, Parser)]
struct Line {
    #[command(flatten)]
    args: LoadArgs,
}

/// The plan of these options, or the message with which they are refused.
pub(super) fn plan(options: &str) -> Result<Plan, String> {
    let words = std::iter::once("load").chain(options.split_whitespace());
    let line = Line::try_parse_from(words).map_err(|e| e.to_string())?;
    line.args.plan().map_err(|e| e.to_string())
}

#[test]
fn an_option_that_is_refused_is_named_with_what_is_allowed() {
    for (options, named, allowed) in [
        ("--rates 1", "--rates", "kHz"),
        ("--rates 1kHz,900kHz", "--rates", "50kHz"),
        ("--wakeups hybrid,poll", "--wakeups", "event"),
        ("--loads heavy", "--loads", "memory-io"),
        ("--privileges maybe", "--privileges", "without"),
        ("--duration 3", "--duration", "20ms"),
        ("--duration 1s --rounds 3", "--duration", "at least 1200ms"),
        ("--rounds 0", "--rounds", "1 to 100"),
        ("--quantile p98", "--quantile", "p99.9"),
        ("--missed-max 1", "--missed-max", "per cent"),
        ("--cpu-max=-5%", "--cpu-max", "not negative"),
        ("--room 120%", "--room", "100 %"),
        ("--set controller.law=ctc", "controller.law", "robust-ff"),
    ] {
        let message = plan(options).unwrap_err();
        assert!(message.contains(named) && message.contains(allowed), "{options}: {message}");
    }
}

#[test]
fn the_default_takes_less_than_ten_minutes_and_the_quick_study_less_than_a_minute_and_a_half() {
    let (default, quick) = (plan("").unwrap(), plan("--quick").unwrap());
    assert_eq!((default.runs(), quick.runs()), (4 * 2 * 4 * 3 * 3, 24));
    assert!(default.estimate_s() < 600.0 && quick.estimate_s() < 90.0);
    // Eight blocks of 250 ms are what an interval takes, after the start-up.
    assert!(quick.run_ns >= 2_200_000_000);
    let own = plan("--quick --rates 2kHz,2kHz --wakeups spin --loads none --privileges with --duration 2s --rounds 2");
    let own = own.unwrap();
    assert_eq!((own.cases.len(), own.runs(), own.run_ns), (1, 2, 1_000_000_000), "what is given twice is run once");
}

#[test]
fn every_round_runs_every_case_once_and_begins_elsewhere() {
    let plan = plan("").unwrap();
    let orders: Vec<Vec<usize>> = (0..plan.rounds).map(|round| plan.round(round).collect()).collect();
    for order in &orders {
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.iter().copied().eq(0..plan.cases.len()));
    }
    assert!(orders[0][0] != orders[1][0] && orders[1][0] != orders[2][0] && orders[0][0] != orders[2][0]);
}

#[test]
fn a_case_without_privileges_asks_for_none_and_keeps_all_else() {
    let plan = plan("--rates 2kHz --wakeups block --privileges without --set plant.gravity=1.62").unwrap();
    let scenario = plan.cases[0].apply(&plan.base);
    assert_eq!(
        (scenario.realtime.priority, scenario.realtime.lock_memory, scenario.realtime.dma_latency),
        (0, false, false)
    );
    assert_eq!(
        (scenario.loop_.rate.0.to_bits(), scenario.plant.gravity.to_bits()),
        (2e3f64.to_bits(), 1.62f64.to_bits())
    );
}

fn run(ticks: u64, skipped: u64, round_trip_ns: u64, missed: &[(&str, u64)]) -> Run {
    let mut hops = Hops::default();
    (0..ticks).for_each(|_| hops.of_mut(Hop::RoundTrip).record(round_trip_ns));
    let mut summary = Summary { ticks, overruns: u64::from(skipped > 0), ..Summary::default() };
    summary.counters.insert("skipped".to_owned(), skipped);
    summary.missed_ticks_by_cause = missed.iter().map(|(cause, n)| ((*cause).to_owned(), *n)).collect();
    Run { summary, hops, blocks: Blocks::new(1_000_000), cpu: CpuUse::default() }
}

#[test]
fn runs_add_up_and_missed_ticks_count_over_all_that_were_due() {
    let plan = plan("--quick").unwrap();
    let mut measured = Measured::default();
    measured.add(run(900, 0, 1_000, &[(HOST, 2), ("page_fault", 1)]));
    measured.add(run(90, 10, 900_000, &[(HOST, 10)]));
    let row = measured.row(&plan.cases[0], Quantile::P99);
    let trip = row.latency_ns.round_trip;
    assert_eq!((row.runs, row.ticks, row.missed_ticks, row.overruns, trip.n), (2, 1000, 13, 1, 990));
    assert_eq!((row.missed_share, row.missed_by_host_share), (Some(0.013), Some(0.012)));
    // 9 % of all ticks are slow: the 99 % quantile is theirs, though one run of two has none of them.
    assert_eq!((trip.p50, trip.max), (Some(1_000.0), Some(900_000.0)));
    assert!(trip.p99.unwrap() > 890_000.0);
    assert_eq!((row.latency, row.cpu, row.e_proven_rad), (None, None, None), "no block, no reading: no figure");
}

const LIMITS: Limits = Limits { missed_max: 0.01, cpu_max: 1.5 };

/// A row of the made-up table: latency in µs, misses and CPU as shares.
fn row(rate_hz: f64, wakeup: &str, load: Kind, latency_us: f64, w: Option<f64>, missed: f64, cpu: f64) -> Row {
    let near = |factor: f64| Some(latency_us * 1e3 * factor);
    let latency = Estimate { value_ns: latency_us * 1e3, lower_ns: near(0.95), upper_ns: near(1.05) };
    Row {
        rate_hz,
        wakeup: wakeup.to_owned(),
        load,
        runs: 3,
        ticks: 3000,
        latency: Some(latency),
        missed_share: Some(missed),
        missed_by_host_share: Some(missed / 2.0),
        cpu: Some(cpu),
        e_proven_rad: w,
        e_proven_lower_rad: w,
        e_proven_upper_rad: w,
        ..Row::default()
    }
}

/// Intervals of ±10 % around the ratio of the rows' latencies.
fn advice_on(rows: &[Row]) -> Advice {
    let latency = |at: usize| rows[at].latency.map_or(f64::NAN, |latency| latency.value_ns);
    advise(rows, Quantile::P99, LIMITS, |a, b| {
        let ratio = latency(b) / latency(a);
        Some(Ratio { ratio, lower: Some(0.9 * ratio), upper: Some(1.1 * ratio) })
    })
}

fn chosen(advice: &Advice) -> Option<(f64, &str)> {
    advice.choice.map(|at| (advice.settings[at].rate_hz, advice.settings[at].wakeup.as_str()))
}

#[test]
fn the_smallest_w_within_the_limits_is_chosen_and_settings_beyond_them_are_not() {
    let rows = [
        row(1e3, "hybrid", Kind::None, 10.0, Some(0.30), 0.001, 0.2),
        row(1e3, "block", Kind::None, 30.0, Some(0.30), 0.001, 0.1),
        row(5e3, "hybrid", Kind::None, 20.0, Some(0.05), 0.02, 0.9),
        row(5e3, "spin", Kind::None, 10.0, Some(0.05), 0.001, 1.9),
        row(5e3, "block", Kind::None, 40.0, Some(0.06), 0.001, 0.4),
    ];
    let advice = advice_on(&rows);
    assert_eq!(chosen(&advice), Some((5e3, "block")));
    assert!(advice.clear && advice.rates.iter().all(|rate| rate.clear), "{advice:?}");
    let against = |at: usize| advice.settings[at].against.join(", ");
    assert!(against(2).contains("2.0 % of ticks missed, allowed: 1.0 %"), "{}", against(2));
    assert!(against(3).contains("190 % of a core, allowed: 150 %"), "{}", against(3));
    // At 1 kHz both are feasible: the faster one wins by a factor of 3.
    let (next, ratio) = advice.rates[0].runner_up.unwrap();
    assert_eq!((advice.settings[next].wakeup.as_str(), ratio.ratio.to_bits()), ("block", 3f64.to_bits()));
    assert!(advice.rates[0].words.contains("3.00 times as late (95 %: 2.70 to 3.30)"), "{}", advice.rates[0].words);
    assert!(
        advice.words.contains("5kHz, `block`") && advice.words.contains("1kHz, 5.00 times that."),
        "{}",
        advice.words
    );
}

#[test]
fn a_setting_is_judged_by_its_worst_load() {
    let rows = [
        row(1e3, "hybrid", Kind::None, 5.0, Some(0.3), 0.0, 0.2),
        row(1e3, "hybrid", Kind::Cpu, 900.0, None, 0.0, 0.2),
        row(1e3, "block", Kind::None, 30.0, Some(0.3), 0.0, 0.1),
        row(1e3, "block", Kind::Cpu, 50.0, Some(0.3), 0.0, 0.1),
    ];
    let advice = advice_on(&rows);
    assert_eq!(chosen(&advice), Some((1e3, "block")));
    assert_eq!(advice.settings[0].against, ["nothing is certified at its latency under load cpu"]);
    let of_block = &advice.settings[1];
    assert_eq!((of_block.worst_row, of_block.latency_ns.to_bits()), (3, 50e3f64.to_bits()));
    assert!(advice.rates[0].words.contains("worst load: cpu") && advice.rates[0].words.contains("No other setting"));
}

#[test]
fn for_one_load_alone_the_others_do_not_count() {
    let rows = [
        row(1e3, "hybrid", Kind::None, 5.0, Some(0.3), 0.0, 0.2),
        row(1e3, "hybrid", Kind::Cpu, 900.0, None, 0.0, 0.2),
        row(1e3, "block", Kind::None, 30.0, Some(0.3), 0.0, 0.1),
        row(1e3, "block", Kind::Cpu, 50.0, Some(0.3), 0.0, 0.1),
    ];
    let ratio = |a: usize, b: usize| {
        assert!(a % 2 == b % 2, "rows {a} and {b} are of two loads");
        Some(Ratio { ratio: 6.0, lower: Some(5.0), upper: Some(7.0) })
    };
    let [none, cpu] = &for_each_load(&rows, Quantile::P99, LIMITS, ratio)[..] else { panic!("two loads") };
    let choice = |only: &ForLoad| only.choice.as_ref().map(|setting| (setting.wakeup.clone(), setting.worst_row));
    assert_eq!((none.load, choice(none)), (Kind::None, Some(("hybrid".to_owned(), 0))));
    assert_eq!((cpu.load, choice(cpu)), (Kind::Cpu, Some(("block".to_owned(), 3))));
    assert!(for_each_load(&rows[..1], Quantile::P99, LIMITS, ratio).is_empty());
}

#[test]
fn what_the_data_do_not_tell_apart_is_called_so_and_the_cheaper_one_is_taken() {
    let rows = [
        row(1e3, "spin", Kind::None, 10.0, Some(0.3), 0.0, 1.4),
        row(1e3, "hybrid", Kind::None, 10.5, Some(0.3), 0.0, 0.3),
        row(1e3, "block", Kind::None, 30.0, Some(0.3), 0.0, 0.1),
    ];
    let advice = advice_on(&rows);
    assert_eq!(chosen(&advice), Some((1e3, "hybrid")), "block takes less still, but is told apart from the best");
    assert!(!advice.rates[0].clear && advice.rates[0].words.contains("No clear winner: `spin`"), "{advice:?}");
    assert!(advice.rates[0].words.contains("of the 2 that these data"), "{}", advice.rates[0].words);
}

#[test]
fn from_too_few_data_nothing_is_recommended() {
    let rows = [
        row(1e3, "spin", Kind::None, 10.0, Some(0.3), 0.0, 1.4),
        row(1e3, "block", Kind::None, 132.9, Some(0.3), 0.0, 0.1),
    ];
    // One is thirteen times as late as the other, and there is no interval.
    let none = advise(&rows, Quantile::P99, LIMITS, |_, _| Some(Ratio { ratio: 13.29, lower: None, upper: None }));
    assert_eq!((chosen(&none), none.clear), (None, false));
    assert!(none.rates[0].too_few_data && none.rates[0].words.contains("--duration"), "{}", none.rates[0].words);
    assert!(!none.rates[0].words.contains("winner") && none.words.contains("too few data"), "{}", none.words);
    // The same where a latency has no interval of its own.
    let mut rows = rows;
    rows.iter_mut().for_each(|row| row.latency.iter_mut().for_each(|latency| latency.lower_ns = None));
    let none = advice_on(&rows);
    assert_eq!(chosen(&none), None);
    assert!(none.rates[0].too_few_data, "{none:?}");
    assert!(none.settings[0].against[0].contains("too few data"), "{:?}", none.settings[0]);
    // Where misses rule a setting out, no data would help.
    rows.iter_mut().for_each(|row| row.missed_share = Some(0.5));
    assert!(!advice_on(&rows).rates[0].too_few_data);
}

#[test]
fn rates_that_allow_the_same_w_are_decided_by_cpu_and_overlapping_ones_are_no_clear_win() {
    let rows = [
        row(1e3, "hybrid", Kind::None, 10.0, Some(0.30), 0.0, 0.4),
        row(2e3, "hybrid", Kind::None, 10.0, Some(0.30), 0.0, 0.8),
    ];
    let advice = advice_on(&rows);
    assert_eq!((chosen(&advice), advice.clear), (Some((1e3, "hybrid")), false));
    let mut rows = [rows[0].clone(), row(2e3, "hybrid", Kind::None, 10.0, Some(0.28), 0.0, 0.8)];
    rows[1].e_proven_upper_rad = Some(0.31);
    let advice = advice_on(&rows);
    assert_eq!((chosen(&advice), advice.clear), (Some((2e3, "hybrid")), false));
    assert!(advice.words.contains("no clear winner"), "{}", advice.words);
}

#[test]
fn where_nothing_is_feasible_nothing_is_recommended_and_every_reason_is_given() {
    let mut rows = [
        row(1e3, "hybrid", Kind::None, 10.0, Some(0.3), 0.5, 0.4),
        row(1e3, "block", Kind::None, 10.0, Some(0.3), 0.0, 0.4),
        Row { rate_hz: 1e3, wakeup: "event".into(), ..Row::default() },
    ];
    rows[1].not_to_be_had = Some("SCHED_FIFO is refused here".to_owned());
    let advice = advice_on(&rows);
    assert_eq!((advice.choice, advice.rates[0].best), (None, None));
    for (at, why) in
        ["50 % of ticks missed", "not to be had: SCHED_FIFO is refused here", "not measured under load none"]
            .into_iter()
            .enumerate()
    {
        assert!(advice.settings[at].against[0].contains(why), "{:?}", advice.settings[at]);
    }
    // Which of them came nearest is said at once.
    assert!(advice.rates[0].words.contains("`block` with privileges: not to be had"), "{}", advice.rates[0].words);
    assert!(advice_on(&[]).choice.is_none());
}

fn report(rows: Vec<Row>) -> Report {
    let advice = advice_on(&rows);
    Report {
        version: REPORT_VERSION,
        written: "2026-01-31T12:00:00.250Z".into(),
        command: "loopbound study load --out <a>".into(),
        host: BTreeMap::from([("kernel".to_owned(), "6.1".into()), ("processor".to_owned(), "A & B".into())]),
        rounds: 3,
        run_s: 1.0,
        runs_planned: 6,
        interrupted: true,
        quantile: Quantile::P99,
        limits: LIMITS,
        for_each_load: Vec::new(),
        room: 0.6,
        rows,
        advice,
        check: None,
    }
}

#[test]
fn what_is_written_shows_every_case_also_one_that_is_not_to_be_had_with_its_reason() {
    let refused =
        Row { not_to_be_had: Some("no \"rights\", here".into()), ..row(2e3, "event", Kind::Cpu, 1.0, None, 0.0, 0.0) };
    let refused = Row { runs: 0, latency: None, ..refused };
    let report = report(vec![row(1e3, "hybrid", Kind::None, 12.0, Some(0.3), 0.004, 0.4), refused]);
    let csv = text::csv(&report);
    assert_eq!(csv.lines().count(), 3);
    assert!(csv.lines().nth(2).unwrap().contains("\"not to be had: no \"\"rights\"\", here\""), "{csv}");
    let page = page::page(&report);
    assert!(
        !page.contains("{{") && !page.contains("<script") && !page.contains("src=") && !page.contains("href="),
        "filled, and fetches nothing"
    );
    assert!(
        page.contains("A &amp; B") && page.contains("--out &lt;a&gt;") && page.contains("not to be had: no &quot;")
    );
    let markdown = text::markdown(&report);
    for text in [&markdown, &page] {
        assert!(text.contains("kernel 6.1") && text.contains("Interrupted") && text.contains("Few data"), "{text}");
    }
    let figure = pictures::maps(&report);
    let svg = loopbound_monitor::chart::to_svg(&figure, loopbound_monitor::chart::Theme::Auto);
    assert!(svg.contains(">0.20+0.20<") && svg.contains(">12.0<") && svg.contains(">—<"), "{svg}");
}
