//! The sampled, delayed, linearised loop in the modes of the chain, and its characteristic function.
//!
//! With the modes of M⁻¹ ∂G (VᵀMV = 1, Vᵀ ∂G V = diag λ) the chain under a held torque is N oscillators
//! ξ̈ = −λ ξ + ω with ω = Vᵀτ, each discretised in closed form, and the law is ω = A ξ + B ξ̇. A delay of j whole periods
//! is a factor z^{−j}, so that the loop has the roots of the determinant of an N × N matrix, however long the delay is:
//!
//! ```text
//! Q(z) = diag(D_i) − A diag(n_i) − B diag(m_i)
//! D = z² − 2cz + 1,   (n, m) = adj(z − Φ) g,   g = z^{−j−1} (G_0 z + G_1)
//! ```
//!
//! c, Φ, G_0 (the torque that takes over in the period) and G_1 (the one that acts before) belong to a mode. Where the
//! law has the chain's own modes (`ctc` with an exact model) A and B are diagonal and the modes are taken one by one.

#![expect(clippy::needless_range_loop, reason = "index notation mirrors the equations, and fixes the order of sums")]

use nalgebra::Complex;

use crate::certificate::envelope::generalised_eigen;
use crate::chain::{Chain, Matrix, Vector};
use crate::law::Law;

/// The loop about rest at one configuration, not yet sampled.
#[derive(Clone, Debug)]
pub(super) struct Modal<const N: usize> {
    /// λ of each mode, 1/s²; negative where a link stands.
    lambda: [f64; N],
    /// A: what the law does about the modes' positions, 1/s².
    on_q: Matrix<N>,
    /// B: what it does about their velocities, 1/s.
    on_v: Matrix<N>,
    /// Whether A and B are diagonal.
    decoupled: bool,
}

impl<const N: usize> Modal<N> {
    /// The loop of `law` with the chain `plant`, linearised about e = 0 at rest in the configuration `q`.
    pub(super) fn new(law: &Law<N>, plant: &Chain<N>, q: &Vector<N>) -> Self {
        let (lambda, modes) = generalised_eigen(&plant.mass_matrix(q), &plant.gravity_rate(q));
        let (on_q, on_v) = law.at_rest(q);
        let (on_q, on_v) = (modes.transpose() * on_q * modes, modes.transpose() * on_v * modes);
        let decoupled = nearly_diagonal(&on_q) && nearly_diagonal(&on_v);
        Self { lambda, on_q, on_v, decoupled }
    }

    /// The loop sampled every `period_s`, each torque acting from `delay_s` after its sample until the next one acts.
    pub(super) fn sampled(&self, period_s: f64, delay_s: f64) -> Sampled<'_, N> {
        let whole = (delay_s / period_s).floor();
        let part_s = (delay_s - whole * period_s).clamp(0.0, period_s);
        let modes = self.lambda.map(|lambda| {
            let (whole, early, late) =
                (Held::of(lambda, period_s), Held::of(lambda, part_s), Held::of(lambda, period_s - part_s));
            let carried = [
                (1.0 - late.fall) * early.position + late.swing * early.swing,
                (1.0 - late.fall) * early.swing - lambda * late.swing * early.position,
            ];
            Mode { lambda, fall: whole.fall, swing: whole.swing, fresh: [late.position, late.swing], old: carried }
        });
        Sampled { of: self, modes, age: whole + 1.0 }
    }
}

/// Off the diagonal there is rounding alone.
fn nearly_diagonal<const N: usize>(matrix: &Matrix<N>) -> bool {
    let scale = matrix.iter().fold(0.0f64, |most, x| most.max(x.abs()));
    (0..N).all(|i| (0..N).all(|j| i == j || matrix[(i, j)].abs() <= 1e-11 * scale))
}

/// A mode ξ̈ = −λ ξ + ω over a time t in which ω is held.
struct Held {
    /// 1 − cos(√λ t), precise for short times.
    fall: f64,
    /// sin(√λ t)/√λ, s: also what ω does to ξ̇.
    swing: f64,
    /// (1 − cos(√λ t))/λ, s²: what ω does to ξ.
    position: f64,
}

impl Held {
    fn of(lambda: f64, t_s: f64) -> Self {
        let turn = lambda * t_s * t_s;
        let half = sinc_of_square(0.25 * turn);
        let position = 0.5 * t_s * t_s * half * half;
        Self { fall: lambda * position, swing: t_s * sinc_of_square(turn), position }
    }
}

/// sin(√y)/√y, and sinh(√−y)/√−y for y < 0.
fn sinc_of_square(y: f64) -> f64 {
    if y.abs() < 1e-3 {
        // The next term of the series is below 3e-18.
        return 1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0)));
    }
    let root = y.abs().sqrt();
    if y > 0.0 { libm::sin(root) / root } else { libm::sinh(root) / root }
}

/// A mode over one period.
#[derive(Clone, Copy, Debug)]
struct Mode {
    lambda: f64,
    fall: f64,
    swing: f64,
    /// What the torque that takes over within the period does to (ξ, ξ̇).
    fresh: [f64; 2],
    /// What the torque that acts before does.
    old: [f64; 2],
}

/// The loop at one configuration, period and delay.
#[derive(Clone, Debug)]
pub(super) struct Sampled<'a, const N: usize> {
    of: &'a Modal<N>,
    modes: [Mode; N],
    /// j + 1.
    age: f64,
}

