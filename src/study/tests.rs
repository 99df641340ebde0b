//! The studies: that their laws are certified, and what makes them fast.

use loopbound_shared::law::LawKind;

use super::cases::{Base, Case, variants};
use super::*;

#[test]
fn work_on_all_cores_keeps_the_order_and_does_every_item_once() {
    let items: Vec<u64> = (0..1000).collect();
    assert_eq!(on_all_cores(&items, |x| x * x), items.iter().map(|x| x * x).collect::<Vec<_>>());
    assert_eq!(on_all_cores(&[] as &[u64], |x| *x), [] as [u64; 0]);
}

#[test]
fn an_impossible_number_of_links_is_refused_before_anything_runs() {
    for links in [vec![0], vec![3, 8]] {
        assert!(check_links(&links).is_err(), "{links:?}");
    }
    assert!(check_links(&[1, 7]).is_ok());
}

#[test]
fn every_law_of_the_study_is_certified_without_mismatch_and_keeps_its_bound() {
    let mut base = Base::new::<3>(true).unwrap();
    base.scenario.loop_.duration = cases::nanos(3.0);
    base.scenario.loop_.settle = Some(cases::nanos(2.0));
    let table = paper::table::<3>(&base, &variants(), &[Case::Exact], 0).unwrap();
    for row in &table.rows {
        let m = &row.measured;
        assert!(m.bound.certified, "{}: {:?}", row.law, m.bound.shortfalls);
        assert_eq!(m.verdicts("controller_fault") + m.verdicts("uncertainty_exceeded"), 0, "{}", row.law);
    }
    let of = |law: &str| table.get(Case::Exact, law).unwrap().worst_e_rad();
    // Without a model gravity stays as an error; with an exact one nothing does.
    assert!(of("robust") > 100.0 * of("robust-ff"), "{} {}", of("robust"), of("robust-ff"));
    assert_eq!(variants()[0].law, LawKind::Robust);
}
