//! Files that somebody else wrote, read with an end: never more than so many bytes, never longer than so long.
//!
//! A path may name a pipe that nobody writes to, a device that never ends, or a file of gigabytes. What a user names on
//! the command line may be a pipe (`<(…)`): [`read_text`] waits for it, but not for ever. What lies in the folder of a
//! run is a regular file or refused: [`open_file`], [`read_file`]. Errors do not name the path: who asks does.

use std::fs::File;
use std::io::{self, Read, Seek as _, SeekFrom};
use std::os::fd::{AsFd as _, OwnedFd};
use std::path::Path;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::time::{Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, timerfd_create, timerfd_settime};

/// A scenario or a file of expectations: one with every key written out has 4 KiB.
pub const SCENARIO_BYTES_MAX: u64 = 1 << 20;
/// A file of waypoints: some hundred thousand of them for 7 links.
pub const WAYPOINTS_BYTES_MAX: u64 = 32 << 20;
/// `summary.json`, which quotes the scenario and what every process said.
pub const SUMMARY_BYTES_MAX: u64 = 64 << 20;
/// `blocks.jsonl` and `latency.hlog`: some tens of megabytes an hour.
pub const FIGURES_BYTES_MAX: u64 = 1 << 30;
/// One line of JSON, of a question to `model` or of `events.jsonl`.
pub const LINE_BYTES_MAX: usize = 1 << 20;

/// A pipe from which nothing comes for so long is given up.
const SILENCE: Timespec = Timespec { tv_sec: 5, tv_nsec: 0 };
/// The longest that a pipe is read.
const READING: Timespec = Timespec { tv_sec: 60, tv_nsec: 0 };
/// Bytes taken at once.
const PIECE: usize = 1 << 16;

/// Reads a file, a pipe or a device to its end.
///
/// # Errors
/// What the system says; more than `most` bytes; a pipe from which nothing comes, or that does not end.
pub fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    // Without waiting: to open a pipe would wait for its writer.
    let mut file = open(path)?;
    let metadata = file.metadata()?;
    if metadata.is_file() && metadata.len() > most {
        return Err(too_long(most));
    }
    read_to_end(&mut file, most)
}

/// [`read`], as text.
///
/// # Errors
/// Those of [`read`], and bytes that are not UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    text_of(read(path, most)?)
}

/// Opens a regular file and nothing else; symbolic links are followed.
///
/// # Errors
/// What the system says, or that it is something else.
pub fn open_file(path: &Path) -> io::Result<File> {
    let file = open(path)?;
    if file.metadata()?.is_file() {
        return Ok(file);
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, "found a folder, a pipe or a device, allowed: a file"))
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// What the system says, that it is no regular file, or that it is longer.
pub fn read_file(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut file = open_file(path)?;
    if file.metadata()?.len() > most {
        return Err(too_long(most));
    }
    let mut bytes = Vec::new();
    // It may grow meanwhile.
    file.by_ref().take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most { Err(too_long(most)) } else { Ok(bytes) }
}

/// [`read_file`], as text.
///
/// # Errors
/// Those of [`read_file`], and bytes that are not UTF-8.
pub fn read_file_text(path: &Path, most: u64) -> io::Result<String> {
    text_of(read_file(path, most)?)
}

/// The last `most` bytes of a regular file.
///
/// # Errors
/// What the system says, or that it is no regular file.
pub fn read_end(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut file = open_file(path)?;
    let from = file.metadata()?.len().saturating_sub(most);
    file.seek(SeekFrom::Start(from))?;
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// One line of a stream.
#[derive(Debug, PartialEq, Eq)]
pub enum Line {
    /// Its bytes, without the line feed.
    Whole(Vec<u8>),
    /// It is longer than [`LINE_BYTES_MAX`]; all of it was passed over.
    TooLong,
}

/// The next line of a stream, holding no more than [`LINE_BYTES_MAX`] of it; none at the end.
///
/// # Errors
/// What the system says.
pub fn next_line(stream: &mut impl io::BufRead) -> io::Result<Option<Line>> {
    let (mut bytes, mut too_long, mut any) = (Vec::new(), false, false);
    loop {
        let piece = match stream.fill_buf() {
            Ok(piece) => piece,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        if piece.is_empty() {
            break;
        }
        any = true;
        let end = piece.iter().position(|byte| *byte == b'\n');
        let part = &piece[..end.unwrap_or(piece.len())];
        too_long |= bytes.len() + part.len() > LINE_BYTES_MAX;
        if !too_long {
            bytes.extend_from_slice(part);
        }
        let used = part.len() + usize::from(end.is_some());
        stream.consume(used);
        if end.is_some() {
            break;
        }
    }
    Ok(any.then_some(if too_long { Line::TooLong } else { Line::Whole(bytes) }))
}

fn open(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC | OFlags::NOCTTY;
    Ok(File::from(rustix::fs::open(path, flags, Mode::empty())?))
}

fn read_to_end(file: &mut File, most: u64) -> io::Result<Vec<u8>> {
    let (mut bytes, mut piece) = (Vec::new(), vec![0; PIECE]);
    let end = alarm_after(READING)?;
    loop {
        wait_for_bytes(file, &end)?;
        let count = match file.read(&mut piece) {
            Ok(0) => return Ok(bytes),
            Ok(count) => count,
            Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => continue,
            Err(error) => return Err(error),
        };
        bytes.extend_from_slice(&piece[..count]);
        if bytes.len() as u64 > most {
            return Err(too_long(most));
        }
    }
}

/// A descriptor that becomes readable after so long.
fn alarm_after(time: Timespec) -> io::Result<OwnedFd> {
    let alarm = timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::CLOEXEC)?;
    let once = Itimerspec { it_interval: Timespec { tv_sec: 0, tv_nsec: 0 }, it_value: time };
    timerfd_settime(&alarm, TimerfdTimerFlags::empty(), &once)?;
    Ok(alarm)
}

/// Returns when there is something to read, or the end; at once for a regular file.
fn wait_for_bytes(file: &File, end: &OwnedFd) -> io::Result<()> {
    let give_up = |why: String| Err(io::Error::new(io::ErrorKind::TimedOut, why));
    let silence = alarm_after(SILENCE)?;
    loop {
        let mut waited =
            [file.as_fd(), silence.as_fd(), end.as_fd()].map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN));
        match poll(&mut waited, None) {
            Err(rustix::io::Errno::INTR) => continue,
            Err(error) => return Err(error.into()),
            Ok(_) => {}
        }
        let [is_ready, is_silent, is_over] = waited.map(|of| !of.revents().is_empty());
        if is_over {
            return give_up(format!("it did not end within {} s", READING.tv_sec));
        }
        if is_ready {
            return Ok(());
        }
        if is_silent {
            return give_up(format!(
                "nothing came of it for {} s, allowed: a file, or a pipe that is written to",
                SILENCE.tv_sec
            ));
        }
    }
}

