//! Attacks on the certificates: V̇ from the plant's own acceleration at random and hill-climbed states in {V ≤ c},
//! under the worst disturbance and mass errors at the vertices, against the promised rate.
//!
//! Each certificate must survive; certificates that are cut by hand must not, or the attack would prove nothing.

use crate::certificate::envelope::Envelope;
use crate::certificate::{Certificate, Form, Gains, OnR};
use crate::chain::{Chain, Vector};
use crate::law::{Law, LawInput, LawKind, certify};
use crate::rng::{Stream, standard_normal, uniform};
use crate::testing::{assume, default_sup, scaled_chain, unit_chain};

/// One certificate under attack.
struct Target<const N: usize> {
    certificate: Certificate,
    law: Law<N>,
    mu: f64,
    disturbance_nm: f64,
}

/// A state of the error system with a setpoint; `s` is r, or ė for `ctc`.
#[derive(Clone, Copy)]
struct Point<const N: usize> {
    q: Vector<N>,
    e: Vector<N>,
    s: Vector<N>,
    v_d: Vector<N>,
    a_d: Vector<N>,
}

fn target<const N: usize>(kind: LawKind, gains: &Gains, mu: f64, disturbance_nm: f64) -> Target<N> {
    let nominal = unit_chain::<N>();
    let found = certify(kind, &assume(&nominal, mu, disturbance_nm), gains, None);
    assert!(found.certificate.is_certified(), "{kind} n {N}: {:?}", found.failures);
    let law = Law::new(kind, nominal, gains, &found.certificate);
    Target { certificate: found.certificate, law, mu, disturbance_nm }
}

impl<const N: usize> Target<N> {
    /// sup(V̇ − rate) that `states` random states (over all mass vertices together) and hill climbing find.
    fn worst(&self, states: u64) -> f64 {
        let vertices = if self.mu > 0.0 { 1u64 << N } else { 1 };
        let mut worst = f64::NEG_INFINITY;
        for vertex in 0..vertices {
            let sign = |link: usize| if vertex >> link & 1 == 1 { 1.0 } else { -1.0 };
            let plant = scaled_chain::<N>(core::array::from_fn(|link| 1.0 + self.mu * sign(link)));
            let mut best: Vec<(f64, Point<N>)> = Vec::new();
            for state in 0..states.div_ceil(vertices) {
                let point = self.draw(vertex * states + state);
                let excess = self.excess(&plant, &point);
                // The ten worst are climbed from.
                let place = best.partition_point(|(other, _)| *other > excess);
                if place < 10 {
                    best.insert(place, (excess, point));
                    best.truncate(10);
                }
            }
            for (start, (excess, point)) in (0..).zip(best) {
                worst = worst.max(self.climb(&plant, excess, point, vertex * 10 + start));
            }
        }
        worst
    }

    fn draw(&self, state: u64) -> Point<N> {
        let mut lane = 0;
        let mut next = |normal: bool| {
            lane += 1;
            if normal {
                standard_normal(11, Stream::Test, state, lane)
            } else {
                2.0 * uniform(11, Stream::Test, state, lane) - 1.0
            }
        };
        let (size_e, size_s) = (libm::exp(2.0 * next(false) - 1.0), libm::exp(2.5 * next(false) - 1.5));
        let sup = default_sup::<N>();
        Point {
            q: Vector::from_fn(|_, _| core::f64::consts::PI * next(false)),
            e: Vector::from_fn(|_, _| size_e * next(true)),
            s: Vector::from_fn(|_, _| 3.0 * size_s * next(true)),
            v_d: Vector::from_fn(|_, _| sup.v_inf * next(false)),
            a_d: Vector::from_fn(|_, _| sup.v_inf * 0.1 * next(false)),
        }
    }

