//! Simulated loops: no false alarm, and each kind of trouble laid to its cause.

use super::*;
use crate::certificate::Gains;
use crate::law::{LawKind, certify};
use crate::rng::{Stream, uniform};
use crate::testing::{assume, unit_chain};
use crate::trajectory::Trajectory;
use crate::truth::Disturbance;

/// A loop in which the torque is `factor` times the law's answer to the state at the start of each period.
struct Loop {
    truth: Truth<3>,
    law: Law<3>,
    certificate: Certificate,
    period_ns: u64,
    factor: f64,
}

impl Loop {
    fn new(kind: LawKind, gains: &Gains, disturbance_nm: f64) -> Self {
        let chain = unit_chain::<3>();
        let found = certify(kind, &assume(&chain, 0.0, disturbance_nm), gains, None);
        assert!(found.certificate.is_certified(), "{:?}", found.failures);
        let law = Law::new(kind, chain, gains, &found.certificate);
        Self { truth: Truth::ideal(chain), law, certificate: found.certificate, period_ns: 1_000_000, factor: 1.0 }
    }

    fn default() -> Self {
        Self::new(LawKind::Robust, &Gains::of(LawKind::Robust), 0.0)
    }

    /// Diagnoses of every period up to `until_s`, or until V leaves all bounds.
    fn run(&self, until_s: f64) -> Vec<IntervalDiagnosis<3>> {
        let diagnosis = Diagnosis {
            truth: &self.truth,
            certificate: &self.certificate,
            law: Some(&self.law),
            step_max_ns: 1_000_000,
        };
        let reference = Trajectory::<3>::of_the_paper();
        let mut state = PlantState { q: Vector::<3>::new(0.3, -0.2, 0.25), v: Vector::<3>::zeros() };
        let mut out: Vec<IntervalDiagnosis<3>> = Vec::new();
        let mut from_ns = 0;
        while from_ns as f64 * 1e-9 < until_s && out.last().is_none_or(|last| last.v_end < 1e3) {
            let setpoint = reference.at(from_ns as f64 * 1e-9);
            let sample = input(&state, &setpoint);
            let segment = Segment {
                to_ns: from_ns + self.period_ns,
                tau: self.law.torque(&sample) * self.factor,
                answered: Some(sample),
                scheduled: Some(sample),
                late: false,
            };
            let found = diagnosis.interval(&state, &setpoint, from_ns, &[segment]);
            (state, from_ns) = (found.end, segment.to_ns);
            out.push(found);
        }
        out
    }

    fn verdicts(&self, until_s: f64) -> Vec<Verdict> {
        self.run(until_s).iter().map(|found| found.verdict).collect()
    }
}

#[test]
fn a_sound_loop_raises_no_alarm_under_any_law() {
    let kinds = [
        (LawKind::Robust, Gains::of(LawKind::Robust)),
        (LawKind::RobustFf, Gains { level: 8.0, ..Gains::of(LawKind::RobustFf) }),
        (LawKind::RobustFf, Gains { level: 8.0, shared_v: true, ..Gains::of(LawKind::RobustFf) }),
        (LawKind::PdG, Gains::of(LawKind::PdG)),
        (LawKind::Ctc, Gains { level: 20.0, ..Gains::of(LawKind::Ctc) }),
    ];
    for (kind, gains) in kinds {
        let mut sound = Loop::new(kind, &gains, 0.0);
        for (period_ns, until_s) in [(1_000_000, 2.0), (100_000, 0.3)] {
            sound.period_ns = period_ns;
            for found in sound.run(until_s) {
                // A certificate without ε leaves no room for the designed hold, which is neither late nor a fault.
                let held = sound.certificate.epsilon == 0.0 && found.verdict == Verdict::DesignedHold;
                assert!(found.verdict == Verdict::Certified || held, "{kind} at {period_ns} ns: {found:?}");
                assert!(found.psi_max <= sound.certificate.psi_allowed() + 1e-9, "{kind}: {found:?}");
            }
        }
    }
}

#[test]
fn a_loop_keeps_promise_a_while_every_interval_is_certified() {
    let sound = Loop::default();
    for found in sound.run(4.0) {
        assert_eq!(found.verdict, Verdict::Certified);
        assert!(found.v_end <= sound.certificate.promised(found.v_start, 1e-3));
    }
}

#[test]
fn a_reversed_torque_is_laid_to_the_controller() {
    let reversed = Loop { factor: -1.0, ..Loop::default() };
    let verdicts = reversed.verdicts(1.0);
    assert!(verdicts.contains(&Verdict::ControllerFault));
    assert!(!verdicts.contains(&Verdict::UncertaintyExceeded));
    assert!(!verdicts.contains(&Verdict::Latency));
}

#[test]
fn an_unstable_period_of_2_2_ms_is_designed_until_v_leaves_the_level_and_latency_where_it_does() {
    let slow = Loop { period_ns: 2_200_000, ..Loop::default() };
    let found = slow.run(1.0);
    let level = slow.certificate.level;
    assert!(found.iter().any(|f| f.verdict == Verdict::DesignedHold));
    assert!(found.iter().any(|f| f.verdict == Verdict::Latency));
    for f in found.iter().filter(|f| f.v_start <= level && f.verdict != Verdict::Certified) {
        let expected = if f.v_end <= level { Verdict::DesignedHold } else { Verdict::Latency };
        assert_eq!(f.verdict, expected, "{f:?}");
    }
}

