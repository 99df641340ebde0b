//! What strangers say on a group's topics is refused by the transport or counted by the plant, and never applied.

use iceoryx2::prelude::*;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenOrCreateError;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use loopbound_shared::clock;
use loopbound_shared::group::Group;
use loopbound_shared::ports::{Node, Publisher, Subscriber};
use loopbound_shared::sample::{State, TickRecord, Torque, record_flag, state_flag};
use loopbound_shared::topics::{NODES_MAX, PUBLISHERS_MAX, SUBSCRIBERS_MAX, Topic};
use serde_json::Value;

use crate::harness::{Case, PATIENCE_S};

/// A torque that would be seen at once in the plant's motion, N·m.
const ABSURD_NM: f64 = 1234.5;

/// As long as a [`Torque`] and aligned like one, yet another type.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
#[type_name("loopbound.Torque.of-another-build")]
struct Foreign {
    words: [u64; size_of::<Torque>() / 8],
}

/// Answers every state by what `forge` makes of it, until the last record; all records that were seen, and how many
/// torques were forged.
fn answer_by(node: &Node, mut forge: impl FnMut(&State) -> Torque) -> (Vec<TickRecord>, u64) {
    let torques: Publisher<Torque> = node.publisher().expect("a publisher");
    let states: Subscriber<State> = node.subscriber(usize::MAX).expect("a subscriber");
    let records: Subscriber<TickRecord> = node.subscriber(usize::MAX).expect("a subscriber");
    let (mut seen, mut forged) = (Vec::new(), 0);
    let until_ns = clock::now_ns() + PATIENCE_S * clock::NS_PER_S;
    while seen.last().is_none_or(|last: &TickRecord| last.flags & record_flag::LAST == 0) {
        while let Some(state) = states.take() {
            if state.flags & (state_flag::LAST | state_flag::WARM_UP) == 0 {
                forged += u64::from(torques.send(forge(&state)));
            }
        }
        while let Some(record) = records.take() {
            // Records of the warm-up have no links.
            if record.links != 0 {
                seen.push(record);
            }
        }
        assert!(clock::now_ns() < until_ns, "no last record");
        clock::sleep_ns(100_000);
    }
    (seen, forged)
}

fn absurd(state: &State) -> Torque {
    let mut torque = Torque {
        tick: state.tick,
        state_published_ns: state.published_ns,
        received_ns: state.published_ns,
        published_ns: clock::now_ns(),
        epoch: state.epoch,
        links: state.links,
        ..Torque::zeroed()
    };
    torque.tau[..state.links as usize].fill(ABSURD_NM);
    torque
}

/// Runs a group with a forger in it; its records, the number of forged torques, and the report.
fn forged(what: &str, scenario: &str, forge: impl FnMut(&State) -> Torque) -> (Vec<TickRecord>, u64, Value) {
    let case = Case::new(what);
    let mut running = case.run(scenario, &[]);
    running.wait_until_active();
    let (node, group) = case.join();
    let (records, count) = answer_by(&node, forge);
    drop((node, group));
    let summary = running.wait().json();
    case.assert_nothing_left();
    assert!(count > 0 && !records.is_empty(), "nothing was forged");
    (records, count, summary)
}

fn assert_only_obeyed(records: &[TickRecord], writers: &[u32]) {
    for record in records {
        for segment in &record.segments[..record.segments_used as usize] {
            assert!(writers.contains(&segment.writer), "tick {}: {segment:?}", record.tick);
            assert!(segment.tau.iter().all(|tau| tau.is_finite() && tau.abs() < ABSURD_NM), "{segment:?}");
        }
        assert!(record.q.iter().chain(&record.v).all(|x| x.is_finite()), "tick {}", record.tick);
    }
}

#[test]
fn torques_of_an_unknown_writer_are_counted_and_never_applied() {
    let scenario = "[loop]\nduration = \"800ms\"\n";
    let (records, count, summary) = forged("unknown", scenario, |state| Torque { writer: 99, ..absurd(state) });
    assert_only_obeyed(&records, &[0, 1]);
    let counted = summary["counters"]["unknown_writer"].as_u64().expect("a count");
    assert!(0 < counted && counted <= count, "{counted} counted of {count}");
}

