//! How far the error, and with it the torques, get on {V ≤ c}.

use crate::chain::Chain;

use super::envelope::symmetric_eigen;
use super::{Certificate, Form};

/// The extremes of a state on {V ≤ c}.
#[derive(Clone, Copy, Debug)]
pub struct Reach<const N: usize> {
    /// |e|, rad.
    pub e: f64,
    /// |ė|, rad/s.
    pub e_dot: f64,
    /// |r_i|, rad/s: r_i² ≤ 2c (M⁻¹)_ii, and (M⁻¹)_ii ≤ (a⁻¹)_ii with equality for aligned links. 0 in a certificate on y.
    pub r: [f64; N],
    /// β of r, 1/s.
    pub beta: f64,
}

impl<const N: usize> Reach<N> {
    /// That of a certificate, for the true chain.
    #[must_use]
    pub fn of(chain: &Chain<N>, cert: &Certificate) -> Self {
        let twice = 2.0 * cert.level;
        match &cert.form {
            Form::OnR(of) => {
                let (eigenvalues, vectors) = symmetric_eigen(chain.a());
                let lambda_lo = eigenvalues.iter().copied().fold(f64::INFINITY, f64::min);
                let inverse =
                    |i: usize| (0..N).map(|k| vectors[(i, k)] * vectors[(i, k)] / eigenvalues[k]).sum::<f64>();
                Self {
                    e: (twice / of.p).sqrt(),
                    // ė = r − βe with ½ rᵀMr + ½ p|e|² ≤ c, by Cauchy.
                    e_dot: (twice * (1.0 / lambda_lo + of.beta * of.beta / of.p)).sqrt(),
                    r: core::array::from_fn(|i| (twice * inverse(i)).sqrt()),
                    beta: of.beta,
                }
            }
            Form::OnY(of) => {
                // The extremes of the ellipse ½ yᵀ([[1+2ζ², ζ],[ζ, 1]] ⊗ 1) y = c.
                let zeta_square = of.k_d * of.k_d / (4.0 * of.k_p);
                let e = (twice / ((1.0 + zeta_square) * of.k_p)).sqrt();
                let e_dot = (twice * (1.0 + 2.0 * zeta_square) / (1.0 + zeta_square)).sqrt();
                Self { e, e_dot, r: [0.0; N], beta: 0.0 }
            }
        }
    }
}

/// Norms of one row of a chain, from which torques of that link are bounded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    /// |M_i| at most, kg·m².
    pub(crate) inertia: f64,
    /// The largest |a_ij| with j ≠ i, kg·m²: of the Coriolis terms.
    pub(crate) turning: f64,
    /// |b_i|, N·m: the weight.
    pub(crate) weight: f64,
}

impl Row {
    /// Row `i` of a chain.
    pub(crate) fn of<const N: usize>(chain: &Chain<N>, i: usize) -> Self {
        let a = chain.a();
        Self {
            inertia: (0..N).map(|j| a[(i, j)] * a[(i, j)]).sum::<f64>().sqrt(),
            turning: (0..N).filter(|j| *j != i).map(|j| a[(i, j)].abs()).fold(0.0, f64::max),
            weight: chain.b()[i].abs(),
        }
    }
}
