//! The loops of plant and controllers allocate nothing of their own once they are warm: an allocation is a lock and, now
//! and then, a system call in the middle of a tick.
//!
//! The transport does allocate: each sample that is loaned for publication has a note of one fixed, small size, released
//! when it is sent. An allocator serves that from the thread's own last released block, without a lock. So what is
//! asserted is that there is nothing else: as many blocks as samples, all of that one size, all released again.
//!
//! The roles run here as threads of one process, each the very function that the executable runs, over a real group;
//! this process's allocator counts by role. What is counted is a stretch of ticks in which nobody joins or leaves.

#![expect(unsafe_code, reason = "a counting allocator has to be an allocator")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::fs;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering::SeqCst};
use std::sync::{Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use loopbound_scenario::Scenario;
use loopbound_scenario::controllers;
use loopbound_shared::clock;
use loopbound_shared::doorbell::{Bell, ControlBlock};
use loopbound_shared::event::{CommandKind, LiveFault, Phase, ReplyKind, Role};
use loopbound_shared::fault::board::Injected;
use loopbound_shared::group::Group;
use loopbound_shared::opening;
use loopbound_shared::ports::{Announces, CommandClient, Node};
use loopbound_shared::role::{RoleArgs, RoleError};
use loopbound_shared::sample::Command;

/// Who is counted: places in [`COUNTS`]. Everyone else is not.
const PLANT: usize = 1;
const CONTROLLERS: usize = 2;
const REFERENCE: usize = 3;
const NOBODY: usize = 0;

/// Largest block that the transport's note of a loaned sample may be, bytes.
const NOTE_MAX: usize = 64;

/// What the threads of one role did.
struct Counts {
    allocated: AtomicU64,
    released: AtomicU64,
    /// Sizes of the blocks since the last [`Counts::forget_sizes`], bytes.
    smallest: AtomicUsize,
    largest: AtomicUsize,
}

impl Counts {
    const fn new() -> Self {
        Self {
            allocated: AtomicU64::new(0),
            released: AtomicU64::new(0),
            smallest: AtomicUsize::new(usize::MAX),
            largest: AtomicUsize::new(0),
        }
    }

    fn allocate(&self, size: usize) {
        self.allocated.fetch_add(1, SeqCst);
        self.smallest.fetch_min(size, SeqCst);
        self.largest.fetch_max(size, SeqCst);
    }

    fn forget_sizes(&self) {
        self.smallest.store(usize::MAX, SeqCst);
        self.largest.store(0, SeqCst);
    }

    fn so_far(&self) -> (u64, u64) {
        (self.allocated.load(SeqCst), self.released.load(SeqCst))
    }
}

static COUNTS: [Counts; 4] = [const { Counts::new() }; 4];

thread_local! {
    static ROLE: Cell<usize> = const { Cell::new(NOBODY) };
}

struct Counting;

/// The counts of this thread's role; a thread that is being torn down has none any more.
fn own() -> &'static Counts {
    &COUNTS[ROLE.try_with(Cell::get).unwrap_or(NOBODY)]
}

// SAFETY: every call is the system allocator's own; counting itself does not allocate, since its place is a constant
// and the role a constant-initialised cell without a destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        own().allocate(layout.size());
        // SAFETY: the caller keeps alloc's contract, which is System's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        own().released.fetch_add(1, SeqCst);
        // SAFETY: the caller keeps dealloc's contract, and every pointer of ours is System's.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        own().allocate(size);
        own().released.fetch_add(1, SeqCst);
        // SAFETY: as in dealloc.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The counts are the process's: one group at a time.
static TURN: Mutex<()> = Mutex::new(());

const PATIENCE_NS: u64 = 60 * clock::NS_PER_S;

fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let until_ns = clock::now_ns() + PATIENCE_NS;
    while !holds() {
        assert!(clock::now_ns() < until_ns, "waited in vain until {what}");
        clock::sleep_ns(500_000);
    }
}

