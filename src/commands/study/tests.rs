//! The studies: their table against a golden one, and what makes them fast.

use loopbound_model::law::LawKind;

use super::cases::{Base, Case, Variant, variants};
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

/// How far a cell may be from the golden one. The runs are bit-identical between machines; this allows for changes that
/// are meant and don't matter, such as another order of a sum.
const TOLERANCE: f64 = 1e-4;

/// The golden table is that of `loopbound study paper --quick`; its rows are independent, so a few stand for all.
#[test]
fn rows_of_the_quick_table_are_the_golden_ones() {
    let base = Base::new::<3>(true).unwrap();
    let laws: Vec<Variant> =
        variants().into_iter().filter(|v| v.law != LawKind::PdG && v.name != "ctc 100/20").collect();
    let table = paper::table::<3>(&base, &laws, &[Case::Mass(0.2), Case::Noise], 0).unwrap();
    let golden = include_str!("../../../tests/golden/study_paper.csv");
    let found = table.to_csv();
    assert_eq!(found.lines().next(), golden.lines().next());
    assert_eq!(golden.lines().count(), 1 + Case::ALL.len() * variants().len());
    for found in found.lines().skip(1) {
        let cells: Vec<&str> = found.split(',').collect();
        let same = |line: &&str| line.split(',').take(2).eq(cells.iter().copied().take(2));
        let golden = golden.lines().find(same).unwrap();
        for (a, b) in cells.iter().zip(golden.split(',')) {
            let near = match (a.parse::<f64>(), b.parse::<f64>()) {
                (Ok(x), Ok(y)) => (x - y).abs() <= TOLERANCE * x.abs().max(y.abs()),
                _ => *a == b,
            };
            assert!(near, "{a} is not {b}\nfound  {found}\ngolden {golden}");
        }
    }
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