    fn climb(&self, plant: &Chain<N>, mut excess: f64, mut point: Point<N>, climber: u64) -> f64 {
        for step in 0..200u32 {
            let scale = 0.3 * libm::pow(0.97, f64::from(step));
            let mut lane = 1000 * (step + 1);
            let mut push = |x: &Vector<N>, by: f64, limit: f64| {
                x.map(|value| {
                    lane += 1;
                    (value + by * scale * standard_normal(12, Stream::Test, climber, lane)).clamp(-limit, limit)
                })
            };
            let sup = default_sup::<N>();
            let tried = Point {
                q: push(&point.q, 1.0, f64::MAX),
                e: push(&point.e, 0.3, f64::MAX),
                s: push(&point.s, 1.0, f64::MAX),
                v_d: push(&point.v_d, sup.v_inf, sup.v_inf),
                a_d: push(&point.a_d, 0.1 * sup.v_inf, 0.1 * sup.v_inf),
            };
            let found = self.excess(plant, &tried);
            if found > excess {
                (excess, point) = (found, tried);
            }
        }
        excess
    }

    /// V̇ − rate at a point, which is shrunk into {V ≤ c} first.
    fn excess(&self, plant: &Chain<N>, point: &Point<N>) -> f64 {
        let cert = &self.certificate;
        let state = |shrink: f64| {
            let (e, s) = (point.e * shrink, point.s * shrink);
            let e_dot = cert.on_r().map_or(s, |of| s - e * of.beta);
            let (v, q_d) = (point.v_d - e_dot, point.q + e);
            LawInput { q: point.q, v, q_d, v_d: point.v_d, a_d: point.a_d }
        };
        let v = cert.v(plant, &state(1.0));
        let x = state(if v > cert.level { (cert.level / v).sqrt() * (1.0 - 1e-9) } else { 1.0 });
        self.v_rate(plant, &x) - cert.rate(&x)
    }

    /// V̇ by its definition, with d along what hurts most.
    fn v_rate(&self, plant: &Chain<N>, x: &LawInput<N>) -> f64 {
        let cert = &self.certificate;
        let (e, e_dot, tau) = (x.e(), x.e_dot(), self.law.torque(x));
        let pushed = |along: &Vector<N>| {
            let d = along * (self.disturbance_nm / along.norm().max(1e-300));
            x.a_d - plant.acceleration(&x.q, &x.v, &(tau + d))
        };
        let of = match cert.form {
            Form::OnR(of) => of,
            Form::OnY(of) => {
                let gradient = e * (of.k_d / 2.0) + e_dot;
                let still = plant.acceleration(&x.q, &Vector::zeros(), &(gradient + plant.gravity(&x.q)));
                let e_ddot = pushed(&-still);
                return (of.k_p + of.k_d * of.k_d / 2.0) * e.dot(&e_dot)
                    + of.k_d / 2.0 * (e_dot.dot(&e_dot) + e.dot(&e_ddot))
                    + e_dot.dot(&e_ddot);
            }
        };
        let r = x.r(of.beta);
        let r_dot = pushed(&-r) + e_dot * of.beta;
        let mass = plant.mass_matrix(&x.q);
        let mass_rate = plant.mass_matrix_rate(&x.q, &x.v);
        r.dot(&(mass * r_dot)) + 0.5 * r.dot(&(mass_rate * r)) + of.p * e.dot(&e_dot)
    }
}

const STATES: u64 = 100_000;

#[track_caller]
fn survives<const N: usize>(kind: LawKind, gains: &Gains, mu: f64, disturbance_nm: f64) {
    let worst = target::<N>(kind, gains, mu, disturbance_nm).worst(STATES);
    assert!(worst <= 1e-9, "{kind} n {N} mu {mu} D {disturbance_nm}: V̇ exceeds its bound by {worst}");
}

#[test]
fn robust_keeps_its_rate_wherever_it_is_attacked() {
    survives::<3>(LawKind::Robust, &Gains::of(LawKind::Robust), 0.0, 10.8);
    survives::<3>(LawKind::Robust, &Gains { level: 7.2, k3: 0.0367, ..Gains::of(LawKind::Robust) }, 0.2, 3.46);
}

