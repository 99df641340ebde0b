//! A swap by command, step by step between two looks: wait for the new process, ask the plant, watch what becomes of it,
//! wait for the monitor's account of it. It knows neither processes nor sockets: it looks at a [`View`] and gives an order.
//!
//! ```text
//! Starting ──member──▶ Asked ──switched──▶ Watched ──time over, rolled back──▶ Settling ──account──▶ concluded
//!     └──ended, late, no room──┴──refused, cancelled, no answer──────────────────────────────────▶ concluded
//! ```

use loopbound_monitor::account::{Account, COMPARED_NS};
use loopbound_scenario::Scenario;
use loopbound_shared::event::{CommandKind, Refusal, ReplyKind};
use loopbound_shared::sample::{Command, Reply};

use super::control::{SwapReport, SwapRequest};
use super::starting::READY_NS;

/// How long the monitor's account of a swap is waited for.
const ACCOUNT_NS: u64 = 1_000_000_000;

/// A swap under way.
pub(super) struct Swapping {
    request: SwapRequest,
    asked_ns: u64,
    blend_ns: u64,
    watched_ticks: u64,
    stage: Stage,
    report: SwapReport,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// The new process is starting.
    Starting,
    /// The plant has the command.
    Asked,
    /// Done; may be rolled back until this tick.
    Watched(u64),
    /// Nothing changes any more; the figures are not complete before the monitor has seen this tick.
    Settling { tick: u64, until_ns: u64 },
    /// Only the answer is missing.
    Concluded,
}

/// The controller that is to take over, as a look finds it.
#[derive(Debug, PartialEq)]
pub(super) enum Newcomer {
    /// Not ready yet.
    Starting,
    /// Ready, and the plant would not have it.
    Refused,
    /// The plant knows it.
    Member,
    /// It has ended, with these last words.
    Ended(Option<String>),
}

/// What a swap can see at a look.
pub(super) struct View<'a> {
    pub(super) newcomer: Newcomer,
    /// Nobody waits for the answer any more.
    pub(super) client_left: bool,
    pub(super) active: u32,
    pub(super) tick: u64,
    pub(super) plant_ended: bool,
    /// What the plant says to [`Swapping::question`].
    pub(super) status: Option<&'a Reply>,
    /// What the monitor has left.
    pub(super) account: Option<&'a Account>,
}

/// What the supervisor is to do for a swap.
#[derive(Debug)]
pub(super) enum Order {
    /// Ask the plant, and tell [`Swapping::answered`].
    Ask(Command),
    /// Answer the client with [`Swapping::into_report`].
    Conclude,
}

impl Swapping {
    /// A swap that was asked for just now, of group `group` from the active controller `from` to `to`.
    pub(super) fn new(request: SwapRequest, scenario: &Scenario, group: &str, from: u32, to: u32, now_ns: u64) -> Self {
        let gate = &scenario.swap_gate;
        let blend_ns = request.blend_ns.unwrap_or(gate.blend.ns());
        let watched_ns = gate.rollback_for.ns().max(COMPARED_NS).max(blend_ns);
        Self {
            request,
            asked_ns: now_ns,
            blend_ns,
            watched_ticks: watched_ns.div_ceil(scenario.period_ns()) + 1,
            stage: Stage::Starting,
            report: SwapReport { group: group.to_owned(), from, to, ..SwapReport::default() },
        }
    }

    /// The controller that is to take over.
    pub(super) fn to(&self) -> u32 {
        self.report.to
    }

    /// Whether a process was started for it.
    pub(super) fn has_started_one(&self) -> bool {
        self.request.to.is_none()
    }

    /// What the plant is to be asked before the next look.
    pub(super) fn question(&self) -> Option<Command> {
        matches!(self.stage, Stage::Asked | Stage::Watched(_)).then(|| self.about(CommandKind::SwapStatus))
    }

    fn about(&self, kind: CommandKind) -> Command {
        Command { kind: kind.code(), controller: self.report.to, ..Command::zeroed() }
    }

