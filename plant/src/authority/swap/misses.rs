//! Which of the last ticks had no torque on time: one bit a tick, as many as the rule of misses may look at.

use loopbound_scenario::ROLLBACK_WINDOW_MAX;

const WORDS: usize = (ROLLBACK_WINDOW_MAX as usize).div_ceil(64);

/// The last ticks, the newest in the lowest bit of the first word.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Misses([u64; WORDS]);

impl Misses {
    /// Adds a tick, and forgets all beyond the last `window`.
    pub(super) fn push(&mut self, missed: bool, window: u32) {
        let mut carry = u64::from(missed);
        for (word, kept) in self.0.iter_mut().zip((0..).map(|word: u32| window.saturating_sub(64 * word))) {
            let next = *word >> 63;
            *word = *word << 1 | carry;
            if kept < 64 {
                *word &= (1 << kept) - 1;
            }
            carry = next;
        }
    }

    /// How many there are.
    pub(super) fn count(&self) -> u32 {
        self.0.iter().map(|word| word.count_ones()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_window_forgets_exactly_what_is_older() {
        for window in [1, 2, 63, 64, 65, 127, 128, 129, 500, 1023, 1024] {
            let mut misses = Misses::default();
            let pattern = |tick: u32| tick.is_multiple_of(3) || tick % 7 == 2;
            for tick in 0..3000 {
                misses.push(pattern(tick), window);
                let expected = (tick.saturating_sub(window - 1)..=tick).filter(|tick| pattern(*tick)).count();
                assert_eq!(misses.count() as usize, expected, "tick {tick}, window {window}");
            }
        }
    }
}
