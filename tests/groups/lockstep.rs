//! On virtual time a group of processes gives the same records as the same code in one process, to the last bit.

use loopbound::inprocess::InProcess;
use loopbound_model::with_links;
use loopbound_scenario::Scenario;
use loopbound_shared::clock;
use loopbound_shared::ports::Subscriber;
use loopbound_shared::sample::{TickRecord, record_flag};

use crate::fold::{fingerprint, golden};
use crate::harness::{Case, PATIENCE_S, Running};

/// Ticks of a run: fewer than a reader's buffer holds, so that nothing is lost even if the reader sleeps.
const TICKS: usize = 1500;
/// Attempts to be in the group before its first tick.
const ATTEMPTS: usize = 20;

/// `extra` on virtual time for [`TICKS`] ticks.
fn lockstep(extra: &str) -> String {
    format!("{extra}\n[loop]\nmode = \"lockstep\"\nduration = \"{TICKS}ms\"\n")
}

/// The records of a real group, by a subscriber of our own.
fn of_a_group(what: &str, scenario: &str) -> Vec<TickRecord> {
    // Whether the bound held is another test's matter.
    of_a_group_that_ends(what, scenario, &[0, 1, 3])
}

/// The same, of a group that ends with one of these codes.
fn of_a_group_that_ends(what: &str, scenario: &str, codes: &[i32]) -> Vec<TickRecord> {
    for _ in 0..ATTEMPTS {
        let case = Case::new(what);
        let mut running = case.run(scenario, &[]);
        let (node, group) = case.join();
        let subscriber: Subscriber<TickRecord> = node.subscriber(usize::MAX).expect("a subscriber");
        let records = until_the_last(&subscriber, &mut running);
        drop((subscriber, node, group));
        let ended = running.wait();
        assert!(ended.code.is_some_and(|code| codes.contains(&code)), "{what}: {ended:?}");
        case.assert_nothing_left();
        // Whoever joins after the first tick sees a part only; the group starts as soon as it is ready.
        if records.first().is_some_and(|first| first.tick == 0) {
            assert_eq!(records.len(), TICKS, "a record of every tick");
            return records;
        }
    }
    panic!("not once in the group before its first tick");
}

fn until_the_last(subscriber: &Subscriber<TickRecord>, running: &mut Running) -> Vec<TickRecord> {
    let mut records = Vec::with_capacity(TICKS);
    let until_ns = clock::now_ns() + PATIENCE_S * clock::NS_PER_S;
    while records.last().is_none_or(|last: &TickRecord| last.flags & record_flag::LAST == 0) {
        let _ = subscriber.update_connections();
        while let Some(record) = subscriber.take() {
            records.push(record);
        }
        let seen = (records.len(), records.first().map(|r| r.tick), records.last().map(|r| r.tick));
        assert!(clock::now_ns() < until_ns, "no last record after (count, first, last) {seen:?}; {}", running.said());
        clock::sleep_ns(100_000);
    }
    records
}

pub(crate) fn fingerprints_in_one_process(scenario: &str) -> Vec<u64> {
    fn with<const N: usize>(scenario: &Scenario) -> Vec<u64> {
        let mut fingerprints = Vec::new();
        InProcess::<N>::new(scenario).expect("a system").run(|record| fingerprints.push(fingerprint(record)));
        fingerprints
    }
    let scenario = Scenario::from_toml(scenario, "test").expect("a scenario");
    with_links!(scenario.links(), with::<N>(&scenario))
}

/// Asserts that a group and one process agree in every field of every record; returns the run's hash.
#[track_caller]
fn assert_identical(what: &str, scenario: &str) -> u64 {
    let records = of_a_group(what, scenario);
    let group: Vec<u64> = records.iter().map(fingerprint).collect();
    let alone = fingerprints_in_one_process(scenario);
    assert_eq!(group.len(), alone.len());
    if let Some(tick) = (0..group.len()).find(|&k| group[k] != alone[k]) {
        panic!("{what}: the group differs from one process in tick {tick}: {:#?}", records[tick]);
    }
    golden(&group)
}

#[test]
fn a_group_is_bit_identical_to_one_process_for_every_number_of_links() {
    for links in 1..=7 {
        assert_identical(&format!("n{links}"), &lockstep(&format!("[plant]\nlinks = {links}\n")));
    }
}