    /// One look.
    pub(super) fn look(&mut self, now_ns: u64, view: &View<'_>) -> Option<Order> {
        if view.client_left {
            match self.stage {
                Stage::Starting => return self.refuse(Refusal::Cancelled.name()),
                Stage::Asked => return Some(Order::Ask(self.about(CommandKind::CancelSwap))),
                Stage::Watched(_) | Stage::Settling { .. } | Stage::Concluded => {}
            }
        }
        match self.stage {
            Stage::Starting => self.look_at_newcomer(now_ns, view),
            Stage::Asked => self.look_at_asked(now_ns, view),
            Stage::Watched(until_tick) => {
                let kind = view.status.and_then(|reply| ReplyKind::from_code(reply.kind));
                match (kind, view.status) {
                    (Some(ReplyKind::RolledBack), Some(reply)) => self.roll_back(reply, now_ns, view),
                    _ if view.tick <= until_tick && !view.plant_ended => None,
                    _ => {
                        self.report.result = "done".to_owned();
                        self.settle(until_tick.min(view.tick), now_ns, view)
                    }
                }
            }
            Stage::Settling { tick, until_ns } => {
                let complete = view.account.is_some_and(|account| account.tick >= tick);
                if !complete && now_ns < until_ns && !view.plant_ended {
                    return None;
                }
                self.take_figures(view.account);
                self.conclude()
            }
            Stage::Concluded => Some(Order::Conclude),
        }
    }

    fn look_at_newcomer(&mut self, now_ns: u64, view: &View<'_>) -> Option<Order> {
        match &view.newcomer {
            Newcomer::Ended(words) => {
                let said = words.as_ref().map_or_else(String::new, |words| format!(": {words}"));
                self.refuse(&format!("the new process ended before it was ready{said}"))
            }
            Newcomer::Refused => self.refuse("the plant has no room for it"),
            Newcomer::Starting if now_ns < self.asked_ns + READY_NS => None,
            Newcomer::Starting => self.refuse("the new process did not become ready"),
            Newcomer::Member => {
                self.report.from = view.active;
                Some(Order::Ask(Command {
                    tick: self.request.at_tick.unwrap_or(0),
                    ns: self.blend_ns,
                    option: u64::from(self.request.force),
                    ..self.about(CommandKind::Swap)
                }))
            }
        }
    }

    fn look_at_asked(&mut self, now_ns: u64, view: &View<'_>) -> Option<Order> {
        let Some((reply, kind)) = view.status.and_then(|reply| Some((reply, ReplyKind::from_code(reply.kind)?))) else {
            return self.refuse("the plant does not answer");
        };
        match kind {
            ReplyKind::Pending => None,
            ReplyKind::Done => self.watch_from(reply.tick),
            // A failover was faster than the gate: the new one is active, as was asked.
            ReplyKind::Refused if reply.reason == Refusal::AlreadyActive.code() && self.has_started_one() => {
                self.report.reason = Some("a failover gave it authority before the gate did".to_owned());
                self.watch_from(reply.tick)
            }
            ReplyKind::Refused => {
                self.note_reason(reply);
                let reason = self.report.reason.take().unwrap_or_default();
                self.refuse(&reason)
            }
            ReplyKind::RolledBack => self.roll_back(reply, now_ns, view),
        }
    }

    /// What the plant has said to an order; `Err` says why it would not.
    pub(super) fn answered(&mut self, command: Command, answer: Result<Reply, String>) -> Option<Order> {
        let cancelled = command.kind == CommandKind::CancelSwap.code();
        match answer {
            // It was faster than the cancelling: what has happened is watched to its end.
            Ok(reply) if cancelled && reply.kind == ReplyKind::Done.code() => self.watch_from(reply.tick),
            _ if cancelled => self.refuse(Refusal::Cancelled.name()),
            Ok(_) => {
                self.stage = Stage::Asked;
                None
            }
            Err(why) => self.refuse(&why),
        }
    }

    /// The change is done, in this tick or, by a failover, before it.
    fn watch_from(&mut self, tick: u64) -> Option<Order> {
        self.report.tick = tick;
        self.stage = Stage::Watched(tick + self.watched_ticks);
        None
    }

    fn roll_back(&mut self, reply: &Reply, now_ns: u64, view: &View<'_>) -> Option<Order> {
        self.note_reason(reply);
        self.report.result = "rolled back".to_owned();
        self.settle(view.tick, now_ns, view)
    }

