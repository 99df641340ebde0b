//! The laws against closed-loop identities that do not repeat their formulas.

mod certificates;

use super::*;
use crate::rng::{Stream, uniform};
use crate::testing::unit_chain;

fn random<const N: usize>(case: u64, what: u32) -> Vector<N> {
    Vector::from_fn(|i, _| 4.0 * uniform(3, Stream::Test, case, what * 8 + u32::try_from(i).unwrap()) - 2.0)
}

fn random_input<const N: usize>(case: u64) -> LawInput<N> {
    LawInput {
        q: random(case, 0),
        v: random(case, 1),
        q_d: random(case, 2),
        v_d: random(case, 3),
        a_d: random(case, 4),
    }
}

fn law<const N: usize>(kind: LawKind) -> Law<N> {
    Law { kind, model: unit_chain(), beta: 5.0, k_t: 106.8, k_p: 25.0, k_d: 10.0 }
}

#[test]
fn computed_torque_on_an_exact_model_makes_the_error_linear() {
    for case in 0..100 {
        let input = random_input::<3>(case);
        let acceleration = unit_chain().acceleration(&input.q, &input.v, &law(LawKind::Ctc).torque(&input));
        // ë + K_d ė + K_p e = 0 is what the law is made for.
        let residual = input.a_d - acceleration + input.e_dot() * 10.0 + input.e() * 25.0;
        assert!(residual.amax() < 1e-10, "case {case}: {residual}");
    }
}

#[test]
fn robust_feed_forward_on_an_exact_model_obeys_the_filtered_error_equation() {
    for case in 0..100 {
        let input = random_input::<5>(case);
        let (chain, r) = (unit_chain::<5>(), input.r(5.0));
        let acceleration = chain.acceleration(&input.q, &input.v, &law(LawKind::RobustFf).torque(&input));
        let r_dot = input.a_d - acceleration + input.e_dot() * 5.0;
        // M ṙ + C(q, q̇) r + K_t r = 0, whence V̇ = −K_t |r|² + ….
        let residual = chain.mass_matrix(&input.q) * r_dot + chain.coriolis(&input.q, &input.v) * r + r * 106.8;
        assert!(residual.amax() < 1e-9, "case {case}: {residual}");
    }
}

#[test]
fn the_robust_law_is_a_linear_law_that_ignores_the_model() {
    let input = random_input::<3>(1);
    let expected = input.e() * (5.0 * 106.8) + input.e_dot() * 106.8;
    assert!((law(LawKind::Robust).torque(&input) - expected).amax() < 1e-10);
    let heavy = Chain::from_coefficients(unit_chain::<3>().a() * 7.0, unit_chain::<3>().b() * 7.0).unwrap();
    let other = Law { model: heavy, ..law(LawKind::Robust) };
    assert_eq!(other.torque(&input), law(LawKind::Robust).torque(&input));
}

#[test]
fn gravity_compensation_holds_the_chain_still_at_the_setpoint() {
    let q = random::<4>(2, 0);
    let zero = Vector::zeros();
    let input = LawInput { q, v: zero, q_d: q, v_d: zero, a_d: zero };
    let torque = law(LawKind::PdG).torque(&input);
    assert!(unit_chain().acceleration(&q, &zero, &torque).amax() < 1e-13);
}

#[test]
fn a_law_is_named_the_same_when_it_is_written_and_read() {
    for kind in LawKind::ALL {
        assert_eq!(kind.to_string().parse::<LawKind>(), Ok(kind));
        assert_eq!(serde_json::to_string(&kind).unwrap(), format!("\"{kind}\""));
        assert_eq!(serde_json::from_str::<LawKind>(&format!("\"{kind}\"")).unwrap(), kind);
    }
    let refusal = "pid".parse::<LawKind>().unwrap_err().to_string();
    assert!(refusal.contains("\"pid\"") && refusal.contains("robust-ff"), "{refusal}");
}

#[test]
fn the_linearised_law_is_the_derivative_of_its_torque() {
    const STEP: f64 = 1e-6;
    let zero = Vector::<3>::zeros();
    for kind in LawKind::ALL {
        for case in 0..10 {
            let (law, q) = (law::<3>(kind), random::<3>(case, 0));
            let (on_q, on_v) = law.at_rest(&q);
            let torque = |by_q: Vector<3>, by_v: Vector<3>| {
                law.torque(&LawInput { q: q + by_q, v: by_v, q_d: q, v_d: zero, a_d: zero })
            };
            for column in 0..3 {
                let push = Vector::<3>::from_fn(|i, _| if i == column { STEP } else { 0.0 });
                let by_q = (torque(push, zero) - torque(-push, zero)) / (2.0 * STEP);
                let by_v = (torque(zero, push) - torque(zero, -push)) / (2.0 * STEP);
                // The rounding of torques of some 100 N·m over the step.
                assert!((by_q - on_q.column(column)).amax() < 1e-6, "{kind} q {case}: {by_q} {on_q}");
                assert!((by_v - on_v.column(column)).amax() < 1e-6, "{kind} v {case}: {by_v} {on_v}");
            }
        }
    }
}

#[test]
fn a_code_is_one_laws_and_0_is_nobodys() {
    let codes = LawKind::ALL.map(LawKind::code);
    assert_eq!(codes, [1, 2, 3, 4], "recordings and samples of older versions carry them");
    assert_eq!(codes.map(LawKind::of_code), LawKind::ALL.map(Some));
    assert!([0, 5, u32::MAX].into_iter().all(|code| LawKind::of_code(code).is_none()));
}
