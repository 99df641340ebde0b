//! The head of a client's request, read as narrowly as possible: only whether it may pass to the server.
//!
//! What the server behind would read in another way must not pass: so whatever is no plain request is refused here.

use loopbound_model::quote;

use super::origin::Origin;

/// No viewer's request is longer.
pub(super) const HEAD_MAX: usize = 8 * 1024;

/// What becomes of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Ruling {
    /// More of it has to come.
    Wait,
    /// It may go to the server.
    Pass,
    /// It gets this answer.
    Refuse(Refusal),
}

/// Why a request gets no further.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Refusal {
    /// A page that may not look.
    #[error("a page of {} may not look at this run: `--foxglove-origin ORIGIN` allows an origin besides Foxglove's own and those of this machine", quote::text(.0))]
    Origin(String),
    /// Not what a viewer sends.
    #[error("no request of a viewer: a WebSocket for Foxglove is served here")]
    Malformed,
    /// It goes on for too long.
    #[error("the head of the request is longer than {HEAD_MAX} bytes")]
    TooLong,
    /// It did not come in time.
    #[error("the head of the request took too long")]
    TooSlow,
    /// There is no place, or the run has ended.
    #[error("no further viewer can be served")]
    NoPlace,
}

impl Refusal {
    const fn status(&self) -> &'static str {
        match self {
            Self::Origin(_) => "403 Forbidden",
            Self::Malformed => "400 Bad Request",
            Self::TooLong => "431 Request Header Fields Too Large",
            Self::TooSlow => "408 Request Timeout",
            Self::NoPlace => "503 Service Unavailable",
        }
    }

    /// The whole answer.
    pub(super) fn answer(&self) -> Vec<u8> {
        let (status, body) = (self.status(), format!("loopbound: {self}\n"));
        let kind = "Content-Type: text/plain; charset=utf-8";
        format!("HTTP/1.1 {status}\r\n{kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{body}", body.len())
            .into()
    }
}

/// Rules on what has come so far.
pub(super) fn rule(bytes: &[u8], further: &[Origin]) -> Ruling {
    let looked_at = bytes.get(..HEAD_MAX).unwrap_or(bytes);
    match head(looked_at) {
        Some(lines) => judge(&lines, further).map_or_else(Ruling::Refuse, |()| Ruling::Pass),
        None if bytes.len() < HEAD_MAX => Ruling::Wait,
        None => Ruling::Refuse(Refusal::TooLong),
    }
}

/// The lines up to the empty one; none if that has not come yet.
fn head(bytes: &[u8]) -> Option<Vec<&[u8]>> {
    let mut lines = Vec::new();
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        let line = line.strip_suffix(b"\n")?;
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        if line.is_empty() {
            return Some(lines);
        }
        lines.push(line);
    }
    None
}

fn judge(lines: &[&[u8]], further: &[Origin]) -> Result<(), Refusal> {
    let (first, fields) = lines.split_first().ok_or(Refusal::Malformed)?;
    if !first.starts_with(b"GET /") || !first.ends_with(b" HTTP/1.1") {
        return Err(Refusal::Malformed);
    }
    let mut origin = None;
    for field in fields {
        let (name, value) = field.split_at(field.iter().position(|byte| *byte == b':').ok_or(Refusal::Malformed)?);
        if name.is_empty() || !name.iter().all(|byte| is_of_a_name(*byte)) {
            return Err(Refusal::Malformed);
        }
        if name.eq_ignore_ascii_case(b"origin") && origin.replace(&value[1..]).is_some() {
            return Err(Refusal::Malformed);
        }
    }
    // Only browsers say where the page is from, and all of them do.
    let Some(origin) = origin else { return Ok(()) };
    let named = String::from_utf8_lossy(origin.trim_ascii()).into_owned();
    let may = named.parse::<Origin>().is_ok_and(|origin| origin.may_look(further));
    if may { Ok(()) } else { Err(Refusal::Origin(named)) }
}

