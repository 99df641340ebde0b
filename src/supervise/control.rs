//! The socket in the group's folder by which `loopbound swap` and `loopbound fault` talk to the supervisor: one line of JSON
//! each way.
//!
//! The supervisor looks at it between its other looks, and waits for nobody: a client that says nothing has one of a few
//! places for a moment, and no look at it costs more than one system call.

use std::collections::VecDeque;
use std::fs::{File, Permissions};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use loopbound_model::law::LawKind;
use loopbound_shared::clock;
use loopbound_shared::group::Group;
use loopbound_shared::run_id::RunId;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::sockopt::socket_peercred;
use rustix::process::geteuid;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Name of the socket.
pub const FILE: &str = "control";
/// A client that has connected writes its line at once.
const LINE_WITHIN_NS: u64 = 1_000_000_000;
/// Clients that have not written their line yet; one more takes the place of the oldest.
const WAITING_MAX: usize = 16;
/// Connections taken at one look: the rest waits for the next.
const ACCEPTED_MAX: usize = 1024;
/// A socket's path is shorter.
const SOCKET_PATH_MAX: usize = 108;
/// No request is longer.
const LINE_MAX: usize = 64 * 1024;

/// What `loopbound swap` asks for: exactly one of `law`, `exe`, `to`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SwapRequest {
    /// A new process with this law.
    pub law: Option<LawKind>,
    /// A new process of this executable.
    pub exe: Option<PathBuf>,
    /// The standby with this number.
    pub to: Option<u32>,
    /// The tick to switch at; as soon as the gate passes if none is named.
    pub at_tick: Option<u64>,
    /// The cross-fade; that of `[swap_gate]` if none is named.
    pub blend_ns: Option<u64>,
    /// Skips the gate, not the safety checks.
    pub force: bool,
    /// The run that is meant, by its id; whichever runs if none is named.
    #[serde(default)]
    pub run: Option<String>,
}

/// What `loopbound fault` asks for. Its line is `{"fault": {…}}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultRequest {
    /// The name of a [`LiveFault`](loopbound_shared::event::LiveFault).
    pub kind: String,
    /// The controller it is injected into; the active one if none is named.
    pub controller: Option<u32>,
    /// How much later each torque comes; of a delay, which needs it not: late enough to be missed.
    pub delay_ns: Option<u64>,
    /// How long it lasts; nothing for a kill.
    pub for_ns: Option<u64>,
    /// What is added to the torque of the first link, N·m; of a glitch.
    pub value_nm: Option<f64>,
    /// The run that is meant, by its id; whichever runs if none is named.
    #[serde(default)]
    pub run: Option<String>,
}

/// What came of an injected fault.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FaultReport {
    /// The group.
    pub group: String,
    /// What was injected.
    pub kind: String,
    /// The controller it is injected into.
    pub controller: u32,
    /// The first tick that it can show in.
    pub tick: u64,
    /// How long it lasts; none of a kill.
    pub for_ns: Option<u64>,
    /// How much later each torque comes; of a delay.
    pub delay_ns: Option<u64>,
    /// What is added to the torque of the first link, N·m; of a glitch.
    pub value_nm: Option<f64>,
    /// `done` or `refused`.
    pub result: String,
    /// Whether the run is to end before the fault does.
    #[serde(default)]
    pub cut_short: bool,
    /// Why, where it was refused.
    pub reason: Option<String>,
}

/// One line of a client.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Another controller.
    Swap(SwapRequest),
    /// A fault.
    Fault(FaultRequest),
}

impl Request {
    fn from_line(line: &str) -> Result<Self, serde_json::Error> {
        let mut value: Value = serde_json::from_str(line)?;
        match value.get_mut("fault").map(Value::take) {
            Some(fault) => serde_json::from_value(fault).map(Self::Fault),
            None => serde_json::from_value(value).map(Self::Swap),
        }
    }

    /// The run that is meant.
    pub(super) fn run(&self) -> Option<&str> {
        match self {
            Self::Swap(swap) => swap.run.as_deref(),
            Self::Fault(fault) => fault.run.as_deref(),
        }
    }

