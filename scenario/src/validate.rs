//! The limits of all values. What is refused here never starts a process.

mod events;
mod physics;

use super::Scenario;
use super::error::{Place, ScenarioError};
use super::names::Restart;
use super::sections::{LoopSection, SwapGateSection};
use super::units::{Nanos, format_duration};
use super::{
    ACTUATION_TICKS_MAX, POLL_NS_MAX, POLL_TICKS_MAX, ROLLBACK_WINDOW_MAX, SETPOINTS_AHEAD_MAX, TRACE_TICKS_MAX,
};
use loopbound_model::quote;
use std::fmt::Display;

/// The longest name of a group: it becomes part of file names of limited length.
const GROUP_NAME_LENGTH_MAX: usize = 32;
/// The slowest and the fastest loop (Hz). Above, the period is too short for an exchange between two processes.
const RATE_HZ: std::ops::RangeInclusive<f64> = 1.0..=50_000.0;
/// The highest priority that leaves the kernel's own threads above the loop.
const PRIORITY_MAX: u32 = 98;
/// As many standbys as the wire has publishers for, less the active controller and one that comes in by a swap.
const STANDBY_MAX: u32 = 6;

/// The largest number of a scenario: its square, multiplied by a few others of its size, is still far from infinite.
const MAGNITUDE_MAX: f64 = 1e12;
/// The smallest number that is not zero, likewise.
const MAGNITUDE_MIN: f64 = 1e-12;
/// Injected faults, which every process looks through every tick.
const FAULTS_MAX: usize = 1000;
/// Torques of disturbance and sines of a reference, which are added up every tick.
const TERMS_MAX: usize = 100;
/// Steps of the integrator in a period: more take longer than any loop waits.
const STEPS_MAX: u64 = 1000;

/// A refusal of the value at `key`.
fn refuse<T>(key: impl Display, found: impl Display, allowed: impl Display) -> Result<T, ScenarioError> {
    Err(ScenarioError::Value {
        place: Place::Nowhere,
        key: key.to_string(),
        found: found.to_string(),
        allowed: allowed.to_string(),
    })
}

/// Refuses the value unless `ok`; NaN makes every comparison false, so it is refused with the rest.
fn require(ok: bool, key: impl Display, found: impl Display, allowed: impl Display) -> Result<(), ScenarioError> {
    if ok { Ok(()) } else { refuse(key, found, allowed) }
}

/// Refuses a number that is not positive, or so small or large that products of it could leave the range of a double.
fn positive(key: impl Display, value: f64) -> Result<(), ScenarioError> {
    let ok = (MAGNITUDE_MIN..=MAGNITUDE_MAX).contains(&value);
    require(ok, key, quote::number(value), "a positive, finite number, 1e-12 to 1e12")
}

/// The same for a number that may be zero.
fn not_negative(key: impl Display, value: f64) -> Result<(), ScenarioError> {
    let ok = value == 0.0 || (MAGNITUDE_MIN..=MAGNITUDE_MAX).contains(&value);
    require(ok, key, quote::number(value), "zero or a positive, finite number, 1e-12 to 1e12")
}

/// The same for a number of any sign.
fn finite(key: impl Display, value: f64) -> Result<(), ScenarioError> {
    require(value.abs() <= MAGNITUDE_MAX, key, quote::number(value), "a finite number, -1e12 to 1e12")
}

/// Refuses a list that is too long to be looked through every tick.
fn at_most(key: &str, found: usize, most: usize) -> Result<(), ScenarioError> {
    require(found <= most, key, format_args!("{found} of them"), format_args!("at most {most}"))
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
        check_loop(&self.loop_)?;
        physics::check(self)?;
        check_operation(self)?;
        check_gate(&self.swap_gate)?;
        events::check(self)?;
        check_expectations(self)
    }
}

fn check_loop(section: &LoopSection) -> Result<(), ScenarioError> {
    require(RATE_HZ.contains(&section.rate.0), "loop.rate", section.rate, "1Hz to 50kHz (a period of at least 20us)")?;
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
    require(section.late_ns() > 0, "loop.late", Nanos(section.late_ns()), "above zero")?;
    let settle = section.settle_ns();
    require(settle <= duration.ns(), "loop.settle", Nanos(settle), format_args!("at most the duration of {duration}"))?;
    let shortest = period.div_ceil(STEPS_MAX);
    let allowed = format_args!("at least {}, a thousandth of the period", format_duration(shortest)).to_string();
    require(section.max_step.ns() >= shortest, "loop.max_step", section.max_step, allowed)
}

/// `[realtime]`, `[supervisor]`, `[monitor]` and the number of standbys.
fn check_operation(scenario: &Scenario) -> Result<(), ScenarioError> {
    let standby = scenario.controller.standby;
    require(standby <= STANDBY_MAX, "controller.standby", standby, format_args!("0 to {STANDBY_MAX}"))?;
    let empty = scenario.controller.exe.as_ref().is_some_and(|exe| exe.as_os_str().is_empty());
    require(!empty, "controller.exe", "\"\"", "the path of an executable")?;
    let priority = scenario.realtime.priority;
    require(priority <= PRIORITY_MAX, "realtime.priority", priority, "1 to 98, or 0 for the ordinary scheduler")?;
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
    require(supervisor.back_off.ns() > 0, "supervisor.back_off", supervisor.back_off, "above zero")?;
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
    require(gate.consecutive >= 1, "swap_gate.consecutive", gate.consecutive, "at least 1")?;
    let step = gate.torque_step_nm;
    require(step > 0.0, "swap_gate.torque_step_nm", quote::number(step), "a positive number, or inf")?;
    require(gate.timeout.ns() > 0, "swap_gate.timeout", gate.timeout, "above zero")?;
    let window = gate.rollback_window;
    let allowed = format_args!("1 to {ROLLBACK_WINDOW_MAX} ticks").to_string();
    require((1..=ROLLBACK_WINDOW_MAX).contains(&window), "swap_gate.rollback_window", window, allowed)?;
    let misses = gate.rollback_misses;
    let allowed = format_args!("1 to rollback_window, {window}").to_string();
    require((1..=window).contains(&misses), "swap_gate.rollback_misses", misses, allowed)
}

fn check_expectations(scenario: &Scenario) -> Result<(), ScenarioError> {
    let confidence = scenario.expect.confidence;
    let ok = confidence > 0.5 && confidence < 1.0;
    require(ok, "expect.confidence", quote::number(confidence), "between 0.5 and 1, both excluded")?;
    let empty = scenario.expect.conditions.iter().find(|condition| condition.key.trim().is_empty());
    require(empty.is_none(), "expect", "an empty key", "a key of the summary")
}
