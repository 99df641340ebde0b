use super::*;
use crate::authority::Authority;
use loopbound_scenario::Scenario;
use loopbound_shared::event::{CommandKind, Decision, HappeningKind, ReplyKind};
use loopbound_shared::sample::Torque;

const PERIOD_NS: u64 = 1_000_000;

/// V of every law, and the level that all are certified to.
struct Physics(Option<(f64, f64)>);

impl CertifiedLevels for Physics {
    fn level(&self, _: u32) -> Option<(f64, f64)> {
        self.0
    }
}

const CALM: Physics = Physics(Some((0.5, 1.0)));

/// Two controllers that answer every tick, 1 active with torque 10, 2 with torque 12.
struct Bench {
    authority: Authority,
    tick: u64,
    tau: [f64; 2],
    answers: [bool; 2],
    bound_held: bool,
    acted: Option<(u32, f64)>,
}

impl Bench {
    fn new(change: impl FnOnce(&mut SwapRules)) -> Self {
        let mut rules = SwapRules::of(&Scenario::default());
        change(&mut rules);
        let mut authority = Authority::new(1, rules);
        authority.add(1).unwrap();
        authority.add(2).unwrap();
        authority.appoint(1).unwrap();
        Self { authority, tick: 0, tau: [10.0, 12.0], answers: [true; 2], bound_held: true, acted: None }
    }

    fn ask(&mut self, at_tick: u64, blend_ticks: u64, force: bool) -> Reply {
        self.authority.request_swap(&Command {
            kind: CommandKind::Swap.code(),
            controller: 2,
            tick: at_tick,
            ns: blend_ticks * PERIOD_NS,
            option: u64::from(force),
            ..Command::zeroed()
        })
    }

    fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.tick(&CALM);
        }
    }

    fn tick(&mut self, physics: &Physics) {
        let (tick, from_ns) = (self.tick, self.tick * PERIOD_NS);
        self.authority.switch_if_due(tick, self.bound_held, physics);
        self.authority.open(tick, from_ns + 500_000);
        self.acted = None;
        for (writer, (tau, answers)) in (1..).zip(self.tau.into_iter().zip(self.answers)) {
            let mut torque = Torque {
                tick,
                published_ns: from_ns,
                state_published_ns: from_ns,
                writer,
                epoch: self.authority.active().1,
                links: 1,
                ..Torque::zeroed()
            };
            torque.tau[0] = tau;
            if answers && let Some(applied) = self.authority.offer(&torque, from_ns + 1000) {
                self.acted = Some((applied.writer, applied.tau[0]));
            }
        }
        if let Some(applied) = self.authority.grace_passed(from_ns + 500_000) {
            self.acted = Some((applied.writer, applied.tau[0]));
        }
        let decision = self.authority.decision().unwrap_or(Decision::Held);
        self.authority.journal.count_decision(decision);
        self.tick += 1;
    }

    fn outcome(&self) -> (Option<ReplyKind>, Option<Refusal>, u64) {
        let reply = self.authority.swap_status(2);
        (ReplyKind::from_code(reply.kind), Refusal::from_code(reply.reason), reply.tick)
    }

    fn happened(&mut self, kind: HappeningKind) -> usize {
        let (happenings, used) = self.authority.journal.take_happenings();
        happenings[..used].iter().filter(|h| h.kind == kind.code()).count()
    }
}

#[test]
fn a_swap_without_a_tick_waits_for_its_gate_and_takes_authority_between_two_ticks() {
    let mut bench = Bench::new(|rules| rules.consecutive = 20);
    bench.run(5);
    assert_eq!(ReplyKind::from_code(bench.ask(0, 0, false).kind), Some(ReplyKind::Pending));
    bench.run(15);
    assert_eq!((bench.outcome().0, bench.acted), (Some(ReplyKind::Pending), Some((1, 10.0))));
    bench.run(1);
    assert_eq!(bench.outcome(), (Some(ReplyKind::Done), None, 20));
    assert_eq!((bench.acted, bench.authority.active()), (Some((2, 12.0)), (2, 2)));
    assert_eq!(bench.authority.swap_status(2).value.to_bits(), 2.0_f64.to_bits(), "the torque step");
    assert_eq!(bench.authority.journal.counters.missed, 0);
}

