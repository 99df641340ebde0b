//! The studies: their table against a golden one, and what makes them fast.

use loopbound_shared::law::LawKind;

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

/// Cells of the golden table that a change of the last bits of libm may not move by more than this: the runs are
/// bit-identical between machines, so this only allows for changes that are meant, such as another quadrature.
const TOLERANCE: f64 = 1e-4;

#[test]
fn the_quick_table_is_the_golden_one() {
    let mut base = Base::new::<3>(true).unwrap();
    base.scenario.loop_.duration = cases::nanos(4.0);
    base.scenario.loop_.settle = Some(cases::nanos(2.0));
    let laws: Vec<Variant> = variants().into_iter().filter(|v| v.name != "ctc 100/20").collect();
    let cases = [Case::Exact, Case::Mass(0.2), Case::Disturbance, Case::Noise, Case::Latency(1.5e-3)];
    let table = paper::table::<3>(&base, &laws, &cases, 0).unwrap();
    let found = table.to_csv();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/study_paper.csv");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, &found).unwrap();
    }
    let golden = std::fs::read_to_string(&path).unwrap();
    assert_eq!(found.lines().count(), golden.lines().count());
    for (found, golden) in found.lines().zip(golden.lines()) {
        for (a, b) in found.split(',').zip(golden.split(',')) {
            let near = match (a.parse::<f64>(), b.parse::<f64>()) {
                (Ok(x), Ok(y)) => (x - y).abs() <= TOLERANCE * x.abs().max(y.abs()),
                _ => a == b,
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
