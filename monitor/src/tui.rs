//! The live view: a monitor that draws instead of writing.
//!
//! Responsible for the terminal and the keys. What is shown is [`model`]'s, how it looks [`view`]'s. It watches as any
//! monitor does: at the ordinary priority, never a listener, so that the loop does not feel it.

pub mod model;
mod screen;
pub mod view;

use std::io::{self, BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use loopbound_model::law::LawKind;
use loopbound_model::with_links;
use loopbound_shared::clock::now_ns;
use loopbound_shared::event::LiveFault;
use loopbound_shared::group::Group;
use loopbound_shared::role::{Joined, RoleError};
use loopbound_shared::sample::{TickRecord, record_flag};
use loopbound_shared::spawn;
use loopbound_shared::topics::Topic;
use serde_json::{Value, json};

use crate::run::{MonitorArgs, START_NS, join_soon};
use model::{Model, Wish};
use screen::{Input, Screen};

/// Between two pictures.
const PICTURE: Duration = Duration::from_millis(50);
/// How long records are taken in before the next picture.
const DRAIN_NS: u64 = 100_000_000;
/// Between two points of a sparkline.
const INTERVAL_NS: u64 = 500_000_000;
/// Silence after which the group is gone.
const SILENCE_NS: u64 = 5_000_000_000;
/// A swap takes its gate and the watch after it.
const ANSWER_WITHIN: Duration = Duration::from_secs(30);

/// How the view was left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// The group ended.
    Ended,
    /// By `q`: whatever runs goes on.
    Quit,
    /// By Ctrl-C: whoever started the group should end it.
    Interrupted,
    /// The terminal has gone: whatever runs goes on.
    TerminalGone,
}

/// Watches a group on the terminal until it ends or the view is left.
///
/// # Errors
/// If the group is not running or of another build, or there is no terminal.
pub fn run(args: &MonitorArgs, stop: &AtomicBool) -> Result<Left, RoleError> {
    let joined = join_soon(args, stop)?;
    let links = joined.scenario.links();
    with_links!(links, watch::<N>(args, &joined, stop))
}

fn watch<const N: usize>(args: &MonitorArgs, joined: &Joined, stop: &AtomicBool) -> Result<Left, RoleError> {
    let records = joined.node.subscriber::<TickRecord>(TickRecord::DEPTH)?.uncounted();
    let announces = joined.node.announces()?.uncounted();
    let mut model = Model::<N>::new(&args.group, &joined.scenario)?;
    let mut screen = Screen::open().map_err(|error| RoleError::Other(format!("the view needs a terminal: {error}")))?;
    let mut answers: Option<Receiver<String>> = None;
    let (mut interval_ns, mut heard_ns, mut last) = (now_ns(), now_ns(), false);
    let left = loop {
        while let Some(announce) = announces.take() {
            model.learn(&announce);
        }
        // A view that can't keep up loses records rather than pictures: it must not drain for ever.
        let until_ns = now_ns() + DRAIN_NS;
        while now_ns() < until_ns {
            let Some(flags) = records.take_with(|record| {
                model.feed(record);
                record.flags
            }) else {
                break;
            };
            last |= flags & record_flag::LAST != 0;
            heard_ns = now_ns();
        }
        if now_ns() >= interval_ns + INTERVAL_NS {
            interval_ns = now_ns();
            model.close_interval();
        }
        if let Some(answer) = answers.as_ref().and_then(|answers| answers.try_recv().ok()) {
            model.answer = answer;
        }
        if screen.draw(|frame| view::draw(frame, &model)).is_err() {
            break Left::TerminalGone;
        }
        let ended = last || stop.load(SeqCst) || now_ns() > heard_ns + SILENCE_NS + START_NS;
        if ended {
            break Left::Ended;
        }
        // An error of the terminal is its end too: a view has nobody else to tell.
        let wish = match screen.input(PICTURE).unwrap_or(Input::Gone) {
            Input::Key(key) => model.press(key),
            Input::Interrupt => break Left::Interrupted,
            Input::Gone => break Left::TerminalGone,
            Input::Nothing => Wish::Nothing,
        };
        match wish {
            Wish::Nothing => {}
            Wish::Swap => answers = Some(swap(&joined.group, &mut model)),
            Wish::Fault(fault) => answers = Some(strike(&joined.group, &mut model, fault)),
            Wish::Quit => break Left::Quit,
        }
    };
    Ok(left)
}

/// Asks the supervisor for another controller: a standby if there is one, else a new one with the next law. The answer
/// comes when the swap is over, and the view goes on meanwhile.
fn swap<const N: usize>(group: &Group, model: &mut Model<N>) -> Receiver<String> {
    let (active, _) = model.in_charge();
    let at = LawKind::ALL.iter().position(|law| law.name() == model.name(active)).unwrap_or(0);
    let next = LawKind::ALL[(at + 1) % LawKind::ALL.len()].name();
    let run = group.run_id().to_string();
    let (wanted, request) = match model.standbys().first() {
        Some(id) => (format!("controller {id}"), json!({"to": id, "force": false, "run": run})),
        None => (next.to_owned(), json!({"law": next, "force": false, "run": run})),
    };
    command(group, model, "swap", &format!("swap to {wanted}"), request)
}

/// Asks the supervisor for a fault of the controller in charge.
fn strike<const N: usize>(group: &Group, model: &mut Model<N>, fault: LiveFault) -> Receiver<String> {
    let (active, _) = model.in_charge();
    let request = json!({"fault": {"kind": fault.name(), "controller": active, "run": group.run_id().to_string()}});
    command(group, model, "fault", &format!("fault {fault} of controller {active}"), request)
}

/// Sends a request on a thread of its own.
fn command<const N: usize>(
    group: &Group,
    model: &mut Model<N>,
    what: &'static str,
    words: &str,
    request: Value,
) -> Receiver<String> {
    model.answer = format!("{words} …");
    let (sender, answers) = channel();
    let control = group.file("control");
    let ask = move || {
        let answer = ask(&control, what, &request).unwrap_or_else(|error| format!("no {what}: {error}"));
        // The view may be gone by now.
        let _ = sender.send(answer);
    };
    if let Err(error) = spawn::thread("command", ask) {
        model.answer = format!("no {what}: {error}");
    }
    answers
}

/// One line of JSON to the supervisor, one back.
fn ask(path: &Path, what: &str, request: &Value) -> io::Result<String> {
    let mut stream = UnixStream::connect(path)?;
    stream.set_read_timeout(Some(ANSWER_WITHIN))?;
    writeln!(stream, "{request}")?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line)?;
    Ok(words(what, &serde_json::from_str(&line)?))
}

/// An answer in a few words.
fn words(what: &str, answer: &Value) -> String {
    let report = if what == "fault" { &answer["fault"] } else { &answer["report"] };
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let result = text(&report["result"]).or_else(|| text(&answer["usage"])).unwrap_or_else(|| answer.to_string());
    let what = text(&report["kind"]).map_or_else(|| what.to_owned(), |kind| format!("{what} {kind}"));
    match text(&report["reason"]) {
        Some(reason) => format!("{what} {result}: {reason}"),
        None => format!("{what} {result}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_says_what_came_of_it_and_why() {
        let done = json!({"fault": {"kind": "hang", "result": "done", "reason": null}});
        assert_eq!(words("fault", &done), "fault hang done");
        let refused = json!({"report": {"result": "refused", "reason": "too soon"}});
        assert_eq!(words("swap", &refused), "swap refused: too soon");
        assert_eq!(words("swap", &json!({"usage": "in lockstep …"})), "swap in lockstep …");
    }
}
