//! Small square matrices of a size known at start-up only, for the sampled loop with its delayed torques.
//!
//! Own code, so that results are bit-identical across machines: sums run in index order, nothing is dispatched. It
//! allocates and is not for loops.

/// A square matrix, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Dense {
    size: usize,
    entries: Vec<f64>,
}

impl Dense {
    pub(super) fn zeros(size: usize) -> Self {
        Self { size, entries: vec![0.0; size * size] }
    }

    pub(super) fn identity(size: usize) -> Self {
        let mut out = Self::zeros(size);
        for i in 0..size {
            out.set(i, i, 1.0);
        }
        out
    }

    pub(super) fn at(&self, row: usize, column: usize) -> f64 {
        self.entries[row * self.size + column]
    }

    pub(super) fn set(&mut self, row: usize, column: usize, value: f64) {
        self.entries[row * self.size + column] = value;
    }

    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        self.entries[row * self.size + column] += value;
    }

    fn scaled(mut self, factor: f64) -> Self {
        self.entries.iter_mut().for_each(|x| *x *= factor);
        self
    }

    /// The largest sum of absolute values of a row.
    fn norm(&self) -> f64 {
        self.entries.chunks(self.size).map(|row| row.iter().map(|x| x.abs()).sum()).fold(0.0, f64::max)
    }

    pub(super) fn times(&self, other: &Self) -> Self {
        let mut out = Self::zeros(self.size);
        for i in 0..self.size {
            for k in 0..self.size {
                let factor = self.at(i, k);
                for j in 0..self.size {
                    out.add(i, j, factor * other.at(k, j));
                }
            }
        }
        out
    }

    /// e^{A}, by scaling to a norm of at most 1/4, eighteen terms of the series (remainder below 1e-27), and squaring.
    pub(super) fn exponential(&self) -> Self {
        let mut squarings = 0;
        let mut scale = 1.0;
        while self.norm() * scale > 0.25 && squarings < 60 {
            scale *= 0.5;
            squarings += 1;
        }
        let small = self.clone().scaled(scale);
        let mut sum = Self::identity(self.size);
        for term in (1..=18u32).rev() {
            // Horner: 1 + A/1 (1 + A/2 (1 + …)).
            sum = small.times(&sum).scaled(1.0 / f64::from(term));
            for i in 0..self.size {
                sum.add(i, i, 1.0);
            }
        }
        for _ in 0..squarings {
            sum = sum.times(&sum);
        }
        sum
    }

    /// The spectral radius, as the limit of ‖A^m‖^{1/m} along m = 2^k (Gelfand's formula); at m = 2^40 the factor that
    /// stands between the norm and the radius is 1 to rounding.
    pub(super) fn spectral_radius(&self) -> f64 {
        let mut power = self.clone();
        let (mut log_radius, mut weight) = (0.0, 1.0);
        for _ in 0..40 {
            let norm = power.norm();
            if !(norm > 0.0 && norm.is_finite()) {
                // A power that vanishes means radius 0; one that is not finite came from such an input.
                return if norm > 0.0 { f64::INFINITY } else { 0.0 };
            }
            log_radius += weight * libm::log(norm);
            weight *= 0.5;
            let unit = power.scaled(1.0 / norm);
            power = unit.times(&unit);
        }
        libm::exp(log_radius)
    }
}
