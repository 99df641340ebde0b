//! The one module that touches iceoryx2 at run time: a group's node, its publishers, subscribers, events, commands.
//!
//! Isolation of groups is by prefix and root path, both derived from the group's own folder. Clean-up of dead nodes is
//! switched off here everywhere (it takes milliseconds in its caller) and done by the supervisor, off the hot path.

use core::time::Duration;

use iceoryx2::node::NodeBuilder;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use thiserror::Error;

use crate::group::Group;
use crate::sample::{Command, Reply};
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
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(|e| error(name, "joining", e))?;
        group.close_objects();
        Ok(Self { node, group: name.to_owned() })
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

    /// A writer of topic `T`.
    ///
    /// # Errors
    /// If the topic has another layout (another build is in the group) or no room.
    pub fn publisher<T: Topic>(&self) -> Result<Publisher<T>, PortError> {
        let port = self
            .topic::<T>()?
            .publisher_builder()
            .max_loaned_samples(1)
            // Worst case is every subscriber full: room for four of them keeps locked memory small, and a loan that
            // fails is counted by its caller, never waited for.
            .override_sample_preallocation(|worst| worst.min(4 * T::DEPTH + T::HISTORY + 16))
            .create()
            .map_err(|e| error(&self.group, T::NAME, e))?;
        Ok(Publisher { port })
    }

    /// A reader of topic `T` with a buffer of `depth` samples (at most [`Topic::DEPTH`]).
    ///
    /// # Errors
    /// If the topic has another layout (another build is in the group) or no room.
    pub fn subscriber<T: Topic>(&self, depth: usize) -> Result<Subscriber<T>, PortError> {
        let port = self
            .topic::<T>()?
            .subscriber_builder()
            .buffer_size(depth.min(T::DEPTH))
            .create()
            .map_err(|e| error(&self.group, T::NAME, e))?;
        Ok(Subscriber { port })
    }

    /// The sending end of iceoryx2's own events, for the wake-up mode `event`.
    ///
    /// # Errors
    /// If there is no room.
    pub fn notifier(&self, bell: &str) -> Result<Notifier, PortError> {
        let service = self.event(bell)?;
        let port = service.notifier_builder().create().map_err(|e| error(&self.group, bell, e))?;
        Ok(Notifier { port })
    }

    /// The waiting end of iceoryx2's own events. Only a member of the loop is ever a listener: each one costs every
    /// notification about 13 µs.
    ///
    /// # Errors
    /// If there is no room.
    pub fn listener(&self, bell: &str) -> Result<Listener, PortError> {
        let service = self.event(bell)?;
        let port = service.listener_builder().create().map_err(|e| error(&self.group, bell, e))?;
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
        let port = self.commands()?.server_builder().create().map_err(|e| error(&self.group, "command server", e))?;
        Ok(CommandServer { port })
    }

    /// The supervisor's end of the commands.
    ///
    /// # Errors
    /// If there is no room.
    pub fn command_client(&self) -> Result<CommandClient, PortError> {
        let port = self.commands()?.client_builder().create().map_err(|e| error(&self.group, "command client", e))?;
        Ok(CommandClient { port, group: self.group.clone() })
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
}

impl<T: Topic> Publisher<T> {
    /// Publishes a copy. False if no slot was free or the sample could not be delivered.
    pub fn send(&self, sample: T) -> bool {
        self.send_with(|slot| {
            slot.write(sample);
        })
    }

    /// Publishes a sample written where it stays (no copy). False if no slot was free.
    ///
    /// `fill` must initialise the whole slot.
    pub fn send_with(&self, fill: impl FnOnce(&mut core::mem::MaybeUninit<T>)) -> bool {
        let Ok(mut slot) = self.port.loan_uninit() else { return false };
        fill(slot.payload_mut());
        // SAFETY: `fill` has initialised the slot, as its contract says; T is plain data, so even a slot of an earlier
        // sample would be a value.
        #[expect(unsafe_code, reason = "the payload is built in place in shared memory")]
        let sample = unsafe { slot.assume_init() };
        sample.send().is_ok()
    }

    /// Maps what has joined since; in the slack, so that `send` need not. True if it succeeded.
    pub fn update_connections(&self) -> bool {
        self.port.update_connections().is_ok()
    }
}

/// Reads samples of one topic.
pub struct Subscriber<T: Topic> {
    port: iceoryx2::port::subscriber::Subscriber<ipc::Service, T, ()>,
}

impl<T: Topic> Subscriber<T> {
    /// The next sample, handed to `read` where it lies in shared memory.
    pub fn take_with<R>(&self, read: impl FnOnce(&T) -> R) -> Option<R> {
        match self.port.receive() {
            Ok(Some(sample)) => Some(read(sample.payload())),
            // A connection that can't be mapped belongs to a process that has just died; the next look finds it gone.
            Ok(None) | Err(_) => None,
        }
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
}

impl CommandServer {
    /// Answers every command that waits, by `answer`. For the slack. Returns how many there were.
    pub fn answer_all(&self, mut answer: impl FnMut(&Command) -> Reply) -> usize {
        let mut count = 0;
        while let Ok(Some(request)) = self.port.receive() {
            // The client may have died since; its answer then goes nowhere, and the command still counts.
            let _ = request.send_copy(answer(&request));
            count += 1;
        }
        count
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
}

impl CommandClient {
    /// Sends a command and waits for the plant's answer.
    ///
    /// # Errors
    /// If the plant does not answer within `timeout_ns`.
    pub fn ask(&self, command: Command, timeout_ns: u64) -> Result<Reply, PortError> {
        let pending = self.port.send_copy(command).map_err(|e| error(&self.group, "command", e))?;
        let until_ns = crate::clock::now_ns() + timeout_ns;
        loop {
            if let Ok(Some(reply)) = pending.receive() {
                return Ok(*reply);
            }
            let now_ns = crate::clock::now_ns();
            if now_ns >= until_ns {
                return Err(error(&self.group, "command", "the plant does not answer"));
            }
            crate::clock::sleep_until_ns(now_ns + 200_000);
        }
    }
}
