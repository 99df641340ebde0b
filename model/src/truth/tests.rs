//! The true plant: what its parts promise in sign, size and repeatability.

use super::*;
use crate::chain::LinkParameters;
use crate::rng::uniform;

fn truth() -> Truth<3> {
    let links = LinkParameters { mass_kg: [1.0; 3], length_m: [1.0; 3], inertia_kg_m2: None, gravity_m_s2: 9.81 };
    Truth::ideal(Chain::from_links(&links).unwrap())
}

fn random(case: u64, what: u32) -> Vector<3> {
    Vector::from_fn(|i, _| 6.0 * uniform(5, Stream::Test, case, what * 8 + u32::try_from(i).unwrap()) - 3.0)
}

fn one_of_each() -> Vec<(&'static str, Disturbance<3>)> {
    let sine = Disturbance::Sine { amplitude_nm: [2.0; 3], omega_rad_s: [3.0, 2.0, 5.0], phase_rad: [0.0, 1.57, 0.0] };
    let step = Disturbance::Step { at_s: 1.0, value_nm: [3.0, 0.0, 4.0] };
    vec![
        ("none", Disturbance::None),
        ("constant", Disturbance::Constant { value_nm: [1.0, -2.0, 2.0] }),
        ("sine", sine.clone()),
        ("step", step.clone()),
        ("noise", Disturbance::Noise(BandNoise::with_rms([1.0, 2.0, 0.5], 0.5, 20.0, 9, 0).unwrap())),
        ("bounded noise", Disturbance::Noise(BandNoise::with_bound([1.0, 2.0, 0.5], 0.0, 5.0, 9, 1).unwrap())),
        ("sum", Disturbance::Sum(vec![sine, step])),
    ]
}

#[test]
fn a_disturbance_acts_with_the_sign_of_a_torque() {
    let (q, v, tau, d) = (random(0, 0), random(0, 1), random(0, 2), random(0, 3));
    let a = truth().acceleration(&q, &v, &tau, &d);
    let chain = truth().chain;
    let balance = chain.mass_matrix(&q) * a + chain.coriolis(&q, &v) * v + chain.gravity(&q) - tau - d;
    assert!(balance.amax() < 1e-12);
}

#[test]
fn friction_takes_energy_and_leaves_a_chain_that_moves_as_one_link_to_its_first_joint() {
    let rubbing = Truth { viscous_nm_s: [0.5, 0.2, 0.1], coulomb_nm: [0.3, 0.0, 0.7], ..truth() };
    for case in 0..200 {
        let v = random(case, 1);
        assert!(rubbing.friction(&v).dot(&v) > 0.0, "friction drives at {v}");
    }
    let together = rubbing.friction(&Vector::repeat(2.0));
    // tanh(2/0.05) is 1 in double precision.
    assert!((together - Vector::<3>::new(0.5 * 2.0 + 0.3, 0.0, 0.0)).amax() < 1e-15);
    let slow = rubbing.friction(&Vector::<3>::new(0.0, 0.0, COULOMB_SPEED_RAD_S));
    let last_joint = 0.1 * COULOMB_SPEED_RAD_S + 0.7 * libm::tanh(1.0);
    assert!((slow - Vector::<3>::new(0.0, -last_joint, last_joint)).amax() < 1e-15);
}

#[test]
fn no_disturbance_exceeds_its_bound_and_simple_ones_attain_it() {
    for (name, disturbance) in one_of_each() {
        disturbance.validate().unwrap();
        let bound = disturbance.sup_norm();
        let largest = (0..100_000).map(|k| disturbance.at(f64::from(k) * 1e-3).norm()).fold(0.0, f64::max);
        assert!(largest <= bound * (1.0 + 1e-12), "{name}: {largest} exceeds {bound}");
        let attained = if name.contains("noise") { 0.25 } else { 0.9 };
        assert!(largest >= attained * bound, "{name}: the bound {bound} is far from {largest}");
    }
}

#[test]
fn a_step_is_zero_before_its_instant_and_full_at_it() {
    let step = Disturbance::Step { at_s: 1.0, value_nm: [3.0, 0.0, 4.0] };
    assert_eq!(step.at(1.0 - 1e-9), Vector::<3>::zeros());
    assert_eq!(step.at(1.0), Vector::<3>::new(3.0, 0.0, 4.0));
}

