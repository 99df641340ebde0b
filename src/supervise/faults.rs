//! Faults by command: the plant is told which ticks to mark, then the controller is struck.
//!
//! The order matters. What the fault does to a tick is put down to it because the plant has marked that tick, so the plant
//! knows first. What a controller does by itself (delay, drop, nan, glitch) it reads from the control block in its slack; what
//! ends or stops it comes as a signal. One fault at a time.

use loopbound_shared::clock;
use loopbound_shared::event::{CommandKind, LiveFault, Refusal};
use loopbound_shared::fault::board::Injected;
use loopbound_shared::sample::Command;

use super::Supervisor;
use super::child::Child;
use super::control::{Answer, FaultReport, FaultRequest};

/// How long a fault lasts that is not said to last longer or shorter.
const FOR_NS: u64 = 100_000_000;
/// The longest, so that nobody has to wait for ever to inject another.
const FOR_NS_MAX: u64 = 60_000_000_000;
/// The longest delay of a torque.
const DELAY_NS_MAX: u64 = 1_000_000_000;
/// The glitch that is added where none is said, N·m: several times what the default certificate bears.
const GLITCH_NM: f64 = 200.0;
/// From the command to the first tick of what a controller reads in its slack.
const AHEAD_NS: u64 = 5_000_000;
/// What is late because of a fault may come so much after it: a stopped process needs its core again.
const AFTER_NS: u64 = 25_000_000;
/// Time for a killed controller's successor to take over; marking ends when it does.
const SUCCESSION_NS: u64 = 3_000_000_000;

/// The fault under way: one at a time.
#[derive(Debug, Default)]
pub(super) struct Injection {
    until_ns: u64,
    /// The process that was stopped on purpose, and when it goes on.
    hanging: Option<(u32, u64)>,
}

impl Injection {
    fn is_under_way(&self, now_ns: u64) -> bool {
        now_ns < self.until_ns
    }

    /// Time to sleep until whoever was stopped goes on; none if nobody is. The last stretch is spun.
    pub(super) fn until_resumed_ns(&self, now_ns: u64) -> Option<u64> {
        let (_, due_ns) = self.hanging?;
        Some(due_ns.saturating_sub(clock::SPIN_LAST_NS).saturating_sub(now_ns))
    }

    /// Who has to go on, and when exactly, as soon as that is a short wait.
    fn look(&self, now_ns: u64) -> Option<(u32, u64)> {
        self.hanging.filter(|_| self.until_resumed_ns(now_ns) == Some(0))
    }
}

/// A request that makes sense.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Wanted {
    kind: LiveFault,
    for_ns: u64,
    delay_ns: u64,
    value_nm: f64,
}

impl Wanted {
    fn of(request: &FaultRequest, grace_ns: u64, period_ns: u64) -> Result<Self, String> {
        let kind: LiveFault = request.kind.parse().map_err(|e| format!("`{}`: {e}", request.kind))?;
        let no_use = |given: bool, key: &str| if given { Err(format!("{key} is of no use to {kind}")) } else { Ok(()) };
        no_use(request.delay_ns.is_some() && kind != LiveFault::Delay, "a delay")?;
        no_use(request.for_ns.is_some() && kind == LiveFault::Kill, "a length")?;
        no_use(request.value_nm.is_some() && kind != LiveFault::Glitch, "a value")?;
        let value_nm = request.value_nm.unwrap_or(GLITCH_NM);
        if !value_nm.is_finite() {
            return Err("the value is no finite number".to_owned());
        }
        let within = |value_ns: u64, max_ns: u64, key: &str| {
            let fits = (1..=max_ns).contains(&value_ns);
            if fits {
                Ok(value_ns)
            } else {
                Err(format!("{key} is more than 0 and at most {} s", max_ns / clock::NS_PER_S))
            }
        };
        // Beyond the grace, as the scenario's `late` is.
        let late_ns = grace_ns.saturating_add(period_ns / 10);
        Ok(Self {
            kind,
            for_ns: within(request.for_ns.unwrap_or(FOR_NS), FOR_NS_MAX, "the length")?,
            delay_ns: within(request.delay_ns.unwrap_or(late_ns.min(DELAY_NS_MAX)), DELAY_NS_MAX, "the delay")?,
            value_nm,
        })
    }

