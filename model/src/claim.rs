//! What a controller says of its law, and the one rule for when that is the law of the scenario.
//!
//! The plant's swap gate, the monitor and a replay ask here, so that none of them takes a certificate or a torque of the
//! scenario's for a controller that another one does not.

use crate::law::{Gain, Law, LawKind};

/// A built-in law that a controller claims to be, with its gains: only then is it certified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Claim {
    /// The law.
    pub law: LawKind,
    /// β, 1/s.
    pub beta: f64,
    /// K_t, N·m·s.
    pub k_t: f64,
    /// K_p: 1/s² in `ctc`, N·m in `pd+g`.
    pub k_p: f64,
    /// K_d: 1/s in `ctc`, N·m·s in `pd+g`.
    pub k_d: f64,
}

impl Claim {
    /// What a law is, as its controller would say it.
    #[must_use]
    pub fn of_law<const N: usize>(law: &Law<N>) -> Self {
        let Law { kind, beta, k_t, k_p, k_d, .. } = *law;
        Self { law: kind, beta, k_t, k_p, k_d }
    }

    /// Whether the two are one law: the same formula with the same gains, to the bit. A gain that the formula does not use makes no
    /// difference. The shares of K_t (K2, K3, C1), the level and the assumptions are the analyst's and not the law's, so whoever has
    /// the scenario's law has its certificate.
    #[must_use]
    pub fn is_same_law(&self, other: &Self) -> bool {
        let same = |gain| self.gain(gain).to_bits() == other.gain(gain).to_bits();
        self.law == other.law && self.law.gains().into_iter().all(same)
    }

    fn gain(&self, gain: Gain) -> f64 {
        match gain {
            Gain::Beta => self.beta,
            Gain::KTotal => self.k_t,
            Gain::KP => self.k_p,
            Gain::KD => self.k_d,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(law: LawKind) -> Claim {
        Claim { law, beta: 5.0, k_t: 100.0, k_p: 25.0, k_d: 10.0 }
    }

    #[test]
    fn every_gain_that_a_law_uses_has_to_be_equal_and_no_other() {
        // The least that a gain can differ by.
        let next = |gain: f64| f64::from_bits(gain.to_bits() + 1);
        let changed = |of: Claim| {
            [
                ("beta", Claim { beta: next(of.beta), ..of }),
                ("k_t", Claim { k_t: next(of.k_t), ..of }),
                ("k_p", Claim { k_p: next(of.k_p), ..of }),
                ("k_d", Claim { k_d: next(of.k_d), ..of }),
            ]
        };
        for law in LawKind::ALL {
            let used =
                if matches!(law, LawKind::Robust | LawKind::RobustFf) { ["beta", "k_t"] } else { ["k_p", "k_d"] };
            for (name, other) in changed(claim(law)) {
                assert_eq!(claim(law).is_same_law(&other), !used.contains(&name), "{law} {name}");
                assert_eq!(other.is_same_law(&claim(law)), !used.contains(&name), "{law} {name}");
            }
            assert!(LawKind::ALL.iter().all(|of| claim(law).is_same_law(&claim(*of)) == (*of == law)));
        }
    }
}
