//! The figures that the documentation quotes, and what is said when there is no certificate.

use super::super::*;
use crate::bound::remedy::{changes, remedies};
use crate::certificate::OnR;
use crate::certificate::envelope::symmetric_eigenvalues;
use crate::certificate::requirement::Requirement;
use crate::certificate::search::{Candidate, Quantity, Task};
use crate::testing::{assume, close, default_start, unit_chain};
use crate::trajectory::SupNorms;

#[track_caller]
fn on_r(certificate: &Certificate) -> OnR {
    *certificate.on_r().expect("certified on r")
}

#[test]
fn the_default_certificate_has_the_documented_figures() {
    let assumptions = assume(&unit_chain::<3>(), 0.0, 0.0);
    let start = default_start();
    let found = certify(LawKind::Robust, &assumptions, &Gains::of(LawKind::Robust), Some(&start));
    assert!(found.certificate.is_certified(), "{:?}", found.failures);
    let (c, of) = (found.certificate, on_r(&found.certificate));
    close(c.envelope.lambda_lo(), 0.10128, 1e-5);
    close(c.envelope.lambda_hi(), 3.56538, 1e-5);
    close(c.envelope.c_bar(), 1.781, 1e-3);
    close(of.kappa, 32.80, 5e-3);
    close(of.k_t, 106.8, 5e-2);
    close(of.c1_required, 29.11, 5e-3);
    close(c.epsilon, 6.25, 1e-12);
    close(c.alpha, 5.0, 1e-12);
    close(c.w_norm, 0.791, 5e-4);
    close(c.ultimate_e, 0.234, 5e-4);
    close(c.ultimate_s, 4.97, 5e-3);
    close(c.v_start, 5.93, 5e-3);
}

#[test]
fn c1_of_40_covers_a_disturbance_of_up_to_10_8_newton_metres() {
    let gains = Gains::of(LawKind::Robust);
    for (disturbance, certified) in [(10.8, true), (10.9, false)] {
        let found = certify(LawKind::Robust, &assume(&unit_chain::<3>(), 0.0, disturbance), &gains, None);
        assert_eq!(found.certificate.is_certified(), certified);
    }
}

#[test]
fn mismatch_of_a_fifth_costs_little_gain_and_feed_forward_saves_three_quarters_of_it() {
    let assumptions = assume(&unit_chain::<3>(), 0.2, 3.46);
    let robust = Gains { level: 7.2, k3: 0.0367, ..Gains::of(LawKind::Robust) };
    let robust = certify(LawKind::Robust, &assumptions, &robust, None);
    assert!(robust.certificate.is_certified(), "{:?}", robust.failures);
    close(robust.certificate.k_t(), 108.4, 5e-2);
    let forward = Gains { level: 6.7, ..Gains::of(LawKind::RobustFf) };
    let forward = certify(LawKind::RobustFf, &assumptions, &forward, None);
    assert!(forward.certificate.is_certified(), "{:?}", forward.failures);
    close(forward.certificate.k_t(), 28.6, 5e-2);
    close(forward.certificate.ultimate_e, 0.231, 5e-4);
}

#[test]
fn gravity_compensation_is_certified_with_the_documented_radii() {
    let given = Gains { level: 2.0, analyst_beta: Some(0.6), analyst_k2: Some(1.2), ..Gains::of(LawKind::PdG) };
    for (mu, disturbance, radius, digits) in [(0.0, 0.0, 0.0078, 5e-5), (0.1, 1.0, 0.346, 5e-4)] {
        let assumptions = assume(&unit_chain::<3>(), mu, disturbance);
        let found = certify(LawKind::PdG, &assumptions, &given, None);
        assert!(found.certificate.is_certified(), "{:?}", found.failures);
        close(found.certificate.ultimate_e, radius, digits);
        // The search may only do better than the documented choice.
        let free = Gains { analyst_beta: None, analyst_k2: None, ..given };
        let searched = certify(LawKind::PdG, &assumptions, &free, None);
        assert!(searched.certificate.is_certified(), "{:?}", searched.failures);
        assert!(searched.certificate.ultimate_e <= found.certificate.ultimate_e * 1.02);
    }
}

