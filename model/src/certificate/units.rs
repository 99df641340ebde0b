//! Units of what a certificate says. V is an energy for the laws that are certified on r; in `ctc` it is made of (√K_p e, ė) and has
//! the unit of a squared velocity, so its figures can't be compared with those of another law.

/// The units of one law's certificate, as they are printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Units {
    /// V, the level c, ε/α, and the slack of a promise.
    pub v: &'static str,
    /// ε, what V may rise by a second.
    pub epsilon: &'static str,
    /// Ψ, and what it may be.
    pub psi: &'static str,
    /// The symbol of what Ψ may be.
    pub psi_allowed: &'static str,
    /// K_p of the law.
    pub k_p: &'static str,
    /// K_d of the law.
    pub k_d: &'static str,
}

impl Units {
    /// On r: V is an energy.
    pub const ON_R: Self = Self { v: "J", epsilon: "J/s", psi: "N·m", psi_allowed: "C1", k_p: "N·m", k_d: "N·m·s" };

    /// On y = (√K_p e, ė).
    pub const ON_Y: Self =
        Self { v: "rad²/s²", epsilon: "rad²/s³", psi: "rad/s²", psi_allowed: "η0", k_p: "1/s²", k_d: "1/s" };
}
