//! The monitor as a process: attach, drain, judge, report, leave.
//!
//! It runs at the ordinary priority, polls and is never a listener, so that the loop does not feel it. It ends with
//! the plant's last record, with the plant, on the stop flag, after its time, or when the group has died.

mod outputs;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};

use loopbound_model::with_links;
use loopbound_scenario::Mode;
use loopbound_shared::clock::{now_ns, seconds, sleep_ns, sleep_until_ns_or_signal, wall_time};
use loopbound_shared::doorbell::{Bell, ControlBlock};
use loopbound_shared::event::{MessageKind, Phase, Role};
use loopbound_shared::fault::Injector;
use loopbound_shared::group::file_of;
use loopbound_shared::ports::{Announces, Publisher, Subscriber};
use loopbound_shared::realtime::{Privileges, die_with_parent};
use loopbound_shared::role::{Joined, RoleArgs, RoleError, announce, build_id, join};
use loopbound_shared::sample::{Announce, TickRecord, record_flag};
use loopbound_shared::say;
use loopbound_shared::topics::Topic;

use crate::account::Accountant;
use crate::files::{LOST_FILE, Place, Recorder};
use crate::handover::Handover as _;
use crate::judge::Judge;
use crate::live::{Address, Live, Origin};
use crate::members::Members;
use crate::summary::Summary;
use crate::tracker::{Config, Tracker};
use crate::verdict::expectations::{judge, validate};
use crate::verdict::{Interim, judge_summary};
use outputs::{about, claim, report, serve, take};

/// Ticks that the plant may be ahead of a managed monitor: three quarters of the subscriber's buffer.
const CREDIT_TICKS: u64 = 1536;
/// Records between two looks at everything else.
const BATCH_MAX: usize = 256;
/// Interval between two looks at what changes seldom: members, announcements.
const CARE_NS: u64 = 20_000_000;
/// Records that were sent just before the plant ended arrive within this time.
const DRAIN_NS: u64 = 50_000_000;
/// Silence of a dead plant after which there is no group.
const DEAD_SILENCE_NS: u64 = 300_000_000;
/// Silence, without a plant that lives, after which there is no group.
const SILENCE_NS: u64 = 10_000_000_000;
/// How long a group that is just being started is waited for.
pub(crate) const START_NS: u64 = 10_000_000_000;
/// Between two attempts to join it.
const JOIN_AGAIN_NS: u64 = 20_000_000;
/// Length of the intervals of `latency.hlog`.
const INTERVAL_NS: u64 = 1_000_000_000;

/// How a monitor is started.
#[derive(Clone, Debug, Default)]
pub struct MonitorArgs {
    /// Name of the group.
    pub group: String,
    /// Id among the monitors.
    pub id: u32,
    /// The scenario; without it the group's own.
    pub scenario: Option<PathBuf>,
    /// The supervisor: if it dies, the monitor ends.
    pub parent: Option<u32>,
    /// Where the files of the run go.
    pub out: Option<PathBuf>,
    /// Print JSON instead of the report (only when not managed).
    pub json: bool,
    /// Say errors alone.
    pub quiet: bool,
    /// Started by the launcher: grants credit, leaves `summary.json` in the group's folder, prints nothing.
    pub managed: bool,
    /// Leave after this time.
    pub duration_ns: Option<u64>,
    /// Where the group is served to Foxglove.
    pub foxglove: Option<Address>,
    /// Web pages that may look besides those of Foxglove and of this machine.
    pub foxglove_origins: Vec<Origin>,
}

/// Why the watching ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The plant's last record came.
    LastRecord,
    /// The plant ended without one.
    PlantEnded,
    /// The stop flag was set.
    Stopped,
    /// The time asked for is over.
    Duration,
    /// Plant and supervisor are gone.
    GroupDied,
}

impl Ended {
    /// The words in the summary.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LastRecord => "last record",
            Self::PlantEnded => "plant ended",
            Self::Stopped => "stopped",
            Self::Duration => "duration",
            Self::GroupDied => "group died",
        }
    }
}

