//! The laws of `shared` as controllers.

use loopbound_model::chain::Vector;
use loopbound_model::law::{Law, LawInput, LawKind};
use loopbound_scenario::system;
use loopbound_scenario::{Scenario, ScenarioError};

use crate::{Claim, Controller, Input};

/// One of the built-in laws.
pub struct Builtin<const N: usize> {
    law: Law<N>,
}

impl<const N: usize> Builtin<N> {
    /// The law `kind` with the gains of the scenario.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn new(scenario: &Scenario, kind: LawKind) -> Result<Self, ScenarioError> {
        Ok(Self { law: system::law(scenario, kind)? })
    }
}

impl<const N: usize> Controller for Builtin<N> {
    fn name(&self) -> &str {
        self.law.kind.name()
    }

    fn claim(&self) -> Option<Claim> {
        Some(Claim::of_law(&self.law))
    }

    fn torque(&mut self, input: &Input<'_>, tau: &mut [f64]) {
        let vector = |values: &[f64]| Vector::<N>::from_column_slice(values);
        let answer = self.law.torque(&LawInput {
            q: vector(input.q),
            v: vector(input.v),
            q_d: vector(input.q_d),
            v_d: vector(input.v_d),
            a_d: vector(input.a_d),
        });
        tau.copy_from_slice(answer.as_slice());
    }
}
