//! The supervisor: makes the group, starts its processes, commands the plant, notices who dies, ends all in order.
//!
//! Responsible for the life of the processes and for nothing in the loop: it looks every 50 ms, and the plant alone
//! decides who is obeyed. Every wait here has an end, so a dead partner never hangs a run. All children are started
//! on the thread that calls [`supervise`] and are gone when it returns, however it returns.

mod child;
mod cleaning;
mod clients;
mod control;
mod ending;
mod faults;
mod hearing;
pub mod keeper;
pub mod needs;
mod notices;
pub mod prepare;
pub mod processes;
mod prolong;
mod record;
mod restarts;
pub mod results;
mod retirements;
mod roster;
mod starting;
mod succession;
mod swapping;
mod watchdog;

use std::path::Path;
use std::sync::atomic::Ordering::SeqCst;

use anyhow::Context as _;
use loopbound_monitor::folder::Results;
use loopbound_scenario::{Mode, Restart, Role, Scenario};
use loopbound_shared::clock;
use loopbound_shared::doorbell::{Bell, ControlBlock};
use loopbound_shared::event::{self, CommandKind, Refusal, ReplyKind};
use loopbound_shared::group::{Group, room};
use loopbound_shared::ports::{CommandClient, Node};
use loopbound_shared::realtime::wait_any_end;
use loopbound_shared::sample::{Command, Reply};

use crate::exit::{Exit, Failure};
use crate::progress::Progress;
use crate::signals::Stop;
use child::Child;
use cleaning::Cleaning;
pub use control::{Answer, FILE as CONTROL_FILE, FaultReport, FaultRequest, Request, SwapReport, SwapRequest, connect};
use control::{Client, Control};
use faults::Injection;
use hearing::Hearing;
use keeper::Keeper;
use notices::Notices;
use processes::Process;
use prolong::Prolonging;
use record::privileges;
pub use record::{Death, ProcessRecord, Record};
use restarts::Restarts;
use results::Asked;
use retirements::Retirements;
use roster::RosterFile;
pub(crate) use roster::pid_namespace;
pub use roster::{Entry, FILE as ROSTER_FILE, Roster};
use swapping::Swapping;
use watchdog::Watchdog;

/// Interval between two looks at a running group.
const LOOK_NS: u64 = 50_000_000;
/// The same while a swap is under way.
const SWAP_LOOK_NS: u64 = 5_000_000;
/// A role that ends in order within this time before the plant ended with it.
const TOGETHER_NS: u64 = 500_000_000;
/// Time for the plant to answer a command, besides two of its periods.
const ANSWER_NS: u64 = 1_000_000_000;

/// How a group is run, besides its scenario.
pub struct Options<'a> {
    /// Name of the group.
    pub group: String,
    /// Shows how far the run is.
    pub progress: Progress,
    /// No notes while it runs.
    pub quiet: bool,
    /// Whether and how to stop early.
    pub stop: &'a Stop,
}

/// What came of a run.
#[derive(Debug)]
pub struct Outcome {
    /// What the launcher knows.
    pub record: Record,
    /// The monitor's summary, if it left one.
    pub summary: Option<serde_json::Value>,
    /// The folder of the run, if one was asked for and everyone became ready.
    pub results: Option<Results>,
    /// The signal that ended the run early, as an exit code.
    pub stopped: Option<Exit>,
}

/// Why the group ends.
#[derive(Debug)]
enum End {
    /// The plant has done its ticks.
    Done,
    /// A signal.
    Stopped(Exit),
    /// The plant died.
    PlantDied,
    /// A role died whose policy is to end the group.
    Policy(String),
    /// Not all became ready, or the plant refused to start.
    NotStarted(Failure),
}

/// The group as its supervisor holds it. Fields are dropped in this order: children first, the group's lock last.
struct Supervisor<'a> {
    children: Vec<Child>,
    /// Ends what is left of the children.
    keeper: Keeper,
    scenario: &'a Scenario,
    options: &'a Options<'a>,
    commands: CommandClient,
    hearing: Hearing,
    prolonging: Prolonging,
    restarts: Restarts,
    retirements: Retirements,
    control: Control,
    /// The swap under way, and who waits for its answer.
    swap: Option<(Client, Swapping)>,
    injection: Injection,
    deaths: Vec<Death>,
    roster: RosterFile,
    /// The controller in charge, 0 before the start.
    active: u32,
    started_ns: u64,
    ready_ns: u64,
    cleaning: Cleaning,
    notices: Notices,
    block: ControlBlock,
    node: Node,
    group: Group,
}