#[test]
fn a_late_torque_is_latency_unless_the_hold_alone_suffices() {
    let gains = Gains { level: 20.0, ..Gains::of(LawKind::Ctc) };
    let sound = Loop::new(LawKind::Ctc, &gains, 0.0);
    let held =
        sound.run(1.0).into_iter().find(|f| f.verdict == Verdict::DesignedHold).expect("an exact model has no room");
    let diagnosis = Diagnosis {
        truth: &sound.truth,
        certificate: &sound.certificate,
        law: Some(&sound.law),
        step_max_ns: 1_000_000,
    };
    let setpoint = Trajectory::<3>::of_the_paper().at(1.0);
    let now = input(&held.end, &setpoint);
    let verdict = |answered: LawInput<3>, late: bool| {
        let tau = sound.law.torque(&answered);
        let segment = Segment { to_ns: 1_001_000_000, tau, answered: Some(answered), scheduled: Some(now), late };
        diagnosis.interval(&held.end, &setpoint, 1_000_000_000, &[segment])
    };
    let older = LawInput { v: now.v + Vector::repeat(0.2), ..now };
    let late = [older, LawInput { v: now.v - Vector::repeat(0.2), ..now }].map(|sample| verdict(sample, true));
    // One of the two errs to the wrong side: what the hold does not explain is late.
    let worse = late.iter().find(|f| f.x > 1e-3).expect("one pushes V up");
    assert_eq!(worse.verdict, Verdict::Latency, "{worse:?}");
    // The very torque that was scheduled is no more to blame for having been flagged.
    let same = verdict(now, true);
    assert!(matches!(same.verdict, Verdict::Certified | Verdict::DesignedHold), "{same:?}");
}

#[test]
fn a_torque_that_answers_no_sample_is_fallback_and_a_given_one_that_is_not_the_laws_answer_is_a_fault() {
    let sound = Loop::default();
    let diagnosis = Diagnosis {
        truth: &sound.truth,
        certificate: &sound.certificate,
        law: Some(&sound.law),
        step_max_ns: 1_000_000,
    };
    let setpoint = Trajectory::<3>::of_the_paper().at(0.0);
    let state = PlantState { q: Vector::<3>::new(0.2, -0.1, 0.15), v: Vector::<3>::new(0.2, -0.2, 0.2) };
    let sample = input(&state, &setpoint);
    let wrong = -sound.law.torque(&sample);
    let verdict = |answered: Option<LawInput<3>>| {
        let segment = Segment { to_ns: 1_000_000, tau: wrong, answered, scheduled: Some(sample), late: true };
        diagnosis.interval(&state, &setpoint, 0, &[segment])
    };
    let (own, given) = (verdict(None), verdict(Some(sample)));
    assert_eq!((own.verdict, given.verdict), (Verdict::Fallback, Verdict::ControllerFault), "{own:?} {given:?}");
    assert_eq!((own.int_f, given.int_f_own), (0.0, 0.0));
    // What one calls the wrong torque, the other splits into the age of the sample and the wrong torque.
    assert!((own.int_f_own - given.int_l - given.int_f).abs() < 1e-9, "{own:?} {given:?}");
}

#[test]
fn lateness_is_what_the_designed_hold_does_not_explain() {
    let sound = Loop::default();
    let diagnosis = Diagnosis {
        truth: &sound.truth,
        certificate: &sound.certificate,
        law: Some(&sound.law),
        step_max_ns: 1_000_000,
    };
    let setpoint = Trajectory::<3>::of_the_paper().at(0.0);
    let state = PlantState { q: Vector::<3>::new(0.3, -0.2, 0.25), v: Vector::<3>::zeros() };
    let (now, before) = (input(&state, &setpoint), LawInput { v: Vector::repeat(0.5), ..input(&state, &setpoint) });
    let segment = |sample: LawInput<3>| Segment {
        to_ns: 1_000_000,
        tau: sound.law.torque(&sample),
        answered: Some(sample),
        scheduled: Some(now),
        late: false,
    };
    let on_time = diagnosis.interval(&state, &setpoint, 0, &[segment(now)]);
    assert_eq!(on_time.int_l.to_bits(), on_time.int_l_scheduled.to_bits());
    let late = diagnosis.interval(&state, &setpoint, 0, &[segment(before)]);
    assert!((late.int_l - late.int_l_scheduled).abs() > 1e-3, "{late:?}");
}

#[test]
fn a_disturbance_far_beyond_the_declared_one_is_laid_to_the_uncertainty() {
    // 60 N·m is 5.5 times what C1 = 40 has room for; 140 shows at once.
    for (norm, within) in [(60.0, 10), (140.0, 2)] {
        let pushed = pushed(norm);
        let found = pushed.run(0.55);
        let first = found.iter().position(|f| f.verdict == Verdict::UncertaintyExceeded).unwrap();
        assert!((500..500 + within).contains(&first), "{norm} N·m: {first}");
        // The interval that ends with the onset sees it at its end.
        assert_eq!(found.iter().position(|f| f.psi_max > pushed.certificate.psi_allowed()), Some(499));
    }
}

