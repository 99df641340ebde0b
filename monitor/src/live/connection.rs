//! One client of the relay: its request is looked at, then bytes pass both ways, or it gets an answer and is let go.
//!
//! Nothing here waits: a socket that is not ready is left for the next look.

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::mem::replace;
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::time::Duration;

use loopbound_shared::clock::NS_PER_S;
use rustix::event::PollFlags;
use rustix::net::sockopt::set_socket_recv_buffer_size;

use super::head::{Refusal, Ruling, rule};
use super::origin::Origin;

/// A viewer sends its request at once.
const HEAD_WITHIN_NS: u64 = 5 * NS_PER_S;
/// To take an answer, or the rest after one end has closed.
const CLOSE_WITHIN_NS: u64 = 2 * NS_PER_S;
/// The server listens on this machine: it answers at once, or not at all.
const CONNECT_WITHIN: Duration = Duration::from_millis(100);
/// What waits for a reader in one direction, and what the kernel may hold back before it.
const PIPE_BYTES: usize = 64 * 1024;
/// Pieces that pass at one look: others have their turn too.
const PIECES_MAX: usize = 16;

/// A client.
pub(super) struct Connection {
    public: TcpStream,
    stage: Stage,
    until_ns: Option<u64>,
}

enum Stage {
    /// The head of its request is coming.
    Head(Vec<u8>),
    /// It talks to the server.
    Passing {
        inner: TcpStream,
        up: Pipe,
        down: Pipe,
    },
    /// It gets an answer; what it sends meanwhile is read and dropped, so that the answer is not lost by a reset.
    Refused(Pipe),
    Over,
}

/// One direction.
#[derive(Default)]
struct Pipe {
    bytes: Vec<u8>,
    written: usize,
    /// The source has closed.
    ended: bool,
    /// The sink has been told.
    shut: bool,
}

impl Connection {
    pub(super) fn new(public: TcpStream, now_ns: u64) -> io::Result<Self> {
        public.set_nonblocking(true)?;
        public.set_nodelay(true)?;
        Ok(Self { public, stage: Stage::Head(Vec::new()), until_ns: Some(now_ns + HEAD_WITHIN_NS) })
    }

    pub(super) fn is_over(&self) -> bool {
        matches!(self.stage, Stage::Over)
    }

    /// Whether nothing has been decided about it yet.
    pub(super) fn is_waiting(&self) -> bool {
        matches!(self.stage, Stage::Head(_))
    }

    pub(super) fn is_passing(&self) -> bool {
        matches!(self.stage, Stage::Passing { .. })
    }

    /// When it is to be looked at even if nothing happens.
    pub(super) fn until_ns(&self) -> Option<u64> {
        self.until_ns
    }

    /// What has to happen to the client's and to the server's socket before there is anything to do. A socket of which
    /// nothing is wanted isn't watched: its end alone would wake the watcher again and again.
    pub(super) fn wants(&self) -> [Option<(&TcpStream, PollFlags)>; 2] {
        let watched = |stream, flags: PollFlags| (!flags.is_empty()).then_some((stream, flags));
        match &self.stage {
            Stage::Head(_) => [watched(&self.public, PollFlags::IN), None],
            Stage::Passing { inner, up, down } => {
                [watched(&self.public, up.reads() | down.writes()), watched(inner, down.reads() | up.writes())]
            }
            Stage::Refused(answer) => {
                let flags = if answer.is_empty() { PollFlags::IN } else { answer.writes() };
                [watched(&self.public, flags), None]
            }
            Stage::Over => [None, None],
        }
    }

