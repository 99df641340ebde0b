//! The other process: answers states with torques, by the mechanism of each order, as a controller would.

use std::sync::atomic::Ordering;

use anyhow::Result;
use loopbound_controller::{Builtin, ControllerCore};
use loopbound_model::law::LawKind;
use loopbound_scenario::Scenario;
use loopbound_shared::clock;
use loopbound_shared::doorbell::{Bell, ControlBlock};
use loopbound_shared::event::Role;
use loopbound_shared::fault::FaultActions;
use loopbound_shared::group::Group;
use loopbound_shared::ports::{Node, Publisher, Subscriber};
use loopbound_shared::realtime;
use loopbound_shared::sample::{State, Torque};
use loopbound_shared::say;
use loopbound_shared::wakeup::{Ringer, Waiter};

use crate::mechanism::Mechanism;
use crate::raw::Page;
use crate::transport::End;
use crate::{LINKS, MODES, SILENCE_NS, SPIN_LOOKS, pause, place_of, setpoint};

/// As the controllers: how long before the expected state a time-triggered one wakes.
const EARLY_NS: u64 = 100_000;
/// How far ahead the setpoints are entered.
const SETPOINTS_AHEAD: u64 = 1024;

struct EchoEnd {
    page: Page,
    bare: End<Torque, State>,
    bells: Vec<(Waiter, Ringer)>,
    states: Subscriber<State>,
    torques: Publisher<Torque>,
    core: ControllerCore<Builtin<LINKS>>,
    block: ControlBlock,
    _node: Node,
}

/// What one order asks for.
#[derive(Clone, Copy)]
struct Order {
    count: u64,
    first_tick: u64,
    period_ns: u64,
}

/// Joins the group, says on standard output which privileges it has, and answers until it is told to end.
pub(crate) fn run(name: &str, parent: u32, request: &realtime::Request) -> Result<()> {
    realtime::die_with_parent(parent)?;
    let group = Group::join(name)?;
    let mut end = EchoEnd::open(&group)?;
    let mut entered = realtime::enter(request);
    entered.populate_shared(&[group.prefix().as_str()]);
    say::out!("{}", entered.privileges());
    let mut done = 0;
    loop {
        let orders = &end.page.orders;
        let number = orders.number.load(Ordering::Acquire);
        if number == done {
            // Seldom: while the product is measured its controller has this core.
            clock::sleep_ns(5_000_000);
            continue;
        }
        let order = Order {
            count: orders.count.load(Ordering::Relaxed),
            first_tick: orders.first_tick.load(Ordering::Relaxed),
            period_ns: orders.period_ns.load(Ordering::Relaxed),
        };
        let Some(mechanism) = Mechanism::ALL.get(orders.mechanism.load(Ordering::Relaxed) as usize) else {
            // The plant is the last to leave, so that its group is swept by it.
            return Ok(());
        };
        end.prepare(order);
        end.page.orders.ready.store(number, Ordering::Release);
        end.answer(*mechanism, order);
        done = number;
    }
}

impl EchoEnd {
    fn open(group: &Group) -> Result<Self> {
        let block = ControlBlock::open(&group.file("bell"))?;
        block.writers().enlist(Role::Controller, 1, std::process::id());
        let node = Node::open(group)?;
        let scenario = Scenario::default();
        let bells = MODES
            .iter()
            .map(|mode| Ok((Waiter::new(&node, *mode, Bell::State)?, Ringer::new(&node, *mode, Bell::Torque)?)))
            .collect::<Result<_>>()?;
        Ok(Self {
            page: Page::open(&group.file("raw"))?,
            bare: End::open(group)?,
            bells,
            states: node.subscriber(8)?,
            torques: node.publisher()?,
            core: ControllerCore::new(&scenario, 1, Builtin::new(&scenario, LawKind::Robust)?),
            block,
            _node: node,
        })
    }

    fn prepare(&mut self, order: Order) {
        // What can't be mapped shows as an answer that does not come.
        let _ = self.states.update_connections() && self.torques.update_connections();
        for tick in order.first_tick..order.first_tick + SETPOINTS_AHEAD {
            self.core.setpoints.enter(&setpoint(tick), LINKS);
        }
    }

