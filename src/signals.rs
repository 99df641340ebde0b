//! Signals become flags that loops look at; nothing else happens when one comes.
//!
//! The launcher takes Ctrl-C by `ctrlc`, which also covers systems without POSIX signals. SIGTERM and SIGHUP are taken
//! apart from it, since the exit code tells the two kinds of ending apart. A role must not grow a thread, which `ctrlc`
//! does: it registers plain flags.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};

use crate::exit::Exit;
use loopbound_shared::spawn;

/// The launcher's view: which signal asked it to stop.
#[derive(Clone, Debug, Default)]
pub struct Stop {
    signal: Arc<AtomicUsize>,
}

impl Stop {
    /// Catches Ctrl-C, SIGTERM and SIGHUP from here on; once in a process.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn install() -> io::Result<Self> {
        let stop = Self::default();
        let interrupted = Arc::clone(&stop.signal);
        ctrlc::set_handler(move || interrupted.store(usize::try_from(SIGINT).unwrap_or(0), SeqCst)).map_err(
            |error| match error {
                ctrlc::Error::System(error) => spawn::with_remedy(error),
                other => io::Error::other(other),
            },
        )?;
        for signal in [SIGTERM, SIGHUP] {
            let number = usize::try_from(signal).unwrap_or(0);
            signal_hook::flag::register_usize(signal, Arc::clone(&stop.signal), number)?;
        }
        Ok(stop)
    }

    /// Whether to stop, and with which exit code.
    #[must_use]
    pub fn requested(&self) -> Option<Exit> {
        let interrupt = usize::try_from(SIGINT).unwrap_or(0);
        match self.signal.load(SeqCst) {
            0 => None,
            signal if signal == interrupt => Some(Exit::Interrupted),
            _ => Some(Exit::Terminated),
        }
    }
}

/// A file that may not grow any more (`ulimit -f`) is an error of whoever writes it, and no reason to be killed.
pub fn let_writes_fail() {
    // Where the system refuses, it is as it was.
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::default());
}

/// A role's view: one flag, which its loop looks at every tick.
///
/// # Errors
/// If the system refuses.
pub fn role_stop_flag() -> io::Result<&'static AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&flag))?;
    }
    // It lives as long as the handlers, which are never taken back.
    let kept: &'static Arc<AtomicBool> = Box::leak(Box::new(flag));
    Ok(kept)
}
