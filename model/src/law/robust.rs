//! `robust`: τ = K_t r, the paper's law, free of a model.

use crate::certificate::envelope::Envelope;
use crate::certificate::on_r::{all_terms_nm, p_of};
use crate::certificate::reach::Reach;
use crate::certificate::requirement::Certification;
use crate::certificate::sampling::ProvenAge;
use crate::certificate::search::{Quantity, Rules, on_r};
use crate::certificate::start::StartError;
use crate::certificate::{Certificate, Gains, OnR};
use crate::chain::{Matrix, Vector};

use super::{ControlLaw, Gain, Law, LawInput};

pub(super) struct Robust;

impl ControlLaw for Robust {
    const NAME: &'static str = "robust";
    const GAINS: [Gain; 2] = [Gain::Beta, Gain::KTotal];
    // With the default gains it covers disturbances up to 10.8 N·m.
    const C1_NM: Option<f64> = Some(40.0);
    const RULES: Rules = Rules { certify, axes, grid: |task| on_r(task, &[], |_| 0.0) };

    fn torque<const N: usize>(law: &Law<N>, input: &LawInput<N>) -> Vector<N> {
        input.r(law.beta) * law.k_t
    }

    fn at_rest<const N: usize>(law: &Law<N>, _mass: &Matrix<N>, _weight: &Matrix<N>) -> (Matrix<N>, Matrix<N>) {
        let unit = Matrix::<N>::identity();
        (unit * (-law.k_t * law.beta), unit * -law.k_t)
    }

    fn torque_bound<const N: usize>(law: &Law<N>, _certificate: &Certificate, reach: &Reach<N>, i: usize) -> f64 {
        law.k_t * reach.r[i]
    }

    /// The largest age T for which 𝒱 = V + γ∫(σ−t+T)|ṙ|²dσ is proven to fall at the rate α with K_t as it is; none when not
    /// even T = 0 is certified.
    ///
    /// With r̄ = sqrt(2c/λ̲), f_e = β²λ̄ + c̄βx, f_r = βλ̄ + c̄(2w + r̄),
    ///
    /// ```text
    /// K_f = √3 T K_t (K_t + f_r)/(λ̲ sqrt(1−ξ)),  ξ = 3(T K_t/λ̲)² + αT < 1,  γ = λ̲ K_t/(2√3 (K_t+f_r) sqrt(1−ξ))   [12]
    /// ε = C1²/(4(K_t − κ − K2 − K_f)) + 3γT(C1 + f_e ē)²/λ̲²,   c ≥ max(V(0), ε/α)
    /// ```
    fn proven_age(cert: &Certificate) -> Option<ProvenAge> {
        let of = cert.on_r().filter(|_| cert.is_certified())?;
        let mut best = with_age(cert, of, 0.0)?;
        // ξ < 1 alone bounds the age by λ̲/(√3 K_t).
        let mut fails = cert.envelope.lambda_lo() / of.k_t;
        for _ in 0..60 {
            let middle = 0.5 * (best.age_s + fails);
            match with_age(cert, of, middle) {
                Some(found) => best = found,
                None => fails = middle,
            }
        }
        Some(best)
    }

    fn gains_for_rate(rate: f64, lambda_lo: f64, gains: &Gains) -> Option<Gains> {
        Some(Gains { k_t: Some(lambda_lo * rate), ..*gains })
    }
}

fn certify(env: &Envelope, gains: &Gains, start: Option<&StartError>) -> Certification {
    let mut of = OnR::new(env, gains, p_of(env, gains.beta), all_terms_nm(env));
    // The certificate covers a torque without a model: holding one needs no more.
    of.c1_held = of.c1;
    let against_c1 = of.share_out(gains);
    let certificate = of.certificate(env, gains, against_c1, of.k_t / env.lambda_lo());
    Certification::of(certificate, gains, start, &positive(gains), |demands| {
        demands.c1(&of);
        demands.error_weight(&of) && demands.gain(&of)
    })
}

/// The numbers without which a law with K_t makes no sense.
pub(super) fn positive(gains: &Gains) -> [f64; 4] {
    [gains.beta, gains.k3, gains.level, gains.k_t.unwrap_or(gains.k2)]
}

/// What remedies may change of a law with K_t.
pub(super) fn axes(gains: &Gains) -> &'static [Quantity] {
    use Quantity::{C1, Disturbance, K3, KTotal, Level, Mismatch};
    const AXES: [Quantity; 6] = [KTotal, Level, K3, C1, Mismatch, Disturbance];
    if gains.k_t.is_some() { &AXES } else { &AXES[1..] }
}

fn with_age(cert: &Certificate, of: &OnR, age_s: f64) -> Option<ProvenAge> {
    let OnR { beta, k_t, .. } = *of;
    let (alpha, c_bar) = (cert.alpha, cert.envelope.c_bar());
    let (lambda_lo, lambda_hi) = (cert.envelope.lambda_lo(), cert.envelope.lambda_hi());
    let r_bar = (2.0 * cert.level / lambda_lo).sqrt();
    let f_e = beta * beta * lambda_hi + c_bar * beta * of.x;
    let f_r = beta * lambda_hi + c_bar * (2.0 * of.w + r_bar);
    let turn = age_s * k_t / lambda_lo;
    let root = (1.0 - (3.0 * turn * turn + alpha * age_s)).sqrt();
    let gain_share = 3.0f64.sqrt() * age_s * k_t * (k_t + f_r) / (lambda_lo * root);
    let gamma = lambda_lo * k_t / (2.0 * 3.0f64.sqrt() * (k_t + f_r) * root);
    let left = k_t - of.kappa - of.k2 - gain_share;
    let push = (of.c1 + f_e * of.e_bar) / lambda_lo;
    let epsilon = of.c1 * of.c1 / (4.0 * left) + 3.0 * gamma * age_s * push * push;
    // ξ ≥ 1 has made the root not a number, which fails here too.
    let proven = root > 0.0 && left > 0.0 && epsilon <= alpha * cert.level && cert.v_start <= cert.level;
    proven.then_some(ProvenAge { age_s, gain_share, epsilon })
}