#[test]
fn computed_torque_is_certified_for_an_exact_model_and_a_narrow_range_around_it() {
    let start = default_start();
    let case = |mu, disturbance, level| {
        let gains = Gains { level, ..Gains::of(LawKind::Ctc) };
        certify(LawKind::Ctc, &assume(&unit_chain::<3>(), mu, disturbance), &gains, Some(&start))
    };
    let exact = case(0.0, 0.0, 1e6);
    assert!(exact.certificate.is_certified());
    close(exact.certificate.alpha, 2.93, 5e-3);
    close(exact.certificate.epsilon, 0.0, 0.0);
    assert!(case(0.01, 0.0, 8.0).certificate.is_certified());
    // Whatever the level: twice the mismatch is too much for these gains.
    for level in [7.3, 8.0, 10.0, 20.0, 50.0] {
        assert!(!case(0.02, 0.0, level).certificate.is_certified());
    }
    let pushed = case(0.0, 2.0, 60.0);
    assert!(pushed.certificate.is_certified(), "{:?}", pushed.failures);
    close(pushed.certificate.ultimate_e, 2.7, 5e-2);
}

#[test]
fn one_known_link_keeps_the_whole_error_term_and_gives_18_exactly() {
    let chain = Chain::from_coefficients(Matrix::<1>::new(2.0), Vector::<1>::new(9.81)).unwrap();
    let sup = SupNorms { v_inf: 0.1, v_2: 0.1, a_2: 0.01 };
    let assumptions = Assumptions { nominal: chain, mass_mismatch: 0.0, disturbance_bound_nm: 0.0, sup };
    let c = certify(LawKind::Robust, &assumptions, &Gains { c1: None, ..Gains::of(LawKind::Robust) }, None).certificate;
    assert!(c.is_certified());
    // κ = βm, p = β²m, and mβ³ in front of e²: nothing halved.
    let of = on_r(&c);
    close(of.kappa, 10.0, 1e-12);
    close(of.p, 50.0, 1e-12);
    close(c.e_rate, 250.0, 1e-9);
    close(of.delta, 0.0, 0.0);
    close(c.w_norm, (6.25f64 / 10.0).sqrt(), 1e-12);
}

#[test]
fn a_gain_given_directly_certifies_what_remains_of_it() {
    let assumptions = assume(&unit_chain::<3>(), 0.0, 0.0);
    let gains = Gains { k_t: Some(120.0), ..Gains::of(LawKind::Robust) };
    let c = certify(LawKind::Robust, &assumptions, &gains, None).certificate;
    assert!(c.is_certified());
    let of = on_r(&c);
    close(of.k2, 120.0 - of.kappa - 64.0, 1e-9);
    let weak = certify(LawKind::Robust, &assumptions, &Gains { k_t: Some(90.0), ..gains }, None);
    assert_eq!(weak.failures[0].requirement, Requirement::Gain);
    // α = 2 K2/λ̄ must keep ε/α under c = 6, which takes K2 = 1.86 beside κ and K3 C1².
    let stronger = mended(LawKind::Robust, &assumptions, &Gains { k_t: Some(90.0), ..gains }, None, Quantity::KTotal);
    close(stronger, of.kappa + 64.0 + 6.25 * c.envelope.lambda_hi() / 12.0, 0.05);
}

/// What a remedy, which all have to be certified, sets a quantity to that it alone changes (with C1, perhaps).
#[track_caller]
fn mended(
    law: LawKind,
    assumptions: &Assumptions<3>,
    gains: &Gains,
    start: Option<&LawInput<3>>,
    quantity: Quantity,
) -> f64 {
    let envelope = assumptions.envelope();
    let start = start.map(|start| StartError::of(&assumptions.nominal, start));
    let task = Task {
        rules: law.rules(),
        envelope,
        gains: *gains,
        start,
        period_s: 1e-3,
        delay_s: 0.0,
        room: 0.9,
        fits: &|_| true,
    };
    let all = remedies(&task);
    for candidate in &all {
        assert!(candidate.certificate.is_certified(), "{candidate:?}");
    }
    let of = |candidate: &Candidate| match changes((&envelope, gains), candidate)[..] {
        [(only, value)] | [(Quantity::C1, _), (only, value)] if only == quantity => Some(value),
        _ => None,
    };
    all.iter().find_map(of).unwrap_or_else(|| panic!("no remedy by {quantity:?}: {all:?}"))
}