/// Starts a role's function as a thread that is counted at `place`.
fn start(
    place: usize,
    args: RoleArgs,
    run: impl FnOnce(&RoleArgs, &'static AtomicBool) -> Result<(), RoleError> + Send + 'static,
) -> JoinHandle<Result<(), RoleError>> {
    static NEVER: AtomicBool = AtomicBool::new(false);
    thread::spawn(move || {
        ROLE.set(place);
        let ended = run(&args, &NEVER);
        ROLE.set(NOBODY);
        ended
    })
}

/// What a supervisor has of a group, with the roles as threads.
struct Threads {
    commands: CommandClient,
    announcements: Announces,
    roles: Vec<JoinHandle<Result<(), RoleError>>>,
    block: ControlBlock,
    _node: Node,
    _group: Group,
}

impl Threads {
    fn start(name: &str, scenario: &Scenario) -> Self {
        let group = Group::create(&format!("alloc-{name}-{}", std::process::id())).expect("a group");
        let file = group.file("scenario.toml");
        fs::write(&file, scenario.to_toml().expect("the scenario as text")).expect("the group's scenario");
        let block = ControlBlock::create(&group.file("bell")).expect("the control block");
        let node = Node::open(&group).expect("a node");
        let (commands, announcements) = (node.command_client(), node.announces());
        let enlist = |role, id| block.writers().enlist(role, id, std::process::id());
        enlist(Role::Reference, 1);
        enlist(Role::Plant, 1);
        controllers::of(scenario).iter().for_each(|part| enlist(Role::Controller, part.id));
        let args = |id| RoleArgs { group: group.name().to_owned(), id, scenario: file.clone(), parent: None };
        let mut roles = vec![start(REFERENCE, args(1), loopbound_reference::run)];
        for part in controllers::of(scenario) {
            let run = move |args: &RoleArgs, stop| loopbound_controller::run(args, Some(part.law), stop);
            roles.push(start(CONTROLLERS, args(part.id), run));
        }
        roles.push(start(PLANT, args(1), loopbound_plant::run));
        // Nobody watches here: the plant need not wait for a monitor.
        block.pace().credit.store(u64::MAX, SeqCst);
        Self {
            commands: commands.expect("the commands"),
            announcements: announcements.expect("a subscriber"),
            roles,
            block,
            _node: node,
            _group: group,
        }
    }

    fn begin(&self, scenario: &Scenario) {
        let mut ready = 0;
        wait_until("all are ready", || {
            while let Some(announce) = self.announcements.take() {
                ready += usize::from(announce.phase == Phase::Ready.code());
            }
            assert!(!self.roles.iter().any(JoinHandle::is_finished), "a role has ended before the start");
            ready == self.roles.len()
        });
        for command in opening::commands(scenario, u64::MAX) {
            self.ask(command);
        }
    }

    fn ask(&self, command: Command) {
        let reply = self.commands.ask(command, PATIENCE_NS).expect("the plant answers");
        let kind = ReplyKind::from_code(reply.kind);
        assert!(matches!(kind, Some(ReplyKind::Done | ReplyKind::Pending)), "{reply:?}");
    }

    fn tick(&self) -> u64 {
        self.block.pace().plant_tick.load(SeqCst)
    }

    /// Waits for a tick; the tick at which the wait ended.
    fn wait_for_tick(&self, tick: u64) -> u64 {
        wait_until(&format!("tick {tick}"), || self.tick() >= tick);
        self.tick()
    }

    fn end(mut self) {
        self.ask(Command { kind: CommandKind::StopAt.code(), tick: 1, ..Command::zeroed() });
        for role in self.roles.drain(..) {
            role.join().expect("no role panics").expect("no role fails");
        }
        self.block.ring(Bell::Pace);
    }
}

/// Asserts that between two ticks of a scenario plant and controllers allocated nothing but the notes of what they
/// published: two samples a tick by the plant, one by each controller.
#[track_caller]
fn assert_only_notes(name: &str, scenario: &str, from: u64, to: u64) {
    assert_only_notes_with(name, scenario, from, to, |_| ());
}

/// The same, with something done once the clock runs, before what is counted.
#[track_caller]
fn assert_only_notes_with(name: &str, scenario: &str, from: u64, to: u64, prepare: impl FnOnce(&Threads)) {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let quiet = "[realtime]\npriority = 0\nlock_memory = false\ndma_latency = false\n";
    let scenario = Scenario::from_toml(&format!("{quiet}{scenario}"), name).expect("a scenario");
    let controllers = controllers::of(&scenario).len() as u64;
    let threads = Threads::start(name, &scenario);
    threads.begin(&scenario);
    prepare(&threads);
    let first = threads.wait_for_tick(from);
    COUNTS.iter().for_each(Counts::forget_sizes);
    let before = [PLANT, CONTROLLERS].map(|place| COUNTS[place].so_far());
    threads.wait_for_tick(to);
    let after = [PLANT, CONTROLLERS].map(|place| COUNTS[place].so_far());
    let sizes =
        [PLANT, CONTROLLERS].map(|place| (COUNTS[place].smallest.load(SeqCst), COUNTS[place].largest.load(SeqCst)));
    // A tick on either side may be half in the stretch.
    let ticks = threads.tick() - first + 2;
    threads.end();
    for (place, (who, per_tick, blocks)) in
        [("plant", 2, 1), ("controllers", controllers, controllers)].iter().enumerate()
    {
        let allocated = after[place].0 - before[place].0;
        let released = after[place].1 - before[place].1;
        let (smallest, largest) = sizes[place];
        assert!(0 < allocated && allocated <= per_tick * ticks, "{name}, {who}: {allocated} blocks in {ticks} ticks");
        assert!(smallest == largest && largest <= NOTE_MAX, "{name}, {who}: blocks of {smallest} to {largest} bytes");
        assert!(allocated.abs_diff(released) <= *blocks, "{name}, {who}: {allocated} blocks, {released} released");
    }
}

#[test]
fn the_realtime_loops_allocate_nothing_of_their_own_in_any_wake_up_mode() {
    for mode in ["hybrid", "block", "spin", "event"] {
        assert_only_notes(mode, &format!("[loop]\nwakeup = \"{mode}\"\n"), 300, 900);
    }
}

#[test]
fn the_realtime_loops_allocate_nothing_of_their_own_with_faults_and_a_failing_active_controller() {
    let scenario = "[controller]\nstandby = 2\n[plant]\nactuation_delay = \"3ms\"\n[plant.noise]\nq_rad = 1e-5\n\
                    [[fault]]\nkind = \"nan\"\ntarget = \"controller:1\"\nprobability = 0.1\n\
                    [[fault]]\nkind = \"drop\"\nprobability = 0.2\n\
                    [[fault]]\nkind = \"stale-setpoint\"\nprobability = 0.2\n";
    assert_only_notes("faults", scenario, 300, 900);
}

#[test]
fn the_realtime_loops_allocate_nothing_of_their_own_while_a_fault_befalls_them_that_was_asked_for() {
    for kind in [LiveFault::Delay, LiveFault::Drop, LiveFault::Nan, LiveFault::Glitch] {
        let scenario = "[controller]\nstandby = 1\n";
        assert_only_notes_with(kind.name(), scenario, 300, 900, |threads| {
            let (target, first, end, delay_ns) = (1, 400, 500, 200_000);
            let (command, option) = (CommandKind::Fault.code(), u64::from(kind.code()));
            threads.ask(Command {
                kind: command,
                controller: target,
                tick: first,
                ns: 100_000_000,
                option,
                ..Command::zeroed()
            });
            threads.block.faults().write(&Injected { kind, target, first, end, delay_ns, value_nm: 1.0 });
        });
    }
}

#[test]
fn the_lockstep_loops_allocate_nothing_of_their_own_for_any_number_of_links() {
    for links in 1..=7 {
        let scenario = format!("[loop]\nmode = \"lockstep\"\n[plant]\nlinks = {links}\n[controller]\nstandby = 1\n");
        assert_only_notes(&format!("lockstep-{links}"), &scenario, 2_000, 6_000);
    }
}

#[test]
fn an_allocation_of_a_role_is_counted() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let before = COUNTS[REFERENCE].so_far();
    let counted = thread::spawn(|| {
        ROLE.set(REFERENCE);
        drop(std::hint::black_box(Vec::<u64>::with_capacity(7)));
        ROLE.set(NOBODY);
    });
    counted.join().expect("it does not panic");
    let after = COUNTS[REFERENCE].so_far();
    assert_eq!((after.0 - before.0, after.1 - before.1), (1, 1), "one block and its release");
}