    /// The same request, of this run.
    fn of_run(mut self, run: RunId) -> Self {
        let place = match &mut self {
            Self::Swap(swap) => &mut swap.run,
            Self::Fault(fault) => &mut fault.run,
        };
        *place = Some(run.to_string());
        self
    }

    fn to_line(&self) -> Result<String, serde_json::Error> {
        match self {
            Self::Swap(swap) => serde_json::to_string(swap),
            Self::Fault(fault) => serde_json::to_string(&serde_json::json!({ "fault": fault })),
        }
    }
}

/// What came of a swap.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SwapReport {
    /// The group.
    pub group: String,
    /// The active controller before.
    pub from: u32,
    /// The one that was to take over.
    pub to: u32,
    /// `done`, `refused` or `rolled back`.
    pub result: String,
    /// Why, where it was refused or rolled back.
    pub reason: Option<String>,
    /// The number that the reason is about …
    pub value: Option<f64>,
    /// … and what is allowed of it.
    pub limit: Option<f64>,
    /// The first tick of the new one, or the tick of the refusal.
    pub tick: u64,
    /// Ticks missed within 50 ms of the switch.
    pub missed_ticks: u64,
    /// Step of each joint's torque at the switch, N·m.
    pub torque_step_nm: Vec<f64>,
    /// Largest difference of the two controllers' torques when the swap was let through, N·m: what a cross-fade fades.
    pub torque_difference_nm: Option<f64>,
    /// Ticks of the cross-fade.
    pub blended_ticks: u64,
    /// Change of V over the first tick, in the V of the new law.
    pub delta_v: Option<f64>,
    /// Median round trip of the last 100 ms before the switch, ns.
    pub latency_before_ns: Option<u64>,
    /// Median round trip of the first 100 ms after it, ns.
    pub latency_after_ns: Option<u64>,
    /// From the command's arrival at the supervisor to the first torque of the new controller, ns.
    pub command_to_authority_ns: Option<u64>,
}

/// The supervisor's line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// The swap was tried.
    Report(Box<SwapReport>),
    /// The fault was injected, or not.
    Fault(Box<FaultReport>),
    /// The request makes no sense here.
    Usage(String),
}

/// The supervisor's end.
pub(super) struct Control {
    listener: UnixListener,
    waiting: VecDeque<Connection>,
}

impl Control {
    pub(super) fn open(group: &Group) -> std::io::Result<Self> {
        let path = group.file(FILE);
        let listener = by_short_path(&path, UnixListener::bind)?;
        // Nobody else may enter the folder; nor could anybody else use the socket.
        std::fs::set_permissions(&path, Permissions::from_mode(0o600))?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, waiting: VecDeque::new() })
    }

    /// The next client that has asked for something, with what it asks for.
    pub(super) fn accept(&mut self) -> Option<(Client, Result<Request, String>)> {
        for _ in 0..ACCEPTED_MAX {
            let Ok((stream, _)) = self.listener.accept() else { break };
            if !may_command(&stream) || stream.set_nonblocking(true).is_err() {
                continue;
            }
            let mut connection = Connection { stream, line: Vec::new(), since_ns: clock::now_ns() };
            // The rule: the line is there already.
            match connection.read() {
                Heard::Line(request) => return Some((Client { stream: connection.stream }, request)),
                Heard::Nothing if self.waiting.len() < WAITING_MAX => {}
                Heard::Nothing => drop(self.waiting.pop_front()),
                Heard::End => continue,
            }
            self.waiting.push_back(connection);
        }
        let now_ns = clock::now_ns();
        for _ in 0..self.waiting.len() {
            let mut connection = self.waiting.pop_front()?;
            match connection.read() {
                Heard::Line(request) => return Some((Client { stream: connection.stream }, request)),
                Heard::Nothing if now_ns < connection.since_ns + LINE_WITHIN_NS => self.waiting.push_back(connection),
                Heard::Nothing | Heard::End => {}
            }
        }
        None
    }
}

