//! `pd+g`: τ = K_p e + K_d ė + Ĝ, proportional-derivative with gravity compensation.
//!
//! Certified on r with β and K2 of the analyst's: K_p e + K_d ė = K_d r + (K_p − βK_d) e.

use crate::certificate::boundary::critical_rate;
use crate::certificate::envelope::Envelope;
use crate::certificate::on_r::{inertial_nm, p_of};
use crate::certificate::reach::{Reach, Row};
use crate::certificate::requirement::{Certification, Requirement};
use crate::certificate::search::{Candidate, Rules, Task, round_down};
use crate::certificate::start::StartError;
use crate::certificate::{Certificate, Gains, OnR};
use crate::chain::{Matrix, Vector};

use super::ctc::axes;
use super::{ControlLaw, Gain, Law, LawInput};

pub(super) struct PdG;

impl ControlLaw for PdG {
    const NAME: &'static str = "pd+g";
    const GAINS: [Gain; 2] = [Gain::KP, Gain::KD];
    const RULES: Rules = Rules { certify, axes, grid };

    fn torque<const N: usize>(law: &Law<N>, input: &LawInput<N>) -> Vector<N> {
        input.e() * law.k_p + input.e_dot() * law.k_d + law.model.gravity(&input.q)
    }

    fn at_rest<const N: usize>(law: &Law<N>, _mass: &Matrix<N>, weight: &Matrix<N>) -> (Matrix<N>, Matrix<N>) {
        let unit = Matrix::<N>::identity();
        (unit * -law.k_p + weight, unit * -law.k_d)
    }

    fn fed_forward<const N: usize>(law: &Law<N>, x: &LawInput<N>) -> Vector<N> {
        law.model.gravity(&x.q)
    }

    fn torque_bound<const N: usize>(law: &Law<N>, _certificate: &Certificate, reach: &Reach<N>, i: usize) -> f64 {
        let weight = Row::of(&law.model, i).weight;
        law.k_d * reach.r[i] + (law.k_p - reach.beta * law.k_d).abs() * reach.e + weight
    }

    fn gains_for_rate(rate: f64, lambda_lo: f64, gains: &Gains) -> Option<Gains> {
        let k_d = lambda_lo * rate;
        Some(Gains { k_p: gains.beta * k_d, k_d, ..*gains })
    }
}

/// With the analyst's β and K2: those given, or the best of a fixed grid.
///
/// Best is the smallest limsup |e| of what is certified; when nothing is, the point that leaves most of K_d after κ.
/// For each β the best K2 is known: ε/α is smallest at half of what κ leaves of K_d, or where α stops growing with K2.
fn certify(env: &Envelope, gains: &Gains, start: Option<&StartError>) -> Certification {
    const BETAS: u32 = 97;
    let at = |beta: f64| {
        let mut of = with_beta(env, &Gains { beta, k2: 0.0, ..*gains });
        let left = if of.p > 0.0 { gains.k_d - of.kappa } else { f64::NEG_INFINITY };
        of.k2 = gains.analyst_k2.unwrap_or((left / 2.0).min(env.lambda_hi() * of.e_rate() / of.p));
        let found = certified(env, gains, start, of);
        let merit = if found.certificate.certified { -found.certificate.ultimate_e } else { f64::NEG_INFINITY };
        (merit, left, found)
    };
    let on_grid = |step: u32| libm::exp2(f64::from(step) * 10.0 / f64::from(BETAS - 1) - 5.0);
    let mut best = at(gains.analyst_beta.unwrap_or(on_grid(0)));
    if gains.analyst_beta.is_none() {
        for other in (1..BETAS).map(|step| at(on_grid(step))) {
            if (other.0, other.1) > (best.0, best.1) {
                best = other;
            }
        }
    }
    best.2
}

/// The constants for a β.
fn with_beta(env: &Envelope, gains: &Gains) -> OnR {
    let p = p_of(env, gains.beta) + gains.k_p - gains.beta * gains.k_d;
    let required = (1.0 + env.mu) * inertial_nm(env) + env.mu * env.b_hat + env.disturbance_nm;
    OnR { k_t: gains.k_d, ..OnR::new(env, gains, p, required) }
}

/// What κ and K2 leave of K_d works against C1.
fn certified(env: &Envelope, gains: &Gains, start: Option<&StartError>, mut of: OnR) -> Certification {
    let against_c1 = gains.k_d - of.kappa - of.k2;
    of.k3 = if of.c1 > 0.0 { against_c1 / (of.c1 * of.c1) } else { 0.0 };
    let certificate = of.certificate(env, gains, against_c1, of.k_t / env.lambda_lo());
    Certification::of(certificate, gains, start, &[gains.k_p, gains.k_d, gains.level, of.beta], |demands| {
        demands.c1(&of);
        let enough = against_c1 > 0.0 || (of.c1 <= 0.0 && against_c1 >= 0.0);
        demands.error_weight(&of)
            && demands.that(enough, Requirement::GainAgainstC1, against_c1, 0.0)
            && demands.gain(&of)
    })
}

/// Shares of the K_d that \[11] allows, and K_p in its proportion.
fn grid(task: &Task<'_>) -> Vec<Candidate> {
    let most = task.room * critical_rate(task.period_s, task.delay_s) * task.envelope.lambda_lo();
    let c1 = task.c1(task.candidate(task.envelope, task.gains).certificate.c1_required());
    let mut found = Vec::new();
    for (stiff, ratio) in (0..8).flat_map(|stiff| (0..14).map(move |ratio| (stiff, ratio))) {
        let k_d = round_down(most * libm::exp2(-0.5 * f64::from(stiff)));
        let k_p = round_down(k_d * libm::exp2(0.5 * f64::from(ratio) - 2.5));
        found.extend(task.settled(|level| Some(Gains { k_p, k_d, level, c1, ..task.gains })));
    }
    found
}
