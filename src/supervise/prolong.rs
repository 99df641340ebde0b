//! Prolonging a run whose verdict is open: the supervisor reads what the launcher's monitor last found, and moves the
//! tick at which the plant stops. Never in lockstep, where more time is not more data of the same kind.

use loopbound_monitor::handover::Handover as _;
use loopbound_monitor::verdict::Interim;
use loopbound_scenario::Scenario;
use loopbound_shared::event::CommandKind;
use loopbound_shared::headline::Headline;
use loopbound_shared::sample::Command;

use super::Supervisor;

/// How long before the end it is decided; a look, a block and the way of the records lie in between.
const AHEAD_NS: u64 = 500_000_000;
/// By how much a run grows at a time.
const STEP_NS: u64 = 1_000_000_000;

/// How long the run is now, and how long it may become.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prolonging {
    stop_tick: u64,
    most: u64,
    period_ns: u64,
}

impl Prolonging {
    /// As long as `scenario` says.
    pub(super) fn new(scenario: &Scenario) -> Self {
        let (stop_tick, period_ns) = (scenario.loop_.ticks(), scenario.period_ns());
        Self { stop_tick, most: scenario.end_tick_at_most(), period_ns }
    }

    /// The first tick that the plant does not run any more.
    pub(super) fn stop_tick(&self) -> u64 {
        self.stop_tick
    }

    /// The tick at which the plant is to stop instead, if it should go on.
    fn look(&self, tick: u64, interim: Option<&Interim>) -> Option<u64> {
        let near = tick.saturating_add(AHEAD_NS / self.period_ns + 1) >= self.stop_tick;
        // No verdict yet means no block yet: the run was shorter than one.
        let open = interim.is_none_or(|interim| Headline::of_word(&interim.status).is_some_and(Headline::is_open));
        let longer = || self.stop_tick.saturating_add(STEP_NS.div_ceil(self.period_ns)).min(self.most);
        (near && open && self.stop_tick < self.most).then(longer)
    }
}

impl Supervisor<'_> {
    /// The first tick that the plant will not run, however often the run is prolonged.
    pub(super) fn end_tick(&self) -> u64 {
        self.prolonging.stop_tick.max(self.prolonging.most)
    }

    /// At every look at a running group.
    pub(super) fn prolong_if_undecided(&mut self) {
        if !self.scenario.may_be_prolonged() {
            return;
        }
        let interim = Interim::read(&self.group.file(Interim::FILE));
        let Some(stop) = self.prolonging.look(self.tick(), interim.as_ref()) else { return };
        let command = Command { kind: CommandKind::StopAt.code(), tick: stop, ..Command::zeroed() };
        // A plant that is just ending may not answer: then the run stays as long as it was.
        if self.command(command).is_ok() {
            self.prolonging.stop_tick = stop;
            self.options.progress.set_length(stop);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interim(status: &str) -> Interim {
        Interim { tick: 0, status: status.to_owned() }
    }

    #[test]
    fn a_run_grows_a_second_at_a_time_while_it_is_open_and_never_beyond_its_most() {
        let of = |stop_tick| Prolonging { stop_tick, most: 6_500, period_ns: 1_000_000 };
        let at = |tick, stop, status| of(stop).look(tick, Some(&interim(status)));
        assert_eq!(at(1_000, 5_000, "inconclusive"), None);
        assert_eq!(at(4_600, 5_000, "inconclusive"), Some(6_000));
        assert_eq!(at(5_600, 6_000, "inconclusive"), Some(6_500));
        assert_eq!(at(6_400, 6_500, "inconclusive"), None);
        for decided in ["passed", "failed", "violated"] {
            assert_eq!(at(4_600, 5_000, decided), None);
        }
        assert_eq!(of(100).look(10, None), Some(1_100));
    }
}
