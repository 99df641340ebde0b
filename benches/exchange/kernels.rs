//! The mathematics of a tick, in ns a call: batches of every kernel in turn, round after round, and their medians.

use std::hint::black_box;

use anyhow::Result;
use loopbound_model::chain::{Chain, Vector};
use loopbound_model::integrator::{PlantState, rk4_step};
use loopbound_model::law::{LawInput, LawKind};
use loopbound_model::rng::{Stream, uniform};
use loopbound_scenario::Scenario;
use loopbound_scenario::system;
use loopbound_shared::clock;
use serde::Serialize;

use crate::statistics::median;

/// Calls in a batch: far longer than a look at the clock.
const BATCH: u16 = 1024;
/// States that the calls go through, so that no branch can be learned by heart.
const STATES: usize = 64;
/// What forward dynamics of three links may cost.
const FORWARD_AIM_NS: f64 = 100.0;
/// The kernel that the aim is for.
const FORWARD: &str = "forward dynamics";

/// A kernel's cost for one number of links.
#[derive(Debug, Serialize)]
pub(crate) struct Kernel {
    pub(crate) name: &'static str,
    pub(crate) links: usize,
    /// Median over the batches.
    pub(crate) median_ns: f64,
    /// 10 % of the batches were faster …
    pub(crate) p10_ns: f64,
    /// … and 10 % slower than this.
    pub(crate) p90_ns: f64,
    pub(crate) batches: usize,
    pub(crate) aim_ns: Option<f64>,
}

/// Times all kernels for one, three and seven links.
pub(crate) fn measure(quick: bool) -> Result<Vec<Kernel>> {
    let rounds = if quick { 20 } else { 200 };
    let mut kernels = measure_links::<1>(rounds)?;
    kernels.extend(measure_links::<3>(rounds)?);
    kernels.extend(measure_links::<7>(rounds)?);
    Ok(kernels)
}

fn measure_links<const N: usize>(rounds: usize) -> Result<Vec<Kernel>> {
    let scenario = Scenario::default().with_set(&format!("plant.links={N}"))?;
    let truth = scenario.build_truth::<N>()?;
    let chain: Chain<N> = truth.chain;
    let laws = LawKind::ALL.map(|kind| system::law::<N>(&scenario, kind));
    let inputs: Vec<LawInput<N>> = (0..STATES as u64).map(input).collect();
    let mut timed: Vec<(&'static str, Vec<f64>)> = Vec::new();
    for _ in 0..rounds {
        let mut place = 0;
        let mut time = |name, ns: f64| {
            if timed.len() == place {
                timed.push((name, Vec::with_capacity(rounds)));
            }
            timed[place].1.push(ns);
            place += 1;
        };
        let from_ns = clock::now_ns();
        time("M", batch(&inputs, |x| chain.mass_matrix(&x.q)));
        time("C", batch(&inputs, |x| chain.coriolis(&x.q, &x.v)));
        time("G", batch(&inputs, |x| chain.gravity(&x.q)));
        time(FORWARD, batch(&inputs, |x| chain.acceleration(&x.q, &x.v, &x.a_d)));
        for (kind, law) in LawKind::ALL.into_iter().zip(&laws) {
            let law = law.as_ref().map_err(|error| anyhow::anyhow!("{error}"))?;
            time(kind.name(), batch(&inputs, |x| law.torque(x)));
        }
        let state = |x: &LawInput<N>| PlantState { q: x.q, v: x.v };
        time("plant step of 1 ms", batch(&inputs, |x| rk4_step(&truth, &state(x), &x.a_d, 0.0, 1e-3)));
        // This process may be a real-time one, which has to leave its core a fifth of the time.
        clock::sleep_ns((clock::now_ns() - from_ns) / 4);
    }
    Ok(timed.into_iter().map(|(name, batches)| kernel(name, N, batches)).collect())
}

fn kernel(name: &'static str, links: usize, mut batches: Vec<f64>) -> Kernel {
    batches.sort_unstable_by(f64::total_cmp);
    let n = batches.len();
    Kernel {
        name,
        links,
        median_ns: median(&batches),
        p10_ns: batches[n / 10],
        p90_ns: batches[n - 1 - n / 10],
        batches: n,
        aim_ns: (name == FORWARD && links == 3).then_some(FORWARD_AIM_NS),
    }
}

/// ns a call. Neither the arguments nor the result are known to the compiler.
#[expect(clippy::cast_precision_loss, reason = "a batch takes less than 104 days")]
fn batch<const N: usize, R>(inputs: &[LawInput<N>], call: impl Fn(&LawInput<N>) -> R) -> f64 {
    let from_ns = clock::now_ns();
    for input in inputs.iter().cycle().take(usize::from(BATCH)) {
        black_box(call(black_box(input)));
    }
    (clock::now_ns() - from_ns) as f64 / f64::from(BATCH)
}

/// Angles within a turn, moderate velocities.
fn input<const N: usize>(number: u64) -> LawInput<N> {
    let draw = |lane: u32, scale: f64| {
        let first = lane * 8;
        Vector::<N>::from_iterator((0..8).map(|i| scale * (uniform(1, Stream::Test, number, first + i) - 0.5)).take(N))
    };
    LawInput { q: draw(0, 6.0), v: draw(1, 4.0), q_d: draw(2, 6.0), v_d: draw(3, 4.0), a_d: draw(4, 20.0) }
}
