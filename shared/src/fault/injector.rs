//! Injects the faults of one process into what it does: its own time, its clock, its numbers, and what it publishes.
//!
//! | what | in real time | in lockstep |
//! |---|---|---|
//! | kill | the process kills itself | the same |
//! | hang, delay | it waits | a torque is marked; any other process waits for a hang, which costs no virtual time |
//! | nan, glitch | the numbers of the sample | the same |
//! | drop, duplicate, reorder, rogue | samples are left out, repeated, held back or added | a torque is marked; a setpoint is never dropped |
//! | clock step | the stamps | the same |
//!
//! In lockstep the plant waits for one answer of every controller in every tick. So a torque carries *marks*: what would have
//! happened to it in real time. `mark` writes them and `arrivals` reads them, which makes two runs bit-identical.

use loopbound_scenario::{Mode, Role, Scenario};

use super::board::{Board, Injected};
use super::{FaultActions, FaultPlan};
use crate::clock;
use crate::role::kill_self;
use crate::sample::{Setpoint, State, Torque, torque_flag};

/// The number under which a rogue publishes: no controller ever has it.
pub const ROGUE_WRITER: u32 = u32::MAX;

/// What a process publishes, as far as faults change it.
pub trait Sample: Copy {
    /// Whether lockstep waits for one in every tick, so that it carries marks instead.
    const CARRIES_MARKS: bool = false;

    /// The numbers that a fault may spoil, one a link.
    fn values(&mut self) -> &mut [f64];

    /// Marks that it is withheld, and in lockstep what would happen to it in real time.
    fn mark(&mut self, _actions: &FaultActions, _in_lockstep: bool) {}

    /// The same sample of a stranger, with `value_nm` on every link.
    fn of_a_rogue(&self, _value_nm: f64) -> Option<Self> {
        None
    }
}

impl Sample for Setpoint {
    fn values(&mut self) -> &mut [f64] {
        &mut self.q_d[..self.links as usize]
    }
}

impl Sample for State {
    fn values(&mut self) -> &mut [f64] {
        &mut self.q[..self.links as usize]
    }
}

impl Sample for Torque {
    const CARRIES_MARKS: bool = true;

    fn values(&mut self) -> &mut [f64] {
        &mut self.tau[..self.links as usize]
    }

    fn mark(&mut self, actions: &FaultActions, in_lockstep: bool) {
        if actions.drop || actions.hang_ns > 0 {
            self.flags |= torque_flag::WITHHELD;
        }
        if in_lockstep {
            mark(self, actions);
        }
    }

    fn of_a_rogue(&self, value_nm: f64) -> Option<Self> {
        let mut rogue = Self { writer: ROGUE_WRITER, flags: 0, ..*self };
        rogue.values().fill(value_nm);
        Some(rogue)
    }
}

/// A monitor publishes nothing that a fault could change.
impl Sample for () {
    fn values(&mut self) -> &mut [f64] {
        &mut []
    }
}

/// Injects the faults of one process. Allocates at construction only.
#[derive(Clone, Debug)]
pub struct Injector<T> {
    plan: FaultPlan,
    id: u32,
    in_lockstep: bool,
    /// The newest fault that was injected by command, and the board's version then.
    commanded: Option<Injected>,
    board_seen: u64,
    /// How far the stamps of this process are off.
    clock_off_ns: i64,
    /// A sample that is published after its successor.
    held_back: Option<T>,
}

impl<T: Sample> Injector<T> {
    /// The faults that a scenario has for the process `id` of `role`.
    #[must_use]
    pub fn new(scenario: &Scenario, role: Role, id: u32) -> Self {
        Self {
            plan: FaultPlan::for_target(scenario, role, id),
            id,
            in_lockstep: scenario.loop_.mode == Mode::Lockstep,
            commanded: None,
            board_seen: 0,
            clock_off_ns: 0,
            held_back: None,
        }
    }

    /// Looks for a fault that was injected by command since the last look.
    pub fn read_board(&mut self, board: &Board) {
        self.commanded = board.read_newer(&mut self.board_seen).or(self.commanded);
    }

    /// Whether the scenario has no fault for this process.
    #[must_use]
    pub fn has_no_plan(&self) -> bool {
        self.plan.is_empty()
    }

    /// What is injected in a tick.
    #[must_use]
    pub fn at_tick(&self, tick: u64) -> FaultActions {
        let mut actions = self.plan.at_tick(tick);
        if let Some(commanded) = &self.commanded {
            commanded.add_to(&mut actions, self.id, tick);
        }
        actions
    }