/// What a monitor has seen.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// All figures.
    pub summary: Summary,
    /// Why it ended.
    pub ended: Ended,
}

/// Watches a group until it ends, or `stop` is set.
///
/// # Errors
/// If the group is not running or of another build, the scenario is refused, or the files can't be written.
pub fn run(args: &MonitorArgs, stop: &AtomicBool) -> Result<Outcome, RoleError> {
    if let Some(parent) = args.parent {
        die_with_parent(parent).map_err(|e| RoleError::Other(format!("the supervisor is gone: {e}")))?;
    }
    let joined = if args.managed { join(&role_args(args)?)? } else { join_soon(args, stop)? };
    let links = joined.scenario.links();
    validate(&joined.scenario.expect).map_err(|e| RoleError::Other(format!("expect: {e}")))?;
    let outcome = with_links!(links, watch::<N>(args, &joined, stop))?;
    report(args, &joined, &outcome)?;
    Ok(outcome)
}

/// Injects the monitor's own faults, also those of ticks that it did not see.
fn inject(faults: &Injector<()>, record: &TickRecord, last_tick: Option<u64>) {
    // The first record that it sees is no gap: those before it were never meant for it.
    let from = last_tick.map_or(record.tick, |last| last + 1);
    for tick in if faults.has_no_plan() { 0..0 } else { from..record.tick + 1 } {
        faults.take_time(&faults.at_tick(tick));
    }
}

fn role_args(args: &MonitorArgs) -> Result<RoleArgs, RoleError> {
    let scenario = args.scenario.clone().map_or_else(|| file_of(&args.group, "scenario.toml"), Ok)?;
    Ok(RoleArgs { group: args.group.clone(), id: args.id, scenario, parent: args.parent })
}

/// Joins as a guest. A group that this guest was started with may still be on its way.
pub(crate) fn join_soon(args: &MonitorArgs, stop: &AtomicBool) -> Result<Joined, RoleError> {
    let role = role_args(args)?;
    let give_up_ns = now_ns() + if args.parent.is_some() { START_NS } else { 0 };
    loop {
        match join(&role) {
            Err(_) if now_ns() < give_up_ns && !stop.load(SeqCst) => sleep_ns(JOIN_AGAIN_NS),
            done => return done,
        }
    }
}

fn watch<const N: usize>(args: &MonitorArgs, joined: &Joined, stop: &AtomicBool) -> Result<Outcome, RoleError> {
    let mut watch = Watch::<N>::open(args, joined)?;
    watch.grant();
    watch.announce(Phase::Ready);
    let ended = watch.until_the_end(stop);
    watch.announce(Phase::Ended);
    let summary = watch.finish(ended)?;
    Ok(Outcome { summary, ended })
}

struct Watch<'a, const N: usize> {
    args: &'a MonitorArgs,
    joined: &'a Joined,
    lockstep: bool,
    records: Subscriber<TickRecord>,
    announces: Announces,
    announcer: Publisher<Announce>,
    tracker: Tracker<N>,
    /// The launcher's own monitor alone.
    accountant: Option<Accountant>,
    members: Members,
    recorder: Option<Recorder>,
    loss_told: bool,
    live: Option<Live>,
    started_ns: u64,
    interval_from_ns: u64,
    judged_blocks: usize,
    last_record_ns: u64,
    last_seen: bool,
    faults: Injector<()>,
}