#[test]
fn a_broken_assumption_shows_in_psi_long_before_it_shows_in_v() {
    // 30 N·m is 2.8 times what is certified. V does not betray it; Ψ does once gravity adds up with it.
    let pushed = pushed(30.0);
    let found = pushed.run(12.0);
    assert!(found.iter().all(|f| f.verdict == Verdict::Certified));
    assert!(found[..490].iter().all(|f| f.psi_max < pushed.certificate.psi_allowed()));
    assert!(found.iter().any(|f| f.psi_max > pushed.certificate.psi_allowed()));
}

/// The default loop with a disturbance of a given norm from 0.5 s on, the same in all links.
fn pushed(norm_nm: f64) -> Loop {
    let mut pushed = Loop::default();
    pushed.truth.disturbance = Disturbance::Step { at_s: 0.5, value_nm: [-norm_nm / 3.0f64.sqrt(); 3] };
    pushed
}

#[test]
fn a_torque_held_for_the_hold_limit_keeps_v_below_the_level() {
    let sound = Loop::new(LawKind::Robust, &Gains::of(LawKind::Robust), 10.8);
    let (cert, reference) = (&sound.certificate, Trajectory::<3>::of_the_paper());
    let (mut held, mut reached) = (0, 0.0f64);
    for case in 0..200 {
        let draw = |first: u32| {
            Vector::<3>::from_fn(|i, _| {
                uniform(5, Stream::Test, case, first + u32::from(i > 0) + u32::from(i > 1)) - 0.5
            })
        };
        let mut truth = sound.truth.clone();
        truth.disturbance = Disturbance::Constant { value_nm: (draw(6).normalize() * 10.8).into() };
        let mut state = PlantState { q: draw(0) * 0.5, v: draw(3) * 4.0 };
        let sample = input(&state, &reference.at(0.0));
        let (v, tau) = (cert.v(&truth.chain, &sample), sound.law.torque(&sample));
        let hold_s = crate::certificate::sampling::hold_limit_s(cert, v, tau.norm());
        for step in 0..20 {
            let h_s = hold_s / 20.0;
            state = crate::integrator::rk4_step(&truth, &state, &tau, f64::from(step) * h_s, h_s);
            let v = cert.v(&truth.chain, &input(&state, &reference.at(f64::from(step + 1) * h_s)));
            assert!(hold_s == 0.0 || v <= cert.level, "case {case}: {v}");
            reached = reached.max(if hold_s > 0.0 { v } else { 0.0 });
        }
        held += i32::from(hold_s > 0.0);
    }
    assert!(held > 100 && reached > 0.1 * cert.level, "{held} holds reached {reached}");
}

#[test]
fn above_the_level_or_without_a_law_or_a_certificate_nothing_is_diagnosed() {
    let mut outside = Loop::default();
    outside.certificate.level = 1.0;
    assert_eq!(outside.verdicts(0.001), [Verdict::OutsideLevel]);
    let mut blank = Loop::default();
    blank.certificate.certified = false;
    assert_eq!(blank.verdicts(0.001), [Verdict::NotCertified]);
    let sound = Loop::default();
    let foreign = Diagnosis { truth: &sound.truth, certificate: &sound.certificate, law: None, step_max_ns: 1_000_000 };
    let state = PlantState { q: Vector::<3>::zeros(), v: Vector::<3>::zeros() };
    let setpoint = Trajectory::<3>::of_the_paper().at(0.0);
    assert_eq!(foreign.interval(&state, &setpoint, 0, &[]).verdict, Verdict::NotCertified);
}

#[test]
fn the_end_of_an_interval_is_bit_for_bit_the_plants() {
    let sound = Loop::default();
    let diagnosis = Diagnosis {
        truth: &sound.truth,
        certificate: &sound.certificate,
        law: Some(&sound.law),
        step_max_ns: 1_000_000,
    };
    let state = PlantState { q: Vector::<3>::new(0.3, -0.2, 0.25), v: Vector::<3>::new(1.0, -2.0, 3.0) };
    let tau = [Vector::<3>::new(1.0, 2.0, 3.0), Vector::<3>::new(-4.0, 5.0, 0.5)];
    let segment = |to_ns, tau| Segment { to_ns, tau, answered: None, scheduled: None, late: false };
    let setpoint = Trajectory::<3>::of_the_paper().at(0.0);
    let found = diagnosis.interval(&state, &setpoint, 0, &[segment(300_000, tau[0]), segment(1_000_000, tau[1])]);
    let middle = crate::integrator::integrate(&sound.truth, &state, &tau[0], 0, 300_000, 1_000_000);
    let end = crate::integrator::integrate(&sound.truth, &middle, &tau[1], 300_000, 1_000_000, 1_000_000);
    assert_eq!((found.end.q, found.end.v), (end.q, end.v));
}
