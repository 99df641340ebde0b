//! A hash over every field of a record, so that two runs are compared to the last bit and a golden value can be kept.
//!
//! Every field counts but the origin, which says whose run it is and is no result: in lockstep the stamps are virtual and the
//! evidence is not read, so nothing of the wall clock is in a record. A record is plain data without padding, so its bytes are
//! its fields.

use loopbound_shared::layout::{FNV_START, content_of, fnv1a};
use loopbound_shared::sample::TickRecord;

/// The hash of one record.
#[must_use]
pub(crate) fn fingerprint(record: &TickRecord) -> u64 {
    fnv1a(FNV_START, content_of(record))
}

/// The hash of a whole run.
#[must_use]
pub(crate) fn golden(fingerprints: &[u64]) -> u64 {
    fingerprints.iter().fold(FNV_START, |hash, fingerprint| fnv1a(hash, &fingerprint.to_le_bytes()))
}
