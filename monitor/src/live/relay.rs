//! The public end of the server for Foxglove. The SDK's server takes whoever comes; so it listens where nobody looks for it,
//! and this relay stands before it, asks whose page a client is, and passes on what may pass.
//!
//! One thread at the ordinary priority, which sleeps until something happens; with no client it never wakes. Clients whose
//! request has not come yet are few and have a time limit, so that idle connections keep nobody out.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::os::unix::net::UnixStream;
use std::thread::JoinHandle;

use loopbound_shared::clock::{NS_PER_S, now_ns, sleep_ns};
use loopbound_shared::say;
use loopbound_shared::spawn;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::rand::{GetRandomFlags, getrandom};

use super::connection::Connection;
use super::head::Refusal;
use super::origin::Origin;

/// Clients whose request has not come yet, or who get an answer; one more takes the place of the oldest.
const WAITING_MAX: usize = 32;
/// Viewers at a time.
const VIEWERS_MAX: usize = 32;
/// Connections taken at one look.
const ACCEPTED_MAX: usize = 64;
/// Without descriptors, or whatever keeps a connection from being taken, the next attempt is made after this.
const ACCEPT_AGAIN_NS: u64 = NS_PER_S / 10;
/// For the last bytes of a run to go.
const END_WITHIN_NS: u64 = NS_PER_S / 5;
/// Between two looks whether the thread has ended.
const LOOK_NS: u64 = 1_000_000;

/// An address of this machine that nobody can guess: a web page may try any, and has 2²⁴ times all ports to try.
pub(super) fn hidden_host() -> Ipv4Addr {
    let mut drawn = [0; 3];
    // Without random numbers there is still the port.
    let _ = getrandom(&mut drawn, GetRandomFlags::NONBLOCK);
    // Neither the network's own address nor that of its broadcasts.
    Ipv4Addr::new(127, drawn[0], drawn[1], drawn[2].clamp(1, 254))
}

/// The relay while it runs.
pub(super) struct Relay {
    port: u16,
    /// Its other end is the thread's: it ends when this one does.
    stop: UnixStream,
    thread: JoinHandle<()>,
}

impl Relay {
    /// Passes those who come to `listener` on to `server`, if they are no pages or pages that may look: Foxglove's, this
    /// machine's, and those of `further`.
    ///
    /// # Errors
    /// If the system has no thread or no descriptors.
    pub(super) fn start(listener: TcpListener, server: SocketAddr, further: Vec<Origin>) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        let (stop, stopped) = UnixStream::pair()?;
        let desk = Desk { stopped, server, further, connections: Vec::new(), deaf_until_ns: 0, told: false };
        let thread = spawn::thread("relay", move || desk.serve(listener))?;
        Ok(Self { port, stop, thread })
    }

    /// Where it is served.
    pub(super) fn port(&self) -> u16 {
        self.port
    }

    /// Takes nobody any more, and lets the last bytes go, within a moment.
    pub(super) fn stop(self) {
        drop(self.stop);
        let until_ns = now_ns() + 2 * END_WITHIN_NS;
        while !self.thread.is_finished() && now_ns() < until_ns {
            sleep_ns(LOOK_NS);
        }
    }
}

/// What the thread works on.
struct Desk {
    stopped: UnixStream,
    server: SocketAddr,
    further: Vec<Origin>,
    connections: Vec<Connection>,
    /// Until then nobody is taken.
    deaf_until_ns: u64,
    /// Whether a refusal has been said: one is enough, since a page may try as often as it likes.
    told: bool,
}

/// What has happened.
struct Woken {
    stop: bool,
    come: bool,
    /// By connection.
    ready: Vec<bool>,
}

impl Desk {
    fn serve(mut self, listener: TcpListener) {
        loop {
            let now_ns = now_ns();
            let listening = (now_ns >= self.deaf_until_ns).then_some(&listener);
            let deaf_until_ns = (self.deaf_until_ns > now_ns).then_some(self.deaf_until_ns);
            let Ok(woken) = self.wait(true, listening, deaf_until_ns) else { return };
            if woken.stop {
                break;
            }
            self.go_on(&woken.ready);
            if woken.come {
                self.take(&listener);
            }
        }
        drop(listener);
        self.end();
    }

