//! What is refused before any process starts: numbers outside the limits of their keys, and keys that don't go together.
//!
//! The limit of a single key is declared with it ([`super::key`]); here is what depends on several.

mod events;
mod physics;

use super::Scenario;
use super::error::{ScenarioError, WrittenAt};
use super::key::{At, Value as _, key};
use super::names::Restart;
use super::sections::{LoopSection, SwapGateSection};
use super::units::{Nanos, format_duration};
use super::{ACTUATION_TICKS_MAX, POLL_NS_MAX, POLL_TICKS_MAX, SETPOINTS_AHEAD_MAX, TRACE_TICKS_MAX};
use loopbound_model::chain::LINKS_MAX;
use std::fmt::Display;

/// The longest name of a group: it becomes part of file names of limited length.
const GROUP_NAME_LENGTH_MAX: usize = 32;
/// Steps of the integrator in a period: more take longer than any loop waits.
const STEPS_MAX: u64 = 1000;

/// A refusal of the value at `key`.
pub(crate) fn refuse<T>(key: impl Display, found: impl Display, allowed: impl Display) -> Result<T, ScenarioError> {
    Err(ScenarioError::Value {
        place: WrittenAt::Nowhere,
        key: key.to_string(),
        found: found.to_string(),
        allowed: allowed.to_string(),
    })
}

/// Refuses the value unless `ok`.
pub(crate) fn require(
    ok: bool,
    key: impl Display,
    found: impl Display,
    allowed: impl Display,
) -> Result<(), ScenarioError> {
    if ok { Ok(()) } else { refuse(key, found, allowed) }
}

/// Checks the name of a group: 1 to 32 of the characters a–z, A–Z, 0–9, `_` and `-`.
///
/// # Errors
/// One line that says what was found and what is allowed.
pub fn check_group_name(name: &str) -> Result<(), ScenarioError> {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    let ok = (1..=GROUP_NAME_LENGTH_MAX).contains(&name.len()) && name.chars().all(plain);
    require(ok, "group", format_args!("{name:?}"), "1 to 32 of the characters a-z A-Z 0-9 _ -")
}

impl Scenario {
    /// Checks all values; loading a scenario has done so already.
    ///
    /// # Errors
    /// The first value outside its limits, by its dotted key.
    pub fn validate(&self) -> Result<(), ScenarioError> {
        // The number of links comes first: lists with one number a link are held to it.
        let links = self.links();
        let blamed = if self.plant.links.is_some() { "plant.links" } else { "plant" };
        let allowed = format_args!("1 to {LINKS_MAX} links").to_string();
        require((1..=LINKS_MAX).contains(&links), blamed, format_args!("{links} links"), allowed)?;
        self.check(&At { path: String::new(), key: &key(), links })?;
        check_loop(&self.loop_)?;
        physics::check(self)?;
        check_operation(self)?;
        check_gate(&self.swap_gate)?;
        events::check(self)?;
        let empty = self.expect.conditions.iter().find(|condition| condition.key.trim().is_empty());
        require(empty.is_none(), "expect", "an empty key", "a key of the summary")
    }
}

