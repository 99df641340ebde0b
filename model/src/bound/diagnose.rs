//! Whether an interval kept the bound, and if not whose fault it was: diagnosis (b).
//!
//! The torque τ that acts at t was computed from a sample taken at s ≤ t. Exactly,
//!
//! ```text
//! V̇ ≤ [8] + rᵀ(τ_law(t) − τ_law(s)) + rᵀ(τ_law(s) − τ)                                                       [10]
//!            latency L                  controller F
//! ```
//!
//! (in `ctc` M⁻¹(½K_d e + ė) has the place of r). The signs stay: with |r||Δτ| instead, faults would hide behind the
//! latency. All integrals run along the plant's own Runge–Kutta steps, so that no tolerance has to be tuned. F falls into
//! two parts: F₀ of the plant's own damping and stop, which answer no sample, and F₁ of torques that somebody gave. For
//! the excess X = ΔV − ∫\[8] the first of X, X − ∫L, X − ∫L − ∫F₀, X − ∫L − ∫F that is not positive names the verdict.
//!
//! L holds the *designed hold* too: the age that the period, the declared delays and the limit of lateness allow, with
//! the measurement error of the sample. Where ∫L suffices, it is the designed hold if no torque was late, or if ∫L of
//! the scheduled sample suffices as well; else it is latency. A V that leaves the certified level is not excused by design.
//!
//! No allocation: this runs for every tick.

use crate::certificate::Certificate;
use crate::certificate::lyapunov::Observed;
use crate::chain::Vector;
use crate::input::LawInput;
use crate::integrator::{PlantState, integrate_with};
use crate::law::Law;
use crate::trajectory::SetpointValue;
use crate::truth::Truth;

/// A stretch of time under one torque.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment<const N: usize> {
    /// Until when the torque acted, ns of plant time; a segment begins where the one before it ends.
    pub to_ns: u64,
    /// The torque that acted (after limits), N·m.
    pub tau: Vector<N>,
    /// The sample that it answers, as the controller got it; none when it answers none (start-up, damping).
    pub answered: Option<LawInput<N>>,
    /// The sample that should have been answered by the schedule: that of the tick itself. None where that isn't one
    /// sample for the whole segment.
    pub scheduled: Option<LawInput<N>>,
    /// Whether the torque acted for longer than the schedule allows: its successor came late, or not at all.
    pub late: bool,
}

/// What stays the same from interval to interval.
#[derive(Clone, Copy, Debug)]
pub struct Diagnosis<'a, const N: usize> {
    /// The plant as it really is.
    pub truth: &'a Truth<N>,
    /// What was promised.
    pub certificate: &'a Certificate,
    /// The law that was announced, with its gains; none for a foreign law: nothing is then attributed.
    pub law: Option<&'a Law<N>>,
    /// The plant's longest integration step, ns.
    pub step_max_ns: u64,
}

/// What became of the promise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// V fell as promised.
    Certified,
    /// It did not, and the age of the torque suffices as the cause: a torque was late, or V left the certified level.
    Latency,
    /// It did not, and the age that the loop is designed for suffices as the cause: no torque was late, and V ≤ c.
    DesignedHold,
    /// The plant damped or stopped by itself, since no torque came, and that suffices as the cause.
    Fallback,
    /// A torque that a controller gave was not the law's answer to its sample: a fault, or a limit.
    ControllerFault,
    /// The uncertainty was larger than declared, or the certificate's model is wrong.
    UncertaintyExceeded,
    /// V was above the certified level at the start: nothing is promised there.
    OutsideLevel,
    /// There is no certificate, or the law is not known.
    NotCertified,
}

impl Verdict {
    /// Whether V did not fall as promised although it was within the certified level. \[10]
    #[must_use]
    pub fn is_violation(self) -> bool {
        match self {
            Self::Certified | Self::OutsideLevel | Self::NotCertified => false,
            Self::Latency | Self::DesignedHold | Self::Fallback | Self::ControllerFault | Self::UncertaintyExceeded => {
                true
            }
        }
    }

    /// Whether a violation comes from torques that were old, or did not come at all.
    #[must_use]
    pub fn is_explained_by_delay(self) -> bool {
        matches!(self, Self::Latency | Self::DesignedHold | Self::Fallback)
    }
}

/// The sums of one interval. Units of V throughout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntervalDiagnosis<const N: usize> {
    /// State at the end, bit for bit the plant's.
    pub end: PlantState<N>,
    /// V at the start.
    pub v_start: f64,
    /// V at the end, with the setpoint extrapolated from the start.
    pub v_end: f64,
    /// X = ΔV − ∫\[8].
    pub x: f64,
    /// ∫L for the samples that were answered.
    pub int_l: f64,
    /// ∫L for the samples that were scheduled; ∫L less this is lateness.
    pub int_l_scheduled: f64,
    /// ∫F₀: of torques that answer no sample, the plant's own.
    pub int_f_own: f64,
    /// ∫F₁: of torques that a controller gave.
    pub int_f: f64,
    /// The largest observed Ψ less its κ terms at ends of segments, to be held against `Certificate::psi_allowed`.
    pub psi_max: f64,
    /// What it comes to.
    pub verdict: Verdict,
}

