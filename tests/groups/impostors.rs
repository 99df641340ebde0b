//! Processes that are not of a run and speak in it on every topic: what an earlier run left behind, what was started by hand.
//! They publish by the bare transport, since this project's own ports would not let them claim to be somebody else.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::prelude::*;
use loopbound_shared::clock;
use loopbound_shared::event::{CommandKind, MessageKind, Phase, Refusal, ReplyKind, Role};
use loopbound_shared::group::Group;
use loopbound_shared::ports::Subscriber;
use loopbound_shared::run_id::RunId;
use loopbound_shared::sample::{
    Announce, Command, Origin, Reply, Setpoint, State, TickRecord, Torque, record_flag, state_flag,
};
use loopbound_shared::topics::{NODES_MAX, PUBLISHERS_MAX, Topic};
use serde_json::Value;

use crate::fold::fingerprint;
use crate::harness::{Case, PATIENCE_S, Running};
use crate::lockstep::fingerprints_in_one_process;
use crate::strangers::{foreign_node, service};

/// An angle that no reference asks for, rad, and a torque that none gives, N·m.
const ABSURD: f64 = 1234.5;

type Client = iceoryx2::port::client::Client<ipc::Service, Command, (), Reply, ()>;

/// A process id of each role that has one, by the group's own list.
#[derive(Clone, Copy)]
struct Pids {
    plant: u32,
    reference: u32,
    controller: u32,
}

/// Everything by which an impostor speaks.
struct Impostor {
    setpoints: Publisher<ipc::Service, Setpoint, ()>,
    states: Publisher<ipc::Service, State, ()>,
    torques: Publisher<ipc::Service, Torque, ()>,
    records: Publisher<ipc::Service, TickRecord, ()>,
    announces: Publisher<ipc::Service, Announce, ()>,
    commands: Client,
    run: RunId,
    pids: Pids,
    _node: iceoryx2::node::Node<ipc::Service>,
}

fn publisher<T: Topic>(node: &iceoryx2::node::Node<ipc::Service>) -> Publisher<ipc::Service, T, ()> {
    service::<T, T>(node).expect("the topic").publisher_builder().create().expect("a publisher")
}

impl Impostor {
    fn join(group: &Group, pids: Pids) -> Self {
        let node = foreign_node(group);
        let commands = node
            .service_builder(&ServiceName::new("command").expect("a name"))
            .request_response::<Command, Reply>()
            .max_clients(PUBLISHERS_MAX)
            .max_servers(1)
            .max_nodes(NODES_MAX)
            .open_or_create()
            .expect("the commands");
        Self {
            setpoints: publisher(&node),
            states: publisher(&node),
            torques: publisher(&node),
            records: publisher(&node),
            announces: publisher(&node),
            commands: commands.client_builder().create().expect("a client"),
            run: group.run_id(),
            pids,
            _node: node,
        }
    }

    /// Says the worst there is on every topic, once as of another run with the true writer's process, and once as of this
    /// run with its own process or in another's role. The refusal of its command, if it was answered.
    fn say(&self, tick: u64) -> Option<Reply> {
        let Pids { plant, reference, controller } = self.pids;
        let own = std::process::id();
        let another = RunId::draw();
        for (run, plant, reference, controller) in [
            (another, plant, reference, controller),
            (self.run, own, own, own),
            (self.run, controller, plant, reference),
        ] {
            let origin = |role: Role, pid| Origin { run_id: run.bits(), role: role.code(), pid };
            let mut setpoint = Setpoint {
                origin: origin(Role::Reference, reference),
                tick,
                writer: 1,
                links: 3,
                ..Setpoint::zeroed()
            };
            setpoint.q_d[..3].fill(ABSURD);
            let _ = self.setpoints.send_copy(setpoint);
            let of_plant = origin(Role::Plant, plant);
            let _ = self.states.send_copy(State { origin: of_plant, flags: state_flag::LAST, ..State::zeroed() });
            let mut torque =
                Torque { origin: origin(Role::Controller, controller), tick, writer: 1, links: 3, ..Torque::zeroed() };
            torque.tau[..3].fill(ABSURD);
            let _ = self.torques.send_copy(torque);
            let flags = record_flag::LAST;
            let record = TickRecord { origin: of_plant, tick: 1 << 40, links: 3, flags, ..TickRecord::zeroed() };
            let _ = self.records.send_copy(record);
            for (role, pid) in [(Role::Plant, plant), (Role::Controller, controller)] {
                let _ = self.announces.send_copy(self.announce(origin(role, pid), role));
            }
        }
        let stop = Command {
            origin: Origin::in_process(Role::Supervisor),
            kind: CommandKind::StopAt.code(),
            ..Command::zeroed()
        };
        let pending = self.commands.send_copy(Command { tick: 1, ..stop }).ok()?;
        let until_ns = clock::now_ns() + 2_000_000;
        while clock::now_ns() < until_ns {
            if let Ok(Some(reply)) = pending.receive() {
                return Some(*reply);
            }
            clock::sleep_ns(100_000);
        }
        None
    }

