//! What the number behind a key may be: one range, for the check, the message, the documents and the schema.

/// The largest number of a scenario: its square, multiplied by a few others of its size, is still far from infinite.
const MAGNITUDE_MAX: f64 = 1e12;
/// The smallest number that is not zero, likewise.
const MAGNITUDE_MIN: f64 = 1e-12;

/// A range of numbers; times count in nanoseconds, rates in hertz.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    /// The smallest number, or the largest one that is too small.
    pub least: f64,
    /// The largest number, or the smallest one that is too large.
    pub most: f64,
    /// Whether `least` itself is allowed.
    pub with_least: bool,
    /// Whether `most` itself is allowed.
    pub with_most: bool,
    /// Whether zero is allowed besides.
    pub or_zero: bool,
    /// The range as a message has it.
    pub words: &'static str,
    /// The range as a table has it: nothing where it goes without saying.
    pub brief: &'static str,
}

/// Any number that a computation stands.
pub(crate) const FINITE: Limit =
    Limit::range(-MAGNITUDE_MAX, MAGNITUDE_MAX, "a finite number, -1e12 to 1e12").brief("");
/// Not zero, and neither so small nor so large that products of it could leave the range of a double.
pub(crate) const POSITIVE: Limit =
    Limit::range(MAGNITUDE_MIN, MAGNITUDE_MAX, "a positive, finite number, 1e-12 to 1e12").brief("positive");
/// The same, or zero.
pub(crate) const NOT_NEGATIVE: Limit = Limit {
    or_zero: true,
    ..Limit::range(MAGNITUDE_MIN, MAGNITUDE_MAX, "zero or a positive, finite number, 1e-12 to 1e12")
        .brief("not negative")
};
/// For what may be without a limit.
pub(crate) const POSITIVE_OR_INF: Limit =
    Limit::range(MAGNITUDE_MIN, f64::INFINITY, "a positive number, or inf").brief("positive, or inf");
/// For times.
pub(crate) const ABOVE_ZERO: Limit = Limit::range(0.0, f64::INFINITY, "above zero").without_least();
/// For counts.
pub(crate) const AT_LEAST_ONE: Limit = Limit::range(1.0, f64::INFINITY, "at least 1");

impl Limit {
    /// Every number.
    pub(crate) const NONE: Self = Self {
        least: f64::NEG_INFINITY,
        most: f64::INFINITY,
        with_least: true,
        with_most: true,
        or_zero: false,
        words: "",
        brief: "",
    };

    /// From `least` to `most`, both included.
    pub(crate) const fn range(least: f64, most: f64, words: &'static str) -> Self {
        Self { least, most, words, brief: words, ..Self::NONE }
    }

    /// The same without its lower end.
    pub(crate) const fn without_least(self) -> Self {
        Self { with_least: false, ..self }
    }

    /// The same without its upper end.
    pub(crate) const fn without_most(self) -> Self {
        Self { with_most: false, ..self }
    }

    /// The same in these words for a table.
    pub(crate) const fn brief(self, brief: &'static str) -> Self {
        Self { brief, ..self }
    }

    /// Whether `value` is allowed. NaN makes every comparison false, so it is refused wherever there is a limit.
    #[must_use]
    pub fn allows(&self, value: f64) -> bool {
        let above = if self.with_least { value >= self.least } else { value > self.least };
        let below = if self.with_most { value <= self.most } else { value < self.most };
        self.words.is_empty() || (above && below) || (self.or_zero && value == 0.0)
    }
}
