//! What is assumed about the plant, the disturbance and the reference, reduced to the few numbers that bounds need.
//!
//! The true masses are m_i = m̂_i (1 + s_i) with |s_i| ≤ μ, inertias in proportion. M, C and G are linear in the
//! masses with positive semidefinite terms, so the nominal chain and μ bound all of them.

use crate::chain::{Chain, Matrix};
use crate::trajectory::SupNorms;

/// Assumptions of a certificate about an N-link chain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Assumptions<const N: usize> {
    /// The controller's model of the chain.
    pub nominal: Chain<N>,
    /// μ: largest relative error of a mass, 0 ≤ μ < 1.
    pub mass_mismatch: f64,
    /// D: largest |d| of whatever acts beside the model (disturbance, friction), N·m.
    pub disturbance_bound_nm: f64,
    /// Suprema of the reference (Assumption 1).
    pub sup: SupNorms,
}

impl<const N: usize> Assumptions<N> {
    /// The numbers that follow from the assumptions.
    #[must_use]
    pub fn envelope(&self) -> Envelope {
        let a = self.nominal.a();
        let eigenvalues = symmetric_eigenvalues(a);
        let off_diagonal = Matrix::<N>::from_fn(|i, j| if i == j { 0.0 } else { a[(i, j)].abs() });
        let c_hat = symmetric_eigenvalues(&off_diagonal).iter().fold(0.0, |top: f64, x| top.max(x.abs()));
        Envelope {
            scalar: N == 1,
            mu: self.mass_mismatch,
            disturbance_nm: self.disturbance_bound_nm,
            v_inf: self.sup.v_inf,
            v_2: self.sup.v_2,
            a_2: self.sup.a_2,
            lambda_hat_lo: eigenvalues.iter().copied().fold(f64::INFINITY, f64::min),
            lambda_hat_hi: eigenvalues.iter().copied().fold(0.0, f64::max),
            c_hat,
            b_hat: self.nominal.b().norm(),
        }
    }
}

/// The numbers that bounds need, free of the number of links.
///
/// By Schur's product theorem the eigenvalues of M over all configurations lie between those of a, and reach them where
/// all links are aligned: no search over configurations is needed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Envelope {
    /// One link: all masses scale alike.
    pub scalar: bool,
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
    /// Smallest eigenvalue of â, kg·m².
    pub lambda_hat_lo: f64,
    /// Largest eigenvalue of â, kg·m².
    pub lambda_hat_hi: f64,
    /// ĉ = ‖|â| without its diagonal‖₂, kg·m²; absolute values, since signs of a_ij may be mixed.
    pub c_hat: f64,
    /// |b̂|, N·m.
    pub b_hat: f64,
}

impl Envelope {
    /// λ̲ = (1−μ) λ̂_min, kg·m².
    #[must_use]
    pub fn lambda_lo(&self) -> f64 {
        (1.0 - self.mu) * self.lambda_hat_lo
    }

    /// λ̄ = (1+μ) λ̂_max, kg·m².
    #[must_use]
    pub fn lambda_hi(&self) -> f64 {
        (1.0 + self.mu) * self.lambda_hat_hi
    }

    /// c̄ = (1+μ) ĉ, kg·m²: |C(q,x) y| ≤ c̄ |x|_∞ |y|.
    #[must_use]
    pub fn c_bar(&self) -> f64 {
        (1.0 + self.mu) * self.c_hat
    }

    /// m̄ = (λ̲ + λ̄)/2, kg·m².
    #[must_use]
    pub fn m_bar(&self) -> f64 {
        (self.lambda_lo() + self.lambda_hi()) / 2.0
    }

    /// ρ ≥ ‖M⁻¹M̂ − 1‖: μ/(1−μ) sqrt(λ̄/λ̲), without the root when all masses scale alike.
    #[must_use]
    pub fn rho(&self) -> f64 {
        let alike = self.mu / (1.0 - self.mu);
        if self.scalar { alike } else { alike * (self.lambda_hi() / self.lambda_lo()).sqrt() }
    }
}

/// All eigenvalues of a symmetric matrix, in no order.
#[must_use]
pub fn symmetric_eigenvalues<const N: usize>(matrix: &Matrix<N>) -> [f64; N] {
    symmetric_eigen(matrix).0
}

/// Eigenvalues of a symmetric matrix, in no order, with their eigenvectors as columns, by cyclic Jacobi rotations.
///
/// Own code, since library eigenvalues may be computed with instructions picked at run time. Sixteen sweeps are twice
/// what a 7 × 7 matrix needs to reach rounding.
#[must_use]
pub fn symmetric_eigen<const N: usize>(matrix: &Matrix<N>) -> ([f64; N], Matrix<N>) {
    let (mut m, mut vectors) = (*matrix, Matrix::<N>::identity());
    for _ in 0..16 {
        for p in 0..N {
            for q in p + 1..N {
                if m[(p, q)].abs() <= f64::MIN_POSITIVE {
                    continue;
                }
                let theta = (m[(q, q)] - m[(p, p)]) / (2.0 * m[(p, q)]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let cos = 1.0 / (t * t + 1.0).sqrt();
                let sin = t * cos;
                for k in 0..N {
                    let (left, right) = (m[(k, p)], m[(k, q)]);
                    m[(k, p)] = cos * left - sin * right;
                    m[(k, q)] = sin * left + cos * right;
                }
                for k in 0..N {
                    let (upper, lower) = (m[(p, k)], m[(q, k)]);
                    m[(p, k)] = cos * upper - sin * lower;
                    m[(q, k)] = sin * upper + cos * lower;
                }
                for k in 0..N {
                    let (left, right) = (vectors[(k, p)], vectors[(k, q)]);
                    vectors[(k, p)] = cos * left - sin * right;
                    vectors[(k, q)] = sin * left + cos * right;
                }
            }
        }
    }
    (core::array::from_fn(|i| m[(i, i)]), vectors)
}

/// λ and V of S V = M V diag(λ), VᵀMV = 1, M positive definite: by its Cholesky factor L and the eigenvectors of L⁻¹SL⁻ᵀ.
#[must_use]
pub fn generalised_eigen<const N: usize>(mass: &Matrix<N>, stiffness: &Matrix<N>) -> ([f64; N], Matrix<N>) {
    let mut lower = Matrix::<N>::zeros();
    for i in 0..N {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| lower[(i, k)] * lower[(j, k)]).sum();
            let left = mass[(i, j)] - known;
            lower[(i, j)] = if i == j { left.sqrt() } else { left / lower[(j, j)] };
        }
    }
    let mut inverse = Matrix::<N>::zeros();
    for j in 0..N {
        for i in j..N {
            let known: f64 = (j..i).map(|k| lower[(i, k)] * inverse[(k, j)]).sum();
            inverse[(i, j)] = (if i == j { 1.0 } else { 0.0 } - known) / lower[(i, i)];
        }
    }
    let (lambda, vectors) = symmetric_eigen(&(inverse * stiffness * inverse.transpose()));
    (lambda, inverse.transpose() * vectors)
}
