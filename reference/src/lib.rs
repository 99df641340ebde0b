//! The reference generator of a group: publishes the setpoint of every tick ahead of time.
//!
//! Never in the loop's hot path: the setpoints of the next ticks are with their readers long before they are needed,
//! so this process may be late by the whole lead before anyone notices.

use std::sync::atomic::{AtomicBool, Ordering};

use loopbound_model::trajectory::Trajectory;
use loopbound_model::with_links;
use loopbound_scenario::{Mode, Scenario, ScenarioError};
use loopbound_shared::clock;
use loopbound_shared::doorbell::Bell;
use loopbound_shared::event::{Phase, Role};
use loopbound_shared::fault::{FaultActions, FaultPlan};
use loopbound_shared::ports::Publisher;
use loopbound_shared::realtime;
use loopbound_shared::role::{self, RoleArgs, RoleError};
use loopbound_shared::sample::{Announce, Origin, Setpoint, to_links};

/// In lockstep, ticks that the reference runs ahead of the plant; less than a reader's buffer, several of the blocks
/// in which the plant rings.
const LOCKSTEP_LEAD_TICKS: u64 = 1024;

/// The setpoints of a scenario, tick by tick, without a clock.
pub struct Generator<const N: usize> {
    trajectory: Trajectory<N>,
    faults: FaultPlan,
    period_ns: u64,
    id: u32,
}

impl<const N: usize> Generator<N> {
    /// The motion of a scenario.
    ///
    /// # Errors
    /// If the scenario describes no motion.
    pub fn new(scenario: &Scenario, id: u32) -> Result<Self, ScenarioError> {
        Ok(Self {
            trajectory: scenario.build_trajectory()?,
            faults: FaultPlan::for_target(scenario, loopbound_scenario::Role::Reference, id),
            period_ns: scenario.period_ns(),
            id,
        })
    }

    /// What befalls the reference in a tick, on purpose.
    #[must_use]
    pub fn faults_at(&self, tick: u64) -> FaultActions {
        self.faults.at_tick(tick)
    }

    /// The setpoint of a tick. A fault may repeat that of the tick before, or make it no number.
    #[must_use]
    pub fn setpoint(&self, tick: u64, faults: &FaultActions) -> Setpoint {
        let plant_ns = tick * self.period_ns;
        let source_ns = if faults.stale_setpoint { plant_ns.saturating_sub(self.period_ns) } else { plant_ns };
        let value = self.trajectory.at(clock::seconds(source_ns));
        let mut setpoint = Setpoint {
            origin: Origin::in_process(Role::Reference),
            tick,
            plant_ns,
            published_ns: 0,
            writer: self.id,
            links: u32::try_from(N).unwrap_or(0),
            q_d: to_links(&value.q_d),
            v_d: to_links(&value.v_d),
            a_d: to_links(&value.a_d),
        };
        if faults.nan {
            setpoint.q_d[..N].fill(f64::NAN);
        }
        setpoint
    }
}

/// Runs the reference until the group ends or `stop` is set.
///
/// # Errors
/// If the group can't be joined or its scenario describes no motion.
pub fn run(args: &RoleArgs, stop: &'static AtomicBool) -> Result<(), RoleError> {
    let links = Scenario::load(&args.scenario)?.links();
    with_links!(links, generate::<N>(args, stop))
}

fn generate<const N: usize>(args: &RoleArgs, stop: &'static AtomicBool) -> Result<(), RoleError> {
    let joined = role::join(args)?;
    role::wait_until_listed(&joined, Role::Reference, args.id)?;
    let generator = Generator::<N>::new(&joined.scenario, args.id)?;
    let setpoints: Publisher<Setpoint> = joined.node.publisher()?;
    let announce: Publisher<Announce> = joined.node.publisher()?;
    let entered = realtime::enter(&realtime::Request::default());
    let (block, scenario) = (&joined.block, &joined.scenario);
    let lockstep = scenario.loop_.mode == Mode::Lockstep;
    let lead_ticks =
        if lockstep { LOCKSTEP_LEAD_TICKS } else { scenario.setpoint_lead_ns().div_ceil(scenario.period_ns()) };
    let stopped = || stop.load(Ordering::Relaxed) || block.pace().plant_ended.load(Ordering::Relaxed) != 0;
    let plant_tick = || block.pace().plant_tick.load(Ordering::Relaxed);
    // One that is started again goes on where the plant is.
    let mut next = plant_tick();
    let mut output = Output { setpoints: &setpoints, lockstep, kept_back: None, clock_off_ns: 0 };
    let mut publish_up_to = |end: u64| {
        // After a long stall of this process, what is past helps nobody.
        next = next.max(plant_tick());
        let any = next < end;
        while next < end {
            output.publish(&generator, next);
            next += 1;
        }
        any
    };
    publish_up_to(plant_tick() + lead_ticks);
    let ready = role::announce(Role::Reference, args.id, Phase::Ready, N, entered.privileges(), "reference");
    announce.send(ready);
    // Often enough that most of the lead is always there.
    let nap_ns = (lead_ticks * scenario.period_ns() / 8).clamp(1_000_000, 20_000_000);
    while !stopped() {
        let until_ns = clock::now_ns() + nap_ns;
        if lockstep {
            let (seen, mut tick) = (plant_tick(), 0);
            block.wait(Bell::Pace, until_ns, || {
                tick = plant_tick();
                (tick != seen).then_some(())
            });
        } else {
            clock::sleep_until_ns(until_ns);
        }
        if publish_up_to(plant_tick() + lead_ticks) && lockstep {
            block.ring(Bell::Pace);
        }
        // Delivers the history to whoever has joined since.
        let _ = (setpoints.update_connections(), announce.update_connections());
    }
    // Ports are dropped before what they were opened from; the hold on the group last.
    announce.send(Announce { phase: Phase::Ended.code(), published_ns: clock::now_ns(), ..ready });
    Ok(())
}

/// Where setpoints go, and what befalls them on the way, on purpose.
struct Output<'a> {
    setpoints: &'a Publisher<Setpoint>,
    lockstep: bool,
    /// A setpoint that is published after its successor.
    kept_back: Option<Setpoint>,
    /// How far this process's stamps are off.
    clock_off_ns: i64,
}

impl Output<'_> {
    fn publish<const N: usize>(&mut self, generator: &Generator<N>, tick: u64) {
        let faults = generator.faults_at(tick);
        if faults.kill {
            role::kill_self();
        }
        let pause_ns = faults.hang_ns.saturating_add(if self.lockstep { 0 } else { faults.delay_ns });
        if pause_ns > 0 {
            clock::wait_until_ns(clock::now_ns().saturating_add(pause_ns));
        }
        self.clock_off_ns = self.clock_off_ns.saturating_add(faults.clock_step_ns);
        // A dropped setpoint would stop lockstep, which waits for it: there it is given late in content instead.
        if faults.drop && !self.lockstep {
            return;
        }
        let now_ns = if self.lockstep { 0 } else { clock::now_ns() };
        let published_ns = now_ns.saturating_add_signed(self.clock_off_ns);
        let setpoint = Setpoint { published_ns, ..generator.setpoint(tick, &faults) };
        if faults.reorder {
            // Of two in a row the older goes now; it is late enough as it is.
            if let Some(older) = self.kept_back.replace(setpoint) {
                self.setpoints.send(older);
            }
            return;
        }
        self.setpoints.send(setpoint);
        if faults.duplicate {
            self.setpoints.send(setpoint);
        }
        if let Some(older) = self.kept_back.take() {
            self.setpoints.send(older);
        }
    }
}
