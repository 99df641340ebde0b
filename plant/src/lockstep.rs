//! The plant's loop on virtual time: t_k = k h. Each tick waits for an answer of every member, and for the setpoint of
//! the very tick; no timeout decides anything, so every run decides alike.

use std::sync::atomic::Ordering;

use loopbound_scenario::{Role, Scenario};
use loopbound_shared::clock;
use loopbound_shared::doorbell::Bell;
use loopbound_shared::fault::Injector;
use loopbound_shared::fault::injector::arrivals;
use loopbound_shared::sample::{State, Torque};

use crate::answers::Answers;
use crate::ports::{Orders, Ports};
use crate::tick::{Opening, PlantCore};

/// How long to spin for torques before sleeping at the doorbell.
const SPIN_NS: u64 = 20_000;
/// How often to look for commands and for the stop flag while nothing comes.
const LOOK_NS: u64 = 5_000_000;
/// The reference and the monitor are woken once in so many ticks.
const PACE_TICKS: u64 = 256;

pub(crate) fn run<const N: usize>(core: &mut PlantCore<N>, ports: &Ports, stopped: &dyn Fn() -> bool) {
    let Some(orders) = ports.await_start(core, stopped) else { return };
    let injector = Injector::new(&ports.joined.scenario, Role::Plant, ports.id);
    let mut cycle = Cycle { core, ports, orders, injector, stopped };
    let mut tick = 0;
    while !cycle.orders.is_over(tick) {
        if cycle.one_tick(tick).is_none() {
            return;
        }
        tick += 1;
    }
    cycle.finish(tick);
}

/// The loop: what it works on, and what it keeps from tick to tick.
struct Cycle<'a, const N: usize> {
    core: &'a mut PlantCore<N>,
    ports: &'a Ports,
    orders: Orders,
    injector: Injector<State>,
    stopped: &'a dyn Fn() -> bool,
}

impl<const N: usize> Cycle<'_, N> {
    /// One tick; none if the group was stopped meanwhile.
    fn one_tick(&mut self, tick: u64) -> Option<()> {
        self.announce(tick);
        self.injector.take_time(&self.injector.at_tick(tick));
        self.wait(tick)?;
        let state = open(self.core, tick, &self.ports.joined.scenario);
        self.ports.states.send(state);
        // In lockstep everyone waits at the doorbell, whatever the mode.
        self.ports.joined.block.ring(Bell::State);
        self.ports.publish_closed(self.core);
        let mut answers = self.gather(tick)?;
        judge(self.core, answers.as_mut_slice(), tick, &self.ports.joined.scenario);
        // A command changes membership at a tick: between two of them.
        if tick.is_multiple_of(PACE_TICKS) {
            self.ports.serve(self.core, &mut self.orders);
        }
        Some(())
    }

    /// Says which tick it is; those who need not know at once are woken now and then.
    fn announce(&self, tick: u64) {
        let block = &self.ports.joined.block;
        block.pace().plant_tick.store(tick, Ordering::Release);
        if tick.is_multiple_of(PACE_TICKS) {
            block.ring(Bell::Pace);
            self.ports.update_connections();
        }
    }

    /// Waits for the setpoint of the tick, and for credit: the launcher's monitor has room for the tick's record.
    fn wait(&mut self, tick: u64) -> Option<()> {
        let (core, ports) = (&mut *self.core, self.ports);
        let block = &ports.joined.block;
        let can_begin =
            |core: &PlantCore<N>| core.setpoints.has(tick) && block.pace().credit.load(Ordering::Acquire) > tick;
        while !can_begin(core) {
            if (self.stopped)() {
                return None;
            }
            block.wait(Bell::Pace, clock::now_ns() + LOOK_NS, || {
                ports.drain_setpoints(core);
                can_begin(core).then_some(())
            });
            ports.serve(core, &mut self.orders);
            ports.update_connections();
        }
        Some(())
    }

    /// Waits for the answer of every member.
    fn gather(&mut self, tick: u64) -> Option<Answers> {
        let (core, ports) = (&mut *self.core, self.ports);
        let block = &ports.joined.block;
        let mut answers = Answers::new();
        loop {
            let complete = ports.torque_bell.wait_lockstep(block, clock::now_ns() + LOOK_NS, SPIN_NS, || {
                while let Some(torque) = ports.torques.take() {
                    answers.note(&torque, core, tick);
                }
                answers.are_complete(core.authority.member_ids(), tick).then_some(())
            });
            if complete.is_some() {
                break;
            }
            if (self.stopped)() {
                return None;
            }
            // The supervisor says who is dead; until then the tick waits.
            ports.serve(core, &mut self.orders);
            ports.update_connections();
        }
        ports.count_strangers(core);
        Some(answers)
    }

    /// Ends the last tick where `tick` would begin.
    fn finish(&mut self, tick: u64) {
        self.core.finish(tick * self.ports.joined.scenario.period_ns());
        self.ports.publish_closed(self.core);
    }
}

/// Opens a tick at its virtual instant t_k = k h; the state to be published.
pub fn open<const N: usize>(core: &mut PlantCore<N>, tick: u64, scenario: &Scenario) -> State {
    let t_k_ns = tick * scenario.period_ns();
    let grace_deadline_ns = t_k_ns + scenario.loop_.grace_ns();
    let mut state = core.open(Opening {
        tick,
        deadline_ns: t_k_ns,
        sampled_ns: t_k_ns,
        grace_deadline_ns,
        skipped: 0,
        wake_late_ns: u64::MAX,
    });
    state.published_ns = t_k_ns;
    core.stamp_published(t_k_ns, grace_deadline_ns, false);
    state
}

/// Applies the answers of a tick in the order of their virtual arrival, as the realtime loop would see them.
pub fn judge<const N: usize>(core: &mut PlantCore<N>, answers: &mut [Torque], tick: u64, scenario: &Scenario) {
    let t_k_ns = tick * scenario.period_ns();
    let grace_ns = t_k_ns + scenario.loop_.grace_ns();
    let cutoff_ns = t_k_ns + scenario.period_ns() - scenario.loop_.lead_ns();
    answers.sort_unstable_by_key(|torque| (torque.tick != tick, torque.virtual_delay_ns, torque.writer));
    let mut grace_passed = false;
    for torque in answers {
        let arrives_ns = t_k_ns + torque.virtual_delay_ns;
        if arrives_ns > grace_ns && !grace_passed {
            core.grace_passed(grace_ns);
            grace_passed = true;
        }
        if arrives_ns > cutoff_ns {
            // By then the realtime loop is in the next tick.
            core.authority.came_late(torque, arrives_ns);
        } else {
            core.arrive(torque, arrives_ns);
            for arrival in arrivals(torque) {
                if arrival.in_its_tick {
                    core.arrive(&arrival.torque, arrives_ns);
                } else {
                    core.authority.journal.counters.stale += 1;
                }
            }
        }
    }
    if !grace_passed {
        core.grace_passed(grace_ns);
    }
}
