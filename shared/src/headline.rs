//! How a run or a command can end: the one table of headlines, with their words and exit codes.
//!
//! Everything that prints a verdict, writes one or ends with one asks here; `docs/exit-codes.md` is this table for users,
//! and a test holds the two together. The order of the variants is the order of precedence: where several headlines
//! apply, the first one counts.

/// The one word that a run is worth, the gravest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Headline {
    /// The command line or the scenario is wrong.
    Usage,
    /// Ctrl-C to the launcher.
    Interrupted,
    /// SIGTERM or SIGHUP to the launcher.
    Terminated,
    /// A fault of loopbound's own, or of the system under it.
    Internal,
    /// The loop ran away.
    Diverged,
    /// A role was lost and not recovered.
    RoleLost,
    /// The run ended before its last tick, and nobody had asked for that.
    Incomplete,
    /// An expectation does not hold.
    Failed,
    /// The certified bound was broken other than by the age of the torque.
    Violated,
    /// A swap was refused or rolled back, or a fault was refused.
    SwapRefused,
    /// No tick was seen.
    NoData,
    /// The data don't decide an expectation.
    Inconclusive,
    /// The law is certified, and no tick could be checked.
    NotChecked,
    /// Latency broke the certified bound, or used up its budget.
    Late,
    /// Nothing is certified for this law, gains and start.
    NotCertified,
    /// Every expectation holds.
    Passed,
    /// The certified bound held on every tick that was checked.
    Held,
}

/// What there is to say of a headline.
struct Row {
    word: &'static str,
    exit_code: u8,
    sentence: &'static str,
}

impl Headline {
    /// All of them, the one that counts first first.
    pub const ALL: [Self; 17] = [
        Self::Usage,
        Self::Interrupted,
        Self::Terminated,
        Self::Internal,
        Self::Diverged,
        Self::RoleLost,
        Self::Incomplete,
        Self::Failed,
        Self::Violated,
        Self::SwapRefused,
        Self::NoData,
        Self::Inconclusive,
        Self::NotChecked,
        Self::Late,
        Self::NotCertified,
        Self::Passed,
        Self::Held,
    ];

    const fn row(self) -> Row {
        let (word, exit_code, sentence) = match self {
            Self::Usage => {
                ("usage", 2, "the command line, the scenario or a file that it names is wrong; nothing was started")
            }
            Self::Interrupted => ("interrupted", 130, "Ctrl-C (SIGINT) reached the launcher"),
            Self::Terminated => ("terminated", 143, "SIGTERM or SIGHUP reached the launcher"),
            Self::Internal => ("internal", 70, "a fault of loopbound itself or of the system under it"),
            Self::Diverged => (
                "diverged",
                1,
                "the loop ran away: a value is not finite, V is far above its start and its certified level, or a joint is faster than `plant.speed_limit`",
            ),
            Self::RoleLost => ("role lost", 5, "a process of the group did not start, or ended and was not replaced"),
            Self::Incomplete => (
                "incomplete",
                5,
                "the run ended before its last tick without anybody having asked for it, or its records do",
            ),
            Self::Failed => ("failed", 1, "an expectation does not hold"),
            Self::Violated => {
                ("violated", 1, "the certified bound on V was broken, and the age of the torque does not explain it")
            }
            Self::SwapRefused => {
                ("swap refused", 4, "a swap was refused or rolled back, or an injected fault was refused")
            }
            Self::NoData => ("no data", 3, "no tick was seen"),
            Self::Inconclusive => ("inconclusive", 3, "no expectation failed, and the data don't decide every one"),
            Self::NotChecked => {
                ("not checked", 3, "the law is certified, and no tick could be checked against its bound")
            }
            Self::Late => {
                ("late", 0, "the age of the torque broke the certified bound on V, or latency used up its budget")
            }
            Self::NotCertified => {
                ("not certified", 0, "nothing is certified for this law with these gains and this start")
            }
            Self::Passed => ("passed", 0, "every expectation holds"),
            Self::Held => ("held", 0, "the certified bound on V held on every tick that was checked"),
        };
        Row { word, exit_code, sentence }
    }

    /// Its word in `summary.json` and every other JSON document: `verdict.status`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        self.row().word
    }

    /// Its word on a screen and on the page of a run.
    #[must_use]
    pub fn screen_word(self) -> String {
        self.word().to_uppercase()
    }

    /// The exit code of a command that ends with it.
    #[must_use]
    pub const fn exit_code(self) -> u8 {
        self.row().exit_code
    }

    /// What it means, in one sentence without a full stop.
    #[must_use]
    pub const fn sentence(self) -> &'static str {
        self.row().sentence
    }

    /// The headline of a word of [`word`](Self::word); none for any other word.
    #[must_use]
    pub fn of_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|headline| headline.word() == word)
    }

    /// The one that counts where all of these apply; none where there are none.
    #[must_use]
    pub fn first_of(all: impl IntoIterator<Item = Self>) -> Option<Self> {
        all.into_iter().min()
    }

    /// Whether it is good news: neither a fault nor an open question nor a warning.
    #[must_use]
    pub const fn is_good(self) -> bool {
        matches!(self, Self::Held | Self::Passed)
    }

    /// Whether more data could change it.
    #[must_use]
    pub const fn is_open(self) -> bool {
        matches!(self, Self::NoData | Self::Inconclusive | Self::NotChecked)
    }

    /// Whether it is a failure that a build should stop at.
    #[must_use]
    pub const fn is_bad(self) -> bool {
        matches!(self.exit_code(), 1 | 4 | 5 | 70)
    }
}

impl std::fmt::Display for Headline {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.word())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_each_neighbouring_pair_the_first_counts_in_whichever_order_they_are_found() {
        for pair in Headline::ALL.windows(2) {
            let [graver, lighter] = [pair[0], pair[1]];
            assert_eq!(Headline::first_of([graver, lighter]), Some(graver));
            assert_eq!(Headline::first_of([lighter, graver]), Some(graver), "{lighter} hides {graver}");
        }
        assert_eq!(Headline::first_of([]), None);
    }

    #[test]
    fn the_order_of_the_exit_codes_is_the_documented_one() {
        let mut codes: Vec<u8> = Headline::ALL.map(Headline::exit_code).to_vec();
        codes.dedup();
        assert_eq!(codes, [2, 130, 143, 70, 1, 5, 1, 4, 3, 0]);
        let sorted = {
            let mut all = Headline::ALL;
            all.sort_unstable();
            all
        };
        assert_eq!(sorted, Headline::ALL, "the list is in the order of precedence");
    }

    #[test]
    fn a_word_finds_its_headline_again_and_no_two_are_alike() {
        for headline in Headline::ALL {
            assert_eq!(Headline::of_word(headline.word()), Some(headline));
            assert!(!headline.sentence().is_empty() && !headline.sentence().ends_with('.'));
        }
        assert_eq!(Headline::of_word("fine"), None);
    }
}
