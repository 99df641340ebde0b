//! The n-link chain: M(q) q̈ + C(q, q̇) q̇ + G(q) = τ, in absolute angles from the downward vertical.

use nalgebra::{SMatrix, SVector};

/// The largest number of links that the wire format carries.
pub const LINKS_MAX: usize = 7;
/// A vector with one entry a link.
pub type Vector<const N: usize> = SVector<f64, N>;
/// A square matrix with one row a link.
pub type Matrix<const N: usize> = SMatrix<f64, N, N>;

/// Coefficients of the chain: a_ij (kg·m²) and b_i (N·m), see [1]–[3].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain<const N: usize> {
    a: Matrix<N>,
    b: Vector<N>,
}
