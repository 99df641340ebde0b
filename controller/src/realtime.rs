//! The controller's loop on the machine's clock: wait, read, compute, publish, record; everything else in the slack

use loopbound_shared::clock;
use loopbound_shared::fault::FaultActions;
use loopbound_shared::realtime::{Evidence, EvidenceReader};
use loopbound_shared::role;
use loopbound_shared::sample::{Setpoint, State, Torque, WARM_UP_TICK, state_flag, torque_flag};

use crate::Controller;
use crate::ports::Ports;
use crate::tick::ControllerCore;

/// How often to look whether the group still lives, when nothing comes.
const LOOK_NS: u64 = 20_000_000;

/// How long before the expected state the active controller wakes: more than a timer is late by, as a rule.
const EARLY_NS: u64 = 100_000;

/// Touches the code and data of a tick before the first one: its page faults and cold caches belong to the start-up.
pub(crate) fn warm_up<C: Controller>(core: &mut ControllerCore<C>, evidence: &mut EvidenceReader, links: usize) {
    let links = u32::try_from(links).unwrap_or(0);
    let state = State { links, ..State::zeroed() };
    let had_one = core.setpoints.has(0);
    if !had_one {
        core.setpoints.enter(&Setpoint { links, ..Setpoint::zeroed() }, links as usize);
    }
    for _ in 0..1000 {
        std::hint::black_box(core.answer(&state, &FaultActions::default()));
        std::hint::black_box(evidence.read());
    }
    if !had_one {
        core.setpoints.clear();
    }
}

/// The loop. Returns when the plant has said that no tick follows, or when `stopped`.
pub(crate) fn run<C: Controller>(
    core: &mut ControllerCore<C>,
    ports: &Ports,
    evidence: &mut EvidenceReader,
    stopped: &dyn Fn() -> bool,
) {
    let links = core.links();
    let mut next = NextState::new(ports, core.id());
    let mut slack = Slack::default();
    while !stopped() {
        let Some((state, received_ns)) = next.wait(ports) else {
            ports.update_connections();
            ports.drain_setpoints(&mut core.setpoints, links);
            continue;
        };
        if state.flags & state_flag::LAST != 0 {
            return;
        }
        if !core.setpoints.has(state.tick) {
            ports.drain_setpoints(&mut core.setpoints, links);
        }
        let faults = faults_of(core, &state);
        core.injector.take_time(&faults);
        let mut torque = core.answer(&state, &faults);
        torque.received_ns = core.injector.stamp_ns(received_ns);
        slack.report_in(&mut torque);
        publish(core, ports, torque, &state, &faults);
        next.expect_after(&state);
        slack.spend(core, ports, evidence);
    }
}

/// When the next state is expected, and so how it is waited for. Only the active controller spins.
struct NextState {
    id: u32,
    period_ns: u64,
    early_ns: u64,
    rest_ns: u64,
    active: bool,
    expected_ns: u64,
}

impl NextState {
    fn new(ports: &Ports, id: u32) -> Self {
        let scenario = &ports.joined.scenario;
        let period_ns = scenario.period_ns();
        Self {
            id,
            period_ns,
            early_ns: scenario.loop_.lead_ns().min(EARLY_NS),
            rest_ns: ports.states_bell.may_rest_ns(period_ns),
            active: false,
            expected_ns: 0,
        }
    }

    /// The newest state, and when it was received; none if nothing comes for a while.
    fn wait(&mut self, ports: &Ports) -> Option<(State, u64)> {
        let block = &ports.joined.block;
        let until_ns = clock::now_ns().max(self.expected_ns) + LOOK_NS;
        let look = || ports.states.take();
        let state = if self.active && ports.states_bell.is_time_triggered() {
            // It wakes a little early and looks for the state from then on.
            clock::sleep_until_ns((self.expected_ns - self.early_ns).max(clock::now_ns() + self.rest_ns));
            ports.states_bell.wait(block, self.expected_ns, until_ns, &mut 0, look)
        } else {
            ports.states_bell.wait_asleep(block, until_ns, look)
        };
        let Some(state) = state else {
            self.active = false;
            return None;
        };
        let received_ns = clock::now_ns();
        // Only one that has waited may have a successor; an empty look costs a tenth of a microsecond on every tick.
        if received_ns > state.published_ns + self.period_ns / 2
            && let Some(newer) = ports.states.latest()
        {
            return Some((newer, clock::now_ns()));
        }
        Some((state, received_ns))
    }

    /// A warm-up state says when the first one comes once that is known: before, there is no instant to spin for.
    fn expect_after(&mut self, state: &State) {
        self.active = state.active == self.id && state.deadline_ns != 0;
        self.expected_ns = state.deadline_ns + self.period_ns;
    }
}

/// What the slack after a tick has shown; the next torque reports it.
#[derive(Default)]
struct Slack {
    evidence: Evidence,
    mapped: bool,
}

impl Slack {
    fn report_in(&self, torque: &mut Torque) {
        torque.evidence = self.evidence;
        torque.flags |= if self.mapped { torque_flag::MAPPED } else { 0 };
    }

    /// Takes setpoints, maps what has joined, looks for a fault by command, and reads the evidence.
    fn spend<C: Controller>(&mut self, core: &mut ControllerCore<C>, ports: &Ports, evidence: &mut EvidenceReader) {
        let links = core.links();
        ports.drain_setpoints(&mut core.setpoints, links);
        let from_ns = clock::now_ns();
        ports.update_connections();
        self.mapped = clock::now_ns() - from_ns > role::MAPPING_NS;
        core.injector.read_board(ports.joined.block.faults());
        self.evidence = evidence.read();
    }
}

fn is_warm_up(state: &State) -> bool {
    state.flags & state_flag::WARM_UP != 0
}

/// What is injected into the answer to a state: nothing in the warm-up, whose states have no tick.
fn faults_of<C: Controller>(core: &ControllerCore<C>, state: &State) -> FaultActions {
    if is_warm_up(state) { FaultActions::default() } else { core.injector.at_tick(state.tick) }
}

/// Publishes the answer to a state. The marker *withheld* serves lockstep; here such an answer is simply not given.
fn publish<C: Controller>(
    core: &mut ControllerCore<C>,
    ports: &Ports,
    mut torque: Torque,
    state: &State,
    faults: &FaultActions,
) {
    if torque.flags & torque_flag::WITHHELD != 0 {
        return;
    }
    if is_warm_up(state) {
        torque.tick = WARM_UP_TICK;
    }
    torque.published_ns = core.injector.stamp_ns(clock::now_ns());
    core.injector.publish(torque, faults, |torque| {
        ports.torques.send(torque);
    });
    ports.torque_bell.ring(&ports.joined.block);
}
