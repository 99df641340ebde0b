//! What is said while a run or a study goes on: notes, and on a terminal a progress bar below them.
//!
//! A thread of its own says it. A terminal that was paused (Ctrl-S) or a pipe that nobody empties stops that thread and
//! never whoever supervises the run.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use loopbound_shared::say;
use loopbound_shared::spawn;

/// Between two looks at how far it is.
const LOOK: Duration = Duration::from_millis(100);
/// Notes that may wait for a reader; more are dropped and counted.
const WAITING_MAX: usize = 256;
/// How long the last notes are waited for at the end.
const PATIENCE: Duration = Duration::from_secs(2);

/// Notes and the bar of something that goes on.
pub struct Progress {
    shared: Arc<Shared>,
    notes: SyncSender<Said>,
    finished: Receiver<()>,
}

#[derive(Debug, Default)]
struct Shared {
    position: AtomicU64,
    length: AtomicU64,
    dropped: AtomicU64,
}

enum Said {
    Note(String),
    Message(String),
    Finish,
}

impl Progress {
    /// A bar of `length` steps, drawn as `template` of indicatif says; without one only notes are shown.
    ///
    /// # Errors
    /// If there is no thread to be had.
    pub fn start(length: u64, template: Option<&str>) -> std::io::Result<Self> {
        let bar = match template {
            Some(template) => ProgressBar::new(length)
                .with_style(ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())),
            None => ProgressBar::hidden(),
        };
        let shared = Arc::new(Shared { length: AtomicU64::new(length), ..Shared::default() });
        let (notes, heard) = sync_channel(WAITING_MAX);
        let (done, finished) = sync_channel(1);
        let theirs = Arc::clone(&shared);
        spawn::thread("progress", move || {
            speak(&bar, &theirs, &heard);
            // Nobody may be waiting any more.
            let _ = done.try_send(());
        })?;
        Ok(Self { shared, notes, finished })
    }

    /// Says a line above the bar.
    pub fn note(&self, line: String) {
        self.send(Said::Note(line));
    }

    /// The words beside the bar.
    pub fn message(&self, words: String) {
        self.send(Said::Message(words));
    }

    fn send(&self, said: Said) {
        if self.notes.try_send(said).is_err() {
            self.shared.dropped.fetch_add(1, SeqCst);
        }
    }

    /// How far it is.
    pub fn set_position(&self, position: u64) {
        self.shared.position.store(position, SeqCst);
    }

    /// One step further.
    pub fn advance(&self) {
        self.shared.position.fetch_add(1, SeqCst);
    }

    /// How far it has to go.
    pub fn set_length(&self, length: u64) {
        self.shared.length.store(length, SeqCst);
    }

    /// Removes the bar, after the last note; a reader who does not read is waited for for a while.
    pub fn finish(&self) {
        self.send(Said::Finish);
        let _ = self.finished.recv_timeout(PATIENCE);
    }
}

fn speak(bar: &ProgressBar, shared: &Shared, heard: &Receiver<Said>) {
    loop {
        let said = if bar.is_hidden() {
            heard.recv().map_err(|_| RecvTimeoutError::Disconnected)
        } else {
            heard.recv_timeout(LOOK)
        };
        let dropped = shared.dropped.swap(0, SeqCst);
        if dropped > 0 {
            bar.suspend(|| say::err!("loopbound: {dropped} notes were dropped: nobody read them"));
        }
        match said {
            Ok(Said::Note(line)) => bar.suspend(|| say::err!("loopbound: {line}")),
            Ok(Said::Message(words)) => bar.set_message(words),
            Ok(Said::Finish) | Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {}
        }
        bar.set_length(shared.length.load(SeqCst));
        bar.set_position(shared.position.load(SeqCst));
    }
    bar.finish_and_clear();
}
