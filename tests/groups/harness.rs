//! Starts the executable, waits for it with an end to every wait, and makes sure that nothing is left of it.

use std::fs::{self, File};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

use loopbound_shared::clock;
use loopbound_shared::group::{Group, object_prefix, runtime_folder};
use loopbound_shared::ports::Node;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::TempDir;

use crate::untested::not_tested;

/// The longest that any wait may last, s: far beyond what a loaded machine takes, and short of a hang.
pub(crate) const PATIENCE_S: u64 = 30;
/// Who has no privileges at all.
pub(crate) const NOBODY: u32 = 65534;

static TURN: Mutex<()> = Mutex::new(());

/// One test's group: its name, its files, and the turn.
pub(crate) struct Case {
    /// Name of the group.
    pub(crate) group: String,
    /// A folder for the test's own files, readable by everyone.
    pub(crate) work: TempDir,
    /// Where the executable is told to keep its groups.
    folder: PathBuf,
    user: Option<u32>,
    _turn: MutexGuard<'static, ()>,
}

impl Case {
    /// Waits for the turn. `what` tells this test's group from the others'.
    pub(crate) fn new(what: &str) -> Self {
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let work = tempfile::tempdir().expect("a temporary folder");
        open_to_all(work.path());
        let group = format!("t{}-{what}", std::process::id());
        Self { group, work, folder: default_folder(), user: None, _turn: turn }
    }

    /// The same, with a runtime folder that no other group is in.
    pub(crate) fn apart(what: &str) -> Self {
        let mut case = Self::new(what);
        case.folder = PathBuf::from(format!("/dev/shm/loopbound-{}", case.group));
        case
    }

    /// The same, as a user without privileges; the executable is copied to where that user may read it.
    pub(crate) fn as_nobody(what: &str) -> Self {
        let mut case = Self::apart(what);
        if rustix::process::getuid().is_root() {
            case.user = Some(NOBODY);
            let copy = case.work.path().join("loopbound");
            fs::copy(env!("CARGO_BIN_EXE_loopbound"), copy).expect("a copy of the executable");
        }
        case
    }

    /// The runtime folder of this case.
    pub(crate) fn runtime_folder(&self) -> &Path {
        &self.folder
    }

    /// The same command as a user without privileges; `None`, and a note of it, if this process may not become one.
    pub(crate) fn command_of_a_stranger(&self, arguments: &[&str]) -> Option<Command> {
        self.strangers_command_of(Path::new(env!("CARGO_BIN_EXE_loopbound")), arguments)
    }

    /// The same of another executable, which is copied to where that user may read it.
    pub(crate) fn strangers_command_of(&self, executable: &Path, arguments: &[&str]) -> Option<Command> {
        if !rustix::process::getuid().is_root() {
            not_tested("another user", "only root can come as one");
            return None;
        }
        let copy = self.work.path().join("strangers-copy");
        fs::copy(executable, &copy).expect("a copy of the executable");
        let mut command = Command::new(copy);
        command.args(arguments).env("LOOPBOUND_RUNTIME_DIR", &self.folder).current_dir(self.work.path());
        command.uid(NOBODY).gid(NOBODY);
        Some(command)
    }

