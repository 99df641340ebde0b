//! Whether the loop ran away: what the plant says of it, what a record shows, and V.
//!
//! Responsible for the first tick and the quantity; the rule itself is `shared`'s `runaway`. The plant stops a loop by its
//! state alone; V is looked at here, and so are the states of recordings by versions whose plant did not stop.

use loopbound_shared::event::{HappeningKind, RunawayKind};
use loopbound_shared::runaway::{self, Runaway};
use loopbound_shared::sample::{TickRecord, record_flag, to_vector};

use crate::summary::{DivergedSummary, finite};
use crate::tracker::happenings;

/// Watches for the first tick in which the loop ran away.
#[derive(Debug)]
pub struct Divergence {
    speed_limit_rad_s: f64,
    first: Option<(u64, u64, Runaway)>,
}

impl Divergence {
    /// Nothing seen yet. `speed_limit_rad_s`: of a joint.
    #[must_use]
    pub fn new(speed_limit_rad_s: f64) -> Self {
        Self { speed_limit_rad_s, first: None }
    }

    /// Takes the next record, and what the judge found of V in it.
    pub fn feed<const N: usize>(&mut self, record: &TickRecord, of_v: Option<Runaway>) {
        if self.first.is_some() {
            return;
        }
        let found = self.told(record).or_else(|| {
            let (q, v) = (to_vector::<N>(&record.q), to_vector::<N>(&record.v));
            runaway::of_state(&q, &v, self.speed_limit_rad_s)
        });
        self.first = found.or(of_v).map(|found| (record.tick, record.start_plant_ns, found));
    }

    /// What the plant says; a monitor that joined later finds the mark alone.
    fn told(&self, record: &TickRecord) -> Option<Runaway> {
        if record.flags & record_flag::DIVERGED == 0 {
            return None;
        }
        let said = happenings(record).iter().find(|happening| happening.kind == HappeningKind::Diverged.code());
        let unknown = Runaway { kind: RunawayKind::Speed, joint: 0, value: f64::NAN, limit: self.speed_limit_rad_s };
        Some(said.map_or(unknown, |said| {
            let kind = u32::try_from(said.detail).ok().and_then(RunawayKind::from_code).unwrap_or(RunawayKind::Speed);
            let (value, limit) = match kind {
                RunawayKind::Speed => (said.value, self.speed_limit_rad_s),
                _ => (f64::NAN, f64::INFINITY),
            };
            Runaway { kind, joint: said.subject, value, limit }
        }))
    }

    /// For the summary; none if the loop did not run away.
    #[must_use]
    pub fn summary(&self) -> Option<DivergedSummary> {
        let (tick, plant_ns, found) = self.first?;
        let words = if found.kind == RunawayKind::Speed && found.value.is_nan() {
            "the plant had stopped it before this monitor came".to_owned()
        } else {
            found.to_string()
        };
        Some(DivergedSummary {
            tick,
            t_s: plant_ns as f64 * 1e-9,
            quantity: found.kind.name().to_owned(),
            joint: (found.joint > 0).then_some(found.joint),
            value: finite(found.value),
            limit: finite(found.limit),
            words,
        })
    }
}
