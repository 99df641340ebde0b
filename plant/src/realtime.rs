//! The plant's loop on the machine's clock.
//!
//! ```text
//! wake early (lead) → map what joined → spin to t_k → integrate to *now* → publish State(k) → ring
//! → wait for Torque(k), to the grace deadline and beyond → slack: TickRecord(k−1), evidence, commands
//! ```
//!
//! Deadlines are absolute. Each torque acts from its arrival, so a late torque is late in the physics too.

use std::sync::atomic::Ordering;

use loopbound_scenario::Scenario;
use loopbound_shared::clock;
use loopbound_shared::fault::FaultActions;
use loopbound_shared::realtime::EvidenceReader;
use loopbound_shared::role;
use loopbound_shared::sample::{State, TickRecord, state_flag};

use crate::core::{Opening, PlantCore};
use crate::ports::{Orders, Ports};

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
    let mut orders = Orders::default();
    let mut suffering = Suffering::default();
    while !orders.start {
        if stopped() {
            return;
        }
        ports.update_connections();
        ports.drain_setpoints(core);
        ports.serve(core, &mut orders);
        clock::sleep_until_ns(clock::now_ns() + 200_000);
    }
    ports.torque_bell.open_alarm(&ports.joined.block);
    warm_up(core, ports, &mut evidence);
    let scenario = &ports.joined.scenario;
    let times = Times::of(scenario, first_deadline(scenario));
    core.start_at(times.t_0_ns);
    exchange(core, ports, times.t_0_ns - times.period_ns);
    let mut tick = 0;
    let mut duty = Duty { awake_since_ns: clock::now_ns() };
    while !stopped() && orders.stop_at.is_none_or(|stop| tick < stop) {
        let wake_late_ns = duty.sleep_until(times.deadline_ns(tick) - times.lead_ns);
        let opened = open_tick(core, ports, &times, tick, wake_late_ns, &orders);
        tick = opened.map_or_else(
            |beyond| beyond,
            |opened| {
                one_tick(core, ports, &times, &opened, &mut suffering, &mut evidence, &mut orders);
                opened.state.tick + 1
            },
        );
    }
    clock::sleep_until_ns(times.deadline_ns(tick));
    core.finish(clock::now_ns());
    publish_closed(core, ports);
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

/// A tick whose state is ready to be published.
struct OpenTick {
    state: State,
    /// The longest gap seen while spinning to the deadline, ns.
    gap_ns: u64,
}

/// Waits for the deadline and samples; the end of the run instead if an overrun passed it.
fn open_tick<const N: usize>(
    core: &mut PlantCore<N>,
    ports: &Ports,
    times: &Times,
    tick: u64,
    wake_late_ns: u64,
    orders: &Orders,
) -> Result<OpenTick, u64> {
    let mut gap_ns = 0;
    let joined_ns = prepare(core, ports);
    let sampled_ns = wait_for_deadline(ports, times.deadline_ns(tick), &mut gap_ns);
    // An overrun: the ticks whose end has passed are skipped and counted, never published.
    let skipped = (sampled_ns - times.deadline_ns(tick)) / times.period_ns;
    if let Some(stop) = orders.stop_at.filter(|stop| tick + skipped >= *stop) {
        core.count_skipped(stop - tick);
        return Err(stop);
    }
    let tick = tick + skipped;
    let state = core.open(Opening {
        tick,
        deadline_ns: times.deadline_ns(tick),
        sampled_ns,
        grace_deadline_ns: times.grace_deadline_ns(tick, sampled_ns),
        skipped,
        wake_late_ns,
    });
    if let Some(took_ns) = joined_ns {
        core.note_join(took_ns);
    }
    Ok(OpenTick { state, gap_ns })
}

