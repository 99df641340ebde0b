//! What the kernel says of a process in `/proc/PID/stat`.

/// One look at a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessStat {
    /// The kernel's letter for what it does.
    state: u8,
    /// The process that started it, or that took it over; 0 for the first one.
    pub parent: u32,
    /// Its process group.
    pub group: u32,
    /// CPU time that it has used so far, in the kernel's units of accounting, a hundredth of a second.
    pub used: u64,
}

impl ProcessStat {
    /// Looks at a process; none if there is none of this number.
    #[must_use]
    pub fn of(pid: u32) -> Option<Self> {
        Self::parse(&std::fs::read(format!("/proc/{pid}/stat")).ok()?)
    }

    /// The name of the program, in brackets, may have anything in it.
    fn parse(stat: &[u8]) -> Option<Self> {
        let after = stat.iter().rposition(|byte| *byte == b')')? + 1;
        let words: Vec<&str> = std::str::from_utf8(stat.get(after..)?).ok()?.split_ascii_whitespace().collect();
        let state = *words.first()?.as_bytes().first()?;
        let time = |place: usize| words.get(place).and_then(|word| word.parse::<u64>().ok()).unwrap_or(0);
        Some(Self {
            state,
            parent: words.get(1)?.parse().ok()?,
            group: words.get(2)?.parse().ok()?,
            used: time(11) + time(12),
        })
    }

    /// It has ended, and is only not reaped yet.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        matches!(self.state, b'Z' | b'X' | b'x')
    }

    /// It was stopped by a signal.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.state == b'T'
    }

    /// It waits inside the kernel, as for a disk.
    #[must_use]
    pub fn waits_for_disk(&self) -> bool {
        self.state == b'D'
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_with_an_ugly_name_has_a_parent_and_a_group_all_the_same() {
        let of = |stat: &[u8]| ProcessStat::parse(stat).map(|stat| (stat.state, stat.parent, stat.group));
        assert_eq!(of(b"7 (a) S 1 ) b) R 12 34 56 0 -1"), Some((b'R', 12, 34)));
        assert_eq!(of(b"7 (sh"), None);
    }

    #[test]
    fn a_process_that_computes_is_at_work_and_one_that_is_gone_is_not() {
        let used = || ProcessStat::of(std::process::id()).unwrap().used;
        let before = used();
        let until_ns = crate::clock::now_ns() + 20_000_000_000;
        while used() <= before + 1 {
            assert!(crate::clock::now_ns() < until_ns, "this process computes and its time stands still");
        }
        assert_eq!(ProcessStat::of(u32::MAX), None);
    }
}
