//! The spectral radius of the sampled, delayed, linearised loop of any law, exactly discretised, and the limits of delay
//! and period that follow from it.
//!
//! With d = (j + f) h the state of the loop is (q, q̇) and the j + 1 torques under way; its eigenvalues are the roots of
//! an N × N determinant (`modal`), and roots outside of a circle are counted without computing any
//! (`circle`). So the cost hardly depends on the length of the delay, or on the rate.

use core::f64::consts::PI;

use nalgebra::Complex;

use crate::chain::{Chain, Vector};
use crate::law::Law;
use crate::rng::{self, Stream};

use super::circle::walk;
use super::modal::{Modal, Sampled};

/// Roots this near to a circle, relative to its radius, are as good as on it.
const ROUNDING: f64 = 1e-11;
/// Periods that are added to a delay, and lengths of a period, in search of a limit.
const SEARCHED: f64 = 1e5;

/// The linearised loop over the configurations that count: all links down, all up (aligned links are the worst for the
/// fast mode), and some that are drawn once and for all.
#[derive(Clone, Debug)]
pub struct SampledLoop<const N: usize> {
    configurations: Vec<Modal<N>>,
}

/// How far a delay or a period may grow before the loop is unstable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// It separates stable from unstable, s.
    At(f64),
    /// The loop is stable at every value that was tried, up to this one, s.
    Beyond(f64),
}

impl Limit {
    /// The limit, or the largest value tried, s.
    #[must_use]
    pub const fn seconds(self) -> f64 {
        match self {
            Self::At(limit_s) | Self::Beyond(limit_s) => limit_s,
        }
    }
}

impl<const N: usize> SampledLoop<N> {
    /// The loop of `law` with the chain `plant`; `drawn` configurations beside the two aligned ones.
    #[must_use]
    pub fn new(law: &Law<N>, plant: &Chain<N>, drawn: u32) -> Self {
        let aligned = [Vector::<N>::zeros(), Vector::<N>::repeat(PI)];
        let drawn = (0..drawn).map(|sample| {
            let mut lane = 0;
            Vector::<N>::from_fn(|_, _| {
                lane += 1;
                PI * (2.0 * rng::uniform(1, Stream::Test, u64::from(sample), lane) - 1.0)
            })
        });
        Self { configurations: aligned.into_iter().chain(drawn).map(|q| Modal::new(law, plant, &q)).collect() }
    }

    /// The largest spectral radius. Below 1 the loop is stable everywhere.
    #[must_use]
    pub fn worst_radius(&self, period_s: f64, delay_s: f64) -> f64 {
        // A radius that is not above the worst so far is not computed.
        self.configurations.iter().fold(0.0, |worst, modal| larger_radius(&modal.sampled(period_s, delay_s), worst))
    }

    /// Whether all roots lie within the unit circle, in every configuration.
    #[must_use]
    pub fn is_stable(&self, period_s: f64, delay_s: f64) -> bool {
        self.configurations.iter().all(|modal| is_stable(modal, period_s, delay_s))
    }

    /// What may be added to the delay before the loop is unstable, s; 0 when it is.
    #[must_use]
    pub fn delay_margin(&self, period_s: f64, delay_s: f64) -> Limit {
        let searched = SEARCHED * period_s;
        match self
            .first_loss(0.0, searched, period_s / 2.0, |modal, added_s| is_stable(modal, period_s, delay_s + added_s))
        {
            Some(limit_s) => Limit::At(limit_s),
            None => Limit::Beyond(searched),
        }
    }

    /// The period that separates stable from unstable at this delay, sought from `period_s` on: upwards when the loop is
    /// stable there, downwards when it is not. None when not even very short periods are stable.
    #[must_use]
    pub fn longest_period(&self, period_s: f64, delay_s: f64) -> Option<Limit> {
        if self.is_stable(period_s, delay_s) {
            let searched = SEARCHED * period_s;
            let found = self.first_loss(period_s, searched, period_s / 16.0, |modal, h| is_stable(modal, h, delay_s));
            return Some(found.map_or(Limit::Beyond(searched), Limit::At));
        }
        // A hold adds half a period to the delay: what a thousandth of the shorter of both does not save, nothing saves.
        let shortest = 1e-3 * period_s.min(delay_s.max(1e-3 * period_s));
        if !self.is_stable(shortest, delay_s) {
            return None;
        }
        let (mut holds, mut fails) = (0.8 * period_s, period_s);
        while holds > shortest && !self.is_stable(holds, delay_s) {
            (holds, fails) = (0.8 * holds, holds);
        }
        let holds = holds.max(shortest);
        Some(Limit::At(bisect(holds, fails, |h| self.is_stable(h, delay_s))))
    }

