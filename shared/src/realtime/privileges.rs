//! What a process had of what it asked for at its real-time start-up, in a form that travels through shared memory.
//!
//! A refusal is data, not an error: a group without privileges runs, and its report says what that costs.

use std::fmt;

use iceoryx2::prelude::ZeroCopySend;
use serde::ser::{Serialize, SerializeMap, Serializer};

/// One step of the start-up of a real-time process, in the order in which they are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The thread is bound to one core.
    Affinity,
    /// Timers of the thread may not be delayed (1 ns slack instead of 50 µs).
    TimerSlack,
    /// `RLIMIT_RTTIME` ends a real-time process that spins without ever sleeping.
    RunawayGuard,
    /// The thread is scheduled by `SCHED_FIFO`.
    SchedFifo,
    /// All pages mapped by then are locked in memory; later ones too, where no limit could refuse them.
    LockMemory,
    /// The stack that the loop will need is mapped.
    PrefaultStack,
    /// The shared memory of the group is mapped page by page.
    PrefaultShared,
    /// `/dev/cpu_dma_latency` is held at 0, so that idle cores don't halt.
    DmaLatency,
}

/// The steps in the order of [`Privileges::steps`].
pub const STEPS: [Step; 8] = [
    Step::Affinity,
    Step::TimerSlack,
    Step::RunawayGuard,
    Step::SchedFifo,
    Step::LockMemory,
    Step::PrefaultStack,
    Step::PrefaultShared,
    Step::DmaLatency,
];

impl Step {
    /// The name in JSON; part of the file format.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Affinity => "affinity",
            Self::RunawayGuard => "runaway_guard",
            Self::SchedFifo => "sched_fifo",
            Self::LockMemory => "lock_memory",
            Self::PrefaultStack => "prefault_stack",
            Self::PrefaultShared => "prefault_shared",
            Self::DmaLatency => "dma_latency",
            Self::TimerSlack => "timer_slack",
        }
    }

    /// What it costs not to have it.
    #[must_use]
    pub const fn cost(self) -> &'static str {
        match self {
            Self::Affinity => "the loop may move between cores, and each move starts with cold caches",
            Self::RunawayGuard => "a loop that spins without end can hold its core until it is killed",
            Self::SchedFifo => "other processes can preempt the loop",
            Self::LockMemory => "pages can be reclaimed, and touching one again stalls the loop",
            Self::PrefaultStack => "the first deep call takes page faults inside the loop",
            Self::PrefaultShared => "the first pass over each shared page takes a page fault inside the loop",
            Self::DmaLatency => "idle cores halt, and waking one costs tens of microseconds",
            Self::TimerSlack => "without SCHED_FIFO, sleeps may end up to 50 us late",
        }
    }

    /// What an administrator does to have it.
    #[must_use]
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::Affinity => "name a core of `taskset -cp $$` in realtime.cores",
            Self::RunawayGuard => "`ulimit -R unlimited` in the shell that starts the group",
            Self::SchedFifo => {
                "`sudo prlimit --rtprio=99 --pid $$`, or run as root; if root is refused too, see `loopbound doctor`"
            }
            Self::LockMemory => "`sudo prlimit --memlock=unlimited --pid $$`, or run as root",
            Self::PrefaultStack => "`ulimit -s 8192` in the shell that starts the group",
            Self::PrefaultShared => "a kernel from 5.14 on and room in /dev/shm (`df -h /dev/shm`)",
            Self::DmaLatency => "`sudo chmod o+rw /dev/cpu_dma_latency`, or run as root",
            Self::TimerSlack => "run outside the sandbox that forbids prctl",
        }
    }
}

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Nobody asked for it.
    NotAsked,
    /// It is in force.
    Had,
    /// The system refused it, with this error number.
    Refused(u32),
}

/// The code of [`Outcome::Had`]; error numbers are far below.
const HAD: u32 = 1 << 31;
/// The value of [`Privileges::core`] that means "not bound to one core".
pub const CORE_NONE: u32 = u32::MAX;

impl Outcome {
    const fn from_code(code: u32) -> Self {
        match code {
            0 => Self::NotAsked,
            HAD => Self::Had,
            errno => Self::Refused(errno),
        }
    }

    const fn code(self) -> u32 {
        match self {
            Self::NotAsked => 0,
            Self::Had => HAD,
            Self::Refused(errno) => errno,
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAsked => f.write_str("not asked"),
            Self::Had => f.write_str("had"),
            Self::Refused(errno) => {
                let error = std::io::Error::from_raw_os_error(i32::try_from(*errno).unwrap_or(i32::MAX));
                write!(f, "refused: {error}")
            }
        }
    }
}