    /// For how long ticks are marked, ns.
    fn marked_ns(&self) -> u64 {
        match self.kind {
            LiveFault::Kill => SUCCESSION_NS,
            LiveFault::Hang => self.for_ns + AFTER_NS,
            LiveFault::Delay => self.for_ns + self.delay_ns,
            LiveFault::Drop | LiveFault::Nan | LiveFault::Glitch => self.for_ns,
        }
    }
}

impl Supervisor<'_> {
    /// Injects a fault, and says what came of it.
    pub(super) fn inject(&mut self, request: &FaultRequest) -> Answer {
        let period_ns = self.scenario.period_ns();
        let wanted = match Wanted::of(request, self.scenario.loop_.grace_ns(), period_ns) {
            Ok(wanted) => wanted,
            Err(why) => return Answer::Usage(why),
        };
        let target = request.controller.unwrap_or(self.active);
        let lasts = wanted.kind != LiveFault::Kill;
        let mut report = FaultReport {
            group: self.group.name().to_owned(),
            kind: wanted.kind.name().to_owned(),
            controller: target,
            tick: self.tick(),
            for_ns: lasts.then_some(wanted.for_ns),
            delay_ns: (wanted.kind == LiveFault::Delay).then_some(wanted.delay_ns),
            value_nm: (wanted.kind == LiveFault::Glitch).then_some(wanted.value_nm),
            ..FaultReport::default()
        };
        let done = self.strike(wanted, target);
        report.result = if done.is_ok() { "done" } else { "refused" }.to_owned();
        match done {
            Ok(first) => {
                report.tick = first;
                let ticks = report.for_ns.unwrap_or(0).div_ceil(period_ns);
                report.cut_short = first.saturating_add(ticks) > self.end_tick();
            }
            Err(why) => report.reason = Some(why),
        }
        let why = report.reason.as_ref().map_or_else(String::new, |why| format!(": {why}"));
        self.note(&format!(
            "fault {} of controller {target} in tick {}: {}{why}",
            report.kind, report.tick, report.result
        ));
        Answer::Fault(Box::new(report))
    }

    /// Returns the first tick that it can show in.
    fn strike(&mut self, wanted: Wanted, target: u32) -> Result<u64, String> {
        let now_ns = clock::now_ns();
        if self.injection.is_under_way(now_ns) {
            return Err("another fault is under way".to_owned());
        }
        let known = |child: &&Child| child.process.id == target && child.ready() && child.member;
        let pid = self.controllers().find(known).map(|child| child.pid).ok_or("no such controller")?;
        let period_ns = self.scenario.period_ns();
        let by_itself = !matches!(wanted.kind, LiveFault::Kill | LiveFault::Hang);
        let ahead = if by_itself { AHEAD_NS.div_ceil(period_ns) + 2 } else { 0 };
        if self.tick() + ahead >= self.end_tick() {
            return Err(Refusal::BeyondEnd.name().to_owned());
        }
        let reply = self.command(Command {
            kind: CommandKind::Fault.code(),
            controller: target,
            tick: self.tick() + ahead,
            ns: wanted.marked_ns(),
            option: u64::from(wanted.kind.code()),
            ..Command::zeroed()
        })?;
        let first = reply.tick;
        self.injection.until_ns = now_ns + ahead * period_ns;
        match wanted.kind {
            LiveFault::Delay | LiveFault::Drop | LiveFault::Nan | LiveFault::Glitch => {
                let end = first + wanted.for_ns.div_ceil(period_ns);
                let Wanted { kind, delay_ns, value_nm, .. } = wanted;
                self.block.faults().write(&Injected { kind, target, first, end, delay_ns, value_nm });
                self.injection.until_ns += wanted.for_ns;
            }
            LiveFault::Kill => self.to_process(pid, Child::kill),
            LiveFault::Hang => {
                self.to_process(pid, Child::stop);
                let until_ns = clock::now_ns() + wanted.for_ns;
                self.injection.hanging = Some((pid, until_ns));
                self.injection.until_ns = until_ns;
            }
        }
        Ok(first)
    }

    fn to_process(&self, pid: u32, act: impl Fn(&Child)) {
        self.children.iter().filter(|child| child.pid == pid).for_each(act);
    }

    /// Lets go on who was stopped for long enough.
    pub(super) fn resume_due(&mut self) {
        if let Some((_, at_ns)) = self.injection.look(clock::now_ns()) {
            clock::wait_until_ns(at_ns);
            self.resume();
        }
    }

    /// Lets go on who was stopped: at the end of the group a stopped process could not end in order.
    pub(super) fn resume(&mut self) {
        if let Some((pid, _)) = self.injection.hanging.take() {
            self.to_process(pid, Child::resume);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted(request: &FaultRequest) -> Result<Wanted, String> {
        Wanted::of(request, 500_000, 1_000_000)
    }

    fn of(kind: &str) -> FaultRequest {
        FaultRequest { kind: kind.into(), ..FaultRequest::default() }
    }

    #[test]
    fn a_fault_without_numbers_is_late_enough_to_be_missed_and_ends_by_itself() {
        let delay = wanted(&of("delay")).unwrap();
        assert_eq!((delay.kind, delay.delay_ns, delay.for_ns), (LiveFault::Delay, 600_000, FOR_NS));
        assert!(LiveFault::ALL.iter().all(|kind| wanted(&of(kind.name())).is_ok()));
    }

    #[test]
    fn what_makes_no_sense_is_refused_by_name() {
        let (some, far) = (Some(1_000), Some(u64::MAX));
        for (request, named) in [
            (of("dely"), "delay drop nan kill hang glitch"),
            (FaultRequest { delay_ns: some, ..of("drop") }, "delay"),
            (FaultRequest { for_ns: some, ..of("kill") }, "length"),
            (FaultRequest { value_nm: Some(1.0), ..of("hang") }, "value"),
            (FaultRequest { value_nm: Some(f64::NAN), ..of("glitch") }, "finite"),
            (FaultRequest { for_ns: far, ..of("hang") }, "60 s"),
            (FaultRequest { for_ns: Some(0), ..of("nan") }, "more than 0"),
            (FaultRequest { delay_ns: far, ..of("delay") }, "1 s"),
        ] {
            let why = wanted(&request).unwrap_err();
            assert!(why.contains(named), "{request:?}: {why}");
        }
    }

    #[test]
    fn ticks_are_marked_for_as_long_as_the_fault_may_show() {
        assert_eq!(wanted(&FaultRequest { for_ns: Some(7), ..of("drop") }).unwrap().marked_ns(), 7);
        let delay = FaultRequest { for_ns: Some(7), delay_ns: Some(5), ..of("delay") };
        assert_eq!(wanted(&delay).unwrap().marked_ns(), 12);
        assert!(wanted(&of("hang")).unwrap().marked_ns() > FOR_NS);
    }

    #[test]
    fn whoever_was_stopped_goes_on_when_its_time_is_over_and_one_fault_ends_before_the_next() {
        let injection = Injection { until_ns: 90_000_000, hanging: Some((7, 90_000_000)) };
        assert!(injection.is_under_way(89_999_999) && !injection.is_under_way(90_000_000));
        let spin_ns = 90_000_000 - clock::SPIN_LAST_NS;
        assert_eq!(injection.look(spin_ns - 1), None);
        assert_eq!(injection.until_resumed_ns(spin_ns - 1), Some(1));
        assert_eq!(injection.look(spin_ns), Some((7, 90_000_000)));
        assert_eq!(Injection::default().until_resumed_ns(0), None);
    }
}
