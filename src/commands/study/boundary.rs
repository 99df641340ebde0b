//! Where a sampled, delayed loop loses its stability: measured in lockstep, and predicted twice.
//!
//! Measured: the chain hangs at rest, its fastest mode is struck lightly, and the motion of that mode grows or dies
//! away. Delays of any length act between the ticks, so that bisection finds the boundary to a thousandth. Predicted by
//! the rule \[11], which knows the fastest mode alone, and by the spectral radius, which knows all of them.

use loopbound_model::bound::stability::radius::spectral_radius;
use loopbound_model::certificate::boundary::critical_rate;
use loopbound_model::chain::{Chain, Vector};
use loopbound_model::law::{Law, LawKind};
use loopbound_scenario::system;
use loopbound_scenario::{Hertz, Mode, PerLink, Scenario, ScenarioError};
use loopbound_shared::sample::to_vector;

use super::cases::nanos;
use crate::inprocess::InProcess;

/// Speed with which the fastest mode is struck, rad/s: so little that the chain stays linear.
const STRIKE_RAD_S: f64 = 1e-4;
/// Ticks of the two windows whose largest motion is compared; the longest oscillation at a boundary of the studies takes
/// 30 ticks.
const EARLY: std::ops::Range<u64> = 100..200;
const LATE: std::ops::Range<u64> = 500..600;
/// Halvings of a bracket: a thousandth of it is left.
const HALVINGS: usize = 10;

/// A loop whose boundary is sought.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe<const N: usize> {
    scenario: Scenario,
    law: Law<N>,
    plant: Chain<N>,
    mode: Vector<N>,
    /// Rate a of the fastest mode, 1/s.
    pub rate: f64,
    /// K_t, or K_d of `pd+g`, N·m·s.
    pub gain: f64,
}

/// A boundary three times: s of delay, or of period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Boundary {
    /// In lockstep.
    pub measured_s: f64,
    /// By \[11] and its continuation to d ≥ h.
    pub rule_s: f64,
    /// By the spectral radius.
    pub radius_s: f64,
}

impl Boundary {
    /// Deviation of \[11] from what was measured, relative.
    #[must_use]
    pub fn rule_deviation(&self) -> f64 {
        self.rule_s / self.measured_s - 1.0
    }

    /// Deviation of the spectral radius from what was measured, relative.
    #[must_use]
    pub fn radius_deviation(&self) -> f64 {
        self.radius_s / self.measured_s - 1.0
    }
}

impl<const N: usize> Probe<N> {
    /// `N` unit links under a law whose fastest mode has about the rate `rate` (1/s); none for a law that has no such
    /// mode.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn new(kind: LawKind, rate: f64) -> Result<Option<Self>, ScenarioError> {
        let mut scenario = Scenario::default();
        scenario.loop_.mode = Mode::Lockstep;
        scenario.plant.links = Some(N);
        scenario.controller.law = kind;
        // Standing still, hanging down: links are aligned, the worst configuration, and the loop is linear.
        scenario.reference.amplitude_rad = Some(PerLink::All(0.0));
        scenario.plant.start_q_rad = Some(PerLink::All(0.0));
        let plant = scenario.build_truth::<N>()?.chain;
        let (lambda, mode) = fastest_mode(&plant);
        let Some(found) = kind.gains_for_rate(rate, lambda, &system::gains(&scenario, kind)) else { return Ok(None) };
        let gains = &mut scenario.controller.gains;
        (gains.k_t, gains.kp, gains.kd) = (found.k_t, found.k_p, found.k_d);
        scenario.plant.start_v_rad_s = Some(PerLink::Each(mode.iter().map(|u| STRIKE_RAD_S * u).collect()));
        let certificate = system::certificate_of::<N>(&scenario, kind)?;
        let law = system::law::<N>(&scenario, kind)?;
        let gain = certificate.k_t();
        Ok(certificate.fast_rate.map(|rate| Self { scenario, law, plant, mode, rate, gain }))
    }

    /// The largest delay (s) at a period, and the least where there is one: above a h = 2 a loop needs some delay.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn delays(&self, period_s: f64) -> Result<Vec<Boundary>, ScenarioError> {
        // A quarter of the period is the best delay there is.
        let best = period_s / 4.0;
        let at = |delay_s: f64| (period_s, delay_s);
        let mut found = Vec::new();
        if let Some(outer) = self.first_unstable(best, period_s / 2.0, &at)? {
            found.push(self.between(best, outer, &at)?);
        }
        if self.rate * period_s > 2.0 {
            found.push(self.between(best, 0.0, &at)?);
        }
        Ok(found)
    }

    /// The longest period (s) at a delay (s), sought from the period `stable_s` on.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn period(&self, stable_s: f64, delay_s: f64) -> Result<Option<Boundary>, ScenarioError> {
        let at = |period_s: f64| (period_s, delay_s);
        let Some(outer) = self.first_unstable(stable_s, stable_s / 2.0, &at)? else { return Ok(None) };
        Ok(Some(self.between(stable_s, outer, &at)?))
    }

    /// The first of a few steps from a stable point at which nothing is stable any more, by measurement and prediction.
    fn first_unstable(
        &self,
        stable: f64,
        step: f64,
        at: &impl Fn(f64) -> (f64, f64),
    ) -> Result<Option<f64>, ScenarioError> {
        for steps in 1..64 {
            let here = stable + f64::from(steps) * step;
            if self.grows(at(here))? && self.rule_fails(at(here)) && self.radius_fails(at(here)) {
                return Ok(Some(here));
            }
        }
        Ok(None)
    }

    fn between(&self, holds: f64, fails: f64, at: &impl Fn(f64) -> (f64, f64)) -> Result<Boundary, ScenarioError> {
        let (mut inside, mut outside) = (holds, fails);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (inside + outside);
            if self.grows(at(middle))? { outside = middle } else { inside = middle }
        }
        Ok(Boundary {
            measured_s: 0.5 * (inside + outside),
            rule_s: bisect(holds, fails, |x| self.rule_fails(at(x))),
            radius_s: bisect(holds, fails, |x| self.radius_fails(at(x))),
        })
    }

    fn rule_fails(&self, (period_s, delay_s): (f64, f64)) -> bool {
        self.rate > critical_rate(period_s, delay_s)
    }

    fn radius_fails(&self, (period_s, delay_s): (f64, f64)) -> bool {
        spectral_radius(&self.law, &self.plant, &Vector::zeros(), period_s, delay_s) > 1.0
    }

    /// Whether the fastest mode grows.
    fn grows(&self, (period_s, delay_s): (f64, f64)) -> Result<bool, ScenarioError> {
        let mut scenario = self.scenario.clone();
        scenario.loop_.rate = Hertz(1e9 / nanos(period_s).ns() as f64);
        scenario.loop_.duration = nanos(period_s * (LATE.end + 1) as f64);
        scenario.plant.actuation_delay = nanos(delay_s);
        let mut group = InProcess::<N>::new(&scenario)?;
        let (mut early, mut late) = (0.0f64, 0.0f64);
        for _ in 0..=LATE.end {
            let Some(record) = group.step() else { continue };
            let (q, v) = (to_vector::<N>(&record.q), to_vector::<N>(&record.v));
            let motion = self.mode.dot(&(v + q * self.law.beta)).abs();
            if motion.is_nan() || motion >= 1e4 * STRIKE_RAD_S {
                return Ok(true);
            }
            if EARLY.contains(&record.tick) {
                early = early.max(motion);
            } else if LATE.contains(&record.tick) {
                late = late.max(motion);
            }
        }
        Ok(late > early)
    }
}

