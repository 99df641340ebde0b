//! The radius against dense matrices, its limits tried on both sides, and what it costs.

use super::super::{dense, modal};
use super::*;
use crate::law::LawKind;
use crate::testing::{scaled_chain, unit_chain};

/// A number between 0 and 1 that depends on its place alone.
fn random(case: u32, lane: u32) -> f64 {
    rng::uniform(7, Stream::Test, u64::from(case), lane)
}

/// Between two positive numbers, all ratios alike.
fn between(low: f64, high: f64, share: f64) -> f64 {
    low * libm::exp(share * libm::log(high / low))
}

/// A law with gains near those that are in use, whose model may differ from the chain, and the chain.
fn random_loop<const N: usize>(case: u32, kind: LawKind) -> (Law<N>, Chain<N>) {
    let mut masses = [1.0; N];
    for (lane, mass) in (10..).zip(&mut masses) {
        *mass = between(0.5, 2.0, random(case, lane));
    }
    let plant = scaled_chain(masses);
    let model = if random(case, 1) < 0.5 { plant } else { unit_chain() };
    let k_d = if kind == LawKind::Ctc { 10.0 } else { 40.0 } * between(0.3, 3.0, random(case, 2));
    let k_p = k_d * between(1.0, 10.0, random(case, 3));
    let k_t = between(5.0, 300.0, random(case, 4));
    (Law { kind, model, beta: between(1.0, 20.0, random(case, 5)), k_t, k_p, k_d }, plant)
}

fn agrees_with_dense_matrices<const N: usize>(cases: u32, periods_max: f64) -> u32 {
    let mut unstable = 0;
    for case in 0..cases {
        let kind = LawKind::ALL[case as usize % 4];
        let (law, plant) = random_loop::<N>(case, kind);
        let mut lane = 20;
        let q = Vector::<N>::from_fn(|_, _| {
            lane += 1;
            // Every third time links are aligned, where modes meet.
            if case % 3 == 0 { 0.0 } else { PI * (2.0 * random(case, lane) - 1.0) }
        });
        let h = between(2e-5, 8e-3, random(case, 6));
        let d = h * if case % 5 == 0 { 0.0 } else { periods_max * random(case, 7) };
        let (found, expected) =
            (spectral_radius(&law, &plant, &q, h, d), dense::spectral_radius(&law, &plant, &q, h, d));
        // Five places are printed.
        assert!(
            (found - expected).abs() < 5e-7 * expected.max(1.0),
            "{kind} n {N} case {case} h {h} d {d}: {found} {expected}"
        );
        unstable += u32::from(found > 1.0);
    }
    unstable
}

#[test]
fn the_radius_agrees_with_dense_matrices_of_the_whole_delay_line() {
    let unstable = agrees_with_dense_matrices::<1>(400, 9.0)
        + agrees_with_dense_matrices::<2>(200, 6.0)
        + agrees_with_dense_matrices::<3>(160, 4.0)
        + agrees_with_dense_matrices::<7>(12, 1.5);
    assert!((60..700).contains(&unstable), "{unstable} unstable");
}

#[test]
fn the_worst_of_the_configurations_is_the_worst_of_each() {
    for case in 0..24 {
        let kind = LawKind::ALL[case as usize % 4];
        let (law, plant) = random_loop::<3>(case, kind);
        let (h, d) = (between(1e-4, 5e-3, random(case, 6)), 2e-3 * random(case, 7));
        let all = SampledLoop::new(&law, &plant, 6);
        let worst = all.worst_radius(h, d);
        let each = all.configurations.iter().map(|modal| larger_radius(&modal.sampled(h, d), 0.0)).fold(0.0, f64::max);
        assert!((worst - each).abs() < 1e-9 * each, "{kind} case {case}: {worst} {each}");
        assert_eq!(all.is_stable(h, d), worst < 1.0, "{kind} case {case}: {worst}");
    }
}

#[test]
fn limits_of_delay_and_period_separate_stable_from_unstable_when_they_are_tried() {
    let (mut delays, mut periods, mut shorter) = (0, 0, 0);
    for case in 0..48 {
        let kind = LawKind::ALL[case as usize % 4];
        let (law, plant) = random_loop::<3>(case, kind);
        let (h, d) = (between(2e-5, 8e-3, random(case, 6)), between(1e-5, 8e-3, random(case, 7)));
        let all = SampledLoop::new(&law, &plant, 4);
        let stable = all.is_stable(h, d);
        if let Limit::At(margin) = all.delay_margin(h, d) {
            assert_eq!(margin > 0.0, stable);
            if stable {
                assert!(
                    all.is_stable(h, d + margin * 0.9999) && !all.is_stable(h, d + margin * 1.0001),
                    "{kind} {case}"
                );
                delays += 1;
            }
        }
        match all.longest_period(h, d) {
            Some(Limit::At(limit)) => {
                assert!(
                    all.is_stable(limit * 0.9999, d) && !all.is_stable(limit * 1.0001, d),
                    "{kind} {case}: {limit}"
                );
                assert_eq!(limit > h, stable);
                periods += 1;
                shorter += u32::from(!stable);
            }
            Some(Limit::Beyond(tried)) => assert!(stable && all.is_stable(tried, d)),
            None => assert!(!stable && !all.is_stable(h / 2.0, d) && !all.is_stable(h / 50.0, d), "{kind} {case}"),
        }
    }
    assert!(delays > 15 && periods > 15 && shorter > 3, "{delays} {periods} {shorter}");
}

/// Determinants that the limits and the radius of a loop of seven links take.
fn determinants(kind: LawKind, h: f64, d: f64) -> u64 {
    let plant = unit_chain::<7>();
    let (k_p, k_d) = if kind == LawKind::Ctc { (25.0, 10.0) } else { (200.0, 60.0) };
    let law = Law { kind, model: plant, beta: 5.0, k_t: 220.0, k_p, k_d };
    modal::EVALUATED.set(0);
    let all = SampledLoop::new(&law, &plant, 16);
    let _ = all.worst_radius(h, d);
    let _ = all.delay_margin(h, d);
    let _ = all.longest_period(h, d);
    modal::EVALUATED.get()
}

#[test]
fn neither_a_high_rate_nor_a_long_delay_makes_the_analysis_slow() {
    for kind in LawKind::ALL {
        for (h, d) in [(1e-3, 0.0), (1e-3, 3e-3), (2e-5, 0.0), (2e-5, 5e-3), (1e-4, 20e-3), (5e-3, 0.0)] {
            let taken = determinants(kind, h, d);
            // A determinant of seven links takes 2 µs; dense matrices took up to 1e11 operations.
            assert!(taken < 120_000, "{kind} h {h} d {d}: {taken} determinants");
        }
    }
}
