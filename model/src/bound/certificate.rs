//! Certificates: the differential inequality V̇ ≤ −… + ε that a law with given gains is proven to keep.
//!
//! All laws but `ctc` use V = ½ rᵀMr + ½ p|e|² \[4]; on {V ≤ c}, with ē = sqrt(2c/p), w = v_∞ + β ē and
//! x = v_∞ + v_2 + β ē,
//!
//! ```text
//! V̇ ≤ −K2 |r|² − ½ β p |e|² + ε,   ε = C1² / (4 K3 C1²) = 1/(4 K3)                      [8], (18)
//! V(t) ≤ V(0) e^{−αt} + (ε/α)(1 − e^{−αt}),   α = min(2 K2/λ̄, β)
//! ```
//!
//! once C1 covers the terms without state \[6] and K_t = K2 + κ + K3 C1² the rest \[7]. It holds when
//! c ≥ max(V(0), ε/α); κ depends on c, so c is fixed first. The certificate travels in shared memory, hence its layout.

use crate::chain::Chain;
use crate::law::{LawInput, LawKind};

use super::envelope::{Assumptions, Envelope};
use super::remedy::{Shortfall, shortfalls};

/// Gains of a law, and how its certificate is to account for them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// β of r = ė + β e, 1/s. Not used by `ctc`; in `pd+g` see `analyst_beta`.
    pub beta: f64,
    /// K2, N·m·s: the share of the gain that makes V fall. In `pd+g` see `analyst_k2`.
    pub k2: f64,
    /// K3, 1/(N·m·rad/s): ε = 1/(4 K3).
    pub k3: f64,
    /// C1, N·m; absent: as much as \[6] requires.
    pub c1: Option<f64>,
    /// c, the certified level of V.
    pub level: f64,
    /// K_p: 1/s² in `ctc`, N·m in `pd+g`.
    pub k_p: f64,
    /// K_d: 1/s in `ctc`, N·m·s in `pd+g`.
    pub k_d: f64,
    /// K_t given directly; what remains of it after κ and K3 C1² is then K2, which may be smaller or larger than `k2`.
    pub k_t: Option<f64>,
    /// β of the certificate of `pd+g`: it is the analyst's, not the law's; absent: searched for.
    pub analyst_beta: Option<f64>,
    /// K2 of the certificate of `pd+g`; absent: searched for.
    pub analyst_k2: Option<f64>,
    /// Give `robust-ff` p = β² m̄, the V of `robust`, so that blends of the two are covered; otherwise p = β K2.
    pub shared_v: bool,
}

impl Gains {
    /// The gains that a law has when nothing is said; those of `robust` are the documentation's example.
    #[must_use]
    pub fn of(law: LawKind) -> Self {
        Self {
            beta: 5.0,
            k2: 10.0,
            k3: 0.04,
            c1: (law == LawKind::Robust).then_some(40.0),
            level: 6.0,
            k_p: 25.0,
            k_d: 10.0,
            k_t: None,
            analyst_beta: None,
            analyst_k2: None,
            shared_v: false,
        }
    }
}

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
        if certificate.law() == Some(LawKind::Ctc) {
            let (k_p, k_d) = (certificate.k_p, certificate.k_d);
            return 0.5 * ((k_p + k_d * k_d / 2.0) * self.e_e + k_d * self.e_v + self.v_v);
        }
        let beta = certificate.beta;
        let r_m_r = self.v_m_v + 2.0 * beta * self.e_m_v + beta * beta * self.e_m_e;
        0.5 * ((1.0 + certificate.mu) * r_m_r + certificate.p * self.e_e)
    }
}

