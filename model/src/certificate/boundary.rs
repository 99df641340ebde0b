//! The boundary of the fast mode ṙ = −a r, sampled every h and answered d later: \[11] for a constant delay, \[14] for
//! one that jumps between two values.
//!
//! Pure mathematics of one rate; which law has which rate is the matter of the law.

use core::f64::consts::PI;

/// Halvings of a bisection: to the last bit of a double.
const HALVINGS: u32 = 60;

/// The rate a (1/s) at which ṙ = −a r, sampled every h and answered d later, loses its stability; any d ≥ 0.
///
/// With d = (j + f) h, 0 ≤ f < 1, the loop is z^{j+1}(z − 1) + a h((1−f) z + f) = 0. For j = 0 that is \[11]; for j ≥ 1
/// the first crossing z = e^{iθ} of the unit circle solves (j + 3/2) θ − arg((1−f) e^{iθ} + f) = π/2, and there
/// a h = 2 sin(θ/2)/|(1−f) e^{iθ} + f|.
#[must_use]
pub fn critical_rate(period_s: f64, delay_s: f64) -> f64 {
    if delay_s < period_s {
        // max(d, (h − 2d)/2) is at least h/4, never 0.
        return 1.0 / delay_s.max((period_s - 2.0 * delay_s) / 2.0);
    }
    let whole = (delay_s / period_s).floor();
    let part = delay_s / period_s - whole;
    let answer = |theta: f64| ((1.0 - part) * libm::cos(theta) + part, (1.0 - part) * libm::sin(theta));
    let theta = bisect(0.0, PI / 2.0, |theta| {
        let (real, imaginary) = answer(theta);
        (whole + 1.5) * theta - libm::atan2(imaginary, real) < PI / 2.0
    });
    let (real, imaginary) = answer(theta);
    2.0 * libm::sin(theta / 2.0) / ((real * real + imaginary * imaginary).sqrt() * period_s)
}

/// The rate a (1/s) at which ṙ = −a r loses its stability when the delay may be anywhere between `least_s` and
/// `most_s`, from tick to tick: a *necessary* rule. Each constant delay in the range must be stable \[11], and so must
/// be a delay that alternates between its ends:
///
/// ```text
/// a (h + sqrt((h − 2 d_1)(2 d_2 − h))) < 2,   d_1 < h/2 < d_2 ≤ h                                             [14]
/// ```
///
/// With r_{k+1} = (1 − m + x_k) r_k − x_k r_{k−1}, m = a h and x_k = a d_k, the product over two ticks with x_1 and x_2
/// has the determinant x_1 x_2 and the trace (1 − m + x_1)(1 − m + x_2) − x_1 − x_2. Jury's test of it is
/// x_1 x_2 < 1, the mean delay in \[11], and m (x_1 + x_2) < 1 + (1 − m)² + 2 x_1 x_2; solved for a, the last is \[14].
/// With d_1 = 0 it reads a d · a h < 1 + (1 − a h)²; with d_1 = d_2 it is never violated.
#[must_use]
pub fn critical_rate_with_jitter(period_s: f64, least_s: f64, most_s: f64) -> f64 {
    // [11] is best at h/4 and falls off on both sides, so its worst constant delay is at an end of the range.
    let constant = critical_rate(period_s, least_s).min(critical_rate(period_s, most_s));
    constant.min(alternating_rate(period_s, least_s, most_s))
}

/// \[14]; infinite where it says nothing. A delay beyond the period counts as one of a period, which lies in its range.
fn alternating_rate(period_s: f64, least_s: f64, most_s: f64) -> f64 {
    let (below, above) = (period_s - 2.0 * least_s, 2.0 * most_s.min(period_s) - period_s);
    if below > 0.0 && above > 0.0 { 2.0 / (period_s + (below * above).sqrt()) } else { f64::INFINITY }
}

/// What may be added to the delay before the rate `rate` (1/s) is the critical one, s; 0 when it is already.
/// `critical` gives the critical rate at a delay; it falls from h/4 on.
pub(super) fn delay_margin_s(rate: f64, period_s: f64, delay_s: f64, critical: impl Fn(f64) -> f64) -> f64 {
    let stable = |delay_s: f64| rate < critical(delay_s);
    if !stable(delay_s) {
        return 0.0;
    }
    let (holds, fails) = (delay_s.max(period_s / 4.0), 2.0 * (delay_s + period_s + PI / rate));
    (bisect(holds, fails, stable) - delay_s).max(0.0)
}

/// The period (s) that separates stable from unstable for a rate at a delay: shorter ones are stable, longer ones are
/// not. None when no period is stable with this delay.
///
/// With a d < 1 that is 2d + 2/a. With more, only periods well below the delay are stable, and none from a d = π/2 on,
/// where even a loop that is never sampled is unstable. In between the boundary is sought from `period_s` on.
#[must_use]
pub fn longest_period_s(rate: f64, period_s: f64, delay_s: f64) -> Option<f64> {
    let turn = rate * delay_s;
    if turn < 1.0 {
        return Some(2.0 * delay_s + 2.0 / rate);
    }
    // What the hold adds to the delay is about half a period, which gives a first guess of a period that is stable.
    let stable = |period_s: f64| rate < critical_rate(period_s, delay_s);
    let mut holds = if stable(period_s) { period_s } else { (delay_s * (PI / (2.0 * turn) - 1.0)).min(period_s) };
    for _ in 0..8 {
        if holds <= 1e-6 * delay_s {
            return None;
        }
        if stable(holds) {
            // From a d = 1 on no period above the delay is stable, and none above an unstable one is looked at.
            let fails = if stable(period_s) { delay_s } else { delay_s.min(period_s) };
            return Some(bisect(holds, fails, stable));
        }
        holds *= 0.5;
    }
    None
}

