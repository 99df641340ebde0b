//! The one module that writes to the standard streams: nothing said there can end the process that says it, and a reader who
//! left is no error.
//!
//! [`crate::say::err!`] writes one line to standard error; if it can't, nobody is told, since there is nowhere to. [`crate::say::out!`]
//! and [`stdout`] write to standard output. If the reader of a pipe or a terminal has gone, the rest is dropped in silence. If
//! the output is lost otherwise (a full disk), the rest is dropped too, [`lost`] has the reason, and the launcher says so at
//! its end. Clippy bans the standard library's macros and handles elsewhere.
#![expect(clippy::disallowed_methods, reason = "this is the module that writes to the standard streams")]

use std::fmt::Arguments;
use std::io::{self, ErrorKind, IsTerminal as _, Stdout, Write};
use std::os::fd::AsFd;
use std::sync::atomic::{AtomicI32, AtomicU8, Ordering::SeqCst};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::FileType;
use rustix::io::Errno;

pub use crate::say_err as err;
pub use crate::say_out as out;

/// Writes a line to standard output. It can't fail; see [`crate::say::lost`].
#[macro_export]
macro_rules! say_out {
    ($($word:tt)*) => { $crate::say::out_line(::core::format_args!($($word)*)) };
}

/// Writes a line to standard error, or nothing if that can't be written.
#[macro_export]
macro_rules! say_err {
    ($($word:tt)*) => { $crate::say::err_line(::core::format_args!($($word)*)) };
}

/// How long standard error is waited for if it is full and somebody has set it not to block.
const ERR_PATIENCE: Timespec = Timespec { tv_sec: 1, tv_nsec: 0 };

const OPEN: u8 = 0;
const READER_GONE: u8 = 1;
const LOST: u8 = 2;

/// What became of this process's standard output: one state, since there is one stream.
static STATE: AtomicU8 = AtomicU8::new(OPEN);
static LOST_BY: AtomicI32 = AtomicI32::new(0);

/// Standard output as a writer that never fails.
pub fn stdout() -> impl Write {
    struct Shared;
    impl Write for Shared {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if STATE.load(SeqCst) == OPEN {
                settle(write_all(&mut io::stdout().lock(), bytes, None));
            }
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            if STATE.load(SeqCst) == OPEN {
                settle(io::stdout().lock().flush());
            }
            Ok(())
        }
    }
    Shared
}

/// Keeps the first reason for which nothing more is written.
fn settle(written: io::Result<()>) {
    let Err(error) = written else { return };
    if reader_gone(&error, &io::stdout()) {
        STATE.store(READER_GONE, SeqCst);
    } else {
        LOST_BY.store(error.raw_os_error().unwrap_or(Errno::IO.raw_os_error()), SeqCst);
        STATE.store(LOST, SeqCst);
    }
}

/// Why a part of standard output was lost, if one was other than by its reader's leaving.
#[must_use]
pub fn lost() -> Option<io::Error> {
    (STATE.load(SeqCst) == LOST).then(|| io::Error::from_raw_os_error(LOST_BY.load(SeqCst)))
}

/// Whether nobody gets what is written to standard output any more: work for it alone may end.
#[must_use]
pub fn is_in_vain() -> bool {
    STATE.load(SeqCst) != OPEN
}

/// Whether standard output is a terminal.
#[must_use]
pub fn to_terminal() -> bool {
    io::stdout().is_terminal()
}

/// Whether standard error is a terminal.
#[must_use]
pub fn err_to_terminal() -> bool {
    io::stderr().is_terminal()
}

/// Whether to colour what goes to a stream: only a terminal, and only if its user has not asked for none
/// (`NO_COLOR`, `TERM=dumb`).
#[must_use]
pub fn in_colour(terminal: bool) -> bool {
    let wanted = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    terminal && wanted && std::env::var_os("TERM").is_none_or(|term| term != "dumb")
}

/// Standard output as it is, for a view that draws on the terminal and sees itself to what fails.
#[must_use]
pub fn screen() -> Stdout {
    io::stdout()
}

/// As [`crate::say::out!`].
pub fn out_line(words: Arguments<'_>) {
    // One write a line: lines of processes that share a stream stay whole.
    let _ = stdout().write_all(format!("{words}\n").as_bytes());
}

/// As [`crate::say::err!`].
pub fn err_line(words: Arguments<'_>) {
    let _ = write_all(&mut io::stderr().lock(), format!("{words}\n").as_bytes(), Some(&ERR_PATIENCE));
}

/// As `Write::write_all`, also to a stream that somebody has set not to block (`O_NONBLOCK`).
fn write_all<S: Write + AsFd>(stream: &mut S, mut bytes: &[u8], patience: Option<&Timespec>) -> io::Result<()> {
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(count) => bytes = &bytes[count..],
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => wait_for_room(stream, patience)?,
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

fn wait_for_room(stream: &impl AsFd, patience: Option<&Timespec>) -> io::Result<()> {
    match poll(&mut [PollFd::new(stream, PollFlags::OUT)], patience) {
        Ok(0) => Err(Errno::AGAIN.into()),
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// A closed pipe or socket, or a terminal that has hung up. The same error of a file is a loss.
fn reader_gone(error: &io::Error, stream: &impl AsFd) -> bool {
    let is_device = || {
        rustix::fs::fstat(stream).is_ok_and(|stat| FileType::from_raw_mode(stat.st_mode) == FileType::CharacterDevice)
    };
    match error.kind() {
        ErrorKind::BrokenPipe | ErrorKind::ConnectionReset => true,
        _ => error.raw_os_error() == Some(Errno::IO.raw_os_error()) && is_device(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::os::unix::net::UnixStream;

    #[test]
    fn a_closed_pipe_or_socket_is_no_loss_and_a_full_device_is() {
        let (reader, mut pipe) = std::io::pipe().unwrap();
        drop(reader);
        let error = write_all(&mut pipe, b"word", None).unwrap_err();
        assert!(reader_gone(&error, &pipe), "{error}");
        let (other, mut socket) = UnixStream::pair().unwrap();
        drop(other);
        let error = write_all(&mut socket, b"word", None).unwrap_err();
        assert!(reader_gone(&error, &socket), "{error}");
        let mut full = File::options().write(true).open("/dev/full").unwrap();
        let error = write_all(&mut full, b"word", None).unwrap_err();
        assert!(!reader_gone(&error, &full), "{error}");
    }

    #[test]
    fn a_stream_that_was_set_not_to_block_is_waited_for_and_given_up_after_a_while() {
        let (reader, mut pipe) = std::io::pipe().unwrap();
        rustix::fs::fcntl_setfl(&pipe, rustix::fs::OFlags::NONBLOCK).unwrap();
        let much = vec![b'x'; 1 << 20];
        let none = Timespec { tv_sec: 0, tv_nsec: 0 };
        assert_eq!(write_all(&mut pipe, &much, Some(&none)).unwrap_err().kind(), ErrorKind::WouldBlock);
        let reading = std::thread::spawn(move || std::io::copy(&mut { reader }, &mut std::io::sink()).unwrap());
        write_all(&mut pipe, &much, None).unwrap();
        drop(pipe);
        assert!(reading.join().unwrap() > 1 << 20);
    }
}
