//! What the paper's study runs: the laws with their gains, the cases, and the scenario of each pair.

use loopbound_model::certificate::sampling::sampling_budget;
use loopbound_model::certificate::start::StartError;
use loopbound_model::certificate::{Certificate, Gains};
use loopbound_model::law::{Gain, LawKind, certificate};
use loopbound_scenario::system;
use loopbound_scenario::{DisturbanceKind, DisturbanceSpec, Hertz, Mode, Nanos, PerLink, Scenario, ScenarioError};

/// Amplitude of the disturbance on each link, N·m.
pub const DISTURBANCE_NM: f64 = 2.0;
/// Standard deviation of the measurement in the case of noise, rad and rad/s.
pub const NOISE: f64 = 1e-3;

/// A law with gains that stay the same in all cases.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// In tables and legends.
    pub name: String,
    /// The law.
    pub law: LawKind,
    /// K_p and K_d, for `ctc` and `pd+g`.
    pub k_p_k_d: Option<(f64, f64)>,
}

/// What is not ideal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Case {
    /// Nothing.
    Exact,
    /// The true masses are those of the model times 1 + this.
    Mass(f64),
    /// Torques of [`DISTURBANCE_NM`] at different frequencies.
    Disturbance,
    /// Measurement noise of [`NOISE`].
    Noise,
    /// Each torque acts so much later, s.
    Latency(f64),
}

impl Case {
    /// Every case of the study.
    pub const ALL: [Self; 12] = [
        Self::Exact,
        Self::Mass(0.1),
        Self::Mass(-0.1),
        Self::Mass(0.2),
        Self::Mass(-0.2),
        Self::Disturbance,
        Self::Noise,
        Self::Latency(0.25e-3),
        Self::Latency(0.5e-3),
        Self::Latency(1e-3),
        Self::Latency(1.5e-3),
        Self::Latency(2e-3),
    ];

    /// In tables.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Exact => "exact".to_owned(),
            Self::Mass(s) => format!("mass {}{:.0} %", if s < 0.0 { '\u{2212}' } else { '+' }, s.abs() * 100.0),
            Self::Disturbance => "disturbance".to_owned(),
            Self::Noise => "noise".to_owned(),
            Self::Latency(s) => format!("latency {} ms", s * 1e3),
        }
    }

    /// Puts the case into a scenario, and declares to its certificate what is to be declared.
    fn apply(self, scenario: &mut Scenario) {
        let links = scenario.links();
        let cycled = |values: [f64; 3]| PerLink::Each(values.iter().copied().cycle().take(links).collect());
        match self {
            Self::Exact => {}
            Self::Mass(s) => {
                scenario.plant.mass_error = Some(PerLink::All(s));
                scenario.controller.uncertainty.mass = s.abs();
            }
            Self::Disturbance => {
                scenario.plant.disturbance.push(DisturbanceSpec {
                    kind: DisturbanceKind::Sine,
                    value_nm: None,
                    amplitude_nm: Some(PerLink::All(DISTURBANCE_NM)),
                    omega_rad_s: Some(cycled([3.0, 2.0, 5.0])),
                    phase_rad: Some(cycled([0.0, std::f64::consts::FRAC_PI_2, 0.0])),
                    at: None,
                    rms_nm: None,
                    low_hz: None,
                    high_hz: None,
                });
                // Rounded up, so that rounding never makes the declared bound the smaller one.
                scenario.controller.uncertainty.disturbance_nm = DISTURBANCE_NM * (links as f64).sqrt() * (1.0 + 1e-9);
            }
            Self::Noise => {
                scenario.plant.noise.q_rad = NOISE;
                scenario.plant.noise.v_rad_s = NOISE;
            }
            Self::Latency(s) => scenario.plant.actuation_delay = nanos(s),
        }
    }
}

/// Seconds as whole nanoseconds.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "durations of studies are positive and short"
)]
pub fn nanos(s: f64) -> Nanos {
    Nanos((s * 1e9).round() as u64)
}

/// The laws of the study. Both robust laws get the same K_t, and computed torque is there twice: the paper names no
/// gains, and the comparison depends on them.
#[must_use]
pub fn variants() -> Vec<Variant> {
    let with = |name: &str, law, k_p_k_d| Variant { name: name.to_owned(), law, k_p_k_d };
    vec![
        with("robust", LawKind::Robust, None),
        with("robust-ff", LawKind::RobustFf, None),
        with("ctc 25/10", LawKind::Ctc, Some((25.0, 10.0))),
        with("ctc 100/20", LawKind::Ctc, Some((100.0, 20.0))),
        with("pd+g 25/10", LawKind::PdG, Some((25.0, 10.0))),
    ]
}

/// The scenario that all cases of a study begin from.
#[derive(Clone, Debug, PartialEq)]
pub struct Base {
    /// Without a case, with the default law.
    pub scenario: Scenario,
    /// K_t of both robust laws, N·m·s.
    pub k_t: f64,
}

