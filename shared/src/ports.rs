//! The one module that touches iceoryx2 at run time: a group's node, its publishers, subscribers, events, commands.
//!
//! Isolation of groups is by prefix and root path, both derived from the group's own folder. Clean-up of dead nodes is
//! switched off here everywhere (it takes milliseconds in its caller) and done by the supervisor, off the hot path.
//!
//! What is sent is stamped here with its origin, and what comes is looked at here: what is not of this run, or not of the
//! process whose part it is to say it, is counted and goes no further. So no writer forgets the one, no reader the other.

use core::cell::{Cell, RefCell};
use core::time::Duration;
use std::sync::Arc;

use iceoryx2::node::NodeBuilder;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use thiserror::Error;

use crate::clock;
use crate::doorbell::ControlBlock;
use crate::event::{MessageKind, Refusal, ReplyKind, Role};
use crate::group::{Group, room, room::Need};
use crate::run_id::RunId;
use crate::sample::{Announce, Command, Message, Origin, Reply};
use crate::topics::{NODES_MAX, PUBLISHERS_MAX, SUBSCRIBERS_MAX, Topic};

/// Why a port could not be opened or used.
#[derive(Debug, Error)]
#[error("{what} of group `{group}`: {why}")]
pub struct PortError {
    what: String,
    group: String,
    why: String,
}

/// A process's membership in the group's shared memory.
pub struct Node {
    node: iceoryx2::node::Node<ipc::Service>,
    group: String,
    /// How the names of the group's shared-memory objects begin.
    prefix: String,
    run: Run,
}

/// The run that a port belongs to, and who may say what in it.
#[derive(Clone)]
struct Run {
    id: RunId,
    /// This process: asked for once, since to ask is a system call.
    pid: u32,
    /// None in a group without a control block, where the run's id must do.
    block: Option<Arc<ControlBlock>>,
}

impl Run {
    fn of(group: &Group) -> Result<Self, PortError> {
        let path = group.file("bell");
        let view = path.exists().then(|| ControlBlock::view(&path)).transpose();
        let block = view.map_err(|e| error(group.name(), "the control block", e))?.map(Arc::new);
        Ok(Self { id: group.run_id(), pid: std::process::id(), block })
    }

    /// Whether a message is of this run and of the process whose part it is to say it.
    fn hears<M: Message>(&self, message: &M) -> bool {
        match &self.block {
            // Who starts may speak before it is on the list: see `Announces`.
            Some(_) if M::KIND == MessageKind::Announce => message.origin().run_id == self.id.bits(),
            Some(block) => block.writers().vouch_for(self.id, message),
            None => message.origin().run_id == self.id.bits(),
        }
    }

    /// What this process is in `role`.
    fn origin(&self, role: Role) -> Origin {
        Origin { run_id: self.id.bits(), role: role.code(), pid: self.pid }
    }

    fn count(&self, kind: MessageKind) {
        if let Some(block) = &self.block {
            block.writers().count_stranger(kind);
        }
    }
}

/// What a port takes besides its samples, and the pages of the transport's own books, bytes: more than was ever seen.
const PORT_BYTES: u64 = 512 << 10;
/// The same of files: the node or port with its service.
const PORT_FILES: u64 = 8;

/// How long a port waits for the supervisor to clean up after the dead when all places are taken, and between two looks.
const ROOM_WITHIN_NS: u64 = 3_000_000_000;
const ROOM_AGAIN_NS: u64 = 20_000_000;

/// Tries for a while what the dead may stand in the way of.
fn with_patience<T>(mut attempt: impl FnMut() -> Result<T, PortError>) -> Result<T, PortError> {
    let until_ns = clock::now_ns() + ROOM_WITHIN_NS;
    loop {
        match attempt() {
            // By the transport's own names: `ExceedsMaxSupportedPublishers` and its kin.
            Err(e) if e.why.contains("ExceedsMax") => {
                if clock::now_ns() >= until_ns {
                    return Err(PortError { why: format!("living processes take all places ({})", e.why), ..e });
                }
                clock::sleep_ns(ROOM_AGAIN_NS);
            }
            done => return done,
        }
    }
}

fn error(group: &str, what: &str, why: impl core::fmt::Display) -> PortError {
    PortError { what: what.to_owned(), group: group.to_owned(), why: why.to_string() }
}