fn check_loop(section: &LoopSection) -> Result<(), ScenarioError> {
    let period = section.period_ns();
    let shown = format_duration(period);
    let duration = section.duration;
    require(duration.ns() >= period, "loop.duration", duration, format_args!("at least one period of {shown}"))?;
    let (grace, lead) = (section.grace_ns(), section.lead_ns());
    let within = format_args!("above zero and at most the period of {shown}").to_string();
    require(grace > 0 && grace <= period, "loop.grace", Nanos(grace), &within)?;
    require(lead < period, "loop.lead", Nanos(lead), format_args!("less than the period of {shown}"))?;
    let room =
        format_args!("at most {}, what the grace leaves of the period", format_duration(period - grace)).to_string();
    let blamed = if section.lead.is_none() { "loop.grace" } else { "loop.lead" };
    if grace + lead > period && section.lead.is_none() {
        let left = format_duration(period - lead);
        return refuse(blamed, Nanos(grace), format_args!("at most {left}, what the lead leaves of the period"));
    }
    require(grace + lead <= period, blamed, Nanos(lead), room)?;
    let phase = section.phase_ns();
    require(phase < period, "loop.phase", Nanos(phase), format_args!("less than the period of {shown}"))?;
    let settle = section.settle_ns();
    require(settle <= duration.ns(), "loop.settle", Nanos(settle), format_args!("at most the duration of {duration}"))?;
    let shortest = period.div_ceil(STEPS_MAX);
    let allowed = format_args!("at least {}, a thousandth of the period", format_duration(shortest)).to_string();
    require(section.max_step.ns() >= shortest, "loop.max_step", section.max_step, allowed)
}

/// `[realtime]`, `[supervisor]`, `[monitor]`.
fn check_operation(scenario: &Scenario) -> Result<(), ScenarioError> {
    if let super::Cores::List(cores) = &scenario.realtime.cores {
        require(!cores.is_empty(), "realtime.cores", "[]", "\"auto\", or at least one core")?;
        for (index, core) in cores.iter().enumerate() {
            let most = rustix::thread::CpuSet::MAX_CPU - 1;
            require(*core <= most, format_args!("realtime.cores[{index}]"), core, format_args!("0 to {most}"))?;
            let new = !cores[..index].contains(core);
            require(new, format_args!("realtime.cores[{index}]"), core, "each core once")?;
        }
    }
    let supervisor = &scenario.supervisor;
    let plant = supervisor.plant;
    require(plant == Restart::End, "supervisor.plant", plant, "end: the state of the plant dies with it")?;
    let at_least = format_args!("at least back_off, {}", supervisor.back_off).to_string();
    let longest = supervisor.back_off_max;
    require(longest >= supervisor.back_off, "supervisor.back_off_max", longest, at_least)?;
    check_leads(scenario)?;
    let monitor = &scenario.monitor;
    let longest = Nanos((POLL_TICKS_MAX * scenario.period_ns()).min(POLL_NS_MAX));
    let allowed = format_args!("above zero, at most {longest}: {POLL_TICKS_MAX} periods, or a second").to_string();
    require(monitor.poll.ns() > 0 && monitor.poll <= longest, "monitor.poll", monitor.poll, allowed)?;
    let at_least = format_args!("at least poll, {}", monitor.poll).to_string();
    require(monitor.finalise >= monitor.poll, "monitor.finalise", monitor.finalise, at_least)
}

/// Times of which something is kept for every tick: none is longer than there is room.
fn check_leads(scenario: &Scenario) -> Result<(), ScenarioError> {
    let period = scenario.period_ns();
    let within = |key: &str, found: u64, ticks: u64| {
        let longest = Nanos(ticks * period);
        let allowed = format_args!("at most {ticks} periods, {longest}").to_string();
        require(found <= longest.ns(), key, Nanos(found), allowed)
    };
    let lead = scenario.setpoint_lead_ns();
    within("reference.lead", lead, SETPOINTS_AHEAD_MAX)?;
    let allowed = format_args!("at least one period, {}", format_duration(period)).to_string();
    require(lead >= period, "reference.lead", Nanos(lead), allowed)?;
    within("plant.actuation_delay", scenario.plant.actuation_delay.ns(), u64::from(ACTUATION_TICKS_MAX))?;
    within("monitor.trace", scenario.monitor.trace.ns(), u64::from(TRACE_TICKS_MAX))
}

fn check_gate(gate: &SwapGateSection) -> Result<(), ScenarioError> {
    let (misses, window) = (gate.rollback_misses, gate.rollback_window);
    let allowed = format_args!("1 to rollback_window, {window}").to_string();
    require((1..=window).contains(&misses), "swap_gate.rollback_misses", misses, allowed)
}
