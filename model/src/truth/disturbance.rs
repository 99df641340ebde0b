//! Disturbance torques as pure functions of time, each with a proven bound D ≥ sup |d|.

use core::f64::consts::TAU;

use super::{TruthError, all_finite, not_negative};
use crate::chain::Vector;
use crate::rng::{Stream, uniform};

/// A disturbance torque d(t), N·m, on the generalised coordinates.
#[derive(Clone, Debug, PartialEq)]
pub enum Disturbance<const N: usize> {
    /// d = 0.
    None,
    /// The same at all times.
    Constant {
        /// d, N·m.
        value_nm: [f64; N],
    },
    /// d_i = A_i sin(ω_i t + φ_i).
    Sine {
        /// A_i, N·m.
        amplitude_nm: [f64; N],
        /// ω_i, rad/s.
        omega_rad_s: [f64; N],
        /// φ_i, rad.
        phase_rad: [f64; N],
    },
    /// 0 before an instant, a constant from it on.
    Step {
        /// The instant, s.
        at_s: f64,
        /// d from then on, N·m.
        value_nm: [f64; N],
    },
    /// Random torques within a band of frequencies.
    Noise(BandNoise<N>),
    /// Several at once.
    Sum(Vec<Disturbance<N>>),
}

/// How many sinusoids make the noise: enough for an almost normal distribution (kurtosis 3 − 3/32).
const WAVES: usize = 16;

/// Band-limited noise: a sum of 16 sinusoids, one in each sixteenth of the band at a random frequency, with random
/// phases for each link. A sum of sinusoids is bounded and smooth, and can be evaluated at any instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BandNoise<const N: usize> {
    /// Amplitude of each of the sinusoids, N·m.
    wave_nm: [f64; N],
    omega_rad_s: [f64; WAVES],
    /// Sine and cosine of the phase of each wave in each link.
    phase: [[(f64, f64); WAVES]; N],
}

impl<const N: usize> Disturbance<N> {
    /// d(t), N·m. Allocates nothing.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Vector<N> {
        match self {
            Self::None => Vector::zeros(),
            Self::Constant { value_nm } => Vector::from(*value_nm),
            Self::Sine { amplitude_nm, omega_rad_s, phase_rad } => {
                Vector::from_fn(|i, _| amplitude_nm[i] * libm::sin(omega_rad_s[i] * t_s + phase_rad[i]))
            }
            Self::Step { at_s, value_nm } if t_s >= *at_s => Vector::from(*value_nm),
            Self::Step { .. } => Vector::zeros(),
            Self::Noise(noise) => noise.at(t_s),
            Self::Sum(parts) => parts.iter().fold(Vector::zeros(), |sum, part| sum + part.at(t_s)),
        }
    }

    /// D ≥ sup_t |d(t)|, N·m, attained by all but sines of different frequencies, noise and sums.
    #[must_use]
    pub fn sup_norm(&self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Constant { value_nm } | Self::Step { value_nm, .. } => Vector::from(*value_nm).norm(),
            Self::Sine { amplitude_nm, .. } => Vector::from(*amplitude_nm).norm(),
            Self::Noise(noise) => noise.sup_norm(),
            Self::Sum(parts) => parts.iter().map(Self::sup_norm).sum(),
        }
    }

    /// Checks that every number is finite.
    ///
    /// # Errors
    /// Names the parameter, the value found and what is allowed.
    pub fn validate(&self) -> Result<(), TruthError> {
        match self {
            Self::None => Ok(()),
            Self::Constant { value_nm } => all_finite("value_nm", value_nm),
            Self::Sine { amplitude_nm, omega_rad_s, phase_rad } => {
                all_finite("amplitude_nm", amplitude_nm)?;
                all_finite("omega_rad_s", omega_rad_s)?;
                all_finite("phase_rad", phase_rad)
            }
            Self::Step { at_s, value_nm } => {
                all_finite("at_s", &[*at_s])?;
                all_finite("value_nm", value_nm)
            }
            // Checked when it was built.
            Self::Noise(_) => Ok(()),
            Self::Sum(parts) => parts.iter().try_for_each(Self::validate),
        }
    }
}

