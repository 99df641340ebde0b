//! `robust-ff`: τ = M̂ a_r + Ĉ v_r + Ĝ + K_t r, the paper's (9) with its robust term.

use crate::certificate::envelope::Envelope;
use crate::certificate::on_r::{inertial_nm, p_of};
use crate::certificate::reach::{Reach, Row};
use crate::certificate::requirement::Certification;
use crate::certificate::search::{Candidate, Rules, Task, on_r};
use crate::certificate::start::StartError;
use crate::certificate::{Certificate, Gains, OnR};
use crate::chain::{Matrix, Vector};

use super::robust::{axes, positive};
use super::{ControlLaw, Gain, Law, LawInput};

pub(super) struct RobustFf;

impl ControlLaw for RobustFf {
    const NAME: &'static str = "robust-ff";
    const GAINS: [Gain; 2] = [Gain::Beta, Gain::KTotal];
    const RULES: Rules = Rules { certify, axes, grid };

    fn torque<const N: usize>(law: &Law<N>, input: &LawInput<N>) -> Vector<N> {
        let (v_r, a_r) = (input.v_d + input.e() * law.beta, input.a_d + input.e_dot() * law.beta);
        law.model.torque_for(&input.q, &input.v, &v_r, &a_r) + input.r(law.beta) * law.k_t
    }

    fn at_rest<const N: usize>(law: &Law<N>, mass: &Matrix<N>, weight: &Matrix<N>) -> (Matrix<N>, Matrix<N>) {
        let unit = Matrix::<N>::identity();
        (unit * (-law.k_t * law.beta) + weight, unit * -law.k_t - mass * law.beta)
    }

    fn fed_forward<const N: usize>(law: &Law<N>, x: &LawInput<N>) -> Vector<N> {
        law.model.torque_for(&x.q, &x.v_d, &x.v_d, &x.a_d)
    }

    fn torque_bound<const N: usize>(law: &Law<N>, certificate: &Certificate, reach: &Reach<N>, i: usize) -> f64 {
        let (row, env) = (Row::of(&law.model, i), &certificate.envelope);
        let (inertial, speed) = (row.inertia * (env.a_2 + law.beta * reach.e_dot), env.v_2 + reach.e_dot);
        inertial + row.turning * speed * (env.v_2 + law.beta * reach.e) + row.weight + law.k_t * reach.r[i]
    }

    fn gains_for_rate(rate: f64, lambda_lo: f64, gains: &Gains) -> Option<Gains> {
        Some(Gains { k_t: Some(lambda_lo * (rate - gains.beta)), ..*gains })
    }
}

fn certify(env: &Envelope, gains: &Gains, start: Option<&StartError>) -> Certification {
    let beta = gains.beta;
    let p = if gains.shared_v { p_of(env, beta) } else { beta * gains.k2 };
    let required = env.mu * (inertial_nm(env) + env.b_hat) + env.disturbance_nm;
    let mut of = OnR::new(env, gains, p, required);
    // Only what the model is wrong about is left to κ.
    let delta = p + env.mu * (beta * beta * env.lambda_hat_hi + env.c_hat * beta * of.x);
    of.pay_for(delta, env.mu * (beta * env.lambda_hat_hi + env.c_hat * of.w));
    let against_c1 = of.share_out(gains);
    // The feed-forward adds β times the largest ratio of the model's inertia to the true one.
    let inertia_ratio = 1.0 + env.mu / (1.0 - env.mu) * (env.lambda_hi() / env.lambda_lo()).sqrt();
    let certificate = of.certificate(env, gains, against_c1, of.k_t / env.lambda_lo() + beta * inertia_ratio);
    Certification::of(certificate, gains, start, &positive(gains), |demands| {
        demands.c1(&of);
        demands.error_weight(&of) && demands.gain(&of)
    })
}

fn grid(task: &Task<'_>) -> Vec<Candidate> {
    // With p = β K2 the best share K2 is not known.
    let shares: &[f64] = if task.gains.shared_v { &[] } else { &[0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8] };
    on_r(task, shares, |beta| beta * (1.0 + task.envelope.rho()))
}
