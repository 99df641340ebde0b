//! The spectral radius by dense matrices, with the whole delay line in the state: what the fast way is compared with.
//!
//! It shares no step with it: the exponential by its series, the feedback in the angles, the radius by squaring.

#![expect(clippy::needless_range_loop, reason = "index notation mirrors the equations, and fixes the order of sums")]

use crate::chain::{Chain, Matrix, Vector};
use crate::law::Law;

/// Spectral radius at a configuration: the loop about rest at `q`, sampled every `period_s`, each torque acting from
/// `delay_s` after its sample (any length) until the next one acts. Below 1 the linearised loop is stable.
///
/// With d = (j + f) h the state is x_k = (q, q̇) and the j + 1 torques under way:
/// x_{k+1} = Φ(h) x_k + Φ(h − fh) Γ(fh) u_{k−j−1} + Γ(h − fh) u_{k−j},  u_k = F x_k.
pub(super) fn spectral_radius<const N: usize>(
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

/// Whole periods in the delay, and the rest of it in s.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the delays of tests are short")]
fn split(period_s: f64, delay_s: f64) -> (usize, f64) {
    let whole = (delay_s / period_s).floor();
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
    let (on_q, on_v) = law.at_rest(q);
    (0..N).map(|i| (0..2 * N).map(|j| if j < N { on_q[(i, j)] } else { on_v[(i, j - N)] }).collect()).collect()
}

/// A square matrix, row by row.
#[derive(Clone, Debug, PartialEq)]
struct Dense {
    size: usize,
    entries: Vec<f64>,
}

impl Dense {
    fn zeros(size: usize) -> Self {
        Self { size, entries: vec![0.0; size * size] }
    }

    fn identity(size: usize) -> Self {
        let mut out = Self::zeros(size);
        for i in 0..size {
            out.set(i, i, 1.0);
        }
        out
    }

    fn at(&self, row: usize, column: usize) -> f64 {
        self.entries[row * self.size + column]
    }

    fn set(&mut self, row: usize, column: usize, value: f64) {
        self.entries[row * self.size + column] = value;
    }

    fn add(&mut self, row: usize, column: usize, value: f64) {
        self.entries[row * self.size + column] += value;
    }

    fn scaled(mut self, factor: f64) -> Self {
        self.entries.iter_mut().for_each(|x| *x *= factor);
        self
    }

    /// The largest sum of absolute values of a row.
    fn norm(&self) -> f64 {
        self.entries.chunks(self.size).map(|row| row.iter().map(|x| x.abs()).sum()).fold(0.0, f64::max)
    }

    fn times(&self, other: &Self) -> Self {
        let mut out = Self::zeros(self.size);
        for i in 0..self.size {
            for k in 0..self.size {
                let factor = self.at(i, k);
                for j in 0..self.size {
                    out.add(i, j, factor * other.at(k, j));
                }
            }
        }
        out
    }

    /// e^{A}, by scaling to a norm of at most 1/4, eighteen terms of the series (remainder below 1e-27), and squaring.
    fn exponential(&self) -> Self {
        let mut squarings = 0;
        let mut scale = 1.0;
        while self.norm() * scale > 0.25 && squarings < 60 {
            scale *= 0.5;
            squarings += 1;
        }
        let small = self.clone().scaled(scale);
        let mut sum = Self::identity(self.size);
        for term in (1..=18u32).rev() {
            // Horner: 1 + A/1 (1 + A/2 (1 + …)).
            sum = small.times(&sum).scaled(1.0 / f64::from(term));
            for i in 0..self.size {
                sum.add(i, i, 1.0);
            }
        }
        for _ in 0..squarings {
            sum = sum.times(&sum);
        }
        sum
    }

    /// The spectral radius, as the limit of ‖A^m‖^{1/m} along m = 2^k (Gelfand's formula); at m = 2^40 the factor that
    /// stands between the norm and the radius is 1 to rounding.
    fn spectral_radius(&self) -> f64 {
        let mut power = self.clone();
        let (mut log_radius, mut weight) = (0.0, 1.0);
        for _ in 0..40 {
            let norm = power.norm();
            if !(norm > 0.0 && norm.is_finite()) {
                // A power that vanishes means radius 0; one that is not finite came from such an input.
                return if norm > 0.0 { f64::INFINITY } else { 0.0 };
            }
            log_radius += weight * libm::log(norm);
            weight *= 0.5;
            let unit = power.scaled(1.0 / norm);
            power = unit.times(&unit);
        }
        libm::exp(log_radius)
    }
}
