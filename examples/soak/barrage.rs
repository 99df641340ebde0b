//! A barrage: random signals reach random processes of one group at random instants, some of them in its first 40 ms and
//! some all at once. Whatever happens, the run ends in bounded time with an exit code that the documents name, and
//! nothing is left of it.
//!
//! What is drawn follows from a seed and a number; when the processes get so far is the machine's affair.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};

use anyhow::Context as _;
use loopbound_model::rng::{Stream, uniform};
use loopbound_shared::clock::{now_ns, sleep_ns};
use loopbound_shared::realtime::{ProcessHandle, Signal};

use crate::remains::{KEEPER, LAUNCHER, NEWBORN, Place, Seen};

/// Length of a run that nothing happens to.
const RUN: &str = "600ms";
/// The signals come within this time, …
const WITHIN_NS: f64 = 900e6;
/// … many of them in the very first of it, while the group is being made.
const EARLY_NS: f64 = 40e6;
/// Whoever is stopped goes on within this time.
const STOPPED_NS: f64 = 300e6;
/// Every run ends within this, on a busy machine too: the longest waits of launcher and keeper, one after the other.
const HANG_NS: u64 = 40_000_000_000;
/// After its launcher has ended a run is gone: at once if the launcher did its part, else when the keeper has done its own.
const GONE_NS: u64 = 2_000_000_000;
const KEPT_NS: u64 = 20_000_000_000;
const LOOK_NS: u64 = 500_000;
/// A process has its signal handlers within this.
const UP_NS: u64 = 300_000_000;
/// Exit codes that a run may end with (`docs/exit-codes.md`): not 2 or 70, since nothing is wrong with what was asked for,
/// nor with loopbound or the machine.
const CODES: [i32; 4] = [0, 1, 3, 5];
/// How a process ends that is wrong in itself, unless it was sent this signal.
const CRASHES: [(Signal, &str); 4] =
    [(Signal::SEGV, "SIGSEGV"), (Signal::BUS, "SIGBUS"), (Signal::ABORT, "SIGABRT"), (Signal::ILL, "signal 4")];

const SIGNALS: [Signal; 14] = [
    Signal::TERM,
    Signal::TERM,
    Signal::INT,
    Signal::HUP,
    Signal::KILL,
    Signal::KILL,
    Signal::STOP,
    Signal::STOP,
    Signal::TSTP,
    Signal::QUIT,
    Signal::USR1,
    Signal::USR2,
    Signal::PIPE,
    Signal::SEGV,
];
const WHOM: [&str; 9] =
    [LAUNCHER, LAUNCHER, KEEPER, "plant", "controller", "reference", "monitor", EVERYONE, EVERYONE_ELSE];
const EVERYONE: &str = "everyone";
const EVERYONE_ELSE: &str = "everyone but the launcher";

/// What is to happen to a group.
#[derive(Debug)]
pub(crate) struct Plan {
    arguments: Vec<String>,
    /// Its controller stands behind a shell script that has started something else.
    wrapped: bool,
    shots: Vec<Shot>,
}

#[derive(Clone, Copy, Debug)]
struct Shot {
    /// After the launcher was started.
    at_ns: u64,
    whom: &'static str,
    signal: Signal,
    /// How long whoever is stopped stays so.
    stopped_ns: u64,
}

/// A signal that reached somebody.
#[derive(Debug)]
pub(crate) struct Hit {
    pub(crate) role: String,
    pub(crate) signal: Signal,
    /// After the launcher was started.
    at_ns: u64,
}

/// What came of it.
#[derive(Debug, Default)]
pub(crate) struct Outcome {
    /// How the launcher ended.
    pub(crate) exit: String,
    /// Launcher and keeper were killed, or the launcher before it had one: `clean` was needed.
    pub(crate) cleaned: bool,
    /// From the start to the end of the last process, ns.
    pub(crate) took_ns: u64,
    /// Who got what.
    pub(crate) hits: Vec<Hit>,
    /// What it said.
    pub(crate) said: String,
    /// What was not as it should be.
    pub(crate) faults: Vec<String>,
}

