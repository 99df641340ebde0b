//! The launcher: starts a process group, supervises it, ends it in order, and reports.
//!
//! One executable is all there is to install: it starts itself in the roles of the group ([`commands::roles`]). The
//! launcher is never in the loop. It alone commands the plant and cleans up after the dead.

pub mod args;
pub mod commands;
pub mod exit;
pub mod inprocess;
pub mod progress;
pub mod signals;
pub mod supervise;
