//! How many records a second a tracker judges: `cargo run --release -p loopbound-monitor --example tracker_speed`.
//!
//! The records are those of the default scenario (n = 3) in lockstep, computed beforehand, with the bound checked and
//! diagnosed in every tick.

use loopbound_model::integrator::integrate;
use loopbound_model::law::LawKind;
use loopbound_monitor::judge::Judge;
use loopbound_monitor::tracker::{Config, Tracker};
use loopbound_scenario::Scenario;
use loopbound_scenario::system;
use loopbound_shared::clock::now_ns;
use loopbound_shared::event::{Acceptance, Decision};
use loopbound_shared::sample::{Receipt, Segment, TickRecord, to_links};
use loopbound_shared::say;

const TICKS: u64 = 20_000;
const ROUNDS: u32 = 5;

fn records(scenario: &Scenario) -> Result<Vec<TickRecord>, Box<dyn std::error::Error>> {
    let law = system::law::<3>(scenario, LawKind::Robust)?;
    let (truth, trajectory) = (scenario.build_truth::<3>()?, scenario.build_trajectory::<3>()?);
    let mut state = scenario.build_start::<3>()?;
    let period_ns = scenario.period_ns();
    let mut records = Vec::new();
    for tick in 0..TICKS {
        let (from_ns, to_ns) = (tick * period_ns, (tick + 1) * period_ns);
        let x = system::input(&state, &trajectory.at(from_ns as f64 * 1e-9));
        let tau = law.torque(&x);
        let mut record = TickRecord {
            tick,
            deadline_ns: from_ns,
            sampled_ns: from_ns + 500,
            published_ns: from_ns + 900,
            grace_deadline_ns: from_ns + period_ns / 2,
            accepted_ns: from_ns + 9_000,
            start_plant_ns: from_ns,
            end_plant_ns: to_ns,
            decision: Decision::Active.code(),
            active: 1,
            segments_used: 1,
            receipts_used: 1,
            q: to_links(&x.q),
            v: to_links(&x.v),
            q_measured: to_links(&x.q),
            v_measured: to_links(&x.v),
            q_d: to_links(&x.q_d),
            v_d: to_links(&x.v_d),
            a_d: to_links(&x.a_d),
            used_q_d: to_links(&x.q_d),
            used_v_d: to_links(&x.v_d),
            used_a_d: to_links(&x.a_d),
            ..TickRecord::zeroed()
        };
        record.segments[0] = Segment {
            from_plant_ns: from_ns,
            answered_tick: tick,
            writer: 1,
            tau: to_links(&tau),
            ..Segment::zeroed()
        };
        record.receipts[0] = Receipt {
            arrived_ns: from_ns + 9_000,
            state_received_ns: from_ns + 4_000,
            torque_published_ns: from_ns + 5_000,
            setpoint_published_ns: from_ns.saturating_sub(20_000_000).max(1),
            writer: 1,
            acceptance: Acceptance::Applied.code(),
            ..Receipt::zeroed()
        };
        state = integrate(&truth, &state, &tau, from_ns, to_ns, scenario.loop_.max_step.ns());
        records.push(record);
    }
    Ok(records)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let scenario = Scenario::default();
    let records = records(&scenario)?;
    let config = Config::of(&scenario);
    for (name, judged) in [("without the bound", false), ("with the bound", true)] {
        for round in 1..=ROUNDS {
            let judge = if judged { Some(Judge::new(&scenario)?) } else { None };
            let mut tracker = Tracker::<3>::new(config.clone(), judge);
            let from_ns = now_ns();
            for record in &records {
                std::hint::black_box(tracker.feed(record));
            }
            let each_ns = (now_ns() - from_ns) as f64 / TICKS as f64;
            let checked = tracker.summarise().bound.checked;
            say::out!(
                "{name}, round {round}: {each_ns:.0} ns a record, {:.0} records/s, {checked} checked",
                1e9 / each_ns
            );
        }
    }
    Ok(())
}
