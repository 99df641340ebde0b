//! The boundary against the spectral radius, and the figures that the documentation quotes.

use super::radius::{SampledLoop, spectral_radius, worst_radius};
use crate::certificate::boundary::critical_rate;
use crate::certificate::sampling::{hold_limit_s, hold_limit_ticks, sampling_budget};
use crate::certificate::{Certificate, Gains};
use crate::chain::Vector;
use crate::law::{Law, LawKind, certify};
use crate::testing::{assume, close, default_start, unit_chain};

fn robust(gains: &Gains) -> Certificate {
    let found = certify(LawKind::Robust, &assume(&unit_chain::<3>(), 0.0, 0.0), gains, Some(&default_start()));
    assert!(found.certificate.is_certified(), "{:?}", found.failures);
    found.certificate
}

fn law(kind: LawKind, k_t: f64, k_p: f64, k_d: f64) -> Law<3> {
    Law { kind, model: unit_chain::<3>(), beta: 5.0, k_t, k_p, k_d }
}

#[test]
fn the_default_loop_has_the_documented_room_for_delay_and_period() {
    let cert = robust(&Gains::of(LawKind::Robust));
    let budget = sampling_budget(&cert, 1e-3, 0.0).unwrap();
    close(budget.delay_margin_s, 0.948e-3, 5e-7);
    close(budget.period_max_s.unwrap(), 1.90e-3, 5e-6);
    // At 200 Hz the default gains diverge.
    assert!(sampling_budget(&cert, 5e-3, 0.0).unwrap().used > 1.0);
    close(sampling_budget(&cert, 5e-3, 0.0).unwrap().delay_margin_s, 0.0, 0.0);
}

#[test]
fn the_boundary_11_agrees_with_the_spectral_radius_of_the_exact_discretisation() {
    let plant = unit_chain::<3>();
    let lambda_lo = 0.101_280_5;
    let (mut checked, mut unstable) = (0, 0);
    for k_t in [54.8, 106.8] {
        let loop_law = law(LawKind::Robust, k_t, 0.0, 0.0);
        for h in [5e-4, 1e-3, 2e-3, 2.5e-3, 3.8e-3] {
            for part in [0.0, 0.1, 0.2, 0.45, 0.9, 0.99, 1.3, 1.8, 2.5] {
                let used = k_t / lambda_lo / critical_rate(h, part * h);
                // Within 3 % of the boundary the slow modes, which [11] leaves out, may decide.
                if (used - 1.0).abs() > 0.03 {
                    let stable = worst_radius(&loop_law, &plant, h, part * h, 4) < 1.0;
                    assert_eq!(stable, used < 1.0, "K_t {k_t}, h {h}, d/h {part}: used {used}");
                    checked += 1;
                    unstable += i32::from(!stable);
                }
            }
        }
    }
    assert!(checked > 70 && unstable > 20, "{checked} points, {unstable} of them unstable");
}

#[test]
fn the_rates_of_the_laws_with_a_model_agree_with_their_spectral_radius() {
    let plant = unit_chain::<3>();
    let assumptions = assume(&plant, 0.0, 0.0);
    for (kind, within) in [(LawKind::RobustFf, 0.15), (LawKind::PdG, 0.15)] {
        let gains = Gains::of(kind);
        let cert = certify(kind, &assumptions, &gains, None).certificate;
        assert!(cert.is_certified());
        let loop_law = law(kind, cert.k_t(), gains.k_p, gains.k_d);
        let rate = cert.fast_rate.unwrap();
        for (h, d) in [(1.0, 0.0), (1.0, 0.6), (0.4, 0.9)] {
            let unit = critical_rate(h, d) / rate;
            let radius = |part: f64| worst_radius(&loop_law, &plant, part * h * unit, part * d * unit, 4);
            let (stable, unstable) = (radius(1.0 - within), radius(1.0 + within));
            assert!(stable < 1.0 && unstable > 1.0, "{kind} h {h} d {d}: {stable} {unstable}");
        }
    }
}

#[test]
fn computed_torque_has_no_single_rate_but_a_delay_margin() {
    let plant = unit_chain::<3>();
    let cert = certify(LawKind::Ctc, &assume(&plant, 0.0, 0.0), &Gains::of(LawKind::Ctc), None).certificate;
    assert!(sampling_budget(&cert, 1e-3, 0.0).is_none());
    let (loop_law, h) = (law(LawKind::Ctc, 0.0, 25.0, 10.0), 5e-3);
    let margin = SampledLoop::new(&loop_law, &plant, 4).delay_margin(h, 1e-3).seconds();
    assert!(margin > h, "{margin}");
    assert!(worst_radius(&loop_law, &plant, h, 1e-3 + margin * 0.99, 4) < 1.0);
    assert!(worst_radius(&loop_law, &plant, h, 1e-3 + margin * 1.01, 4) > 1.0);
}

#[test]
fn a_slow_exact_loop_has_the_radius_of_its_continuous_poles() {
    // Computed torque with the exact model at rest is ë + 10 ė + 25 e = 0: a double pole at −5 in every direction.
    let h = 1e-4;
    let radius = spectral_radius(
        &law(LawKind::Ctc, 0.0, 25.0, 10.0),
        &unit_chain::<3>(),
        &Vector::<3>::new(0.4, -1.0, 2.0),
        h,
        0.0,
    );
    // The hold delays by h/2, which splits the double pole by some sqrt(h): 3 in 5 at most.
    close(-libm::log(radius) / h, 5.0, 0.5);
}

#[test]
fn the_proven_age_is_a_small_fraction_of_a_millisecond() {
    let age = |beta, k2| {
        let gains = Gains { beta, k2, c1: Some(30.0), k3: 0.04, ..Gains::of(LawKind::Robust) };
        let kappa = robust(&gains).on_r().unwrap().kappa;
        // K_t = 107 in all: what κ and K2 leave goes against C1.
        let cert = robust(&Gains { k3: (107.0 - kappa - k2) / 900.0, ..gains });
        close(cert.k_t(), 107.0, 1e-9);
        LawKind::Robust.proven_age(&cert).unwrap().age_s
    };
    close(age(5.0, 10.0), 0.180e-3, 5e-7);
    close(age(3.0, 6.0), 0.20e-3, 5e-6);
}

#[test]
fn a_held_torque_keeps_the_level_for_seven_milliseconds() {
    let gains = Gains::of(LawKind::Robust);
    let cert = robust(&gains);
    close(hold_limit_s(&cert, 0.05, 30.0), 7.4e-3, 5e-5);
    assert_eq!(hold_limit_ticks(&cert, 0.05, 30.0, 1e-3), 7);
    for bad in [f64::NAN, f64::INFINITY, -1.0, cert.level] {
        assert_eq!(hold_limit_ticks(&cert, bad, 30.0, 1e-3), 0);
    }
    let assumptions = assume(&unit_chain::<3>(), 0.0, 0.0);
    let weak = certify(LawKind::Robust, &assumptions, &Gains { c1: Some(1.0), ..gains }, None).certificate;
    assert!(!weak.is_certified());
    assert_eq!(hold_limit_ticks(&weak, 0.05, 30.0, 1e-3), 0);
}

#[test]
fn the_average_delay_rule_allows_loops_that_diverge() {
    // d + h/2 < π λ/(2K_t) allows h = 2.94 ms at d = 0; the loop is unstable from 1.90 ms on.
    let plant = unit_chain::<3>();
    assert!(worst_radius(&law(LawKind::Robust, 106.8, 0.0, 0.0), &plant, 2.9e-3, 0.0, 0) > 1.0);
}
