//! A plant and a controller in one thread, on paper: records with known answers for the tests.

use loopbound_model::integrator::{PlantState, integrate};
use loopbound_model::law::{Law, LawInput, LawKind};
use loopbound_model::trajectory::Trajectory;
use loopbound_model::truth::Truth;
use loopbound_scenario::Scenario;
use loopbound_scenario::system;
use loopbound_shared::event::{Acceptance, Decision, Role};
use loopbound_shared::sample::{Announce, Receipt, Segment, TickRecord, to_links};

use crate::judge::Judge;
use crate::tracker::{Config, Tracker};

pub(crate) const PERIOD_NS: u64 = 1_000_000;
/// Stamps of the paper loop: wake-up, publishing, the controller's wake-up, computation, the way back.
pub(crate) const WAKEUP_NS: u64 = 2_000;
pub(crate) const PUBLISH_NS: u64 = 500;
pub(crate) const TO_CONTROLLER_NS: u64 = 3_000;
pub(crate) const COMPUTE_NS: u64 = 1_000;
pub(crate) const RETURN_NS: u64 = 4_000;
pub(crate) const LEAD_NS: u64 = 20_000_000;
const START_NS: u64 = 1_000_000_000_000;

pub(crate) fn config() -> Config {
    Config {
        period_ns: PERIOD_NS,
        late_ns: 500_000,
        settle_ns: 0,
        start_up_ns: 0,
        finalise_ns: 50_000_000,
        lockstep: false,
        speed_limit_rad_s: 100.0,
        scheduled_swaps: Vec::new(),
        rollback_ticks: 50,
        planned: crate::late::Planned::default(),
    }
}

pub(crate) fn tracker() -> Tracker<3> {
    Tracker::new(config(), None)
}

pub(crate) fn judged_tracker(scenario: &Scenario) -> Tracker<3> {
    Tracker::new(config(), Some(Judge::new(scenario).unwrap()))
}

/// A record of a tick in which all went well, standing still.
pub(crate) fn good(tick: u64) -> TickRecord {
    let deadline_ns = START_NS + tick * PERIOD_NS;
    let mut record = TickRecord {
        tick,
        deadline_ns,
        sampled_ns: deadline_ns + WAKEUP_NS,
        published_ns: deadline_ns + WAKEUP_NS + PUBLISH_NS,
        grace_deadline_ns: deadline_ns + PERIOD_NS / 2,
        end_ns: deadline_ns + PERIOD_NS + WAKEUP_NS,
        start_plant_ns: tick * PERIOD_NS,
        end_plant_ns: (tick + 1) * PERIOD_NS,
        setpoint_tick: tick,
        decision: Decision::Active.code(),
        active: 1,
        epoch: 1,
        links: 3,
        segments_used: 1,
        receipts_used: 1,
        ..TickRecord::zeroed()
    };
    let received_ns = record.published_ns + TO_CONTROLLER_NS;
    record.receipts[0] = Receipt {
        arrived_ns: received_ns + COMPUTE_NS + RETURN_NS,
        state_received_ns: received_ns,
        torque_published_ns: received_ns + COMPUTE_NS,
        setpoint_published_ns: record.sampled_ns - LEAD_NS,
        setpoint_tick: tick,
        writer: 1,
        epoch: 1,
        acceptance: Acceptance::Applied.code(),
        ..Receipt::zeroed()
    };
    record.accepted_ns = record.receipts[0].arrived_ns;
    record.segments[0] =
        Segment { from_plant_ns: record.start_plant_ns, answered_tick: tick, writer: 1, ..Segment::zeroed() };
    record.counters.ticks = tick + 1;
    record
}

/// A record in which nothing came from the controller.
pub(crate) fn unanswered(tick: u64) -> TickRecord {
    let mut record = good(tick);
    record.receipts[0] = Receipt { writer: 1, epoch: 1, ..Receipt::zeroed() };
    record.accepted_ns = 0;
    record.decision = Decision::Held.code();
    record
}

pub(crate) fn controller(id: u32, law: LawKind, gains: &Law<3>) -> Announce {
    Announce {
        role: Role::Controller.code(),
        id,
        law: u32::try_from(law as usize + 1).unwrap(),
        beta: gains.beta,
        k_t: gains.k_t,
        k_p: gains.k_p,
        k_d: gains.k_d,
        ..Announce::zeroed()
    }
}

/// A closed loop in lockstep: the records that a plant would publish.
pub(crate) struct Loop {
    pub(crate) law: Law<3>,
    pub(crate) truth: Truth<3>,
    pub(crate) state: PlantState<3>,
    trajectory: Trajectory<3>,
    pub(crate) period_ns: u64,
    pub(crate) tick: u64,
    /// The torque that acts is this times the law's.
    pub(crate) factor: f64,
}

impl Loop {
    pub(crate) fn new(scenario: &Scenario, kind: LawKind) -> Self {
        Self {
            law: system::law(scenario, kind).unwrap(),
            truth: scenario.build_truth().unwrap(),
            state: scenario.build_start().unwrap(),
            trajectory: scenario.build_trajectory().unwrap(),
            period_ns: scenario.period_ns(),
            tick: 0,
            factor: 1.0,
        }
    }

    pub(crate) fn next(&mut self) -> TickRecord {
        let (from_ns, to_ns) = (self.tick * self.period_ns, (self.tick + 1) * self.period_ns);
        let setpoint = self.trajectory.at(from_ns as f64 * 1e-9);
        let x: LawInput<3> = system::input(&self.state, &setpoint);
        let tau = self.law.torque(&x) * self.factor;
        let mut record = good(self.tick);
        (record.start_plant_ns, record.end_plant_ns) = (from_ns, to_ns);
        (record.q, record.v) = (to_links(&x.q), to_links(&x.v));
        (record.q_measured, record.v_measured) = (record.q, record.v);
        (record.q_d, record.v_d, record.a_d) = (to_links(&x.q_d), to_links(&x.v_d), to_links(&x.a_d));
        (record.used_q_d, record.used_v_d, record.used_a_d) = (record.q_d, record.v_d, record.a_d);
        record.segments[0].from_plant_ns = from_ns;
        record.segments[0].tau = to_links(&tau);
        self.state = integrate(&self.truth, &self.state, &tau, from_ns, to_ns, 1_000_000);
        self.tick += 1;
        record
    }
}