    /// Viewers get what the server still had for them.
    fn end(mut self) {
        let until_ns = now_ns() + END_WITHIN_NS;
        loop {
            self.connections.retain(|one| !one.is_over() && !one.is_waiting());
            if self.connections.is_empty() || now_ns() >= until_ns {
                return;
            }
            let Ok(woken) = self.wait(false, None, Some(until_ns)) else { return };
            self.go_on(&woken.ready);
        }
    }

    /// Sleeps until something happens, or is due.
    fn wait(&self, stoppable: bool, listener: Option<&TcpListener>, until_ns: Option<u64>) -> io::Result<Woken> {
        const STOP: usize = usize::MAX;
        const LISTENER: usize = usize::MAX - 1;
        let stop = stoppable.then(|| (STOP, PollFd::new(&self.stopped, PollFlags::IN)));
        let listener = listener.map(|listener| (LISTENER, PollFd::new(listener, PollFlags::IN)));
        let clients = self.connections.iter().enumerate().flat_map(|(at, connection)| {
            connection.wants().into_iter().flatten().map(move |(stream, flags)| (at, PollFd::new(stream, flags)))
        });
        let (whose, mut watched): (Vec<usize>, Vec<PollFd<'_>>) =
            stop.into_iter().chain(listener).chain(clients).unzip();
        let due_ns = self.connections.iter().filter_map(Connection::until_ns).chain(until_ns).min();
        let timeout = due_ns.map(|due_ns| span(due_ns.saturating_sub(now_ns())));
        match poll(&mut watched, timeout.as_ref()) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
        let now_ns = now_ns();
        let due = |one: &Connection| one.until_ns().is_some_and(|until_ns| now_ns >= until_ns);
        let mut woken = Woken { stop: false, come: false, ready: self.connections.iter().map(due).collect() };
        for (whose, fd) in whose.into_iter().zip(&watched) {
            let happened = !fd.revents().is_empty();
            match whose {
                STOP => woken.stop = happened,
                LISTENER => woken.come = happened,
                at => woken.ready[at] |= happened,
            }
        }
        Ok(woken)
    }

    fn go_on(&mut self, ready: &[bool]) {
        for (at, _) in ready.iter().enumerate().filter(|(_, ready)| **ready) {
            self.look_at(at);
        }
        self.connections.retain(|one| !one.is_over());
    }

    fn look_at(&mut self, at: usize) {
        let room = self.connections.iter().filter(|one| one.is_passing()).count() < VIEWERS_MAX;
        let refusal = self.connections[at].go_on(self.server, &self.further, room, now_ns());
        if let Some(refusal @ Refusal::Origin(_)) = refusal.filter(|_| !self.told) {
            self.told = true;
            say::err!("loopbound: --foxglove: {refusal}");
        }
    }

    fn take(&mut self, listener: &TcpListener) {
        for _ in 0..ACCEPTED_MAX {
            let stream = match listener.accept() {
                Ok((stream, _)) => stream,
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => continue,
                Err(_) => return self.deaf_until_ns = now_ns() + ACCEPT_AGAIN_NS,
            };
            let Ok(connection) = Connection::new(stream, now_ns()) else { continue };
            self.connections.push(connection);
            // The rule: the request is there already.
            self.look_at(self.connections.len() - 1);
            self.connections.retain(|one| !one.is_over());
            let waiting = self.connections.iter().filter(|one| !one.is_passing()).count();
            if waiting > WAITING_MAX
                && let Some(oldest) = self.connections.iter().position(|one| !one.is_passing())
            {
                self.connections.remove(oldest);
            }
        }
    }
}

fn span(ns: u64) -> Timespec {
    // Rounded up to the clock of poll, so that what is due is due when it wakes.
    let ns = i64::try_from(ns.saturating_add(1_000_000)).unwrap_or(i64::MAX);
    let per_s = i64::try_from(NS_PER_S).unwrap_or(1);
    Timespec { tv_sec: ns / per_s, tv_nsec: ns % per_s }
}

/// Where the server behind listens.
pub(super) fn hidden_address(host: Ipv4Addr, port: u16) -> SocketAddr {
    SocketAddr::new(IpAddr::V4(host), port)
}

#[cfg(test)]
mod tests {
    use std::io::{Read as _, Write as _};
    use std::net::{Shutdown, TcpStream};
    use std::time::Duration;

