//! This process's end: sends states, waits for torques, and times the exchange, as the plant would.

use anyhow::{Result, anyhow};
use loopbound_plant::{Opening, PlantCore};
use loopbound_scenario::Scenario;
use loopbound_shared::clock;
use loopbound_shared::doorbell::{Bell, ControlBlock};
use loopbound_shared::event::Role;
use loopbound_shared::group::Group;
use loopbound_shared::ports::{Node, Publisher, Subscriber};
use loopbound_shared::sample::{State, Torque};
use loopbound_shared::wakeup::{Ringer, Waiter};
use std::sync::atomic::Ordering;

use crate::echo_end::{spin, word};
use crate::mechanism::Mechanism;
use crate::raw::Page;
use crate::transport::End;
use crate::{LINKS, MODES, SILENCE_NS, place_of, setpoint};

/// Exchanges at the start of each block that are not recorded: both ends find their caches and their pace.
const WARM_UP: u64 = 64;
/// How long before the deadline a time-triggered plant wakes, as in the default scenario.
const LEAD_NS: u64 = 250_000;

pub(crate) struct PlantEnd {
    bare: End<State, Torque>,
    bells: Vec<(Waiter, Ringer)>,
    states: Publisher<State>,
    torques: Subscriber<Torque>,
    core: Box<PlantCore<LINKS>>,
    /// How far the core's time has come.
    plant_ns: u64,
    next_tick: u64,
    orders_given: u32,
    page: Page,
    block: ControlBlock,
    _node: Node,
}

/// The ticks of a block and their pace.
#[derive(Clone, Copy)]
struct Plan {
    first_tick: u64,
    count: u64,
    /// 0: back to back.
    period_ns: u64,
    /// How long before a deadline to wake and spin.
    lead_ns: u64,
}

impl PlantEnd {
    /// Makes what the echo opens, so before it is started.
    pub(crate) fn open(group: &Group) -> Result<Self> {
        let block = ControlBlock::create(&group.file("bell"))?;
        block.writers().enlist(Role::Plant, 1, std::process::id());
        let node = Node::open(group)?;
        let mut core = Box::new(PlantCore::new(&Scenario::default(), true)?);
        let member = |e| anyhow!("the plant refuses its controller: {e:?}");
        core.authority.add(1).map_err(member)?;
        core.authority.appoint(1).map_err(member)?;
        let bells = MODES
            .iter()
            .map(|mode| Ok((Waiter::new(&node, *mode, Bell::Torque)?, Ringer::new(&node, *mode, Bell::State)?)))
            .collect::<Result<_>>()?;
        Ok(Self {
            bare: End::open(group)?,
            bells,
            states: node.publisher()?,
            torques: node.subscriber(usize::MAX)?,
            core,
            plant_ns: 0,
            next_tick: 1,
            orders_given: 0,
            page: Page::create(&group.file("raw"))?,
            block,
            _node: node,
        })
    }

    /// Tells the echo to end.
    pub(crate) fn dismiss(&mut self) {
        self.page.orders.mechanism.store(u32::MAX, Ordering::Relaxed);
        self.orders_given += 1;
        self.page.orders.number.store(self.orders_given, Ordering::Release);
    }

    /// One block of `count` exchanges, each timed from before the state is sent to after the torque is read, ns; then
    /// a rest, so that this real-time process leaves the core a fifth of the time.
    pub(crate) fn run_block(&mut self, mechanism: Mechanism, count: u64, period_ns: u64) -> Result<Vec<u64>> {
        let plan = self.order(mechanism, count + WARM_UP, period_ns)?;
        let from_ns = clock::now_ns();
        let mut latencies_ns = Vec::with_capacity(usize::try_from(plan.count)?);
        let complete = self.exchange(mechanism, plan, |latency_ns| latencies_ns.push(latency_ns));
        if !complete {
            return Err(anyhow!("{}: exchange {} was not answered", mechanism.name(), latencies_ns.len() + 1));
        }
        clock::sleep_ns((clock::now_ns() - from_ns) / 4 + 500_000);
        latencies_ns.drain(..usize::try_from(WARM_UP)?);
        Ok(latencies_ns)
    }

    fn order(&mut self, mechanism: Mechanism, count: u64, period_ns: u64) -> Result<Plan> {
        let time_triggered =
            matches!(mechanism, Mechanism::Project(mode) if self.bells[place_of(mode)].0.is_time_triggered());
        let lead_ns = if time_triggered { LEAD_NS.min(period_ns / 2) } else { 0 };
        let plan = Plan { first_tick: self.next_tick, count, period_ns, lead_ns };
        self.next_tick += count;
        self.orders_given += 1;
        let orders = &self.page.orders;
        orders.mechanism.store(mechanism.index(), Ordering::Relaxed);
        orders.count.store(count, Ordering::Relaxed);
        orders.first_tick.store(plan.first_tick, Ordering::Relaxed);
        orders.period_ns.store(period_ns, Ordering::Relaxed);
        orders.number.store(self.orders_given, Ordering::Release);
        // What can't be mapped shows as an answer that does not come.
        let _ = self.states.update_connections() && self.torques.update_connections();
        let until_ns = clock::now_ns() + 5_000_000_000;
        while orders.ready.load(Ordering::Acquire) != self.orders_given {
            if clock::now_ns() > until_ns {
                return Err(anyhow!("the echo process does not take orders"));
            }
            clock::sleep_ns(100_000);
        }
        // Let the echo fall asleep, or begin to spin.
        clock::sleep_ns(100_000);
        Ok(plan)
    }

