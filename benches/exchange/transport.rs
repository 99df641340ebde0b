//! iceoryx2 as it comes, with its defaults and without the project's ports: the baseline of the project's own exchange.

use std::time::Duration;

use anyhow::{Result, anyhow};
use iceoryx2::node::{Node, NodeBuilder};
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use loopbound_shared::group::Group;
use loopbound_shared::sample::{State, Torque};

/// One end: it sends `Out` and receives `In`.
pub(crate) struct End<Out: Payload, In: Payload> {
    publisher: Publisher<ipc::Service, Out, ()>,
    subscriber: Subscriber<ipc::Service, In, ()>,
    notifier: Notifier<ipc::Service>,
    listener: Listener<ipc::Service>,
    _node: Node<ipc::Service>,
}

/// A sample with the service that it travels by.
pub(crate) trait Payload: ZeroCopySend + Copy + std::fmt::Debug + 'static {
    const SERVICE: &'static str;
}

impl Payload for State {
    const SERVICE: &'static str = "bare-state";
}

impl Payload for Torque {
    const SERVICE: &'static str = "bare-torque";
}

impl<Out: Payload, In: Payload> End<Out, In> {
    /// Opens this end within the group's shared memory, so that the group's sweep takes it too.
    pub(crate) fn open(group: &Group) -> Result<Self> {
        let mut config = Config::default();
        config.global.prefix = FileName::new(group.prefix().as_bytes()).map_err(failed("prefix"))?;
        let root = group.transport_root();
        let root = Path::new(root.as_os_str().as_encoded_bytes()).map_err(failed("root path"))?;
        config.global.set_root_path(&root);
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(failed("node"))?;
        let topic = |name: &str| Ok::<_, anyhow::Error>(node.service_builder(&name.try_into().map_err(failed(name))?));
        let bell = |name: &str| topic(&format!("{name}-bell"))?.event().open_or_create().map_err(failed(name));
        let out = topic(Out::SERVICE)?.publish_subscribe::<Out>().open_or_create().map_err(failed(Out::SERVICE))?;
        let incoming = topic(In::SERVICE)?.publish_subscribe::<In>().open_or_create().map_err(failed(In::SERVICE))?;
        Ok(Self {
            publisher: out.publisher_builder().create().map_err(failed("publisher"))?,
            subscriber: incoming.subscriber_builder().create().map_err(failed("subscriber"))?,
            notifier: bell(Out::SERVICE)?.notifier_builder().create().map_err(failed("notifier"))?,
            listener: bell(In::SERVICE)?.listener_builder().create().map_err(failed("listener"))?,
            _node: node,
        })
    }

    /// Publishes, written where it stays.
    pub(crate) fn send(&self, sample: Out) {
        // A sample that could not be sent shows as an answer that does not come.
        if let Ok(slot) = self.publisher.loan_uninit() {
            let _ = slot.write_payload(sample).send();
        }
    }

    /// The next sample.
    pub(crate) fn take(&self) -> Option<In> {
        self.subscriber.receive().ok().flatten().map(|sample| *sample)
    }

    /// Notifies the other end.
    pub(crate) fn ring(&self) {
        // As for `send`.
        let _ = self.notifier.notify();
    }

    /// Sleeps until the other end notifies, at most `timeout_ns`.
    pub(crate) fn sleep(&self, timeout_ns: u64) {
        // However it ends, the caller looks for a sample.
        let _ = self.listener.timed_wait(|_| {}, Duration::from_nanos(timeout_ns));
    }
}

fn failed<E: std::fmt::Debug>(what: &str) -> impl Fn(E) -> anyhow::Error {
    move |error| anyhow!("iceoryx2: {what}: {error:?}")
}