    use super::*;

    const REQUEST: &[u8] = b"GET / HTTP/1.1\r\n\r\n";

    fn relay() -> (TcpListener, Relay) {
        let server = TcpListener::bind((hidden_host(), 0)).unwrap();
        let public = TcpListener::bind("127.0.0.1:0").unwrap();
        let relay = Relay::start(public, server.local_addr().unwrap(), Vec::new()).unwrap();
        (server, relay)
    }

    fn client(relay: &Relay) -> TcpStream {
        let client = TcpStream::connect(("127.0.0.1", relay.port())).unwrap();
        client.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        client
    }

    #[test]
    fn what_passes_is_passed_whole_both_ways_and_so_is_its_end() {
        const LENGTH: usize = 3_000_000;
        let (server, relay) = relay();
        let echo = std::thread::spawn(move || {
            let (mut stream, _) = server.accept().unwrap();
            let mut back = stream.try_clone().unwrap();
            std::io::copy(&mut stream, &mut back).unwrap();
        });
        let mut viewer = client(&relay);
        let mut writer = viewer.try_clone().unwrap();
        let sent: Vec<u8> = REQUEST.iter().copied().chain((0..=u8::MAX).cycle()).take(LENGTH).collect();
        let copy = sent.clone();
        let sending = std::thread::spawn(move || {
            writer.write_all(&copy).unwrap();
            writer.shutdown(Shutdown::Write).unwrap();
        });
        let mut came = Vec::new();
        viewer.read_to_end(&mut came).unwrap();
        assert!(came == sent, "{} of {LENGTH} bytes came back", came.len());
        sending.join().unwrap();
        echo.join().unwrap();
        relay.stop();
    }

    #[test]
    fn hundreds_of_idle_connections_keep_nobody_out() {
        let (server, relay) = relay();
        let idle: Vec<TcpStream> = (0..300).map(|_| client(&relay)).collect();
        let mut viewer = client(&relay);
        viewer.write_all(REQUEST).unwrap();
        let (mut stream, _) = server.accept().unwrap();
        let mut head = [0; REQUEST.len()];
        stream.read_exact(&mut head).unwrap();
        assert_eq!(head, REQUEST);
        // The oldest have made room.
        assert_eq!((&idle[0]).read(&mut [0]).unwrap(), 0);
        relay.stop();
    }

    #[test]
    fn a_viewer_that_never_reads_does_not_keep_the_end_and_the_address_is_free_after_it() {
        let (server, relay) = relay();
        let mut viewer = client(&relay);
        viewer.write_all(REQUEST).unwrap();
        let (stream, _) = server.accept().unwrap();
        stream.set_nonblocking(true).unwrap();
        while (&stream).write(&[0; 65536]).is_ok() {}
        let port = relay.port();
        relay.stop();
        TcpListener::bind(("127.0.0.1", port)).unwrap();
    }

    #[test]
    fn whoever_comes_when_it_ends_is_let_go() {
        let (_server, relay) = relay();
        let port = relay.port();
        let coming = std::thread::spawn(move || {
            let mut refused = 0;
            while refused == 0 {
                match TcpStream::connect(("127.0.0.1", port)) {
                    Ok(mut stream) => drop(stream.write_all(b"GET / HT")),
                    Err(_) => refused += 1,
                }
            }
        });
        relay.stop();
        coming.join().unwrap();
    }
}