    fn note_reason(&mut self, reply: &Reply) {
        let reason = Refusal::from_code(reply.reason).map_or("no reason given", Refusal::name);
        self.report.tick = if self.report.tick == 0 { reply.tick } else { self.report.tick };
        (self.report.value, self.report.limit) = (Some(reply.value), Some(reply.limit));
        self.report.reason = Some(reason.to_owned());
    }

    /// The monitor is a little behind: its account is complete when it has seen `tick`.
    fn settle(&mut self, tick: u64, now_ns: u64, view: &View<'_>) -> Option<Order> {
        self.stage = Stage::Settling { tick, until_ns: now_ns + ACCOUNT_NS };
        self.look(now_ns, view)
    }

    /// Nothing has changed: there is no account to wait for.
    fn refuse(&mut self, why: &str) -> Option<Order> {
        (self.report.result, self.report.reason) = ("refused".to_owned(), Some(why.to_owned()));
        self.conclude()
    }

    fn conclude(&mut self) -> Option<Order> {
        self.stage = Stage::Concluded;
        Some(Order::Conclude)
    }

    fn take_figures(&mut self, account: Option<&Account>) {
        let report = &mut self.report;
        let Some(change) = account.and_then(|account| account.change_to(report.to, report.tick)) else { return };
        // A failover to the same controller before the tick that was asked for is another change.
        if self.request.at_tick.is_some() && change.entry.tick != report.tick {
            return;
        }
        let (entry, around) = (&change.entry, &change.around);
        report.tick = entry.tick;
        (report.missed_ticks, report.delta_v) = (entry.missed_ticks, entry.delta_v);
        report.torque_step_nm.clone_from(&entry.torque_steps_nm);
        (report.torque_difference_nm, report.blended_ticks) = (entry.torque_difference_nm, entry.blended_ticks);
        (report.latency_before_ns, report.latency_after_ns) = (around.latency_before_ns, around.latency_after_ns);
        report.command_to_authority_ns = around.first_accepted_ns.map(|ns| ns.saturating_sub(self.asked_ns));
    }

    /// What is answered; of a refusal before any tick was named, in `tick`.
    pub(super) fn into_report(self, tick: u64) -> SwapReport {
        let mut report = self.report;
        if report.tick == 0 {
            report.tick = tick;
        }
        report
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use loopbound_monitor::account::{Around, Change};
    use loopbound_monitor::summary::SwapSummary;

    const MS: u64 = 1_000_000;

    fn swapping() -> Swapping {
        let request = SwapRequest { law: Some(loopbound_model::law::LawKind::Ctc), ..SwapRequest::default() };
        Swapping::new(request, &Scenario::default(), "g", 1, 2, 5 * MS)
    }

    fn view(newcomer: Newcomer, tick: u64) -> View<'static> {
        View { newcomer, client_left: false, active: 1, tick, plant_ended: false, status: None, account: None }
    }

    fn reply(kind: ReplyKind, tick: u64) -> Reply {
        Reply { kind: kind.code(), tick, ..Reply::zeroed() }
    }

    /// A swap that the plant has carried out in tick 100, and the last tick of its watch.
    fn watched() -> (Swapping, u64) {
        let mut swap = swapping();
        assert!(swap.look(6 * MS, &view(Newcomer::Starting, 10)).is_none());
        assert!(swap.question().is_none(), "the plant has heard of nothing yet");
        let order = swap.look(7 * MS, &view(Newcomer::Member, 20));
        let Some(Order::Ask(command)) = order else { panic!("{order:?}") };
        assert_eq!((command.kind, command.controller), (CommandKind::Swap.code(), 2));
        assert!(swap.answered(command, Ok(reply(ReplyKind::Pending, 20))).is_none());
        assert!(swap.question().is_some());
        let pending = reply(ReplyKind::Pending, 30);
        assert!(swap.look(8 * MS, &View { status: Some(&pending), ..view(Newcomer::Member, 30) }).is_none());
        let done = reply(ReplyKind::Done, 100);
        assert!(swap.look(9 * MS, &View { status: Some(&done), ..view(Newcomer::Member, 101) }).is_none());
        let Stage::Watched(until_tick) = swap.stage else { panic!("{:?}", swap.stage) };
        (swap, until_tick)
    }

