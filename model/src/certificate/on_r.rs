//! The proof in r, as far as the laws share it: \[4] to \[9].
//!
//! With V = ½ rᵀMr + ½ p|e|² \[4]; on {V ≤ c}, with ē = sqrt(2c/p), w = v_∞ + β ē and x = v_∞ + v_2 + β ē,
//!
//! ```text
//! V̇ ≤ −K2 |r|² − ½ β p |e|² + ε,   ε = C1² / (4 K3 C1²) = 1/(4 K3)                      [8], (18)
//! V(t) ≤ V(0) e^{−αt} + (ε/α)(1 − e^{−αt}),   α = min(2 K2/λ̄, β)
//! ```
//!
//! once C1 covers the terms without state \[6] and K_t = K2 + κ + K3 C1² the rest \[7]. It holds when
//! c ≥ max(V(0), ε/α); κ depends on c, so c is fixed first.

use super::envelope::Envelope;
use super::{Certificate, Form, Gains, OnR};

/// |M q̈_d + C(q, q̇_d) q̇_d| of the nominal chain at most, N·m.
pub(crate) fn inertial_nm(env: &Envelope) -> f64 {
    env.lambda_hat_hi * env.a_2 + env.c_hat * env.v_inf * env.v_2
}

/// All terms without state, N·m: what C1 must cover when nothing of them is fed forward. \[6]
pub(crate) fn all_terms_nm(env: &Envelope) -> f64 {
    (1.0 + env.mu) * inertial_nm(env) + (1.0 + env.mu) * env.b_hat + env.disturbance_nm
}

/// p = β² m̄, with which the cross term is smallest when the law knows nothing of the model.
pub(crate) fn p_of(env: &Envelope, beta: f64) -> f64 {
    beta * beta * env.m_bar()
}

impl OnR {
    /// The constants of a law that knows nothing of the inertia; K_t is not yet shared out.
    pub(crate) fn new(env: &Envelope, gains: &Gains, p: f64, c1_required: f64) -> Self {
        let beta = gains.beta;
        let e_bar = if p > 0.0 { (2.0 * gains.level / p).sqrt() } else { f64::INFINITY };
        let x = env.v_inf + env.v_2 + beta * e_bar;
        let (lo, hi) = (beta * beta * env.lambda_lo(), beta * beta * env.lambda_hi());
        let mut on_r = Self {
            beta,
            p,
            k2: gains.k2,
            k3: gains.k3,
            c1: gains.c1.unwrap_or(c1_required),
            c1_required,
            delta: 0.0,
            kappa: 0.0,
            k_t: 0.0,
            w: env.v_inf + beta * e_bar,
            x,
            e_bar,
            // A held torque knows nothing of the model: it leaves all of Ψ, whatever the law was.
            c1_held: all_terms_nm(env),
            delta_held: (p - lo).abs().max((p - hi).abs()) + env.c_bar() * beta * x,
        };
        let delta = beta * beta * (env.lambda_hi() - env.lambda_lo()) / 2.0 + env.c_bar() * beta * x;
        on_r.pay_for(delta, beta * env.lambda_hi() + env.c_bar() * on_r.w);
        on_r
    }

    /// κ pays for what grows with |r|² (`of_r`, N·m·s), and for δ |e||r|. \[7]
    pub(crate) fn pay_for(&mut self, delta: f64, of_r: f64) {
        self.delta = delta;
        self.kappa = of_r + delta * delta / (2.0 * self.beta * self.p);
    }

    /// K_t from its shares, or K2 from a K_t that is given; the share K3 C1² that works against C1, N·m·s.
    pub(crate) fn share_out(&mut self, gains: &Gains) -> f64 {
        let against_c1 = gains.k3 * self.c1 * self.c1;
        match gains.k_t {
            Some(k_t) => {
                self.k_t = k_t;
                self.k2 = k_t - self.kappa - against_c1;
            }
            None => self.k_t = gains.k2 + self.kappa + against_c1,
        }
        against_c1
    }

    /// ε, α and the radii \[8], \[9], (20) from K2, p, δ and the share of the gain that works against C1.
    pub(crate) fn certificate(self, env: &Envelope, gains: &Gains, against_c1: f64, fast_rate: f64) -> Certificate {
        // Without terms to pay for (an exact feed-forward) there is no ε, whatever the gain.
        let epsilon = if self.c1 > 0.0 { self.c1 * self.c1 / (4.0 * against_c1) } else { 0.0 };
        let (s_rate, e_rate) = (self.k2, self.e_rate());
        let alpha = (2.0 * s_rate / env.lambda_hi()).min(2.0 * e_rate / self.p);
        Certificate {
            envelope: *env,
            certified: false,
            level: gains.level,
            v_start: 0.0,
            s_rate,
            e_rate,
            epsilon,
            alpha,
            w_norm: (epsilon / s_rate.min(e_rate)).sqrt(),
            ultimate_e: (2.0 * epsilon / (alpha * self.p)).sqrt(),
            ultimate_s: (2.0 * epsilon / (alpha * env.lambda_lo())).sqrt(),
            fast_rate: Some(fast_rate).filter(|rate| *rate > 0.0 && rate.is_finite()),
            form: Form::OnR(self),
        }
    }

    /// Coefficient of |e|² in the certified rate of V.
    pub(crate) fn e_rate(&self) -> f64 {
        // The half of β p |e|² that pays for the cross term stays with e where there is none: (18) for one known link.
        let kept = if self.delta > 0.0 { 0.5 } else { 1.0 };
        kept * self.beta * self.p
    }
}