/// Somebody who has not written a whole line yet.
struct Connection {
    stream: UnixStream,
    line: Vec<u8>,
    since_ns: u64,
}

enum Heard {
    Line(Result<Request, String>),
    /// Nothing more for now.
    Nothing,
    /// It has left.
    End,
}

impl Connection {
    fn read(&mut self) -> Heard {
        let mut bytes = [0; 4096];
        loop {
            match self.stream.read(&mut bytes) {
                Ok(0) => return Heard::End,
                Ok(length) => self.line.extend_from_slice(&bytes[..length]),
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => return Heard::Nothing,
                Err(_) => return Heard::End,
            }
            if let Some(end) = self.line.iter().position(|byte| *byte == b'\n') {
                let line = String::from_utf8_lossy(&self.line[..end]);
                return Heard::Line(Request::from_line(&line).map_err(|e| e.to_string()));
            }
            if self.line.len() > LINE_MAX {
                return Heard::Line(Err(format!("it is longer than {LINE_MAX} bytes")));
            }
        }
    }
}

/// Whether the one at the other end is this user, or root: a command can start a program.
fn may_command(stream: &UnixStream) -> bool {
    socket_peercred(stream).is_ok_and(|peer| peer.uid == geteuid() || peer.uid.is_root())
}

/// Somebody who waits for an answer.
pub(super) struct Client {
    stream: UnixStream,
}

impl Client {
    /// Whether nobody waits at the other end any more. One that only has nothing more to say does.
    pub(super) fn has_left(&self) -> bool {
        let mut look = [PollFd::new(&self.stream, PollFlags::empty())];
        let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
        poll(&mut look, Some(&at_once)).is_ok() && look[0].revents().intersects(PollFlags::HUP | PollFlags::ERR)
    }

    /// Whoever has left meanwhile gets none, nor does one who leaves no room for a line.
    pub(super) fn answer(mut self, answer: &Answer) {
        let line = serde_json::to_string(answer).unwrap_or_default();
        let _ = self.stream.write_all(format!("{line}\n").as_bytes());
    }
}

/// Asks the supervisor of a running group and waits for its answer; `None` if the group ended meanwhile.
///
/// # Errors
/// If the group is not running, or has no such socket (yet).
pub fn connect(group: &str, request: &Request) -> anyhow::Result<Option<Answer>> {
    use anyhow::Context as _;
    let joined = Group::join(group)?;
    let mut stream = by_short_path(&joined.file(FILE), UnixStream::connect)
        .with_context(|| format!("the supervisor of group {group} does not answer"))?;
    writeln!(stream, "{}", request.clone().of_run(joined.run_id()).to_line()?)?;
    drop(joined);
    let mut line = String::new();
    // A supervisor that is killed closes the connection.
    BufReader::new(stream).read_line(&mut line).unwrap_or(0);
    Ok(serde_json::from_str(&line).ok())
}

