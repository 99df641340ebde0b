//! The n-link chain: M(q) q̈ + C(q, q̇) q̇ + G(q) = τ, in absolute angles from the downward vertical.
//!
//! This module is responsible for the rigid-body terms and nothing else: friction, disturbances and noise belong to
//! `truth`, control laws to `law`. Angles are absolute (each from the downward vertical), torques τ_i are conjugate to
//! them. Numbers in square brackets are the equations of the model document:
//!
//! ```text
//! M_ij(q)    = a_ij cos(q_i − q_j)        [1]
//! C_ij(q, v) = a_ij sin(q_i − q_j) v_j    [2]
//! G_i(q)     = b_i sin q_i                [3]
//! ```
//!
//! Every result is bit-identical across machines: sines come from libm, one call a link, and the sines and cosines of
//! differences are products of them; sums run in index order; nothing is fused and nothing is dispatched at run time.

#![expect(clippy::needless_range_loop, reason = "index notation mirrors the equations, and fixes the order of sums")]

use nalgebra::{SMatrix, SVector};
use thiserror::Error;

use self::factors::Factors;

mod factors;

/// The largest number of links that the wire format carries.
pub const LINKS_MAX: usize = 7;
/// A vector with one entry a link.
pub type Vector<const N: usize> = SVector<f64, N>;
/// A square matrix with one row a link.
pub type Matrix<const N: usize> = SMatrix<f64, N, N>;

/// Links as a drawing shows them, hinge first; each centre of mass is in the middle of its link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkParameters<const N: usize> {
    /// Mass of each link, kg, > 0.
    pub mass_kg: [f64; N],
    /// Length of each link, m, > 0.
    pub length_m: [f64; N],
    /// Inertia of each link about its centre of mass, kg·m², ≥ 0; absent: m l²/12, a uniform rod.
    pub inertia_kg_m2: Option<[f64; N]>,
    /// Gravity, m/s²; 0 is a chain in the plane, a negative value hangs it upside down.
    pub gravity_m_s2: f64,
}

/// Why a chain cannot be built. Links and rows are counted from 1, as in the equations.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ChainError {
    /// A parameter of one link is outside of its range.
    #[error("{field} of link {link} is {value}, allowed: {allowed}")]
    Link {
        /// Name of the parameter.
        field: &'static str,
        /// Which link, from 1.
        link: usize,
        /// What was found.
        value: f64,
        /// What would be accepted.
        allowed: &'static str,
    },
    /// Gravity is not a finite number.
    #[error("gravity_m_s2 is {value}, allowed: any finite number")]
    Gravity {
        /// What was found.
        value: f64,
    },
    /// A coefficient a_ij is not a finite number.
    #[error("a[{row}][{column}] is {value}, allowed: any finite number")]
    Coefficient {
        /// Row of a, from 1.
        row: usize,
        /// Column of a, from 1.
        column: usize,
        /// What was found.
        value: f64,
    },
    /// a is not symmetric.
    #[error("a[{row}][{column}] is {value}, allowed: {mirror}, the value of a[{column}][{row}] (a must be symmetric)")]
    NotSymmetric {
        /// Row of a, from 1.
        row: usize,
        /// Column of a, from 1.
        column: usize,
        /// What was found.
        value: f64,
        /// The entry across the diagonal.
        mirror: f64,
    },
    /// a is symmetric, but not positive definite.
    #[error("pivot {row} of a is {value}, allowed: > {smallest:e} (a must be positive definite)")]
    NotPositiveDefinite {
        /// Which pivot of the factorisation a = L D Lᵀ, from 1.
        row: usize,
        /// What was found.
        value: f64,
        /// The rounding error of the pivot: below it the sign is not known.
        smallest: f64,
    },
}

/// Coefficients of the chain: a_ij (kg·m²) and b_i (N·m), see \[1]–\[3].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain<const N: usize> {
    a: Matrix<N>,
    b: Vector<N>,
}