#[test]
fn every_remedy_mends_what_it_claims_to() {
    let start = default_start();
    let assumptions = assume(&unit_chain::<3>(), 0.1, 14.0);
    let gains = Gains { level: 4.0, k3: 0.02, ..Gains::of(LawKind::Robust) };
    let found = certify(LawKind::Robust, &assumptions, &gains, Some(&start));
    let names: Vec<_> = found.failures.iter().map(|f| f.requirement).collect();
    assert_eq!(names, [Requirement::C1, Requirement::LevelAtStart]);
    let level = mended(LawKind::Robust, &assumptions, &gains, Some(&start), Quantity::Level);
    assert!(level >= found.certificate.v_start && level < 1.001 * found.certificate.v_start, "{level}");

    let (pushed, gains) = (assume(&unit_chain::<3>(), 0.0, 14.0), Gains::of(LawKind::Robust));
    let value = |quantity| mended(LawKind::Robust, &pushed, &gains, None, quantity);
    let required = certify(LawKind::Robust, &pushed, &gains, None).certificate.c1_required();
    assert!(value(Quantity::C1) >= required && value(Quantity::C1) < 1.001 * required);
    let most = 40.0 - 29.110_97;
    assert!(value(Quantity::Disturbance) <= most && value(Quantity::Disturbance) > 0.999 * most);
}

#[test]
fn gains_that_are_no_gains_are_refused_without_a_panic() {
    let assumptions = assume(&unit_chain::<3>(), 0.0, 0.0);
    for law in LawKind::ALL {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            for gains in [
                Gains { level: bad, ..Gains::of(law) },
                Gains { beta: bad, k_p: bad, analyst_beta: Some(bad), ..Gains::of(law) },
                Gains { k3: bad, k_d: bad, ..Gains::of(law) },
            ] {
                let found = certify(law, &assumptions, &gains, None);
                assert!(!found.certificate.is_certified());
                assert!(!found.failures.is_empty());
            }
        }
        for mismatch in [1.0, -0.1, f64::NAN] {
            let wrong = Assumptions { mass_mismatch: mismatch, ..assumptions };
            let found = certify(law, &wrong, &Gains::of(law), None);
            assert_eq!(found.failures[0].requirement, Requirement::Mismatch);
        }
    }
}

#[test]
fn mixed_signs_in_a_take_the_norm_of_absolute_values() {
    let a = Matrix::<3>::from_row_slice(&[4.0, 1.0, -1.0, 1.0, 4.0, 1.0, -1.0, 1.0, 4.0]);
    let chain = Chain::from_coefficients(a, Vector::<3>::zeros()).unwrap();
    // ‖|a| off the diagonal‖ of all ones is 2; the norm with the signs kept would be 2 as well only for one pattern.
    close(assume(&chain, 0.0, 0.0).envelope().c_hat, 2.0, 1e-12);
    let b = Matrix::<3>::from_row_slice(&[4.0, 1.0, 1.0, 1.0, 4.0, -1.0, 1.0, -1.0, 4.0]);
    let signed = symmetric_extremes(&(b - Matrix::<3>::from_diagonal_element(4.0)));
    assert!(signed.1 < 1.5, "with signs the largest eigenvalue would be too small: {signed:?}");
}

fn symmetric_extremes(m: &Matrix<3>) -> (f64, f64) {
    let all = symmetric_eigenvalues(m);
    (all.iter().copied().fold(f64::INFINITY, f64::min), all.iter().copied().fold(f64::NEG_INFINITY, f64::max))
}

#[test]
fn eigenvalues_agree_with_the_library_for_every_number_of_links() {
    fn compare<const N: usize>() {
        let a = *unit_chain::<N>().a();
        let mut own = symmetric_eigenvalues(&a);
        own.sort_by(f64::total_cmp);
        let mut library: Vec<f64> =
            nalgebra::DMatrix::from_fn(N, N, |i, j| a[(i, j)]).symmetric_eigenvalues().iter().copied().collect();
        library.sort_by(f64::total_cmp);
        for (x, y) in own.iter().zip(&library) {
            close(*x, *y, 1e-12 * library[N - 1]);
        }
    }
    compare::<2>();
    compare::<3>();
    compare::<5>();
    compare::<7>();
}
