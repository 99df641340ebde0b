//! The mathematics of loopbound: the chain and the true plant, references, control laws, certificates, and the live check.
//!
//! Pure functions of their arguments, the same to the bit on every machine. Nothing here may ever know a clock, the
//! operating system, a file, the transport, a scenario, or which process it runs in.

pub mod bound;
pub mod certificate;
pub mod chain;
pub mod claim;
pub mod input;
pub mod integrator;
pub mod law;
pub mod quote;
pub mod rng;
#[cfg(test)]
mod testing;
pub mod trajectory;
pub mod truth;

/// Calls a function that is generic over the number of links with the scenario's number.
#[macro_export]
macro_rules! with_links {
    ($links:expr, $function:ident :: <N> ( $($argument:expr),* $(,)? )) => {
        match $links {
            1 => $function::<1>($($argument),*),
            2 => $function::<2>($($argument),*),
            3 => $function::<3>($($argument),*),
            4 => $function::<4>($($argument),*),
            5 => $function::<5>($($argument),*),
            6 => $function::<6>($($argument),*),
            7 => $function::<7>($($argument),*),
            other => unreachable!("a scenario has 1 to 7 links, not {other}: checked when it is read"),
        }
    };
}