fn bisect(holds: f64, fails: f64, fails_at: impl Fn(f64) -> bool) -> f64 {
    let (mut inside, mut outside) = (holds, fails);
    for _ in 0..30 {
        let middle = 0.5 * (inside + outside);
        if fails_at(middle) { outside = middle } else { inside = middle }
    }
    0.5 * (inside + outside)
}

/// The least eigenvalue of M with aligned links, kg·m², and its direction: by inverse iteration.
fn fastest_mode<const N: usize>(plant: &Chain<N>) -> (f64, Vector<N>) {
    let rest = Vector::<N>::zeros();
    // Hanging down, gravity vanishes: the acceleration is M⁻¹τ. Neighbours in the fastest mode move against each other.
    let mut mode = Vector::<N>::from_fn(|i, _| if i % 2 == 0 { 1.0 } else { -1.0 }).normalize();
    let mut lambda = 1.0;
    for _ in 0..200 {
        let next = plant.acceleration(&rest, &rest, &mode);
        lambda = 1.0 / next.norm();
        mode = next.normalize();
    }
    (lambda, mode)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_measured_boundary_agrees_with_both_predictions_within_5_percent() {
        // Below one period, beyond one, and where a loop needs some delay; the study takes more points.
        for (rate, count) in [(600.0, 1), (1500.0, 1), (2600.0, 2)] {
            let found = Probe::<3>::new(LawKind::Robust, rate).unwrap().unwrap().delays(1e-3).unwrap();
            assert_eq!(found.len(), count, "{rate}");
            for boundary in found {
                let (rule, radius) = (boundary.rule_deviation().abs(), boundary.radius_deviation().abs());
                assert!(rule < 0.05 && radius < 0.01, "a = {rate}: {boundary:?}");
            }
        }
        let probe = Probe::<1>::new(LawKind::Robust, 1000.0).unwrap().unwrap();
        let longest = probe.period(1e-3, 0.0).unwrap().unwrap();
        // 2/a, by [11].
        assert!((longest.rule_s - 2e-3).abs() < 1e-6 && longest.rule_deviation().abs() < 0.05, "{longest:?}");
    }

    #[test]
    fn the_fastest_mode_of_three_unit_links_has_the_least_eigenvalue_of_the_documentation() {
        let plant = Scenario::default().build_truth::<3>().unwrap().chain;
        let (lambda, mode) = fastest_mode(&plant);
        assert!((lambda - 0.101_28).abs() < 1e-5, "{lambda}");
        assert!((plant.a() * mode - mode * lambda).norm() < 1e-12);
    }

    #[test]
    fn computed_torque_has_no_fast_mode_to_probe() {
        assert_eq!(Probe::<2>::new(LawKind::Ctc, 1000.0).unwrap(), None);
    }
}