    fn account(tick: u64) -> Account {
        let entry = SwapSummary { tick: 100, to: 2, missed_ticks: 3, result: "done".into(), ..SwapSummary::default() };
        let around = Around { first_accepted_ns: Some(25 * MS), ..Around::default() };
        Account { tick, changes: vec![Change { entry, around }] }
    }

    #[test]
    fn a_swap_that_holds_is_answered_with_the_monitors_figures_when_those_are_complete() {
        let (mut swap, until_tick) = watched();
        let done = reply(ReplyKind::Done, 100);
        let (early, complete) = (account(until_tick - 1), account(until_tick));
        let at = |tick, account| View { status: Some(&done), account: Some(account), ..view(Newcomer::Member, tick) };
        assert!(swap.look(10 * MS, &at(until_tick, &complete)).is_none(), "it may still be rolled back");
        assert!(swap.look(11 * MS, &at(until_tick + 1, &early)).is_none(), "the monitor is behind");
        assert!(matches!(swap.look(12 * MS, &at(until_tick + 2, &complete)), Some(Order::Conclude)));
        let report = swap.into_report(0);
        assert_eq!((report.result.as_str(), report.tick, report.missed_ticks), ("done", 100, 3));
        assert_eq!(report.command_to_authority_ns, Some(20 * MS));
    }

    #[test]
    fn a_swap_is_answered_without_figures_if_the_monitor_has_none() {
        let (mut swap, until_tick) = watched();
        assert!(swap.look(10 * MS, &view(Newcomer::Member, until_tick + 1)).is_none());
        let order = swap.look(10 * MS + ACCOUNT_NS, &view(Newcomer::Member, until_tick + 9));
        assert!(matches!(order, Some(Order::Conclude)));
        assert_eq!(swap.into_report(0).command_to_authority_ns, None);
    }

    #[test]
    fn a_rollback_is_told_with_its_reason() {
        let (mut swap, _) = watched();
        let back = Reply { reason: Refusal::Deadlines.code(), ..reply(ReplyKind::RolledBack, 105) };
        let account = account(110);
        let seen = View { status: Some(&back), account: Some(&account), ..view(Newcomer::Member, 110) };
        assert!(matches!(swap.look(10 * MS, &seen), Some(Order::Conclude)));
        let report = swap.into_report(0);
        assert_eq!(
            (report.result.as_str(), report.reason.as_deref()),
            ("rolled back", Some(Refusal::Deadlines.name()))
        );
    }

    #[test]
    fn a_new_process_that_ends_is_late_or_finds_no_room_is_no_swap() {
        for (newcomer, now_ns, because) in [
            (Newcomer::Ended(Some("no such file".into())), 6 * MS, "ended before it was ready: no such file"),
            (Newcomer::Refused, 6 * MS, "no room"),
            (Newcomer::Starting, 5 * MS + READY_NS, "did not become ready"),
        ] {
            let mut swap = swapping();
            assert!(matches!(swap.look(now_ns, &view(newcomer, 10)), Some(Order::Conclude)));
            let report = swap.into_report(77);
            assert_eq!((report.result.as_str(), report.tick), ("refused", 77));
            assert!(report.reason.as_deref().is_some_and(|why| why.contains(because)), "{report:?}");
        }
    }

    #[test]
    fn whoever_asked_and_has_left_cancels_a_swap_that_still_waits_and_none_that_has_happened() {
        let left = |tick| View { client_left: true, ..view(Newcomer::Member, tick) };
        let cancel = |swap: &mut Swapping| match swap.look(10 * MS, &left(50)) {
            Some(Order::Ask(command)) if command.kind == CommandKind::CancelSwap.code() => command,
            other => panic!("{other:?}"),
        };
        let mut swap = swapping();
        swap.stage = Stage::Asked;
        let command = cancel(&mut swap);
        assert!(matches!(swap.answered(command, Err("no swap".into())), Some(Order::Conclude)));
        assert_eq!(swap.into_report(50).reason.as_deref(), Some(Refusal::Cancelled.name()));
        let mut faster = swapping();
        faster.stage = Stage::Asked;
        let command = cancel(&mut faster);
        assert!(faster.answered(command, Ok(reply(ReplyKind::Done, 49))).is_none());
        assert!(faster.look(11 * MS, &left(51)).is_none(), "what has happened is watched to its end");
    }
}