impl<'a, const N: usize> Watch<'a, N> {
    fn open(args: &'a MonitorArgs, joined: &'a Joined) -> Result<Self, RoleError> {
        let scenario = &joined.scenario;
        let lockstep = scenario.loop_.mode == Mode::Lockstep;
        let config = Config::of(scenario);
        let other = |e: &dyn std::fmt::Display| RoleError::Other(e.to_string());
        let judge = Judge::new(scenario).map_err(|e| other(&e))?;
        let claim = if args.managed { None } else { args.out.as_deref().map(claim).transpose()? };
        // Before the folder is touched: a refused address must not cost the files of an earlier run.
        let live = args.foxglove.as_ref().map(|address| serve(address, args, joined)).transpose()?;
        let place = match claim {
            Some(claim) => Some(take(claim, joined)?),
            None => args.out.clone().map(|folder| Place::Launcher(folder, joined.group.run_id())),
        };
        let recorder = match place {
            None => None,
            Some(place) => {
                let lossless = lockstep && args.managed;
                let trace_s = seconds(scenario.monitor.trace.ns());
                let recorder = Recorder::start(place, about(args, joined)?, lossless, trace_s);
                Some(recorder.map_err(|e| RoleError::Other(format!("the thread that writes the files: {e}")))?)
            }
        };
        let now_ns = now_ns();
        let (records, announces) = (joined.node.subscriber(TickRecord::DEPTH)?, joined.node.announces()?);
        // The launcher's monitor counts what strangers say; a guest would count it once more.
        let (records, announces) =
            if args.managed { (records, announces) } else { (records.uncounted(), announces.uncounted()) };
        Ok(Self {
            args,
            joined,
            lockstep,
            records,
            announces,
            announcer: joined.node.publisher()?,
            tracker: Tracker::new(config, Some(judge)),
            accountant: (args.managed && !lockstep)
                .then(|| Accountant::new(scenario.period_ns(), scenario.swap_gate.rollback_for.ns())),
            members: Members::default(),
            recorder,
            loss_told: false,
            live,
            started_ns: now_ns,
            interval_from_ns: now_ns,
            judged_blocks: 0,
            last_record_ns: now_ns,
            last_seen: false,
            faults: Injector::new(scenario, loopbound_scenario::Role::Monitor, args.id),
        })
    }

    fn announce(&self, phase: Phase) {
        let links = self.joined.scenario.links();
        let own = announce(Role::Monitor, self.args.id, phase, links, Privileges::default(), "monitor");
        // A full slot is of no consequence: the supervisor also watches the process itself.
        let _ = self.announcer.send(own);
    }

    fn until_the_end(&mut self, stop: &AtomicBool) -> Ended {
        let mut care_ns = 0;
        loop {
            let drained = self.drain();
            let now_ns = now_ns();
            if now_ns >= care_ns {
                care_ns = now_ns + CARE_NS;
                self.care(now_ns);
            }
            if self.last_seen {
                return Ended::LastRecord;
            }
            if stop.load(SeqCst) {
                return Ended::Stopped;
            }
            if self.args.duration_ns.is_some_and(|ns| now_ns.saturating_sub(self.started_ns) >= ns) {
                return Ended::Duration;
            }
            if drained > 0 {
                continue;
            }
            if let Some(ended) = self.is_over(now_ns) {
                self.drain_the_rest();
                return if self.last_seen { Ended::LastRecord } else { ended };
            }
            self.wait(now_ns + self.joined.scenario.monitor.poll.ns());
        }
    }

    /// Takes a batch of records. Returns how many there were.
    fn drain(&mut self) -> usize {
        let (mut count, batch_ns) = (0, now_ns());
        while count < BATCH_MAX {
            let Self { records, announces, members, tracker, accountant, recorder, live, last_seen, faults, .. } = self;
            let taken = records.take_with(|record| {
                inject(faults, record, tracker.last_tick());
                *last_seen |= record.flags & record_flag::LAST != 0;
                // One that was started for a swap may be in charge before the next look at everything else.
                if !tracker.knows(record.active) {
                    learn(announces, members, tracker, recorder);
                }
                let Some(row) = tracker.feed(record) else { return };
                if let Some(accountant) = accountant {
                    accountant.feed(record, row.round_trip_ns, tracker.swaps().list());
                }
                if let Some(live) = live {
                    live.tick(record, &row, batch_ns);
                }
                if let Some(recorder) = recorder {
                    recorder.tick(record, row);
                }
            });
            if taken.is_none() {
                break;
            }
            count += 1;
        }
        if count > 0 {
            self.last_record_ns = now_ns();
            self.grant();
            self.pass_events_on();
        }
        count
    }