    /// Writes a file of the test's own.
    pub(crate) fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.work.path().join(name);
        fs::write(&path, text).expect("a file of the test");
        path
    }

    /// The executable with these arguments.
    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let exe = match self.user {
            Some(_) => self.work.path().join("loopbound"),
            None => PathBuf::from(env!("CARGO_BIN_EXE_loopbound")),
        };
        let mut command = Command::new(exe);
        command.args(arguments).env("LOOPBOUND_RUNTIME_DIR", &self.folder).current_dir(self.work.path());
        if let Some(user) = self.user {
            command.uid(user).gid(user);
        }
        command
    }

    /// Starts a scenario's group in this case's name, for one JSON document.
    pub(crate) fn run(&self, scenario: &str, arguments: &[&str]) -> Running {
        let file = self.write("scenario.toml", scenario);
        let mut all = vec!["run", file.to_str().expect("a path in UTF-8"), "--group", &self.group, "--json"];
        all.extend(arguments);
        self.start(&all)
    }

    /// Starts the executable with its output in files.
    pub(crate) fn start(&self, arguments: &[&str]) -> Running {
        self.start_command(self.command(arguments))
    }

    /// Starts a command with its output in files.
    pub(crate) fn start_command(&self, mut command: Command) -> Running {
        let out = tempfile::tempfile_in(self.work.path()).expect("a file for the output");
        let err = tempfile::tempfile_in(self.work.path()).expect("a file for the errors");
        let copy = |file: &File| Stdio::from(file.try_clone().expect("a second descriptor"));
        command.stdin(Stdio::null()).stdout(copy(&out)).stderr(copy(&err));
        let child = command.spawn().expect("the executable starts");
        Running { child, out, err, roster: self.group_folder().join("processes.json"), reaped: false }
    }

    /// Runs the executable to its end.
    pub(crate) fn output(&self, arguments: &[&str]) -> Ended {
        self.start(arguments).wait()
    }

    /// The folder of this case's group.
    pub(crate) fn group_folder(&self) -> PathBuf {
        self.folder.join(&self.group)
    }

    /// Joins the running group as a stranger would; it must be in the default runtime folder.
    pub(crate) fn join(&self) -> (Node, Group) {
        assert_eq!(self.folder, default_folder(), "this process can only join groups of its own runtime folder");
        wait_until("the group is there", || self.group_folder().join("bell").exists());
        let group = Group::join(&self.group).expect("the group can be joined");
        (Node::open(&group).expect("a node in the group"), group)
    }

    /// Everyone who was started for this case's group, the keeper too.
    pub(crate) fn everyone(&self) -> Vec<u32> {
        let number = |line: &String| line.split_once(':')?.0.parse().ok();
        processes_that_mention(&self.group).iter().filter_map(number).collect()
    }

    /// The keeper's process id, once there is one other than `but`.
    pub(crate) fn keeper(&self, but: u32) -> u32 {
        let mut keeper = None;
        wait_until("there is a keeper", || {
            let lines = processes_that_mention(&self.group);
            let of_keeper = |line: &&String| line.contains(" keeper --group ");
            let pids = lines.iter().filter(of_keeper).filter_map(|line| line.split_once(':')?.0.parse().ok());
            keeper = pids.into_iter().find(|pid| *pid != but);
            keeper.is_some()
        });
        keeper.expect("a process id")
    }

    /// Whether any process lives that was started for this case's group.
    pub(crate) fn is_mentioned(&self) -> bool {
        !processes_that_mention(&self.group).is_empty()
    }

    /// Asserts that nothing is left of `group` in memory and among the processes.
    pub(crate) fn assert_nothing_left_of(&self, group: &str) {
        let folder = self.folder.join(group);
        assert!(!folder.exists(), "left behind: {}: {:?}", folder.display(), names(&folder));
        let prefix = object_prefix(&folder);
        let objects: Vec<String> =
            names(Path::new("/dev/shm")).into_iter().filter(|name| name.starts_with(&prefix)).collect();
        assert!(objects.is_empty(), "left in shared memory: {objects:?}");
        let processes = processes_that_mention(group);
        assert!(processes.is_empty(), "still running: {processes:?}");
    }

    /// Asserts that nothing is left of this case's group, now or very soon: children of a killed launcher need a moment.
    pub(crate) fn assert_nothing_left(&self) {
        wait_until("all processes have ended", || processes_that_mention(&self.group).is_empty());
        self.assert_nothing_left_of(&self.group);
        if self.folder != default_folder() {
            assert!(!self.folder.exists(), "left behind: {:?}", names(&self.folder));
        }
    }
}

fn default_folder() -> PathBuf {
    runtime_folder().expect("a valid runtime directory")
}

fn open_to_all(folder: &Path) {
    use std::os::unix::fs::PermissionsExt as _;
    fs::set_permissions(folder, fs::Permissions::from_mode(0o777)).expect("the folder's permissions");
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

/// Command lines, other than this process's own, in which `word` is an argument.
pub(crate) fn processes_that_mention(word: &str) -> Vec<String> {
    let own = std::process::id().to_string();
    let numbers = names(Path::new("/proc")).into_iter().filter(|n| n.bytes().all(|c| c.is_ascii_digit()) && *n != own);
    let lines = numbers.filter_map(|number| {
        let bytes = fs::read(format!("/proc/{number}/cmdline")).ok()?;
        let mentioned = bytes.split(|byte| *byte == 0).any(|argument| argument == word.as_bytes());
        mentioned.then(|| format!("{number}: {}", String::from_utf8_lossy(&bytes).replace('\0', " ")))
    });
    lines.collect()
}

/// Waits until something holds; panics when it takes longer than [`PATIENCE_S`].
pub(crate) fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let until_ns = clock::now_ns() + PATIENCE_S * clock::NS_PER_S;
    while !holds() {
        assert!(clock::now_ns() < until_ns, "waited {PATIENCE_S} s in vain until {what}");
        clock::sleep_ns(1_000_000);
    }
}

