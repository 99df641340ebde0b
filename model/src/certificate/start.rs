//! The start of a run, as a certificate asks for it.

use crate::chain::Chain;
use crate::input::LawInput;

use super::{Certificate, Form};

/// The start error reduced to the numbers of which V(0) is made, whatever β and p turn out to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartError {
    e_e: f64,
    e_v: f64,
    v_v: f64,
    e_m_e: f64,
    e_m_v: f64,
    v_m_v: f64,
}

impl StartError {
    /// Of the true start state and the setpoint at that instant.
    ///
    /// With mismatch the true M is not known, but M ≤ (1+μ) M̂ is, so V(0) becomes an upper bound.
    #[must_use]
    pub fn of<const N: usize>(nominal: &Chain<N>, start: &LawInput<N>) -> Self {
        let (e, v, mass) = (start.e(), start.e_dot(), nominal.mass_matrix(&start.q));
        let weighted = mass * v;
        Self {
            e_e: e.dot(&e),
            e_v: e.dot(&v),
            v_v: v.dot(&v),
            e_m_e: e.dot(&(mass * e)),
            e_m_v: e.dot(&weighted),
            v_m_v: v.dot(&weighted),
        }
    }

    /// Upper bound of V(0) in the V of a certificate.
    #[must_use]
    pub fn v(&self, certificate: &Certificate) -> f64 {
        match &certificate.form {
            Form::OnR(of) => {
                let r_m_r = self.v_m_v + 2.0 * of.beta * self.e_m_v + of.beta * of.beta * self.e_m_e;
                0.5 * ((1.0 + certificate.envelope.mu) * r_m_r + of.p * self.e_e)
            }
            Form::OnY(of) => 0.5 * ((of.k_p + of.k_d * of.k_d / 2.0) * self.e_e + of.k_d * self.e_v + self.v_v),
        }
    }
}
