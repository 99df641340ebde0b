//! Real process groups: the executable itself, with all its processes, over real shared memory.
//!
//! Every test has a group name of its own, takes the one turn there is (two groups on two cores would disturb each
//! other), waits for nothing without an end, and leaves nothing behind: that is checked after every single one. No test
//! asserts how long anything took on the clock, which is the machine's affair.
#![allow(clippy::disallowed_macros, reason = "the harness keeps what a test prints")]

#[path = "../../examples/soak/barrage.rs"]
mod barrage;
mod fold;
mod harness;
mod input;
#[path = "../../examples/soak/remains.rs"]
mod remains;
mod untested;

mod attached;
mod deaths;
mod diverged;
mod earlier;
mod faults;
mod guests;
mod impostors;
mod keeper;
#[cfg(feature = "foxglove")]
mod live;
mod lockstep;
mod realtime;
mod recording;
mod remedies;
mod resources;
mod results;
mod scenario_faults;
mod signals;
mod stopped;
mod strangers;
mod streams;
mod studies;
mod swaps;
mod terminal;
mod usage;
mod users;
mod verdicts;