impl<const N: usize> Chain<N> {
    /// The chain of the given links:
    ///
    /// ```text
    /// a_ii = I_i + m_i l_i²/4 + l_i² Σ_{k>i} m_k      a_ij = a_ji = l_i l_j (m_j/2 + Σ_{k>j} m_k),  i < j
    /// b_i  = g l_i (m_i/2 + Σ_{k>i} m_k)
    /// ```
    ///
    /// # Errors
    /// Names the parameter, the link, the value found and what is allowed.
    pub fn from_links(links: &LinkParameters<N>) -> Result<Self, ChainError> {
        let LinkParameters { mass_kg, length_m, inertia_kg_m2, gravity_m_s2 } = links;
        check_links("mass_kg", mass_kg, "a finite number > 0", |x| x > 0.0)?;
        check_links("length_m", length_m, "a finite number > 0", |x| x > 0.0)?;
        if let Some(inertia) = inertia_kg_m2 {
            check_links("inertia_kg_m2", inertia, "a finite number >= 0", |x| x >= 0.0)?;
        }
        if !gravity_m_s2.is_finite() {
            return Err(ChainError::Gravity { value: *gravity_m_s2 });
        }
        // beyond[i] = Σ_{k>i} m_k, the mass that link i carries at its end.
        let mut beyond = [0.0; N];
        for i in (1..N).rev() {
            beyond[i - 1] = beyond[i] + mass_kg[i];
        }
        let mut a = Matrix::<N>::zeros();
        let mut b = Vector::<N>::zeros();
        for j in 0..N {
            let (m, l) = (mass_kg[j], length_m[j]);
            let inertia = inertia_kg_m2.map_or(m * l * l / 12.0, |given| given[j]);
            a[(j, j)] = inertia + m * l * l / 4.0 + l * l * beyond[j];
            b[j] = gravity_m_s2 * l * (m / 2.0 + beyond[j]);
            for i in 0..j {
                a[(i, j)] = length_m[i] * l * (m / 2.0 + beyond[j]);
                a[(j, i)] = a[(i, j)];
            }
        }
        Self::from_coefficients(a, b)
    }

    /// The chain with the coefficients a (kg·m², symmetric positive definite) and b (N·m, finite) of \[1]–\[3].
    ///
    /// By Schur's product theorem M(q) is positive definite at every q exactly when a is, so this is all there is to
    /// check. Definite means beyond rounding: each pivot must exceed N machine epsilons of its diagonal entry.
    ///
    /// # Errors
    /// Names the entry, the value found and what is allowed.
    pub fn from_coefficients(a: Matrix<N>, b: Vector<N>) -> Result<Self, ChainError> {
        const { assert!(N >= 1 && N <= LINKS_MAX, "the wire format carries 1 to 7 links") };
        for i in 0..N {
            if !b[i].is_finite() {
                return Err(ChainError::Link { field: "b", link: i + 1, value: b[i], allowed: "any finite number" });
            }
            for j in 0..N {
                if !a[(i, j)].is_finite() {
                    return Err(ChainError::Coefficient { row: i + 1, column: j + 1, value: a[(i, j)] });
                }
            }
        }
        check_symmetric(&a)?;
        let factors = Factors::<N>::of(a.data.0);
        for i in 0..N {
            let (value, smallest) = (factors.pivots[i], ROUNDING_PER_LINK * links_f64::<N>() * a[(i, i)].max(0.0));
            // Written so that a pivot that is not a number is refused too.
            if !(value > smallest && value.is_finite()) {
                return Err(ChainError::NotPositiveDefinite { row: i + 1, value, smallest });
            }
        }
        Ok(Self { a, b })
    }

    /// The coefficients a_ij, kg·m², N × N.
    #[must_use]
    pub fn a(&self) -> &Matrix<N> {
        &self.a
    }

    /// The coefficients b_i, N·m.
    #[must_use]
    pub fn b(&self) -> &Vector<N> {
        &self.b
    }

    /// M(q), kg·m², N × N, symmetric positive definite. \[1]
    #[must_use]
    pub fn mass_matrix(&self, q: &Vector<N>) -> Matrix<N> {
        let mass = self.mass_array(&Angles::of(q));
        Matrix::from_fn(|i, j| mass[i][j])
    }

