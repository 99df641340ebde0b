//! A viewer of the Foxglove WebSocket protocol comes to a running group: another implementation of WebSocket, and a
//! decoder that knows nothing but the schema that it was sent.

use std::collections::BTreeMap;
use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use loopbound_monitor::recording::channels::Channel;
use rustix::process::Signal;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest as _;
use tungstenite::{HandshakeError, Message, WebSocket};

use crate::harness::{Case, PATIENCE_S, Running, wait_until};

/// The protocol's number for a message of a subscription.
const MESSAGE_DATA: u8 = 1;

/// A viewer, connected.
struct Viewer {
    socket: WebSocket<TcpStream>,
    /// What was advertised, by topic.
    channels: BTreeMap<String, Value>,
}

/// A connection to the server.
fn call(port: u16) -> TcpStream {
    let stream = TcpStream::connect(("127.0.0.1", port)).expect("the server is there");
    stream.set_read_timeout(Some(Duration::from_secs(PATIENCE_S))).expect("a time limit");
    stream
}

/// What the server answers to bytes that are no handshake of a viewer.
fn answer(port: u16, bytes: &str) -> String {
    let mut stream = call(port);
    // It may have answered and closed before it has got everything.
    let _ = stream.write_all(bytes.as_bytes());
    let mut text = String::new();
    stream.read_to_string(&mut text).expect("an answer");
    text
}

/// The handshake of a viewer that says which page it is a part of; the status and the words of a refusal.
fn shake(port: u16, origin: Option<&str>) -> Result<WebSocket<TcpStream>, (u16, String)> {
    let mut request = format!("ws://127.0.0.1:{port}").into_client_request().expect("a request");
    request.headers_mut().insert("Sec-WebSocket-Protocol", "foxglove.sdk.v1".parse().expect("a header"));
    if let Some(origin) = origin {
        request.headers_mut().insert("Origin", origin.parse().expect("a header"));
    }
    match tungstenite::client::client(request, call(port)) {
        Ok((socket, answer)) => {
            assert_eq!(answer.headers()["Sec-WebSocket-Protocol"], "foxglove.sdk.v1");
            Ok(socket)
        }
        Err(HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
            let body = answer.body().clone().unwrap_or_default();
            Err((answer.status().as_u16(), String::from_utf8(body).expect("text")))
        }
        Err(error) => panic!("{error}"),
    }
}

impl Viewer {
    fn connect(port: u16) -> Self {
        let socket = shake(port, None).expect("a handshake");
        let mut viewer = Self { socket, channels: BTreeMap::new() };
        while viewer.channels.len() < Channel::SHOWN.len() {
            viewer.next();
        }
        viewer
    }

    fn subscribe(&mut self, id: u32, channel: Channel) {
        let channel_id = &self.channels[channel.topic()]["id"];
        let subscription = json!({"op": "subscribe", "subscriptions": [{"id": id, "channelId": channel_id}]});
        self.socket.send(Message::text(subscription.to_string())).expect("a subscription");
    }

    /// The next message of a subscription with its number and time; none if it was something else, or the end.
    fn next(&mut self) -> Option<(u32, u64, Vec<u8>)> {
        match self.socket.read().ok()? {
            Message::Text(text) => {
                let message: Value = serde_json::from_str(&text).expect("JSON");
                for channel in message["channels"].as_array().into_iter().flatten() {
                    let topic = channel["topic"].as_str().expect("a topic").to_owned();
                    self.channels.insert(topic, channel.clone());
                }
                None
            }
            Message::Binary(bytes) if bytes[0] == MESSAGE_DATA => {
                let id = u32::from_le_bytes(bytes[1..5].try_into().expect("four bytes"));
                let time_ns = u64::from_le_bytes(bytes[5..13].try_into().expect("eight bytes"));
                Some((id, time_ns, bytes[13..].to_vec()))
            }
            _ => None,
        }
    }

