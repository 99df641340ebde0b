//! The fault that is injected by command into a controller of the running group: the supervisor writes it into a few words of
//! the control block, and the controller reads it
//!
//! One writer, any number of readers, no lock: the version is odd while the words are being written, and a reader that
//! finds it odd, or changed when it has read them, looks again in its next slack. A look costs one load when there is
//! nothing new. A writer that was killed in the middle leaves an odd version, and so no fault.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::SeqCst};

use super::FaultActions;
use crate::event::LiveFault;

/// A fault that was asked for while the group runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Injected {
    /// Its kind.
    pub kind: LiveFault,
    /// The controller that it is injected into.
    pub target: u32,
    /// The first tick.
    pub first: u64,
    /// The first tick after it.
    pub end: u64,
    /// How much later each torque is published, ns; of a delay.
    pub delay_ns: u64,
    /// What is added to the torque of the first link, N·m; of a glitch.
    pub value_nm: f64,
}

impl Injected {
    /// Adds what is injected into controller `id` in `tick`. What ends or stops a process comes as a signal from the
    /// supervisor; the process itself injects nothing then.
    pub fn add_to(&self, actions: &mut FaultActions, id: u32, tick: u64) {
        if id != self.target || !(self.first..self.end).contains(&tick) {
            return;
        }
        match self.kind {
            LiveFault::Delay => actions.delay_ns = actions.delay_ns.saturating_add(self.delay_ns),
            LiveFault::Drop => actions.drop = true,
            LiveFault::Nan => actions.nan = true,
            LiveFault::Glitch => actions.glitch = Some((0, self.value_nm)),
            LiveFault::Kill | LiveFault::Hang => {}
        }
    }
}

/// The words. All zero: nothing was ever injected.
#[derive(Debug, Default)]
#[repr(C, align(64))]
pub struct Board {
    version: AtomicU64,
    kind: AtomicU32,
    target: AtomicU32,
    first: AtomicU64,
    end: AtomicU64,
    delay_ns: AtomicU64,
    /// The bits of the value.
    value_nm: AtomicU64,
}

impl Board {
    /// Replaces what was there. For one writer alone: the supervisor.
    pub fn write(&self, fault: &Injected) {
        let version = self.version.load(SeqCst) | 1;
        self.version.store(version, SeqCst);
        self.kind.store(fault.kind.code(), SeqCst);
        self.target.store(fault.target, SeqCst);
        self.first.store(fault.first, SeqCst);
        self.end.store(fault.end, SeqCst);
        self.delay_ns.store(fault.delay_ns, SeqCst);
        self.value_nm.store(fault.value_nm.to_bits(), SeqCst);
        self.version.store(version.wrapping_add(1), SeqCst);
    }

    /// What was written since the version in `seen`, which then is that of what was read; none if there is nothing new, or
    /// nothing whole yet.
    pub fn read_newer(&self, seen: &mut u64) -> Option<Injected> {
        let version = self.version.load(SeqCst);
        if version == *seen || version & 1 != 0 {
            return None;
        }
        let fault = Injected {
            kind: LiveFault::from_code(self.kind.load(SeqCst))?,
            target: self.target.load(SeqCst),
            first: self.first.load(SeqCst),
            end: self.end.load(SeqCst),
            delay_ns: self.delay_ns.load(SeqCst),
            value_nm: f64::from_bits(self.value_nm.load(SeqCst)),
        };
        if self.version.load(SeqCst) != version {
            return None;
        }
        *seen = version;
        Some(fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(n: u64) -> Injected {
        let kind = LiveFault::ALL[usize::try_from(n).unwrap() % LiveFault::ALL.len()];
        Injected { kind, target: u32::try_from(n).unwrap(), first: n, end: 2 * n, delay_ns: 3 * n, value_nm: n as f64 }
    }

    #[test]
    fn a_fault_is_injected_into_its_controller_in_its_ticks_and_in_no_others() {
        let fault = Injected { kind: LiveFault::Delay, target: 2, first: 10, end: 12, delay_ns: 700, value_nm: 3.0 };
        let actions = |fault: &Injected, id: u32, tick: u64| {
            let mut actions = FaultActions { delay_ns: 50, ..FaultActions::default() };
            fault.add_to(&mut actions, id, tick);
            actions
        };
        assert_eq!([9, 10, 11, 12].map(|tick| actions(&fault, 2, tick).delay_ns), [50, 750, 750, 50]);
        assert_eq!(actions(&fault, 1, 10).delay_ns, 50);
        assert!(actions(&Injected { kind: LiveFault::Drop, ..fault }, 2, 10).drop);
        assert_eq!(actions(&Injected { kind: LiveFault::Glitch, ..fault }, 2, 10).glitch, Some((0, 3.0)));
        assert!(actions(&Injected { kind: LiveFault::Nan, ..fault }, 2, 10).nan);
        assert_eq!(actions(&Injected { kind: LiveFault::Kill, ..fault }, 2, 10), actions(&fault, 1, 10));
    }

    #[test]
    fn a_fault_is_read_once_and_a_half_written_one_never() {
        let (board, mut seen) = (Board::default(), 0);
        assert_eq!(board.read_newer(&mut seen), None);
        board.write(&numbered(5));
        assert_eq!(board.read_newer(&mut seen), Some(numbered(5)));
        assert_eq!(board.read_newer(&mut seen), None);
        // As a writer leaves it that was killed in the middle.
        board.version.store(seen + 1, SeqCst);
        board.target.store(77, SeqCst);
        assert_eq!(board.read_newer(&mut seen), None);
        board.write(&numbered(6));
        assert_eq!(board.read_newer(&mut seen), Some(numbered(6)));
    }

    #[test]
    fn no_reader_ever_sees_a_mixture_of_two_faults() {
        const LAST: u64 = 50_000;
        let board = Board::default();
        std::thread::scope(|scope| {
            let reader = scope.spawn(|| {
                let (mut seen, mut count, mut newest) = (0, 0, 0);
                while newest < LAST {
                    if let Some(fault) = board.read_newer(&mut seen) {
                        assert_eq!(fault, numbered(fault.first));
                        assert!(fault.first > newest);
                        (newest, count) = (fault.first, count + 1);
                    }
                }
                count
            });
            (1..=LAST).for_each(|n| board.write(&numbered(n)));
            assert!(reader.join().unwrap() > 0);
        });
    }
}
