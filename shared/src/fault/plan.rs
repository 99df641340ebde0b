//! The faults of a scenario: which of them are injected into a process in a tick, and how
//!
//! A pure function of the scenario and the tick: any process can recompute it, and a run in lockstep repeats it. It injects
//! nothing itself.

use loopbound_model::rng::{Stream, uniform};
use loopbound_scenario::{Distribution, FaultKind, FaultSpec, PARETO_SHAPE_DEFAULT, Role, Scenario};

use super::FaultActions;

/// Random numbers of one fault in one tick: whether it is injected, and how long it delays.
const LANE_DUE: u32 = 0;
/// See [`LANE_DUE`].
const LANE_DELAY: u32 = 1;
/// Lanes of one fault, so that faults with the same seed are independent.
const LANES: u32 = 2;
/// Torque of a rogue without a value of its own (N·m): far from anything a law would say.
const ROGUE_NM: f64 = 100.0;

/// One fault with its window in ticks.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    kind: FaultKind,
    first: u64,
    /// The first tick after the window.
    end: u64,
    every: u64,
    probability: f64,
    seed: u64,
    lane: u32,
    delay: Delay,
    hang_ns: u64,
    glitch: (usize, f64),
    clock_step_ns: i64,
}

/// How long a delay is.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Delay {
    distribution: Distribution,
    /// Constant, least, or scale (ns).
    from_ns: u64,
    /// Most (ns).
    to_ns: u64,
    shape: f64,
}

impl Delay {
    /// The delay (ns) for a uniform number u in [0, 1).
    ///
    /// Pareto's inverse distribution is from · (1 − u)^(−1/shape); it is cut at `to_ns`, so the mean is finite for any shape.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the value is not negative, and the cast saturates before the cut"
    )]
    fn ns(self, u: f64) -> u64 {
        let from = self.from_ns as f64;
        match self.distribution {
            Distribution::Constant => self.from_ns,
            Distribution::Uniform => {
                let span = self.to_ns.saturating_sub(self.from_ns) as f64;
                self.from_ns.saturating_add((u * span) as u64).min(self.to_ns)
            }
            Distribution::Pareto => ((from * libm::pow(1.0 - u, -1.0 / self.shape)) as u64).min(self.to_ns),
        }
    }
}

impl Entry {
    fn new(index: u32, spec: &FaultSpec, scenario: &Scenario) -> Self {
        let period_ns = scenario.period_ns();
        let first = spec.at.map_or(0, |at| at.tick(period_ns));
        let for_ticks = spec.for_.map(|length| length.tick(period_ns).max(1));
        let hang = spec.kind == FaultKind::Hang;
        let alone = spec.every.is_none() && spec.probability.is_none();
        // The `for` of a hang is its own length, so its window is open unless it is injected in one tick only.
        let window = if hang { None } else { for_ticks };
        let end = match window {
            Some(ticks) => first.saturating_add(ticks),
            None if alone && spec.at.is_some() => first + 1,
            None => u64::MAX,
        };
        let late_by = spec.delay.map_or(period_ns / 10, |delay| delay.ns());
        let from_ns = match spec.kind {
            FaultKind::Late => scenario.loop_.grace_ns().saturating_add(late_by),
            _ => spec.delay.unwrap_or_default().ns(),
        };
        let value_nm = spec.value_nm.unwrap_or(ROGUE_NM);
        Self {
            kind: spec.kind,
            first,
            end,
            every: spec.every.map_or(1, |every| every.tick(period_ns)).max(1),
            probability: spec.probability.unwrap_or(1.0),
            seed: spec.seed.unwrap_or(1),
            lane: index.wrapping_mul(LANES),
            delay: Delay {
                distribution: spec.distribution.unwrap_or(Distribution::Constant),
                from_ns,
                to_ns: spec.delay_max.map_or(from_ns, |longest| longest.ns()),
                shape: spec.shape.unwrap_or(PARETO_SHAPE_DEFAULT),
            },
            hang_ns: if hang { for_ticks.map_or(u64::MAX, |ticks| hang_length_ns(spec, ticks, period_ns)) } else { 0 },
            glitch: (spec.joint.unwrap_or(1).saturating_sub(1), value_nm),
            clock_step_ns: spec.step.map_or(0, |step| step.0),
        }
    }

