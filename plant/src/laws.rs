//! What the plant knows of the controllers' laws: enough to evaluate V, for the swap gate, the certified bound on V after a
//! swap, and the time for which a torque may be held.

use loopbound_model::certificate::Certificate;
use loopbound_model::chain::Chain;
use loopbound_model::claim::Claim;
use loopbound_model::integrator::PlantState;
use loopbound_model::law::{LawInput, LawKind};
use loopbound_model::trajectory::SetpointValue;
use loopbound_scenario::system;
use loopbound_scenario::{Scenario, ScenarioError};
use loopbound_shared::clock::seconds;
use loopbound_shared::event::{Phase, Role};
use loopbound_shared::sample::{Announce, RECEIPTS_MAX, TickRecord, to_vector};

use crate::authority::CertifiedLevels;

/// V is compared with this much room: the error of the integration of V̇ is far below it.
const TOLERANCE: f64 = 1e-6;

/// Certificates of all laws in this scenario, and which controller claims which.
pub(crate) struct Laws<const N: usize> {
    true_chain: Chain<N>,
    certificates: [Certificate; LawKind::ALL.len()],
    /// The scenario's laws, in the same order.
    laws: [Claim; LawKind::ALL.len()],
    claims: [Option<(u32, usize)>; RECEIPTS_MAX],
}

impl<const N: usize> Laws<N> {
    pub(crate) fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let mut certificates = [system::certificate_of::<N>(scenario, LawKind::Robust)?; LawKind::ALL.len()];
        for (place, law) in certificates.iter_mut().zip(LawKind::ALL) {
            *place = system::certificate_of::<N>(scenario, law)?;
        }
        let laws = system::laws::<N>(scenario)?;
        Ok(Self { true_chain: scenario.build_truth()?.chain, certificates, laws, claims: [None; RECEIPTS_MAX] })
    }

    /// A controller claims a law; the certificate is that of the scenario's law, so one with other gains has none here. When all
    /// places are taken, one whose controller is no member any more is given away.
    pub(crate) fn learn(&mut self, announce: &Announce, is_member: impl Fn(u32) -> bool) {
        if announce.role != Role::Controller.code() || announce.phase != Phase::Ready.code() {
            return;
        }
        let claim = announce.claim();
        let law = claim.and_then(|claim| self.laws.iter().position(|law| claim.is_same_law(law)));
        let id = announce.id;
        self.forget(id);
        let Some(law) = law else { return };
        let free = self.claims.iter().position(Option::is_none);
        let left = || self.claims.iter().position(|c| c.is_some_and(|(of, _)| !is_member(of)));
        if let Some(place) = free.or_else(left) {
            self.claims[place] = Some((id, law));
        }
    }

    /// Controller `id` is no member any more.
    pub(crate) fn forget(&mut self, id: u32) {
        for claim in self.claims.iter_mut().filter(|c| c.is_some_and(|(of, _)| of == id)) {
            *claim = None;
        }
    }

    fn certificate(&self, id: u32) -> Option<&Certificate> {
        let law = self.claims.iter().flatten().find(|(of, _)| *of == id)?.1;
        Some(&self.certificates[law]).filter(|c| c.is_certified())
    }

    /// The certificate of controller `id` and V of its law at a state; none where nothing is certified.
    pub(crate) fn v_of(
        &self,
        id: u32,
        state: &PlantState<N>,
        setpoint: &SetpointValue<N>,
    ) -> Option<(&Certificate, f64)> {
        let certificate = self.certificate(id)?;
        Some((certificate, certificate.v(&self.true_chain, &system::input(state, setpoint))))
    }

    /// V of `robust` at the start of a record, for the hold limit; none if `robust` is not certified here.
    pub(crate) fn robust_v(&self, record: &TickRecord) -> Option<f64> {
        let certificate = self.certificates.first().filter(|c| c.is_certified())?;
        let input = LawInput {
            q: to_vector(&record.q),
            v: to_vector(&record.v),
            q_d: to_vector(&record.q_d),
            v_d: to_vector(&record.v_d),
            a_d: to_vector(&record.a_d),
        };
        Some(certificate.v(&self.true_chain, &input))
    }

    /// Whether V is within its certified bound at the end of an interval.
    pub(crate) fn bound_holds(certificate: &Certificate, before: f64, after: f64, h_ns: u64) -> bool {
        after <= certificate.promised(before, seconds(h_ns)) + TOLERANCE * (1.0 + before)
    }

    /// This knowledge at one state, as the swap gate asks for it.
    pub(crate) fn at(&self, state: &PlantState<N>, setpoint: &SetpointValue<N>) -> LawsAt<'_, N> {
        LawsAt { laws: self, state: *state, setpoint: *setpoint }
    }
}

/// The laws at one state.
pub(crate) struct LawsAt<'a, const N: usize> {
    laws: &'a Laws<N>,
    state: PlantState<N>,
    setpoint: SetpointValue<N>,
}

impl<const N: usize> CertifiedLevels for LawsAt<'_, N> {
    fn level(&self, id: u32) -> Option<(f64, f64)> {
        self.laws.v_of(id, &self.state, &self.setpoint).map(|(certificate, v)| (v, certificate.level))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_model::chain::Vector;

    /// V and level that the gate finds for a controller with this claim, away from the setpoint.
    fn gate_finds(claim: Claim) -> Option<(f64, f64)> {
        let mut laws = Laws::<3>::new(&Scenario::default()).unwrap();
        let mut announce =
            Announce { role: Role::Controller.code(), phase: Phase::Ready.code(), id: 7, ..Announce::zeroed() };
        announce.set_claim(&claim);
        laws.learn(&announce, |_| true);
        let state = PlantState { q: Vector::zeros(), v: Vector::zeros() };
        let setpoint = SetpointValue { q_d: Vector::repeat(0.1), v_d: Vector::zeros(), a_d: Vector::zeros() };
        laws.at(&state, &setpoint).level(7)
    }

    #[test]
    fn the_gate_takes_the_scenarios_certificate_for_the_scenarios_law_alone() {
        let [robust, robust_ff, ctc, _] = system::laws::<3>(&Scenario::default()).unwrap();
        for law in [robust, robust_ff] {
            let (v, level) = gate_finds(law).expect("it is certified");
            assert!(v > 0.0 && level > 0.0);
            // The same K_t with another beta is another V.
            assert_eq!(gate_finds(Claim { beta: law.beta * 2.0, ..law }), None);
            assert_eq!(gate_finds(Claim { k_t: law.k_t + 1.0, ..law }), None);
            // What the law does not use makes no other law of it.
            assert_eq!(gate_finds(Claim { k_p: 1.0, k_d: 1.0, ..law }), Some((v, level)));
        }
        let found = gate_finds(ctc);
        assert!(found.is_some());
        assert_eq!(gate_finds(Claim { beta: 1.0, k_t: 1.0, ..ctc }), found);
        assert_eq!(gate_finds(Claim { k_d: 9.0, ..ctc }), None);
    }
}
