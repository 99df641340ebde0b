//! The contract of the loopbound processes: what they say to each other, and the mathematics they share.
//!
//! A process crate (`plant`, `controller`, `reference`, `monitor`) depends on this crate and on no other of the
//! workspace. Nothing here knows which process it runs in.

pub mod bound;
pub mod cast;
pub mod chain;
pub mod claim;
pub mod clock;
pub mod doorbell;
pub mod event;
pub mod fault;
pub mod group;
pub mod headline;
pub mod input;
pub mod integrator;
pub mod law;
pub mod layout;
pub mod ports;
pub mod quote;
pub mod realtime;
pub mod rng;
pub mod role;
pub mod run_id;
pub mod runaway;
pub mod sample;
pub mod say;
pub mod scenario;
pub mod setpoints;
pub mod system;
pub mod topics;
pub mod trajectory;
pub mod truth;
pub mod wakeup;
pub mod writers;
