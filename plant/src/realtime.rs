//! The plant's loop on the machine's clock: wait, read, compute, publish, record.
//!
//! ```text
//! wake early (lead) → map what joined → spin to t_k → integrate to *now* → publish State(k) → ring
//! → wait for Torque(k), to the grace deadline and beyond → slack: TickRecord(k−1), evidence, commands
//! ```
//!
//! Deadlines are absolute. Each torque acts from its arrival, so a late torque is late in the physics too.

use std::sync::atomic::Ordering;

use loopbound_scenario::{Role, Scenario};
use loopbound_shared::clock;
use loopbound_shared::fault::{FaultActions, Injector};
use loopbound_shared::realtime::EvidenceReader;
use loopbound_shared::role;
use loopbound_shared::sample::{State, TickRecord, state_flag};

use crate::ports::{Orders, Ports};
use crate::tick::{Opening, PlantCore};

/// t_0 lies on a multiple of this (plus the phase): of every usual period of the kernel's tick (1, 4, 10 ms), so that
/// the phase between the loop and the kernel's tick is what the scenario says.
const GRID_NS: u64 = 20_000_000;
/// Rounds of exchange before t_0, so that both ends are warm.
const WARM_UP_ROUNDS: u32 = 64;

/// The loop's times, ns.
struct Times {
    period_ns: u64,
    lead_ns: u64,
    grace_ns: u64,
    t_0_ns: u64,
}

impl Times {
    fn of(scenario: &Scenario, t_0_ns: u64) -> Self {
        Self {
            period_ns: scenario.period_ns(),
            lead_ns: scenario.loop_.lead_ns(),
            grace_ns: scenario.loop_.grace_ns(),
            t_0_ns,
        }
    }

    fn deadline_ns(&self, tick: u64) -> u64 {
        self.t_0_ns + tick * self.period_ns
    }

    /// min(published + grace, t_{k+1} − lead).
    fn grace_deadline_ns(&self, tick: u64, published_ns: u64) -> u64 {
        (published_ns + self.grace_ns).min(self.cutoff_ns(tick))
    }

    /// When the loop turns to the next tick: a torque after it is stale.
    fn cutoff_ns(&self, tick: u64) -> u64 {
        self.deadline_ns(tick + 1) - self.lead_ns
    }
}

pub(crate) fn run<const N: usize>(core: &mut PlantCore<N>, ports: &Ports, stopped: &dyn Fn() -> bool) {
    let mut evidence = EvidenceReader::open();
    let Some(orders) = ports.await_start(core, stopped) else { return };
    ports.torque_bell.open_alarm(&ports.joined.block);
    warm_up(core, ports, &mut evidence);
    let scenario = &ports.joined.scenario;
    let times = Times::of(scenario, first_deadline(scenario));
    core.start_at(times.t_0_ns);
    exchange(core, ports, times.t_0_ns - times.period_ns);
    let duty = Duty { awake_since_ns: clock::now_ns() };
    let injector = Injector::new(scenario, Role::Plant, ports.id);
    let faults = FaultActions::default();
    let mut cycle = Cycle { core, ports, times, orders, evidence, duty, injector, faults, spin_gap_ns: 0 };
    let mut tick = 0;
    while !stopped() && !cycle.orders.is_over(tick) {
        tick = cycle.one_tick(tick);
    }
    cycle.finish(tick);
}

/// The loop: what it works on, and what it keeps from tick to tick.
struct Cycle<'a, const N: usize> {
    core: &'a mut PlantCore<N>,
    ports: &'a Ports,
    times: Times,
    orders: Orders,
    evidence: EvidenceReader,
    duty: Duty,
    injector: Injector<State>,
    /// What is injected in the open tick.
    faults: FaultActions,
    /// The longest gap seen while spinning in the open tick, ns.
    spin_gap_ns: u64,
}

/// When a tick was sampled.
struct Sampled {
    /// The tick: the one that was due, or a later one after an overrun.
    tick: u64,
    at_ns: u64,
    /// Ticks whose end had passed: they are counted, never published.
    skipped: u64,
}