    /// Goes on as far as it can at `now_ns`. The refusal, if it is refused now.
    pub(super) fn go_on(&mut self, server: SocketAddr, further: &[Origin], room: bool, now_ns: u64) -> Option<Refusal> {
        let late = self.until_ns.is_some_and(|until_ns| now_ns >= until_ns);
        let mut refusal = None;
        if let Stage::Head(bytes) = &mut self.stage {
            match self.public.hear(bytes) {
                Err(_) => self.stage = Stage::Over,
                Ok(ended) => match rule(bytes, further) {
                    Ruling::Wait if ended => self.stage = Stage::Over,
                    Ruling::Wait if late => refusal = Some(Refusal::TooSlow),
                    Ruling::Wait => {}
                    Ruling::Pass if room => refusal = self.connect(server, ended),
                    Ruling::Pass => refusal = Some(Refusal::NoPlace),
                    Ruling::Refuse(why) => refusal = Some(why),
                },
            }
        } else if late {
            self.stage = Stage::Over;
        }
        if let Some(refusal) = &refusal {
            self.stage = Stage::Refused(Pipe { bytes: refusal.answer(), ended: true, ..Pipe::default() });
            self.until_ns = Some(now_ns + CLOSE_WITHIN_NS);
        }
        if self.pass(now_ns).is_err() {
            self.stage = Stage::Over;
        }
        refusal
    }

    /// Gives the request to the server.
    fn connect(&mut self, server: SocketAddr, ended: bool) -> Option<Refusal> {
        let connected = TcpStream::connect_timeout(&server, CONNECT_WITHIN).and_then(|inner| {
            inner.set_nonblocking(true)?;
            inner.set_nodelay(true)?;
            // A slow viewer should lose what is old, not look at it later and later.
            set_socket_recv_buffer_size(&inner, PIPE_BYTES)?;
            Ok(inner)
        });
        let Ok(inner) = connected else { return Some(Refusal::NoPlace) };
        let Stage::Head(head) = replace(&mut self.stage, Stage::Over) else { return None };
        let up = Pipe { bytes: head, ended, ..Pipe::default() };
        (self.stage, self.until_ns) = (Stage::Passing { inner, up, down: Pipe::default() }, None);
        None
    }

    fn pass(&mut self, now_ns: u64) -> io::Result<()> {
        match &mut self.stage {
            Stage::Head(_) | Stage::Over => return Ok(()),
            Stage::Passing { inner, up, down } => {
                up.pass(&mut self.public, inner)?;
                down.pass(inner, &mut self.public)?;
                if (up.shut || down.shut) && self.until_ns.is_none() {
                    self.until_ns = Some(now_ns + CLOSE_WITHIN_NS);
                }
                if up.shut && down.shut {
                    self.stage = Stage::Over;
                }
            }
            Stage::Refused(answer) => {
                answer.write(&mut self.public)?;
                if self.public.drop_what_comes()? {
                    self.stage = Stage::Over;
                }
            }
        }
        Ok(())
    }
}

impl Pipe {
    fn is_empty(&self) -> bool {
        self.written == self.bytes.len()
    }

    fn reads(&self) -> PollFlags {
        if self.is_empty() && !self.ended { PollFlags::IN } else { PollFlags::empty() }
    }

    fn writes(&self) -> PollFlags {
        if self.is_empty() { PollFlags::empty() } else { PollFlags::OUT }
    }