    fn is_due(&self, tick: u64) -> bool {
        let due = (self.first..self.end).contains(&tick) && (tick - self.first).is_multiple_of(self.every);
        // A probability of 1 needs no number, and one of 0 is never above it.
        due && uniform(self.seed, Stream::Fault, tick, self.lane.wrapping_add(LANE_DUE)) < self.probability
    }

    fn apply(&self, tick: u64, actions: &mut FaultActions) {
        match self.kind {
            FaultKind::Kill => actions.kill = true,
            FaultKind::Hang => actions.hang_ns = actions.hang_ns.max(self.hang_ns),
            FaultKind::Delay | FaultKind::Late => {
                let u = uniform(self.seed, Stream::Fault, tick, self.lane.wrapping_add(LANE_DELAY));
                actions.delay_ns = actions.delay_ns.saturating_add(self.delay.ns(u));
            }
            FaultKind::Drop => actions.drop = true,
            FaultKind::Nan => actions.nan = true,
            FaultKind::Glitch => actions.glitch = Some(self.glitch),
            FaultKind::Duplicate => actions.duplicate = true,
            FaultKind::Reorder => actions.reorder = true,
            FaultKind::StaleSetpoint => actions.stale_setpoint = true,
            FaultKind::ClockStep => actions.clock_step_ns = actions.clock_step_ns.saturating_add(self.clock_step_ns),
            FaultKind::Rogue => actions.rogue_nm = Some(self.glitch.1),
        }
    }
}

/// The length of a hang as written: a time is taken to the nanosecond, ticks by the period.
fn hang_length_ns(spec: &FaultSpec, ticks: u64, period_ns: u64) -> u64 {
    match spec.for_ {
        Some(loopbound_scenario::When::Time(time)) => time.ns(),
        _ => ticks.saturating_mul(period_ns),
    }
}

/// The faults of one process, ready to be asked every tick without allocating.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaultPlan {
    entries: Vec<Entry>,
}

impl FaultPlan {
    /// The faults that a scenario has for the process `id` (from 1) of `role`.
    #[must_use]
    pub fn for_target(scenario: &Scenario, role: Role, id: u32) -> Self {
        let numbered = (0_u32..).zip(&scenario.fault);
        let mine = numbered.filter(|(_, fault)| fault.target().matches(role, id));
        Self { entries: mine.map(|(index, fault)| Entry::new(index, fault, scenario)).collect() }
    }

