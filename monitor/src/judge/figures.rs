//! The figures of the bound, law by law. V, its level, C1, ‖W‖ and what was observed of them belong to one law with its
//! gains: those of two are never mixed. Counts are kept for the whole run as well.

use loopbound_model::bound::diagnose::{IntervalDiagnosis, Verdict};
use loopbound_model::certificate::Certificate;
use loopbound_model::certificate::sampling::sampling_budget_with_jitter;

use super::CertifiedLaw;
use crate::summary::{BoundSummary, LawSummary, finite};

/// Laws whose figures are kept apart; beyond them the oldest is forgotten, and only its counts stay.
const LAWS_MAX: usize = 64;

const VERDICTS: [(Verdict, &str); 8] = [
    (Verdict::Certified, "certified"),
    (Verdict::Latency, "latency"),
    (Verdict::DesignedHold, "designed_hold"),
    (Verdict::Fallback, "fallback"),
    (Verdict::ControllerFault, "controller_fault"),
    (Verdict::UncertaintyExceeded, "uncertainty_exceeded"),
    (Verdict::OutsideLevel, "outside_level"),
    (Verdict::NotCertified, "not_certified"),
];

/// The key of a verdict in files.
pub(super) fn name_of(verdict: Verdict) -> &'static str {
    VERDICTS.iter().find(|(of, _)| *of == verdict).map_or("not_certified", |(_, name)| name)
}

#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    checked: u64,
    violations: u64,
    delay_aware: u64,
    promise: u64,
    verdicts: [u64; VERDICTS.len()],
}

/// What was seen under one law.
#[derive(Clone, Debug)]
pub(super) struct OfLaw<const N: usize> {
    claim: Option<CertifiedLaw<N>>,
    /// What the controller that had it last calls itself.
    name: Option<String>,
    controllers: Vec<u32>,
    /// Ticks for which it was in charge, and the first and the last of them.
    ticks: u64,
    span: Option<(u64, u64)>,
    counts: Counts,
    promises: u64,
    v_start: Option<f64>,
    v_max: Option<f64>,
    v_final: Option<f64>,
    psi_max: Option<f64>,
    slack_min: Option<f64>,
    slack_sum: f64,
    w_max_settled: Option<f64>,
}

/// The figures of a run.
#[derive(Debug)]
pub(super) struct Figures<const N: usize> {
    /// In the order in which they first were in charge.
    laws: Vec<OfLaw<N>>,
    /// The one that is in charge now.
    current: Option<usize>,
    total: Counts,
}

impl<const N: usize> Default for Figures<N> {
    fn default() -> Self {
        Self { laws: Vec::with_capacity(LAWS_MAX), current: None, total: Counts::default() }
    }
}

impl<const N: usize> Figures<N> {
    /// A controller is in charge, with the law that is known of it, and what it calls itself. The places of laws that are known
    /// already are kept; an unknown law is a controller's own.
    pub(super) fn turn_to(&mut self, controller: u32, claim: Option<&CertifiedLaw<N>>, name: Option<&str>) {
        let is_it = |of: &OfLaw<N>| match (&of.claim, claim) {
            (Some(known), Some(claim)) => known.law == claim.law,
            (None, None) => of.controllers.contains(&controller),
            _ => false,
        };
        let unchanged =
            self.current.is_some_and(|at| is_it(&self.laws[at]) && self.laws[at].controllers.contains(&controller));
        if unchanged {
            return;
        }
        let at = self.laws.iter().position(is_it).unwrap_or_else(|| {
            if self.laws.len() == LAWS_MAX {
                self.laws.remove(0);
            }
            self.laws.push(OfLaw::new(claim.cloned()));
            self.laws.len() - 1
        });
        let of = &mut self.laws[at];
        if controller != 0 && !of.controllers.contains(&controller) {
            of.controllers.push(controller);
        }
        of.name = name.map(str::to_owned).or_else(|| of.name.take());
        self.current = Some(at);
    }

    /// Those of whoever is in charge.
    pub(super) fn current(&mut self) -> Option<&mut OfLaw<N>> {
        self.laws.get_mut(self.current?)
    }

    /// A tick was checked; whether it broke the bound.
    pub(super) fn note_diagnosis(&mut self, found: &IntervalDiagnosis<N>) -> bool {
        let at = VERDICTS.iter().position(|(verdict, _)| *verdict == found.verdict).unwrap_or(VERDICTS.len() - 1);
        let violated = found.verdict.is_violation();
        let aware = violated && !found.verdict.is_explained_by_delay();
        self.count(|counts| {
            // Above the level nothing is promised, and so nothing is checked.
            counts.checked += u64::from(found.verdict != Verdict::OutsideLevel);
            counts.verdicts[at] += 1;
            counts.violations += u64::from(violated);
            counts.delay_aware += u64::from(aware);
        });
        if let Some(of) = self.current() {
            of.psi_max = largest(of.psi_max, found.psi_max);
        }
        violated
    }

    /// A promise was due: its right side less V, and whether it was broken.
    pub(super) fn note_promise(&mut self, slack: f64, broken: bool) {
        self.count(|counts| counts.promise += u64::from(broken));
        if let Some(of) = self.current() {
            of.promises += 1;
            of.slack_min = Some(of.slack_min.map_or(slack, |least| least.min(slack)));
            of.slack_sum += slack;
        }
    }

    fn count(&mut self, add: impl Fn(&mut Counts)) {
        add(&mut self.total);
        if let Some(of) = self.current() {
            add(&mut of.counts);
        }
    }