#[test]
fn feed_forward_keeps_its_rate_wherever_it_is_attacked() {
    let gains = Gains::of(LawKind::RobustFf);
    survives::<3>(LawKind::RobustFf, &Gains { level: 6.7, ..gains }, 0.2, 3.46);
    survives::<3>(LawKind::RobustFf, &Gains { level: 6.5, ..gains }, 0.0, 2.0);
    survives::<3>(LawKind::RobustFf, &Gains { level: 6.7, shared_v: true, ..gains }, 0.2, 3.46);
}

#[test]
fn gravity_compensation_keeps_its_rate_wherever_it_is_attacked() {
    let gains = Gains { level: 2.0, analyst_beta: Some(0.6), analyst_k2: Some(1.2), ..Gains::of(LawKind::PdG) };
    survives::<3>(LawKind::PdG, &gains, 0.1, 1.0);
    survives::<3>(LawKind::PdG, &gains, 0.0, 0.0);
    survives::<3>(LawKind::PdG, &Gains { analyst_beta: None, analyst_k2: None, ..gains }, 0.1, 1.0);
}

#[test]
fn computed_torque_keeps_its_rate_wherever_it_is_attacked() {
    let gains = Gains::of(LawKind::Ctc);
    survives::<3>(LawKind::Ctc, &Gains { level: 8.0, ..gains }, 0.01, 0.1);
    survives::<3>(LawKind::Ctc, &Gains { level: 60.0, ..gains }, 0.0, 2.0);
    survives::<3>(LawKind::Ctc, &Gains { level: 1e4, ..gains }, 0.0, 0.0);
}

#[test]
fn every_number_of_links_keeps_its_rate() {
    let gains = Gains { c1: None, ..Gains::of(LawKind::Robust) };
    survives::<1>(LawKind::Robust, &gains, 0.0, 1.0);
    survives::<1>(LawKind::Robust, &gains, 0.2, 1.0);
    survives::<2>(LawKind::Robust, &gains, 0.1, 1.0);
    let large = Gains { level: 40.0, k2: 20.0, ..gains };
    survives::<5>(LawKind::Robust, &large, 0.0, 1.0);
    survives::<7>(LawKind::Robust, &Gains { level: 100.0, k2: 60.0, ..gains }, 0.0, 1.0);
    survives::<1>(LawKind::Ctc, &Gains { level: 8.0, ..Gains::of(LawKind::Ctc) }, 0.02, 0.1);
}

#[test]
fn an_epsilon_cut_by_a_third_is_found_out() {
    let mut cut = target::<3>(LawKind::Robust, &Gains { c1: None, ..Gains::of(LawKind::Robust) }, 0.0, 10.8);
    let honest = cut.worst(STATES / 10);
    cut.certificate.epsilon *= 0.7;
    let found = cut.worst(STATES / 10);
    assert!(honest <= 1e-9 && found > 0.0, "{honest} {found}");
}

#[test]
fn a_gain_without_kappa_is_found_out() {
    let mut cut = target::<3>(LawKind::Robust, &Gains::of(LawKind::Robust), 0.0, 10.8);
    cut.law.k_t -= cut.certificate.on_r().unwrap().kappa;
    let found = cut.worst(STATES / 10);
    assert!(found > 0.0, "{found}");
}

