//! From a latency to the gains that it allows: the smallest proven |e|, and the scenario with these gains.

use std::cell::RefCell;
use std::collections::HashMap;

use loopbound_model::certificate::Certificate;
use loopbound_model::certificate::sampling::sampling_budget;
use loopbound_model::with_links;
use loopbound_monitor::hops::HIGHEST_NS;
use loopbound_scenario::system;
use loopbound_scenario::system::advice::{Remedy, best_gains};
use loopbound_scenario::{Scenario, ScenarioError};

/// Searches gains for the latencies of one scenario, each search once.
#[derive(Debug)]
pub struct Designer {
    base: Scenario,
    room: f64,
    found: RefCell<HashMap<(u64, u64), Option<Remedy>>>,
}

impl Designer {
    /// For this scenario; `room` is the share of \[11] that a gain may use.
    #[must_use]
    pub fn new(base: Scenario, room: f64) -> Self {
        Self { base, room, found: RefCell::default() }
    }

    /// The gains with the smallest proven |e| for torques up to `latency_ns` late; none if nothing is certified.
    ///
    /// Latency varies from tick to tick, so the loop has to be stable with *every* constant delay up to that. By \[11]
    /// the least stable one below h/2 is no delay at all (the hold alone), above it the longest.
    #[must_use]
    pub fn smallest(&self, rate_hz: f64, latency_ns: f64) -> Option<Remedy> {
        if is_never(latency_ns) {
            return None;
        }
        let period_s = 1.0 / rate_hz;
        let delay_s = latency_ns * 1e-9 + self.base.plant.actuation_delay.seconds();
        let delay_s = if delay_s <= period_s / 2.0 { 0.0 } else { delay_s };
        let key = (rate_hz.to_bits(), delay_s.to_bits());
        let search = || with_links!(self.base.links(), best_gains::<N>(&self.base, period_s, delay_s, self.room));
        // The scenario was built when the study began, so nothing is hidden by the second `ok`.
        self.found.borrow_mut().entry(key).or_insert_with(|| search().ok().flatten()).clone()
    }

    /// The scenario with the gains that were found for one that differs from it in its loop alone.
    ///
    /// # Errors
    /// If the scenario refuses them.
    pub fn with_gains(scenario: &Scenario, found: &Remedy) -> Result<Scenario, ScenarioError> {
        scenario.with_sets(&found.settings)
    }

    /// The scenario to measure at a rate: as it is if it is stable by \[11] without delay and with one of half a period,
    /// else with gains that are. Latency does not depend on gains, but a robot that flies apart would disturb it.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn to_measure(&self, scenario: &Scenario) -> Result<Scenario, ScenarioError> {
        let half_ns = scenario.period_ns() / 2;
        let used = |delay_ns: f64| budget_used(scenario, delay_ns).map(|used| used.unwrap_or(0.0));
        if used(0.0)?.max(used(half_ns as f64)?) < 1.0 {
            return Ok(scenario.clone());
        }
        let found = self.smallest(scenario.loop_.rate.0, 0.0);
        found.map_or_else(|| Ok(scenario.clone()), |found| Self::with_gains(scenario, &found))
    }
}

/// Whether a latency is that of torques that did not come: longer than a histogram reaches, or no number.
#[must_use]
pub fn is_never(latency_ns: f64) -> bool {
    latency_ns.is_nan() || latency_ns > HIGHEST_NS as f64
}

/// Share of \[11] that a scenario's own gains use at a latency; none where \[11] does not apply, or no torque came.
///
/// # Errors
/// If the scenario describes no system.
pub fn budget_used(scenario: &Scenario, latency_ns: f64) -> Result<Option<f64>, ScenarioError> {
    if is_never(latency_ns) {
        return Ok(None);
    }
    let certificate = with_links!(scenario.links(), certificate::<N>(scenario))?;
    let delay_s = latency_ns * 1e-9 + scenario.plant.actuation_delay.seconds();
    let budget = sampling_budget(&certificate, scenario.period_ns() as f64 * 1e-9, delay_s);
    Ok(budget.map(|budget| budget.used).filter(|used| used.is_finite()))
}

fn certificate<const N: usize>(scenario: &Scenario) -> Result<Certificate, ScenarioError> {
    system::certificate_of::<N>(scenario, scenario.controller.law)
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_model::law::LawKind;
    use loopbound_scenario::{Hertz, LoopSection};

    fn designer() -> Designer {
        Designer::new(Scenario::default(), 0.6)
    }

    #[test]
    fn a_later_torque_never_proves_a_smaller_error_and_below_half_a_period_the_hold_alone_counts() {
        let designer = designer();
        let norms: Vec<f64> = [0.0, 100e3, 499e3, 700e3, 900e3]
            .map(|latency_ns| {
                designer.smallest(1e3, latency_ns).map_or(f64::INFINITY, |found| found.certificate.ultimate_e)
            })
            .to_vec();
        assert!(norms[0] > 0.0 && norms[0].is_finite(), "{norms:?}");
        assert_eq!((norms[0].to_bits(), norms[1].to_bits()), (norms[1].to_bits(), norms[2].to_bits()));
        assert!(norms[2] < norms[3] && norms[3] <= norms[4], "{norms:?}");
        assert!(
            designer.smallest(5e3, 50e3).unwrap().certificate.ultimate_e < norms[0],
            "a faster loop may be stiffer"
        );
        assert!(designer.smallest(1e3, 1.8e19).is_none(), "a torque that never came");
    }

    #[test]
    fn the_scenario_with_the_found_gains_has_the_certificate_that_was_found() {
        let found = designer().smallest(2e3, 300e3).unwrap();
        let mut scenario = Designer::with_gains(&Scenario::default(), &found).unwrap();
        scenario.loop_.rate = Hertz(2e3);
        let again = system::certificate_of::<3>(&scenario, LawKind::Robust).unwrap();
        assert!(again.is_certified());
        let found = found.certificate;
        for (a, b) in [(again.ultimate_e, found.ultimate_e), (again.k_t(), found.k_t())] {
            assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
        }
        let used = budget_used(&scenario, 300e3).unwrap().unwrap();
        assert!(used <= 0.6 + 1e-9, "{used}");
        assert_eq!(budget_used(&scenario, u64::MAX as f64).unwrap(), None);
    }

    #[test]
    fn gains_that_fly_apart_at_a_rate_are_replaced_and_others_kept() {
        let at = |rate| Scenario {
            loop_: LoopSection { rate: Hertz(rate), ..LoopSection::default() },
            ..Scenario::default()
        };
        let designer = designer();
        assert_eq!(designer.to_measure(&at(1e3)).unwrap(), at(1e3));
        let replaced = designer.to_measure(&at(500.0)).unwrap();
        assert!(budget_used(&at(500.0), 0.0).unwrap().unwrap() > 1.0);
        assert!(budget_used(&replaced, 0.0).unwrap().unwrap() < 0.61);
    }
}
