//! Threads and processes are started here: where the system allows no more of them it is an error that names the remedy,
//! and never a panic.
//!
//! The standard library's `thread::spawn` panics then, and its words elsewhere ("Resource temporarily unavailable") help
//! nobody.

use std::io;
use std::process::{Child, Command};
use std::thread::{Builder, JoinHandle};

use rustix::io::Errno;

/// Starts a process.
///
/// # Errors
/// If it can't be started.
pub fn process(command: &mut Command) -> io::Result<Child> {
    command.spawn().map_err(with_remedy)
}

/// Starts a thread.
///
/// # Errors
/// If there is none to be had.
pub fn thread<T: Send + 'static>(name: &str, work: impl FnOnce() -> T + Send + 'static) -> io::Result<JoinHandle<T>> {
    Builder::new().name(name.to_owned()).spawn(work).map_err(with_remedy)
}

/// Whether so many threads more may be started at once: for a library that panics where they may not.
///
/// # Errors
/// If not.
pub fn require_threads(count: usize) -> io::Result<()> {
    let go = std::sync::Mutex::new(());
    // Each waits for the lock, so that all are there together.
    let held = go.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    std::thread::scope(|scope| {
        let wait = || drop(go.lock());
        let started = (0..count).try_for_each(|_| Builder::new().spawn_scoped(scope, wait).map(drop));
        drop(held);
        started.map_err(with_remedy)
    })
}

/// Does `work` on up to `threads` threads at once, this one among them: so it is done even where no other is to be had.
pub fn on_threads(threads: usize, work: impl Fn() + Sync) {
    std::thread::scope(|scope| {
        let _ = (1..threads).take_while(|_| Builder::new().spawn_scoped(scope, &work).is_ok()).count();
        work();
    });
}

/// The error of a start, with what helps where the limit on processes and threads is reached.
#[must_use]
pub fn with_remedy(error: io::Error) -> io::Error {
    if error.raw_os_error() != Some(Errno::AGAIN.raw_os_error()) {
        return error;
    }
    let words = "no further process or thread may be started here: raise the limit (ulimit -u; a container: --pids-limit; \
                 systemd: TasksMax=), or end others";
    io::Error::new(io::ErrorKind::WouldBlock, words)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};

    use super::*;

    #[test]
    fn the_remedy_is_named_where_the_limit_is_reached_and_nowhere_else() {
        let reached = with_remedy(io::Error::from_raw_os_error(11)).to_string();
        assert!(reached.contains("ulimit -u") && reached.contains("--pids-limit"), "{reached}");
        let other = process(&mut Command::new("/nowhere/there")).unwrap_err();
        assert_eq!(other.kind(), io::ErrorKind::NotFound);
    }

    #[test]
    fn work_is_done_by_as_many_threads_as_were_asked_for_and_by_one_at_least() {
        for (threads, expected) in [(0, 1), (1, 1), (4, 4)] {
            let done = AtomicUsize::new(0);
            on_threads(threads, || _ = done.fetch_add(1, SeqCst));
            assert_eq!(done.load(SeqCst), expected, "{threads}");
        }
        require_threads(16).unwrap();
        assert_eq!(thread("t", || 7).unwrap().join().unwrap(), 7);
    }
}