#[test]
fn a_named_tick_is_kept_exactly_or_refused() {
    let mut bench = Bench::new(|_| {});
    bench.ask(50, 0, false);
    bench.run(50);
    assert_eq!(bench.acted, Some((1, 10.0)));
    bench.run(1);
    assert_eq!((bench.acted, bench.outcome()), (Some((2, 12.0)), (Some(ReplyKind::Done), None, 50)));
    let mut early = Bench::new(|_| {});
    early.ask(10, 0, false);
    early.run(12);
    assert_eq!(early.outcome(), (Some(ReplyKind::Refused), Some(Refusal::NotOnTime), 10));
    assert_eq!((early.authority.active().0, early.happened(HappeningKind::SwapRefused)), (1, 1));
    assert_eq!(Refusal::from_code(early.ask(5, 0, false).reason), Some(Refusal::TickPassed));
}

#[test]
fn a_named_tick_is_not_kept_waiting_by_a_swap_that_waits_for_its_gate() {
    let mut bench = Bench::new(|rules| rules.dwell_ticks = 0);
    bench.authority.add(3).unwrap();
    // Controller 3 never answers, so its swap waits.
    bench.authority.request_swap(&Command { controller: 3, kind: CommandKind::Swap.code(), ..Command::zeroed() });
    bench.ask(30, 0, false);
    bench.run(31);
    assert_eq!((bench.authority.active().0, bench.outcome().2), (2, 30));
    let waiting = bench.authority.swap_status(3);
    assert_eq!(ReplyKind::from_code(waiting.kind), Some(ReplyKind::Pending));
}

#[test]
fn the_gate_names_its_reason_with_the_number_found_and_the_one_allowed() {
    let refusal = |bench: &Bench| {
        let reply = bench.authority.swap_status(2);
        (Refusal::from_code(reply.reason), reply.value, reply.limit)
    };
    let mut step = Bench::new(|rules| rules.torque_step_nm = 1.5);
    step.ask(30, 0, false);
    step.run(31);
    assert_eq!(refusal(&step), (Some(Refusal::TorqueStep), 2.0, 1.5));

    let mut level = Bench::new(|_| {});
    level.ask(30, 0, false);
    level.run(30);
    level.tick(&Physics(Some((1.25, 1.0))));
    assert_eq!(refusal(&level), (Some(Refusal::OutsideLevel), 1.25, 1.0));

    let mut silent = Bench::new(|rules| rules.timeout_ticks = 40);
    silent.answers[1] = false;
    silent.ask(0, 0, false);
    silent.run(39);
    assert_eq!(silent.outcome().0, Some(ReplyKind::Pending));
    silent.run(2);
    assert_eq!(refusal(&silent).0, Some(Refusal::NotOnTime));

    let mut own = Bench::new(|_| {});
    own.authority.appoint(2).unwrap();
    own.ask(0, 0, false);
    own.run(1);
    assert_eq!(refusal(&own).0, Some(Refusal::AlreadyActive));

    let mut gone = Bench::new(|_| {});
    gone.ask(0, 0, false);
    gone.authority.remove(2).unwrap();
    gone.run(1);
    assert_eq!(refusal(&gone).0, Some(Refusal::Gone));

    let mut stranger = Bench::new(|_| {});
    stranger.authority.remove(2).unwrap();
    assert_eq!(Refusal::from_code(stranger.ask(0, 0, false).reason), Some(Refusal::UnknownController));
}

