//! The plant's ports, and the commands that reach it through them.

use std::sync::atomic::Ordering;

use loopbound_scenario::{Mode, Role};
use loopbound_shared::doorbell::Bell;
use loopbound_shared::event::{CommandKind, LiveFault, Refusal, ReplyKind};
use loopbound_shared::fault::FaultPlan;
use loopbound_shared::ports::{Announces, CommandServer, Publisher, Subscriber};
use loopbound_shared::role::{Joined, RoleError};
use loopbound_shared::sample::{
    Announce, Command, Reply, Setpoint, State, TickRecord, Torque, WARM_UP_TICK, state_flag,
};
use loopbound_shared::wakeup::{Ringer, Waiter};

use crate::authority::Authority;
use crate::core::PlantCore;

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
    pub(crate) faults: FaultPlan,
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
    pub(crate) struck: Option<Struck>,
}

/// The ticks in which an injected fault shows: those that follow from it are put down to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Struck {
    kind: LiveFault,
    target: u32,
    first: u64,
    end: u64,
    noted: bool,
}

impl Struck {
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
            faults: FaultPlan::for_target(&joined.scenario, Role::Plant, id),
            joined,
        })
    }

    /// Maps what has joined or left, in the slack.
    pub(crate) fn update_connections(&self) {
        // What can't be mapped now belongs to a process that is just dying; the next look finds it gone.
        let _ = self.torques.update_connections();
        let _ = self.setpoints.update_connections();
        let _ = self.states.update_connections();
        let _ = self.records.update_connections();
        let _ = self.announce.update_connections();
        let _ = self.announces.update_connections();
        let _ = self.commands.update_connections();
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
        core.authority.counters.unknown_writer += self.torques.take_strangers();
    }

    /// Reads announcements and answers the supervisor.
    pub(crate) fn serve<const N: usize>(&self, core: &mut PlantCore<N>, orders: &mut Orders) {
        self.count_strangers(core);
        while let Some(announce) = self.announces.take() {
            core.learn(&announce);
        }
        self.commands.answer_all(|command| {
            let done = Reply { kind: ReplyKind::Done.code(), tick: core.authority.tick(), ..Reply::zeroed() };
            match CommandKind::from_code(command.kind) {
                Some(CommandKind::Start) => {
                    if let Err(refusal) = core.authority.appoint(command.controller) {
                        return Authority::refused(refusal);
                    }
                    (orders.start, orders.stop_at) = (true, Some(command.tick));
                    done
                }
                Some(CommandKind::StopAt) if command.tick <= core.authority.tick() && core.has_opened() => {
                    orders.stop_at = Some(core.authority.tick() + 1);
                    Reply { reason: Refusal::TickPassed.code(), ..done }
                }
                Some(CommandKind::StopAt) => {
                    orders.stop_at = Some(command.tick);
                    done
                }
                // In lockstep no tick is marked: there faults are the scenario's.
                Some(CommandKind::Fault) if self.joined.scenario.loop_.mode == Mode::Realtime => {
                    let period_ns = self.joined.scenario.period_ns();
                    let Some(struck) = Struck::of(command, core.authority.tick(), period_ns) else {
                        return Authority::refused(Refusal::BadCommand);
                    };
                    orders.struck = Some(struck);
                    Reply { tick: struck.first, ..done }
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