    fn exchange(&mut self, mechanism: Mechanism, plan: Plan, record: impl FnMut(u64)) -> bool {
        let (page, bare) = (&self.page, &self.bare);
        match mechanism {
            Mechanism::RawSpin => time_each(plan, record, |state| {
                page.states.put(*state, word(state.tick));
                spin(|| page.torques.get(word(state.tick)))
            }),
            Mechanism::RawFutex => time_each(plan, record, |state| {
                page.states.put(*state, word(state.tick));
                page.states.wake();
                page.torques.sleep_for(word(state.tick), &page.orders)
            }),
            Mechanism::TransportPolled => time_each(plan, record, |state| {
                bare.send(*state);
                spin(|| bare.take())
            }),
            Mechanism::TransportEvents => time_each(plan, record, |state| {
                bare.send(*state);
                bare.ring();
                crate::by_events(bare)
            }),
            Mechanism::Project(mode) => {
                let ((waiter, ringer), mut gap_ns) = (&self.bells[place_of(mode)], 0);
                time_each(plan, record, |state| {
                    self.states.send(*state);
                    ringer.ring(&self.block);
                    let now_ns = clock::now_ns();
                    let for_this = || self.torques.take().filter(|torque| torque.tick == state.tick);
                    waiter.wait(&self.block, now_ns, now_ns + SILENCE_NS, &mut gap_ns, for_this)
                })
            }
            Mechanism::Worked => self.exchange_with_plant(plan, record),
            // Processes of its own.
            Mechanism::Product(_) => true,
        }
    }

    /// As the loop of the plant, without its slack: from the sample to the torque that acts.
    fn exchange_with_plant(&mut self, plan: Plan, mut record: impl FnMut(u64)) -> bool {
        let Self { core, plant_ns, states, torques, bells, block, .. } = self;
        let ((waiter, ringer), mut gap_ns) = (&bells[place_of(crate::WORKED_IN)], 0);
        // The plant's time stands still between two blocks: nobody controls it there.
        let t_0_ns = clock::now_ns() - *plant_ns;
        core.start_at(t_0_ns);
        for tick in plan.first_tick..plan.first_tick + plan.count {
            core.setpoints.enter(&setpoint(tick), LINKS);
            let sampled_ns = clock::now_ns();
            let grace_deadline_ns = sampled_ns + SILENCE_NS;
            let opening = Opening {
                tick,
                deadline_ns: sampled_ns,
                sampled_ns,
                grace_deadline_ns,
                skipped: 0,
                wake_late_ns: u64::MAX,
            };
            let mut state = core.open(opening);
            state.published_ns = clock::now_ns();
            core.stamp_published(state.published_ns, grace_deadline_ns, false);
            states.send(state);
            ringer.ring(block);
            waiter.wait(block, clock::now_ns(), grace_deadline_ns, &mut gap_ns, || {
                while let Some(torque) = torques.take() {
                    core.arrive(&torque, clock::now_ns());
                }
                core.authority.is_settled().then_some(())
            });
            let settled_ns = clock::now_ns();
            if !core.authority.is_settled() {
                return false;
            }
            core.grace_passed(settled_ns);
            record(settled_ns - sampled_ns);
            *plant_ns = sampled_ns - t_0_ns;
        }
        true
    }
}

/// Runs the ticks of a plan: at its pace, or back to back. False at the first state without an answer.
fn time_each(plan: Plan, mut record: impl FnMut(u64), mut exchange: impl FnMut(&State) -> Option<Torque>) -> bool {
    let mut state = State { links: 3, q: [0.5; 7], v: [0.25; 7], ..State::zeroed() };
    let start_ns = clock::now_ns() + 2 * plan.period_ns;
    for (k, tick) in (plan.first_tick..plan.first_tick + plan.count).enumerate() {
        (state.tick, state.deadline_ns) = (tick, clock::now_ns());
        if plan.period_ns > 0 {
            state.deadline_ns = start_ns + k as u64 * plan.period_ns;
            clock::sleep_until_ns(state.deadline_ns - plan.lead_ns);
            clock::spin_until_ns(state.deadline_ns);
        }
        let from_ns = clock::now_ns();
        state.published_ns = from_ns;
        let torque = exchange(&state);
        let took_ns = clock::now_ns() - from_ns;
        if std::hint::black_box(torque).is_none() {
            return false;
        }
        record(took_ns);
    }
    true
}