#[test]
fn two_swaps_within_the_dwell_time_are_one_too_many() {
    let mut bench = Bench::new(|rules| rules.dwell_ticks = 100);
    bench.ask(0, 0, false);
    bench.run(30);
    assert_eq!(bench.authority.active().0, 2);
    let back = Command { kind: CommandKind::Swap.code(), controller: 1, tick: 60, ..Command::zeroed() };
    bench.authority.request_swap(&back);
    bench.run(40);
    assert_eq!(Refusal::from_code(bench.authority.swap_status(1).reason), Some(Refusal::Dwell));
    assert_eq!(bench.authority.active().0, 2);
}

#[test]
fn force_skips_the_gate_and_not_the_safety_checks() {
    let mut forced = Bench::new(|rules| (rules.consecutive, rules.torque_step_nm) = (1000, 0.1));
    forced.ask(3, 0, true);
    forced.run(4);
    assert_eq!((forced.acted, forced.outcome().0), (Some((2, 12.0)), Some(ReplyKind::Done)));

    let mut silent = Bench::new(|_| {});
    silent.answers[1] = false;
    silent.ask(3, 0, true);
    silent.run(4);
    assert_eq!(silent.outcome().1, Some(Refusal::NotOnTime));

    let mut beyond = Bench::new(|rules| rules.torque_limit_nm[0] = 11.0);
    beyond.ask(3, 0, true);
    beyond.run(4);
    let reply = beyond.authority.swap_status(2);
    assert_eq!((Refusal::from_code(reply.reason), reply.value, reply.limit), (Some(Refusal::NotFinite), 12.0, 11.0));
}

#[test]
fn a_cross_fade_moves_smoothly_from_the_old_torque_to_the_new() {
    let mut bench = Bench::new(|rules| rules.torque_step_nm = 0.0);
    bench.tau = [0.0, 1024.0];
    bench.ask(40, 3, false);
    bench.run(40);
    let mut acted = Vec::new();
    for _ in 0..5 {
        bench.run(1);
        acted.push(bench.acted);
    }
    // 10 x³ − 15 x⁴ + 6 x⁵ at quarters.
    assert_eq!(acted, [106.0, 512.0, 918.0, 1024.0, 1024.0].map(|tau| Some((2, tau))));
}

#[test]
fn a_long_cross_fade_begins_and_ends_without_a_step() {
    let mut bench = Bench::new(|_| {});
    bench.tau = [0.0, 1.0];
    bench.ask(40, 20, false);
    bench.run(39);
    let mut acted = vec![0.0];
    for _ in 0..22 {
        bench.run(1);
        acted.extend(bench.acted.map(|(_, tau)| tau));
    }
    let steps: Vec<f64> = acted.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let (first, last) = (steps.iter().copied().find(|step| *step > 0.0), steps.iter().copied().rfind(|s| *s > 0.0));
    assert!(first.is_some_and(|step| step < 0.0011) && last.is_some_and(|step| step < 0.0011), "{steps:?}");
    assert!(steps.iter().all(|step| (0.0..1.9 / 21.0).contains(step)), "{steps:?}");
}

#[test]
fn a_cross_fade_goes_on_with_one_of_the_two_when_the_other_is_silent() {
    for silent in [0, 1] {
        let mut bench = Bench::new(|_| {});
        bench.ask(40, 10, false);
        bench.run(43);
        bench.answers[silent] = false;
        bench.run(1);
        let (writer, tau) = if silent == 0 { (2, 12.0) } else { (1, 10.0) };
        assert_eq!((bench.acted, bench.authority.journal.counters.missed), (Some((writer, tau)), 0));
        assert_eq!(bench.authority.active().0, 2, "a single miss is no verdict");
    }
}

#[test]
fn the_old_one_may_leave_in_the_middle_of_a_cross_fade() {
    let mut bench = Bench::new(|_| {});
    bench.ask(40, 10, false);
    bench.run(43);
    bench.authority.remove(1).unwrap();
    bench.run(1);
    assert_eq!((bench.acted, bench.authority.decision()), (Some((2, 12.0)), Some(Decision::Active)));
}