/// A `token` of RFC 9110.
fn is_of_a_name(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || b"!#$%&'*+-.^_`|~".contains(&byte)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Ruling {
        rule(text.as_bytes(), &[])
    }

    fn with(field: &str) -> Ruling {
        of(&format!("GET / HTTP/1.1\r\nHost: 127.0.0.1:8765\r\n{field}\r\nUpgrade: websocket\r\n\r\n"))
    }

    #[test]
    fn a_request_passes_without_an_origin_and_with_one_that_may_look() {
        assert_eq!(of("GET / HTTP/1.1\r\n\r\n"), Ruling::Pass);
        for field in ["X: y", "Origin: http://localhost:8080", "ORIGIN:https://app.foxglove.dev  ", "origin:\tfile://"]
        {
            assert_eq!(with(field), Ruling::Pass, "{field}");
        }
        assert_eq!(of("GET / HTTP/1.1\nOrigin: http://localhost\n\nmore"), Ruling::Pass);
    }

    #[test]
    fn a_foreign_origin_is_refused_however_it_is_written() {
        for (field, named) in [
            ("Origin: https://evil.example", "https://evil.example"),
            ("oRIGIN:https://evil.example", "https://evil.example"),
            ("Origin:\t https://evil.example\t", "https://evil.example"),
            ("Origin: null", "null"),
            ("Origin:", ""),
            ("Origin: http://localhost https://evil.example", "http://localhost https://evil.example"),
        ] {
            assert_eq!(with(field), Ruling::Refuse(Refusal::Origin(named.into())), "{field}");
        }
        let bare = "GET / HTTP/1.1\nOrigin: https://evil.example\n\n";
        assert_eq!(of(bare), Ruling::Refuse(Refusal::Origin("https://evil.example".into())));
    }

    #[test]
    fn what_could_be_read_in_two_ways_is_refused() {
        for field in [
            "Origin: http://localhost\r\nOrigin: https://evil.example",
            "Origin : https://evil.example",
            " Origin: https://evil.example",
            "X: y\r\n Origin: https://evil.example",
            "Or\0igin: https://evil.example",
            "no field",
            ": nothing",
        ] {
            assert_eq!(with(field), Ruling::Refuse(Refusal::Malformed), "{field:?}");
        }
        for first in
            ["", "POST / HTTP/1.1", "GET / HTTP/1.0", "GET http://x/ HTTP/1.1", "\u{16}\u{3}\u{1}", "PRI * HTTP/2.0"]
        {
            assert_eq!(of(&format!("{first}\r\nHost: x\r\n\r\n")), Ruling::Refuse(Refusal::Malformed), "{first:?}");
        }
    }

    #[test]
    fn an_unfinished_head_is_waited_for_until_it_is_too_long() {
        for text in ["", "G", "GET / HTTP/1.1\r\n", "GET / HTTP/1.1\r\nOrigin: https://evil.example\r\n"] {
            assert_eq!(of(text), Ruling::Wait, "{text:?}");
        }
        let endless = format!("GET / HTTP/1.1\r\nX: {}", "y".repeat(HEAD_MAX));
        assert_eq!(of(&endless), Ruling::Refuse(Refusal::TooLong));
        // Its end may not hide beyond what is looked at.
        assert_eq!(of(&format!("{endless}\r\n\r\n")), Ruling::Refuse(Refusal::TooLong));
    }

    #[test]
    fn an_answer_quotes_nothing_raw() {
        let answer = String::from_utf8(Refusal::Origin("\u{1b}[2J\r\nX: y".into()).answer()).unwrap();
        assert!(answer.starts_with("HTTP/1.1 403 Forbidden\r\n") && answer.contains("\r\n\r\nloopbound: "), "{answer}");
        assert!(!answer.contains('\u{1b}') && !answer.contains("\r\nX: y"), "{answer}");
    }
}
