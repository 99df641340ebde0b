//! Units of what a certificate says. V is an energy for the laws that are certified on r; in `ctc` it is made of (√K_p e, ė) and has
//! the unit of a squared velocity, so its figures can't be compared with those of another law.

use crate::law::LawKind;

/// The units of one law's certificate, as they are printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Units {
    /// V, the level c, ε/α, and the slack of a promise.
    pub v: &'static str,
    /// ε, what V may rise by a second.
    pub epsilon: &'static str,
    /// Ψ, and what it may be: C1, or η0 in `ctc`.
    pub psi: &'static str,
    /// K_p of the law.
    pub k_p: &'static str,
    /// K_d of the law.
    pub k_d: &'static str,
}

impl Units {
    /// Those of a law.
    #[must_use]
    pub const fn of(law: LawKind) -> Self {
        match law {
            LawKind::Robust | LawKind::RobustFf | LawKind::PdG => {
                Self { v: "J", epsilon: "J/s", psi: "N·m", k_p: "N·m", k_d: "N·m·s" }
            }
            LawKind::Ctc => Self { v: "rad²/s²", epsilon: "rad²/s³", psi: "rad/s²", k_p: "1/s²", k_d: "1/s" },
        }
    }
}
