//! Limits of scheduled swaps and injected faults.

use super::{refuse, require};
use crate::error::ScenarioError;
use crate::names::{Distribution, FaultKind, Mode, Role};
use crate::units::LONGEST_NS;
use crate::{CONTROLLERS_MAX, FaultSpec, Nanos, Scenario, SwapSpec, When};

pub(super) fn check(scenario: &Scenario) -> Result<(), ScenarioError> {
    check_members(scenario)?;
    for (index, swap) in scenario.swap.iter().enumerate() {
        check_swap(index, swap, controllers(scenario))?;
        check_instant(&format!("swap[{index}].at"), Some(swap.at), scenario.period_ns())?;
    }
    let links = scenario.links();
    let lockstep = scenario.loop_.mode == Mode::Lockstep;
    for (index, fault) in scenario.fault.iter().enumerate() {
        check_fault(index, fault, links, lockstep)?;
        for (name, when) in [("at", fault.at), ("for", fault.for_), ("every", fault.every)] {
            check_instant(&format!("fault[{index}].{name}"), when, scenario.period_ns())?;
        }
    }
    Ok(())
}

/// How many controllers there are: the first, its standbys, and those that scheduled swaps start.
fn controllers(scenario: &Scenario) -> usize {
    let started = scenario.swap.iter().filter(|swap| swap.to.is_none()).count();
    1 + scenario.controller.standby as usize + started
}

/// Every controller of a scenario is a member from the start.
fn check_members(scenario: &Scenario) -> Result<(), ScenarioError> {
    let members = controllers(scenario);
    let found = format_args!(
        "{} swaps to new controllers beside {} standbys",
        scenario.swap.iter().filter(|swap| swap.to.is_none()).count(),
        scenario.controller.standby
    )
    .to_string();
    require(members <= CONTROLLERS_MAX, "swap", found, format_args!("{CONTROLLERS_MAX} controllers in all"))
}

/// An instant or a length in ticks is no longer than one in time may be.
fn check_instant(key: &str, when: Option<When>, period_ns: u64) -> Result<(), ScenarioError> {
    let Some(When::Tick(tick)) = when else { return Ok(()) };
    let most = LONGEST_NS / period_ns;
    require(tick <= most, key, format_args!("tick {tick}"), format_args!("at most {most}, {}", Nanos(LONGEST_NS)))
}

fn check_swap(index: usize, swap: &SwapSpec, controllers: usize) -> Result<(), ScenarioError> {
    let named = [swap.law.is_some(), swap.exe.is_some(), swap.to.is_some()].into_iter().filter(|given| *given).count();
    let key = format!("swap[{index}]");
    require(named == 1, &key, format_args!("{named} of law, exe, to"), "exactly one of law, exe, to")?;
    let to = swap.to.unwrap_or(1);
    let ok = (1..=controllers).contains(&(to as usize));
    require(ok, format_args!("{key}.to"), to, format_args!("the number of a controller, 1 to {controllers}"))
}

/// The roles that a fault of this kind can be injected into.
fn roles(kind: FaultKind) -> &'static [Role] {
    use Role::{Controller, Monitor, Plant, Reference};
    match kind {
        FaultKind::Kill | FaultKind::Hang => &[Reference, Controller, Plant, Monitor],
        // A monitor stamps nothing.
        FaultKind::Delay | FaultKind::Drop | FaultKind::Duplicate | FaultKind::Reorder | FaultKind::ClockStep => {
            &[Reference, Controller, Plant]
        }
        FaultKind::Nan => &[Reference, Controller],
        FaultKind::Glitch | FaultKind::Late | FaultKind::Rogue => &[Controller],
        FaultKind::StaleSetpoint => &[Reference],
    }
}

fn check_fault(index: usize, fault: &FaultSpec, links: usize, lockstep: bool) -> Result<(), ScenarioError> {
    let section = format!("fault[{index}]");
    let key = |name: &str| format!("{section}.{name}");
    let (roles, target) = (roles(fault.kind), fault.target());
    let allowed = roles.iter().map(|role| role.name()).collect::<Vec<_>>().join(", ");
    require(
        roles.contains(&target.role),
        key("target"),
        target,
        format_args!("{allowed} for kind \"{}\"", fault.kind),
    )?;
    // In virtual time every member waits for every state: one can't be late, lost or doubled.
    let of_states = target.role == Role::Plant && !matches!(fault.kind, FaultKind::Kill | FaultKind::Hang);
    require(
        !(lockstep && of_states),
        key("target"),
        target,
        format_args!("kill or hang of the plant in lockstep; kind \"{}\" of it needs realtime", fault.kind),
    )?;
    check_window(&section, fault)?;
    check_delay(&section, fault)?;
    let joint = fault.joint.unwrap_or(1);
    require((1..=links).contains(&joint), key("joint"), joint, format_args!("1 to {links}, a link of the chain"))?;
    let seed = fault.seed.unwrap_or(1);
    require(i64::try_from(seed).is_ok(), key("seed"), seed, "below 2^63")
}

fn check_window(section: &str, fault: &FaultSpec) -> Result<(), ScenarioError> {
    let key = |name: &str| format!("{section}.{name}");
    let once = matches!(fault.kind, FaultKind::Kill | FaultKind::Hang);
    let placed = fault.at.is_some() || fault.every.is_some() || fault.probability.is_some();
    if once && !placed {
        return refuse(key("at"), "nothing", format_args!("at, every or probability for kind \"{}\"", fault.kind));
    }
    Ok(())
}

fn check_delay(section: &str, fault: &FaultSpec) -> Result<(), ScenarioError> {
    let key = |name: &str| format!("{section}.{name}");
    let distribution = fault.distribution();
    let spread = distribution != Distribution::Constant;
    if spread && fault.delay_max.is_none() {
        return refuse(
            key("delay_max"),
            "nothing",
            format_args!("a value, which distribution \"{distribution}\" needs"),
        );
    }
    if let Some(longest) = fault.delay_max {
        require(spread, key("delay_max"), longest, "none with distribution \"constant\"")?;
        let delay = fault.delay.unwrap_or_default();
        require(longest > delay, key("delay_max"), longest, format_args!("above delay, {delay}"))?;
    }
    if distribution == Distribution::Pareto {
        let delay = fault.delay.unwrap_or_default();
        require(delay.ns() > 0, key("delay"), delay, "above zero with distribution \"pareto\"")?;
    }
    if let Some(shape) = fault.shape {
        require(distribution == Distribution::Pareto, key("shape"), shape, "none but with distribution \"pareto\"")?;
    }
    Ok(())
}