#[test]
fn torques_that_bear_a_members_number_are_a_strangers_all_the_same_and_shut_nobody_out() {
    let scenario = "[loop]\nduration = \"800ms\"\n";
    let mut earlier = false;
    let (records, count, summary) = forged("members-number", scenario, |state| {
        earlier = !earlier;
        let tick = if earlier { state.tick.wrapping_sub(50) } else { state.tick };
        Torque { writer: 1, tick, ..absurd(state) }
    });
    assert_only_obeyed(&records, &[0, 1]);
    let counted = summary["counters"]["unknown_writer"].as_u64().expect("a count");
    assert!(0 < counted && counted <= count, "{counted} counted of {count}: {}", summary["counters"]);
    assert_eq!(summary["counters"]["duplicate"], 0, "the true torque of the tick is not shut out");
}

#[test]
fn torques_that_are_no_numbers_are_counted_and_never_applied() {
    // A member's own: a stranger's are not looked into.
    let fault =
        "[loop]\nduration = \"800ms\"\n[[fault]]\nkind = \"nan\"\nat = \"200ms\"\nfor = \"300ms\"\nevery = 10\n";
    for standby in [0, 1] {
        let scenario = format!("{fault}target = \"controller:1\"\n[controller]\nstandby = {standby}\n");
        let strange = |state: &State| Torque { writer: 99, links: 900, tau: [f64::NAN; 7], ..absurd(state) };
        let (records, _, summary) = forged(&format!("nan-{standby}"), &scenario, strange);
        assert_only_obeyed(&records, &[0, 1, 2]);
        let counted = summary["counters"]["not_finite"].as_u64().expect("a count");
        assert!((1..=30).contains(&counted), "{counted} of 30: {}", summary["counters"]);
    }
}

#[test]
fn a_publisher_of_another_layout_is_refused_by_the_transport() {
    let case = Case::new("foreign");
    let mut running = case.run("[loop]\nduration = \"600ms\"\n", &[]);
    running.wait_until_active();
    let (own, group) = case.join();
    let foreign = foreign_node(&group);
    let refused = torques_of::<Foreign>(&foreign);
    let refused = format!("{:?}", refused.expect_err("another layout must not be let in"));
    assert!(refused.contains("IncompatibleTypes"), "{refused}");
    // The same builder with the true type is let in, so it was the layout.
    let let_in = torques_of::<Torque>(&foreign);
    assert!(let_in.is_ok(), "{:?}", let_in.err());
    drop((let_in, foreign, own, group));
    let summary = running.wait().json();
    assert_eq!(summary["supervision"]["end"], "done");
    case.assert_nothing_left();
}

/// A node as one would make it with the bare transport, in the group's own part of the shared memory.
pub(crate) fn foreign_node(group: &Group) -> iceoryx2::node::Node<ipc::Service> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(group.prefix().as_bytes()).expect("a file name");
    let root = group.transport_root();
    config.global.set_root_path(&Path::new(root.as_os_str().as_encoded_bytes()).expect("a path"));
    NodeBuilder::new()
        .config(&config)
        .signal_handling_mode(SignalHandlingMode::Disabled)
        .create::<ipc::Service>()
        .expect("a node")
}

/// The service of the torques as this project builds it, with samples of another type perhaps.
fn torques_of<T: std::fmt::Debug + ZeroCopySend>(
    node: &iceoryx2::node::Node<ipc::Service>,
) -> Result<PortFactory<ipc::Service, T, ()>, PublishSubscribeOpenOrCreateError> {
    service::<Torque, T>(node)
}

/// The service of a topic as this project builds it, with samples of type `S`.
pub(crate) fn service<T: Topic, S: std::fmt::Debug + ZeroCopySend>(
    node: &iceoryx2::node::Node<ipc::Service>,
) -> Result<PortFactory<ipc::Service, S, ()>, PublishSubscribeOpenOrCreateError> {
    node.service_builder(&ServiceName::new(T::NAME).expect("a name"))
        .publish_subscribe::<S>()
        .enable_safe_overflow(true)
        .max_publishers(PUBLISHERS_MAX)
        .max_subscribers(SUBSCRIBERS_MAX)
        .max_nodes(NODES_MAX)
        .subscriber_max_buffer_size(T::DEPTH)
        .history_size(T::HISTORY)
        .open_or_create()
}
