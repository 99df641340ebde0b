//! What is said once, at once, and never again while a run goes on.

use loopbound_monitor::files::LOST_FILE;
use loopbound_shared::event::MessageKind;

use super::Supervisor;

/// What was said already.
#[derive(Debug, Default)]
pub(super) struct Notices {
    strangers: bool,
    loss: bool,
}

impl Notices {
    /// That a process outside this run speaks in it; the report has the counts.
    fn of_strangers(&mut self, count: impl Fn(MessageKind) -> u64) -> Option<String> {
        let kind = MessageKind::ALL.iter().find(|kind| !self.strangers && count(**kind) > 0)?;
        self.strangers = true;
        Some(format!("a process that is not of this run sends it a {}: refused and counted", kind.words()))
    }

    /// That the monitor can't record any more, for this reason.
    fn of_loss(&mut self, why: impl FnOnce() -> Option<String>) -> Option<String> {
        let why = if self.loss { None } else { why() }?;
        self.loss = true;
        Some(format!("the recording has ended: {why}; the run goes on"))
    }
}

impl Supervisor<'_> {
    pub(super) fn note_strangers(&mut self) {
        let writers = self.block.writers();
        if let Some(line) = self.notices.of_strangers(|kind| writers.strangers(kind)) {
            self.note(&line);
        }
    }

    pub(super) fn note_loss(&mut self) {
        let file = self.group.file(LOST_FILE);
        if let Some(line) = self.notices.of_loss(|| std::fs::read_to_string(file).ok()) {
            self.note(&line);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strangers_and_a_lost_recording_are_told_once_each() {
        let mut notices = Notices::default();
        assert_eq!(notices.of_strangers(|_| 0), None);
        let line = notices.of_strangers(|kind| u64::from(kind == MessageKind::Torque)).unwrap();
        assert!(line.contains(MessageKind::Torque.words()), "{line}");
        assert_eq!(notices.of_strangers(|_| 9), None);
        assert_eq!(notices.of_loss(|| None), None);
        assert!(notices.of_loss(|| Some("no space".into())).unwrap().contains("no space"));
        assert_eq!(notices.of_loss(|| Some("no space".into())), None);
    }
}
