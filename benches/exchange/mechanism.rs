//! What is compared with what.

use loopbound_scenario::Wakeup;

/// A way to exchange a state for a torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mechanism {
    /// Copies in shared memory, both ends spin on a word.
    RawSpin,
    /// Copies in shared memory, both ends sleep on a word.
    RawFutex,
    /// iceoryx2's publish-subscribe alone, both ends poll.
    TransportPolled,
    /// iceoryx2's publish-subscribe and its own events.
    TransportEvents,
    /// The project's ports and wake-ups.
    Project(Wakeup),
    /// The same in `hybrid`, with the work of both ends: plant core and law for three links.
    Worked,
    /// The processes of the product in a group, as `loopbound run` starts them.
    Product(Wakeup),
}

/// What a mechanism is measured against, and the ratio of medians that it should not exceed.
pub(crate) struct Baseline {
    pub(crate) mechanism: Mechanism,
    pub(crate) aim: Option<f64>,
}

impl Mechanism {
    /// Every one, in the order in which a round runs them.
    pub(crate) const ALL: [Self; 9] = [
        Self::RawSpin,
        Self::TransportPolled,
        Self::Project(Wakeup::Spin),
        Self::Project(Wakeup::Hybrid),
        Self::RawFutex,
        Self::Project(Wakeup::Block),
        Self::TransportEvents,
        Self::Project(Wakeup::Event),
        Self::Worked,
    ];

    /// Those that make sense with a pause after each exchange: a spinner without time-triggering would be stopped by
    /// the kernel for want of sleep.
    pub(crate) const PACED: [Self; 8] = [
        Self::RawFutex,
        Self::TransportEvents,
        Self::Project(Wakeup::Block),
        Self::Project(Wakeup::Event),
        Self::Project(Wakeup::Hybrid),
        Self::Project(Wakeup::Spin),
        Self::Product(Wakeup::Block),
        Self::Product(Wakeup::Hybrid),
    ];

    /// The name in the table and in JSON.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::RawSpin => "raw spin",
            Self::RawFutex => "raw futex",
            Self::TransportPolled => "iceoryx2 polled",
            Self::TransportEvents => "iceoryx2 events",
            Self::Project(Wakeup::Spin) => "loopbound spin",
            Self::Project(Wakeup::Hybrid) => "loopbound hybrid",
            Self::Project(Wakeup::Block) => "loopbound block",
            Self::Project(Wakeup::Event) => "loopbound event",
            Self::Worked => "hybrid with plant and law",
            Self::Product(Wakeup::Spin) => "loopbound run, spin",
            Self::Product(Wakeup::Hybrid) => "loopbound run, hybrid",
            Self::Product(Wakeup::Block) => "loopbound run, block",
            Self::Product(Wakeup::Event) => "loopbound run, event",
        }
    }

    /// Place in [`Mechanism::ALL`], as it travels to the echo.
    pub(crate) fn index(self) -> u32 {
        Self::ALL.iter().position(|m| *m == self).and_then(|place| u32::try_from(place).ok()).unwrap_or(u32::MAX)
    }

    /// What it is measured against: back to back, the same path without this project; paced, the raw futex.
    pub(crate) fn baseline(self, paced: bool) -> Option<Baseline> {
        let (mechanism, aim) = match self {
            Self::RawSpin | Self::RawFutex => return None,
            Self::Product(Wakeup::Block) => (Self::RawFutex, Some(1.25)),
            _ if paced => (Self::RawFutex, None),
            Self::TransportPolled => (Self::RawSpin, None),
            Self::TransportEvents => (Self::RawFutex, None),
            Self::Project(Wakeup::Spin | Wakeup::Hybrid) => (Self::TransportPolled, Some(1.1)),
            Self::Project(Wakeup::Block) => (Self::RawFutex, Some(1.25)),
            Self::Project(Wakeup::Event) => (Self::TransportEvents, None),
            Self::Worked => (Self::Project(Wakeup::Hybrid), None),
            Self::Product(_) => (Self::RawFutex, None),
        };
        Some(Baseline { mechanism, aim })
    }
}