impl Node {
    /// Joins the group's shared memory. Takes 1–2 ms: before the real-time part.
    ///
    /// # Errors
    /// If the transport refuses (no room, no rights).
    pub fn open(group: &Group) -> Result<Self, PortError> {
        set_log_level(LogLevel::Fatal);
        let name = group.name();
        let config = configuration(group)?;
        room::require(Need { bytes: PORT_BYTES, files: PORT_FILES }).map_err(|e| error(name, "joining", e))?;
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| error(name, "joining", e))?;
        group.close_objects();
        Ok(Self { node, group: name.to_owned(), prefix: group.prefix(), run: Run::of(group)? })
    }

    /// Makes a port whose samples take `bytes`: not where there is no room for it, and with all its pages.
    fn make<P>(&self, what: &str, bytes: usize, port: impl FnOnce() -> Result<P, PortError>) -> Result<P, PortError> {
        room::require(Need { bytes: PORT_BYTES + bytes as u64, files: PORT_FILES })
            .map_err(|e| error(&self.group, what, e))?;
        let port = port()?;
        room::take(&self.prefix).map_err(|e| error(&self.group, what, e))?;
        Ok(port)
    }

    fn service_name(&self, what: &str) -> Result<ServiceName, PortError> {
        what.try_into().map_err(|e| error(&self.group, what, format!("{e:?}")))
    }

    fn topic<T: Topic>(
        &self,
    ) -> Result<iceoryx2::service::port_factory::publish_subscribe::PortFactory<ipc::Service, T, ()>, PortError> {
        self.node
            .service_builder(&self.service_name(T::NAME)?)
            .publish_subscribe::<T>()
            .enable_safe_overflow(true)
            .max_publishers(PUBLISHERS_MAX)
            .max_subscribers(SUBSCRIBERS_MAX)
            .max_nodes(NODES_MAX)
            .subscriber_max_buffer_size(T::DEPTH)
            .subscriber_max_borrowed_samples(2)
            .history_size(T::HISTORY)
            .open_or_create()
            .map_err(|e| error(&self.group, T::NAME, e))
    }

    /// A writer of topic `T`. Where the dead have taken all places it waits for the supervisor to clean up.
    ///
    /// # Errors
    /// If the topic has another layout (another build is in the group) or no room.
    pub fn publisher<T: Topic>(&self) -> Result<Publisher<T>, PortError> {
        with_patience(|| self.make(T::NAME, T::KEPT * size_of::<T>(), || self.try_publisher()))
    }

    fn try_publisher<T: Topic>(&self) -> Result<Publisher<T>, PortError> {
        let port = self
            .topic::<T>()?
            .publisher_builder()
            .max_loaned_samples(1)
            // Worst case is every subscriber full: room for four of them keeps locked memory small, and a loan that
            // fails is counted by its caller, never waited for.
            .override_sample_preallocation(|worst| worst.min(T::KEPT))
            .create()
            .map_err(|e| error(&self.group, T::NAME, e))?;
        Ok(Publisher { port, run: self.run.clone() })
    }

    /// A reader of topic `T` with a buffer of `depth` samples (at most [`Topic::DEPTH`]). Where the dead have taken all
    /// places it waits for the supervisor to clean up.
    ///
    /// # Errors
    /// If the topic has another layout (another build is in the group) or no room.
    pub fn subscriber<T: Topic>(&self, depth: usize) -> Result<Subscriber<T>, PortError> {
        with_patience(|| self.make(T::NAME, 0, || self.try_subscriber(depth)))
    }

    fn try_subscriber<T: Topic>(&self, depth: usize) -> Result<Subscriber<T>, PortError> {
        let port = self
            .topic::<T>()?
            .subscriber_builder()
            .buffer_size(depth.min(T::DEPTH))
            .create()
            .map_err(|e| error(&self.group, T::NAME, e))?;
        Ok(Subscriber { port, run: self.run.clone(), counts: true, strangers: Cell::new(0) })
    }

    /// A reader of what the processes say of themselves.
    ///
    /// # Errors
    /// As [`subscriber`](Self::subscriber).
    pub fn announces(&self) -> Result<Announces, PortError> {
        Ok(Announces {
            port: self.subscriber(Announce::DEPTH)?,
            unknown: RefCell::new([None; UNKNOWN_MAX]),
            waiting: Cell::new(0),
        })
    }

    /// The sending end of iceoryx2's own events, for the wake-up mode `event`.
    ///
    /// # Errors
    /// If there is no room.
    pub fn notifier(&self, bell: &str) -> Result<Notifier, PortError> {
        let failed = |e| error(&self.group, bell, e);
        let port =
            with_patience(|| self.make(bell, 0, || self.event(bell)?.notifier_builder().create().map_err(failed)))?;
        Ok(Notifier { port })
    }

    /// The waiting end of iceoryx2's own events. Only a member of the loop is ever a listener: each one costs every
    /// notification about 13 µs.
    ///
    /// # Errors
    /// If there is no room.
    pub fn listener(&self, bell: &str) -> Result<Listener, PortError> {
        let failed = |e| error(&self.group, bell, e);
        let port =
            with_patience(|| self.make(bell, 0, || self.event(bell)?.listener_builder().create().map_err(failed)))?;
        Ok(Listener { port })
    }

    fn event(
        &self,
        bell: &str,
    ) -> Result<iceoryx2::service::port_factory::event::PortFactory<ipc::Service>, PortError> {
        self.node
            .service_builder(&self.service_name(bell)?)
            .event()
            .max_listeners(SUBSCRIBERS_MAX)
            .max_notifiers(SUBSCRIBERS_MAX)
            .max_nodes(NODES_MAX)
            .open_or_create()
            .map_err(|e| error(&self.group, bell, e))
    }

    fn commands(
        &self,
    ) -> Result<
        iceoryx2::service::port_factory::request_response::PortFactory<ipc::Service, Command, (), Reply, ()>,
        PortError,
    > {
        self.node
            .service_builder(&self.service_name("command")?)
            .request_response::<Command, Reply>()
            .max_clients(PUBLISHERS_MAX)
            .max_servers(1)
            .max_nodes(NODES_MAX)
            .open_or_create()
            .map_err(|e| error(&self.group, "command", e))
    }

    /// The plant's end of the commands.
    ///
    /// # Errors
    /// If another process serves them already.
    pub fn command_server(&self) -> Result<CommandServer, PortError> {
        let failed = |e| error(&self.group, "command server", e);
        let port = self.make("command server", 0, || self.commands()?.server_builder().create().map_err(failed))?;
        Ok(CommandServer { port, run: self.run.clone() })
    }

    /// The supervisor's end of the commands.
    ///
    /// # Errors
    /// If there is no room.
    pub fn command_client(&self) -> Result<CommandClient, PortError> {
        let failed = |e| error(&self.group, "command client", e);
        let port = self.make("command client", 0, || self.commands()?.client_builder().create().map_err(failed))?;
        Ok(CommandClient { port, group: self.group.clone(), run: self.run.clone() })
    }

    /// Removes what dead processes of the group left behind. Takes milliseconds: the supervisor's, never in a loop.
    pub fn clean_up_dead_nodes(&self) {
        let _ = self.node.try_cleanup_dead_nodes();
    }
}