impl<const N: usize> BandNoise<N> {
    /// Noise with the given root mean square of each link, N·m, in the band `low_hz`..`high_hz`. Noises of one run
    /// that are to be independent need different `index`es.
    ///
    /// # Errors
    /// A value that is negative or not finite, or an empty band.
    pub fn with_rms(rms_nm: [f64; N], low_hz: f64, high_hz: f64, seed: u64, index: u64) -> Result<Self, TruthError> {
        not_negative("rms_nm", &rms_nm)?;
        // A sinusoid of amplitude A has the mean square A²/2, and those of different frequencies add.
        let wave_nm = rms_nm.map(|rms| rms * (2.0 / WAVES as f64).sqrt());
        Self::with_waves(wave_nm, low_hz, high_hz, seed, index)
    }

    /// As `with_rms`, but with |d_i| ≤ `bound_nm[i]` at all times; the root mean square is then bound/√32.
    ///
    /// # Errors
    /// A value that is negative or not finite, or an empty band.
    pub fn with_bound(
        bound_nm: [f64; N],
        low_hz: f64,
        high_hz: f64,
        seed: u64,
        index: u64,
    ) -> Result<Self, TruthError> {
        not_negative("bound_nm", &bound_nm)?;
        Self::with_waves(bound_nm.map(|bound| bound / WAVES as f64), low_hz, high_hz, seed, index)
    }

    fn with_waves(wave_nm: [f64; N], low_hz: f64, high_hz: f64, seed: u64, index: u64) -> Result<Self, TruthError> {
        not_negative("low_hz", &[low_hz])?;
        not_negative("high_hz", &[high_hz])?;
        if high_hz <= low_hz {
            return Err(TruthError { field: "high_hz", value: high_hz, allowed: "a number > low_hz" });
        }
        let width_hz = (high_hz - low_hz) / WAVES as f64;
        // Lane 0 of each wave draws its frequency, the lanes from 1 the phases of the links.
        let draw = |wave: usize, lane: u32| uniform(seed, Stream::Disturbance, index, 8 * lane_of(wave) + lane);
        let mut omega_rad_s = [0.0; WAVES];
        let mut phase = [[(0.0, 1.0); WAVES]; N];
        for wave in 0..WAVES {
            omega_rad_s[wave] = TAU * (low_hz + width_hz * (wave as f64 + draw(wave, 0)));
            for (lane, link) in (1..).zip(&mut phase) {
                link[wave] = libm::sincos(TAU * draw(wave, lane));
            }
        }
        Ok(Self { wave_nm, omega_rad_s, phase })
    }

    /// d(t), N·m.
    #[must_use]
    pub fn at(&self, t_s: f64) -> Vector<N> {
        let mut sum = Vector::zeros();
        for wave in 0..WAVES {
            // sin(ωt + φ) by the sum formula: one sine and cosine a wave, whatever the number of links.
            let (sin, cos) = libm::sincos(self.omega_rad_s[wave] * t_s);
            for link in 0..N {
                let (phase_sin, phase_cos) = self.phase[link][wave];
                sum[link] += self.wave_nm[link] * (sin * phase_cos + cos * phase_sin);
            }
        }
        sum
    }

    /// D ≥ sup |d|, N·m: all sinusoids at their crest.
    #[must_use]
    pub fn sup_norm(&self) -> f64 {
        Vector::from(self.wave_nm).norm() * WAVES as f64
    }
}

/// A wave's number as part of a lane.
#[expect(clippy::cast_possible_truncation, reason = "there are 16 waves")]
fn lane_of(wave: usize) -> u32 {
    wave as u32
}
