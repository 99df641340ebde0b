//! The plant's ports, and the commands that reach it through them.

use std::sync::atomic::Ordering;

use loopbound_scenario::Mode;
use loopbound_shared::clock;
use loopbound_shared::doorbell::Bell;
use loopbound_shared::event::{CommandKind, LiveFault, Refusal};
use loopbound_shared::ports::{Announces, CommandServer, Publisher, Subscriber};
use loopbound_shared::role::{Joined, RoleError};
use loopbound_shared::sample::{
    Announce, Command, Reply, Setpoint, State, TickRecord, Torque, WARM_UP_TICK, state_flag,
};
use loopbound_shared::wakeup::{Ringer, Waiter};

use crate::replies;
use crate::tick::PlantCore;

/// How often to look for the order to start.
const START_LOOK_NS: u64 = 200_000;

/// Everything that the plant sends and receives by.
pub(crate) struct Ports {
    pub(crate) states: Publisher<State>,
    pub(crate) records: Publisher<TickRecord>,
    pub(crate) announce: Publisher<Announce>,
    pub(crate) torques: Subscriber<Torque>,
    pub(crate) setpoints: Subscriber<Setpoint>,
    announces: Announces,
    commands: CommandServer,
    pub(crate) torque_bell: Waiter,
    pub(crate) state_bell: Ringer,
    /// Its number among the plants.
    pub(crate) id: u32,
    /// Dropped last: the hold on the group outlives the ports.
    pub(crate) joined: Joined,
}

/// What the supervisor asked of the loop itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Orders {
    /// Start the clock.
    pub(crate) start: bool,
    /// The tick at which to end, not published any more.
    pub(crate) stop_at: Option<u64>,
    /// The fault that was injected last into a controller.
    pub(crate) injected: Option<InjectedFault>,
}

impl Orders {
    /// Whether the run ends before `tick`, which is not published any more.
    pub(crate) fn is_over(&self, tick: u64) -> bool {
        self.stop_at.is_some_and(|stop| tick >= stop)
    }
}

/// The ticks in which an injected fault shows: what follows from it is attributed to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct InjectedFault {
    kind: LiveFault,
    target: u32,
    first: u64,
    end: u64,
    noted: bool,
}

impl InjectedFault {
    fn of(command: &Command, tick: u64, period_ns: u64) -> Option<Self> {
        let kind = u32::try_from(command.option).ok().and_then(LiveFault::from_code)?;
        // The present tick has been decided.
        let first = command.tick.max(tick + 1);
        let end = first.saturating_add(command.ns.div_ceil(period_ns));
        Some(Self { kind, target: command.controller, first, end, noted: false })
    }

    /// Marks `tick`, if it is one of them and nobody else has taken over.
    pub(crate) fn mark<const N: usize>(&mut self, core: &mut PlantCore<N>, tick: u64) {
        let (active, _) = core.authority.active();
        if !(self.first..self.end).contains(&tick) || (active != self.target && active != 0) {
            return;
        }
        let first_time = !std::mem::replace(&mut self.noted, true);
        core.note_fault(first_time.then_some((self.kind, self.target, self.end - self.first)));
    }
}

impl Ports {
    pub(crate) fn open(joined: Joined, id: u32) -> Result<Self, RoleError> {
        let (node, mode) = (&joined.node, joined.scenario.loop_.wakeup);
        Ok(Self {
            states: node.publisher()?,
            records: node.publisher()?,
            announce: node.publisher()?,
            torques: node.subscriber(usize::MAX)?,
            setpoints: node.subscriber(usize::MAX)?,
            announces: node.announces()?.uncounted(),
            commands: node.command_server()?,
            torque_bell: Waiter::new(node, mode, Bell::Torque)?,
            state_bell: Ringer::new(node, mode, Bell::State)?,
            id,
            joined,
        })
    }