/// Everything that a certificate says, in numbers; all zero: nothing is certified.
///
/// A field that does not belong to the law is 0. In `ctc` the part of r is played by ė.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct Certificate {
    /// Which law: 0 none, else 1 + its place in `LawKind::ALL`.
    pub law_code: u32,
    /// 1 when every requirement is met, else 0.
    pub certified: u32,
    /// β, 1/s.
    pub beta: f64,
    /// p of V, N·m/rad.
    pub p: f64,
    /// K2, N·m·s.
    pub k2: f64,
    /// K3, 1/(N·m·rad/s).
    pub k3: f64,
    /// C1, N·m.
    pub c1: f64,
    /// What C1 must cover at least, N·m. \[6]
    pub c1_required: f64,
    /// δ of the cross term |e||r|. \[7]
    pub delta: f64,
    /// κ, N·m·s. \[7]
    pub kappa: f64,
    /// K_t = K2 + κ + K3 C1², N·m·s; K_d in `pd+g`.
    pub k_t: f64,
    /// K_p of the law.
    pub k_p: f64,
    /// K_d of the law.
    pub k_d: f64,
    /// c, the certified level of V.
    pub level: f64,
    /// Upper bound of V(0); 0 when no start was given.
    pub v_start: f64,
    /// Coefficient of |r|² in the promised rate of V.
    pub r_rate: f64,
    /// Coefficient of |e|² in the promised rate of V.
    pub e_rate: f64,
    /// ε, in units of V a second. \[8]
    pub epsilon: f64,
    /// α, 1/s.
    pub alpha: f64,
    /// ‖W‖ with W = (e, r): outside of this radius V falls. (20)
    pub w_norm: f64,
    /// limsup ‖e‖ over all links, rad. \[9]
    pub ultimate_e: f64,
    /// limsup ‖r‖ over all links, rad/s. \[9]
    pub ultimate_r: f64,
    /// λ̲, kg·m².
    pub lambda_lo: f64,
    /// λ̄, kg·m².
    pub lambda_hi: f64,
    /// c̄, kg·m².
    pub c_bar: f64,
    /// w = v_∞ + β ē, rad/s.
    pub w: f64,
    /// x = v_∞ + v_2 + β ē, rad/s.
    pub x: f64,
    /// ē, the largest |e| on {V ≤ c}, rad.
    pub e_bar: f64,
    /// μ, relative.
    pub mu: f64,
    /// D, N·m.
    pub disturbance_nm: f64,
    /// sup |q̇_d|_∞, rad/s.
    pub v_inf: f64,
    /// sup |q̇_d|, rad/s.
    pub v_2: f64,
    /// sup |q̈_d|, rad/s².
    pub a_2: f64,
    /// What C1 must cover when no law answers and a torque is just held, N·m; 0 in `ctc`. \[13]
    pub c1_held: f64,
    /// δ when a torque is held. \[13]
    pub delta_held: f64,
    /// `ctc`: k = ½K_d − σ η1, 1/s.
    pub k: f64,
    /// `ctc`: ν₋, the smaller eigenvalue of the matrix of V.
    pub nu_lo: f64,
    /// `ctc`: ν₊, the larger one.
    pub nu_hi: f64,
    /// `ctc`: σ = sqrt(1 + ζ²).
    pub sigma: f64,
    /// `ctc`: η0 of |η| ≤ η0 + η1 |y|, rad/s².
    pub eta0: f64,
    /// `ctc`: η1.
    pub eta1: f64,
}

const _: () = assert!(size_of::<Certificate>() == 8 + 39 * 8 && align_of::<Certificate>() == 8, "no padding");

impl Certificate {
    /// Which law the certificate is of; none for an unknown code.
    #[must_use]
    pub fn law(&self) -> Option<LawKind> {
        let place = usize::try_from(self.law_code).ok()?.checked_sub(1)?;
        LawKind::ALL.get(place).copied()
    }

    /// Whether every requirement is met.
    #[must_use]
    pub fn is_certified(&self) -> bool {
        self.certified == 1
    }

    /// ε/α: where V settles at most.
    #[must_use]
    pub fn v_ultimate(&self) -> f64 {
        if self.alpha > 0.0 { self.epsilon / self.alpha } else { f64::INFINITY }
    }

    /// limsup |e_i| of each link, rad. V weighs the links' errors alike, so within {V ≤ v} one link alone may have all of ‖e‖: the
    /// bound of the norm is the bound of each link, and no better one follows from V.
    #[must_use]
    pub fn ultimate_e_link(&self) -> f64 {
        self.ultimate_e
    }

    /// Where every number that comes over the wire must lie.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        [self.p, self.level, self.epsilon, self.alpha, self.r_rate, self.e_rate, self.k_t, self.beta]
            .iter()
            .all(|x| x.is_finite())
    }

    fn blank(law: LawKind, envelope: &Envelope, gains: &Gains) -> Self {
        let place = LawKind::ALL.iter().position(|kind| *kind == law).unwrap_or(0);
        Self {
            law_code: u32::try_from(place + 1).unwrap_or(0),
            level: gains.level,
            lambda_lo: envelope.lambda_lo(),
            lambda_hi: envelope.lambda_hi(),
            c_bar: envelope.c_bar(),
            mu: envelope.mu,
            disturbance_nm: envelope.disturbance_nm,
            v_inf: envelope.v_inf,
            v_2: envelope.v_2,
            a_2: envelope.a_2,
            ..Self::default()
        }
    }
}

/// A certificate, and what is missing when there is none.
#[derive(Clone, Debug, PartialEq)]
pub struct Certification {
    /// The numbers; `certified` is 0 when something is missing.
    pub certificate: Certificate,
    /// Requirements that are not met; empty when certified.
    pub failures: Vec<Shortfall>,
}

