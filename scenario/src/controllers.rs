//! Which controllers a scenario has, and which swaps it schedules: the launcher and the single-process run must agree.

use std::path::PathBuf;

use crate::Scenario;
use loopbound_model::law::LawKind;

/// One controller of a scenario.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// Its id; the first is in charge at the start.
    pub id: u32,
    /// Its law, where it is a built-in one.
    pub law: LawKind,
    /// A user's executable instead.
    pub exe: Option<PathBuf>,
}

/// The controllers of a scenario, by id from 1: the one in charge, its standbys, and those of scheduled swaps, which
/// start before tick 0 so that they are warm.
#[must_use]
pub fn of(scenario: &Scenario) -> Vec<Part> {
    let own = &scenario.controller;
    let mut parts: Vec<Part> =
        (1..=1 + own.standby).map(|id| Part { id, law: own.law, exe: own.exe.clone() }).collect();
    for (id, swap) in (2 + own.standby..).zip(scenario.swap.iter().filter(|swap| swap.to.is_none())) {
        parts.push(Part { id, law: swap.law.unwrap_or(own.law), exe: swap.exe.clone() });
    }
    parts
}

/// A swap that the scenario schedules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scheduled {
    /// The first tick of the new controller.
    pub tick: u64,
    /// The new controller.
    pub to: u32,
}

/// The swaps of a scenario, in the order in which it lists them.
#[must_use]
pub fn scheduled_swaps(scenario: &Scenario) -> Vec<Scheduled> {
    let mut next_id = 2 + scenario.controller.standby;
    let scheduled = scenario.swap.iter().map(|swap| Scheduled {
        // Tick 0 is no boundary to switch at, and means "as soon as possible" besides.
        tick: swap.at.tick(scenario.period_ns()).max(1),
        to: swap.to.unwrap_or_else(|| {
            next_id += 1;
            next_id - 1
        }),
    });
    scheduled.collect()
}
