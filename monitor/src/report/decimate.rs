//! A run of any length as a few thousand intervals, each with the least and the largest value of every series: no peak
//! is lost, and a page stays small.

use serde::Serialize;

/// Intervals at most; when they are used up, neighbours are merged.
const INTERVALS_MAX: usize = 4096;

/// Several series over common intervals of time.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Decimated {
    /// Start of each interval, s.
    pub(super) t_s: Vec<f64>,
    /// For each series the least value of each interval; `null` where there was none.
    pub(super) low: Vec<Vec<Option<f32>>>,
    /// And the largest.
    pub(super) high: Vec<Vec<Option<f32>>>,
    #[serde(skip)]
    ticks_each: usize,
    #[serde(skip)]
    ticks_in_last: usize,
}

impl Decimated {
    /// So many series, without values.
    #[must_use]
    pub(super) fn new(series: usize) -> Self {
        let none = vec![Vec::new(); series];
        Self { t_s: Vec::new(), low: none.clone(), high: none, ticks_each: 1, ticks_in_last: 0 }
    }

    /// Adds a tick with a value of each series; what is not finite counts as none.
    pub(super) fn push(&mut self, t_s: f64, values: impl Iterator<Item = Option<f64>>) {
        if self.t_s.is_empty() || self.ticks_in_last == self.ticks_each {
            if self.t_s.len() == INTERVALS_MAX {
                self.merge();
            }
            self.t_s.push(t_s);
            self.low.iter_mut().chain(&mut self.high).for_each(|series| series.push(None));
            self.ticks_in_last = 0;
        }
        self.ticks_in_last += 1;
        let last = self.t_s.len() - 1;
        for ((low, high), value) in self.low.iter_mut().zip(&mut self.high).zip(values) {
            #[expect(clippy::cast_possible_truncation, reason = "a picture needs no more")]
            let value = value.map(|value| value as f32).filter(|value| value.is_finite());
            (low[last], high[last]) = (least(low[last], value), largest(high[last], value));
        }
    }

    fn merge(&mut self) {
        self.ticks_each *= 2;
        self.t_s = self.t_s.iter().step_by(2).copied().collect();
        let pairs = |series: &mut Vec<Option<f32>>, pick: fn(Option<f32>, Option<f32>) -> Option<f32>| {
            *series = series.chunks(2).map(|pair| pick(pair[0], pair.get(1).copied().flatten())).collect();
        };
        self.low.iter_mut().for_each(|series| pairs(series, least));
        self.high.iter_mut().for_each(|series| pairs(series, largest));
        self.ticks_in_last = self.ticks_each;
    }
}

fn least(a: Option<f32>, b: Option<f32>) -> Option<f32> {
    a.zip(b).map(|(a, b)| a.min(b)).or(a).or(b)
}

fn largest(a: Option<f32>, b: Option<f32>) -> Option<f32> {
    a.zip(b).map(|(a, b)| a.max(b)).or(a).or(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_peak_survives_however_long_the_run() {
        let mut decimated = Decimated::new(2);
        for tick in 0..100_000u32 {
            let peak = if tick == 77_777 { 9.0 } else { f64::from(tick % 2) };
            decimated.push(f64::from(tick), [Some(peak), None].into_iter());
        }
        assert!(decimated.t_s.len() <= INTERVALS_MAX && decimated.t_s.len() > INTERVALS_MAX / 4);
        let at = decimated.high[0].iter().position(|value| *value == Some(9.0)).unwrap();
        assert!(decimated.t_s[at] <= 77_777.0 && decimated.t_s[at + 1] > 77_777.0);
        assert_eq!((decimated.low[0][at], decimated.low[1][at]), (Some(0.0), None));
        assert!(decimated.t_s.windows(2).all(|pair| pair[0] < pair[1]));
    }
}