fn text_of(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let line = error.as_bytes()[..at].iter().filter(|byte| **byte == b'\n').count() + 1;
        io::Error::new(io::ErrorKind::InvalidData, format!("line {line} is not text (UTF-8)"))
    })
}

fn too_long(most: u64) -> io::Error {
    let most = if most >= 1 << 20 { format!("{} MiB", most >> 20) } else { format!("{most} bytes") };
    io::Error::new(io::ErrorKind::InvalidData, format!("it is longer than what is read of such a file: {most}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    #[test]
    fn a_file_within_its_limit_is_read_and_one_byte_more_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, "12345").unwrap();
        assert_eq!(read(&path, 5).unwrap(), b"12345");
        assert_eq!(read_file(&path, 5).unwrap(), b"12345");
        for refused in [read(&path, 4), read_file(&path, 4)] {
            assert!(refused.unwrap_err().to_string().contains("4 bytes"));
        }
        std::fs::write(&path, b"a\nb\xff").unwrap();
        assert_eq!(read_text(&path, 5).unwrap_err().to_string(), "line 2 is not text (UTF-8)");
        assert!(read(folder.path(), 5).is_err() && open_file(folder.path()).is_err());
        assert_eq!(read_end(&path, 2).unwrap(), b"b\xff");
        // A hole of 4 GB costs nothing to refuse.
        File::create(&path).unwrap().set_len(4 << 30).unwrap();
        assert!(read(&path, 1 << 20).unwrap_err().to_string().contains("1 MiB"));
    }

    #[test]
    fn devices_that_never_end_are_bounded_and_no_file_of_a_run() {
        assert!(read(Path::new("/dev/zero"), 1000).unwrap_err().to_string().contains("longer"));
        assert_eq!(read(Path::new("/dev/null"), 1000).unwrap(), b"");
        for path in ["/dev/zero", "/dev/null"] {
            assert!(read_file(Path::new(path), 1000).unwrap_err().to_string().contains("allowed: a file"));
        }
    }

    fn pipe(folder: &Path) -> std::path::PathBuf {
        let path = folder.join("pipe");
        rustix::fs::mkfifoat(rustix::fs::CWD, &path, Mode::from_raw_mode(0o600)).unwrap();
        path
    }

    #[test]
    fn a_pipe_is_waited_for_and_read_to_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = pipe(folder.path());
        let writer = std::thread::spawn({
            let path = path.clone();
            move || {
                let _ = rustix::thread::nanosleep(&Timespec { tv_sec: 0, tv_nsec: 30_000_000 });
                let mut file = std::fs::OpenOptions::new().write(true).open(path).unwrap();
                for piece in ["one, ", "two"] {
                    file.write_all(piece.as_bytes()).unwrap();
                    let _ = rustix::thread::nanosleep(&Timespec { tv_sec: 0, tv_nsec: 20_000_000 });
                }
            }
        });
        assert_eq!(read_text(&path, 100).unwrap(), "one, two");
        writer.join().unwrap();
    }

    #[test]
    fn a_pipe_that_nobody_writes_to_is_given_up_and_is_no_file_of_a_run() {
        let folder = tempfile::tempdir().unwrap();
        let path = pipe(folder.path());
        assert!(open_file(&path).unwrap_err().to_string().contains("allowed: a file"));
        assert!(read(&path, 100).unwrap_err().to_string().contains("nothing came of it for 5 s"));
    }

    #[test]
    fn a_line_is_held_up_to_its_limit_and_the_next_one_is_found() {
        let mut text = vec![b'x'; LINE_BYTES_MAX + 1];
        text.extend_from_slice(b"\nshort\n\nlast");
        let mut stream = io::BufReader::with_capacity(1000, text.as_slice());
        assert_eq!(next_line(&mut stream).unwrap(), Some(Line::TooLong));
        for expected in ["short", "", "last"] {
            assert_eq!(next_line(&mut stream).unwrap(), Some(Line::Whole(expected.as_bytes().to_vec())));
        }
        assert_eq!(next_line(&mut stream).unwrap(), None);
        let whole = vec![b'y'; LINE_BYTES_MAX];
        assert_eq!(next_line(&mut whole.as_slice()).unwrap(), Some(Line::Whole(whole)));
    }
}