/// Publishes the state, waits for its torque, and does what the slack is for.
fn one_tick<const N: usize>(
    core: &mut PlantCore<N>,
    ports: &Ports,
    times: &Times,
    opened: &OpenTick,
    suffering: &mut Suffering,
    evidence: &mut EvidenceReader,
    orders: &mut Orders,
) {
    let block = &ports.joined.block;
    let (mut state, mut gap_ns) = (opened.state, opened.gap_ns);
    let tick = state.tick;
    let faults = suffering.begin(core, ports, tick);
    if let Some(struck) = &mut orders.struck {
        struck.mark(core, tick);
    }
    let now_ns = clock::now_ns();
    let (published_ns, grace_deadline_ns) = (suffering.stamp_ns(now_ns), times.grace_deadline_ns(tick, now_ns));
    (state.published_ns, state.grace_deadline_ns) = (published_ns, grace_deadline_ns);
    let squeezed = grace_deadline_ns.saturating_sub(now_ns) < times.grace_ns / 2;
    core.stamp_published(published_ns, grace_deadline_ns, squeezed);
    suffering.publish(ports, &state, &faults);
    ports.state_bell.ring(block);
    block.pace().plant_tick.store(tick, Ordering::Release);
    await_torque(core, ports, times.cutoff_ns(tick), grace_deadline_ns, &mut gap_ns);
    publish_closed(core, ports);
    core.note_slack(evidence.read(), gap_ns);
    ports.serve(core, orders);
    ports.torque_bell.set_end(block, times.grace_deadline_ns(tick + 1, times.deadline_ns(tick + 1)));
}

/// In the slack before the deadline: maps what joined (its time if it was long), takes what came late.
fn prepare<const N: usize>(core: &mut PlantCore<N>, ports: &Ports) -> Option<u64> {
    let from_ns = clock::now_ns();
    ports.update_connections();
    let took_ns = clock::now_ns() - from_ns;
    ports.drain_setpoints(core);
    // Anything still here came after the cut-off: another tick's by the time it could act.
    while let Some(torque) = ports.next_torque() {
        core.authority.too_late(&torque, clock::now_ns());
    }
    (took_ns > role::MAPPING_NS).then_some(took_ns)
}

fn wait_for_deadline(ports: &Ports, deadline_ns: u64, gap_ns: &mut u64) -> u64 {
    if ports.torque_bell.is_time_triggered() {
        ports.torque_bell.spin_until(deadline_ns, gap_ns)
    } else {
        clock::sleep_until_ns(deadline_ns);
        clock::now_ns()
    }
}

/// Waits until some torque for the tick acts: to the grace deadline, then on to the cut-off.
fn await_torque<const N: usize>(
    core: &mut PlantCore<N>,
    ports: &Ports,
    cutoff_ns: u64,
    grace_deadline_ns: u64,
    gap_ns: &mut u64,
) {
    let block = &ports.joined.block;
    for (until_ns, at_grace) in [(grace_deadline_ns, true), (cutoff_ns, false)] {
        ports.torque_bell.wait(block, clock::now_ns(), until_ns, gap_ns, || {
            while let Some(torque) = ports.next_torque() {
                core.arrive(&torque, clock::now_ns());
            }
            core.authority.is_settled().then_some(())
        });
        if at_grace {
            // Also when all is settled: the authority wants to know once a tick.
            core.grace_passed(clock::now_ns());
        }
        if core.authority.is_settled() {
            return;
        }
    }
}

fn publish_closed<const N: usize>(core: &PlantCore<N>, ports: &Ports) {
    if let Some(record) = core.closed() {
        ports.records.send(*record);
    }
}

/// The plant's own injected faults, and what of them lasts beyond a tick.
#[derive(Default)]
struct Suffering {
    /// A state that is published after its successor.
    kept_back: Option<State>,
    clock_off_ns: i64,
}

impl Suffering {
    /// The faults of a tick; those that take time or end it have struck on return.
    fn begin<const N: usize>(&mut self, core: &mut PlantCore<N>, ports: &Ports, tick: u64) -> FaultActions {
        let faults = ports.faults.at_tick(tick);
        if faults.any() {
            core.note_fault(None);
            if faults.kill {
                role::kill_self();
            }
            if faults.hang_ns > 0 || faults.delay_ns > 0 {
                let now_ns = clock::now_ns();
                clock::wait_until_ns(now_ns.saturating_add(faults.hang_ns).saturating_add(faults.delay_ns));
            }
            self.clock_off_ns = self.clock_off_ns.saturating_add(faults.clock_step_ns);
        }
        faults
    }

    /// The stamp of an instant by this process's clock, which a fault may have stepped.
    fn stamp_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_add_signed(self.clock_off_ns)
    }

    fn publish(&mut self, ports: &Ports, state: &State, faults: &FaultActions) {
        let kept_back = self.kept_back.take();
        if faults.reorder {
            self.kept_back = Some(*state);
        } else if !faults.drop {
            ports.states.send(*state);
        }
        if faults.duplicate {
            ports.states.send(*state);
        }
        if let Some(older) = kept_back {
            ports.states.send(older);
        }
    }
}