    /// A controller of absurd gains, or a plant.
    fn announce(&self, origin: Origin, role: Role) -> Announce {
        let mut name = [0; 32];
        name[..8].copy_from_slice(b"impostor");
        let (pid, phase) = (origin.pid, Phase::Ready.code());
        let gains = Announce { law: 1, beta: ABSURD, k_t: ABSURD, ..Announce::zeroed() };
        Announce {
            origin,
            role: role.code(),
            id: 1,
            pid,
            phase,
            links: 3,
            name,
            published_ns: clock::now_ns(),
            ..gains
        }
    }
}

fn pids(running: &mut Running) -> Pids {
    running.wait_until_active();
    Pids {
        plant: running.process("plant", 1, &["ready"]),
        reference: running.process("reference", 1, &["ready"]),
        controller: running.process("controller", 1, &["active"]),
    }
}

/// Runs a group with impostors in it; the records that were seen, the report, and whether a command was refused.
fn with_impostors(what: &str, scenario: &str) -> (Vec<TickRecord>, Value, Vec<Reply>) {
    let case = Case::new(what);
    let mut running = case.run(scenario, &[]);
    let pids = pids(&mut running);
    let (node, group) = case.join();
    let records: Subscriber<TickRecord> = node.subscriber(usize::MAX).expect("a subscriber").uncounted();
    let over = AtomicBool::new(false);
    let (mut seen, mut refused) = (Vec::new(), Vec::new());
    std::thread::scope(|scope| {
        let said = scope.spawn(|| {
            let impostor = Impostor::join(&group, pids);
            let mut replies = Vec::new();
            for tick in 0.. {
                if over.load(Relaxed) {
                    break;
                }
                replies.extend(impostor.say(tick));
            }
            replies
        });
        let until_ns = clock::now_ns() + PATIENCE_S * clock::NS_PER_S;
        while seen.last().is_none_or(|last: &TickRecord| last.flags & record_flag::LAST == 0) {
            while let Some(record) = records.take() {
                seen.push(record);
            }
            let hopeless = clock::now_ns() >= until_ns || (seen.is_empty() && !running.runs());
            over.store(hopeless, Relaxed);
            assert!(!hopeless, "no last record: {}", running.said());
            clock::sleep_ns(200_000);
        }
        over.store(true, Relaxed);
        refused = said.join().expect("the impostor");
    });
    drop((records, node, group));
    let summary = running.wait().json();
    case.assert_nothing_left();
    (seen, summary, refused)
}