impl Plan {
    pub(crate) fn draw(seed: u64, number: u64) -> Self {
        let mut lane = 0;
        let mut next = || {
            lane += 1;
            uniform(seed, Stream::Fault, number, lane)
        };
        let settings = match below(next(), 3) {
            0 => ["loop.mode=lockstep", "loop.duration=4s"],
            _ => ["loop.rate=200Hz", "loop.wakeup=block"],
        };
        let standby = format!("controller.standby={}", below(next(), 2));
        let mut arguments: Vec<String> = vec!["--set".to_owned(), format!("loop.duration={RUN}")];
        for setting in settings.into_iter().chain([standby.as_str(), "supervisor.back_off=20ms"]) {
            arguments.extend(["--set".to_owned(), setting.to_owned()]);
        }
        let wrapped = below(next(), 4) == 0;
        if cfg!(feature = "foxglove") && below(next(), 4) == 0 {
            arguments.extend(["--foxglove".to_owned(), "127.0.0.1:0".to_owned()]);
        }
        let count = 1 + below(next(), 4);
        let mut shots: Vec<Shot> = (0..count)
            .map(|_| Shot {
                at_ns: ns(next() * if next() < 0.4 { EARLY_NS } else { WITHIN_NS }),
                whom: WHOM[below(next(), WHOM.len())],
                signal: SIGNALS[below(next(), SIGNALS.len())],
                stopped_ns: ns(next() * STOPPED_NS),
            })
            .collect();
        shots.sort_by_key(|shot| shot.at_ns);
        Self { arguments, wrapped, shots }
    }

    /// Runs a group of `executable` in `place`, with files in `work`, under this barrage.
    pub(crate) fn run(&self, executable: &Path, place: &Place, work: &Path) -> anyhow::Result<Outcome> {
        let errors = work.join("errors");
        let mut launcher = self.start(executable, place, work, &File::create(&errors)?)?;
        let mut barrage =
            Barrage { place, launcher: launcher.id(), from_ns: now_ns(), resumptions: Vec::new(), kept: None };
        let mut outcome = Outcome::default();
        let status = barrage.go_on(self.shots.clone(), &mut launcher, &mut outcome)?;
        outcome.exit = status.map_or("hangs".to_owned(), |status| status.to_string());
        outcome.faults.extend(status.map_or(Some("it hangs".to_owned()), |status| outcome.wrong_exit(status)));
        outcome.said = fs::read_to_string(&errors).unwrap_or_default();
        outcome.faults.extend(outcome.said.lines().filter(|line| line.contains("panicked")).map(str::to_owned));
        outcome.faults.extend(crashes(&work.join("out"), &outcome.hits));
        let killed = status.is_none_or(|status| status.code().is_none());
        let kept = barrage.kept == Some(true) && !outcome.keeper_was_killed();
        let left = place.left_after(if killed && kept { KEPT_NS } else { GONE_NS });
        if killed && !kept {
            outcome.cleaned = !left.is_empty();
        } else if !left.is_empty() {
            outcome.faults.push(format!("left behind: {left:?}"));
        }
        outcome.faults.extend(clean(executable, place, left));
        outcome.took_ns = now_ns() - barrage.from_ns;
        Ok(outcome)
    }

    fn start(&self, executable: &Path, place: &Place, work: &Path, errors: &File) -> anyhow::Result<Child> {
        let mut command = Command::new(executable);
        command.args(["run", "--group", &place.group, "--quiet", "--out"]).arg(work.join("out"));
        // At this rate the default law runs away.
        command.args(["--law", "ctc"]).args(&self.arguments);
        if self.wrapped {
            let script = format!("#!/bin/sh\nsleep {} &\n{} controller \"$@\"\n", place.word, executable.display());
            let wrapper = work.join("wrapper");
            fs::write(&wrapper, script)?;
            fs::set_permissions(&wrapper, fs::Permissions::from_mode(0o755))?;
            command.args(["--set", &format!("controller.exe={}", wrapper.display())]);
        }
        command.env("LOOPBOUND_RUNTIME_DIR", &place.folder).current_dir(work);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(errors.try_clone()?);
        command.spawn().context("the launcher")
    }
}

/// A group under fire.
struct Barrage<'a> {
    place: &'a Place,
    launcher: u32,
    from_ns: u64,
    /// Who was stopped, and when it goes on.
    resumptions: Vec<(u64, ProcessHandle)>,
    /// Whether there was a keeper when the launcher was seen to have ended.
    kept: Option<bool>,
}