/// The certificate of every blend of two laws, torque = w τ_a + (1 − w) τ_b for the same state, w in [0, 1] however
/// it varies with time; none when the two do not share V.
///
/// V̇ is affine in τ, so a blend keeps the weaker of the two promises on the smaller level set: with the smaller
/// rates and the larger ε. Shared means same β, same p, same true plants (μ, D) and reference. `robust` and
/// `robust-ff` share V when the latter is given p = β² m̄; `ctc` has another V, so no blend with it is covered.
fn blend_covered(a: &Certificate, b: &Certificate) -> Option<Certificate> {
    if !(a.is_certified() && b.is_certified()) {
        return None;
    }
    let (of_a, of_b) = (a.on_r()?, b.on_r()?);
    let key = |c: &Certificate, of: &OnR| {
        let Envelope { v_inf, v_2, a_2, .. } = c.envelope;
        let of_plants = [c.envelope.lambda_lo(), c.envelope.lambda_hi(), c.envelope.c_bar(), v_inf, v_2, a_2];
        (of_plants.map(f64::to_bits), [of.beta, of.p].map(f64::to_bits))
    };
    if key(a, of_a) != key(b, of_b) {
        return None;
    }
    let level = a.level.min(b.level);
    let (s_rate, e_rate) = (a.s_rate.min(b.s_rate), a.e_rate.min(b.e_rate));
    let epsilon = a.epsilon.max(b.epsilon);
    let alpha = (2.0 * s_rate / a.envelope.lambda_hi()).min(2.0 * e_rate / of_a.p);
    // The smaller level set may be too small for the larger ε: then the blend may leave it.
    if epsilon > alpha * level {
        return None;
    }
    let disturbance_nm = a.envelope.disturbance_nm.min(b.envelope.disturbance_nm);
    Some(Certificate {
        envelope: Envelope { disturbance_nm, ..a.envelope },
        level,
        s_rate,
        e_rate,
        epsilon,
        alpha,
        w_norm: (epsilon / s_rate.min(e_rate)).sqrt(),
        ultimate_e: (2.0 * epsilon / (alpha * of_a.p)).sqrt(),
        ultimate_s: (2.0 * epsilon / (alpha * a.envelope.lambda_lo())).sqrt(),
        ..*a
    })
}

#[test]
fn a_blend_of_laws_on_one_v_keeps_the_weaker_rate() {
    let robust =
        target::<3>(LawKind::Robust, &Gains { level: 7.2, k3: 0.0367, ..Gains::of(LawKind::Robust) }, 0.2, 3.46);
    let gains = Gains { level: 7.0, k2: 8.0, shared_v: true, ..Gains::of(LawKind::RobustFf) };
    let forward = target::<3>(LawKind::RobustFf, &gains, 0.2, 3.46);
    let blend = blend_covered(&robust.certificate, &forward.certificate).unwrap();
    let plant = scaled_chain::<3>([0.8, 1.2, 0.8]);
    let mut level_reached = 0.0f64;
    for state in 0..20_000 {
        let point = robust.draw(state);
        let v = point.s - point.e * blend.on_r().unwrap().beta;
        let x = LawInput { q: point.q, v: point.v_d - v, q_d: point.q + point.e, v_d: point.v_d, a_d: point.a_d };
        if blend.v(&plant, &x) > blend.level {
            continue;
        }
        level_reached = level_reached.max(blend.v(&plant, &x));
        // V̇ is affine in τ: the mean of both rates is the rate of the mean torque.
        let weight = uniform(13, Stream::Test, state, 0);
        let rate = weight * robust.v_rate(&plant, &x) + (1.0 - weight) * forward.v_rate(&plant, &x);
        assert!(rate <= blend.rate(&x) + 1e-9);
    }
    assert!(level_reached > 0.9 * blend.level);
    // Not on the same V: another p, another β, or computed torque.
    let own = target::<3>(LawKind::RobustFf, &Gains { shared_v: false, ..gains }, 0.2, 3.46);
    assert!(blend_covered(&robust.certificate, &own.certificate).is_none());
    let ctc = target::<3>(LawKind::Ctc, &Gains { level: 8.0, ..Gains::of(LawKind::Ctc) }, 0.0, 0.0);
    assert!(blend_covered(&robust.certificate, &ctc.certificate).is_none());
}