/// Certifies a law. V(0) is checked against the level when a start is given.
#[must_use]
pub fn certify<const N: usize>(
    law: LawKind,
    assumptions: &Assumptions<N>,
    gains: &Gains,
    start: Option<&LawInput<N>>,
) -> Certification {
    let start = start.map(|input| StartError::of(&assumptions.nominal, input));
    let envelope = assumptions.envelope();
    let certificate = certificate(law, &envelope, gains, start.as_ref());
    let failures = shortfalls(&certificate, &envelope, gains, start.is_some());
    Certification { certificate, failures }
}

/// The certificate alone, without diagnosis of what is missing.
#[must_use]
pub fn certificate(law: LawKind, envelope: &Envelope, gains: &Gains, start: Option<&StartError>) -> Certificate {
    let mut result = match law {
        LawKind::Robust | LawKind::RobustFf => of_r(law, envelope, gains),
        LawKind::Ctc => of_ctc(envelope, gains),
        LawKind::PdG => of_pd_g(envelope, gains, start),
    };
    result.v_start = start.map_or(0.0, |start| start.v(&result));
    result.certified = u32::from(shortfalls(&result, envelope, gains, start.is_some()).is_empty());
    result
}

/// Constants of the laws that are certified on r: \[4] to \[9].
fn of_r(law: LawKind, env: &Envelope, gains: &Gains) -> Certificate {
    let beta = gains.beta;
    let mut out = Certificate { beta, k2: gains.k2, k3: gains.k3, ..Certificate::blank(law, env, gains) };
    let inertial = env.lambda_hat_hi * env.a_2 + env.c_hat * env.v_inf * env.v_2;
    let true_inertial = (1.0 + env.mu) * inertial;
    let shared = beta * beta * env.m_bar();
    (out.p, out.c1_required) = match law {
        LawKind::RobustFf => {
            let p = if gains.shared_v { shared } else { beta * gains.k2 };
            (p, env.mu * (inertial + env.b_hat) + env.disturbance_nm)
        }
        LawKind::PdG => {
            (out.k_p, out.k_d) = (gains.k_p, gains.k_d);
            let p = shared + gains.k_p - beta * gains.k_d;
            (p, true_inertial + env.mu * env.b_hat + env.disturbance_nm)
        }
        LawKind::Robust | LawKind::Ctc => (shared, true_inertial + (1.0 + env.mu) * env.b_hat + env.disturbance_nm),
    };
    out.c1 = gains.c1.unwrap_or(out.c1_required);
    out.e_bar = if out.p > 0.0 { (2.0 * gains.level / out.p).sqrt() } else { f64::INFINITY };
    out.w = env.v_inf + beta * out.e_bar;
    out.x = env.v_inf + env.v_2 + beta * out.e_bar;
    // [7]: what grows with r or e is paid for by κ.
    let kappa_of_r;
    (out.delta, kappa_of_r) = if law == LawKind::RobustFf {
        let delta = out.p + env.mu * (beta * beta * env.lambda_hat_hi + env.c_hat * beta * out.x);
        (delta, env.mu * (beta * env.lambda_hat_hi + env.c_hat * out.w))
    } else {
        let delta = beta * beta * (env.lambda_hi() - env.lambda_lo()) / 2.0 + env.c_bar() * beta * out.x;
        (delta, beta * env.lambda_hi() + env.c_bar() * out.w)
    };
    // A held torque knows nothing of the model: it leaves all of Ψ, whatever the law was.
    let full = true_inertial + (1.0 + env.mu) * env.b_hat + env.disturbance_nm;
    out.c1_held = if law == LawKind::Robust { out.c1 } else { full };
    let (lo, hi) = (beta * beta * env.lambda_lo(), beta * beta * env.lambda_hi());
    out.delta_held = (out.p - lo).abs().max((out.p - hi).abs()) + env.c_bar() * beta * out.x;
    out.kappa = kappa_of_r + out.delta * out.delta / (2.0 * beta * out.p);
    let against_c1 = match law {
        LawKind::PdG => gains.k_d - out.kappa - gains.k2,
        _ => gains.k3 * out.c1 * out.c1,
    };
    match law {
        LawKind::PdG => {
            out.k_t = gains.k_d;
            out.k3 = if out.c1 > 0.0 { against_c1 / (out.c1 * out.c1) } else { 0.0 };
        }
        _ => match gains.k_t {
            Some(k_t) => (out.k_t, out.k2) = (k_t, k_t - out.kappa - against_c1),
            None => out.k_t = gains.k2 + out.kappa + against_c1,
        },
    }
    finish_r(&mut out, against_c1);
    out
}

