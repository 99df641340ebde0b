//! The scenario with every default written out, as it is stored beside a run.

use super::key::Value as _;
use super::{ChainSpec, Scenario};

impl Scenario {
    /// The same scenario with all derived defaults in place.
    ///
    /// Three kinds of key stay absent, since their absence is a statement of its own: gains that the certificate derives
    /// (`c1`, `k_t`, `analyst_beta`), the window of a fault, and the choice between `law`, `exe` and `to`.
    #[must_use]
    pub fn resolved(&self) -> Self {
        let mut full = self.clone();
        full.resolve(self);
        full
    }

    /// The plant's chain as its keys have it, before `plant.mass_error`.
    pub(crate) fn plant_without_error(&self) -> ChainSpec {
        let mut nominal = self.clone();
        nominal.plant.mass_error = None;
        nominal.plant_chain()
    }
}
