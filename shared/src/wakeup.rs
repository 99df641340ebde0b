//! How a process of the loop waits for a sample, and how it wakes the one that waits: the four wake-up modes.
//!
//! | mode | waits by |
//! |---|---|
//! | `hybrid` | spinning for a while around the expected instant, then at the doorbell |
//! | `spin` | spinning (it sleeps an eighth of the period, see [`Waiter::may_rest_ns`]) |
//! | `block` | at the doorbell at once |
//! | `event` | iceoryx2's own event, for comparison |

use crate::clock;
use crate::doorbell::{Bell, ControlBlock};
use crate::ports::{Listener, Node, Notifier, PortError};
use loopbound_scenario::Wakeup;

/// How long `hybrid` spins before it goes to the doorbell, ns: several round trips, yet little of a period.
const SPIN_NS: u64 = 60_000;

/// Looks between two looks at the clock while spinning. A look costs about as much as reading the clock, and half a
/// round of the loop is added to every latency; a gap of the host is far longer than four looks.
const LOOKS: u32 = 4;

/// One end of a doorbell, in the group's wake-up mode.
pub struct Waiter {
    mode: Wakeup,
    bell: Bell,
    listener: Option<Listener>,
    spin_ns: u64,
    /// On a machine with one core a spinning process keeps the awaited one from running: it has to give way.
    yields: bool,
}

/// The event service of a doorbell.
const fn service(bell: Bell) -> &'static str {
    match bell {
        Bell::State => "state-event",
        Bell::Torque => "torque-event",
        Bell::Pace => "pace-event",
    }
}

impl Waiter {
    /// The waiting end of `bell`.
    ///
    /// # Errors
    /// In mode `event`, if there is no room for a listener.
    pub fn new(node: &Node, mode: Wakeup, bell: Bell) -> Result<Self, PortError> {
        let listener = if mode == Wakeup::Event { Some(node.listener(service(bell))?) } else { None };
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let spin_ns = if mode == Wakeup::Hybrid && cores > 1 { SPIN_NS } else { 0 };
        Ok(Self { mode, bell, listener, spin_ns, yields: cores == 1 })
    }

    /// Opens the alarm that [`Self::set_end`] sets, where waits of this mode go to the doorbell at once and have an end that is near.
    pub fn open_alarm(&self, block: &ControlBlock) {
        if self.mode == Wakeup::Block {
            // Where the kernel refuses it every wait has a timeout of its own, which costs some microseconds.
            let _ = block.open_alarm(self.bell);
        }
    }

    /// Sets in the slack when the next wait is to look at the clock, so that the wait itself need not.
    pub fn set_end(&self, block: &ControlBlock, at_ns: u64) {
        if self.mode == Wakeup::Block {
            block.set_alarm(at_ns);
        }
    }

    /// Whether a wait of this mode sleeps where nothing comes.
    #[must_use]
    pub fn sleeps(&self) -> bool {
        self.mode != Wakeup::Spin
    }

    /// Whether this mode wakes before the expected instant and spins towards it.
    #[must_use]
    pub fn is_time_triggered(&self) -> bool {
        self.spin_ns > 0 || self.mode == Wakeup::Spin
    }

    /// Looks by `look` until it finds something or the clock passes `until_ns`. What is awaited is expected at
    /// `expected_ns`: `hybrid` spins until a little later. The longest gap between two looks at the clock while
    /// spinning is kept in `gap_ns`: what the host took away.
    pub fn wait<R>(
        &self,
        block: &ControlBlock,
        expected_ns: u64,
        until_ns: u64,
        gap_ns: &mut u64,
        mut look: impl FnMut() -> Option<R>,
    ) -> Option<R> {
        if !self.is_time_triggered() {
            return self.wait_asleep(block, until_ns, look);
        }
        let mut before_ns = clock::now_ns();
        let spin_until_ns = match self.mode {
            Wakeup::Spin => until_ns,
            _ => until_ns.min(expected_ns.max(before_ns) + self.spin_ns),
        };
        loop {
            for _ in 0..LOOKS {
                if let Some(found) = look() {
                    return Some(found);
                }
                self.pause();
            }
            let now_ns = clock::now_ns();
            *gap_ns = (*gap_ns).max(now_ns - before_ns);
            before_ns = now_ns;
            if now_ns >= spin_until_ns {
                break;
            }
        }
        if before_ns >= until_ns { None } else { self.wait_asleep(block, until_ns, look) }
    }

    /// The same without spinning, whatever the mode: for processes that must not take a core.
    pub fn wait_asleep<R>(
        &self,
        block: &ControlBlock,
        until_ns: u64,
        mut look: impl FnMut() -> Option<R>,
    ) -> Option<R> {
        let Some(listener) = &self.listener else { return block.wait(self.bell, until_ns, look) };
        loop {
            if let Some(found) = look() {
                return Some(found);
            }
            let now_ns = clock::now_ns();
            if now_ns >= until_ns {
                return None;
            }
            listener.wait(until_ns - now_ns);
        }
    }

    /// In lockstep: looks, spinning for `spin_ns`, then at the doorbell, whatever the mode. Time is virtual there, so
    /// nothing but speed depends on how one waits.
    pub fn wait_lockstep<R>(
        &self,
        block: &ControlBlock,
        until_ns: u64,
        spin_ns: u64,
        mut look: impl FnMut() -> Option<R>,
    ) -> Option<R> {
        let spin_until_ns = clock::now_ns() + if self.yields { 0 } else { spin_ns };
        loop {
            for _ in 0..8 {
                if let Some(found) = look() {
                    return Some(found);
                }
                self.pause();
            }
            if clock::now_ns() >= spin_until_ns {
                return block.wait(self.bell, until_ns, look);
            }
        }
    }

    /// Spins until `deadline_ns`; returns the stamp that ended it and keeps the longest gap in `gap_ns`.
    pub fn spin_until(&self, deadline_ns: u64, gap_ns: &mut u64) -> u64 {
        let mut before_ns = clock::now_ns();
        while before_ns < deadline_ns {
            self.pause();
            let now_ns = clock::now_ns();
            *gap_ns = (*gap_ns).max(now_ns - before_ns);
            before_ns = now_ns;
        }
        before_ns
    }

    fn pause(&self) {
        if self.yields {
            rustix::thread::sched_yield();
        } else {
            clock::spin_hint();
        }
    }

    /// How long a process in mode `spin` has to sleep each period: a real-time thread that never sleeps is stopped by
    /// the kernel for 50 ms every second.
    #[must_use]
    pub fn may_rest_ns(&self, period_ns: u64) -> u64 {
        if self.mode == Wakeup::Spin { period_ns / 8 } else { 0 }
    }
}

/// Wakes whoever waits, in the group's wake-up mode.
pub struct Ringer {
    bell: Bell,
    notifier: Option<Notifier>,
}

impl Ringer {
    /// The ringing end of `bell`.
    ///
    /// # Errors
    /// In mode `event`, if there is no room for a notifier.
    pub fn new(node: &Node, mode: Wakeup, bell: Bell) -> Result<Self, PortError> {
        let notifier = if mode == Wakeup::Event { Some(node.notifier(service(bell))?) } else { None };
        Ok(Self { bell, notifier })
    }

    /// Publish first, then ring.
    pub fn ring(&self, block: &ControlBlock) {
        match &self.notifier {
            // False: no listener could be reached; it will time out and look by itself.
            Some(notifier) => {
                let _ = notifier.ring();
            }
            None => block.ring(self.bell),
        }
    }
}
