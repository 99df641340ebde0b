//! What every role process is started with, and how it ends.

use std::path::PathBuf;

use thiserror::Error;

use crate::clock;
use crate::doorbell::ControlBlock;
use crate::event::{MessageKind, Phase, Role};
use crate::group::{Group, GroupError};
use crate::layout::{FNV_START, Layout, fnv1a};
use crate::ports::{Node, PortError};
use crate::realtime::{Privileges, Request};
use crate::sample::{Announce, Command, Reply, Setpoint, State, TickRecord, Torque};
use loopbound_scenario::{Cores, Mode, Scenario, ScenarioError};

/// How a role process is started: `EXE --group G --id N --scenario FILE [--parent PID]`.
#[derive(Clone, Debug)]
pub struct RoleArgs {
    /// Name of the group.
    pub group: String,
    /// Id within the group; controllers count from 1.
    pub id: u32,
    /// The scenario, with all defaults filled in.
    pub scenario: PathBuf,
    /// The supervisor: if it dies, the role ends.
    pub parent: Option<u32>,
}

/// Why a role could not start or go on.
#[derive(Debug, Error)]
pub enum RoleError {
    /// The group is not there.
    #[error(transparent)]
    Group(#[from] GroupError),
    /// A port can't be opened.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The scenario is refused.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The control block can't be opened.
    #[error("the group's control block: {0}")]
    ControlBlock(std::io::Error),
    /// What was asked for on the command line can't be had, said in words.
    #[error("{0}")]
    Usage(String),
    /// Anything else, said in words.
    #[error("{0}")]
    Other(String),
}

/// What every role has once it has joined. Fields are dropped in this order: ports (the node) before the group's lock.
pub struct Joined {
    /// Its doorbells.
    pub block: ControlBlock,
    /// Its ports' node.
    pub node: Node,
    /// What is to be run.
    pub scenario: Scenario,
    /// Its hold on the group.
    pub group: Group,
}

/// Joins the group named in `args` and reads its scenario.
///
/// # Errors
/// If the group is not running, is of another build, or the scenario is refused.
pub fn join(args: &RoleArgs) -> Result<Joined, RoleError> {
    let group = Group::join(&args.group)?;
    let scenario = Scenario::load(&args.scenario)?;
    let block = ControlBlock::open(&group.file("bell")).map_err(RoleError::ControlBlock)?;
    let node = Node::open(&group)?;
    Ok(Joined { block, node, scenario, group })
}

/// Waits until the supervisor has this process on its list, so that nothing that it says is lost as a stranger's.
///
/// # Errors
/// If it is not there in time: nobody of this run has started this process.
pub fn wait_until_listed(joined: &Joined, role: Role, id: u32) -> Result<(), RoleError> {
    let until_ns = clock::now_ns() + LISTED_WITHIN_NS;
    while !joined.block.writers().knows(role, Some(id), std::process::id()) {
        if clock::now_ns() >= until_ns {
            return Err(RoleError::Other(format!("{role} {id}: the group's supervisor does not know this process")));
        }
        clock::sleep_ns(200_000);
    }
    Ok(())
}

/// A child is on the list as soon as its supervisor runs again after starting it.
const LISTED_WITHIN_NS: u64 = 5_000_000_000;

/// An announcement with what all roles have in common.
#[must_use]
pub fn announce(role: Role, id: u32, phase: Phase, links: usize, privileges: Privileges, name: &str) -> Announce {
    let mut bytes = [0; 32];
    let length = name.len().min(bytes.len());
    bytes[..length].copy_from_slice(&name.as_bytes()[..length]);
    Announce {
        role: role.code(),
        id,
        pid: std::process::id(),
        phase: phase.code(),
        build: build_id(),
        published_ns: clock::now_ns(),
        privileges,
        links: u32::try_from(links).unwrap_or(0),
        name: bytes,
        ..Announce::zeroed()
    }
}

/// Identifies what this executable exchanges and computes: version and layout of every sample.
#[must_use]
pub fn build_id() -> u64 {
    let hash = fnv1a(FNV_START, env!("CARGO_PKG_VERSION").as_bytes());
    MessageKind::ALL.iter().fold(hash, |hash, kind| fnv1a(hash, &layout_of(*kind).to_le_bytes()))
}

/// Layout of what travels as a message of a kind.
const fn layout_of(kind: MessageKind) -> u64 {
    match kind {
        MessageKind::Setpoint => Setpoint::HASH,
        MessageKind::State => State::HASH,
        MessageKind::Torque => Torque::HASH,
        MessageKind::TickRecord => TickRecord::HASH,
        MessageKind::Announce => Announce::HASH,
        MessageKind::Command => Command::HASH,
        MessageKind::Reply => Reply::HASH,
    }
}

/// What a process of the loop asks of the kernel: the plant on the first of the scenario's cores, controllers on the
/// second. Nothing in lockstep, where time is virtual.
#[must_use]
pub fn realtime_request(scenario: &Scenario, role: Role) -> Request {
    if scenario.loop_.mode == Mode::Lockstep {
        return Request { priority: 0, core: None, lock_memory: false, dma_latency: false };
    }
    let wanted = &scenario.realtime;
    let cores: Vec<usize> = match &wanted.cores {
        Cores::Auto => allowed_cores(),
        Cores::List(cores) => cores.clone(),
    };
    let core = match role {
        Role::Plant => cores.first(),
        Role::Controller => cores.get(1),
        Role::Supervisor | Role::Reference | Role::Monitor => None,
    };
    Request {
        priority: wanted.priority,
        // With one core only there is nothing to choose.
        core: core.copied().filter(|_| cores.len() > 1),
        lock_memory: wanted.lock_memory,
        dma_latency: wanted.dma_latency,
    }
}

fn allowed_cores() -> Vec<usize> {
    let set = rustix::thread::sched_getaffinity(None);
    set.map(|set| (0..rustix::thread::CpuSet::MAX_CPU).filter(|core| set.is_set(*core)).collect()).unwrap_or_default()
}

/// A round of mapping that takes longer than this (ns) has mapped something.
pub const MAPPING_NS: u64 = 40_000;

/// Ends this process at once, as an injected fault: no destructor runs, as if killed from outside.
pub fn kill_self() -> ! {
    let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
    loop {
        std::thread::park();
    }
}