impl Barrage<'_> {
    /// Until all has been sent and the launcher has ended; how it ended, none if it hangs.
    fn go_on(
        &mut self,
        mut shots: Vec<Shot>,
        launcher: &mut Child,
        outcome: &mut Outcome,
    ) -> anyhow::Result<Option<ExitStatus>> {
        loop {
            let now_ns = now_ns();
            while shots.first().is_some_and(|shot| now_ns >= self.from_ns + shot.at_ns) {
                let shot = shots.remove(0);
                self.fire(shot, outcome);
            }
            self.resume_due(now_ns);
            let status = launcher.try_wait()?;
            if status.is_some() && self.kept.is_none() {
                self.kept = Some(self.place.members(self.launcher).iter().any(|one| one.role == KEEPER));
            }
            if status.is_some() && shots.is_empty() && self.resumptions.is_empty() {
                return Ok(status);
            }
            if now_ns >= self.from_ns + HANG_NS {
                launcher.kill()?;
                launcher.wait()?;
                return Ok(None);
            }
            sleep_ns(LOOK_NS);
        }
    }

    fn resume_due(&mut self, now_ns: u64) {
        self.resumptions.retain(|(at_ns, process)| {
            let due = now_ns >= *at_ns;
            if due {
                // It may have been killed meanwhile.
                let _ = process.signal(Signal::CONT);
            }
            !due
        });
    }

    fn fire(&mut self, shot: Shot, outcome: &mut Outcome) {
        let is_meant = |one: &Seen| match shot.whom {
            EVERYONE => true,
            EVERYONE_ELSE => one.role != LAUNCHER,
            role => one.role == role,
        };
        for one in self.place.members(self.launcher).into_iter().filter(is_meant) {
            if one.process.signal(shot.signal).is_ok() {
                outcome.hits.push(Hit { role: one.role, signal: shot.signal, at_ns: now_ns() - self.from_ns });
                if [Signal::STOP, Signal::TSTP].contains(&shot.signal) {
                    self.resumptions.push((now_ns() + shot.stopped_ns, one.process));
                }
            }
        }
    }
}

impl Outcome {
    fn wrong_exit(&self, status: ExitStatus) -> Option<String> {
        let of_launcher = |hit: &&Hit| hit.role == LAUNCHER;
        let sent = |number| self.hits.iter().filter(of_launcher).any(|hit| hit.signal.as_raw() == number);
        let right = match (status.code(), status.signal()) {
            (Some(130), _) => sent(Signal::INT.as_raw()),
            (Some(143), _) => sent(Signal::TERM.as_raw()) || sent(Signal::HUP.as_raw()),
            (Some(code), _) => CODES.contains(&code),
            (None, signal) => signal.is_some_and(sent),
        };
        (!right).then(|| format!("ended with {status}"))
    }

    /// Whether the keeper can have ended by what was sent: it catches the signals that ask for an end, once it is up.
    fn keeper_was_killed(&self) -> bool {
        let caught = [Signal::TERM, Signal::INT, Signal::HUP, Signal::STOP, Signal::TSTP, Signal::PIPE];
        let of_keeper = self.hits.iter().filter(|hit| [KEEPER, NEWBORN].contains(&hit.role.as_str()));
        of_keeper.into_iter().any(|hit| hit.at_ns < UP_NS || !caught.contains(&hit.signal))
    }
}

/// Who ended by a fault of its own, and not by what it was sent.
fn crashes(out: &Path, hits: &[Hit]) -> Vec<String> {
    let bytes = fs::read(out.join("summary.json")).unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_slice(&bytes).unwrap_or_default();
    let sent = |signal: Signal| hits.iter().any(|hit| hit.signal == signal);
    let own = CRASHES.iter().filter(|(signal, _)| !sent(*signal)).map(|(_, word)| *word);
    let words: Vec<&str> = own.chain(["exit code 101"]).collect();
    let deaths = summary["supervision"]["deaths"].as_array().cloned().unwrap_or_default();
    let hows = deaths.iter().filter_map(|death| death["how"].as_str());
    let is_crash = |how: &&str| words.iter().any(|word| how.contains(word));
    hows.filter(is_crash).map(|how| format!("a process crashed: {how}")).collect()
}

/// Ends and sweeps what is left; what is left even then is a fault.
fn clean(executable: &Path, place: &Place, mut left: Vec<String>) -> Option<String> {
    place.end_the_rest();
    let until_ns = now_ns() + KEPT_NS;
    while !left.is_empty() && now_ns() < until_ns {
        // A killed process gives up its hold only when the kernel has torn it down: until then the group is not dead.
        let cleaned = Command::new(executable).arg("clean").env("LOOPBOUND_RUNTIME_DIR", &place.folder).output();
        if !cleaned.is_ok_and(|output| output.status.success()) {
            return Some("`clean` fails".to_owned());
        }
        left = place.left_after(LOOK_NS);
    }
    (!left.is_empty()).then(|| format!("left after `clean`: {left:?}"))
}

/// How many of what.
pub(crate) fn count<T: ToString>(words: impl Iterator<Item = T>) -> BTreeMap<String, u32> {
    let mut counts = BTreeMap::new();
    words.for_each(|word| *counts.entry(word.to_string()).or_default() += 1);
    counts
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below the count")]
fn below(share: f64, count: usize) -> usize {
    (share * count as f64) as usize
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "seconds at most")]
fn ns(ns: f64) -> u64 {
    ns as u64
}