    fn next_of(&mut self, wanted: u32) -> (u64, Vec<u8>) {
        for _ in 0..10_000 {
            if let Some((id, time_ns, data)) = self.next()
                && id == wanted
            {
                return (time_ns, data);
            }
        }
        panic!("no message of subscription {wanted}");
    }
}

/// A field on the wire: its number, and a number as its bits or a stretch of bytes.
enum Wire<'a> {
    Number(u64),
    Bytes(&'a [u8]),
}

fn wire_fields(mut bytes: &[u8]) -> Vec<(u64, Wire<'_>)> {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = bytes[0];
            *bytes = &bytes[1..];
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                break;
            }
        }
        value
    }
    let mut fields = Vec::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let length = match key & 7 {
            0 => {
                fields.push((key >> 3, Wire::Number(varint(&mut bytes))));
                continue;
            }
            1 => 8,
            2 => usize::try_from(varint(&mut bytes)).expect("a length"),
            other => panic!("wire type {other}"),
        };
        let (value, rest) = bytes.split_at(length);
        bytes = rest;
        let number = || Wire::Number(u64::from_le_bytes(value.try_into().expect("eight bytes")));
        fields.push((key >> 3, if key & 7 == 1 { number() } else { Wire::Bytes(value) }));
    }
    fields
}

/// Name and type of each field of the one message in a `FileDescriptorSet`, by the numbers of `descriptor.proto`.
fn described(set: &[u8]) -> BTreeMap<u64, (String, u64)> {
    fn within(bytes: &[u8], number: u64) -> Vec<&[u8]> {
        let found = wire_fields(bytes).into_iter().filter(|(at, _)| *at == number);
        found.filter_map(|(_, value)| if let Wire::Bytes(bytes) = value { Some(bytes) } else { None }).collect()
    }
    let message = within(within(set, 1)[0], 4)[0];
    let fields = within(message, 2).into_iter().map(|field| {
        let number = |wanted: u64| {
            let found = wire_fields(field).into_iter().find(|(at, _)| *at == wanted);
            if let Some((_, Wire::Number(value))) = found { value } else { panic!("no number {wanted}") }
        };
        let name = String::from_utf8(within(field, 1)[0].to_vec()).expect("a name");
        (number(3), (name, number(5)))
    });
    fields.collect()
}

/// A message by its schema: each figure by name, a list for what is repeated.
fn decode(message: &[u8], schema: &BTreeMap<u64, (String, u64)>) -> BTreeMap<String, Vec<f64>> {
    const DOUBLE: u64 = 1;
    let figures = wire_fields(message).into_iter().map(|(number, value)| {
        let (name, kind) = &schema[&number];
        let values = match value {
            Wire::Number(bits) if *kind == DOUBLE => vec![f64::from_bits(bits)],
            Wire::Number(value) => vec![value as f64],
            Wire::Bytes(bytes) => {
                bytes.chunks(8).map(|chunk| f64::from_le_bytes(chunk.try_into().expect("a double"))).collect()
            }
        };
        (name.clone(), values)
    });
    figures.collect()
}