    /// Whether there is nothing to ask.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// What is injected into the process in `tick`.
    #[must_use]
    pub fn at_tick(&self, tick: u64) -> FaultActions {
        let mut actions = FaultActions::default();
        for entry in self.entries.iter().filter(|entry| entry.is_due(tick)) {
            entry.apply(tick, &mut actions);
        }
        actions
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(fault: &str) -> FaultPlan {
        let scenario = Scenario::from_toml(fault, "test").expect("the scenario is valid");
        FaultPlan::for_target(&scenario, Role::Controller, 1)
    }

    fn injected(plan: &FaultPlan, ticks: u64) -> Vec<u64> {
        (0..ticks).filter(|tick| plan.at_tick(*tick).any()).collect()
    }

    #[test]
    fn a_fault_with_at_alone_is_injected_in_one_tick() {
        let plan = plan("[[fault]]\nkind = \"drop\"\nat = \"5ms\"");
        assert_eq!(injected(&plan, 100), [5]);
        assert!(plan.at_tick(5).drop);
    }

    #[test]
    fn a_window_and_a_stride_select_ticks() {
        let plan = plan("[[fault]]\nkind = \"nan\"\nat = 10\nfor = \"6ms\"\nevery = 2");
        assert_eq!(injected(&plan, 100), [10, 12, 14]);
    }

    #[test]
    fn a_delay_without_a_window_is_injected_in_every_tick() {
        let plan = plan("[[fault]]\nkind = \"delay\"\ndelay = \"20us\"");
        assert!((0..1000).all(|tick| plan.at_tick(tick).delay_ns == 20_000));
    }

    #[test]
    fn a_probability_is_met_and_repeats_itself() {
        let plan = plan("[[fault]]\nkind = \"drop\"\nprobability = 0.01\nseed = 3");
        let count = 100_000;
        let first = injected(&plan, count);
        assert_eq!(first, injected(&plan.clone(), count));
        // Five standard deviations of a binomial count, sqrt(100 000 · 0.01 · 0.99) = 31.5.
        assert!((1000_usize.abs_diff(first.len())) < 158, "{} ticks", first.len());
    }

    #[test]
    fn two_faults_with_one_seed_are_injected_independently() {
        let two = "[[fault]]\nkind = \"drop\"\nprobability = 0.5\n[[fault]]\nkind = \"nan\"\nprobability = 0.5";
        let plan = plan(two);
        let both = (0..10_000).filter(|tick| plan.at_tick(*tick).drop && plan.at_tick(*tick).nan).count();
        // A quarter of the ticks, within five standard deviations of 43.
        assert!((2285..=2715).contains(&both), "{both} ticks with both");
    }

    #[test]
    fn uniform_delays_fill_their_range() {
        let plan =
            plan("[[fault]]\nkind = \"delay\"\ndelay = \"100us\"\ndelay_max = \"300us\"\ndistribution = \"uniform\"");
        let delays: Vec<u64> = (0..10_000).map(|tick| plan.at_tick(tick).delay_ns).collect();
        assert!(delays.iter().all(|delay| (100_000..=300_000).contains(delay)));
        let mean = delays.iter().sum::<u64>() / 10_000;
        // The standard deviation of the mean is 200 us / sqrt(12 · 10 000) = 0.58 us; five of them are allowed.
        assert!(mean.abs_diff(200_000) < 2_900, "mean {mean} ns");
    }

    #[test]
    fn pareto_delays_have_the_tail_of_their_shape() {
        let plan = plan(
            "[[fault]]\nkind = \"delay\"\ndelay = \"10us\"\ndelay_max = \"1s\"\ndistribution = \"pareto\"\nshape = 2.0",
        );
        let above = |limit: u64| (0..100_000).filter(|tick| plan.at_tick(*tick).delay_ns > limit).count();
        assert_eq!(above(9_999), 100_000);
        // P(delay > x) = (10 us / x)^2: a hundredth above 100 us, within five standard deviations of 31.5.
        assert!(above(100_000).abs_diff(1000) < 158, "{} above 100 us", above(100_000));
    }

    #[test]
    fn a_fault_is_injected_into_its_target_only() {
        let text = "[[fault]]\nkind = \"kill\"\ntarget = \"controller:2\"\nat = 7";
        let scenario = Scenario::from_toml(text, "test").expect("the scenario is valid");
        assert!(FaultPlan::for_target(&scenario, Role::Controller, 1).is_empty());
        assert!(FaultPlan::for_target(&scenario, Role::Plant, 2).is_empty());
        let plan = FaultPlan::for_target(&scenario, Role::Controller, 2);
        assert!(plan.at_tick(7).kill && !plan.at_tick(8).any());
    }

    #[test]
    fn a_hang_lasts_as_long_as_written_or_for_ever() {
        assert_eq!(plan("[[fault]]\nkind = \"hang\"\nat = 3\nfor = \"1500us\"").at_tick(3).hang_ns, 1_500_000);
        assert_eq!(plan("[[fault]]\nkind = \"hang\"\nat = 3\nfor = 2").at_tick(3).hang_ns, 2_000_000);
        let for_ever = plan("[[fault]]\nkind = \"hang\"\nat = 3");
        assert_eq!(for_ever.at_tick(3).hang_ns, u64::MAX);
        assert!(!for_ever.at_tick(4).any());
    }

    #[test]
    fn a_late_torque_misses_the_grace_deadline() {
        let scenario =
            Scenario::from_toml("[[fault]]\nkind = \"late\"\nat = 3", "test").expect("the scenario is valid");
        let plan = FaultPlan::for_target(&scenario, Role::Controller, 1);
        assert!(plan.at_tick(3).delay_ns > scenario.loop_.grace_ns());
    }

    #[test]
    fn links_of_a_glitch_are_counted_from_one_in_the_file_and_from_zero_inside() {
        let plan = plan("[[fault]]\nkind = \"glitch\"\nat = 3\nvalue_nm = -4.5\njoint = 3");
        assert_eq!(plan.at_tick(3).glitch, Some((2, -4.5)));
    }
}
