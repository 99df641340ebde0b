//! The factorisation of the mass matrix: by hand, so that every machine does the same operations in the same order.

#![expect(clippy::needless_range_loop, reason = "index notation mirrors the recurrences, and fixes the order of sums")]

/// M = L D Lᵀ with a unit lower triangular L: Cholesky's factorisation without its square roots.
pub(super) struct Factors<const N: usize> {
    /// Below the diagonal: L.
    lower: [[f64; N]; N],
    /// The diagonal of D, all positive exactly when M is positive definite.
    pub(super) pivots: [f64; N],
    /// 1/D: a division is much dearer than a product.
    inverse_pivots: [f64; N],
}

impl<const N: usize> Factors<N> {
    /// Uses the lower triangle of `matrix` only.
    pub(super) fn of(matrix: [[f64; N]; N]) -> Self {
        let mut factors = Self { lower: matrix, pivots: [0.0; N], inverse_pivots: [0.0; N] };
        // For a column j, scaled[k] = L_jk D_k.
        let mut scaled = [0.0; N];
        for j in 0..N {
            let mut pivot = factors.lower[j][j];
            for k in 0..j {
                scaled[k] = factors.lower[j][k] * factors.pivots[k];
                pivot -= factors.lower[j][k] * scaled[k];
            }
            let inverse = 1.0 / pivot;
            for i in j + 1..N {
                let mut entry = factors.lower[i][j];
                for k in 0..j {
                    entry -= factors.lower[i][k] * scaled[k];
                }
                factors.lower[i][j] = entry * inverse;
            }
            factors.pivots[j] = pivot;
            factors.inverse_pivots[j] = inverse;
        }
        factors
    }

    /// The solution x of M x = `rhs`.
    pub(super) fn solve(&self, rhs: [f64; N]) -> [f64; N] {
        let mut x = rhs;
        for i in 0..N {
            for k in 0..i {
                x[i] -= self.lower[i][k] * x[k];
            }
        }
        for i in 0..N {
            x[i] *= self.inverse_pivots[i];
        }
        for i in (0..N).rev() {
            for k in i + 1..N {
                x[i] -= self.lower[k][i] * x[k];
            }
        }
        x
    }
}