    /// C(q, v), N·m·s, N × N; C(q, q̇) q̇ is the torque of the centrifugal forces. \[2]
    #[must_use]
    pub fn coriolis(&self, q: &Vector<N>, v: &Vector<N>) -> Matrix<N> {
        let angles = Angles::of(q);
        Matrix::from_fn(|i, j| self.a[(i, j)] * angles.sin_difference(i, j) * v[j])
    }

    /// G(q), N·m. \[3]
    #[must_use]
    pub fn gravity(&self, q: &Vector<N>) -> Vector<N> {
        let angles = Angles::of(q);
        Vector::from_fn(|i, _| self.b[i] * angles.sin[i])
    }

    /// ∂G/∂q, N·m/rad: the stiffness that the weight gives the chain.
    #[must_use]
    pub fn gravity_rate(&self, q: &Vector<N>) -> Matrix<N> {
        Matrix::<N>::from_diagonal(&Vector::<N>::from_fn(|i, _| self.b[i] * libm::cos(q[i])))
    }

    /// Ṁ along q̇ = v, N·m·s, N × N: Ṁ_ij = −a_ij sin(q_i − q_j)(v_i − v_j).
    #[must_use]
    pub fn mass_matrix_rate(&self, q: &Vector<N>, v: &Vector<N>) -> Matrix<N> {
        let angles = Angles::of(q);
        Matrix::from_fn(|i, j| -self.a[(i, j)] * angles.sin_difference(i, j) * (v[i] - v[j]))
    }

    /// C(q, v) v + G(q), N·m: what must be overcome to move without acceleration.
    #[must_use]
    pub fn bias(&self, q: &Vector<N>, v: &Vector<N>) -> Vector<N> {
        Vector::from(self.bias_array(&Angles::of(q), v, v))
    }

    /// M(q) x + C(q, v) w + G(q), N·m, for x in rad/s² and v, w in rad/s.
    ///
    /// With w = v and x = q̈ it is inverse dynamics; the laws and Ψ of \[5] need w ≠ v. One pass, no matrix is formed.
    #[must_use]
    pub fn torque_for(&self, q: &Vector<N>, v: &Vector<N>, w: &Vector<N>, x: &Vector<N>) -> Vector<N> {
        let angles = Angles::of(q);
        let mut torque = self.bias_array(&angles, v, w);
        for i in 0..N {
            let mut inertial = 0.0;
            for j in 0..N {
                inertial += self.a[(i, j)] * angles.cos_difference(i, j) * x[j];
            }
            torque[i] += inertial;
        }
        Vector::from(torque)
    }

    /// q̈ = M⁻¹(τ − C q̇ − G), rad/s²: forward dynamics (1).
    #[must_use]
    pub fn acceleration(&self, q: &Vector<N>, v: &Vector<N>, tau: &Vector<N>) -> Vector<N> {
        let angles = Angles::of(q);
        let mut rhs = self.bias_array(&angles, v, v);
        for i in 0..N {
            rhs[i] = tau[i] - rhs[i];
        }
        Vector::from(Factors::of(self.mass_array(&angles)).solve(rhs))
    }

    /// ½ q̇ᵀ M q̇, J.
    #[must_use]
    pub fn kinetic_energy(&self, q: &Vector<N>, v: &Vector<N>) -> f64 {
        let angles = Angles::of(q);
        let mut twice = 0.0;
        for i in 0..N {
            for j in 0..N {
                twice += self.a[(i, j)] * angles.cos_difference(i, j) * v[i] * v[j];
            }
        }
        twice / 2.0
    }

    /// −Σ b_i cos q_i, J: zero at the height of the hinge.
    #[must_use]
    pub fn potential_energy(&self, q: &Vector<N>) -> f64 {
        let angles = Angles::of(q);
        let mut energy = 0.0;
        for i in 0..N {
            energy -= self.b[i] * angles.cos[i];
        }
        energy
    }