    /// Injects what takes time or ends the process. A delay counts from here: what came before takes its own time.
    pub fn take_time(&self, actions: &FaultActions) {
        if actions.kill {
            kill_self();
        }
        let pause_ns = match (self.in_lockstep, T::CARRIES_MARKS) {
            (false, _) => actions.pause_ns(),
            (true, false) => actions.hang_ns,
            (true, true) => 0,
        };
        if pause_ns > 0 {
            clock::wait_until_ns(clock::now_ns().saturating_add(pause_ns));
        }
    }

    /// Steps the clock by which this process stamps.
    pub fn step_clock(&mut self, actions: &FaultActions) {
        self.clock_off_ns = self.clock_off_ns.saturating_add(actions.clock_step_ns);
    }

    /// The stamp of an instant by the clock of this process.
    #[must_use]
    pub fn stamp_ns(&self, now_ns: u64) -> u64 {
        now_ns.saturating_add_signed(self.clock_off_ns)
    }

    /// Changes the numbers of a sample, and marks it.
    pub fn spoil(&self, sample: &mut T, actions: &FaultActions) {
        actions.spoil(sample.values());
        sample.mark(actions, self.in_lockstep);
    }

    /// Publishes a sample through `send`, and what a fault makes of it: nothing, a second one, one that was held back, a rogue's.
    pub fn publish(&mut self, sample: T, actions: &FaultActions, mut send: impl FnMut(T)) {
        if let Some(rogue) = actions.rogue_nm.and_then(|value_nm| sample.of_a_rogue(value_nm)) {
            send(rogue);
        }
        // Lockstep waits for every sample: without it the run would stop.
        if actions.drop && !self.in_lockstep {
            return;
        }
        if actions.reorder {
            // Of two in a row the older goes now: it is late enough.
            if let Some(older) = self.held_back.replace(sample) {
                send(older);
            }
            return;
        }
        send(sample);
        if actions.duplicate {
            send(sample);
        }
        if let Some(older) = self.held_back.take() {
            send(older);
        }
    }
}

/// Marks on a torque what would happen to it in real time.
fn mark(torque: &mut Torque, actions: &FaultActions) {
    let flag = |injected: bool, flag: u32| if injected { flag } else { 0 };
    torque.virtual_delay_ns = actions.delay_ns;
    torque.flags |= flag(actions.duplicate, torque_flag::TWICE)
        | flag(actions.reorder, torque_flag::WITHHELD | torque_flag::AFTER_ITS_TIME)
        | flag(actions.rogue_nm.is_some(), torque_flag::ROGUE);
}

/// What comes with a marked torque, beside itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// The torque.
    pub torque: Torque,
    /// Whether it comes in its own tick, or when that is over.
    pub in_its_tick: bool,
}