    /// Maps what has joined or left, in the slack.
    pub(crate) fn update_connections(&self) {
        // Every field is named, so that no port can be forgotten.
        let Self {
            states,
            records,
            announce,
            torques,
            setpoints,
            announces,
            commands,
            torque_bell: _,
            state_bell: _,
            id: _,
            joined: _,
        } = self;
        // What can't be mapped now belongs to a process that is just dying; the next look finds it gone.
        let _ = torques.update_connections();
        let _ = setpoints.update_connections();
        let _ = states.update_connections();
        let _ = records.update_connections();
        let _ = announce.update_connections();
        let _ = announces.update_connections();
        let _ = commands.update_connections();
    }

    /// The next torque that is meant for a tick: answers to the warm-up may still come when the first one is open.
    pub(crate) fn next_torque(&self) -> Option<Torque> {
        loop {
            let torque = self.torques.take()?;
            if torque.tick != WARM_UP_TICK {
                return Some(torque);
            }
        }
    }

    /// Enters all setpoints that have come.
    pub(crate) fn drain_setpoints<const N: usize>(&self, core: &mut PlantCore<N>) {
        while self.setpoints.take_with(|setpoint| core.setpoints.enter(setpoint, N)).is_some() {}
    }

    /// Notes how many torques were none of this run's, for the record.
    pub(crate) fn count_strangers<const N: usize>(&self, core: &mut PlantCore<N>) {
        core.authority.journal.counters.unknown_writer += self.torques.take_strangers();
    }

    /// Waits for the supervisor's order to start; none if the group was stopped before.
    pub(crate) fn await_start<const N: usize>(
        &self,
        core: &mut PlantCore<N>,
        stopped: &dyn Fn() -> bool,
    ) -> Option<Orders> {
        let mut orders = Orders::default();
        while !orders.start {
            if stopped() {
                return None;
            }
            self.update_connections();
            self.drain_setpoints(core);
            self.serve(core, &mut orders);
            clock::sleep_until_ns(clock::now_ns() + START_LOOK_NS);
        }
        Some(orders)
    }

    /// Publishes the record of the tick that was closed last.
    pub(crate) fn publish_closed<const N: usize>(&self, core: &PlantCore<N>) {
        if let Some(record) = core.closed() {
            self.records.send(*record);
        }
    }

    /// Reads announcements and answers the supervisor.
    pub(crate) fn serve<const N: usize>(&self, core: &mut PlantCore<N>, orders: &mut Orders) {
        self.count_strangers(core);
        while let Some(announce) = self.announces.take() {
            core.learn(&announce);
        }
        self.commands.answer_all(|command| {
            let tick = core.authority.tick();
            match CommandKind::from_code(command.kind) {
                Some(CommandKind::Start) => {
                    if let Err(refusal) = core.authority.appoint(command.controller) {
                        return replies::refused(refusal);
                    }
                    orders.start = true;
                    orders.stop_at = Some(command.tick);
                    replies::done(tick)
                }
                Some(CommandKind::StopAt) if command.tick <= tick && core.has_opened() => {
                    orders.stop_at = Some(tick + 1);
                    Reply { reason: Refusal::TickPassed.code(), ..replies::done(tick) }
                }
                Some(CommandKind::StopAt) => {
                    orders.stop_at = Some(command.tick);
                    replies::done(tick)
                }
                // In lockstep no tick is marked: there faults are the scenario's.
                Some(CommandKind::Fault) if self.joined.scenario.loop_.mode == Mode::Realtime => {
                    let period_ns = self.joined.scenario.period_ns();
                    let Some(injected) = InjectedFault::of(command, tick, period_ns) else {
                        return replies::refused(Refusal::BadCommand);
                    };
                    orders.injected = Some(injected);
                    replies::done(injected.first)
                }
                _ => core.command(command),
            }
        });
    }

    /// Tells everyone that no tick follows.
    pub(crate) fn tell_end(&self) {
        let block = &self.joined.block;
        block.pace().plant_ended.store(1, Ordering::SeqCst);
        self.states.send(State { flags: state_flag::LAST, ..State::zeroed() });
        self.state_bell.ring(block);
        block.ring(Bell::State);
        block.ring(Bell::Pace);
    }
}