#[test]
fn v_above_its_certified_bound_rolls_the_swap_back_while_it_is_watched_and_not_after() {
    let mut bench = Bench::new(|rules| rules.rollback_ticks = 50);
    bench.ask(30, 0, false);
    bench.run(40);
    bench.bound_held = false;
    bench.run(1);
    assert_eq!(bench.acted, Some((1, 10.0)));
    assert_eq!(bench.outcome(), (Some(ReplyKind::RolledBack), Some(Refusal::BoundExceeded), 40));
    assert_eq!(bench.happened(HappeningKind::Rollback), 1);

    let mut watched = Bench::new(|rules| rules.rollback_ticks = 50);
    watched.ask(30, 0, false);
    watched.run(80);
    watched.bound_held = false;
    watched.run(5);
    assert_eq!((watched.authority.active().0, watched.outcome().0), (2, Some(ReplyKind::Done)));
}

#[test]
fn a_new_controller_that_is_late_once_is_stood_in_for_and_stays() {
    let mut bench = Bench::new(|_| {});
    bench.ask(30, 0, false);
    bench.run(40);
    bench.answers[1] = false;
    bench.run(1);
    assert_eq!((bench.acted, bench.authority.journal.counters.missed), (Some((1, 10.0)), 0));
    assert_eq!(bench.happened(HappeningKind::StoodIn), 1);
    bench.answers[1] = true;
    bench.run(1);
    assert_eq!((bench.acted, bench.authority.active()), (Some((2, 12.0)), (2, 2)));
    assert_eq!(bench.outcome().0, Some(ReplyKind::Done));
}

#[test]
fn a_new_controller_that_falls_silent_costs_no_tick_and_the_swap_is_rolled_back() {
    let mut bench = Bench::new(|rules| (rules.rollback_misses, rules.rollback_window) = (3, 10));
    bench.ask(30, 0, false);
    bench.run(40);
    bench.answers[1] = false;
    for _ in 0..4 {
        bench.run(1);
        assert_eq!((bench.acted, bench.authority.journal.counters.missed), (Some((1, 10.0)), 0));
    }
    assert_eq!(bench.outcome(), (Some(ReplyKind::RolledBack), Some(Refusal::Deadlines), 43));
    assert_eq!(bench.authority.active().0, 1);
}

#[test]
fn a_new_controller_that_talks_nonsense_is_fenced_at_once() {
    let mut bench = Bench::new(|_| {});
    bench.ask(30, 0, false);
    bench.run(40);
    bench.tau[1] = f64::NAN;
    bench.run(1);
    assert_eq!((bench.acted, bench.authority.journal.counters.failovers), (Some((1, 10.0)), 1));
    assert_eq!(bench.outcome(), (Some(ReplyKind::RolledBack), Some(Refusal::Deadlines), 40));
}

#[test]
fn too_many_misses_among_the_last_ticks_roll_back_when_the_old_one_is_fit_again() {
    let mut bench = Bench::new(|rules| (rules.rollback_misses, rules.rollback_window) = (3, 10));
    bench.ask(30, 0, false);
    bench.run(32);
    // Both are silent: nobody can take over within the tick, and there is nobody to go back to.
    bench.answers = [false; 2];
    bench.run(5);
    assert_eq!((bench.authority.active().0, bench.authority.journal.counters.missed), (2, 5));
    bench.answers = [true; 2];
    bench.run(2);
    assert_eq!(bench.outcome().1, Some(Refusal::Deadlines));
    assert_eq!(bench.acted, Some((1, 10.0)));
}

#[test]
fn the_outcomes_of_many_swaps_take_no_more_room_than_a_few() {
    let mut bench = Bench::new(|rules| rules.dwell_ticks = 0);
    for _ in 0..20 {
        for controller in [2, 1] {
            bench.authority.request_swap(&Command {
                kind: CommandKind::Swap.code(),
                controller,
                option: 1,
                ..Command::zeroed()
            });
            bench.run(2);
            assert_eq!(bench.authority.active().0, controller);
        }
    }
    assert_eq!(bench.authority.swaps.outcomes.len(), 2);
}