fn assert_unharmed(records: &[TickRecord], summary: &Value, refused: &[Reply]) {
    assert_eq!(summary["supervision"]["end"], "done", "{}", summary["supervision"]);
    assert_eq!(summary["supervision"]["deaths"], Value::Array(Vec::new()));
    assert_eq!(summary["ended"], "last record");
    let ticks = records.last().map(|last| last.counters.ticks + last.counters.skipped);
    let wanted =
        summary["scenario"]["loop"]["duration"].as_str().expect("a duration").trim_end_matches('s').parse::<f64>();
    assert_eq!(ticks.map(|ticks| ticks as f64 * 1e-3), wanted.ok(), "no command ended it");
    for record in records {
        assert!(record.q_d.iter().all(|q| q.abs() < 10.0), "tick {}: a stranger's setpoint", record.tick);
        for segment in &record.segments[..record.segments_used as usize] {
            assert!(segment.tau.iter().all(|tau| tau.abs() < ABSURD), "tick {}: {segment:?}", record.tick);
        }
    }
    assert!(!summary["processes"].to_string().contains("impostor"), "{}", summary["processes"]);
    assert!(summary["bound"]["k_t"].as_f64().is_some_and(|k_t| k_t < ABSURD), "{}", summary["bound"]);
    for kind in MessageKind::ALL.iter().filter(|kind| **kind != MessageKind::Reply) {
        assert!(summary["strangers"][kind.name()].as_u64() > Some(0), "{kind}: {}", summary["strangers"]);
    }
    assert!(!refused.is_empty(), "no command was answered");
    for reply in refused {
        assert_eq!((reply.kind, reply.reason), (ReplyKind::Refused.code(), Refusal::Stranger.code()));
    }
}

#[test]
fn in_real_time_what_impostors_say_on_any_topic_is_refused_counted_and_reported() {
    let (records, summary, refused) = with_impostors("impostors", "[loop]\nduration = \"2s\"\n");
    assert_unharmed(&records, &summary, &refused);
}

#[test]
fn in_lockstep_a_run_with_impostors_on_every_topic_is_the_run_without_to_the_bit() {
    let scenario = "[controller]\nstandby = 1\n[loop]\nmode = \"lockstep\"\nduration = \"20s\"\n";
    let (records, summary, refused) = with_impostors("impostors-ls", scenario);
    assert_unharmed(&records, &summary, &refused);
    let alone = fingerprints_in_one_process(scenario);
    for record in &records {
        // The count of refused torques is the one trace they leave in a record.
        let mut record = *record;
        record.counters.unknown_writer = 0;
        let tick = usize::try_from(record.tick).expect("a tick");
        assert_eq!(fingerprint(&record), alone[tick], "tick {tick}");
    }
}

#[test]
fn a_flood_of_torques_loses_no_members_answer_in_lockstep() {
    let case = Case::new("flood");
    let scenario = "[controller]\nstandby = 2\n[loop]\nmode = \"lockstep\"\nduration = \"20s\"\n";
    let mut running = case.run(scenario, &[]);
    let pids = pids(&mut running);
    let (node, group) = case.join();
    let impostor = Impostor::join(&group, pids);
    let origin = |run: RunId, pid| Origin { run_id: run.bits(), role: Role::Controller.code(), pid };
    let foreign = Torque { origin: origin(RunId::draw(), pids.controller), writer: 1, links: 3, ..Torque::zeroed() };
    // One that knows all of a member but the tick: only the order of the answers can keep it from doing harm.
    let knowing = Torque { origin: origin(group.run_id(), pids.controller), tick: 1 << 40, ..foreign };
    let mut sent: u64 = 0;
    while running.runs() {
        for _ in 0..64 {
            sent += u64::from(impostor.torques.send_copy(foreign).is_ok());
            sent += u64::from(impostor.torques.send_copy(knowing).is_ok());
        }
    }
    drop((impostor, node, group));
    let summary = running.wait().json();
    assert!(sent > 1000, "no flood");
    assert_eq!(summary["supervision"]["end"], "done", "{}", summary["supervision"]);
    assert_eq!(summary["supervision"]["deaths"], Value::Array(Vec::new()));
    assert_eq!((&summary["ticks"], &summary["missed_ticks"]), (&Value::from(20_000), &Value::from(0)));
    for counter in ["unknown_writer", "stale"] {
        assert!(summary["counters"][counter].as_u64() > Some(0), "{}", summary["counters"]);
    }
    case.assert_nothing_left();
}