    fn pass_events_on(&mut self) {
        let Self { tracker, recorder, live, .. } = self;
        for event in tracker.drain_events() {
            if let Some(live) = live {
                live.event(&event);
            }
            if let Some(recorder) = recorder {
                recorder.event(event);
            }
        }
    }

    /// Tells the plant how far it may go, so that the launcher's monitor gets every record.
    fn grant(&self) {
        if self.args.managed {
            let next = self.tracker.last_tick().map_or(0, |tick| tick.saturating_add(1));
            // One that was started again must not take back what its predecessor has granted.
            self.joined.block.pace().credit.fetch_max(next.saturating_add(CREDIT_TICKS), SeqCst);
            self.joined.block.ring(Bell::Pace);
        }
    }

    fn care(&mut self, now_ns: u64) {
        let _ = self.announcer.update_connections();
        let Self { announces, members, tracker, recorder, .. } = self;
        learn(announces, members, tracker, recorder);
        if let Some(live) = &mut self.live {
            live.care(now_ns);
        }
        let duration_ns = now_ns.saturating_sub(self.interval_from_ns);
        if duration_ns >= INTERVAL_NS {
            self.close_interval(now_ns);
        }
        self.tell_loss();
        self.tell_changes();
        self.judge_so_far();
    }

    /// While a change of the active controller may still be asked about.
    fn tell_changes(&mut self) {
        let (tick, list) = (self.tracker.last_tick(), self.tracker.swaps().list());
        if let Some(account) = self.accountant.as_mut().and_then(|accountant| accountant.due(tick, list)) {
            // Without it the answer of a swap has no figures, and the run goes on.
            let _ = account.write(&self.joined.group);
        }
    }

    /// Once, as soon as it is known: to the supervisor, who says it, or to whoever started this monitor.
    fn tell_loss(&mut self) {
        let Some(why) = self.recorder.as_ref().and_then(Recorder::lost).filter(|_| !self.loss_told) else { return };
        self.loss_told = true;
        if self.args.managed {
            // In memory: what is full is the disk of the recording.
            let _ = self.joined.group.write(LOST_FILE, why.as_bytes());
        } else {
            say::err!("loopbound: the recording has ended: {why}; the watching goes on");
        }
    }

    /// After every block, for the supervisor, who prolongs a run while its verdict is open. It reads when it likes, so
    /// neither waits for the other; a look that is missed costs a later one at most.
    fn judge_so_far(&mut self) {
        let blocks = self.tracker.blocks().closed().len();
        let asked = self.args.managed && !self.lockstep && !self.joined.scenario.expect.conditions.is_empty();
        if !asked || blocks == self.judged_blocks {
            return;
        }
        self.judged_blocks = blocks;
        let summary = self.tracker.summarise();
        let verdict = judge(&self.joined.scenario.expect, &summary, self.tracker.blocks(), judge_summary(&summary));
        let interim = Interim { tick: summary.last_tick.unwrap_or(0), status: verdict.status };
        // A full disc shows at the end, when the summary can't be written either.
        let _ = interim.write(&self.joined.group);
    }

    fn close_interval(&mut self, now_ns: u64) {
        if let Some(recorder) = &mut self.recorder {
            let start_ns = self.interval_from_ns.saturating_sub(self.started_ns);
            let duration_ns = now_ns.saturating_sub(self.interval_from_ns);
            recorder.interval(start_ns, duration_ns, self.tracker.interval());
        }
        self.tracker.start_interval();
        self.interval_from_ns = now_ns;
    }