/// ε, α and the radii \[8], \[9], (20) from K2, p, δ and the share of the gain that works against C1.
fn finish_r(out: &mut Certificate, against_c1: f64) {
    // Without terms to pay for (an exact feed-forward) there is no ε, whatever the gain.
    out.epsilon = if out.c1 > 0.0 { out.c1 * out.c1 / (4.0 * against_c1) } else { 0.0 };
    // The half of β p |e|² that pays for the cross term stays with e where there is none: (18) for one known link.
    let kept = if out.delta > 0.0 { 0.5 } else { 1.0 };
    out.r_rate = out.k2;
    out.e_rate = kept * out.beta * out.p;
    out.alpha = (2.0 * out.r_rate / out.lambda_hi).min(2.0 * out.e_rate / out.p);
    out.w_norm = (out.epsilon / out.r_rate.min(out.e_rate)).sqrt();
    out.ultimate_e = (2.0 * out.epsilon / (out.alpha * out.p)).sqrt();
    out.ultimate_r = (2.0 * out.epsilon / (out.alpha * out.lambda_lo)).sqrt();
}

/// Computed torque: V = ½ yᵀ([[1+2ζ², ζ],[ζ, 1]] ⊗ 1) y with y = (√K_p e, ė).
fn of_ctc(env: &Envelope, gains: &Gains) -> Certificate {
    let (k_p, k_d) = (gains.k_p, gains.k_d);
    let zeta = k_d / (2.0 * k_p.sqrt());
    let sigma = (1.0 + zeta * zeta).sqrt();
    let (nu_lo, nu_hi) = (sigma * sigma - zeta * sigma, sigma * sigma + zeta * sigma);
    let y_bar = (2.0 * gains.level / nu_lo).sqrt();
    let rho = env.rho();
    let wrong_torque = env.mu * (env.c_hat * env.v_inf * env.v_2 + env.b_hat) + env.disturbance_nm;
    let eta0 = rho * env.a_2 + wrong_torque / env.lambda_lo();
    let eta1 = rho * (k_p * (1.0 + 4.0 * zeta * zeta)).sqrt()
        + env.mu * env.c_hat * (env.v_inf + env.v_2 + y_bar) / env.lambda_lo();
    let k = 0.5 * k_d - sigma * eta1;
    // Half of k pays for η0; with an exact model nothing has to be paid and the whole of it stays.
    let kept = if eta0 > 0.0 { 0.5 * k } else { k };
    let epsilon = if eta0 > 0.0 { sigma * eta0 * sigma * eta0 / (2.0 * k) } else { 0.0 };
    let alpha = 2.0 * kept / nu_hi;
    Certificate {
        k_p,
        k_d,
        k,
        nu_lo,
        nu_hi,
        sigma,
        eta0,
        eta1,
        r_rate: kept,
        e_rate: kept * k_p,
        epsilon,
        alpha,
        e_bar: y_bar / k_p.sqrt(),
        w_norm: (epsilon / (kept * k_p.min(1.0))).sqrt(),
        ultimate_e: (2.0 * epsilon / (alpha * nu_lo * k_p)).sqrt(),
        ultimate_r: (2.0 * epsilon / (alpha * nu_lo)).sqrt(),
        ..Certificate::blank(LawKind::Ctc, env, gains)
    }
}

/// `pd+g`, whose β and K2 are the analyst's: those given, or the best of a fixed grid.
///
/// Best is the smallest limsup |e| of what is certified; when nothing is, the point that leaves most of K_d after κ.
/// For each β the best K2 is known: ε/α is smallest at half of what κ leaves of K_d, or where α stops growing with K2.
fn of_pd_g(env: &Envelope, gains: &Gains, start: Option<&StartError>) -> Certificate {
    const BETAS: u32 = 97;
    let mut best: Option<(f64, f64, Certificate)> = None;
    for step in 0..BETAS {
        let grid = libm::exp2(f64::from(step) * 10.0 / f64::from(BETAS - 1) - 5.0);
        let beta = gains.analyst_beta.unwrap_or(grid);
        let probe = of_r(LawKind::PdG, env, &Gains { beta, k2: 0.0, ..*gains });
        let left = if probe.p > 0.0 { gains.k_d - probe.kappa } else { f64::NEG_INFINITY };
        let k2 = gains.analyst_k2.unwrap_or((left / 2.0).min(env.lambda_hi() * probe.e_rate / probe.p));
        let mut found = of_r(LawKind::PdG, env, &Gains { beta, k2, ..*gains });
        found.v_start = start.map_or(0.0, |start| start.v(&found));
        let met = shortfalls(&found, env, gains, start.is_some()).is_empty();
        let merit = if met { -found.ultimate_e } else { f64::NEG_INFINITY };
        if best.is_none_or(|(m, l, _)| (merit, left) > (m, l)) {
            best = Some((merit, left, found));
        }
        if gains.analyst_beta.is_some() {
            break;
        }
    }
    best.map_or_else(|| Certificate::blank(LawKind::PdG, env, gains), |(_, _, found)| found)
}

#[cfg(test)]
mod tests;