fn configuration(group: &Group) -> Result<Config, PortError> {
    let name = group.name();
    let mut config = Config::default();
    config.global.prefix =
        FileName::new(group.prefix().as_bytes()).map_err(|e| error(name, "prefix", format!("{e:?}")))?;
    let root = group.transport_root();
    config.global.set_root_path(
        &Path::new(root.as_os_str().as_encoded_bytes()).map_err(|e| error(name, "root path", format!("{e:?}")))?,
    );
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    Ok(config)
}

/// Writes samples of one topic.
pub struct Publisher<T: Topic> {
    port: iceoryx2::port::publisher::Publisher<ipc::Service, T, ()>,
    run: Run,
}

impl<T: Topic> Publisher<T> {
    /// Publishes a copy, with this process as its origin. False if no slot was free or the sample could not be delivered.
    pub fn send(&self, sample: T) -> bool {
        self.send_with(|slot| {
            slot.write(sample);
        })
    }

    /// Publishes a sample written where it stays (no copy), with this process as its origin. False if no slot was free.
    ///
    /// `fill` must initialise the whole slot.
    pub fn send_with(&self, fill: impl FnOnce(&mut core::mem::MaybeUninit<T>)) -> bool {
        let Ok(mut slot) = self.port.loan_uninit() else { return false };
        fill(slot.payload_mut());
        // SAFETY: `fill` has initialised the slot, as its contract says; T is plain data, so even a slot of an earlier
        // sample would be a value.
        #[expect(unsafe_code, reason = "the payload is built in place in shared memory")]
        let mut sample = unsafe { slot.assume_init() };
        let role = sample.payload().role();
        *sample.payload_mut().origin_mut() = role.map_or(Origin::zeroed(), |role| self.run.origin(role));
        sample.send().is_ok()
    }