/// det Q at a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Value {
    /// Its direction, of modulus 1.
    pub(super) direction: Complex<f64>,
    /// The logarithm of its modulus.
    pub(super) log: f64,
    /// Its derivative by z over itself.
    pub(super) rate: Complex<f64>,
}

#[cfg(test)]
std::thread_local! {
    /// Determinants computed by this thread.
    pub(super) static EVALUATED: core::cell::Cell<u64> = const { core::cell::Cell::new(0) };
}

const ZERO: Complex<f64> = Complex::new(0.0, 0.0);
const ONE: Complex<f64> = Complex::new(1.0, 0.0);

impl<const N: usize> Sampled<'_, N> {
    /// det Q at z = 1 + w; w is given since near 1, where a fast loop has its roots, z alone has lost their digits.
    pub(super) fn at(&self, w: Complex<f64>) -> Value {
        #[cfg(test)]
        EVALUATED.set(EVALUATED.get() + 1);
        let z = w + 1.0;
        // z^{−j−1}, of which the modulus is taken out where it is large: a common factor changes no direction or rate.
        let growth = -self.age * 0.5 * libm::log1p(2.0 * w.re + w.norm_sqr());
        let turn = -self.age * libm::atan2(z.im, z.re);
        let (delayed, scale) = (libm::exp(growth.min(0.0)), libm::exp((-growth).min(0.0)));
        let delayed = Complex::new(delayed * libm::cos(turn), delayed * libm::sin(turn));
        let aging = -ONE / z * self.age;
        let terms = self.modes.map(|mode| mode.terms(w, delayed, aging, scale));
        let common = growth.max(0.0) * N as f64;
        if self.of.decoupled {
            let mut value = Value { direction: ONE, log: common, rate: ZERO };
            for (i, term) in terms.iter().enumerate() {
                let (a, b) = (self.of.on_q[(i, i)], self.of.on_v[(i, i)]);
                value.times(term.own.0 - term.q.0 * a - term.v.0 * b, term.own.1 - term.q.1 * a - term.v.1 * b);
            }
            return value;
        }
        let (mut matrix, mut slope) = ([[ZERO; N]; N], [[ZERO; N]; N]);
        for i in 0..N {
            for (k, term) in terms.iter().enumerate() {
                let (a, b) = (self.of.on_q[(i, k)], self.of.on_v[(i, k)]);
                matrix[i][k] = -(term.q.0 * a + term.v.0 * b);
                slope[i][k] = -(term.q.1 * a + term.v.1 * b);
            }
            matrix[i][i] += terms[i].own.0;
            slope[i][i] += terms[i].own.1;
        }
        determinant(matrix, slope, common)
    }
}

/// D, n and m of a mode, each with its derivative by z.
struct Terms {
    own: (Complex<f64>, Complex<f64>),
    q: (Complex<f64>, Complex<f64>),
    v: (Complex<f64>, Complex<f64>),
}

impl Mode {
    fn terms(&self, w: Complex<f64>, delayed: Complex<f64>, aging: Complex<f64>, scale: f64) -> Terms {
        let z = w + 1.0;
        let off = w + self.fall;
        let torque = |part: usize| {
            let value = delayed * (z * self.fresh[part] + self.old[part]);
            (value, delayed * self.fresh[part] + value * aging)
        };
        let ((g_q, g_q_rate), (g_v, g_v_rate)) = (torque(0), torque(1));
        let back = self.lambda * self.swing;
        Terms {
            own: ((off * off + back * self.swing) * scale, off * (2.0 * scale)),
            q: (off * g_q + g_v * self.swing, g_q + off * g_q_rate + g_v_rate * self.swing),
            v: (off * g_v - g_q * back, g_v + off * g_v_rate - g_q_rate * back),
        }
    }
}

impl Value {
    fn times(&mut self, factor: Complex<f64>, slope: Complex<f64>) {
        let modulus = factor.norm_sqr().sqrt();
        self.direction *= factor / modulus;
        self.log += libm::log(modulus);
        self.rate += slope / factor;
    }
}

/// The determinant of a matrix with its logarithmic derivative tr(Q⁻¹ Q'), by elimination with row pivots.
fn determinant<const N: usize>(
    mut matrix: [[Complex<f64>; N]; N],
    mut slope: [[Complex<f64>; N]; N],
    log: f64,
) -> Value {
    let mut value = Value { direction: ONE, log, rate: ZERO };
    for column in 0..N {
        let mut pivot = column;
        for row in column + 1..N {
            if matrix[row][column].norm_sqr() > matrix[pivot][column].norm_sqr() {
                pivot = row;
            }
        }
        if pivot != column {
            matrix.swap(pivot, column);
            slope.swap(pivot, column);
            value.direction = -value.direction;
        }
        let inverse = ONE / matrix[column][column];
        for row in column + 1..N {
            let factor = matrix[row][column] * inverse;
            for k in column + 1..N {
                let taken = factor * matrix[column][k];
                matrix[row][k] -= taken;
            }
            for k in 0..N {
                let taken = factor * slope[column][k];
                slope[row][k] -= taken;
            }
        }
        value.times(matrix[column][column], ZERO);
    }
    // Back substitution, of which the trace needs row i of column i alone.
    for i in 0..N {
        let mut solved = [ZERO; N];
        for row in (i..N).rev() {
            let mut left = slope[row][i];
            for k in row + 1..N {
                left -= matrix[row][k] * solved[k];
            }
            solved[row] = left / matrix[row][row];
        }
        value.rate += solved[i];
    }
    value
}
