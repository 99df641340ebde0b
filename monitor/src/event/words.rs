//! What happened, in words: the numbers of a happening mean something else in each kind.

use loopbound_shared::event::{Decision, HappeningKind, RunawayKind};
use loopbound_shared::sample::Happening;
use serde_json::Value;

use super::{fault, refusal};
use crate::counted::counted;

/// A happening in words, without its kind and tick.
#[must_use]
pub fn words(happening: &Happening) -> String {
    let Happening { subject, detail, value, .. } = *happening;
    match HappeningKind::from_code(happening.kind) {
        Some(HappeningKind::Swap) => {
            format!("controller {subject} took over from {detail}; their torques differed by {value:.4} N·m")
        }
        Some(HappeningKind::Failover) => {
            format!("controller {subject} took over from {detail}, whose torque was not there or no good")
        }
        Some(HappeningKind::Rollback) => format!("controller {subject} is active again: {}", refusal(detail)),
        Some(HappeningKind::SwapRefused) => format!("to controller {subject}: {}{}", refusal(detail), found(value)),
        Some(HappeningKind::FirstTorque) => format!("of controller {subject}"),
        Some(HappeningKind::Fallback) => fallback(subject, detail),
        Some(HappeningKind::Joined) => format!("a port was mapped in {:.1} µs", detail as f64 * 1e-3),
        Some(HappeningKind::MemberAdded | HappeningKind::MemberRemoved) => format!("controller {subject}"),
        Some(HappeningKind::FaultInjected) => {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of ticks; saturates")]
            let ticks = value as u64;
            format!("{} into controller {subject}, for {}", fault(detail), counted(ticks, "tick"))
        }
        Some(HappeningKind::Diverged) => diverged(subject, detail, value),
        Some(HappeningKind::StoodIn) => format!("controller {subject} for {detail}"),
        None => format!("subject {subject}, detail {detail}, value {value}"),
    }
}

/// The number for which a swap was refused; 0 where the reason has none.
fn found(value: f64) -> String {
    if value == 0.0 { String::new() } else { format!(" ({value:.4})") }
}

fn diverged(joint: u32, kind: u64, value: f64) -> String {
    match u32::try_from(kind).ok().and_then(RunawayKind::from_code) {
        Some(RunawayKind::Speed) => format!("joint {joint} turned at {value:.4} rad/s; the plant has stopped for good"),
        kind => {
            let what = kind.map_or("a quantity", RunawayKind::name);
            format!("{what} of link {joint} was not finite; the plant has stopped for good")
        }
    }
}

fn fallback(rung: u32, ticks: u64) -> String {
    let ticks = counted(ticks, "tick");
    match Decision::from_code(rung) {
        Some(Decision::Damped) => format!("the plant damps by itself, after {ticks} without a torque"),
        Some(Decision::Stopped) => format!("the plant has stopped by itself, after {ticks} without a torque"),
        Some(Decision::Held) => format!("the last torque is held, after {ticks} without one"),
        _ => format!("a controller answers again, after {ticks} without a torque"),
    }
}

/// Adds the words to a line of `events.jsonl` that an older version wrote without.
pub fn complete(line: &mut Value) {
    let Some(event) = line.as_object_mut().filter(|event| !event.contains_key("text")) else { return };
    let number = |key: &str| event.get(key).and_then(Value::as_u64);
    let kind = event.get("kind").and_then(Value::as_str);
    let kind = kind.and_then(|name| HappeningKind::ALL.iter().find(|kind| kind.name() == name));
    let subject = number("subject").and_then(|subject| u32::try_from(subject).ok());
    let (Some(kind), Some(subject), Some(detail)) = (kind, subject, number("detail")) else { return };
    let value = event.get("value").and_then(Value::as_f64).unwrap_or(0.0);
    let text = words(&Happening { kind: kind.code(), subject, detail, value });
    event.insert("text".to_owned(), Value::String(text));
}

#[cfg(test)]
mod tests {
    use loopbound_shared::event::Refusal;
    use serde_json::json;

    use super::*;

    #[test]
    fn every_kind_has_words_of_its_own_and_none_shows_its_codes() {
        for kind in HappeningKind::ALL {
            let text = words(&Happening { kind: kind.code(), subject: 3, detail: 5, value: 0.0 });
            assert!(!text.contains("detail") && !text.contains("subject"), "{kind}: {text}");
        }
        let damped = Happening { kind: 6, subject: Decision::Damped.code(), detail: 3, value: 0.0 };
        assert_eq!(words(&damped), "the plant damps by itself, after 3 ticks without a torque");
        let held = Happening { subject: Decision::Held.code(), detail: 1, ..damped };
        assert_eq!(words(&held), "the last torque is held, after 1 tick without one");
        let refused = Happening { kind: 4, subject: 2, detail: u64::from(Refusal::TorqueStep.code()), value: 7.5 };
        assert_eq!(words(&refused), "to controller 2: the torque would step by more than allowed (7.5000)");
    }

    #[test]
    fn a_line_of_an_older_version_gets_its_words_and_one_that_has_them_keeps_them() {
        let mut old = json!({"kind": "fallback", "tick": 63, "subject": 5, "detail": 3, "value": 0.0});
        complete(&mut old);
        assert_eq!(old["text"], "the plant damps by itself, after 3 ticks without a torque");
        for mut line in [json!({"kind": "late", "tick": 1}), json!({"kind": "joined", "text": "so it was"}), json!(7)] {
            let before = line.clone();
            complete(&mut line);
            assert_eq!(line, before);
        }
    }
}
