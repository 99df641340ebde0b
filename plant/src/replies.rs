//! The plant's answers to the supervisor's commands.

use loopbound_shared::event::{Refusal, ReplyKind};
use loopbound_shared::sample::Reply;

/// Done in `tick`.
pub(crate) fn done(tick: u64) -> Reply {
    Reply { kind: ReplyKind::Done.code(), tick, ..Reply::zeroed() }
}

/// Under way; `tick` is the one it waits for, 0 if none was named.
pub(crate) fn pending(tick: u64) -> Reply {
    Reply { kind: ReplyKind::Pending.code(), tick, ..Reply::zeroed() }
}

/// Refused, before any tick had to do with it.
pub(crate) fn refused(reason: Refusal) -> Reply {
    Reply { kind: ReplyKind::Refused.code(), reason: reason.code(), ..Reply::zeroed() }
}

/// A swap that was done and was rolled back in `tick`.
pub(crate) fn rolled_back(reason: Refusal, tick: u64) -> Reply {
    Reply { kind: ReplyKind::RolledBack.code(), reason: reason.code(), tick, ..Reply::zeroed() }
}