    /// Maps what has joined since; in the slack, so that `send` need not. True if it succeeded.
    pub fn update_connections(&self) -> bool {
        self.port.update_connections().is_ok()
    }
}

/// Reads samples of one topic, and passes over those of strangers.
pub struct Subscriber<T: Topic> {
    port: iceoryx2::port::subscriber::Subscriber<ipc::Service, T, ()>,
    run: Run,
    counts: bool,
    strangers: Cell<u64>,
}

impl<T: Topic> Subscriber<T> {
    /// The most samples of strangers that one look passes over: with a flood, too, a look has an end.
    const PASSED_MAX: usize = 2 * T::DEPTH;

    /// The same reader, whose refusals another reader of the topic counts for the report.
    #[must_use]
    pub fn uncounted(self) -> Self {
        Self { counts: false, ..self }
    }

    /// The next sample, handed to `read` where it lies in shared memory.
    pub fn take_with<R>(&self, read: impl FnOnce(&T) -> R) -> Option<R> {
        for _ in 0..Self::PASSED_MAX {
            match self.port.receive() {
                Ok(Some(sample)) if self.run.hears(sample.payload()) => return Some(read(sample.payload())),
                Ok(Some(_)) => self.refuse(),
                // A connection that can't be mapped belongs to a process that has just died; the next look finds it gone.
                Ok(None) | Err(_) => return None,
            }
        }
        None
    }

    fn refuse(&self) {
        self.strangers.set(self.strangers.get() + 1);
        if self.counts {
            self.run.count(T::KIND);
        }
    }

    /// How many samples of strangers were passed over since this was last called.
    pub fn take_strangers(&self) -> u64 {
        self.strangers.take()
    }

    /// A copy of the next sample.
    #[must_use]
    pub fn take(&self) -> Option<T> {
        self.take_with(|sample| *sample)
    }

    /// A copy of the newest sample; older ones are dropped.
    #[must_use]
    pub fn latest(&self) -> Option<T> {
        let mut newest = None;
        while let Some(sample) = self.take() {
            newest = Some(sample);
        }
        newest
    }

    /// Maps what has joined since; in the slack, so that `take` need not. True if it succeeded.
    pub fn update_connections(&self) -> bool {
        self.port.update_connections().is_ok()
    }
}

/// Processes whose announcement may wait until the supervisor has entered them.
const UNKNOWN_MAX: usize = 16;
/// Who is not on the list by then is a stranger: the supervisor enters a child as soon as it has started it.
const KNOWN_WITHIN_NS: u64 = 2_000_000_000;

/// Reads what the processes of the run say of themselves. An announcement may be faster than the supervisor's list: it
/// waits until its writer is there. Monitors come by themselves, and need only be of this run.
pub struct Announces {
    port: Subscriber<Announce>,
    /// With the instant at which each is given up.
    unknown: RefCell<[Option<(Announce, u64)>; UNKNOWN_MAX]>,
    /// How many there are: none, as a rule.
    waiting: Cell<usize>,
}

impl Announces {
    /// The same reader, whose refusals another reader counts for the report.
    #[must_use]
    pub fn uncounted(self) -> Self {
        Self { port: self.port.uncounted(), ..self }
    }

    /// The next announcement of a process of this run.
    pub fn take(&self) -> Option<Announce> {
        while let Some(announce) = self.port.take() {
            match self.is_known(&announce) {
                Some(true) => return Some(announce),
                Some(false) => self.remember(announce),
                None => self.port.refuse(),
            }
        }
        if self.waiting.get() == 0 { None } else { self.take_known() }
    }

    /// Whether its writer is who it says it is; none if it can't become so.
    fn is_known(&self, announce: &Announce) -> Option<bool> {
        let role = Role::from_code(announce.role)?;
        let origin = announce.origin;
        if (origin.role, origin.pid) != (announce.role, announce.pid) || role == Role::Supervisor {
            return None;
        }
        let block = self.port.run.block.as_ref();
        let listed = block.is_none_or(|block| block.writers().vouch_for(self.port.run.id, announce));
        Some(listed || role == Role::Monitor)
    }

    /// One whose writer has been entered meanwhile; gives up those that have waited for too long.
    fn take_known(&self) -> Option<Announce> {
        let now_ns = clock::now_ns();
        for place in self.unknown.borrow_mut().iter_mut() {
            let Some((announce, until_ns)) = *place else { continue };
            let known = self.is_known(&announce) == Some(true);
            if known || now_ns >= until_ns {
                *place = None;
                self.waiting.set(self.waiting.get() - 1);
            }
            if known {
                return Some(announce);
            }
            if now_ns >= until_ns {
                self.port.refuse();
            }
        }
        None
    }

