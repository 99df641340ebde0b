//! When the transport is looked through for what the dead hold: it takes milliseconds, so not at every look.

/// How long after a death it is looked through at every look, and how often without one.
const AGAIN_NS: u64 = 200_000_000;
const EVERY_NS: u64 = 5_000_000_000;

/// When it was, and until when it is at every look.
#[derive(Debug)]
pub(super) struct Cleaning {
    done_ns: u64,
    until_ns: u64,
}

impl Cleaning {
    /// It was just done.
    pub(super) fn new(now_ns: u64) -> Self {
        Self { done_ns: now_ns, until_ns: 0 }
    }

    /// Whether to look through the transport now. A guest that was killed is noticed by its place in the control block, of which
    /// `freed` were freed at this look; its ports are free when the transport has noticed too, which may be a look or two later.
    pub(super) fn look(&mut self, now_ns: u64, freed: usize) -> bool {
        if freed > 0 {
            self.until_ns = now_ns + AGAIN_NS;
        }
        let due = now_ns < self.until_ns || now_ns >= self.done_ns + EVERY_NS;
        if due {
            self.done_ns = now_ns;
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_a_death_the_transport_is_looked_through_for_a_while_and_otherwise_seldom() {
        let mut cleaning = Cleaning::new(0);
        assert!(!cleaning.look(EVERY_NS - 1, 0));
        assert!(cleaning.look(EVERY_NS, 0));
        assert!(!cleaning.look(EVERY_NS + 1, 0));
        let death_ns = EVERY_NS + 10;
        assert!(cleaning.look(death_ns, 1) && cleaning.look(death_ns + AGAIN_NS - 1, 0));
        assert!(!cleaning.look(death_ns + AGAIN_NS, 0));
    }
}