    fn pass(&mut self, source: &mut TcpStream, sink: &mut TcpStream) -> io::Result<()> {
        for _ in 0..PIECES_MAX {
            if self.is_empty() && !self.ended {
                self.bytes.resize(PIPE_BYTES, 0);
                let read = not_yet(source.read(&mut self.bytes));
                self.bytes.truncate(*read.as_ref().ok().and_then(Option::as_ref).unwrap_or(&0));
                self.written = 0;
                match read? {
                    None => return Ok(()),
                    Some(count) => self.ended = count == 0,
                }
            }
            self.write(sink)?;
            if !self.is_empty() || self.ended {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Writes what it can, and says that there is no more when there is no more.
    fn write(&mut self, sink: &mut TcpStream) -> io::Result<()> {
        while let Some(rest) = self.bytes.get(self.written..).filter(|rest| !rest.is_empty()) {
            match not_yet(sink.write(rest))? {
                Some(count) if count > 0 => self.written += count,
                _ => return Ok(()),
            }
        }
        if self.ended && !self.shut {
            self.shut = true;
            sink.shutdown(Shutdown::Write)?;
        }
        Ok(())
    }
}

/// What a client's socket is asked before and after it passes.
trait Hear {
    /// Adds what has come. Whether that was all.
    fn hear(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool>;
    /// Whether it has closed; what comes is of no interest.
    fn drop_what_comes(&mut self) -> io::Result<bool>;
}

impl Hear for TcpStream {
    fn hear(&mut self, bytes: &mut Vec<u8>) -> io::Result<bool> {
        let mut piece = [0; 4096];
        // As many pieces as make the longest head; the ruling ends the rest.
        for _ in 0..3 {
            match not_yet(self.read(&mut piece))? {
                None => break,
                Some(0) => return Ok(true),
                Some(count) => bytes.extend_from_slice(&piece[..count]),
            }
        }
        Ok(false)
    }

    fn drop_what_comes(&mut self) -> io::Result<bool> {
        let mut piece = [0; 4096];
        for _ in 0..PIECES_MAX {
            match not_yet(self.read(&mut piece))? {
                None => return Ok(false),
                Some(0) => return Ok(true),
                Some(_) => {}
            }
        }
        Ok(false)
    }
}

/// `None` of what would have to be waited for.
fn not_yet(done: io::Result<usize>) -> io::Result<Option<usize>> {
    match done {
        Ok(count) => Ok(Some(count)),
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use super::*;

    /// A server that was not asked yet, a client, and the relay's end of it at the instant 0.
    fn pair() -> (TcpListener, TcpStream, Connection) {
        let server = TcpListener::bind("127.0.0.1:0").unwrap();
        let public = TcpListener::bind("127.0.0.1:0").unwrap();
        let client = TcpStream::connect(public.local_addr().unwrap()).unwrap();
        client.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        (server, client, Connection::new(public.accept().unwrap().0, 0).unwrap())
    }

    /// Looks until something is decided.
    fn decide(connection: &mut Connection, server: &TcpListener, room: bool, now_ns: u64) -> Option<Refusal> {
        for _ in 0..20_000 {
            let refusal = connection.go_on(server.local_addr().unwrap(), &[], room, now_ns);
            if refusal.is_some() || !connection.is_waiting() {
                return refusal;
            }
            std::thread::yield_now();
        }
        panic!("nothing is decided");
    }

    fn answer(mut client: TcpStream) -> String {
        let mut text = String::new();
        client.read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn a_head_that_comes_byte_by_byte_passes_and_one_that_takes_too_long_is_answered() {
        let (server, mut client, mut connection) = pair();
        for byte in b"GET / HTTP/1.1\r\n\r" {
            client.write_all(&[*byte]).unwrap();
            assert_eq!(connection.go_on(server.local_addr().unwrap(), &[], true, 1), None);
            assert!(connection.is_waiting());
        }
        client.write_all(b"\n").unwrap();
        assert_eq!(decide(&mut connection, &server, true, HEAD_WITHIN_NS - 1), None);
        assert!(connection.is_passing() && connection.until_ns().is_none());

        let (server, mut slow, mut connection) = pair();
        slow.write_all(b"GET / HTTP/1.1\r\nX: y").unwrap();
        assert_eq!(decide(&mut connection, &server, true, HEAD_WITHIN_NS), Some(Refusal::TooSlow));
        // Its end of the connection is closed only when it has closed its own, or after a while.
        assert_eq!(connection.go_on(server.local_addr().unwrap(), &[], true, HEAD_WITHIN_NS + CLOSE_WITHIN_NS), None);
        assert!(connection.is_over());
        assert!(answer(slow).starts_with("HTTP/1.1 408 "));
    }

    #[test]
    fn whoever_finds_no_place_or_no_server_is_told() {
        let (server, mut client, mut connection) = pair();
        client.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
        assert_eq!(decide(&mut connection, &server, false, 0), Some(Refusal::NoPlace));
        drop(connection);
        assert!(answer(client).starts_with("HTTP/1.1 503 "));

        let (server, mut client, mut connection) = pair();
        client.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
        let gone = server.local_addr().unwrap();
        drop(server);
        let mut refusal = None;
        while connection.is_waiting() {
            refusal = connection.go_on(gone, &[], true, 0);
        }
        assert_eq!(refusal, Some(Refusal::NoPlace));
    }

    #[test]
    fn a_client_that_leaves_before_its_request_is_forgotten() {
        let (server, client, mut connection) = pair();
        drop(client);
        assert_eq!(decide(&mut connection, &server, true, 0), None);
        assert!(connection.is_over());
    }
}
