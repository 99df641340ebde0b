//! The figures of a tick as a protobuf message that describes itself.
//!
//! One table says which fields there are; the descriptor, which viewers need, and the encoder follow from it. A figure
//! that does not exist is NaN: proto3 would show an absent one as zero, and a plot leaves a gap at NaN.

use loopbound_shared::sample::TickRecord;

use crate::hops::Hop;
use crate::tracker::{Row, accepted};

/// Full name of the message.
pub const MESSAGE: &str = "loopbound.Tick";

/// Type of a field, by its number in `descriptor.proto`.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Double = 1,
    UInt64 = 4,
    /// `repeated double`, one entry a link.
    Doubles = 0,
}

/// The fields before the latencies, of which there is one for each hop, in ns; a field's number is its place, from 1.
const FIELDS: [(&str, Kind); 19] = [
    ("tick", Kind::UInt64),
    ("t_s", Kind::Double),
    ("q_rad", Kind::Doubles),
    ("v_rad_s", Kind::Doubles),
    ("q_d_rad", Kind::Doubles),
    ("v_d_rad_s", Kind::Doubles),
    ("error_rad", Kind::Doubles),
    ("tau_nm", Kind::Doubles),
    ("disturbance_nm", Kind::Doubles),
    ("lyapunov", Kind::Double),
    ("lyapunov_promised", Kind::Double),
    ("lyapunov_level", Kind::Double),
    ("active", Kind::UInt64),
    ("epoch", Kind::UInt64),
    ("decision", Kind::UInt64),
    ("missed", Kind::UInt64),
    ("late", Kind::UInt64),
    ("skipped", Kind::UInt64),
    ("segments", Kind::UInt64),
];

const VARINT: u64 = 0;
const FIXED64: u64 = 1;
const BYTES: u64 = 2;

fn varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value.to_le_bytes()[0] | 0x80);
        value >>= 7;
    }
    out.push(value.to_le_bytes()[0]);
}

fn key(out: &mut Vec<u8>, number: u64, wire: u64) {
    varint(out, number << 3 | wire);
}

fn bytes(out: &mut Vec<u8>, number: u64, value: &[u8]) {
    key(out, number, BYTES);
    varint(out, value.len() as u64);
    out.extend_from_slice(value);
}

/// The message's `FileDescriptorSet`, serialised: what an MCAP schema of the encoding `protobuf` holds.
#[must_use]
pub fn descriptors() -> Vec<u8> {
    const OPTIONAL: u64 = 1;
    const REPEATED: u64 = 3;
    let mut message = Vec::new();
    bytes(&mut message, 1, b"Tick");
    let fields = FIELDS.into_iter().map(|(name, kind)| (name.to_owned(), kind));
    let hops = Hop::ALL.into_iter().map(|hop| (format!("{}_ns", hop.name()), Kind::Double));
    for (number, (name, kind)) in (1..).zip(fields.chain(hops)) {
        let mut field = Vec::new();
        bytes(&mut field, 1, name.as_bytes());
        let repeated = kind == Kind::Doubles;
        let kind = if repeated { Kind::Double } else { kind };
        for (at, value) in [(3, number), (4, if repeated { REPEATED } else { OPTIONAL }), (5, kind as u64)] {
            key(&mut field, at, VARINT);
            varint(&mut field, value);
        }
        bytes(&mut message, 2, &field);
    }
    let mut file = Vec::new();
    bytes(&mut file, 1, b"loopbound/tick.proto");
    bytes(&mut file, 2, b"loopbound");
    bytes(&mut file, 4, &message);
    bytes(&mut file, 12, b"proto3");
    let mut set = Vec::new();
    bytes(&mut set, 1, &file);
    set
}

/// Writes fields in the order of the table.
struct Encoder<'a> {
    out: &'a mut Vec<u8>,
    number: u64,
}

impl Encoder<'_> {
    fn number(&mut self) -> u64 {
        self.number += 1;
        self.number
    }

    fn uint(&mut self, value: u64) {
        let number = self.number();
        key(self.out, number, VARINT);
        varint(self.out, value);
    }

    fn double(&mut self, value: Option<f64>) {
        let number = self.number();
        key(self.out, number, FIXED64);
        self.out.extend_from_slice(&value.unwrap_or(f64::NAN).to_le_bytes());
    }

    fn doubles(&mut self, values: impl ExactSizeIterator<Item = f64>) {
        let number = self.number();
        key(self.out, number, BYTES);
        varint(self.out, 8 * values.len() as u64);
        for value in values {
            self.out.extend_from_slice(&value.to_le_bytes());
        }
    }
}

/// Appends the message of one tick.
pub fn encode(out: &mut Vec<u8>, record: &TickRecord, row: &Row, links: usize) {
    let receipt = accepted(record);
    let mut encoder = Encoder { out, number: 0 };
    encoder.uint(record.tick);
    encoder.double(Some(row.t_s));
    for values in [&row.q, &row.v, &row.q_d, &row.v_d] {
        encoder.doubles(values.iter().take(links).copied());
    }
    encoder.doubles(row.q_d.iter().zip(&row.q).take(links).map(|(wanted, is)| wanted - is));
    for values in [&row.tau, &record.disturbance] {
        encoder.doubles(values.iter().take(links).copied());
    }
    for value in [row.lyapunov, row.lyapunov_bound, row.lyapunov_level] {
        encoder.double(value);
    }
    for value in [record.active, record.epoch, record.decision] {
        encoder.uint(u64::from(value));
    }
    let counters = &record.counters;
    for value in [counters.missed, counters.late, counters.skipped, u64::from(record.segments_used)] {
        encoder.uint(value);
    }
    debug_assert_eq!(encoder.number, FIELDS.len() as u64, "the encoder follows the table");
    for hop in Hop::ALL {
        let stamps = hop.stamps(record, receipt);
        encoder.double(stamps.and_then(|(from_ns, to_ns)| Some(to_ns.checked_sub(from_ns)? as f64)));
    }
}

/// What a message says of V; what does not exist is NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// The tick.
    pub tick: u64,
    /// V.
    pub v: f64,
    /// The right side of promise (a) from the tick before.
    pub promised: f64,
    /// c, the certified level.
    pub level: f64,
}

/// The figures of an encoded message; none if the bytes are no such message.
#[must_use]
pub fn figures(message: &[u8]) -> Option<Figures> {
    let (mut at, mut tick) = (0, None);
    let (mut v, mut promised, mut level) = (None, None, None);
    while at < message.len() {
        let key = read_varint(message, &mut at)?;
        let name = FIELDS.get(usize::try_from(key >> 3).ok()?.checked_sub(1)?).map_or("a latency", |field| field.0);
        match key & 7 {
            VARINT => {
                let value = read_varint(message, &mut at)?;
                tick = if name == "tick" { Some(value) } else { tick };
            }
            FIXED64 => {
                let value = f64::from_le_bytes(message.get(at..at + 8)?.try_into().ok()?);
                at += 8;
                match name {
                    "lyapunov" => v = Some(value),
                    "lyapunov_promised" => promised = Some(value),
                    "lyapunov_level" => level = Some(value),
                    _ => {}
                }
            }
            BYTES => {
                let length = read_varint(message, &mut at)?;
                at = at.checked_add(usize::try_from(length).ok()?)?;
            }
            _ => return None,
        }
    }
    Some(Figures { tick: tick?, v: v?, promised: promised?, level: level? })
}

fn read_varint(bytes: &[u8], at: &mut usize) -> Option<u64> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = *bytes.get(*at)?;
        *at += 1;
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}