    fn is_over(&mut self, now_ns: u64) -> Option<Ended> {
        let silent_ns = now_ns.saturating_sub(self.last_record_ns);
        if self.joined.block.pace().plant_ended.load(SeqCst) != 0 {
            return Some(Ended::PlantEnded);
        }
        let patience_ns = match self.members.is_alive(Role::Plant) {
            Some(true) => return None,
            // Its last records may still be on their way, and a process that can't be watched looks dead.
            Some(false) => DEAD_SILENCE_NS,
            // A plant that never announced itself: silence must do.
            None => SILENCE_NS,
        };
        let patience_ns = patience_ns + 3 * self.joined.scenario.period_ns();
        (silent_ns > patience_ns).then_some(Ended::GroupDied)
    }

    fn drain_the_rest(&mut self) {
        let until_ns = now_ns() + DRAIN_NS;
        loop {
            let drained = self.drain();
            let now_ns = now_ns();
            if self.last_seen || (drained == 0 && now_ns >= until_ns) {
                return;
            }
            if drained == 0 {
                let _ = sleep_until_ns_or_signal(now_ns + self.joined.scenario.monitor.poll.ns());
            }
        }
    }

    /// Lockstep goes as fast as its monitor lets it: there the bell is answered at once.
    fn wait(&mut self, until_ns: u64) {
        if self.lockstep {
            let joined = self.joined;
            let _ = joined.block.wait(Bell::Pace, until_ns, || (self.drain() > 0).then_some(()));
        } else {
            let _ = sleep_until_ns_or_signal(until_ns);
        }
    }

    fn finish(mut self, ended: Ended) -> Result<Summary, RoleError> {
        self.care(now_ns());
        self.announces.finish();
        self.close_interval(now_ns());
        self.tracker.finish();
        self.pass_events_on();
        if let Some(live) = self.live.take() {
            live.stop();
        }
        let mut summary = self.tracker.summarise();
        let scenario = &self.joined.scenario;
        summary.group.clone_from(&self.args.group);
        summary.build = format!("{:016x}", build_id());
        summary.written = wall_time();
        summary.ended = ended.name().to_owned();
        summary.strangers = strangers(&self.joined.block, &summary);
        summary.processes = self.members.summaries();
        summary.host = crate::host::describe();
        summary.scenario = serde_json::to_value(scenario).unwrap_or_default();
        summary.run_id = self.joined.group.run_id().to_string();
        if let Some(recorder) = &mut self.recorder {
            let lost = recorder.finish();
            summary.dropped.samples += lost.samples;
            summary.dropped.events += lost.events;
            summary.dropped.intervals += lost.intervals;
        }
        self.tracker.close_block();
        let natural = judge_summary(&summary);
        summary.verdict = judge(&scenario.expect, &summary, self.tracker.blocks(), natural);
        if let Some(recorder) = &mut self.recorder {
            // The launcher adds its part to those of its own monitor.
            recorder.write_end(&mut summary, self.tracker.hops(), self.tracker.blocks(), !self.args.managed);
        }
        self.tell_loss();
        Ok(summary)
    }
}

/// Takes what the processes have said of themselves.
fn learn<const N: usize>(
    announces: &Announces,
    members: &mut Members,
    tracker: &mut Tracker<N>,
    recorder: &mut Option<Recorder>,
) {
    while let Some(announce) = announces.take() {
        members.learn(&announce);
        tracker.learn(&announce);
        if let Some(recorder) = recorder {
            recorder.announce(&announce);
        }
    }
}

/// What was said by others than the processes of this run, by kind. Torques are counted by the plant, with those that a
/// fault injects.
fn strangers(block: &ControlBlock, summary: &Summary) -> BTreeMap<String, u64> {
    let mut counts: BTreeMap<String, u64> =
        MessageKind::ALL.iter().map(|kind| (kind.name().to_owned(), block.writers().strangers(*kind))).collect();
    let torques = summary.counters.get("unknown_writer").copied().unwrap_or(0);
    counts.insert(MessageKind::Torque.name().to_owned(), torques);
    counts
}
