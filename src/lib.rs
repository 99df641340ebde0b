//! x

pub mod doctor;