/// Reads the marks of a torque: what would have come with it in real time, in the order in which it comes.
pub fn arrivals(torque: &Torque) -> impl Iterator<Item = Arrival> + use<> {
    let rogue = Torque { writer: ROGUE_WRITER, flags: 0, ..*torque };
    let marks = [
        (torque_flag::TWICE, Arrival { torque: *torque, in_its_tick: true }),
        (torque_flag::AFTER_ITS_TIME, Arrival { torque: *torque, in_its_tick: false }),
        (torque_flag::ROGUE, Arrival { torque: rogue, in_its_tick: true }),
    ];
    let flags = torque.flags;
    marks.into_iter().filter(move |(flag, _)| flags & flag != 0).map(|(_, arrival)| arrival)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn injector<T: Sample>(mode: &str, role: Role, fault: &str) -> Injector<T> {
        let text = format!("[loop]\nmode = \"{mode}\"\n[[fault]]\ntarget = \"{role}\"\n{fault}");
        Injector::new(&Scenario::from_toml(&text, "test").unwrap(), role, 1)
    }

    fn torque(tick: u64) -> Torque {
        Torque { tick, writer: 1, links: 3, tau: [1.0; 7], ..Torque::zeroed() }
    }

    /// The ticks of what goes out for ticks 8 to 13, in order; a rogue's as 0.
    fn published(fault: &str) -> Vec<u64> {
        let mut injector = injector::<Torque>("realtime", Role::Controller, fault);
        let mut sent = Vec::new();
        for tick in 8..14 {
            let actions = injector.at_tick(tick);
            let send = |torque: Torque| sent.push(if torque.writer == ROGUE_WRITER { 0 } else { torque.tick });
            injector.publish(torque(tick), &actions, send);
        }
        sent
    }

    #[test]
    fn samples_are_left_out_repeated_held_back_and_added() {
        assert_eq!(published("kind = \"drop\"\nat = 10\nfor = 2"), [8, 9, 12, 13]);
        assert_eq!(published("kind = \"duplicate\"\nat = 10"), [8, 9, 10, 10, 11, 12, 13]);
        assert_eq!(published("kind = \"reorder\"\nat = 10"), [8, 9, 11, 10, 12, 13]);
        assert_eq!(published("kind = \"reorder\"\nat = 10\nfor = 2"), [8, 9, 10, 12, 11, 13]);
        assert_eq!(published("kind = \"rogue\"\nat = 10"), [8, 9, 0, 10, 11, 12, 13]);
    }

    #[test]
    fn every_process_publishes_through_the_same_faults() {
        for fault in ["kind = \"drop\"\nat = 10", "kind = \"duplicate\"\nat = 10", "kind = \"reorder\"\nat = 10"] {
            let mut plant = injector::<State>("realtime", Role::Plant, fault);
            let mut reference = injector::<Setpoint>("realtime", Role::Reference, fault);
            let (mut states, mut setpoints) = (Vec::new(), Vec::new());
            for tick in 8..14 {
                let actions = plant.at_tick(tick);
                plant.publish(State { tick, ..State::zeroed() }, &actions, |state| states.push(state.tick));
                let setpoint = Setpoint { tick, ..Setpoint::zeroed() };
                reference.publish(setpoint, &actions, |setpoint| setpoints.push(setpoint.tick));
            }
            assert_eq!((&states, &setpoints), (&published(fault), &published(fault)), "{fault}");
        }
    }

    #[test]
    fn in_lockstep_a_torque_says_what_would_happen_to_it_and_a_setpoint_is_never_dropped() {
        for (fault, arrived) in [
            ("duplicate", vec![(1, true)]),
            ("reorder", vec![(1, false)]),
            ("rogue", vec![(ROGUE_WRITER, true)]),
            ("drop", vec![]),
        ] {
            let injector = injector::<Torque>("lockstep", Role::Controller, &format!("kind = \"{fault}\"\nat = 10"));
            let mut marked = torque(10);
            injector.spoil(&mut marked, &injector.at_tick(10));
            let found = arrivals(&marked).map(|arrival| (arrival.torque.writer, arrival.in_its_tick));
            assert_eq!(found.collect::<Vec<_>>(), arrived, "{fault}");
            assert_eq!(arrivals(&torque(10)).count(), 0);
        }
        let mut reference = injector::<Setpoint>("lockstep", Role::Reference, "kind = \"drop\"\nat = 10");
        let actions = reference.at_tick(10);
        let mut sent = 0;
        reference.publish(Setpoint::zeroed(), &actions, |_| sent += 1);
        assert!(actions.drop && sent == 1);
    }

    #[test]
    fn only_a_torque_answers_for_its_hang_in_lockstep() {
        let fault = "kind = \"hang\"\nat = 10\nfor = \"2ms\"";
        let took_ns = |take_time: &dyn Fn()| {
            let from_ns = clock::now_ns();
            take_time();
            clock::now_ns() - from_ns
        };
        let plant = injector::<State>("lockstep", Role::Plant, fault);
        assert!(took_ns(&|| plant.take_time(&plant.at_tick(10))) >= 2_000_000);
        let forever = injector::<Torque>("lockstep", Role::Controller, "kind = \"hang\"\nat = 10");
        // It returns at all.
        forever.take_time(&forever.at_tick(10));
    }

    #[test]
    fn a_stepped_clock_changes_every_later_stamp_and_numbers_are_spoilt_within_the_links() {
        let mut injector =
            injector::<Torque>("realtime", Role::Controller, "kind = \"clock-step\"\nat = 10\nstep = \"-5us\"");
        let stamps = [9, 10, 11].map(|tick| {
            injector.step_clock(&injector.at_tick(tick));
            injector.stamp_ns(7_000)
        });
        assert_eq!(stamps, [7_000, 2_000, 2_000]);
        let mut values = [1.0; 3];
        FaultActions { glitch: Some((6, -4.0)), ..FaultActions::default() }.spoil(&mut values);
        assert_eq!(values.map(f64::to_bits), [1.0, 1.0, -3.0].map(f64::to_bits));
    }
}