/// The end of what holds, between a point that does and one that doesn't.
fn bisect(mut holds: f64, mut fails: f64, holds_at: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..HALVINGS {
        let middle = 0.5 * (holds + fails);
        if holds_at(middle) { holds = middle } else { fails = middle }
    }
    holds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::close;

    /// Growth of ṙ = −a r over many ticks whose delays (s, below the period) come from `delay_at`.
    fn grows(rate: f64, period_s: f64, delay_at: impl Fn(u32) -> f64) -> bool {
        let (mut now, mut before, mut size) = (1.0f64, 0.0f64, 0.0f64);
        for tick in 0..4000 {
            let delay_s = delay_at(tick);
            let next = now - rate * ((period_s - delay_s) * now + delay_s * before);
            (before, now) = (now, next);
            size = now.abs().max(before.abs());
            if size > 1e100 {
                return true;
            }
        }
        size > 1.0
    }

    #[test]
    fn the_rule_for_a_delay_that_alternates_separates_growth_from_decay() {
        let h = 1e-3;
        for (least, most) in [(0.0, 0.6), (0.0, 0.55), (0.1, 0.9), (0.3, 0.7), (0.45, 1.0), (0.0, 1.0)] {
            let rate = critical_rate_with_jitter(h, least * h, most * h);
            // The worst of what may happen: either end all the time, or both in turn.
            let worst = |rate: f64| {
                let in_turn = grows(rate, h, |tick| if tick % 2 == 0 { least * h } else { most * h });
                in_turn || grows(rate, h, |_| least * h) || grows(rate, h, |_| most * h)
            };
            assert!(!worst(0.995 * rate) && worst(1.005 * rate), "{least} {most}: {rate}");
        }
    }

    #[test]
    fn with_no_delay_at_one_end_the_rule_is_a_d_a_h_below_1_plus_the_square() {
        let (h, d) = (1e-3, 0.6e-3);
        let rate = critical_rate_with_jitter(h, 0.0, d);
        let (m, x) = (rate * h, rate * d);
        close(m * x, 1.0 + (1.0 - m) * (1.0 - m), 1e-12);
        // It is the stricter one only for 1 < a h < 2, and asks nothing of a delay that does not jump.
        assert!((1.0..2.0).contains(&m) && x < 1.0);
        for d in [0.0, 0.2e-3, 0.6e-3, 0.99e-3, 1.7e-3] {
            close(critical_rate_with_jitter(h, d, d), critical_rate(h, d), 0.0);
        }
    }

    #[test]
    fn the_longest_period_separates_stable_from_unstable_at_every_delay() {
        let rate = 1054.0;
        let mut none = 0;
        for delay_ms in [0.0, 0.1, 0.5, 0.94, 0.96, 1.0, 1.1, 1.17, 1.178, 1.2, 1.26, 1.3, 1.4, 1.48, 1.5, 2.0, 40.0] {
            for period_ms in [0.02, 0.1, 0.4, 0.7, 1.0, 3.3333, 5.8824] {
                let (d, h) = (delay_ms * 1e-3, period_ms * 1e-3);
                let stable = |h: f64| rate < critical_rate(h, d);
                match longest_period_s(rate, h, d) {
                    Some(limit) => {
                        assert!(stable(limit * (1.0 - 1e-6)) && !stable(limit * (1.0 + 1e-6)), "{d} {h}: {limit}");
                        assert!(!stable(h) || h <= limit, "{d} {h}: stable above the limit {limit}");
                        assert!(stable(h) || h >= limit, "{d} {h}: unstable below the limit {limit}");
                    }
                    None => {
                        none += 1;
                        assert!(rate * d > 1.5 && !stable(h) && !stable(h / 50.0), "{d} {h}");
                    }
                }
            }
        }
        assert!(none > 10, "{none}");
    }

    #[test]
    fn the_delay_that_is_left_separates_stable_from_unstable_at_every_period() {
        let rate = 1054.0;
        for period_ms in [0.02, 0.1, 0.4, 0.7, 1.0, 1.8, 2.5] {
            for delay in [0.0, 0.3, 0.7, 1.4, 9.0] {
                let (h, d) = (period_ms * 1e-3, delay * period_ms * 1e-3);
                let stable = |d: f64| rate < critical_rate(h, d);
                let left = delay_margin_s(rate, h, d, |d| critical_rate(h, d));
                if stable(d) {
                    assert!(stable(d + left * (1.0 - 1e-9)) && !stable(d + left * (1.0 + 1e-6) + 1e-12), "{h} {d}");
                } else {
                    close(left, 0.0, 0.0);
                }
            }
        }
    }
}
