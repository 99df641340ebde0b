//! Random numbers as functions of (seed, stream, tick, lane): no state, so any process can recompute any of them.
//!
//! A generator with a state would make a run depend on the order in which its processes draw. Here a counter is
//! enciphered: Philox 4×32 with 10 rounds (Salmon et al., *Parallel Random Numbers: As Easy as 1, 2, 3*, 2011), which
//! passes the statistical tests in use and takes some 10 ns. Not for secrets.

use core::f64::consts::TAU;

/// What a random number is for. Numbers of different streams are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Stream {
    /// Noise of the measured angles.
    MeasuredAngle = 1,
    /// Noise of the measured velocities.
    MeasuredVelocity = 2,
    /// Frequencies and phases of a random disturbance.
    Disturbance = 3,
    /// Injected faults: when they strike.
    Fault = 4,
    /// States and parameters drawn by tests and searches.
    Test = 5,
}

/// A number in [0, 1), a multiple of 2⁻⁵³.
#[must_use]
pub fn uniform(seed: u64, stream: Stream, tick: u64, lane: u32) -> f64 {
    to_unit_interval(bits(seed, stream, tick, lane)[0])
}

/// A standard normal number (mean 0, variance 1), by Box and Muller's transform.
#[must_use]
pub fn standard_normal(seed: u64, stream: Stream, tick: u64, lane: u32) -> f64 {
    let [first, second] = bits(seed, stream, tick, lane);
    // 1 − u lies in (0, 1], so the logarithm is finite.
    let radius = (-2.0 * libm::log(1.0 - to_unit_interval(first))).sqrt();
    radius * libm::cos(TAU * to_unit_interval(second))
}

/// 128 random bits.
#[must_use]
pub fn bits(seed: u64, stream: Stream, tick: u64, lane: u32) -> [u64; 2] {
    let [tick_low, tick_high] = halves(tick);
    let [w0, w1, w2, w3] = philox_4x32_10([tick_low, tick_high, lane, stream as u32], halves(seed));
    [u64::from(w0) | u64::from(w1) << 32, u64::from(w2) | u64::from(w3) << 32]
}

/// The 53 upper bits as a fraction.
fn to_unit_interval(bits: u64) -> f64 {
    const TWO_TO_MINUS_53: f64 = 1.0 / (1u64 << 53) as f64;
    (bits >> 11) as f64 * TWO_TO_MINUS_53
}

/// Lower and upper 32 bits.
#[expect(clippy::cast_possible_truncation, reason = "the halves of a word are what is asked for")]
fn halves(word: u64) -> [u32; 2] {
    [word as u32, (word >> 32) as u32]
}

fn philox_4x32_10(counter: [u32; 4], key: [u32; 2]) -> [u32; 4] {
    let ([mut c0, mut c1, mut c2, mut c3], [mut k0, mut k1]) = (counter, key);
    for _ in 0..10 {
        let [low0, high0] = halves(0xD251_1F53 * u64::from(c0));
        let [low1, high1] = halves(0xCD9E_8D57 * u64::from(c2));
        [c0, c1, c2, c3] = [high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0];
        k0 = k0.wrapping_add(0x9E37_79B9);
        k1 = k1.wrapping_add(0xBB67_AE85);
    }
    [c0, c1, c2, c3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cipher_gives_the_published_known_answers() {
        // The kat_vectors file of the authors' Random123 library.
        let answers = [
            ([0; 4], [0; 2], [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]),
            ([u32::MAX; 4], [u32::MAX; 2], [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]),
            (
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0],
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ];
        for (counter, key, answer) in answers {
            assert_eq!(philox_4x32_10(counter, key), answer);
        }
    }

    #[test]
    fn normal_numbers_have_the_moments_of_the_normal_distribution() {
        let count = 200_000u64;
        let mut moments = [0.0; 4];
        for tick in 0..count {
            let x = standard_normal(7, Stream::Test, tick, 0);
            for (power, moment) in moments.iter_mut().enumerate() {
                *moment += libm::pow(x, power as f64 + 1.0) / count as f64;
            }
        }
        // Standard deviations of the sample moments: sqrt(1, 2, 15, 96 / count); five of them are allowed.
        for (moment, (expected, variance)) in moments.iter().zip([(0.0, 1.0), (1.0, 2.0), (0.0, 15.0), (3.0, 96.0)]) {
            let allowed = 5.0 * (variance / count as f64).sqrt();
            assert!((moment - expected).abs() < allowed, "{moment} instead of {expected} ± {allowed}");
        }
    }

    #[test]
    fn every_coordinate_of_the_counter_changes_the_number() {
        let base = bits(1, Stream::Test, 2, 3);
        assert_ne!(base, bits(2, Stream::Test, 2, 3));
        assert_ne!(base, bits(1 | 1 << 40, Stream::Test, 2, 3));
        assert_ne!(base, bits(1, Stream::Fault, 2, 3));
        assert_ne!(base, bits(1, Stream::Test, 2 | 1 << 40, 3));
        assert_ne!(base, bits(1, Stream::Test, 2, 4));
        assert_eq!(base, bits(1, Stream::Test, 2, 3));
    }
}
