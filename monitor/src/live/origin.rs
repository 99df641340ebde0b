//! Which web pages may look at a run. A browser names the page that opens a WebSocket in `Origin`, and lets any page
//! open one to this machine: so whoever serves has to look.

use std::fmt;
#[cfg(feature = "foxglove")]
use std::net::Ipv4Addr;
use std::net::Ipv6Addr;
use std::str::FromStr;

use loopbound_model::quote;

/// Foxglove in the browser.
#[cfg(feature = "foxglove")]
const FOXGLOVE: &str = "https://app.foxglove.dev";
/// Foxglove on the desktop, whose pages are files.
#[cfg(feature = "foxglove")]
const DESKTOP: &str = "file://";

/// Where a web page comes from: scheme, host, and the port unless it is the scheme's own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    scheme: String,
    host: String,
    port: Option<u16>,
}

/// Why a text is no origin.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{}` is no origin: write SCHEME://HOST or SCHEME://HOST:PORT without a path, such as https://viewer.example:8080", quote::text(.0))]
pub struct OriginError(String);

#[cfg(feature = "foxglove")]
impl Origin {
    /// Whether the page is served by this machine itself.
    fn is_loopback(&self) -> bool {
        let bare = self.host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        let is_loopback = match bare {
            Some(bare) => bare.parse::<Ipv6Addr>().is_ok_and(|ip| ip.is_loopback()),
            None => self.host == "localhost" || self.host.parse::<Ipv4Addr>().is_ok_and(|ip| ip.is_loopback()),
        };
        is_loopback && ["http", "https"].contains(&self.scheme.as_str())
    }

    /// Whether a page from here may look at a run, where `further` are allowed besides Foxglove and this machine.
    pub(super) fn may_look(&self, further: &[Self]) -> bool {
        [FOXGLOVE, DESKTOP].contains(&self.to_string().as_str()) || self.is_loopback() || further.contains(self)
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}://{}", self.scheme, self.host)?;
        self.port.map_or(Ok(()), |port| write!(f, ":{port}"))
    }
}

impl FromStr for Origin {
    type Err = OriginError;

    fn from_str(text: &str) -> Result<Self, OriginError> {
        let refused = || OriginError(text.to_owned());
        let lower = text.to_ascii_lowercase();
        let (scheme, place) = lower.split_once("://").ok_or_else(refused)?;
        let after_host = place.rfind(']').map_or(0, |end| end + 1);
        let (host, port) = match place.get(after_host..).unwrap_or_default().find(':') {
            Some(at) => {
                let (host, port) = place.split_at(after_host + at);
                (
                    host,
                    Some(
                        port[1..]
                            .parse()
                            .ok()
                            .filter(|_| port[1..].bytes().all(|b| b.is_ascii_digit()))
                            .ok_or_else(refused)?,
                    ),
                )
            }
            None => (place, None),
        };
        let is_scheme = scheme.starts_with(|c: char| c.is_ascii_lowercase())
            && scheme.bytes().all(|b| b.is_ascii_alphanumeric() || b"+-.".contains(&b));
        let is_host = match host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            Some(bare) => bare.parse::<Ipv6Addr>().is_ok(),
            // Only a page that is a file has none.
            None if host.is_empty() => scheme == "file" && port.is_none(),
            None => host.bytes().all(|b| b.is_ascii_alphanumeric() || b"-._".contains(&b)),
        };
        let own_port = match scheme {
            "http" | "ws" => Some(80),
            "https" | "wss" => Some(443),
            _ => None,
        };
        if !is_scheme || !is_host {
            return Err(refused());
        }
        Ok(Self { scheme: scheme.to_owned(), host: host.to_owned(), port: port.filter(|_| port != own_port) })
    }
}

#[cfg(all(test, feature = "foxglove"))]
mod tests {
    use super::*;

    fn may_look(text: &str) -> bool {
        text.parse::<Origin>().is_ok_and(|origin| origin.may_look(&[]))
    }

    #[test]
    fn pages_of_foxglove_and_of_this_machine_may_look() {
        for origin in [
            "https://app.foxglove.dev",
            "https://app.foxglove.dev:443",
            "file://",
            "http://localhost",
            "https://localhost:8080",
            "http://LOCALHOST:3000",
            "http://127.0.0.1:5173",
            "https://127.255.0.9",
            "http://[::1]:8080",
        ] {
            assert!(may_look(origin), "{origin}");
        }
    }

    #[test]
    fn pages_from_elsewhere_may_not_whatever_they_look_like() {
        for origin in [
            "https://evil.example",
            "null",
            "",
            " ",
            "http://app.foxglove.dev",
            "https://app.foxglove.dev:8443",
            "https://app.foxglove.dev.evil.example",
            "https://app.foxglove.dev@evil.example",
            "https://foxglove.dev",
            "https://evilapp.foxglove.dev",
            "http://localhost.evil.example",
            "http://localhost@evil.example",
            "http://localhost:80@evil.example",
            "http://localhost/",
            "http://localhost:8080/x",
            "http://localhost:",
            "http://localhost:+80",
            "http://localhost:99999",
            "http://localhost localhost",
            "http://localhost, https://evil.example",
            "http://127.0.0.1.evil.example",
            "http://128.0.0.1",
            "http://0.0.0.0",
            "http://192.168.1.2:8080",
            "http://[::2]:80",
            "http://[::1].evil.example",
            "http://[::1]evil.example:80",
            "http://::1",
            "ftp://localhost",
            "chrome-extension://localhost",
            "file:///etc/passwd",
            "file://evil.example",
            "://localhost",
            "http://",
            "http://lo\u{441}alhost",
        ] {
            assert!(!may_look(origin), "{origin}");
        }
    }

    #[test]
    fn a_further_origin_is_that_origin_and_no_other() {
        let further: Vec<Origin> = vec!["https://Viewer.example:443".parse().unwrap(), "app://x".parse().unwrap()];
        let may = |text: &str| text.parse::<Origin>().unwrap().may_look(&further);
        assert!(may("https://viewer.example") && may("app://x"));
        assert!(
            !may("http://viewer.example") && !may("https://viewer.example:8443") && !may("https://a.viewer.example")
        );
    }

    #[test]
    fn what_is_no_origin_is_refused_with_what_one_is() {
        for text in ["null", "viewer.example", "https://viewer.example/", "https://*", "https://a b", "https://x:y"] {
            let error = text.parse::<Origin>().unwrap_err().to_string();
            assert!(error.contains(text) && error.contains("SCHEME://HOST:PORT"), "{error}");
        }
    }
}