/// The outcome of every step; by default nothing was asked.
///
/// Any bit pattern is a valid value, so what a stranger wrote into shared memory can be displayed without a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ZeroCopySend)]
#[repr(C)]
#[type_name("loopbound.Privileges.1")]
pub struct Privileges {
    /// The priority in force under `SCHED_FIFO`, 1..=99, or 0 for `SCHED_OTHER`.
    pub priority: u32,
    /// The one core that the thread is bound to, or [`CORE_NONE`].
    pub core: u32,
    /// One code a step, in the order of [`STEPS`]; read them by [`Privileges::outcome`].
    pub steps: [u32; STEPS.len()],
}

const _: () = assert!(size_of::<Privileges>() == 40 && align_of::<Privileges>() == 4);

impl Default for Privileges {
    fn default() -> Self {
        Self { priority: 0, core: CORE_NONE, steps: [0; STEPS.len()] }
    }
}

impl Privileges {
    /// How `step` ended.
    #[must_use]
    pub const fn outcome(&self, step: Step) -> Outcome {
        Outcome::from_code(self.steps[step as usize])
    }

    /// Notes how `step` ended.
    pub const fn note(&mut self, step: Step, outcome: Outcome) {
        self.steps[step as usize] = outcome.code();
    }

    /// The steps that were asked for and refused, in order.
    pub fn refused(&self) -> impl Iterator<Item = (Step, u32)> + '_ {
        STEPS.iter().filter_map(|&step| match self.outcome(step) {
            Outcome::Refused(errno) => Some((step, errno)),
            Outcome::Had | Outcome::NotAsked => None,
        })
    }

    /// Whether everything that was asked for is in force.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.refused().next().is_none()
    }
}

/// One line for what is in force, then one for each refusal: what it costs, and what mends it.
impl fmt::Display for Privileges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut had = STEPS.iter().filter(|&&step| self.outcome(step) == Outcome::Had).peekable();
        f.write_str("in force: ")?;
        if had.peek().is_none() {
            f.write_str("none")?;
        }
        let mut separator = "";
        for step in had {
            write!(f, "{separator}{}", step.name())?;
            match step {
                Step::SchedFifo => write!(f, " {}", self.priority)?,
                Step::Affinity if self.core != CORE_NONE => write!(f, " cpu{}", self.core)?,
                _ => {}
            }
            separator = ", ";
        }
        for (step, errno) in self.refused() {
            write!(f, "\nno {} ({}): {}; mend: {}", step.name(), Outcome::Refused(errno), step.cost(), step.remedy())?;
        }
        Ok(())
    }
}

/// `{"priority": 80, "core": 0 | null, "complete": true, "sched_fifo": "had" | "not asked" | "refused: …", …}`
impl Serialize for Privileges {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(3 + STEPS.len()))?;
        map.serialize_entry("priority", &self.priority)?;
        map.serialize_entry("core", &(self.core != CORE_NONE).then_some(self.core))?;
        map.serialize_entry("complete", &self.is_complete())?;
        for step in STEPS {
            map.serialize_entry(step.name(), &self.outcome(step).to_string())?;
        }
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_order_of_the_table_is_the_order_of_the_enum() {
        for (index, step) in STEPS.iter().enumerate() {
            assert_eq!(*step as usize, index, "{step:?}");
        }
    }

    #[test]
    fn every_outcome_survives_its_code() {
        for outcome in [Outcome::NotAsked, Outcome::Had, Outcome::Refused(1), Outcome::Refused(133)] {
            assert_eq!(Outcome::from_code(outcome.code()), outcome);
        }
    }

    #[test]
    fn a_refusal_says_its_cost_and_its_remedy() {
        let mut privileges = Privileges { priority: 0, core: 1, ..Privileges::default() };
        privileges.note(Step::Affinity, Outcome::Had);
        privileges.note(Step::SchedFifo, Outcome::Refused(1));
        let text = privileges.to_string();
        assert!(text.starts_with("in force: affinity cpu1\n"), "{text}");
        assert!(text.contains("no sched_fifo (refused: Operation not permitted"), "{text}");
        assert!(text.contains("other processes can preempt the loop; mend: `sudo prlimit --rtprio"), "{text}");
        assert!(!text.contains("dma_latency"), "what was not asked for is no complaint: {text}");
        assert!(!privileges.is_complete());
    }

    #[test]
    fn the_json_form_names_every_step() {
        let mut privileges = Privileges { priority: 80, ..Privileges::default() };
        privileges.note(Step::SchedFifo, Outcome::Had);
        let json = serde_json::to_value(privileges).unwrap();
        assert_eq!(json["sched_fifo"], "had");
        assert_eq!(json["dma_latency"], "not asked");
        assert_eq!(json["core"], serde_json::Value::Null);
        assert_eq!(json["complete"], true);
        assert_eq!(json.as_object().unwrap().len(), 3 + STEPS.len());
    }

    #[test]
    fn values_written_by_a_stranger_are_displayed_and_not_trusted() {
        let hostile = Privileges { priority: u32::MAX, core: u32::MAX - 1, steps: [u32::MAX; STEPS.len()] };
        assert!(!hostile.is_complete());
        assert_eq!(hostile.to_string().lines().count(), 1 + STEPS.len());
    }
}
