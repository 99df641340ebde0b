//! `ctc`: τ = M̂ (q̈_d + K_d ė + K_p e) + Ĉ q̇ + Ĝ, computed torque.
//!
//! Certified on y = (√K_p e, ė) with V = ½ yᵀ([[1+2ζ², ζ],[ζ, 1]] ⊗ 1) y.

use crate::certificate::envelope::Envelope;
use crate::certificate::reach::{Reach, Row};
use crate::certificate::requirement::{Certification, Requirement};
use crate::certificate::search::{Candidate, Quantity, Rules, Task, round_down};
use crate::certificate::start::StartError;
use crate::certificate::units::Units;
use crate::certificate::{Certificate, Form, Gains, OnY};
use crate::chain::{Matrix, Vector};

use super::{ControlLaw, Gain, Law, LawInput};

pub(super) struct Ctc;

impl ControlLaw for Ctc {
    const NAME: &'static str = "ctc";
    const GAINS: [Gain; 2] = [Gain::KP, Gain::KD];
    const UNITS: Units = Units::ON_Y;
    const RULES: Rules = Rules { certify, axes, grid };

    fn torque<const N: usize>(law: &Law<N>, input: &LawInput<N>) -> Vector<N> {
        let acceleration = input.a_d + input.e_dot() * law.k_d + input.e() * law.k_p;
        law.model.torque_for(&input.q, &input.v, &input.v, &acceleration)
    }

    fn at_rest<const N: usize>(law: &Law<N>, mass: &Matrix<N>, weight: &Matrix<N>) -> (Matrix<N>, Matrix<N>) {
        (mass * -law.k_p + weight, mass * -law.k_d)
    }

    fn torque_bound<const N: usize>(law: &Law<N>, certificate: &Certificate, reach: &Reach<N>, i: usize) -> f64 {
        let (row, env) = (Row::of(&law.model, i), &certificate.envelope);
        let asked = env.a_2 + law.k_d * reach.e_dot + law.k_p * reach.e;
        let speed = env.v_2 + reach.e_dot;
        row.inertia * asked + row.turning * speed * speed + row.weight
    }
}

fn certify(env: &Envelope, gains: &Gains, start: Option<&StartError>) -> Certification {
    let (k_p, k_d) = (gains.k_p, gains.k_d);
    let zeta = k_d / (2.0 * k_p.sqrt());
    let sigma = (1.0 + zeta * zeta).sqrt();
    // The eigenvalues of the matrix of V.
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
    let certificate = Certificate {
        envelope: *env,
        certified: false,
        level: gains.level,
        v_start: 0.0,
        s_rate: kept,
        e_rate: kept * k_p,
        epsilon,
        alpha,
        w_norm: (epsilon / (kept * k_p.min(1.0))).sqrt(),
        ultimate_e: (2.0 * epsilon / (alpha * nu_lo * k_p)).sqrt(),
        ultimate_s: (2.0 * epsilon / (alpha * nu_lo)).sqrt(),
        fast_rate: None,
        form: Form::OnY(OnY { k_p, k_d, k, eta0, eta1 }),
    };
    Certification::of(certificate, gains, start, &[k_p, k_d, gains.level], |demands| {
        demands.that(k > 0.0, Requirement::ComputedTorqueMargin, k, 0.0)
    })
}

/// What remedies may change of a law with K_p and K_d.
pub(super) fn axes(_gains: &Gains) -> &'static [Quantity] {
    &[Quantity::Level, Quantity::KD, Quantity::KP, Quantity::Mismatch, Quantity::Disturbance]
}

/// K_p and the damping, with the gains as they are among them.
fn grid(task: &Task<'_>) -> Vec<Candidate> {
    let grid = (0..29).flat_map(|step| {
        let k_p = round_down(libm::exp2(f64::from(step) * 0.5));
        [0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0].map(|damping| (k_p, round_down(2.0 * damping * k_p.sqrt())))
    });
    let all = [(task.gains.k_p, task.gains.k_d)].into_iter().chain(grid);
    all.filter_map(|(k_p, k_d)| task.settled(|level| Some(Gains { k_p, k_d, level, ..task.gains }))).collect()
}