impl<const N: usize> Cycle<'_, N> {
    /// The tick that is due, from the sleep before it to its slack; returns the next one.
    fn one_tick(&mut self, due: u64) -> u64 {
        let wake_late_ns = self.wait(due);
        let mapped_ns = self.read();
        let sampled = self.sample(due);
        if let Some(end) = self.orders.stop_at.filter(|end| sampled.tick >= *end) {
            // An overrun has passed the end of the run.
            self.core.count_skipped(end - due);
            return end;
        }
        let state = self.compute(&sampled, wake_late_ns, mapped_ns);
        let grace_deadline_ns = self.publish(state);
        self.await_torque(grace_deadline_ns, self.times.cutoff_ns(sampled.tick));
        self.record(sampled.tick + 1);
        sampled.tick + 1
    }

    /// Sleeps until shortly before the deadline; how late the kernel ended the sleep.
    fn wait(&mut self, due: u64) -> u64 {
        self.duty.sleep_until(self.times.deadline_ns(due) - self.times.lead_ns)
    }

    /// Maps what has joined (its time if it was long), and takes what has come since the tick before.
    fn read(&mut self) -> Option<u64> {
        let from_ns = clock::now_ns();
        self.ports.update_connections();
        let mapped_ns = clock::now_ns() - from_ns;
        self.ports.drain_setpoints(self.core);
        // Any torque still here came after the cut-off: another tick's by the time it could act.
        while let Some(torque) = self.ports.next_torque() {
            self.core.authority.too_late(&torque, clock::now_ns());
        }
        (mapped_ns > role::MAPPING_NS).then_some(mapped_ns)
    }

    /// Waits for the deadline itself.
    fn sample(&mut self, due: u64) -> Sampled {
        let deadline_ns = self.times.deadline_ns(due);
        self.spin_gap_ns = 0;
        let at_ns = if self.ports.torque_bell.is_time_triggered() {
            self.ports.torque_bell.spin_until(deadline_ns, &mut self.spin_gap_ns)
        } else {
            clock::sleep_until_ns(deadline_ns);
            clock::now_ns()
        };
        let skipped = (at_ns - deadline_ns) / self.times.period_ns;
        Sampled { tick: due + skipped, at_ns, skipped }
    }

    /// Closes the tick before, integrates to now, and opens this tick: its state, ready to be published. The injected faults
    /// of the plant that take time take it here.
    fn compute(&mut self, sampled: &Sampled, wake_late_ns: u64, mapped_ns: Option<u64>) -> State {
        let Sampled { tick, at_ns, skipped } = *sampled;
        let state = self.core.open(Opening {
            tick,
            deadline_ns: self.times.deadline_ns(tick),
            sampled_ns: at_ns,
            grace_deadline_ns: self.times.grace_deadline_ns(tick, at_ns),
            skipped,
            wake_late_ns,
        });
        if let Some(took_ns) = mapped_ns {
            self.core.note_join(took_ns);
        }
        self.faults = self.injector.at_tick(tick);
        if self.faults.any() {
            self.core.note_fault(None);
            self.injector.take_time(&self.faults);
            self.injector.step_clock(&self.faults);
        }
        if let Some(injected) = &mut self.orders.injected {
            injected.mark(self.core, tick);
        }
        state
    }

    /// Publishes the state and wakes the controllers; the grace deadline, which counts from here.
    fn publish(&mut self, mut state: State) -> u64 {
        let (ports, now_ns) = (self.ports, clock::now_ns());
        let grace_deadline_ns = self.times.grace_deadline_ns(state.tick, now_ns);
        let squeezed = grace_deadline_ns.saturating_sub(now_ns) < self.times.grace_ns / 2;
        state.published_ns = self.injector.stamp_ns(now_ns);
        state.grace_deadline_ns = grace_deadline_ns;
        self.core.stamp_published(state.published_ns, grace_deadline_ns, squeezed);
        self.injector.publish(state, &self.faults, |state| {
            ports.states.send(state);
        });
        let block = &ports.joined.block;
        ports.state_bell.ring(block);
        block.pace().plant_tick.store(state.tick, Ordering::Release);
        grace_deadline_ns
    }

    /// Waits until some torque for the tick acts: to the grace deadline, then on to the cut-off.
    fn await_torque(&mut self, grace_deadline_ns: u64, cutoff_ns: u64) {
        self.await_until(grace_deadline_ns);
        // Also when all is settled: the authority wants to know once a tick.
        self.core.grace_passed(clock::now_ns());
        if !self.core.authority.is_settled() {
            let slept = clock::now_ns() < cutoff_ns && self.ports.torque_bell.sleeps();
            self.await_until(cutoff_ns);
            if slept && !self.core.authority.is_settled() {
                self.duty.note_sleep();
            }
        }
    }

    fn await_until(&mut self, until_ns: u64) {
        let (core, ports) = (&mut *self.core, self.ports);
        ports.torque_bell.wait(&ports.joined.block, clock::now_ns(), until_ns, &mut self.spin_gap_ns, || {
            while let Some(torque) = ports.next_torque() {
                core.arrive(&torque, clock::now_ns());
            }
            core.authority.is_settled().then_some(())
        });
    }

    /// The slack: publishes the record of the tick before, reads the evidence of this one, answers commands, and sets the
    /// alarm of the tick that comes.
    fn record(&mut self, next: u64) {
        self.ports.publish_closed(self.core);
        self.core.note_slack(self.evidence.read(), self.spin_gap_ns);
        self.ports.serve(self.core, &mut self.orders);
        let grace_deadline_ns = self.times.grace_deadline_ns(next, self.times.deadline_ns(next));
        self.ports.torque_bell.set_end(&self.ports.joined.block, grace_deadline_ns);
    }

    /// Ends the last tick at the deadline of `tick`, which is not published any more.
    fn finish(&mut self, tick: u64) {
        clock::sleep_until_ns(self.times.deadline_ns(tick));
        self.core.finish(clock::now_ns());
        self.ports.publish_closed(self.core);
    }
}

