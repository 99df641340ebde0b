//! Whether a plant lies within what a certificate assumes of it, line by line.
//!
//! A certificate speaks of every plant that the controller declares; which plant there really is it does not ask. A
//! scenario knows both sides. What depends on the state is asked on {V ≤ c} alone: what happens outside of it is not
//! certified anyway.

use core::fmt;

use crate::certificate::Certificate;
use crate::certificate::envelope::{Assumptions, generalised_eigen, symmetric_eigenvalues};
use crate::certificate::reach::Reach;
use crate::chain::{Chain, Matrix, Vector};
use crate::law::Law;
use crate::truth::Truth;

/// Relative room for rounding.
const ROUNDING: f64 = 1e-9;

/// What of the loop around a plant bears on its certificate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    /// h, s.
    pub period_s: f64,
    /// From the acceptance of a torque to its action, s.
    pub actuation_delay_s: f64,
    /// Speed of a joint at which the plant stops for good, rad/s; infinite: none.
    pub speed_limit_rad_s: f64,
}

/// Something of the plant that the certificate does not allow for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Gap {
    /// M, C or G differs from the controller's model by more than μ.
    Model {
        /// Largest relative difference of M and C.
        inertia: f64,
        /// Relative difference of |b|.
        weight: f64,
        /// μ.
        declared: f64,
    },
    /// The disturbance exceeds D.
    Disturbance {
        /// Bound of |d|, N·m.
        found_nm: f64,
        /// D, N·m.
        declared_nm: f64,
    },
    /// Friction, which the model does not have, leads beyond D.
    Friction {
        /// Bound of |f| on {V ≤ c}, N·m.
        found_nm: f64,
        /// D, N·m.
        declared_nm: f64,
        /// What the disturbance leaves of D, N·m.
        left_nm: f64,
    },
    /// The actuators deliver less than the law may ask for on {V ≤ c}.
    TorqueLimit {
        /// Which link, from 1.
        link: usize,
        /// What they deliver, N·m.
        limit_nm: f64,
        /// What may be asked, N·m.
        asked_nm: f64,
    },
    /// Joints may turn on {V ≤ c} as fast as stops the plant for good.
    SpeedLimit {
        /// What stops it, rad/s.
        limit_rad_s: f64,
        /// What is reached, rad/s.
        reached_rad_s: f64,
    },
    /// Torques act late by design, and later than is proven beforehand.
    ActuationDelay {
        /// The delay, s.
        delay_s: f64,
        /// The age of a torque, hold included, that is proven, s. \[12]
        proven_s: f64,
    },
    /// The law answers what sensors say, and they are not exact.
    Measurement {
        /// The first key of `plant.noise` that says so.
        key: &'static str,
        /// Its value, rad or rad/s.
        value: f64,
    },
}

impl fmt::Display for Gap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Model { inertia, weight, declared } => {
                let (inertia, weight, worst) = (Percent(inertia), Percent(weight), inertia.max(weight));
                let covers = Percent(declared);
                write!(
                    f,
                    "plant.mass_error, controller.model: the plant's inertia is {inertia} off the controller's model, its \
                     weight {weight}; controller.uncertainty.mass = {declared} covers {covers}"
                )?;
                if worst < 1.0 {
                    write!(f, ", it would have to be {:.4}", (worst * 1e4 - ROUNDING).ceil() * 1e-4)
                } else {
                    f.write_str(", and less than 1 is allowed")
                }
            }
            Self::Disturbance { found_nm, declared_nm } => write!(
                f,
                "plant.disturbance: up to {found_nm:.3} N·m; controller.uncertainty.disturbance_nm = {declared_nm} covers \
                 less"
            ),
            Self::Friction { found_nm, declared_nm, left_nm } => write!(
                f,
                "plant.friction: up to {found_nm:.3} N·m where V ≤ c; controller.uncertainty.disturbance_nm = {declared_nm} \
                 leaves {left_nm:.3} N·m for it"
            ),
            Self::TorqueLimit { link, limit_nm, asked_nm } => write!(
                f,
                "plant.torque_limit_nm: {limit_nm} N·m at link {link}; the law may ask for {asked_nm:.3} N·m where V ≤ c"
            ),
            Self::SpeedLimit { limit_rad_s, reached_rad_s } => write!(
                f,
                "plant.speed_limit: the plant stops at {limit_rad_s} rad/s; joints may turn at {reached_rad_s:.3} rad/s where \
                 V ≤ c"
            ),
            Self::ActuationDelay { delay_s, proven_s } => write!(
                f,
                "plant.actuation_delay: torques act {:.4} ms late, beside the hold of a period; an age of {:.4} ms in all is \
                 proven beforehand",
                delay_s * 1e3,
                proven_s * 1e3
            ),
            Self::Measurement { key, value } => {
                write!(f, "{key}: {value}; the law answers what is measured, the certificate assumes exact states")
            }
        }
    }
}

/// A relative difference for people.
struct Percent(f64);

impl fmt::Display for Percent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 > 100.0 { f.write_str("more than 10000 %") } else { write!(f, "{:.2} %", self.0 * 100.0) }
    }
}

