//! What a control law sees, and the errors that follow from it.

use crate::chain::Vector;

/// What a law sees: a measured state and the setpoint at the same instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LawInput<const N: usize> {
    /// Measured angles, rad.
    pub q: Vector<N>,
    /// Measured velocities, rad/s.
    pub v: Vector<N>,
    /// Desired angles, rad.
    pub q_d: Vector<N>,
    /// Desired velocities, rad/s.
    pub v_d: Vector<N>,
    /// Desired accelerations, rad/s².
    pub a_d: Vector<N>,
}

impl<const N: usize> LawInput<N> {
    /// e = q_d − q, rad.
    #[must_use]
    pub fn e(&self) -> Vector<N> {
        self.q_d - self.q
    }

    /// ė = q̇_d − q̇, rad/s.
    #[must_use]
    pub fn e_dot(&self) -> Vector<N> {
        self.v_d - self.v
    }

    /// r = ė + β e, rad/s. (6)
    #[must_use]
    pub fn r(&self, beta: f64) -> Vector<N> {
        self.e_dot() + self.e() * beta
    }
}