/// Runs `scenario` as a group of processes to its end. The folder of the run is taken when all of them are ready.
///
/// # Errors
/// If the group can't be made (then nothing was started), or did not start (then nothing is left of it).
pub fn supervise(scenario: &Scenario, options: &Options<'_>, asked: Option<Asked>) -> anyhow::Result<Outcome> {
    let mut supervisor = Supervisor::create(scenario, options)?;
    let file = supervisor.group.file("scenario.toml");
    for process in processes::table(scenario, &file, asked.as_ref().map(Asked::path)) {
        let child = supervisor.start_child(process, 0)?;
        supervisor.children.push(child);
    }
    let mut results = None;
    let end = match supervisor.wait_until_ready() {
        None => match asked.map(|asked| asked.take(&supervisor.group)).transpose() {
            Ok(taken) => {
                results = taken;
                supervisor.run()
            }
            Err(failure) => End::NotStarted(failure),
        },
        Some(end) => end,
    };
    options.progress.finish();
    Ok(Outcome { results, ..supervisor.finish(end)? })
}

impl<'a> Supervisor<'a> {
    fn create(scenario: &'a Scenario, options: &'a Options<'a>) -> anyhow::Result<Self> {
        let group = Group::create(&options.group)?;
        prepare::write_scenario(&group, scenario)?;
        let block = ControlBlock::create(&group.file("bell")).context("the group's control block")?;
        let node = Node::open(&group)?;
        let lockstep = scenario.loop_.mode == Mode::Lockstep;
        Ok(Self {
            children: Vec::new(),
            keeper: Keeper::start(&group).context("the keeper")?,
            scenario,
            options,
            commands: node.command_client()?,
            hearing: Hearing::open(&node, lockstep)?,
            prolonging: Prolonging::new(scenario),
            restarts: Restarts::new(scenario),
            retirements: Retirements::default(),
            control: Control::open(&group).context("the group's socket")?,
            swap: None,
            injection: Injection::default(),
            deaths: Vec::new(),
            roster: RosterFile::default(),
            active: 0,
            started_ns: clock::now_ns(),
            ready_ns: 0,
            cleaning: Cleaning::new(clock::now_ns()),
            notices: Notices::default(),
            block,
            node,
            group,
        })
    }

    /// Starts a process, and enters it in the list of those who may speak in this run.
    fn start_child(&self, process: Process, restarts: u32) -> anyhow::Result<Child> {
        let (role, id) = (process.role, process.id);
        // It could not even say so: its words go to a file there.
        if self.active != 0 {
            room::require(room::NEWCOMER).with_context(|| format!("{} can't be started", process.name()))?;
        }
        let child = Child::start(process, &self.group, restarts)?;
        self.block.writers().enlist(role.into(), id, child.pid);
        Ok(child)
    }

    fn lockstep(&self) -> bool {
        self.scenario.loop_.mode == Mode::Lockstep
    }

    fn tick(&self) -> u64 {
        self.block.pace().plant_tick.load(SeqCst)
    }

    fn plant_ended(&self) -> bool {
        self.block.pace().plant_ended.load(SeqCst) != 0
    }

    fn controllers(&self) -> impl Iterator<Item = &Child> {
        self.children.iter().filter(|c| c.process.role == Role::Controller)
    }