fn base64(text: &str) -> Vec<u8> {
    let digit = |byte: u8| match byte {
        b'A'..=b'Z' => byte - b'A',
        b'a'..=b'z' => byte - b'a' + 26,
        b'0'..=b'9' => byte - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u32> = text.bytes().filter(|byte| *byte != b'=').map(|byte| u32::from(digit(byte))).collect();
    let whole = digits.chunks(4).flat_map(|four| {
        let bits = four.iter().fold(0, |bits, digit| bits << 6 | digit) << (6 * (4 - four.len()));
        bits.to_be_bytes()[1..four.len()].to_vec()
    });
    whole.collect()
}

/// The port that the server says it has.
fn port_of(running: &mut Running) -> u16 {
    let mut port = None;
    wait_until("the server says where it is", || {
        let said = running.said();
        let after = said.split("ws://127.0.0.1:").nth(1);
        let digits: Option<String> = after.map(|rest| rest.chars().take_while(char::is_ascii_digit).collect());
        port = digits.filter(|_| said.ends_with('\n')).and_then(|digits| digits.parse().ok());
        port.is_some()
    });
    port.expect("a port")
}

#[test]
fn a_viewer_is_shown_the_recordings_topics_and_ticks_that_their_own_schema_explains() {
    let case = Case::new("live");
    let mut running = case.run("[loop]\nduration = \"3s\"\n", &[]);
    running.wait_until_active();
    let mut server = case.start(&["monitor", "--group", &case.group, "--json", "--foxglove", "127.0.0.1:0"]);
    let port = port_of(&mut server);
    // One that leaves without a word, and one that stays and never reads.
    drop(Viewer::connect(port));
    let mut stalled = Viewer::connect(port);
    stalled.subscribe(1, Channel::Ticks);
    let mut viewer = Viewer::connect(port);
    for channel in Channel::SHOWN {
        let (advertised, schema) = (&viewer.channels[channel.topic()], channel.schema());
        assert_eq!(advertised["encoding"], channel.encoding());
        assert_eq!(
            (&advertised["schemaName"], &advertised["schemaEncoding"]),
            (&json!(schema.name), &json!(schema.encoding))
        );
    }
    assert_eq!(viewer.channels.len(), Channel::SHOWN.len(), "what no viewer can read is not offered");
    let schema = viewer.channels[Channel::Ticks.topic()]["schema"].as_str().expect("a schema").to_owned();
    let schema = described(&base64(&schema));
    viewer.subscribe(7, Channel::Ticks);
    viewer.subscribe(8, Channel::Scene);
    let mut last = (0, 0.0);
    for at in 0..200 {
        let (time_ns, message) = viewer.next_of(7);
        let figures = decode(&message, &schema);
        assert_eq!(figures.len(), schema.len(), "every figure is there");
        let tick = figures["tick"][0];
        assert!(at == 0 || (tick > last.1 && time_ns > last.0), "tick {tick} after {}", last.1);
        assert!((figures["t_s"][0] - tick * 1e-3).abs() < 0.1, "tick {tick} at {} s", figures["t_s"][0]);
        assert_eq!(figures["q_rad"].len(), 3);
        assert!(figures["lyapunov"][0] >= 0.0 && figures["lyapunov_level"][0] > 0.0, "{figures:?}");
        let errors = figures["q_d_rad"].iter().zip(&figures["q_rad"]).map(|(wanted, is)| wanted - is);
        assert!(errors.zip(&figures["error_rad"]).all(|(error, told)| error.to_bits() == told.to_bits()));
        last = (time_ns, tick);
    }
    let (_, scene) = viewer.next_of(8);
    let scene: Value = serde_json::from_slice(&scene).expect("JSON");
    assert_eq!(scene["entities"][1]["id"], "chain");
    let seen = server.wait().json_with(0);
    assert_eq!(seen["ended"], "last record", "a viewer that hangs does not keep the monitor");
    assert_eq!(running.wait().json()["supervision"]["end"], "done");
    drop(stalled);
    case.assert_nothing_left();
}

#[test]
fn a_run_serves_itself_and_its_server_leaves_with_it() {
    let case = Case::new("live-run");
    let mut running = case.run("[loop]\nduration = \"2s\"\n", &["--foxglove", "127.0.0.1:0"]);
    let mut viewer = Viewer::connect(port_of(&mut running));
    viewer.subscribe(1, Channel::Events);
    viewer.subscribe(2, Channel::Ticks);
    viewer.next_of(2);
    running.signal(Signal::INT);
    while viewer.socket.can_read() && viewer.next().is_some() {}
    assert_eq!(running.wait().code, Some(130));
    case.assert_nothing_left();
}

#[test]
fn only_pages_of_foxglove_of_this_machine_and_those_that_were_allowed_may_look() {
    let case = Case::new("live-origin");
    let allowed = ["--foxglove", "127.0.0.1:0", "--foxglove-origin", "https://viewer.example"];
    let mut running = case.run("[loop]\nduration = \"60s\"\n", &allowed);
    let port = port_of(&mut running);
    for origin in [
        None,
        Some("https://app.foxglove.dev"),
        Some("file://"),
        Some("http://localhost:8080"),
        Some("https://127.0.0.1"),
        Some("http://[::1]:3000"),
        Some("https://viewer.example"),
    ] {
        let mut socket = shake(port, origin).unwrap_or_else(|refusal| panic!("{origin:?}: {refusal:?}"));
        assert!(socket.read().is_ok_and(|message| message.is_text()), "{origin:?}");
    }
    for origin in ["https://evil.example", "null", "http://viewer.example", "http://localhost.evil.example", "x"] {
        let (status, words) = shake(port, Some(origin)).err().unwrap_or_else(|| panic!("{origin} may look"));
        assert!(status == 403 && words.contains(origin) && words.contains("--foxglove-origin"), "{origin}: {words}");
    }
    let said = running.said();
    assert_eq!(said.matches("may not look at this run").count(), 1, "said once: {said}");
    let fields = "Host: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n";
    let twice = "Origin: http://localhost\r\nOrigin: https://evil.example\r\n";
    assert!(answer(port, &format!("GET / HTTP/1.1\r\n{fields}{twice}\r\n")).starts_with("HTTP/1.1 400 "));
    assert!(answer(port, "\u{16}\u{3}\u{1} not HTTP\r\n\r\n").starts_with("HTTP/1.1 400 "));
    let endless = "y".repeat(20_000);
    assert!(answer(port, &format!("GET / HTTP/1.1\r\nX: {endless}")).starts_with("HTTP/1.1 431 "));
    running.signal(Signal::INT);
    assert_eq!(running.wait().code, Some(130));
    case.assert_nothing_left();
}

#[test]
fn clients_that_stall_flood_or_come_at_the_end_keep_nobody() {
    let case = Case::new("live-flood");
    let mut running = case.run("[loop]\nduration = \"60s\"\n", &["--foxglove", "127.0.0.1:0"]);
    let port = port_of(&mut running);
    let mut half = call(port);
    half.write_all(b"GET / HTTP/1.1\r\nUpgrade: webso").expect("half a request");
    let _idle: Vec<TcpStream> = (0..200).map(|_| call(port)).collect();
    let mut viewer = Viewer::connect(port);
    viewer.subscribe(1, Channel::Ticks);
    viewer.next_of(1);
    let coming = std::thread::spawn(move || {
        // Until nobody listens any more.
        while let Ok(mut stream) = TcpStream::connect(("127.0.0.1", port)) {
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nUpgrade: websocket\r\n");
        }
    });
    running.signal(Signal::INT);
    assert_eq!(running.wait().code, Some(130));
    coming.join().expect("the server has ended");
    case.assert_nothing_left();
}

#[test]
fn an_address_that_can_not_be_had_is_refused_before_anything_starts() {
    let case = Case::apart("live-refused");
    let taken = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = taken.local_addr().expect("its address").to_string();
    for (arguments, names) in [
        (["run", "--foxglove", &address], ["in use", &address]),
        (["run", "--foxglove", "ws://here"], ["--foxglove", "HOST:PORT"]),
        (["run", "--foxglove", "70000"], ["--foxglove", "70000"]),
        (["run", "--foxglove=0", "--foxglove-origin=viewer.example"], ["viewer.example", "SCHEME://HOST:PORT"]),
    ] {
        let ended = case.output(&arguments);
        assert_eq!((ended.code, ended.out.as_str()), (Some(2), ""), "{ended:?}");
        assert!(names.iter().all(|name| ended.err.contains(name)), "{ended:?}");
    }
    let ended = case.output(&["monitor", "--group", "nobody", "--foxglove", "0"]);
    assert!(ended.code == Some(2) && ended.err.contains("nobody"), "{ended:?}");
    case.assert_nothing_left();
}
