//! The subcommands, one file or folder each: what it reads from the command line, what it does, and what it says.

pub mod bound;
pub mod check;
pub mod clean;
pub mod compare;
mod conclusion;
pub mod doctor;
pub mod fault;
pub mod model;
pub mod monitor;
pub mod options;
pub mod pages;
pub mod ps;
pub mod replay;
pub mod report;
pub mod roles;
pub mod run;
pub mod scenario;
pub mod study;
pub mod swap;