impl Base {
    /// For `N` links. Three links are the default scenario itself. For others C1 covers what \[6] requires and the
    /// disturbance, c the start, and the rate is the first of 1, 2, 5, 10, 20 kHz that uses at most 60 % of \[11].
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn new<const N: usize>(quick: bool) -> Result<Self, ScenarioError> {
        let mut scenario = Scenario::default();
        scenario.loop_.mode = Mode::Lockstep;
        scenario.plant.links = Some(N);
        if N != 3 {
            let envelope = system::assumptions::<N>(&scenario)?.envelope();
            let needed = certificate(LawKind::Robust, &envelope, &system::gains(&scenario, LawKind::Robust), None);
            scenario.controller.gains.c1 = Some((needed.c1_required() + DISTURBANCE_NM * (N as f64).sqrt()).ceil());
            scenario.controller.gains.level = needed_level::<N>(&scenario)?;
        }
        let found = system::certificate_of::<N>(&scenario, LawKind::Robust)?;
        let fits = |rate: &f64| sampling_budget(&found, 1.0 / rate, 0.0).is_some_and(|budget| budget.used <= 0.6);
        let rate_hz = [1e3, 2e3, 5e3, 1e4, 2e4].into_iter().find(fits).unwrap_or(5e4);
        scenario.loop_.rate = Hertz(rate_hz);
        // About as many ticks for every rate: a study is to take seconds.
        let duration_s = (if quick { 16.0 } else { 40.0 } * 1e3 / rate_hz).max(if quick { 6.0 } else { 12.0 });
        scenario.loop_.duration = nanos(duration_s);
        scenario.loop_.settle = Some(nanos((duration_s / 2.0).min(10.0)));
        Ok(Self { scenario, k_t: found.k_t() })
    }

    /// The scenario of a law in a case. The gains of the law are the same in every case; how they are accounted for is
    /// searched anew for each, so that a certificate is missing only where none of this form exists on the grid.
    ///
    /// # Errors
    /// If the scenario describes no system.
    pub fn scenario<const N: usize>(&self, variant: &Variant, case: Case) -> Result<Scenario, ScenarioError> {
        let mut scenario = self.scenario.clone();
        scenario.controller.law = variant.law;
        scenario.controller.gains.k_t = Some(self.k_t);
        if let Some((k_p, k_d)) = variant.k_p_k_d {
            (scenario.controller.gains.kp, scenario.controller.gains.kd) = (k_p, k_d);
        }
        case.apply(&mut scenario);
        account::<N>(&mut scenario)?;
        scenario.validate()?;
        Ok(scenario)
    }
}

/// A level just above V(0) of `robust`.
fn needed_level<const N: usize>(scenario: &Scenario) -> Result<f64, ScenarioError> {
    let assumptions = system::assumptions::<N>(scenario)?;
    let start = StartError::of(&assumptions.nominal, &system::start::<N>(scenario)?);
    let gains = system::gains(scenario, LawKind::Robust);
    let v_start = certificate(LawKind::Robust, &assumptions.envelope(), &gains, Some(&start)).v_start;
    Ok((v_start * 1.05 * 10.0).ceil() / 10.0)
}

/// Chooses c, K3, C1 and K2 such that the certificate of the law as it is promises the smallest limsup |e|; leaves all
/// as it is where none certifies.
fn account<const N: usize>(scenario: &mut Scenario) -> Result<(), ScenarioError> {
    let law = scenario.controller.law;
    let assumptions = system::assumptions::<N>(scenario)?;
    let (envelope, start) =
        (assumptions.envelope(), StartError::of(&assumptions.nominal, &system::start::<N>(scenario)?));
    let base = system::gains(scenario, law);
    let mut best: Option<(Certificate, f64, f64)> = None;
    for level_step in 0..32 {
        let level = libm::exp2(f64::from(level_step) * 0.25 - 2.0);
        let k3_steps = if law.uses(Gain::KTotal) { 25 } else { 1 };
        let k2_steps = if law == LawKind::RobustFf { 6 } else { 1 };
        for (k3_step, k2_step) in (0..k3_steps).flat_map(|a| (0..k2_steps).map(move |b| (a, b))) {
            let k3 = libm::exp2(f64::from(k3_step) * 0.25) * 0.008;
            let k2 = base.k2 * libm::exp2(f64::from(k2_step - 1));
            let found = certificate(law, &envelope, &Gains { level, k3, k2, c1: None, ..base }, Some(&start));
            if found.is_certified() && best.as_ref().is_none_or(|(b, ..)| found.ultimate_e < b.ultimate_e) {
                best = Some((found, k3, k2));
            }
        }
    }
    if let Some((found, k3, k2)) = best {
        let gains = &mut scenario.controller.gains;
        (gains.level, gains.k3, gains.k2) = (found.level, k3, k2);
        if law.c1_nm().is_some() {
            gains.c1 = Some(found.c1_required());
        }
    }
    Ok(())
}
