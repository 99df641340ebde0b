//! V and its certified bound at one state: the rate \[8], the step promise (a), and the observed Ψ against C1.

use crate::chain::{Chain, Vector};
use crate::input::LawInput;

use super::{Certificate, Form, OnY};

impl Certificate {
    /// V of a state, with the true chain. \[4], or the V of `ctc`.
    ///
    /// `true_chain` is the plant's: the M of V is the true one.
    #[must_use]
    pub fn v<const N: usize>(&self, true_chain: &Chain<N>, x: &LawInput<N>) -> f64 {
        let e = x.e();
        match &self.form {
            // The kinetic energy of a chain that moves with r is ½ rᵀMr.
            Form::OnR(of) => true_chain.kinetic_energy(&x.q, &x.r(of.beta)) + 0.5 * of.p * e.dot(&e),
            Form::OnY(of) => {
                let v = x.e_dot();
                0.5 * ((of.k_p + of.k_d * of.k_d / 2.0) * e.dot(&e) + of.k_d * e.dot(&v) + v.dot(&v))
            }
        }
    }

    /// The certified rate of V: V̇ ≤ this. \[8], or that of `ctc`.
    #[must_use]
    pub fn rate<const N: usize>(&self, x: &LawInput<N>) -> f64 {
        let e = x.e();
        let s = self.filtered(x);
        self.epsilon - self.s_rate * s.dot(&s) - self.e_rate * e.dot(&e)
    }

    /// s: r of the certificate's β, or ė in a certificate on y.
    fn filtered<const N: usize>(&self, x: &LawInput<N>) -> Vector<N> {
        match &self.form {
            Form::OnR(of) => x.r(of.beta),
            Form::OnY(_) => x.e_dot(),
        }
    }

    /// −∂V̇/∂τ: what a missing torque does to V̇.
    pub(crate) fn lever<const N: usize>(&self, true_chain: &Chain<N>, x: &LawInput<N>) -> Vector<N> {
        match &self.form {
            Form::OnR(of) => x.r(of.beta),
            Form::OnY(of) => acceleration_change(true_chain, &x.q, &(x.e() * (of.k_d / 2.0) + x.e_dot())),
        }
    }

    /// |W| with W = (e, r), to be held against `w_norm`. (20)
    #[must_use]
    pub fn w_of<const N: usize>(&self, x: &LawInput<N>) -> f64 {
        let (e, s) = (x.e(), self.filtered(x));
        (e.dot(&e) + s.dot(&s)).sqrt()
    }

    /// Promise (a): the largest V that may be found `h_s` seconds after V was `v`.
    #[must_use]
    pub fn promised(&self, v: f64, h_s: f64) -> f64 {
        // expm1 keeps the small difference 1 − e^{−αh} exact at kHz rates.
        let fade = -libm::expm1(-self.alpha * h_s);
        if self.alpha > 0.0 { v + (self.v_ultimate() - v) * fade } else { v }
    }

    /// Ψ less the terms that κ pays for, as it was observed: the part that C1 must cover, N·m. \[5], \[6]
    ///
    /// Observed means from the acceleration q̈ that the plant really had under the torque τ, so disturbances, friction
    /// and wrong parameters are all in it; the true chain gives M and C. From M(q̈_d − q̈) + τ − C q̇ = M q̈_d + G − d,
    ///
    /// ```text
    /// robust      M q̈_d + C(q,q̇_d) q̇_d + G − d
    /// robust-ff   the same, less M̂ q̈_d + Ĉ(q,q̇_d) q̇_d + Ĝ
    /// pd+g        the same, less Ĝ
    /// ctc         M times the part of η without |y|: M(q̈ of the law − q̈), reduced by λ̲ η1 |y|
    /// ```
    ///
    /// Compare the norm of the result with [`Certificate::psi_allowed`].
    #[must_use]
    pub fn psi_observed<const N: usize>(&self, facts: &Observed<'_, N>) -> f64 {
        match &self.form {
            Form::OnR(_) => {
                let Observed { true_chain, x, acceleration, tau, fed_forward, .. } = facts;
                let zero = Vector::<N>::zeros();
                // torque_for contains G, which the difference of the two calls removes again.
                let moved = true_chain.torque_for(&x.q, &x.v_d, &x.v_d, &(x.a_d - *acceleration));
                let centrifugal = true_chain.torque_for(&x.q, &x.v, &x.v, &zero);
                let observed = moved - centrifugal + *tau;
                (observed - *fed_forward).norm()
            }
            Form::OnY(of) => of.eta_observed(facts),
        }
    }

    /// What [`Certificate::psi_observed`] may be: C1 in N·m; η0 in rad/s² for `ctc`.
    #[must_use]
    pub fn psi_allowed(&self) -> f64 {
        match &self.form {
            Form::OnR(of) => of.c1,
            Form::OnY(of) => of.eta0,
        }
    }
}

impl OnY {
    /// |η| as it was observed, less its part in |y|, rad/s².
    fn eta_observed<const N: usize>(&self, facts: &Observed<'_, N>) -> f64 {
        let Observed { true_chain, x, acceleration, tau, law_torque, .. } = facts;
        // With the law's own torque the acceleration would have been q̈ + M⁻¹(τ_law − τ).
        let due = acceleration_change(true_chain, &x.q, &(*law_torque - *tau));
        let eta = -(x.a_d - *acceleration - due + x.e_dot() * self.k_d + x.e() * self.k_p);
        let y = (self.k_p * x.e().norm_squared() + x.e_dot().norm_squared()).sqrt();
        (eta.norm() - self.eta1 * y).max(0.0)
    }
}

/// What [`Certificate::psi_observed`] is computed from.
#[derive(Clone, Copy, Debug)]
pub struct Observed<'a, const N: usize> {
    /// The plant's chain.
    pub true_chain: &'a Chain<N>,
    /// True state and setpoint.
    pub x: &'a LawInput<N>,
    /// q̈ that the plant had, rad/s².
    pub acceleration: &'a Vector<N>,
    /// τ that acted, N·m.
    pub tau: &'a Vector<N>,
    /// The law's answer to `x`, N·m; a certificate on r does not need it.
    pub law_torque: &'a Vector<N>,
    /// What of the terms without state the law feeds forward at `x`, N·m; a certificate on y does not need it.
    pub fed_forward: &'a Vector<N>,
}

/// M⁻¹ τ: the chain's acceleration at rest, less that of its weight.
fn acceleration_change<const N: usize>(chain: &Chain<N>, q: &Vector<N>, tau: &Vector<N>) -> Vector<N> {
    let rest = Vector::<N>::zeros();
    chain.acceleration(q, &rest, &(tau + chain.gravity(q)))
}