/// A socket's path has room for 108 bytes, a folder's may be longer: then it is named by its descriptor.
fn by_short_path<T>(path: &Path, act: impl FnOnce(PathBuf) -> std::io::Result<T>) -> std::io::Result<T> {
    if path.as_os_str().len() < SOCKET_PATH_MAX {
        return act(path.to_owned());
    }
    let folder = File::open(path.parent().unwrap_or(Path::new("/")))?;
    act(PathBuf::from(format!("/proc/self/fd/{}/{FILE}", folder.as_raw_fd())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_reaches_the_supervisor_and_its_answer_the_client() {
        let name = format!("test-control-{}", std::process::id());
        let group = Group::create(&name).unwrap();
        let mut control = Control::open(&group).unwrap();
        let asked = Request::Swap(SwapRequest { law: Some(LawKind::Ctc), at_tick: Some(7), ..SwapRequest::default() });
        let (request, group_name) = (asked.clone(), name.clone());
        let client = std::thread::spawn(move || connect(&group_name, &request).unwrap());
        let (waiting, request) = loop {
            if let Some(found) = control.accept() {
                break found;
            }
            loopbound_shared::clock::sleep_ns(1_000_000);
        };
        assert_eq!(request.unwrap(), asked.of_run(group.run_id()));
        assert!(!waiting.has_left());
        let report = Answer::Report(Box::new(SwapReport { tick: 7, to: 2, ..SwapReport::default() }));
        waiting.answer(&report);
        assert_eq!(client.join().unwrap(), Some(report));
    }

    #[test]
    fn a_client_has_left_when_it_has_closed_its_end_and_not_when_it_has_said_all() {
        let (stream, other) = UnixStream::pair().unwrap();
        let client = Client { stream };
        assert!(!client.has_left());
        other.shutdown(std::net::Shutdown::Write).unwrap();
        assert!(!client.has_left(), "it waits for the answer");
        drop(other);
        assert!(client.has_left());
    }

    #[test]
    fn hundreds_who_say_nothing_have_a_few_places_and_keep_nobody_else_from_being_heard() {
        let group = Group::create(&format!("test-control-idle-{}", std::process::id())).unwrap();
        let mut control = Control::open(&group).unwrap();
        let mut idle = Vec::new();
        for round in 0..500 {
            idle.push(UnixStream::connect(group.file(FILE)).unwrap());
            // The system holds about a hundred connections that nobody has taken.
            if round % 50 == 0 {
                assert!(control.accept().is_none());
            }
        }
        assert!(control.accept().is_none());
        assert_eq!(control.waiting.len(), WAITING_MAX);
        let mut half = UnixStream::connect(group.file(FILE)).unwrap();
        half.write_all(b"{\"to\": 3, \"for").unwrap();
        assert!(control.accept().is_none());
        half.write_all(b"ce\": true}\n").unwrap();
        let (_, request) = control.accept().expect("a line in two parts is heard");
        let force = SwapRequest { to: Some(3), force: true, ..SwapRequest::default() };
        assert_eq!(request.unwrap(), Request::Swap(force));
        let mut endless = UnixStream::connect(group.file(FILE)).unwrap();
        endless.set_nonblocking(true).unwrap();
        while endless.write(&[b'x'; 4096]).is_ok() {}
        let refused = loop {
            if let Some((_, request)) = control.accept() {
                break request.unwrap_err();
            }
            while endless.write(&[b'x'; 4096]).is_ok() {}
        };
        assert!(refused.contains("longer"), "{refused}");
        for connection in &mut control.waiting {
            connection.since_ns -= LINE_WITHIN_NS;
        }
        assert!(control.accept().is_none());
        assert_eq!(control.waiting.len(), 0, "their time is over");
    }

    #[test]
    fn a_line_with_a_fault_is_one_and_any_other_is_a_swap() {
        let fault = FaultRequest { kind: "delay".into(), delay_ns: Some(5), ..FaultRequest::default() };
        for request in [Request::Fault(fault), Request::Swap(SwapRequest::default())] {
            assert_eq!(Request::from_line(&request.to_line().unwrap()).unwrap(), request);
        }
        for line in ["{\"fault\": {\"kid\": 1}}", "{\"fault\": 3}", "{\"lwa\": \"ctc\"}", "3"] {
            assert!(Request::from_line(line).is_err(), "{line}");
        }
    }

    #[test]
    fn a_supervisor_that_dies_leaves_no_client_waiting_and_a_group_that_is_not_there_is_named() {
        let name = format!("test-control-dead-{}", std::process::id());
        let group = Group::create(&name).unwrap();
        let mut control = Control::open(&group).unwrap();
        let group_name = name.clone();
        let client = std::thread::spawn(move || connect(&group_name, &Request::Swap(SwapRequest::default())).unwrap());
        while control.accept().is_none() {
            loopbound_shared::clock::sleep_ns(1_000_000);
        }
        assert_eq!(client.join().unwrap(), None);
        drop((control, group));
        assert!(connect(&name, &Request::Swap(SwapRequest::default())).unwrap_err().to_string().contains(&name));
    }
}
