//! The contract of the loopbound processes: what they say to each other, how they wait, and what they ask of the kernel.
//!
//! A process crate (`plant`, `controller`, `reference`, `monitor`) depends on this crate, on what it stands on, and on no other
//! process. Nothing here may ever know which process it runs in.

mod alarm;
pub mod clock;
pub mod counters;
pub mod doorbell;
pub mod event;
pub mod fault;
pub mod group;
pub mod headline;
pub mod layout;
pub mod opening;
pub mod ports;
pub mod realtime;
pub mod role;
pub mod run_id;
pub mod runaway;
pub mod sample;
pub mod say;
pub mod setpoints;
pub mod spawn;
pub mod topics;
pub mod wakeup;
pub mod writers;
