//! The identity of one run: what it writes and what its processes say carries it, so that two runs are never mixed.
//!
//! It identifies and is no result: comparisons of results leave it out by name.

use std::fmt;
use std::str::FromStr;

use rustix::rand::{GetRandomFlags, getrandom};

/// The identity of one run: 64 random bits, never 0. Written as 16 hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RunId(u64);

/// A text that is no run id.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a run id has 16 hexadecimal digits and is not 0")]
pub struct RunIdError;

impl RunId {
    /// The id of what runs within one process, where nobody could be mistaken for somebody else.
    pub const IN_PROCESS: Self = Self(u64::MAX);

    /// Draws a new one from the kernel's random numbers; from clock and process id where those are not to be had.
    #[must_use]
    pub fn draw() -> Self {
        let mut bytes = [0; 8];
        let drawn = getrandom(&mut bytes, GetRandomFlags::NONBLOCK).is_ok_and(|n| n == bytes.len());
        let substitute = crate::clock::now_ns().rotate_left(24) ^ u64::from(std::process::id());
        let bits = if drawn { u64::from_ne_bytes(bytes) } else { substitute };
        Self(bits.max(1))
    }

    /// The id behind the bits that a sample carries; none for 0.
    #[must_use]
    pub const fn from_bits(bits: u64) -> Option<Self> {
        if bits == 0 { None } else { Some(Self(bits)) }
    }

    /// The bits that a sample carries; never 0.
    #[must_use]
    pub const fn bits(self) -> u64 {
        self.0
    }
}

impl fmt::Display for RunId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

impl FromStr for RunId {
    type Err = RunIdError;

    fn from_str(text: &str) -> Result<Self, RunIdError> {
        let hexadecimal = text.len() == 16 && text.bytes().all(|c| c.is_ascii_hexdigit());
        let bits = if hexadecimal { u64::from_str_radix(text, 16).ok() } else { None };
        bits.and_then(Self::from_bits).ok_or(RunIdError)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_survives_being_written_and_two_draws_differ() {
        let id = RunId::draw();
        assert_eq!(id.to_string().parse(), Ok(id));
        assert_eq!(RunId::from_bits(id.bits()), Some(id));
        assert_ne!(RunId::draw(), id);
    }

    #[test]
    fn what_is_no_id_is_refused() {
        for text in ["", "0000000000000000", "12", "+123456789abcdef", "0123456789abcdefg", "0x23456789abcdef"] {
            assert_eq!(text.parse::<RunId>(), Err(RunIdError), "{text}");
        }
    }
}
