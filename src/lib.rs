//! The launcher: starts a process group, supervises it, ends it in order, and reports.
//!
//! One executable is all there is to install: it starts itself in the roles of the group (`roles`). The launcher is
//! never in the loop. It alone commands the plant and cleans up after the dead.

pub mod background;
pub mod bound;
pub mod check;
pub mod clean;
pub mod cli;
pub mod compare;
mod conclusion;
pub mod doctor;
pub mod exit;
pub mod fault;
pub mod guests;
pub mod inprocess;
pub mod keeper;
pub mod model;
pub mod needs;
pub mod pages;
pub mod prepare;
pub mod processes;
pub mod progress;
pub mod ps;
pub mod replay;
pub mod report;
pub mod results;
pub mod roles;
pub mod run;
pub mod signals;
pub mod study;
pub mod supervise;
pub mod swap;
