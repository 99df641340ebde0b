//! Whether a control loop does what its certificate says, and what to do when none holds: the live check, coverage of the plant,
//! stability of the sampled loop, gains and remedies.
//!
//! Numbers in round brackets are the equations of Gupta et al., JESA 54(4), 2021; those in square brackets are derived
//! in `docs/model-and-bound.md`. This folder computes; who is told, and what is done about it, belongs to the monitor,
//! the plant and the launcher.
//!
//! | module | answers |
//! |---|---|
//! | [`coverage`] | whether a plant lies within what the certificate assumes of it |
//! | [`design`] | which gains prove the smallest error at a period and a latency |
//! | [`remedy`] | which changes would make a certificate hold |
//! | [`diagnose`] | whether an interval kept the bound, and if not what suffices as the cause |
//! | [`stability`] | the spectral radius of the sampled loop, with its limits of delay and period |

pub mod coverage;
pub mod design;
pub mod diagnose;
pub mod remedy;
pub mod stability;

#[cfg(test)]
mod attack;
#[cfg(test)]
mod paper;
