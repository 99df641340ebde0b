//! Counted words: `1 tick`, `2 ticks`, `2 replies`.

/// A count with its word, which is given for one; in `several words` the last one takes the plural.
#[must_use]
pub fn counted(count: u64, one: &str) -> String {
    if count == 1 { format!("1 {one}") } else { format!("{count} {}", plural(one)) }
}

fn plural(one: &str) -> String {
    match one.strip_suffix('y') {
        Some(stem) if !stem.ends_with(['a', 'e', 'o', 'u']) => format!("{stem}ies"),
        _ if one.ends_with(['s', 'x', 'h']) => format!("{one}es"),
        _ => format!("{one}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_singular_and_none_and_many_are_plural() {
        let words = |one: &str| [0, 1, 2].map(|count| counted(count, one)).join(", ");
        assert_eq!(words("tick"), "0 ticks, 1 tick, 2 ticks");
        assert_eq!(words("tick record"), "0 tick records, 1 tick record, 2 tick records");
        assert_eq!(words("reply"), "0 replies, 1 reply, 2 replies");
        assert_eq!(words("delay"), "0 delays, 1 delay, 2 delays");
        assert_eq!(words("process"), "0 processes, 1 process, 2 processes");
    }
}
