//! Notices that the plant's tick no longer advances.
//!
//! In lockstep nobody else can: the plant waits for every member, and only the supervisor may decide that one is dead.

use std::sync::atomic::Ordering::SeqCst;

use loopbound_scenario::Role;
use loopbound_shared::event::CommandKind;
use loopbound_shared::sample::Command;

use super::{ANSWER_NS, Supervisor};

/// Wall time without a tick after which somebody is held to be dead. The same for all scenarios: a member that takes
/// longer for one torque is of no use at any rate.
pub(super) const STALL_NS: u64 = 2_000_000_000;

/// The last tick seen and since when.
#[derive(Debug)]
pub(super) struct Watchdog {
    tick: u64,
    since_ns: u64,
    limit_ns: u64,
}

impl Watchdog {
    /// Starts to watch. `period_ns` is the plant's in realtime, 0 in lockstep.
    pub(super) fn new(now_ns: u64, period_ns: u64) -> Self {
        Self { tick: 0, since_ns: now_ns, limit_ns: STALL_NS + 2 * period_ns }
    }

    /// Whether `tick` has stood for too long. After a yes it waits for as long again.
    pub(super) fn stalled(&mut self, now_ns: u64, tick: u64) -> bool {
        if tick != self.tick {
            (self.tick, self.since_ns) = (tick, now_ns);
        }
        let stalled = now_ns.saturating_sub(self.since_ns) >= self.limit_ns;
        if stalled {
            self.since_ns = now_ns;
        }
        stalled
    }
}

impl Supervisor<'_> {
    /// The plant's tick has stood for two seconds: kills whom it waits for.
    pub(super) fn kill_who_is_silent(&mut self) {
        let tick = self.tick();
        let silent = self.silent_in(tick);
        if self.tick() != tick {
            // Whoever it was does its part again.
            return;
        }
        for index in silent {
            self.children[index].kill();
            self.note(&format!("{} is silent in tick {tick}: killed", self.children[index].process.name()));
        }
    }

    /// Those who don't do their part in `tick`, by the order in which the plant waits for them.
    fn silent_in(&mut self, tick: u64) -> Vec<usize> {
        // In realtime the plant waits for nobody; in lockstep it answers commands while it waits.
        let status = Command { kind: CommandKind::SwapStatus.code(), ..Command::zeroed() };
        if !self.lockstep() || self.commands.ask(status, ANSWER_NS).is_err() {
            return self.living(Role::Plant);
        }
        self.listen();
        // Before it samples it needs room at the monitor, and the setpoint of the very tick.
        if !self.hearing.has_opened(tick) {
            let no_room = self.block.pace().credit.load(SeqCst) <= tick;
            return self.living(if no_room { Role::Monitor } else { Role::Reference });
        }
        let mut silent = self.living(Role::Controller);
        silent.retain(|&index| {
            let id = self.children[index].process.id;
            !self.hearing.has_answered(id, tick)
        });
        // With all that it waits for it would go on.
        if silent.is_empty() { self.living(Role::Plant) } else { silent }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_that_stands_is_noticed_once_a_limit_and_one_that_moves_never() {
        let mut watchdog = Watchdog::new(0, 0);
        assert!((1..100).all(|k| !watchdog.stalled(k * 1_900_000_000, k)));
        let last_ns = 99 * 1_900_000_000;
        assert!(!watchdog.stalled(last_ns + STALL_NS - 1, 99));
        assert!(watchdog.stalled(last_ns + STALL_NS, 99));
        assert!(!watchdog.stalled(last_ns + STALL_NS + 1, 99));
        assert!(watchdog.stalled(last_ns + 2 * STALL_NS, 99));
    }
}
