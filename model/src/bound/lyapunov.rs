//! V and what is promised of it, at one state: the rate \[8], the step promise (a), the observed Ψ against C1, and the
//! statement about blends.

use crate::chain::{Chain, Vector};
use crate::law::{LawInput, LawKind};

use super::certificate::Certificate;

impl Certificate {
    /// V of a state, with the true chain. \[4], or the V of `ctc`.
    ///
    /// `true_chain` is the plant's: the M of V is the true one. Zero for a certificate without a law.
    #[must_use]
    pub fn v<const N: usize>(&self, true_chain: &Chain<N>, x: &LawInput<N>) -> f64 {
        let e = x.e();
        match self.law() {
            None => 0.0,
            Some(LawKind::Ctc) => {
                let v = x.e_dot();
                0.5 * ((self.k_p + self.k_d * self.k_d / 2.0) * e.dot(&e) + self.k_d * e.dot(&v) + v.dot(&v))
            }
            // The kinetic energy of a chain that moves with r is ½ rᵀMr.
            Some(_) => true_chain.kinetic_energy(&x.q, &x.r(self.beta)) + 0.5 * self.p * e.dot(&e),
        }
    }

    /// The promised rate of V: V̇ ≤ this. \[8], or that of `ctc`.
    #[must_use]
    pub fn rate<const N: usize>(&self, x: &LawInput<N>) -> f64 {
        let e = x.e();
        let s = self.filtered(x);
        self.epsilon - self.r_rate * s.dot(&s) - self.e_rate * e.dot(&e)
    }

    /// r of the certificate's β; ė for `ctc`.
    #[must_use]
    pub fn filtered<const N: usize>(&self, x: &LawInput<N>) -> Vector<N> {
        if self.law() == Some(LawKind::Ctc) { x.e_dot() } else { x.r(self.beta) }
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
    /// `law_torque` is what the law would answer to `x` itself; only `ctc` needs it. Compare the norm of the result with
    /// [`Certificate::psi_allowed`].
    #[must_use]
    pub fn psi_observed<const N: usize>(&self, facts: &Observed<'_, N>) -> f64 {
        let Observed { true_chain, nominal, x, acceleration, tau, law_torque } = *facts;
        let zero = Vector::<N>::zeros();
        let Some(law) = self.law() else { return 0.0 };
        if law == LawKind::Ctc {
            // With the law's own torque the acceleration would have been q̈ + M⁻¹(τ_law − τ).
            let due = acceleration_change(true_chain, &x.q, &(law_torque - tau));
            let eta = -(x.a_d - acceleration - due + x.e_dot() * self.k_d + x.e() * self.k_p);
            let y = (self.k_p * x.e().norm_squared() + x.e_dot().norm_squared()).sqrt();
            return (eta.norm() - self.eta1 * y).max(0.0);
        }
        // torque_for contains G, which the difference of the two calls removes again.
        let moved = true_chain.torque_for(&x.q, &x.v_d, &x.v_d, &(x.a_d - acceleration));
        let centrifugal = true_chain.torque_for(&x.q, &x.v, &x.v, &zero);
        let observed = moved - centrifugal + tau;
        let known = match law {
            LawKind::RobustFf => nominal.torque_for(&x.q, &x.v_d, &x.v_d, &x.a_d),
            LawKind::PdG => nominal.gravity(&x.q),
            LawKind::Robust | LawKind::Ctc => zero,
        };
        (observed - known).norm()
    }

    /// What [`Certificate::psi_observed`] may be: C1 in N·m; η0 in rad/s² for `ctc`.
    #[must_use]
    pub fn psi_allowed(&self) -> f64 {
        if self.law() == Some(LawKind::Ctc) { self.eta0 } else { self.c1 }
    }
}

/// What [`Certificate::psi_observed`] is computed from.
#[derive(Clone, Copy, Debug)]
pub struct Observed<'a, const N: usize> {
    /// The plant's chain.
    pub true_chain: &'a Chain<N>,
    /// The controller's chain.
    pub nominal: &'a Chain<N>,
    /// True state and setpoint.
    pub x: &'a LawInput<N>,
    /// q̈ that the plant had, rad/s².
    pub acceleration: &'a Vector<N>,
    /// τ that acted, N·m.
    pub tau: &'a Vector<N>,
    /// The law's answer to `x`, N·m.
    pub law_torque: &'a Vector<N>,
}

/// M⁻¹ τ: the chain's acceleration at rest, less that of its weight.
fn acceleration_change<const N: usize>(chain: &Chain<N>, q: &Vector<N>, tau: &Vector<N>) -> Vector<N> {
    let rest = Vector::<N>::zeros();
    chain.acceleration(q, &rest, &(tau + chain.gravity(q)))
}

/// The certificate of every blend of two laws, torque = w τ_a + (1 − w) τ_b for the same state, w in [0, 1] however
/// it varies with time; none when the two do not share V.
///
/// V̇ is affine in τ, so a blend keeps the weaker of the two promises on the smaller level set: with the smaller
/// rates and the larger ε. Shared means same β, same p, same true plants (μ, D) and reference. `robust` and
/// `robust-ff` share V when the latter is given p = β² m̄; `ctc` has another V, so no blend with it is covered.
#[must_use]
pub fn blend_covered(a: &Certificate, b: &Certificate) -> Option<Certificate> {
    if !(a.is_certified() && b.is_certified()) {
        return None;
    }
    if a.law() == Some(LawKind::Ctc) || b.law() == Some(LawKind::Ctc) {
        return None;
    }
    let key =
        |c: &Certificate| [c.beta, c.p, c.lambda_lo, c.lambda_hi, c.c_bar, c.v_inf, c.v_2, c.a_2].map(f64::to_bits);
    if key(a) != key(b) {
        return None;
    }
    let level = a.level.min(b.level);
    let (r_rate, e_rate) = (a.r_rate.min(b.r_rate), a.e_rate.min(b.e_rate));
    let epsilon = a.epsilon.max(b.epsilon);
    let alpha = (2.0 * r_rate / a.lambda_hi).min(2.0 * e_rate / a.p);
    // The smaller level set may be too small for the larger ε: then the blend may leave it.
    if epsilon > alpha * level {
        return None;
    }
    Some(Certificate {
        level,
        k2: r_rate,
        r_rate,
        e_rate,
        epsilon,
        alpha,
        disturbance_nm: a.disturbance_nm.min(b.disturbance_nm),
        w_norm: (epsilon / r_rate.min(e_rate)).sqrt(),
        ultimate_e: (2.0 * epsilon / (alpha * a.p)).sqrt(),
        ultimate_r: (2.0 * epsilon / (alpha * a.lambda_lo)).sqrt(),
        ..*a
    })
}