    fn answer(&mut self, mechanism: Mechanism, order: Order) {
        let (page, bare) = (&self.page, &self.bare);
        match mechanism {
            Mechanism::RawSpin => answer_each(order, |tick| {
                let state = spin(|| page.states.get(word(tick)))?;
                page.torques.put(reply(&state), word(tick));
                Some(state)
            }),
            Mechanism::RawFutex => answer_each(order, |tick| {
                let state = page.states.sleep_for(word(tick), &page.orders)?;
                page.torques.put(reply(&state), word(tick));
                page.torques.wake();
                Some(state)
            }),
            Mechanism::TransportPolled => answer_each(order, |_| {
                let state = spin(|| bare.take())?;
                bare.send(reply(&state));
                Some(state)
            }),
            Mechanism::TransportEvents => answer_each(order, |_| {
                let state = crate::by_events(bare)?;
                bare.send(reply(&state));
                bare.ring();
                Some(state)
            }),
            Mechanism::Project(mode) => {
                let (waiter, ringer) = &self.bells[place_of(mode)];
                self.answer_as_controller(order, waiter, ringer, reply);
            }
            Mechanism::Worked => self.answer_with_law(order),
            // Processes of its own.
            Mechanism::Product(_) => {}
        }
    }

    /// As the loop of the controllers, without its slack.
    fn answer_as_controller(&self, order: Order, waiter: &Waiter, ringer: &Ringer, reply: impl Fn(&State) -> Torque) {
        let (block, mut gap_ns, mut next_ns) = (&self.block, 0, 0);
        answer_each(order, |_| {
            let until_ns = clock::now_ns() + SILENCE_NS;
            let newest = || self.states.latest();
            let state = if waiter.is_time_triggered() {
                if order.period_ns > 0 && next_ns > 0 {
                    clock::sleep_until_ns(next_ns - EARLY_NS);
                }
                waiter.wait(block, next_ns, until_ns, &mut gap_ns, newest)?
            } else {
                waiter.wait_asleep(block, until_ns, newest)?
            };
            let mut torque = reply(&state);
            torque.received_ns = clock::now_ns();
            torque.published_ns = clock::now_ns();
            self.torques.send(torque);
            ringer.ring(block);
            next_ns = state.deadline_ns + order.period_ns;
            Some(state)
        });
    }

    fn answer_with_law(&mut self, order: Order) {
        let Self { core, states, torques, bells, block, .. } = self;
        let ((waiter, ringer), mut gap_ns) = (&bells[place_of(crate::WORKED_IN)], 0);
        answer_each(order, |_| {
            let now_ns = clock::now_ns();
            let state = waiter.wait(block, now_ns, now_ns + SILENCE_NS, &mut gap_ns, || states.latest())?;
            let received_ns = clock::now_ns();
            let mut torque = core.answer(&state, &FaultActions::default());
            torque.received_ns = received_ns;
            torque.published_ns = clock::now_ns();
            torques.send(torque);
            ringer.ring(block);
            core.setpoints.enter(&setpoint(state.tick + SETPOINTS_AHEAD), LINKS);
            Some(state)
        });
    }
}

/// Answers the order's states in turn; gives up at the first that does not come (the plant notices).
fn answer_each(order: Order, mut answer: impl FnMut(u64) -> Option<State>) {
    for tick in order.first_tick..order.first_tick + order.count {
        if answer(tick).is_none() {
            return;
        }
    }
}

/// Spins until `look` finds something; none after a long silence.
pub(crate) fn spin<R>(mut look: impl FnMut() -> Option<R>) -> Option<R> {
    let until_ns = clock::now_ns() + SILENCE_NS;
    loop {
        for _ in 0..SPIN_LOOKS {
            if let Some(found) = look() {
                return Some(found);
            }
            pause();
        }
        if clock::now_ns() >= until_ns {
            return None;
        }
    }
}

/// The word of a tick in the raw slots.
#[expect(clippy::cast_possible_truncation, reason = "equal words of one slot are 2^32 ticks apart")]
pub(crate) const fn word(tick: u64) -> u32 {
    tick as u32
}

/// An answer without a law.
fn reply(state: &State) -> Torque {
    Torque {
        tick: state.tick,
        state_published_ns: state.published_ns,
        writer: 1,
        epoch: state.epoch,
        links: state.links,
        tau: state.q,
        ..Torque::zeroed()
    }
}