/// The executable while it runs. Killed when the test gives it up.
pub(crate) struct Running {
    child: Child,
    out: File,
    err: File,
    roster: PathBuf,
    reaped: bool,
}

/// How the executable ended, and what it said.
#[derive(Debug)]
pub(crate) struct Ended {
    /// Exit code; none after a signal.
    pub(crate) code: Option<i32>,
    /// Its standard output.
    pub(crate) out: String,
    /// Its standard error.
    pub(crate) err: String,
}

impl Ended {
    /// Its standard output as one JSON document.
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("no JSON document ({e}): {self:?}"))
    }

    /// Its standard output as one JSON document, if it ended with this code.
    pub(crate) fn json_with(&self, code: i32) -> Value {
        assert_eq!(self.code, Some(code), "{self:?}");
        self.json()
    }
}

impl Running {
    /// Whether it still runs.
    pub(crate) fn runs(&mut self) -> bool {
        self.status().is_none()
    }

    /// Whether it runs, who is in it, and what it has said, for the message of a test that fails.
    pub(crate) fn said(&mut self) -> String {
        format!("running: {}, processes: {:?}, standard error: {}", self.runs(), self.roster(), text(&self.err))
    }

    fn status(&mut self) -> Option<ExitStatus> {
        let status = self.child.try_wait().expect("the state of a child");
        self.reaped |= status.is_some();
        status
    }

    /// Waits for its end.
    pub(crate) fn wait(mut self) -> Ended {
        let until_ns = clock::now_ns() + PATIENCE_S * clock::NS_PER_S;
        let status = loop {
            match self.status() {
                Some(status) => break status,
                None => assert!(clock::now_ns() < until_ns, "it hangs; it said: {}", text(&self.err)),
            }
            clock::sleep_ns(2_000_000);
        };
        Ended { code: status.code(), out: text(&self.out), err: text(&self.err) }
    }

    /// The executable's process id.
    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal to the executable.
    pub(crate) fn signal(&self, signal: Signal) {
        send(self.child.id(), signal);
    }

    /// The group's processes by the supervisor's own list; empty before there is one.
    pub(crate) fn roster(&self) -> Vec<Value> {
        let bytes = fs::read(&self.roster).unwrap_or_default();
        let roster: Value = serde_json::from_slice(&bytes).unwrap_or_default();
        roster["processes"].as_array().cloned().unwrap_or_default()
    }

    /// The process of `role` and `id`, once it is in one of `states`.
    pub(crate) fn process(&mut self, role: &str, id: u64, states: &[&str]) -> u32 {
        let mut pid = None;
        wait_until(&format!("{role} {id} is one of {states:?}"), || {
            assert!(self.runs(), "the group has ended meanwhile: {}", text(&self.err));
            let found = self
                .roster()
                .into_iter()
                .find(|p| p["role"] == role && p["id"] == id && states.iter().any(|state| p["state"] == *state));
            pid = found.and_then(|p| p["pid"].as_u64());
            pid.is_some()
        });
        pid.and_then(|pid| u32::try_from(pid).ok()).expect("a process id")
    }

    /// Waits until the first controller is in charge: the clock runs.
    pub(crate) fn wait_until_active(&mut self) {
        self.process("controller", 1, &["active"]);
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if !self.reaped {
            // Its children end with it.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// Sends a signal to a process.
pub(crate) fn send(pid: u32, signal: Signal) {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw).expect("a process id");
    kill_process(pid, signal).expect("the process is there");
}

fn text(file: &File) -> String {
    use std::os::unix::fs::FileExt as _;
    let length = usize::try_from(file.metadata().expect("the length of an output").len()).expect("a short output");
    let mut bytes = vec![0; length];
    file.read_exact_at(&mut bytes, 0).expect("the output");
    String::from_utf8_lossy(&bytes).into_owned()
}