    /// The figures so far: those of the law in charge last, with the counts of the whole run and the list of all laws.
    /// `unseen` stands for a run in which nobody has been in charge yet.
    pub(super) fn summary(&self, unseen: Option<&CertifiedLaw<N>>) -> BoundSummary {
        let mut summary = match self.current.and_then(|at| self.laws.get(at)) {
            Some(of) => of.summary(),
            None => OfLaw::new(unseen.cloned()).summary(),
        };
        self.total.put(&mut summary);
        // A law whose turn was over before its first tick has no figures.
        let seen = self.laws.iter().filter(|of| of.ticks > 0);
        summary.laws = seen
            .map(|of| LawSummary {
                controllers: of.controllers.clone(),
                ticks: of.ticks,
                first_tick: of.span.map(|(first, _)| first),
                last_tick: of.span.map(|(_, last)| last),
                bound: of.summary(),
            })
            .collect();
        summary
    }
}

impl<const N: usize> OfLaw<N> {
    fn new(claim: Option<CertifiedLaw<N>>) -> Self {
        Self {
            claim,
            name: None,
            controllers: Vec::new(),
            ticks: 0,
            span: None,
            counts: Counts::default(),
            promises: 0,
            v_start: None,
            v_max: None,
            v_final: None,
            psi_max: None,
            slack_min: None,
            slack_sum: 0.0,
            w_max_settled: None,
        }
    }

    /// It was in charge of a tick.
    pub(super) fn note_tick(&mut self, tick: u64) {
        self.ticks += 1;
        self.span = Some((self.span.map_or(tick, |(first, _)| first), tick));
    }

    /// V at the start of a tick of its own.
    pub(super) fn note_v(&mut self, v: f64) {
        self.v_start = self.v_start.or(finite(v));
        self.v_max = largest(self.v_max, v);
        self.v_final = finite(v);
    }

    /// ‖W‖ once settled.
    pub(super) fn note_w(&mut self, w: f64) {
        self.w_max_settled = largest(self.w_max_settled, w);
    }

    fn summary(&self) -> BoundSummary {
        let mut summary = BoundSummary {
            name: self.name.clone(),
            v_start: self.v_start,
            v_max: self.v_max.and_then(finite),
            v_final: self.v_final,
            psi_max: self.psi_max.and_then(finite),
            slack_min: self.slack_min.and_then(finite),
            slack_mean: if self.promises > 0 { finite(self.slack_sum / self.promises as f64) } else { None },
            w_norm_max_settled: self.w_max_settled.and_then(finite),
            ..BoundSummary::default()
        };
        self.counts.put(&mut summary);
        if let Some(claim) = &self.claim {
            put_certificate(&mut summary, claim);
        }
        summary
    }
}

impl Counts {
    fn put(&self, summary: &mut BoundSummary) {
        summary.checked = self.checked;
        summary.violations = self.violations;
        summary.violations_delay_aware = self.delay_aware;
        summary.violations_promise = self.promise;
        summary.verdicts = VERDICTS.iter().zip(self.verdicts).map(|((_, name), n)| ((*name).to_owned(), n)).collect();
    }
}

fn put_certificate<const N: usize>(summary: &mut BoundSummary, claim: &CertifiedLaw<N>) {
    let certificate = &claim.certificate;
    summary.law = Some(claim.law.kind.name().to_owned());
    let units = claim.law.kind.units();
    (summary.v_unit, summary.psi_unit) = (Some(units.v.to_owned()), Some(units.psi.to_owned()));
    summary.certified = certificate.is_certified();
    summary.shortfalls.clone_from(&claim.shortfalls);
    summary.outside.clone_from(&claim.outside);
    summary.level = finite(certificate.level);
    if let Some(on_r) = certificate.on_r() {
        summary.k_t = finite(claim.law.k_t);
        summary.kappa = finite(on_r.kappa);
    }
    if certificate.is_certified() {
        summary.alpha = finite(certificate.alpha);
        summary.epsilon = finite(certificate.epsilon);
        summary.c1 = finite(certificate.psi_allowed());
        summary.uub_radius = finite(certificate.w_norm);
        summary.ultimate_bound = finite(certificate.ultimate_e);
        summary.ultimate_bound_link = finite(certificate.ultimate_e_link());
    }
}

/// What of the room that sampling leaves is used by a period and a delay between the two ends of a range.
pub(super) fn put_budget(
    summary: &mut BoundSummary,
    certificate: &Certificate,
    period_ns: u64,
    range_ns: Option<(f64, f64)>,
) {
    let Some((least_ns, most_ns)) = range_ns else { return };
    (summary.loop_latency_min_ns, summary.loop_latency_ns) = (Some(least_ns), Some(most_ns));
    let period_s = period_ns as f64 * 1e-9;
    if let Some(budget) = sampling_budget_with_jitter(certificate, period_s, least_ns * 1e-9, most_ns * 1e-9) {
        summary.budget_used = finite(budget.used);
        summary.budget_rule = Some(budget.rule.name().to_owned());
        summary.delay_margin_ns = finite(budget.delay_margin_s * 1e9);
    }
}

/// The larger one; what is not finite counts as infinite and ends as `null`.
fn largest(so_far: Option<f64>, value: f64) -> Option<f64> {
    let value = if value.is_nan() { f64::INFINITY } else { value };
    Some(so_far.map_or(value, |most| most.max(value)))
}
