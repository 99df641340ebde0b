//! How many roots of a sampled loop lie outside of a circle about 0: by the argument principle.
//!
//! F(z) = z^{−2N} det Q(z) has no pole and tends to 1 far out, so minus its winding number along |z| = ρ is the number of
//! its roots outside. F(z̄) is the conjugate of F(z): half of the circle is enough.

use core::f64::consts::PI;

use nalgebra::Complex;

use super::modal::Sampled;

/// Longest step along the circle, in terms of the logarithm of F. Below 2, so that no step can straddle roots on the
/// circle: at a distance x from m of them the logarithm changes at the rate m/x.
const STEP_MAX: f64 = 1.9;
/// By how much the trapezoid rule may miss the change of the logarithm of F over a step: well below half a turn.
const MISS_MAX: f64 = 0.3;
/// Steps shorter than this share of the angle don't get shorter: a root lies on the circle to rounding.
const ANGLE_MIN: f64 = 4e-16;
/// What that share is at least of, near the real axis.
const ANGLE_NEAR: f64 = 1e-8;
/// An end to what a step costs, for numbers beyond reason.
const STEPS_MAX: u32 = 400_000;

/// What a walk along a circle has found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Circle {
    /// Roots outside.
    pub(super) outside: u32,
    /// w = z − 1 of the point nearest to a root, by the length of Newton's step.
    pub(super) nearest: Complex<f64>,
}

#[derive(Clone, Copy)]
struct Point {
    theta: f64,
    w: Complex<f64>,
    direction: Complex<f64>,
    log: f64,
    /// Derivative of the logarithm of F by θ.
    rate: Complex<f64>,
    /// |f'/f|, 1 over the length of Newton's step.
    pull: f64,
}

/// Walks along |z| = 1 + `excess`.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small count, and the cast saturates")]
pub(super) fn walk<const N: usize>(sampled: &Sampled<'_, N>, excess: f64) -> Circle {
    let rho = 1.0 + excess;
    let at = |theta: f64| {
        let half = libm::sin(0.5 * theta);
        let w = Complex::new(excess - 2.0 * rho * half * half, rho * libm::sin(theta));
        let value = sampled.at(w);
        let order = 2.0 * N as f64;
        let back = Complex::new(libm::cos(order * theta), -libm::sin(order * theta));
        Point {
            theta,
            w,
            direction: value.direction * back,
            log: value.log,
            rate: ((w + 1.0) * value.rate - order) * Complex::new(0.0, 1.0),
            pull: value.rate.norm_sqr(),
        }
    };
    let mut here = at(0.0);
    let mut best = here;
    let mut turned = 0.0;
    // Roots of a fast loop crowd near z = 1, so the first marks are spaced by ratios.
    let mut ahead: Vec<Point> = (0..16).map(|step| at(PI * libm::exp2(-2.0 * f64::from(step)))).collect();
    let mut steps = 0;
    while let Some(next) = ahead.last().copied() {
        steps += 1;
        let width = next.theta - here.theta;
        let change = next.direction * here.direction.conj();
        let (turn, grown) = (libm::atan2(change.im, change.re), next.log - here.log);
        let guess = (here.rate + next.rate) * (0.5 * width);
        let fastest = here.rate.norm_sqr().max(next.rate.norm_sqr());
        let smooth = fastest * width * width <= STEP_MAX * STEP_MAX
            && (turn - guess.im).abs() <= MISS_MAX
            && (grown - guess.re).abs() <= MISS_MAX;
        if smooth || width <= ANGLE_MIN * (next.theta + ANGLE_NEAR) || steps > STEPS_MAX {
            turned += turn;
            here = next;
            if here.pull > best.pull {
                best = here;
            }
            ahead.pop();
        } else if here.theta > 0.0 && next.theta > 2.0 * here.theta {
            ahead.push(at((here.theta * next.theta).sqrt()));
        } else {
            ahead.push(at(here.theta + 0.5 * width));
        }
    }
    // A turn that is no number (gains or lengths beyond reason) counts as unstable.
    let outside = if turned.is_finite() { (-turned / PI).round().max(0.0) as u32 } else { u32::MAX };
    Circle { outside, nearest: best.w }
}
