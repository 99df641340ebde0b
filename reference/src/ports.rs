//! The ports of the reference, and how it publishes ahead of the plant.

use std::sync::atomic::Ordering;

use loopbound_shared::ports::Publisher;
use loopbound_shared::role::{Joined, RoleError};
use loopbound_shared::sample::{Announce, Setpoint};

use crate::Generator;

/// The ports of the reference. They are dropped before what they were opened from; the hold on the group last.
pub(crate) struct Ports {
    pub(crate) setpoints: Publisher<Setpoint>,
    pub(crate) announce: Publisher<Announce>,
    pub(crate) joined: Joined,
}

impl Ports {
    pub(crate) fn open(joined: Joined) -> Result<Self, RoleError> {
        Ok(Self { setpoints: joined.node.publisher()?, announce: joined.node.publisher()?, joined })
    }

    /// The tick that the plant is in.
    pub(crate) fn plant_tick(&self) -> u64 {
        self.joined.block.pace().plant_tick.load(Ordering::Relaxed)
    }

    /// Delivers the history to whoever has joined since.
    pub(crate) fn update_connections(&self) {
        // Every field is named, so that no port can be forgotten.
        let Self { setpoints, announce, joined: _ } = self;
        // What can't be mapped now belongs to a process that is just dying; the next look finds it gone.
        let _ = (setpoints.update_connections(), announce.update_connections());
    }
}

/// The setpoints that are published ahead of the plant.
pub(crate) struct Ahead<const N: usize> {
    generator: Generator<N>,
    lead_ticks: u64,
    /// The next tick to be published.
    next: u64,
}

impl<const N: usize> Ahead<N> {
    /// A reference that is started again goes on where the plant is.
    pub(crate) fn new(generator: Generator<N>, lead_ticks: u64, ports: &Ports) -> Self {
        Self { generator, lead_ticks, next: ports.plant_tick() }
    }

    /// Publishes what is missing of the lead, stamped by `now_ns`; whether that was anything.
    pub(crate) fn publish(&mut self, ports: &Ports, now_ns: impl Fn() -> u64) -> bool {
        let plant_tick = ports.plant_tick();
        let end = plant_tick + self.lead_ticks;
        // After a long stall of this process, what is past helps nobody.
        self.next = self.next.max(plant_tick);
        let any = self.next < end;
        while self.next < end {
            let Self { generator, next: tick, .. } = self;
            let faults = generator.injector.at_tick(*tick);
            generator.injector.take_time(&faults);
            let setpoint = generator.setpoint(*tick, &faults, now_ns());
            generator.injector.publish(setpoint, &faults, |setpoint| {
                ports.setpoints.send(setpoint);
            });
            *tick += 1;
        }
        any
    }
}
