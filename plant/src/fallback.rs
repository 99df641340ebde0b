//! What acts when no controller answers: *hold*, the last torque for as long as the certificate allows; then *damp*, the
//! plant's own damping with gravity compensation; and once all links are slow, the same as a safe *stop*. The steps are
//! drawn in [`crate::authority`].

use loopbound_model::certificate::Certificate;
use loopbound_model::certificate::sampling::hold_limit_s;
use loopbound_model::chain::{Chain, Vector};
use loopbound_model::law::LawKind;
use loopbound_scenario::system;
use loopbound_scenario::{Scenario, ScenarioError};
use loopbound_shared::clock::seconds;
use loopbound_shared::event::Decision;
use loopbound_shared::sample::{Links, TickRecord};

#[cfg(test)]
mod tests;

/// Below this speed of every link (rad/s) damping counts as a stop.
const STOPPED_RAD_S: f64 = 1e-3;
/// The damping is this share of what sampling allows (K h < 2 λ_min, see \[11]) …
const DAMPING_SHARE: f64 = 0.125;
/// … and at most this, N·m·s.
const DAMPING_MAX: f64 = 20.0;

/// The plant's own law: damping with gravity compensation, by the nominal model.
#[derive(Clone, Debug)]
pub struct Damping<const N: usize> {
    model: Chain<N>,
    damping: f64,
}

impl<const N: usize> Damping<N> {
    /// The damping of a scenario.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let lambda_lo = system::certificate_of::<N>(scenario, LawKind::Robust)?.envelope.lambda_lo();
        let damping = (DAMPING_SHARE * 2.0 * lambda_lo / seconds(scenario.period_ns())).min(DAMPING_MAX);
        Ok(Self { model: scenario.build_model()?, damping })
    }

    /// τ (N·m) at the measured q (rad) and q̇ (rad/s), before limits.
    #[must_use]
    pub fn torque(&self, q: &Vector<N>, v: &Vector<N>) -> Vector<N> {
        self.model.gravity(q) - v * self.damping
    }
}

/// The fallback: which step it is at, and since when.
pub(crate) struct Fallback<const N: usize> {
    certificate: Certificate,
    damping: Damping<N>,
    period_ns: u64,
    /// The plant has stopped for good, whoever answers.
    stopped: bool,
    /// Ticks in a row that nobody answered.
    ticks: u64,
    /// The last torque may be held until then; set by the first unanswered tick.
    hold_until_plant_ns: u64,
    /// Held, damped or stopped.
    step: Decision,
    changed: bool,
}

impl<const N: usize> Fallback<N> {
    pub(crate) fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let certificate = system::certificate_of::<N>(scenario, LawKind::Robust)?;
        let period_ns = scenario.period_ns();
        Ok(Self {
            certificate,
            damping: Damping::new(scenario)?,
            period_ns,
            stopped: false,
            ticks: 0,
            hold_until_plant_ns: 0,
            step: Decision::Held,
            changed: false,
        })
    }

    /// A controller's torque was accepted: the fallback ends. The ticks it took, if it went beyond holding.
    pub(crate) fn answered(&mut self) -> Option<u64> {
        let ticks = (self.step != Decision::Held).then_some(self.ticks);
        self.ticks = 0;
        self.step = Decision::Held;
        self.changed = false;
        ticks
    }

    /// The tick of `record` went unanswered; `v` is V of `robust` at its start if that is certified.
    pub(crate) fn unanswered(&mut self, record: &TickRecord, v: Option<f64>, held: &Links) {
        if self.ticks == 0 {
            let norm = held.iter().map(|x| x * x).sum::<f64>().sqrt();
            // [13], counted from the instant at which V was read; nothing is certified: nothing is held.
            let hold_s = v.map_or(0.0, |v| hold_limit_s(&self.certificate, v, norm));
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "finite, not negative, capped")]
            let hold_ns = (hold_s.clamp(0.0, 10.0) * 1e9) as u64;
            self.hold_until_plant_ns = record.start_plant_ns + hold_ns;
        }
        self.ticks += 1;
    }

    /// Stops for good, whoever answers from now on.
    pub(crate) fn stop(&mut self) {
        self.stopped = true;
        self.go_to(Decision::Stopped);
    }

    fn go_to(&mut self, step: Decision) {
        self.changed |= self.step != step;
        self.step = step;
    }

    /// The step that a tick without an answer counts under.
    pub(crate) fn decision(&self) -> Decision {
        self.step
    }

    /// The plant's own torque from `plant_ns` on, if the time to hold ends within the coming tick.
    pub(crate) fn own_torque(&mut self, plant_ns: u64, q: &Vector<N>, v: &Vector<N>) -> Option<Vector<N>> {
        if self.stopped {
            return Some(self.damping.torque(q, v));
        }
        if self.ticks == 0 || plant_ns + self.period_ns <= self.hold_until_plant_ns {
            return None;
        }
        self.go_to(if v.amax() < STOPPED_RAD_S { Decision::Stopped } else { Decision::Damped });
        Some(self.damping.torque(q, v))
    }

    /// The step and the ticks gone unanswered, once after each change.
    pub(crate) fn take_change(&mut self) -> Option<(Decision, u64)> {
        std::mem::take(&mut self.changed).then_some((self.step, self.ticks))
    }
}
