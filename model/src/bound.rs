//! What a control loop is certified to do, and whether it does: Lyapunov certificates, the live check, stability of
//! the sampled loop.
//!
//! Numbers in round brackets are the equations of Gupta et al., JESA 54(4), 2021; those in square brackets are derived
//! in `docs/model-and-bound.md`. This folder computes; who is told, and what is done about it, belongs to the monitor,
//! the plant and the launcher.
//!
//! | module | answers |
//! |---|---|
//! | [`envelope`] | what is assumed about the plant, the disturbance and the reference |
//! | [`certificate`] | which V̇ ≤ −… + ε follows from it, with which gains, and what is missing when none does |
//! | [`coverage`] | whether a plant lies within what the certificate assumes of it |
//! | [`design`] | which gains prove the smallest error at a period and a latency |
//! | [`remedy`] | what a certificate lacks, and which changes would make it hold |
//! | [`lyapunov`] | V, its promised rate, the observed Ψ, and which blends of laws a certificate covers |
//! | [`diagnose`] | whether an interval kept the promise, and if not whose fault it was |
//! | [`stability`] | how late a torque may be: \[11], \[12], \[13] and the spectral radius of the sampled loop |
//! | [`units`] | in which units all that is given |

pub mod certificate;
pub mod coverage;
pub mod design;
pub mod diagnose;
pub mod envelope;
pub mod lyapunov;
pub mod remedy;
pub mod stability;
pub mod units;

#[cfg(test)]
mod attack;
#[cfg(test)]
mod paper;
#[cfg(test)]
mod testing;