#[test]
fn noise_has_its_root_mean_square_and_keeps_to_its_band() {
    let (rms, low_hz, high_hz) = ([1.0, 2.0], 2.0, 10.0);
    let noise = BandNoise::with_rms(rms, low_hz, high_hz, 4, 0).unwrap();
    let (count, dt) = (200_000u32, 1e-3);
    let tau = core::f64::consts::TAU;
    for (link, expected) in rms.into_iter().enumerate() {
        let mut mean_square = 0.0;
        let mut outside = [0.0; 4];
        for k in 0..count {
            let t = f64::from(k) * dt;
            let d = noise.at(t)[link];
            mean_square += d * d / f64::from(count);
            for (probe, hz) in outside.iter_mut().zip([0.0, 1.0, 12.0, 20.0]) {
                *probe += d * libm::cos(tau * hz * t) / f64::from(count);
            }
        }
        // Over T = 200 s the cross terms of waves at least δ apart average to some 1/(δ T); waves may be 0.1 Hz apart.
        assert!((mean_square.sqrt() / expected - 1.0).abs() < 0.05, "link {link}: {mean_square}");
        // A wave at least 1 Hz away correlates by at most A/(2π T · 1 Hz) over T.
        assert!(outside.iter().all(|probe| probe.abs() < 0.02 * expected), "link {link}: {outside:?}");
    }
    assert_eq!(noise, BandNoise::with_rms(rms, low_hz, high_hz, 4, 0).unwrap());
    assert_ne!(noise, BandNoise::with_rms(rms, low_hz, high_hz, 4, 1).unwrap());
    assert!((noise.at(0.3)[0] * 2.0 - noise.at(0.3)[1]).abs() > 1e-3, "the links are not independent");
}

#[test]
fn exact_sensors_tell_the_state_and_noisy_ones_repeat_themselves() {
    let (q, v) = (random(3, 0), random(3, 1));
    assert_eq!(truth().measure(&q, &v, 17), (q, v));
    let noisy = Truth { noise_q_rad: 1e-3, noise_v_rad_s: 1e-2, seed: 6, ..truth() };
    assert_eq!(noisy.measure(&q, &v, 17), noisy.measure(&q, &v, 17));
    assert_ne!(noisy.measure(&q, &v, 17), noisy.measure(&q, &v, 18));
    assert_ne!(noisy.measure(&q, &v, 17), Truth { seed: 7, ..noisy.clone() }.measure(&q, &v, 17));
    let count = 20_000u32;
    let (mut square_q, mut square_v) = (0.0, 0.0);
    for tick in 0..u64::from(count) {
        let (q_m, v_m) = noisy.measure(&q, &v, tick);
        square_q += (q_m - q).norm_squared() / f64::from(3 * count);
        square_v += (v_m - v).norm_squared() / f64::from(3 * count);
    }
    // The sample deviation of 60 000 normal numbers is off by 0.3 %; five of those are allowed.
    assert!((square_q.sqrt() / 1e-3 - 1.0).abs() < 0.015 && (square_v.sqrt() / 1e-2 - 1.0).abs() < 0.015);
}

#[test]
fn sensors_with_steps_tell_the_nearest_multiple() {
    let stepped = Truth { quant_q_rad: 0.25, quant_v_rad_s: 0.5, ..truth() };
    let (q, v) = stepped.measure(&Vector::<3>::new(0.3, -0.4, 0.12), &Vector::<3>::new(0.3, -0.2, 7.1), 0);
    assert_eq!(q, Vector::<3>::new(0.25, -0.5, 0.0));
    assert_eq!(v, Vector::<3>::new(0.5, 0.0, 7.0));
}

#[test]
fn actuators_clip_each_torque_with_its_sign_and_say_so() {
    let weak = Truth { torque_limit_nm: [10.0, 20.0, f64::INFINITY], ..truth() };
    assert_eq!(weak.saturate(&Vector::<3>::new(-11.0, 20.0, 1e9)), (Vector::<3>::new(-10.0, 20.0, 1e9), true));
    assert_eq!(weak.saturate(&Vector::<3>::new(-10.0, 20.0, 1e9)), (Vector::<3>::new(-10.0, 20.0, 1e9), false));
    assert!(weak.saturate(&Vector::<3>::new(f64::NAN, 0.0, 0.0)).0[0].is_nan());
}

#[test]
fn parameters_out_of_range_are_refused_by_name() {
    let refusal = |truth: Truth<3>| truth.validate().unwrap_err().to_string();
    truth().validate().unwrap();
    assert_eq!(refusal(Truth { noise_q_rad: -1.0, ..truth() }), "noise_q_rad is -1, allowed: a finite number >= 0");
    assert!(refusal(Truth { viscous_nm_s: [0.0, f64::NAN, 0.0], ..truth() }).starts_with("viscous_nm_s is NaN"));
    assert!(refusal(Truth { coulomb_nm: [f64::INFINITY; 3], ..truth() }).starts_with("coulomb_nm is inf"));
    assert!(refusal(Truth { torque_limit_nm: [1.0, 0.0, 1.0], ..truth() }).starts_with("torque_limit_nm is 0"));
    let endless = Disturbance::Sum(vec![Disturbance::Constant { value_nm: [f64::INFINITY; 3] }]);
    assert!(refusal(Truth { disturbance: endless, ..truth() }).starts_with("value_nm is inf"));
    assert!(BandNoise::with_rms([1.0], 5.0, 5.0, 0, 0).unwrap_err().to_string().starts_with("high_hz is 5"));
    assert!(BandNoise::with_bound([-1.0], 1.0, 5.0, 0, 0).unwrap_err().to_string().starts_with("bound_nm is -1"));
}
