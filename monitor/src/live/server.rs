//! The server: channels of the SDK, fed with the recording's messages while somebody is subscribed to them.

use std::net::TcpListener;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;

use foxglove::websocket::Status;
use foxglove::{
    ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, WebSocketServer, WebSocketServerHandle,
};
use loopbound_shared::clock::{NS_PER_S, sleep_ns};
use loopbound_shared::sample::TickRecord;
use loopbound_shared::spawn;

use super::relay::{Relay, hidden_address, hidden_host};
use super::stretch::Stretches;
use super::{Address, LiveError, Origin};
use crate::counted::counted;
use crate::event::{Event, EventKind};
use crate::recording::About;
use crate::recording::channels::Channel;
use crate::recording::views::Views;
use crate::tracker::Row;

/// Between two words about the same loss.
const STATUS_NS: u64 = NS_PER_S;
/// Time for clients to take the last messages …
const LINGER_NS: u64 = 100_000_000;
/// … and to answer the farewell: one that hangs must not keep the monitor.
const FAREWELL: Duration = Duration::from_millis(300);

/// Serves a run until it is stopped.
pub struct Live {
    server: WebSocketServerHandle,
    relay: Relay,
    address: Address,
    feed: Feed,
    events: Arc<RawChannel>,
    stretches: Stretches,
    /// Clients at the last look: a new one is told what the others have been told.
    clients: usize,
    lost: Lost,
    /// Channels live as long as their context.
    _context: Arc<Context>,
}

/// What is made of a tick that is shown.
struct Feed {
    ticks: Arc<RawChannel>,
    scene: Arc<RawChannel>,
    views: Views,
}

/// Records that did not reach this monitor.
#[derive(Default)]
struct Lost {
    records: u64,
    told: u64,
    due_ns: u64,
}

impl Live {
    /// Serves the run that `about` is of, with ticks of `period_ns`, at `address`, to pages of `origins` too.
    ///
    /// # Errors
    /// If the address can't be had, or the server can't start.
    pub fn start(
        address: &Address,
        origins: &[Origin],
        about: &About,
        period_ns: u64,
        lockstep: bool,
    ) -> Result<Self, LiveError> {
        let listener = TcpListener::bind(address.to_string());
        let listener = listener.map_err(|source| LiveError::Bind { address: address.clone(), source })?;
        let context = Context::new();
        let refused = |error: FoxgloveError| LiveError::Server(error.to_string());
        let [ticks, events, scene] = Channel::SHOWN.map(|channel| open(&context, channel));
        let (ticks, events, scene) = (ticks.map_err(refused)?, events.map_err(refused)?, scene.map_err(refused)?);
        let hidden = hidden_host();
        // Its runtime panics where there is none to be had: one for each core, and one that serves as they need it.
        let threads = std::thread::available_parallelism().map_or(1, usize::from) + 2;
        spawn::require_threads(threads).map_err(|error| LiveError::Server(error.to_string()))?;
        let server = WebSocketServer::new()
            .context(&context)
            .name(format!("loopbound {}", about.group))
            .bind(hidden.to_string(), 0)
            .start_blocking()
            .map_err(refused)?;
        let relay = Relay::start(listener, hidden_address(hidden, server.port()), origins.to_vec());
        Ok(Self {
            relay: relay.map_err(|error| LiveError::Server(error.to_string()))?,
            server,
            address: address.clone(),
            feed: Feed { ticks, scene, views: Views::new(about) },
            events,
            stretches: Stretches::new(period_ns, lockstep),
            clients: 0,
            lost: Lost::default(),
            _context: context,
        })
    }

    /// What to connect to.
    #[must_use]
    pub fn url(&self) -> String {
        format!("ws://{}:{}", self.address.host(), self.relay.port())
    }

    /// Takes a tick, at `now_ns` on the wall.
    pub fn tick(&mut self, record: &TickRecord, row: &Row, now_ns: u64) {
        let Self { feed, stretches, .. } = self;
        feed.views.heed_clock(record);
        stretches.take(record, row, now_ns, |record, row| feed.show(record, row));
    }

    /// Takes an event.
    pub fn event(&mut self, event: &Event) {
        if let EventKind::Gap { ticks } = event.kind {
            self.lost.records = self.lost.records.saturating_add(ticks);
        }
        if self.events.has_sinks() {
            let views = &self.feed.views;
            self.events.log_with_meta(views.log_line(event).as_bytes(), at(views.wall_ns(event.plant_ns)));
        }
    }

    /// Tells clients what they can't see of the messages: what is left out, and what was lost on the way here.
    pub fn care(&mut self, now_ns: u64) {
        let clients = self.server.client_count();
        let somebody_new = clients > self.clients;
        self.clients = clients;
        let stretch = self.stretches.ticks();
        if somebody_new && stretch > 1 {
            let text = format!("of {stretch} ticks one is shown: the one with the latest torque, or the missed one");
            self.server.publish_status(Status::info(text).with_id("stretch"));
        }
        let lost = &mut self.lost;
        let more = lost.records > lost.told && now_ns >= lost.due_ns;
        if more || (somebody_new && lost.records > 0) {
            (lost.told, lost.due_ns) = (lost.records, now_ns + STATUS_NS);
            let text = {
                let records = counted(lost.records, "record");
                format!("{records} did not reach this view: the monitor could not keep up")
            };
            self.server.publish_status(Status::warning(text).with_id("lost"));
        }
    }

    /// Says farewell to the clients, within a moment.
    pub fn stop(mut self) {
        let Self { feed, stretches, .. } = &mut self;
        stretches.finish(|record, row| feed.show(record, row));
        if self.server.client_count() > 0 {
            sleep_ns(LINGER_NS);
        }
        let (sender, ended) = channel();
        let farewell = self.server.stop();
        let wait = move || {
            farewell.wait_blocking();
            // Nobody waits any more if it took too long.
            let _ = sender.send(());
        };
        if spawn::thread("farewell", wait).is_ok() {
            let _ = ended.recv_timeout(FAREWELL);
        }
        self.relay.stop();
    }
}

impl Feed {
    fn show(&mut self, record: &TickRecord, row: &Row) {
        let time_ns = self.views.wall_ns(record.start_plant_ns);
        if self.ticks.has_sinks() {
            self.ticks.log_with_meta(self.views.figures(record, row), at(time_ns));
        }
        if self.scene.has_sinks()
            && let Some(scene) = self.views.scene(record, row)
        {
            self.scene.log_with_meta(scene.as_bytes(), at(time_ns));
        }
    }
}

fn at(time_ns: u64) -> PartialMetadata {
    PartialMetadata { log_time: Some(time_ns) }
}

fn open(context: &Arc<Context>, channel: Channel) -> Result<Arc<RawChannel>, FoxgloveError> {
    let schema = channel.schema();
    ChannelBuilder::new(channel.topic())
        .context(context)
        .message_encoding(channel.encoding())
        .schema(foxglove::Schema::new(schema.name, schema.encoding, schema.data))
        .build_raw()
}