/// Sees to it that this process sleeps now and then also when it is overloaded: a real-time thread that never does is
/// stopped by the kernel for 50 ms every second, and ended by its own run-away guard after half a second.
struct Duty {
    awake_since_ns: u64,
}

impl Duty {
    /// The longest time without sleep, and the sleep that is then forced; the ticks it costs are overruns.
    const AWAKE_MAX_NS: u64 = 100_000_000;
    const REST_NS: u64 = 15_000_000;

    /// A wait has slept: with nobody to answer, the sleep before a tick may always be over already.
    fn note_sleep(&mut self) {
        self.awake_since_ns = clock::now_ns();
    }

    /// Sleeps, and returns how late the kernel ended it: the noise floor of the run. A sleep that was due already says
    /// nothing about the host, and returns the largest number.
    fn sleep_until(&mut self, deadline_ns: u64) -> u64 {
        let now_ns = clock::now_ns();
        let on_time = deadline_ns > now_ns;
        if on_time {
            clock::sleep_until_ns(deadline_ns);
        } else if now_ns - self.awake_since_ns > Self::AWAKE_MAX_NS {
            clock::sleep_until_ns(now_ns + Self::REST_NS);
        } else {
            return u64::MAX;
        }
        self.awake_since_ns = clock::now_ns();
        if on_time { self.awake_since_ns - deadline_ns } else { u64::MAX }
    }
}

fn first_deadline(scenario: &Scenario) -> u64 {
    let soonest_ns = clock::now_ns() + 2 * scenario.loop_.lead_ns() + 1_000_000;
    soonest_ns.next_multiple_of(GRID_NS) + scenario.loop_.phase_ns()
}

/// Exchanges states and torques that count for nothing, and runs the whole tick's code.
fn warm_up<const N: usize>(core: &mut PlantCore<N>, ports: &Ports, evidence: &mut EvidenceReader) {
    for _ in 0..WARM_UP_ROUNDS {
        exchange(core, ports, 0);
        // Readers pass over a record without links.
        ports.records.send(TickRecord::zeroed());
        ports.update_connections();
        std::hint::black_box(evidence.read());
    }
    core.rehearse();
}

/// One exchange of the warm-up; `deadline_ns` is one period before t_0 once that is known.
fn exchange<const N: usize>(core: &PlantCore<N>, ports: &Ports, deadline_ns: u64) {
    let block = &ports.joined.block;
    let (now_ns, (active, epoch)) = (clock::now_ns(), core.authority.active());
    ports.states.send(State {
        deadline_ns,
        published_ns: now_ns,
        active,
        epoch,
        flags: state_flag::WARM_UP,
        links: u32::try_from(N).unwrap_or(0),
        ..State::zeroed()
    });
    ports.state_bell.ring(block);
    ports.torque_bell.wait(block, now_ns, now_ns + 300_000, &mut 0, || ports.torques.take());
}
