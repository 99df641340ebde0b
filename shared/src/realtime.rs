//! What a process asks of the kernel to keep its deadlines, what it was given, and what the kernel did to it.
//!
//! Responsible for the start-up of a real-time process, for the evidence behind late ticks, and for the handles by
//! which the supervisor watches processes. Not responsible for cycles and deadlines: those belong to the loops.
//! Every step is optional, and a refusal is reported rather than fatal. Raw system calls stand in `system` alone.

mod evidence;
mod privileges;

pub use evidence::{Evidence, MISSING_SCHEDSTAT, MISSING_USAGE};
pub use privileges::{CORE_NONE, Outcome, Privileges, STEPS, Step};
