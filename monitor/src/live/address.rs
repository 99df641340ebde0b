//! Where the live view is served, as people write it.

use std::fmt;
use std::net::{Ipv4Addr, Ipv6Addr, TcpListener};
use std::str::FromStr;

use super::LiveError;

/// The port that Foxglove proposes.
const PORT: u16 = 8765;

/// A host and a port. Nobody but this machine can connect unless the host says so by itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    host: String,
    port: u16,
}

/// Why a text is no address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AddressError {
    /// What should be the port is none.
    #[error("`{0}` is no port: a number up to 65535")]
    Port(String),
    /// What should be the host is none.
    #[error("`{0}` is no host: write HOST:PORT, HOST or PORT, such as 127.0.0.1:8765")]
    Host(String),
}

impl Address {
    /// The host, an IPv6 address in brackets.
    #[must_use]
    pub fn host(&self) -> &str {
        &self.host
    }

    /// The port; 0: whichever is free.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Whether only processes of this machine can connect.
    #[must_use]
    pub fn is_loopback(&self) -> bool {
        let bare = self.host.trim_matches(['[', ']']);
        bare == "localhost"
            || bare.parse::<Ipv4Addr>().is_ok_and(|ip| ip.is_loopback())
            || bare.parse::<Ipv6Addr>().is_ok_and(|ip| ip.is_loopback())
    }

    /// Whether it could be served there now, for whoever wants to know before a group is started.
    ///
    /// # Errors
    /// If the address is in use or not of this machine, or the build has no server.
    pub fn probe(&self) -> Result<(), LiveError> {
        if cfg!(not(feature = "foxglove")) {
            return Err(LiveError::Absent);
        }
        let bound = TcpListener::bind(self.to_string());
        bound.map(drop).map_err(|source| LiveError::Bind { address: self.clone(), source })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.host, self.port)
    }
}

impl FromStr for Address {
    type Err = AddressError;

    /// `PORT`, `HOST` or `HOST:PORT`; the default host is the loopback.
    fn from_str(text: &str) -> Result<Self, AddressError> {
        let port = |text: &str| text.parse::<u16>().map_err(|_| AddressError::Port(text.to_owned()));
        let at = |host: &str, port| Self { host: host.to_owned(), port };
        if !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit()) {
            return Ok(at(&Ipv4Addr::LOCALHOST.to_string(), port(text)?));
        }
        if text.parse::<Ipv6Addr>().is_ok() {
            return Ok(at(&format!("[{text}]"), PORT));
        }
        if let Some((host, rest)) = text.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            let rest = rest.strip_prefix(':').map_or(Ok(PORT), port)?;
            let ip: Ipv6Addr = host.parse().map_err(|_| AddressError::Host(host.to_owned()))?;
            return Ok(at(&format!("[{ip}]"), rest));
        }
        let is_host = |host: &str| {
            !host.is_empty() && host.bytes().all(|byte| byte.is_ascii_alphanumeric() || b".-_".contains(&byte))
        };
        let (host, port) = match text.rsplit_once(':') {
            Some((host, given)) if is_host(host) && !given.starts_with('/') => (host, port(given)?),
            _ => (text, PORT),
        };
        if is_host(host) { Ok(at(host, port)) } else { Err(AddressError::Host(text.to_owned())) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(text: &str) -> String {
        text.parse::<Address>().unwrap().to_string()
    }

    #[test]
    fn a_port_a_host_or_both_are_an_address_and_the_loopback_is_the_default() {
        assert_eq!(written("9000"), "127.0.0.1:9000");
        assert_eq!(written("localhost"), "localhost:8765");
        assert_eq!(written("0.0.0.0:0"), "0.0.0.0:0");
        assert_eq!(written("robot-1.lan:8766"), "robot-1.lan:8766");
        assert_eq!(
            (written("::1"), written("[::1]"), written("[::1]:7")),
            ("[::1]:8765".into(), "[::1]:8765".into(), "[::1]:7".into())
        );
    }

    #[test]
    fn what_is_no_address_is_refused_by_the_part_that_is_wrong() {
        let refused = |text: &str| text.parse::<Address>().unwrap_err();
        assert_eq!(refused("65536"), AddressError::Port("65536".into()));
        assert_eq!(refused("localhost:http"), AddressError::Port("http".into()));
        assert_eq!(refused("[::1]:x"), AddressError::Port("x".into()));
        for text in ["", ":8765", "ws://127.0.0.1:8765", "ws://robot", "a b", "[::x]:1", "[::1"] {
            assert!(matches!(refused(text), AddressError::Host(_)), "{text}");
        }
    }

    #[test]
    fn only_addresses_of_the_loopback_are_for_this_machine_alone() {
        let loopback = |text: &str| text.parse::<Address>().unwrap().is_loopback();
        assert!(["8765", "localhost", "127.0.0.2:1", "[::1]:8765"].into_iter().all(loopback));
        assert!(!["0.0.0.0", "[::]:8765", "192.168.1.2", "robot"].into_iter().any(loopback));
    }

    #[test]
    #[cfg(not(feature = "foxglove"))]
    fn a_build_without_the_server_says_how_to_build_one_with_it() {
        let error = "0".parse::<Address>().unwrap().probe().unwrap_err().to_string();
        assert!(error.contains("cargo build --release --features foxglove"), "{error}");
    }

    #[test]
    #[cfg(feature = "foxglove")]
    fn a_port_in_use_is_named() {
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let address: Address = taken.local_addr().unwrap().to_string().parse().unwrap();
        let error = address.probe().unwrap_err().to_string();
        assert!(error.contains(&address.to_string()) && error.contains("in use"), "{error}");
        drop(taken);
        address.probe().unwrap();
    }
}
