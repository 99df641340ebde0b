//! The spectral radius of the sampled, delayed, linearised loop of any law, exactly discretised.

use core::f64::consts::PI;

use crate::chain::{Chain, Matrix, Vector};
use crate::law::{Law, LawKind};
use crate::rng::{self, Stream};

use super::dense::Dense;

/// Spectral radius at a configuration: the loop about rest at `q`, sampled every `period_s`, each torque acting from
/// `delay_s` after its sample (any length) until the next one acts. Below 1 the linearised loop is stable.
///
/// With d = (j + f) h the state is x_k = (q, q̇) and the j + 1 torques under way:
/// x_{k+1} = Φ(h) x_k + Φ(h − fh) Γ(fh) u_{k−j−1} + Γ(h − fh) u_{k−j},  u_k = F x_k.
#[must_use]
pub fn spectral_radius<const N: usize>(
    law: &Law<N>,
    plant: &Chain<N>,
    q: &Vector<N>,
    period_s: f64,
    delay_s: f64,
) -> f64 {
    let (whole, part_s) = split(period_s, delay_s);
    let early = held(plant, q, part_s);
    let late = held(plant, q, period_s - part_s);
    let feedback = feedback(law, q);
    let size = 2 * N + (whole + 1) * N;
    let mut step = Dense::zeros(size);
    let old = 2 * N + whole * N;
    for i in 0..2 * N {
        for j in 0..2 * N {
            let free: f64 = (0..2 * N).map(|k| late.at(i, k) * early.at(k, j)).sum();
            // Without a whole period of delay the torque that takes over is the answer to x_k itself.
            let answered: f64 =
                if whole == 0 { (0..N).map(|k| late.at(i, 2 * N + k) * feedback[k][j]).sum() } else { 0.0 };
            step.set(i, j, free + answered);
        }
        for j in 0..N {
            let outgoing: f64 = (0..2 * N).map(|k| late.at(i, k) * early.at(k, 2 * N + j)).sum();
            step.add(i, old + j, outgoing);
            if whole > 0 {
                step.add(i, old - N + j, late.at(i, 2 * N + j));
            }
        }
    }
    for (i, row) in feedback.iter().enumerate() {
        for (j, gain) in row.iter().take(2 * N).enumerate() {
            step.set(2 * N + i, j, *gain);
        }
    }
    for i in 0..whole * N {
        step.set(3 * N + i, 2 * N + i, 1.0);
    }
    step.spectral_radius()
}

/// The largest spectral radius over configurations: all links down, all up (aligned links are the worst for the fast
/// mode), and `samples` that are drawn once and for all.
#[must_use]
pub fn worst_radius<const N: usize>(law: &Law<N>, plant: &Chain<N>, period_s: f64, delay_s: f64, samples: u32) -> f64 {
    let aligned = [Vector::<N>::zeros(), Vector::<N>::repeat(PI)];
    let drawn = (0..samples).map(|sample| {
        let mut lane = 0;
        Vector::<N>::from_fn(|_, _| {
            lane += 1;
            PI * (2.0 * rng::uniform(1, Stream::Test, u64::from(sample), lane) - 1.0)
        })
    });
    aligned.into_iter().chain(drawn).map(|q| spectral_radius(law, plant, &q, period_s, delay_s)).fold(0.0, f64::max)
}

/// What may be added to the delay before [`worst_radius`] reaches 1, s; 0 when it has. For any law, `ctc` included.
///
/// The search ends at 32 periods: a loop that bears more is not limited by its latency.
#[must_use]
pub fn delay_margin_s<const N: usize>(law: &Law<N>, plant: &Chain<N>, period_s: f64, delay_s: f64) -> f64 {
    let stable = |delay_s: f64| worst_radius(law, plant, period_s, delay_s, 4) < 1.0;
    if !stable(delay_s) {
        return 0.0;
    }
    let (mut holds, mut step) = (delay_s, period_s / 2.0);
    // Walking before bisecting finds the first boundary, should there be several.
    while holds < delay_s + 32.0 * period_s && stable(holds + step) {
        holds += step;
    }
    for _ in 0..20 {
        step *= 0.5;
        if stable(holds + step) {
            holds += step;
        }
    }
    holds - delay_s
}

/// Whole periods in the delay, and the rest of it in s.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded by 64, not negative")]
fn split(period_s: f64, delay_s: f64) -> (usize, f64) {
    // A delay of 64 periods is beyond every loop that is worth its analysis; the bound keeps the matrix small.
    let whole = (delay_s / period_s).floor().clamp(0.0, 64.0);
    (whole as usize, (delay_s - whole * period_s).clamp(0.0, period_s))
}

/// [Φ(t) Γ(t); 0 1] of the chain linearised about rest at q: 3N × 3N, the exponential of t [[0,1,0],[−M⁻¹∂G,0,M⁻¹],0].
fn held<const N: usize>(plant: &Chain<N>, q: &Vector<N>, t_s: f64) -> Dense {
    let inverse = inverse_mass(plant, q);
    let mut rate = Dense::zeros(3 * N);
    for i in 0..N {
        rate.set(i, N + i, t_s);
        for j in 0..N {
            rate.set(N + i, j, -t_s * inverse[(i, j)] * plant.b()[j] * libm::cos(q[j]));
            rate.set(N + i, 2 * N + j, t_s * inverse[(i, j)]);
        }
    }
    rate.exponential()
}

fn inverse_mass<const N: usize>(plant: &Chain<N>, q: &Vector<N>) -> Matrix<N> {
    let (rest, weight) = (Vector::<N>::zeros(), plant.gravity(q));
    let mut inverse = Matrix::<N>::zeros();
    for j in 0..N {
        let mut unit = weight;
        unit[j] += 1.0;
        inverse.set_column(j, &plant.acceleration(q, &rest, &unit));
    }
    inverse
}

/// F of δτ = F (δq, δq̇), N rows of 2N, about e = 0 at rest.
fn feedback<const N: usize>(law: &Law<N>, q: &Vector<N>) -> Vec<Vec<f64>> {
    let unit = Matrix::<N>::identity();
    let mass = law.model.mass_matrix(q);
    let stiffness = Matrix::<N>::from_diagonal(&Vector::<N>::from_fn(|i, _| law.model.b()[i] * libm::cos(q[i])));
    let Law { beta, k_t, k_p, k_d, .. } = *law;
    let (on_q, on_v) = match law.kind {
        LawKind::Robust => (unit * (-k_t * beta), unit * -k_t),
        LawKind::RobustFf => (unit * (-k_t * beta) + stiffness, unit * -k_t - mass * beta),
        LawKind::Ctc => (mass * -k_p + stiffness, mass * -k_d),
        LawKind::PdG => (unit * -k_p + stiffness, unit * -k_d),
    };
    (0..N).map(|i| (0..2 * N).map(|j| if j < N { on_q[(i, j)] } else { on_v[(i, j - N)] }).collect()).collect()
}