impl<const N: usize> Diagnosis<'_, N> {
    /// Diagnoses the interval from `from_ns` (ns of plant time) to the end of the last segment.
    ///
    /// `start` is the true state and `setpoint` the setpoint, both at `from_ns`; the setpoint is extrapolated inside.
    #[must_use]
    pub fn interval(
        &self,
        start: &PlantState<N>,
        setpoint: &SetpointValue<N>,
        from_ns: u64,
        segments: &[Segment<N>],
    ) -> IntervalDiagnosis<N> {
        let from_s = from_ns as f64 * 1e-9;
        let seen = |state: &PlantState<N>, t_s: f64| input(state, &setpoint.extrapolate(t_s - from_s));
        let v_start = self.certificate.v(&self.truth.chain, &seen(start, from_s));
        let (mut state, mut at_ns, mut sums, mut psi_max) = (*start, from_ns, [0.0; 4], 0.0f64);
        let mut int_f_own = 0.0;
        for segment in segments {
            psi_max = psi_max.max(self.psi(&seen(&state, at_ns as f64 * 1e-9), &segment.tau, at_ns));
            let (end, parts) = self.segment(&state, at_ns, segment, &seen);
            (state, at_ns) = (end, segment.to_ns.max(at_ns));
            let [promised, l, l_scheduled, f] = parts;
            let (own, given) = if segment.answered.is_none() { (f, 0.0) } else { (0.0, f) };
            int_f_own += own;
            sums.iter_mut().zip([promised, l, l_scheduled, given]).for_each(|(sum, part)| *sum += part);
            psi_max = psi_max.max(self.psi(&seen(&state, at_ns as f64 * 1e-9), &segment.tau, at_ns));
        }
        let v_end = self.certificate.v(&self.truth.chain, &seen(&state, at_ns as f64 * 1e-9));
        let [promised, int_l, int_l_scheduled, int_f] = sums;
        let x = v_end - v_start - promised;
        let verdict = Verdict::NotCertified;
        let mut found = IntervalDiagnosis {
            end: state,
            v_start,
            v_end,
            x,
            int_l,
            int_l_scheduled,
            int_f_own,
            int_f,
            psi_max,
            verdict,
        };
        found.verdict = self.verdict(&found, segments.iter().any(|segment| segment.late));
        found
    }

    /// The end of a segment and the integrals of \[8], L, L as scheduled, F over it.
    fn segment(
        &self,
        start: &PlantState<N>,
        from_ns: u64,
        segment: &Segment<N>,
        seen: &impl Fn(&PlantState<N>, f64) -> LawInput<N>,
    ) -> (PlantState<N>, [f64; 4]) {
        let tau = segment.tau;
        let answer = |sample: &Option<LawInput<N>>| match (self.law, sample) {
            (Some(law), Some(sample)) => Some(law.torque(sample)),
            _ => None,
        };
        // A torque that answers no sample is not late: all that is wrong with it is F.
        let (answered, scheduled) = (answer(&segment.answered), answer(&segment.scheduled));
        let integrand = |t_s: f64, state: &PlantState<N>, _: &Vector<N>| {
            let x = seen(state, t_s);
            let promised = self.certificate.rate(&x);
            let Some(law) = self.law else { return [promised, 0.0, 0.0, 0.0] };
            let (now, lever) = (law.torque(&x), self.certificate.lever(&self.truth.chain, &x));
            let late = |from: Option<Vector<N>>| from.map_or(0.0, |torque| lever.dot(&(now - torque)));
            [promised, late(answered), late(scheduled), lever.dot(&(answered.unwrap_or(now) - tau))]
        };
        integrate_with(self.truth, start, &tau, from_ns, segment.to_ns, self.step_max_ns, integrand)
    }

    fn verdict(&self, found: &IntervalDiagnosis<N>, late: bool) -> Verdict {
        if !self.certificate.is_certified() || self.law.is_none() {
            return Verdict::NotCertified;
        }
        let IntervalDiagnosis { v_start, v_end, x, int_l, int_l_scheduled, int_f_own, int_f, .. } = *found;
        let level = self.certificate.level;
        if v_start.is_nan() || v_start > level {
            return Verdict::OutsideLevel;
        }
        // A hundred times the quadrature's error at 1 kHz; below it lies the rounding of V itself.
        let tolerance = 1e-6 * (1.0 + v_start);
        let suffices = |explained: f64| x - explained <= tolerance;
        if suffices(0.0) {
            Verdict::Certified
        } else if suffices(int_l) {
            let designed = v_end <= level && (!late || suffices(int_l_scheduled));
            if designed { Verdict::DesignedHold } else { Verdict::Latency }
        } else if suffices(int_l + int_f_own) {
            Verdict::Fallback
        } else if suffices(int_l + int_f_own + int_f) {
            Verdict::ControllerFault
        } else {
            Verdict::UncertaintyExceeded
        }
    }

    fn psi(&self, x: &LawInput<N>, tau: &Vector<N>, at_ns: u64) -> f64 {
        let Some(law) = self.law else { return 0.0 };
        let disturbance = self.truth.disturbance(at_ns as f64 * 1e-9);
        self.certificate.psi_observed(&Observed {
            true_chain: &self.truth.chain,
            x,
            acceleration: &self.truth.acceleration(&x.q, &x.v, tau, &disturbance),
            tau,
            law_torque: &law.torque(x),
            fed_forward: &law.fed_forward(x),
        })
    }
}

/// A state and a setpoint at the same instant.
fn input<const N: usize>(state: &PlantState<N>, setpoint: &SetpointValue<N>) -> LawInput<N> {
    LawInput { q: state.q, v: state.v, q_d: setpoint.q_d, v_d: setpoint.v_d, a_d: setpoint.a_d }
}

#[cfg(test)]
mod tests;