    /// The first value from `from` on, at most `limit`, at which a configuration becomes unstable. The steps grow with the
    /// distance; `finest` is the first.
    fn first_loss(&self, from: f64, limit: f64, finest: f64, stable: impl Fn(&Modal<N>, f64) -> bool) -> Option<f64> {
        let mut found = None;
        for modal in &self.configurations {
            // The first configuration is usually the worst; the others only have to be shown not to be.
            let growth = if found.is_none() { 0.25 } else { 1.0 };
            let limit = found.unwrap_or(limit);
            if !stable(modal, from) {
                return Some(from);
            }
            let mut holds = from;
            while holds < limit {
                let next = (holds + finest.max(growth * (holds - from))).min(limit);
                if !stable(modal, next) {
                    found = Some(bisect(holds, next, |x| stable(modal, x)));
                    break;
                }
                holds = next;
            }
        }
        found
    }
}

/// Spectral radius at a configuration: the loop about rest at `q`, sampled every `period_s`, each torque acting from
/// `delay_s` after its sample (any length) until the next one acts. Below 1 the linearised loop is stable.
#[must_use]
pub fn spectral_radius<const N: usize>(
    law: &Law<N>,
    plant: &Chain<N>,
    q: &Vector<N>,
    period_s: f64,
    delay_s: f64,
) -> f64 {
    larger_radius(&Modal::new(law, plant, q).sampled(period_s, delay_s), 0.0)
}

/// The largest spectral radius over configurations, `samples` of them drawn: see [`SampledLoop`].
#[must_use]
pub fn worst_radius<const N: usize>(law: &Law<N>, plant: &Chain<N>, period_s: f64, delay_s: f64, samples: u32) -> f64 {
    SampledLoop::new(law, plant, samples).worst_radius(period_s, delay_s)
}

fn is_stable<const N: usize>(modal: &Modal<N>, period_s: f64, delay_s: f64) -> bool {
    walk(&modal.sampled(period_s, delay_s), 0.0).outside == 0
}

/// The spectral radius where it is larger than `floor`, else `floor`.
fn larger_radius<const N: usize>(sampled: &Sampled<'_, N>, floor: f64) -> f64 {
    // The excess over 1 is what is searched: the radius of a fast loop differs from 1 in its last digits only.
    let above = |excess: f64| walk(sampled, excess);
    let margin = |excess: f64| ROUNDING * (1.0 + excess);
    let (mut low, mut high) = (floor - 1.0, 0.0);
    if floor > 0.0 {
        let circle = above(low + margin(low));
        if circle.outside == 0 {
            return floor;
        }
        if let Some(excess) = confirmed(sampled, circle.nearest, &above) {
            return 1.0 + excess;
        }
    }
    if floor < 1.0 {
        let unit = above(0.0);
        if let Some(excess) = confirmed(sampled, unit.nearest, &above) {
            return 1.0 + excess;
        }
        if unit.outside > 0 {
            low = 0.0;
        } else if floor <= 0.0 {
            // Inwards, in steps that grow.
            let mut inwards = 1e-7;
            while above(libm::expm1(-inwards)).outside == 0 {
                high = libm::expm1(-inwards);
                inwards *= 4.0;
                if inwards > 30.0 {
                    return 0.0;
                }
            }
            low = libm::expm1(-inwards);
        }
    }
    if low >= 0.0 {
        high = 2.0 * low + 1.0;
        while above(high).outside > 0 {
            (low, high) = (high, 2.0 * high + 1.0);
            if high > 1e15 {
                return f64::INFINITY;
            }
        }
    }
    let mut tries = 0;
    while high - low > margin(high) {
        let middle = 0.5 * (low + high);
        let circle = above(middle);
        if circle.outside > 0 {
            low = middle
        } else {
            high = middle
        }
        // Newton's method is worth a try once the bracket tells roots apart.
        tries += 1;
        if tries % 3 == 0
            && let Some(excess) = confirmed(sampled, circle.nearest, &above)
        {
            return 1.0 + excess;
        }
    }
    1.0 + 0.5 * (low + high)
}

/// The excess of the modulus of the root that Newton's method finds from w = z − 1, if no root lies further out and one
/// does lie there.
fn confirmed<const N: usize>(
    sampled: &Sampled<'_, N>,
    mut w: Complex<f64>,
    above: &impl Fn(f64) -> super::circle::Circle,
) -> Option<f64> {
    for _ in 0..12 {
        let step = 1.0 / sampled.at(w).rate;
        w -= step;
        if step.norm_sqr() <= 1e-28 * (1.0 + w).norm_sqr() {
            let square = 2.0 * w.re + w.norm_sqr();
            // sqrt(1 + s) − 1 without loss of digits.
            let excess = square / (1.0 + (1.0 + square).sqrt());
            let margin = ROUNDING * (1.0 + excess);
            let outermost = above(excess + margin).outside == 0 && above(excess - margin).outside > 0;
            return outermost.then_some(excess);
        }
        if !step.re.is_finite() {
            return None;
        }
    }
    None
}

/// The end of what holds, between a value that does and one that doesn't: to 1 part in 10^10.
fn bisect(mut holds: f64, mut fails: f64, holds_at: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..60 {
        let middle = 0.5 * (holds + fails);
        if holds_at(middle) {
            holds = middle
        } else {
            fails = middle
        }
        if (fails - holds).abs() <= 1e-10 * holds.max(fails) {
            break;
        }
    }
    holds
}

#[cfg(test)]
mod tests;
