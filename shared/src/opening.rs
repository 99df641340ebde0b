//! What the plant is told before a run starts: the launcher and the single-process run must agree.

use loopbound_scenario::Scenario;
use loopbound_scenario::controllers::{self, Scheduled, scheduled_swaps};

use crate::event::CommandKind;
use crate::sample::Command;

/// What the plant is told before it starts: its members, the scheduled swaps, and the start itself, which appoints the
/// first controller and ends the run before `stop_tick`.
#[must_use]
pub fn commands(scenario: &Scenario, stop_tick: u64) -> Vec<Command> {
    let command = |kind: CommandKind, controller: u32| Command { kind: kind.code(), controller, ..Command::zeroed() };
    let mut commands: Vec<Command> =
        controllers::of(scenario).iter().map(|part| command(CommandKind::AddMember, part.id)).collect();
    for (swap, Scheduled { tick, to }) in scenario.swap.iter().zip(scheduled_swaps(scenario)) {
        commands.push(Command {
            tick,
            ns: swap.blend.unwrap_or(scenario.swap_gate.blend).ns(),
            option: u64::from(swap.force),
            ..command(CommandKind::Swap, to)
        });
    }
    commands.push(Command { tick: stop_tick, ..command(CommandKind::Start, 1) });
    commands
}