    /// Keeps the last word of each process; whom there is no room for is a stranger.
    fn remember(&self, announce: Announce) {
        let mut unknown = self.unknown.borrow_mut();
        let same = |(of, _): &(Announce, u64)| (of.role, of.id, of.pid) == (announce.role, announce.id, announce.pid);
        if let Some((kept, _)) = unknown.iter_mut().flatten().find(|kept| same(kept)) {
            *kept = announce;
            self.port.refuse();
        } else if let Some(free) = unknown.iter_mut().find(|place| place.is_none()) {
            *free = Some((announce, clock::now_ns() + KNOWN_WITHIN_NS));
            self.waiting.set(self.waiting.get() + 1);
        } else {
            self.port.refuse();
        }
    }

    /// After the last look: who still waits was a stranger.
    pub fn finish(&self) {
        for place in self.unknown.borrow_mut().iter_mut().filter(|place| place.is_some()) {
            *place = None;
            self.port.refuse();
        }
        self.waiting.set(0);
    }

    /// Maps what has joined since; in the slack. True if it succeeded.
    pub fn update_connections(&self) -> bool {
        self.port.update_connections()
    }
}

/// Rings iceoryx2's own events.
pub struct Notifier {
    port: iceoryx2::port::notifier::Notifier<ipc::Service>,
}

impl Notifier {
    /// Wakes all listeners. False if it could not.
    pub fn ring(&self) -> bool {
        self.port.notify().is_ok()
    }
}

/// Waits for iceoryx2's own events.
pub struct Listener {
    port: iceoryx2::port::listener::Listener<ipc::Service>,
}

impl Listener {
    /// Returns on the next event, or after `timeout_ns`.
    pub fn wait(&self, timeout_ns: u64) {
        // Whether an event, the timeout or a signal ended the wait: the caller looks for samples in any case.
        let _ = self.port.timed_wait(|_| {}, Duration::from_nanos(timeout_ns));
    }
}

/// The plant's end of the commands.
pub struct CommandServer {
    port: iceoryx2::port::server::Server<ipc::Service, Command, (), Reply, ()>,
    run: Run,
}

impl CommandServer {
    /// The most commands that one look answers: with a flood, too, a look has an end.
    const ANSWERED_MAX: usize = 4 * PUBLISHERS_MAX;

    /// Answers the supervisor's commands by `answer`, and refuses a stranger's. For the slack.
    pub fn answer_all(&self, mut answer: impl FnMut(&Command) -> Reply) {
        for _ in 0..Self::ANSWERED_MAX {
            let Ok(Some(request)) = self.port.receive() else { return };
            let mut reply = if self.run.hears(request.payload()) {
                answer(&request)
            } else {
                self.run.count(MessageKind::Command);
                let (kind, reason) = (ReplyKind::Refused.code(), Refusal::Stranger.code());
                Reply { kind, reason, ..Reply::zeroed() }
            };
            reply.origin = self.run.origin(Role::Plant);
            // The client may have died since; its answer then goes nowhere, and the command still counts.
            let _ = request.send_copy(reply);
        }
    }

    /// Maps what has joined since.
    pub fn update_connections(&self) -> bool {
        self.port.update_connections().is_ok()
    }
}

/// The supervisor's end of the commands.
pub struct CommandClient {
    port: iceoryx2::port::client::Client<ipc::Service, Command, (), Reply, ()>,
    group: String,
    run: Run,
}

impl CommandClient {
    /// Sends a command and waits for the plant's answer.
    ///
    /// # Errors
    /// If the plant does not answer within `timeout_ns`.
    pub fn ask(&self, command: Command, timeout_ns: u64) -> Result<Reply, PortError> {
        let command = Command { origin: self.run.origin(Role::Supervisor), ..command };
        let pending = self.port.send_copy(command).map_err(|e| error(&self.group, "command", e))?;
        let until_ns = clock::now_ns() + timeout_ns;
        loop {
            if let Ok(Some(reply)) = pending.receive() {
                if self.run.hears(reply.payload()) {
                    return Ok(*reply);
                }
                self.run.count(MessageKind::Reply);
                continue;
            }
            let now_ns = clock::now_ns();
            if now_ns >= until_ns {
                return Err(error(&self.group, "command", "the plant does not answer"));
            }
            clock::sleep_until_ns(now_ns + 200_000);
        }
    }
}
