//! The contract of the loopbound processes: what they say to each other, and the mathematics they share.
//!
//! A process crate (`plant`, `controller`, `reference`, `monitor`) depends on this crate and on no other of the
//! workspace. Nothing here knows which process it runs in.

pub mod bound;
pub mod chain;
pub mod fault;
pub mod integrator;
pub mod law;
pub mod realtime;
pub mod rng;
pub mod scenario;
pub mod trajectory;
pub mod truth;