    /// C(q, v) w + G(q), N·m.
    fn bias_array(&self, angles: &Angles<N>, v: &Vector<N>, w: &Vector<N>) -> [f64; N] {
        let mut bias = [0.0; N];
        for i in 0..N {
            let mut centrifugal = 0.0;
            for j in 0..N {
                centrifugal += self.a[(i, j)] * angles.sin_difference(i, j) * (v[j] * w[j]);
            }
            bias[i] = centrifugal + self.b[i] * angles.sin[i];
        }
        bias
    }

    fn mass_array(&self, angles: &Angles<N>) -> [[f64; N]; N] {
        let mut mass = [[0.0; N]; N];
        for i in 0..N {
            for j in 0..=i {
                mass[i][j] = self.a[(i, j)] * angles.cos_difference(i, j);
                mass[j][i] = mass[i][j];
            }
        }
        mass
    }
}

/// Torques u of the joint actuators (N·m) that act as the generalised torques τ: τ_i = u_i − u_{i+1}, so
/// u_i = Σ_{k≥i} τ_k.
#[must_use]
pub fn joint_torques<const N: usize>(tau: &Vector<N>) -> Vector<N> {
    let mut u = *tau;
    for i in (1..N).rev() {
        u[i - 1] += u[i];
    }
    u
}

/// Position (x, y) of the chain's tip relative to the hinge, m; y points up, so the chain at rest hangs at y < 0.
#[must_use]
pub fn tip_position<const N: usize>(length_m: &[f64; N], q: &Vector<N>) -> [f64; 2] {
    let angles = Angles::of(q);
    let mut tip = [0.0; 2];
    for i in 0..N {
        tip[0] += length_m[i] * angles.sin[i];
        tip[1] -= length_m[i] * angles.cos[i];
    }
    tip
}

/// Rounding error of a pivot, relative to its diagonal entry and a link.
const ROUNDING_PER_LINK: f64 = f64::EPSILON;

/// N as a floating point number, exact for N ≤ 7.
fn links_f64<const N: usize>() -> f64 {
    N as f64
}

fn check_links<const N: usize>(
    field: &'static str,
    values: &[f64; N],
    allowed: &'static str,
    accepts: impl Fn(f64) -> bool,
) -> Result<(), ChainError> {
    for (i, &value) in values.iter().enumerate() {
        if !(value.is_finite() && accepts(value)) {
            return Err(ChainError::Link { field, link: i + 1, value, allowed });
        }
    }
    Ok(())
}

fn check_symmetric<const N: usize>(a: &Matrix<N>) -> Result<(), ChainError> {
    for i in 0..N {
        for j in 0..i {
            #[expect(clippy::float_cmp, reason = "a small asymmetry is an input error too, not rounding of ours")]
            if a[(i, j)] != a[(j, i)] {
                let (value, mirror) = (a[(i, j)], a[(j, i)]);
                return Err(ChainError::NotSymmetric { row: i + 1, column: j + 1, value, mirror });
            }
        }
    }
    Ok(())
}

/// Sines and cosines of the link angles: the only transcendental functions of the model.
struct Angles<const N: usize> {
    sin: [f64; N],
    cos: [f64; N],
}

impl<const N: usize> Angles<N> {
    fn of(q: &Vector<N>) -> Self {
        let mut angles = Self { sin: [0.0; N], cos: [0.0; N] };
        for i in 0..N {
            (angles.sin[i], angles.cos[i]) = libm::sincos(q[i]);
        }
        angles
    }

    /// sin(q_i − q_j), exactly 0 for i = j.
    fn sin_difference(&self, i: usize, j: usize) -> f64 {
        self.sin[i] * self.cos[j] - self.cos[i] * self.sin[j]
    }

    /// cos(q_i − q_j), exactly 1 for i = j.
    fn cos_difference(&self, i: usize, j: usize) -> f64 {
        if i == j { 1.0 } else { self.cos[i] * self.cos[j] + self.sin[i] * self.sin[j] }
    }
}

#[cfg(test)]
mod tests;