    /// Looks every 50 ms, and at once when a process ends.
    fn watch(&mut self) -> End {
        let period_ns = if self.lockstep() { 0 } else { self.scenario.period_ns() };
        let mut watchdog = Watchdog::new(clock::now_ns(), period_ns);
        loop {
            self.resume_due();
            let look_ns = if self.swap.is_some() { SWAP_LOOK_NS } else { LOOK_NS };
            self.wait_for_an_end(
                self.injection.until_resumed_ns(clock::now_ns()).map_or(look_ns, |ns| ns.min(look_ns)),
            );
            self.listen();
            if let Some(exit) = self.options.stop.requested() {
                return End::Stopped(exit);
            }
            if let Some(end) = self.settle_deaths() {
                return end;
            }
            self.start_due();
            self.keeper.ensure(&self.group);
            self.serve_clients();
            self.retire_due();
            self.clean_up_now_and_then();
            self.note_strangers();
            self.prolong_if_undecided();
            self.note_loss();
            self.options.progress.set_position(self.tick());
            if watchdog.stalled(clock::now_ns(), self.tick()) {
                self.kill_who_is_silent();
            }
        }
    }

    /// Sleeps until a child ends, at most `timeout_ns`.
    fn wait_for_an_end(&self, timeout_ns: u64) {
        let handles: Vec<_> = self.children.iter().filter_map(Child::handle).collect();
        // Without descriptors (an old kernel) it is a plain pause.
        if handles.is_empty() || wait_any_end(&handles, timeout_ns).is_err() {
            clock::sleep_ns(timeout_ns.min(10_000_000));
        }
    }

    /// Takes what was said since the last look; keeps the roster.
    fn listen(&mut self) {
        while let Some(announce) = self.hearing.next_ready() {
            // What a newcomer and the loop made together: the loop itself has no time for it.
            if self.group.take_room().is_err() {
                self.note("/dev/shm is full: whoever joins now may fail");
            }
            let Some(child) = self.children.iter_mut().find(|c| c.is_announced_by(&announce)) else { continue };
            self.block.writers().enlist(child.process.role.into(), child.process.id, announce.pid);
            let first = child.announce.replace(announce).is_none();
            if first && self.active != 0 {
                let pid = child.pid;
                self.admit(pid);
            }
        }
        if let Some(state) = self.hearing.latest_state()
            && state.active != self.active
            && self.active != 0
            && state.active != 0
        {
            self.retire_after_scheduled(self.active, state.active, state.tick);
            self.active = state.active;
            self.set_priorities();
        }
        self.hearing.hear_torques();
        let newest = self.hearing.newest_closed();
        let roster = roster::roster(self.group.name(), &self.children, self.active, newest);
        self.roster.update(&self.group, roster);
    }

    /// Deals with everyone that has ended since the last look. Some: so has the group.
    fn settle_deaths(&mut self) -> Option<End> {
        for child in &mut self.children {
            child.reap();
        }
        let plant = self.children.iter().find(|c| c.process.role == Role::Plant)?;
        if let Some((status, _)) = plant.ended {
            return Some(if status.success() { End::Done } else { End::PlantDied });
        }
        if self.plant_ended() {
            return Some(End::Done);
        }
        let now_ns = clock::now_ns();
        let died = |child: &Child| {
            // Whoever ends in order has probably seen the last state, and the plant is about to end too.
            child.ended.is_some_and(|(status, at_ns)| !status.success() || now_ns >= at_ns + TOGETHER_NS)
        };
        self.bury_retired();
        while let Some(index) = self.children.iter().position(|c| !c.settled && died(c)) {
            self.children[index].settled = true;
            if let Some(end) = self.settle_death(index) {
                return Some(end);
            }
        }
        None
    }

    fn settle_death(&mut self, index: usize) -> Option<End> {
        let child = &self.children[index];
        let (role, id, pid, restarts) = (child.process.role, child.process.id, child.pid, child.restarts);
        let (name, how, process) = (child.process.name(), child.how_ended(), child.process.clone());
        match role {
            // In lockstep the plant waits for this very command.
            Role::Controller => {
                let remove = Command { kind: CommandKind::RemoveMember.code(), controller: id, ..Command::zeroed() };
                if self.children[index].member
                    && let Err(why) = self.command(remove)
                {
                    self.note(&format!("{name}: {why}"));
                }
            }
            // Nobody takes the records any more: the plant need not wait for that.
            Role::Monitor => self.grant_all_credit(),
            Role::Plant | Role::Reference => {}
        }
        self.clean_up_the_dead();
        let tick = self.tick();
        let stands_in = role == Role::Controller && self.controllers().any(Child::ready);
        self.deaths.push(Death { role: role.to_string(), id, pid, tick, how: how.clone(), recovered: stands_in });
        self.note(&format!("{name} (pid {pid}): {how} in tick {tick}"));
        match process.policy {
            Restart::End => return Some(End::Policy(format!("{name}: {how}"))),
            Restart::Ignore => {}
            Restart::Restart => self.plan_restart(process, restarts, id),
        }
        None
    }

