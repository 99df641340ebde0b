//! How a message shows what somebody else wrote: without control characters, and no longer than can be read.
//!
//! A file may hold an escape sequence that moves the cursor or renames the terminal, a NUL, or a number of 300 digits.
//! What a message quotes of it goes through here: [`text`] and [`number`] where it is put in, [`lines`] once more where
//! a whole message is printed.

/// Characters of a quoted text; of a longer one the beginning and the end are shown.
const SHOWN_MAX: usize = 80;
/// Characters of a word within a message: enough for a path, too few for a number of 300 digits.
const WORD_MAX: usize = 200;

/// A text of a user's: control characters escaped, shortened in the middle where it is long.
#[must_use]
pub fn text(raw: &str) -> String {
    shortened(&escaped(raw, false), SHOWN_MAX)
}

/// A path, as a message shows it.
#[must_use]
pub fn path(path: &std::path::Path) -> String {
    shortened(&escaped(&path.to_string_lossy(), false), WORD_MAX)
}

/// The same however long it is: for whoever reads it from standard output.
#[must_use]
pub fn whole_path(path: &std::path::Path) -> String {
    escaped(&path.to_string_lossy(), false)
}

/// A number in at most some twenty characters: with an exponent where it is very large or very small.
#[must_use]
pub fn number(value: f64) -> String {
    let plain = value == 0.0 || !value.is_finite() || (1e-5..1e15).contains(&value.abs());
    if plain { value.to_string() } else { format!("{value:e}") }
}

/// A whole message: lines stay lines, and nothing in them reaches the terminal as a command. Words longer than any path
/// are shortened.
#[must_use]
pub fn lines(message: &str) -> String {
    let escaped = escaped(message, true);
    if escaped.len() <= WORD_MAX {
        return escaped;
    }
    let mut shown = String::with_capacity(escaped.len());
    for piece in escaped.split_inclusive([' ', '\n', '\t']) {
        let word = piece.trim_end_matches([' ', '\n', '\t']);
        shown.push_str(&shortened(word, WORD_MAX));
        shown.push_str(&piece[word.len()..]);
    }
    shown
}

/// The candidate that a writer most likely meant by `found`, if any is near enough to be worth naming.
#[must_use]
pub fn nearest<'a>(found: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    candidates
        .into_iter()
        // What is far longer than any of them is none of them, and would take long to compare.
        .filter(|candidate| found.len() <= 2 * candidate.len() + 8)
        .map(|candidate| (strsim::damerau_levenshtein(found, candidate), candidate))
        .min_by_key(|(distance, _)| *distance)
        .filter(|(distance, candidate)| *distance <= 1 + candidate.len() / 3)
        .map(|(_, candidate)| candidate)
}

/// Whether a terminal would do something else with this character than show it: control characters, and those that
/// change the direction of what follows or show nothing at all.
fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}')
}

fn escaped(raw: &str, keeps_lines: bool) -> String {
    let mut shown = String::with_capacity(raw.len());
    for c in raw.chars() {
        match c {
            '\n' | '\t' if keeps_lines => shown.push(c),
            c if is_hidden(c) => shown.extend(c.escape_default()),
            c => shown.push(c),
        }
    }
    shown
}

fn shortened(text: &str, most: usize) -> String {
    let count = text.chars().count();
    if count <= most {
        return text.to_owned();
    }
    let (head, tail) = (most / 2, most / 4);
    let begin: String = text.chars().take(head).collect();
    let end: String = text.chars().skip(count - tail).collect();
    format!("{begin}…{end} ({count} characters)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_command_a_terminal_is_shown_as_its_escape() {
        assert_eq!(text("a\u{1b}[2Jb\0c\u{9b}d\r\n"), "a\\u{1b}[2Jb\\u{0}c\\u{9b}d\\r\\n");
        assert_eq!(text("robst é µ q̈"), "robst é µ q̈", "what can be read stays as it is");
        assert_eq!(text("\u{202e}gnp"), "\\u{202e}gnp");
        assert_eq!(lines("two\nlines\u{7}"), "two\nlines\\u{7}");
        assert_eq!(path(std::path::Path::new("a\u{1b}b")), "a\\u{1b}b");
    }

    #[test]
    fn numbers_and_words_of_any_length_stay_readable() {
        assert_eq!(
            (number(1e160), number(-2.5e-9), number(0.1), number(1000.0)),
            ("1e160".into(), "-2.5e-9".into(), "0.1".into(), "1000".into())
        );
        assert_eq!((number(f64::NAN), number(f64::INFINITY), number(0.0)), ("NaN".into(), "inf".into(), "0".into()));
        let long = text(&"1".repeat(300));
        assert!(long.chars().count() < 90 && long.ends_with("(300 characters)"), "{long}");
        let line = lines(&format!("found {}, allowed: less", "9".repeat(5000)));
        assert!(
            line.chars().count() < 250 && line.starts_with("found 99") && line.ends_with("allowed: less"),
            "{line}"
        );
        let path = format!("/{}", "folder/".repeat(20));
        assert_eq!(
            lines(&format!("{path}: no such file, and more words to make it long: {path}")).matches(&path).count(),
            2
        );
    }
}
