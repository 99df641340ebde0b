//! The controller's loop on the machine's clock: wait, read, compute, publish; everything else in the slack.

use loopbound_shared::clock;
use loopbound_shared::fault::{FaultActions, ROGUE_WRITER};
use loopbound_shared::realtime::{Evidence, EvidenceReader};
use loopbound_shared::role;
use loopbound_shared::sample::{Setpoint, State, Torque, WARM_UP_TICK, state_flag, torque_flag};

use crate::Controller;
use crate::core::ControllerCore;
use crate::serve::Ports;

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

pub(crate) fn run<C: Controller>(
    core: &mut ControllerCore<C>,
    ports: &Ports,
    evidence: &mut EvidenceReader,
    id: u32,
    stopped: &dyn Fn() -> bool,
) {
    let scenario = &ports.joined.scenario;
    let (block, links, period_ns) = (&ports.joined.block, scenario.links(), scenario.period_ns());
    let (early_ns, rest_ns) = (scenario.loop_.lead_ns().min(EARLY_NS), ports.states_bell.may_rest_ns(period_ns));
    let mut evidence_now = Evidence::default();
    let (mut active, mut gap_ns) = (false, 0);
    let mut mapped = false;
    let mut next_ns = 0;
    // Injected: a torque that is published after its successor.
    let mut kept_back = None;
    while !stopped() {
        let until_ns = clock::now_ns().max(next_ns) + LOOK_NS;
        let next_state = || ports.states.take();
        // Only the active controller spins: it wakes a little early and looks for the state from then on.
        let state = if active && ports.states_bell.is_time_triggered() {
            clock::sleep_until_ns((next_ns - early_ns).max(clock::now_ns() + rest_ns));
            ports.states_bell.wait(block, next_ns, until_ns, &mut gap_ns, next_state)
        } else {
            ports.states_bell.wait_asleep(block, until_ns, next_state)
        };
        let Some(mut state) = state else {
            active = false;
            ports.update_connections();
            ports.drain_setpoints(&mut core.setpoints, links);
            continue;
        };
        let mut received_ns = clock::now_ns();
        // Only one that has waited may have a successor; an empty look costs a tenth of a microsecond on every tick.
        if received_ns > state.published_ns + period_ns / 2
            && let Some(newer) = ports.states.latest()
        {
            state = newer;
            received_ns = clock::now_ns();
        }
        if state.flags & state_flag::LAST != 0 {
            return;
        }
        if !core.setpoints.has(state.tick) {
            ports.drain_setpoints(&mut core.setpoints, links);
        }
        let warm_up = state.flags & state_flag::WARM_UP != 0;
        let faults = if warm_up { FaultActions::default() } else { core.faults_at(state.tick) };
        if faults.any() {
            suffer(&faults);
        }
        let mut torque = core.answer(&state, &faults);
        torque.received_ns = core.stamp_ns(received_ns);
        if warm_up {
            torque.tick = WARM_UP_TICK;
        }
        torque.evidence = evidence_now;
        torque.flags |= if mapped { torque_flag::MAPPED } else { 0 };
        // The marker serves lockstep; here an answer that is withheld is simply not given.
        if torque.flags & torque_flag::WITHHELD == 0 {
            torque.published_ns = core.stamp_ns(clock::now_ns());
            if faults.any() {
                publish_spoilt(ports, &torque, &faults, &mut kept_back);
            } else {
                ports.torques.send(torque);
            }
            if let Some(old) = kept_back.take_if(|old| old.tick != torque.tick) {
                ports.torques.send(old);
            }
            ports.torque_bell.ring(block);
        }
        // A warm-up state says when the first one comes once that is known: before, there is no instant to spin for.
        (active, next_ns) = (state.active == id && state.deadline_ns != 0, state.deadline_ns + period_ns);
        ports.drain_setpoints(&mut core.setpoints, links);
        let mapping_from_ns = clock::now_ns();
        ports.update_connections();
        mapped = clock::now_ns() - mapping_from_ns > role::MAPPING_NS;
        core.heed(block.faults());
        evidence_now = evidence.read();
    }
}

/// The faults of publication.
fn publish_spoilt(ports: &Ports, torque: &Torque, faults: &FaultActions, kept_back: &mut Option<Torque>) {
    if let Some(rogue_nm) = faults.rogue_nm {
        let mut rogue = Torque { writer: ROGUE_WRITER, flags: 0, ..*torque };
        rogue.tau[..ports.joined.scenario.links()].fill(rogue_nm);
        ports.torques.send(rogue);
    }
    if faults.reorder {
        // Two in a row: the older one goes first, late enough as it is.
        if let Some(older) = kept_back.replace(*torque) {
            ports.torques.send(older);
        }
        return;
    }
    ports.torques.send(*torque);
    if faults.duplicate {
        ports.torques.send(*torque);
    }
}

/// The faults that take time or end it.
fn suffer(faults: &FaultActions) {
    if faults.kill {
        role::kill_self();
    }
    let pause_ns = faults.hang_ns.saturating_add(faults.delay_ns);
    if pause_ns > 0 {
        // Counted from here: what came before takes its own time, and the answer is later by just this.
        clock::wait_until_ns(clock::now_ns().saturating_add(pause_ns));
    }
}
