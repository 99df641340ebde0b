//! Certificates: the differential inequality V̇ ≤ −… + ε that a law with given gains is proven to keep.
//!
//! What every certificate has in common, and the two forms of V. Which form a law takes, and what its proof puts into it,
//! stands in the law's own file; no module of this folder knows a law.
//!
//! | module | answers |
//! |---|---|
//! | [`envelope`] | what is assumed about the plant, the disturbance and the reference |
//! | [`on_r`] | the proof in r that all laws but `ctc` share, as far as they share it |
//! | [`start`] | V(0), whatever V turns out to be |
//! | [`requirement`] | what a certificate needs in order to hold, and what it lacks |
//! | [`lyapunov`] | V, its certified rate and the observed Ψ at one state |
//! | [`reach`] | how far the error and the torques get on {V ≤ c} |
//! | [`sampling`], [`boundary`] | how late a torque may be \[11], \[14], and how long it may be held \[13] |
//! | [`search`] | gains and declarations, tried by certifying them |
//! | [`units`] | in which units all that is given |

pub mod boundary;
pub mod envelope;
pub mod lyapunov;
pub mod on_r;
pub mod reach;
pub mod requirement;
pub mod sampling;
pub mod search;
pub mod start;
pub mod units;

use self::envelope::Envelope;

/// Gains of a law, and how its certificate is to account for them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// β of r = ė + β e, 1/s. Not used by `ctc`; in `pd+g` see `analyst_beta`.
    pub beta: f64,
    /// K2, N·m·s: the share of the gain that makes V fall. In `pd+g` see `analyst_k2`.
    pub k2: f64,
    /// K3, 1/(N·m·rad/s): ε = 1/(4 K3).
    pub k3: f64,
    /// C1, N·m; absent: as much as \[6] requires.
    pub c1: Option<f64>,
    /// c, the certified level of V.
    pub level: f64,
    /// K_p: 1/s² in `ctc`, N·m in `pd+g`.
    pub k_p: f64,
    /// K_d: 1/s in `ctc`, N·m·s in `pd+g`.
    pub k_d: f64,
    /// K_t given directly; what remains of it after κ and K3 C1² is then K2, which may be smaller or larger than `k2`.
    pub k_t: Option<f64>,
    /// β of the certificate of `pd+g`: it is the analyst's, not the law's; absent: searched for.
    pub analyst_beta: Option<f64>,
    /// K2 of the certificate of `pd+g`; absent: searched for.
    pub analyst_k2: Option<f64>,
    /// Give `robust-ff` p = β² m̄, the V of `robust`, so that blends of the two are covered; otherwise p = β K2.
    pub shared_v: bool,
}

/// What a certificate says of V, whatever the law: on {V ≤ c}, V̇ ≤ −`s_rate`·|s|² − `e_rate`·|e|² + ε, where s is r, or ė in a
/// certificate on y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certificate {
    /// What is assumed.
    pub envelope: Envelope,
    /// Whether every requirement is met.
    pub certified: bool,
    /// c, the certified level of V.
    pub level: f64,
    /// Upper bound of V(0); 0 when no start was given.
    pub v_start: f64,
    /// Coefficient of |s|² in the certified rate of V.
    pub s_rate: f64,
    /// Coefficient of |e|² in it.
    pub e_rate: f64,
    /// ε, in units of V a second. \[8]
    pub epsilon: f64,
    /// α, 1/s.
    pub alpha: f64,
    /// ‖W‖ with W = (e, s): outside of this radius V falls. (20)
    pub w_norm: f64,
    /// limsup ‖e‖ over all links, rad. \[9]
    pub ultimate_e: f64,
    /// limsup ‖s‖ over all links, rad/s. \[9]
    pub ultimate_s: f64,
    /// Rate a of the fastest mode of the loop, 1/s: ṡ = −a s, in the worst configuration (links aligned). None for a law
    /// that has no mode which is much faster than the chain itself, so that no single rate describes it.
    pub fast_rate: Option<f64>,
    /// V, and what its proof rests on.
    pub form: Form,
}

/// The two forms of V.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Form {
    /// ½ rᵀMr + ½ p|e|²: an energy. \[4]
    OnR(OnR),
    /// ½ yᵀ([[1+2ζ², ζ],[ζ, 1]] ⊗ 1) y with y = (√K_p e, ė).
    OnY(OnY),
}

/// The numbers of a certificate on r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnR {
    /// β, 1/s.
    pub beta: f64,
    /// p of V, N·m/rad.
    pub p: f64,
    /// K2, N·m·s.
    pub k2: f64,
    /// K3, 1/(N·m·rad/s).
    pub k3: f64,
    /// C1, N·m.
    pub c1: f64,
    /// What C1 must cover at least, N·m. \[6]
    pub c1_required: f64,
    /// δ of the cross term |e||r|. \[7]
    pub delta: f64,
    /// κ, N·m·s. \[7]
    pub kappa: f64,
    /// K_t = K2 + κ + K3 C1², N·m·s; K_d in `pd+g`.
    pub k_t: f64,
    /// w = v_∞ + β ē, rad/s.
    pub w: f64,
    /// x = v_∞ + v_2 + β ē, rad/s.
    pub x: f64,
    /// ē, the largest |e| on {V ≤ c}, rad.
    pub e_bar: f64,
    /// What C1 must cover when no law answers and a torque is just held, N·m. \[13]
    pub c1_held: f64,
    /// δ when a torque is held. \[13]
    pub delta_held: f64,
}

/// The numbers of a certificate on y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnY {
    /// K_p, 1/s².
    pub k_p: f64,
    /// K_d, 1/s.
    pub k_d: f64,
    /// k = ½K_d − σ η1, 1/s.
    pub k: f64,
    /// η0 of |η| ≤ η0 + η1 |y|, rad/s².
    pub eta0: f64,
    /// η1.
    pub eta1: f64,
}

impl Certificate {
    /// Whether every requirement is met.
    #[must_use]
    pub fn is_certified(&self) -> bool {
        self.certified
    }

    /// ε/α: where V settles at most.
    #[must_use]
    pub fn v_ultimate(&self) -> f64 {
        if self.alpha > 0.0 { self.epsilon / self.alpha } else { f64::INFINITY }
    }

    /// limsup |e_i| of each link, rad. V weighs the links' errors alike, so within {V ≤ v} one link alone may have all of ‖e‖: the
    /// bound of the norm is the bound of each link, and no better one follows from V.
    #[must_use]
    pub fn ultimate_e_link(&self) -> f64 {
        self.ultimate_e
    }

    /// The numbers of a certificate on r; none for one on y.
    #[must_use]
    pub fn on_r(&self) -> Option<&OnR> {
        match &self.form {
            Form::OnR(on_r) => Some(on_r),
            Form::OnY(_) => None,
        }
    }

    /// K_t, N·m·s; 0 where the law has none.
    #[must_use]
    pub fn k_t(&self) -> f64 {
        self.on_r().map_or(0.0, |on_r| on_r.k_t)
    }

    /// What C1 must cover at least, N·m; 0 where there is no C1.
    #[must_use]
    pub fn c1_required(&self) -> f64 {
        self.on_r().map_or(0.0, |on_r| on_r.c1_required)
    }
}