#[test]
fn two_runs_of_a_group_are_bit_identical() {
    let scenario = lockstep("[[fault]]\nkind = \"drop\"\nprobability = 0.1\n");
    let first: Vec<u64> = of_a_group("twice-a", &scenario).iter().map(fingerprint).collect();
    let second: Vec<u64> = of_a_group("twice-b", &scenario).iter().map(fingerprint).collect();
    assert_eq!(first, second);
}

/// Golden values guard the results across machines, compilers and changes that were meant to change nothing. A change
/// of a law, of the integrator or of a record's fields changes them: then they are taken from this test's own message.
/// Seven links under the default gains run away in tick 21, so their value also guards how the plant stops.
#[test]
fn the_records_of_one_three_and_seven_links_are_those_of_every_other_machine() {
    let found = [1, 3, 7].map(|links| {
        let alone = fingerprints_in_one_process(&lockstep(&format!("[plant]\nlinks = {links}\n")));
        format!("{:016x}", golden(&alone))
    });
    assert_eq!(found, ["8dc8bea60491e644", "2145eb05f60c1353", "c213c5a4864b4bf5"]);
}

#[test]
fn faults_befall_a_group_and_one_process_alike() {
    let faults = [
        ("drop", "[[fault]]\nkind = \"drop\"\nprobability = 0.2\nseed = 5\n"),
        ("nan", "[[fault]]\nkind = \"nan\"\nat = \"100ms\"\nfor = \"300ms\"\nevery = 7\n"),
        ("glitch", "[[fault]]\nkind = \"glitch\"\nat = 40\nvalue_nm = 5\njoint = 2\n"),
        ("hang", "[[fault]]\nkind = \"hang\"\nat = 90\nfor = \"30ms\"\n"),
        ("stale", "[[fault]]\nkind = \"stale-setpoint\"\nat = 50\nfor = 20\n"),
        (
            "delay",
            "[[fault]]\nkind = \"delay\"\ndelay = \"50us\"\ndelay_max = \"2ms\"\ndistribution = \"pareto\"\nshape = 1.2\n",
        ),
    ];
    for (what, fault) in faults {
        assert_identical(what, &lockstep(fault));
        assert_identical(&format!("{what}-standby"), &lockstep(&format!("{fault}\n[controller]\nstandby = 1\n")));
    }
}

#[test]
fn a_killed_active_controller_is_replaced_in_the_same_tick_of_both() {
    let scenario =
        lockstep("[controller]\nstandby = 1\n[[fault]]\nkind = \"kill\"\ntarget = \"controller:1\"\nat = 700\n");
    assert_identical("failover", &scenario);
    let records = of_a_group("failover-again", &scenario);
    assert_eq!(records[699].active, 1);
    assert_eq!(records[700].active, 2, "the standby answers the very tick in which the active one died");
    assert_eq!(records.last().map(|last| last.counters.missed), Some(0));
}

#[test]
fn a_killed_only_controller_leaves_the_plant_to_its_fallback_in_both() {
    let scenario = lockstep("[[fault]]\nkind = \"kill\"\nat = 700\n");
    let case = "alone";
    let records = of_a_group_that_ends(case, &scenario, &[5]);
    let group: Vec<u64> = records.iter().map(fingerprint).collect();
    assert_eq!(group, fingerprints_in_one_process(&scenario));
    assert!(records.last().is_some_and(|last| last.counters.damped + last.counters.stopped > 0), "it brakes by itself");
}

#[test]
fn noise_disturbance_friction_and_the_actuation_delay_are_functions_of_the_tick() {
    let truth = "[plant]\nactuation_delay = \"1700us\"\n[plant.noise]\nq_rad = 1e-4\nv_rad_s = 1e-3\n\
                 [[plant.disturbance]]\nkind = \"sine\"\namplitude_nm = 1\nomega_rad_s = [3, 2, 5]\n";
    assert_identical("truth", &lockstep(truth));
}

#[test]
fn scheduled_swaps_happen_in_the_same_tick_of_both() {
    let swaps = "[[swap]]\nat = \"300ms\"\nlaw = \"robust-ff\"\nblend = \"20ms\"\n[[swap]]\nat = \"800ms\"\nlaw = \"ctc\"\n\
                 [controller.gains]\nshared_v = true\n";
    let scenario = lockstep(swaps);
    assert_identical("swap", &scenario);
    let records = of_a_group("swap-again", &scenario);
    let actives: std::collections::BTreeSet<u32> = records.iter().map(|record| record.active).collect();
    assert!(actives.len() > 1, "nobody but {actives:?} was ever in charge");
}