    /// Frees what dead processes still hold, so that others find room: children, and guests that nobody here has started.
    fn clean_up_the_dead(&self) {
        self.block.clear_places_of_the_dead();
        self.node.clean_up_dead_nodes();
    }

    /// At every look.
    fn clean_up_now_and_then(&mut self) {
        let freed = self.block.clear_places_of_the_dead();
        if self.cleaning.look(clock::now_ns(), freed) {
            self.node.clean_up_dead_nodes();
        }
    }

    fn grant_all_credit(&self) {
        self.block.pace().credit.store(u64::MAX, SeqCst);
        self.block.ring(Bell::Pace);
    }

    fn living(&self, role: Role) -> Vec<usize> {
        let lives = |child: &Child| child.process.role == role && child.lives();
        self.children.iter().enumerate().filter(|(_, c)| lives(c)).map(|(index, _)| index).collect()
    }

    /// Asks the plant for something; an error says why it was not done.
    fn command(&self, command: Command) -> Result<Reply, String> {
        let reply = self.ask_plant(command)?;
        refusal(command, reply).map_or(Ok(reply), Err)
    }

    /// The plant's answer, whatever it is; an error if it gives none.
    fn ask_plant(&self, command: Command) -> Result<Reply, String> {
        let plant_lives = self.children.iter().any(|c| c.process.role == Role::Plant && c.lives());
        if !plant_lives || self.plant_ended() {
            return Err("the plant has ended".to_owned());
        }
        let timeout_ns = ANSWER_NS + 2 * self.scenario.period_ns();
        self.commands.ask(command, timeout_ns).map_err(|e| e.to_string())
    }

    /// Says something while the run goes on, above the progress bar.
    fn note(&self, line: &str) {
        if !self.options.quiet {
            self.options.progress.note(line.to_owned());
        }
    }

    fn record(&self, end: &End) -> Record {
        let process = |child: &Child| ProcessRecord {
            role: child.process.role.to_string(),
            id: child.process.id,
            pid: child.pid,
            restarts: child.restarts,
            end: child.how_ended(),
            privileges: child.announce.as_ref().map(|a| privileges(&a.privileges)).unwrap_or_default(),
            said: child.said(),
        };
        Record {
            group: self.group.name().to_owned(),
            start_up_ns: self.ready_ns.saturating_sub(self.started_ns),
            end: end.to_string(),
            ticks_planned: self.prolonging.stop_tick(),
            processes: self.children.iter().map(process).collect(),
            deaths: self.deaths.clone(),
        }
    }
}

/// Why the plant has not done what it was asked for; none if it has, or is about to.
fn refusal(command: Command, reply: Reply) -> Option<String> {
    if matches!(ReplyKind::from_code(reply.kind), Some(ReplyKind::Done | ReplyKind::Pending)) {
        return None;
    }
    let kind = event::CommandKind::from_code(command.kind).map_or("command", event::CommandKind::name);
    let reason = Refusal::from_code(reply.reason).map_or("no reason given", Refusal::name);
    Some(format!("{kind}: {reason}"))
}

impl std::fmt::Display for End {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Done => f.write_str("done"),
            Self::Stopped(Exit::Interrupted) => f.write_str("interrupted"),
            Self::Stopped(_) => f.write_str("terminated"),
            Self::PlantDied => f.write_str("the plant died"),
            Self::Policy(who) => write!(f, "ended by policy: {who}"),
            Self::NotStarted(failure) => write!(f, "{failure}"),
        }
    }
}

/// Writes a whole file or nothing: a reader finds the old one or the new one.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".new");
    let new = path.with_file_name(name);
    std::fs::write(&new, bytes)?;
    std::fs::rename(&new, path)
}
