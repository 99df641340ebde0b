//! The terminal of the view: pictures, keys, and its end.
//!
//! A terminal ends when its window is closed or its connection breaks. Then it reads as "nothing, for ever", which a reader
//! that waits for a key would take for a reason to look again at once. So keys are read here, and the end is an input
//! like a key. Nothing here prints or panics where there is no terminal any more.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, IsTerminal as _, Stdout, stdin};
use std::mem::ManuallyDrop;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use loopbound_shared::say;
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

/// Bytes taken at a time; a paste comes in several.
const CHUNK: usize = 64;
const CTRL_C: u8 = 3;
const ESC: u8 = 0x1b;

/// What came from the terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Input {
    /// A character, or Esc as itself.
    Key(char),
    /// Ctrl-C.
    Interrupt,
    /// Nothing in the time given.
    Nothing,
    /// There is no terminal any more.
    Gone,
}

/// The terminal while the view has it. Given back when it is dropped.
pub(super) struct Screen {
    /// Never dropped: its destructor would print to a terminal that may have gone.
    terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
    keys: Keys,
}

impl Screen {
    /// Takes the terminal.
    pub(super) fn open() -> io::Result<Self> {
        let keys = Keys::open()?;
        enable_raw_mode()?;
        let opened = execute!(say::screen(), EnterAlternateScreen)
            .and_then(|()| Terminal::new(CrosstermBackend::new(say::screen())));
        match opened {
            Ok(terminal) => Ok(Self { terminal: ManuallyDrop::new(terminal), keys }),
            Err(error) => {
                give_back();
                Err(error)
            }
        }
    }

    /// Draws a picture.
    pub(super) fn draw(&mut self, picture: impl FnOnce(&mut ratatui::Frame<'_>)) -> io::Result<()> {
        self.terminal.draw(picture).map(|_| ())
    }

    /// Waits for a key, at most so long.
    pub(super) fn input(&mut self, timeout: Duration) -> io::Result<Input> {
        self.keys.next(timeout)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.terminal.show_cursor();
        give_back();
    }
}

/// Where there is no terminal any more there is nothing to give back.
fn give_back() {
    let _ = execute!(say::screen(), LeaveAlternateScreen);
    let _ = disable_raw_mode();
}

/// The keys of a terminal in raw mode.
struct Keys {
    /// None: standard input is the terminal.
    terminal: Option<File>,
    pressed: VecDeque<Input>,
}

impl Keys {
    fn open() -> io::Result<Self> {
        let terminal = if stdin().is_terminal() { None } else { Some(File::open("/dev/tty")?) };
        Ok(Self { terminal, pressed: VecDeque::new() })
    }

    fn next(&mut self, timeout: Duration) -> io::Result<Input> {
        if let Some(input) = self.pressed.pop_front() {
            return Ok(input);
        }
        let stdin = stdin();
        let terminal = self.terminal.as_ref().map_or_else(|| stdin.as_fd(), AsFd::as_fd);
        let read = read(terminal, timeout)?;
        self.pressed.extend(read);
        Ok(self.pressed.pop_front().unwrap_or(Input::Nothing))
    }
}

/// What can be read within `timeout`.
fn read(terminal: BorrowedFd<'_>, timeout: Duration) -> io::Result<Vec<Input>> {
    let timeout = Timespec::try_from(timeout).map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
    let mut look = [PollFd::from_borrowed_fd(terminal, PollFlags::IN)];
    match poll(&mut look, Some(&timeout)) {
        Ok(0) | Err(Errno::INTR) => return Ok(Vec::new()),
        Ok(_) => {}
        Err(error) => return Err(error.into()),
    }
    if look[0].revents().intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL) {
        return Ok(vec![Input::Gone]);
    }
    let mut bytes = [0; CHUNK];
    match rustix::io::read(terminal, &mut bytes) {
        Ok(0) | Err(Errno::IO) => Ok(vec![Input::Gone]),
        Ok(count) => Ok(inputs(&bytes[..count])),
        Err(Errno::INTR | Errno::AGAIN) => Ok(Vec::new()),
        Err(error) => Err(error.into()),
    }
}

/// The keys in what was read at once. An arrow or a function key is a sequence that begins with Esc: it is none of ours.
fn inputs(bytes: &[u8]) -> Vec<Input> {
    match bytes {
        [ESC] => vec![Input::Key('\u{1b}')],
        [ESC, ..] => Vec::new(),
        _ => bytes.iter().filter_map(|byte| key(*byte)).collect(),
    }
}

fn key(byte: u8) -> Option<Input> {
    match byte {
        CTRL_C => Some(Input::Interrupt),
        ESC => Some(Input::Key('\u{1b}')),
        b' '..=b'~' => Some(Input::Key(char::from(byte))),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    const SOON: Duration = Duration::from_millis(10);

    #[test]
    fn keys_come_one_by_one_and_sequences_of_the_terminal_are_passed_over() {
        assert_eq!(inputs(b"sf"), [Input::Key('s'), Input::Key('f')]);
        assert_eq!(inputs(b"\x1b"), [Input::Key('\u{1b}')]);
        assert_eq!(inputs(b"\x1b[A"), []);
        assert_eq!(inputs(b"\x03"), [Input::Interrupt]);
        assert_eq!(inputs("é\n".as_bytes()), []);
    }

    #[test]
    fn whatever_has_hung_up_is_gone_and_does_not_look_like_silence() {
        let (reader, mut writer) = io::pipe().unwrap();
        assert_eq!(read(reader.as_fd(), SOON).unwrap(), []);
        writer.write_all(b"q").unwrap();
        assert_eq!(read(reader.as_fd(), SOON).unwrap(), [Input::Key('q')]);
        drop(writer);
        assert_eq!(read(reader.as_fd(), SOON).unwrap(), [Input::Gone]);
    }
}