/// What of `truth` the certificate of `law` does not cover.
///
/// Where nothing is certified, what depends on the certified level is left out.
#[must_use]
pub fn gaps<const N: usize>(
    truth: &Truth<N>,
    assumptions: &Assumptions<N>,
    law: &Law<N>,
    certificate: &Certificate,
    around: &Surroundings,
) -> Vec<Gap> {
    let mut found = Vec::new();
    let declared = assumptions.mass_mismatch;
    let (inertia, weight) = mismatch(&truth.chain, &assumptions.nominal);
    if inertia.max(weight) > declared + ROUNDING {
        found.push(Gap::Model { inertia, weight, declared });
    }
    let declared_nm = assumptions.disturbance_bound_nm;
    let disturbance_nm = truth.disturbance.sup_norm();
    if disturbance_nm > declared_nm * (1.0 + ROUNDING) {
        found.push(Gap::Disturbance { found_nm: disturbance_nm, declared_nm });
    }
    if certificate.is_certified() {
        on_the_level(truth, law, certificate, around, declared_nm, disturbance_nm, &mut found);
    }
    if around.actuation_delay_s > 0.0 {
        let (delay_s, proven_s) =
            (around.actuation_delay_s, law.kind.proven_age(certificate).map_or(0.0, |proven| proven.age_s));
        if delay_s + around.period_s > proven_s {
            found.push(Gap::ActuationDelay { delay_s, proven_s });
        }
    }
    let measured = [
        ("plant.noise.q_rad", truth.noise_q_rad),
        ("plant.noise.v_rad_s", truth.noise_v_rad_s),
        ("plant.noise.quantum_q_rad", truth.quant_q_rad),
        ("plant.noise.quantum_v_rad_s", truth.quant_v_rad_s),
    ];
    if let Some((key, value)) = measured.into_iter().find(|(_, value)| *value > 0.0) {
        found.push(Gap::Measurement { key, value });
    }
    found
}

/// What depends on how far the state gets on {V ≤ c}.
fn on_the_level<const N: usize>(
    truth: &Truth<N>,
    law: &Law<N>,
    certificate: &Certificate,
    around: &Surroundings,
    declared_nm: f64,
    disturbance_nm: f64,
    found: &mut Vec<Gap>,
) {
    let reach = Reach::of(&truth.chain, certificate);
    let friction_nm = friction(truth, certificate.envelope.v_2 + reach.e_dot);
    let left_nm = (declared_nm - disturbance_nm).max(0.0);
    if friction_nm > left_nm * (1.0 + ROUNDING) {
        found.push(Gap::Friction { found_nm: friction_nm, declared_nm, left_nm });
    }
    // The worst link is enough.
    let short = |link: &usize| law.torque_bound(certificate, &reach, *link) / truth.torque_limit_nm[*link];
    if let Some(link) = (0..N).max_by(|a, b| short(a).total_cmp(&short(b)))
        && short(&link) > 1.0 + ROUNDING
    {
        let (limit_nm, asked_nm) = (truth.torque_limit_nm[link], law.torque_bound(certificate, &reach, link));
        found.push(Gap::TorqueLimit { link: link + 1, limit_nm, asked_nm });
    }
    // A joint turns by the difference of two links, of which one alone may have all of |ė|, or both a share.
    let links = if N == 1 { 1.0 } else { 2.0 };
    let reached_rad_s = links * certificate.envelope.v_inf + links.sqrt() * reach.e_dot;
    if reached_rad_s > around.speed_limit_rad_s {
        found.push(Gap::SpeedLimit { limit_rad_s: around.speed_limit_rad_s, reached_rad_s });
    }
}

/// By how much, relative to the model, a chain differs in M and C, and in G: in just the norms that the proof uses of μ.
///
/// (1−μ) â ≤ a ≤ (1+μ) â carries over to M by Schur's product theorem, ‖|Δa| without its diagonal‖ ≤ μ ĉ to C.
fn mismatch<const N: usize>(chain: &Chain<N>, model: &Chain<N>) -> (f64, f64) {
    let off = |matrix: &Matrix<N>| {
        let off = Matrix::<N>::from_fn(|i, j| if i == j { 0.0 } else { matrix[(i, j)].abs() });
        symmetric_eigenvalues(&off).iter().fold(0.0f64, |most, x| most.max(x.abs()))
    };
    let (ratios, _) = generalised_eigen(model.a(), chain.a());
    let of_m = ratios.iter().fold(0.0f64, |most, ratio| most.max((ratio - 1.0).abs()));
    let relative = |part: f64, whole: f64| if part > 0.0 { part / whole } else { 0.0 };
    let of_c = relative(off(&(chain.a() - model.a())), off(model.a()));
    (of_m.max(of_c), relative((chain.b() - model.b()).norm(), model.b().norm()))
}

/// Largest |f| of the friction at velocities up to `speed` (rad/s), N·m. f = Jᵀu with the joints' velocities w = Jq̇.
fn friction<const N: usize>(truth: &Truth<N>, speed: f64) -> f64 {
    let next = |values: &[f64; N], i: usize| values.get(i + 1).copied().unwrap_or(0.0);
    let viscous = Matrix::<N>::from_fn(|i, j| match i.abs_diff(j) {
        0 => truth.viscous_nm_s[i] + next(&truth.viscous_nm_s, i),
        1 => -truth.viscous_nm_s[i.max(j)],
        _ => 0.0,
    });
    let viscous = symmetric_eigenvalues(&viscous).iter().copied().fold(0.0, f64::max);
    // Coulomb friction is at its largest where neighbouring joints turn against each other.
    let coulomb = Vector::<N>::from_fn(|i, _| truth.coulomb_nm[i] + next(&truth.coulomb_nm, i)).norm();
    viscous * speed + coulomb
}
