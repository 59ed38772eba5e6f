//! Finds who lies, remembers it, and estimates the state as if the liars were known.
//!
//! ```text
//!     1  what is remembered of every sensor, one sample on ([`memory`])
//!     2  innovations about N(C x⁻, C P⁻ Cᵀ + R)
//!     3  beliefs and sites to their fixed point, from several starts ([`labels`], [`density`], [`cavity`], [`robust`])
//!     4  the labelling of largest evidence; a rival that is close is merged, its spread included
//!     5  if the accused outvote the believed for some samples ([`votes`]), 2–4 again without memory and prediction
//!     6  x, P by the sites; remember; predict
//! ```
//!
//! What arrives per sample, the square-root information filter and the posterior are those of [`crate::mixture`].
//! docs/secure-filter.md explains the model and says what was measured.

pub mod cavity;
pub mod density;
pub mod labels;
pub mod memory;
mod report;
pub mod robust;
pub mod settings;
mod votes;

use crate::codec::{Decoder, Encoder};
use crate::dense::{self, Arithmetic};
use crate::kalman::heard::Heard;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::kalman::whitening::Noise;
use crate::mixture::information::Information;
use crate::mixture::posterior::Posterior;
use crate::mixture::sample::Sample;
use crate::secure::labels::{Labels, Prior, Scratch};
use crate::secure::memory::Memory;
use crate::secure::robust::Regression;
use crate::secure::settings::{DOUBT, Part, SWEEPS, Settings};
use crate::{Dims, Error, Estimator, Output, Result};

/// Beliefs that sweeps begin from: what is remembered, a gate on the prediction, a robust regression, and, in doubt, the
/// opposite of what was believed.
const STARTS: usize = 4;

/// See [`STARTS`].
#[derive(Debug, Clone, Copy)]
enum Start {
    Memory,
    Gate,
    Regression,
    Opposite,
}

/// Weight of the second labelling from which on it is merged.
const RIVAL: f64 = 0.01;

/// Names of the diagnostics.
const DIAGNOSTICS: [&str; 5] = ["channels", "sweeps", "gap", "distrusted", "rival"];

/// The estimator.
#[derive(Debug, Clone)]
pub struct Secure {
    model: Model,
    noise: Noise,
    settings: Settings,
    steady: Option<Ud>,
    arithmetic: Arithmetic,
    /// Sum of the squares of the sensors' channels, and the most channels of one.
    blocks: usize,
    widest: usize,
}

/// Belief about x\[k|k−1\], what is remembered of the sensors, and scratch.
#[derive(Debug, Clone)]
pub struct State {
    k: usize,
    x: Vec<f64>,
    prior: Ud,
    memory: Memory,
    work: Box<Work>,
}

/// Scratch.
#[derive(Debug, Clone)]
struct Work {
    heard: Heard,
    /// Every channel of a plant whose matrices do not change is what `heard` holds.
    complete: bool,
    sample: Sample,
    prior: Prior,
    information: Information,
    scratch: Scratch,
    regression: Regression,
    /// Labellings found, the first of them in use.
    trials: Vec<Labels>,
    found: usize,
    /// The labelling before everything was doubted, and what was remembered.
    kept: Labels,
    plea: Labels,
    remembered: Memory,
    inflated: Ud,
    posterior: Posterior,
    next: Vec<f64>,
    innovation: Vec<f64>,
    /// Scratch by channel.
    channel: Vec<f64>,
    eta: Vec<f64>,
}

/// Which labelling won, and how sure that is.
#[derive(Debug, Clone, Copy)]
struct Verdict {
    winner: usize,
    /// The second, and its weight.
    rival: Option<(usize, f64)>,
    /// Deviations by which they are apart.
    apart: f64,
    /// More are accused than believed.
    outvoted: bool,
}

impl Secure {
    /// The estimator of `model`. `steady` is P[0|−1] (n, n) of the steady state, if there is one.
    ///
    /// # Errors
    /// If `steady` is no covariance, a setting is out of range, sensors share noise, or the channels of a sensor do not
    /// follow each other.
    pub fn new(model: Model, steady: Option<&[f64]>, settings: Settings) -> Result<Self> {
        let (n, owner) = (model.dims.states, &model.channel_sensor);
        if !owner.is_sorted() {
            return Err(Error::input("channel_sensor", "the channels of a sensor side by side", "a mixture"));
        }
        let noise = model.noise.within(owner)?;
        if noise.r != model.noise.r {
            return Err(Error::input("R", "no correlation between sensors", "some"));
        }
        let widest = settings.sizes.iter().copied().max().unwrap_or(0);
        let steady = steady.map(|p| Ud::new("prior covariance", p, n)).transpose()?;
        let blocks = settings.sizes.iter().map(|size| size * size).sum();
        Ok(Self { noise, settings, steady, arithmetic: Arithmetic::default(), blocks, widest, model })
    }

    fn state(&self, mean: Vec<f64>, prior: Ud) -> State {
        let Dims { states: n, channels: m, sensors, .. } = self.model.dims;
        let labels = Labels::new(sensors, m, self.blocks, self.widest);
        let memory = Memory::new(&self.settings);
        let work = Work {
            heard: Heard::new(&self.model, &self.noise),
            complete: false,
            sample: Sample::new(m, sensors),
            prior: Prior::new(sensors, m),
            information: Information::new(self.arithmetic, n, m),
            scratch: Scratch::new(m, self.widest),
            regression: Regression::new(sensors, m),
            trials: vec![labels.clone(); STARTS],
            found: 0,
            kept: labels.clone(),
            plea: labels,
            remembered: memory.clone(),
            inflated: prior.clone(),
            posterior: Posterior::new(self.arithmetic, &self.model),
            next: vec![0.0; n],
            innovation: vec![0.0; m],
            channel: vec![0.0; m],
            eta: vec![0.0; m],
        };
        State { k: 0, x: mean, prior, memory, work: Box::new(work) }
    }

    /// How far everyone is from the prediction with covariance `prior`.
    #[inline(always)]
    fn measure(&self, work: &mut Work, prior: &Ud, memory: &Memory) {
        let Work { sample, information, innovation, heard, eta, .. } = work;
        let white = heard.whiten(innovation, eta);
        sample.residual[..white.len()].copy_from_slice(white);
        information.see(prior, heard.rows());
        sample.measure(information);
        memory.expect(&self.settings, heard, sample, &mut work.prior);
    }

    /// Every labelling that sweeps arrive at. The regression is asked only if they disagree or it is news who lies.
    #[inline(always)]
    fn explain(&self, work: &mut Work, doubted: bool) {
        let settings = &self.settings;
        let arrived = work.sample.arrived.len();
        work.found = 0;
        for start in [Start::Memory, Start::Gate, Start::Regression, Start::Opposite] {
            let Work { sample, prior, information, scratch, trials, regression, kept, found, .. } = work;
            let (before, rest) = trials.split_at_mut(*found);
            let trial = &mut rest[0];
            let surprised = before.len() > 1 || before.iter().any(|labels| labels.surprises(prior, arrived));
            match start {
                Start::Memory => trial.begin(sample, prior, |index, _| {
                    let [honest, constant, ..] = prior.probability[index];
                    (honest, constant)
                }),
                Start::Gate => {
                    trial.begin(sample, prior, |index, one| {
                        (density::gate(sample, prior, index, one.size), 0.0)
                    });
                }
                Start::Regression if surprised && settings.has(Part::Regression) => {
                    regression.begin(trial, (sample, prior), settings, information, scratch);
                }
                Start::Opposite if doubted => {
                    trial.begin(sample, prior, |index, _| (f64::from(u8::from(!kept.believes(index))), 0.0));
                }
                Start::Regression | Start::Opposite => continue,
            }
            if before.iter().any(|other| other.agrees(trial, arrived)) {
                continue;
            }
            for _ in 0..SWEEPS.0 {
                trial.sweep((sample, prior), information, scratch);
                if trial.gap < SWEEPS.1 {
                    break;
                }
            }
            if !before.iter().any(|other| other.agrees(trial, arrived)) {
                *found += 1;
            }
        }
        if work.found > 1 || doubted {
            let Work { sample, prior, information, scratch, trials, eta, found, .. } = work;
            let eta = &mut eta[..information.count()];
            for trial in &mut trials[..*found] {
                trial.weigh_evidence((sample, prior), settings, information, scratch, eta);
            }
        }
    }

    /// The labelling of largest evidence, and the next if it is close.
    #[inline(always)]
    fn choose(&self, work: &mut Work) -> Verdict {
        let trials = &work.trials[..work.found];
        let better = |a: usize, b: usize| if trials[b].evidence > trials[a].evidence { b } else { a };
        let winner = (1..trials.len()).fold(0, better);
        let second = (0..trials.len()).filter(|&i| i != winner).reduce(better);
        let rival = second.and_then(|second| {
            let weight = 1.0 / (1.0 + (trials[winner].evidence - trials[second].evidence).exp());
            (weight >= RIVAL).then_some((second, weight))
        });
        Verdict { winner, rival, apart: 0.0, outvoted: votes::outvoted(work, &self.settings, winner) }
    }

    /// More were accused than believed for some time: the prediction or what is remembered may be wrong. Explain the
    /// sample without either. What outvotes nobody and explains it better than the labelling in doubt would, on the same
    /// terms, stays: where states outnumber the sensors that see them, the accused are often many in some direction.
    #[inline(always)]
    fn doubt(&self, work: &mut Work, memory: &mut Memory, prior: &Ud, verdict: Verdict) -> Verdict {
        let settings = &self.settings;
        memory.outvoted = if verdict.outvoted { memory.outvoted.saturating_add(1) } else { 0 };
        if memory.outvoted < DOUBT.0 || !settings.has(Part::Doubt) {
            return verdict;
        }
        work.kept.copy_from(&work.trials[verdict.winner]);
        work.remembered.copy_from(memory);
        memory.clear(settings);
        let mut inflated = std::mem::replace(&mut work.inflated, Ud::zero(0));
        inflated.copy_from(prior);
        inflated.d.iter_mut().for_each(|d| *d *= DOUBT.1);
        self.measure(work, &inflated, memory);
        work.inflated = inflated;
        self.explain(work, true);
        let fresh = self.choose(work);
        let plea = self.plead(work);
        let found = &work.trials[fresh.winner];
        if !fresh.outvoted && found.evidence > plea && !found.agrees(&work.kept, work.sample.arrived.len()) {
            return Verdict { rival: None, ..fresh };
        }
        memory.copy_from(&mut work.remembered);
        self.measure(work, prior, memory);
        work.trials[0].copy_from(&work.kept);
        work.found = 1;
        Verdict { winner: 0, rival: None, ..verdict }
    }

    /// Evidence of the labelling in doubt without what is remembered: whoever it accuses lies wildly.
    #[inline(always)]
    fn plead(&self, work: &mut Work) -> f64 {
        let Work { sample, prior, information, scratch, plea, kept, eta, .. } = work;
        plea.copy_from(kept);
        plea.round(sample.arrived.len());
        let eta = &mut eta[..information.count()];
        plea.weigh_evidence((sample, prior), &self.settings, information, scratch, eta);
        plea.evidence
    }

    /// The estimate of the winner, its rival merged into it.
    #[inline(always)]
    fn conclude(&self, work: &mut Work, verdict: &mut Verdict) {
        let Work { sample, information, scratch, trials, posterior, .. } = work;
        let count = information.count();
        let winner = verdict.winner;
        trials[winner].weigh(sample, information, scratch);
        posterior.conclude(information, &trials[winner].eta[..count]);
        let Some((rival, weight)) = verdict.rival else { return };
        trials[rival].weigh(sample, information, scratch);
        verdict.apart = posterior.merge(information, &trials[rival].eta[..count], weight);
        trials.swap(0, winner);
        let rival = if rival == 0 { winner } else { rival };
        verdict.winner = 0;
        let (first, others) = trials.split_at_mut(1);
        first[0].merge(&others[rival - 1], weight, sample.arrived.len());
    }

    /// One sample.
    #[inline(always)]
    fn advance(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) {
        let settings = &self.settings;
        let State { k, x, prior, memory, work } = state;
        let all = y.iter().all(|value| !value.is_nan());
        if !(all && work.complete) {
            work.heard.listen(&self.model, &self.noise, *k, y);
            work.sample.listen(&work.heard, &self.model.channel_sensor, &settings.protected);
            work.complete = all && self.model.horizon.is_none();
        }
        if *k > 0 {
            memory.move_on(settings, &work.sample);
        }
        self.model.innovation(*k, x, (y, u), &mut work.innovation);
        self.measure(work, prior, memory);
        self.innovation_std(work, *k, prior, out.innovation_std);
        self.explain(work, false);
        let verdict = self.choose(work);
        let mut verdict = self.doubt(work, memory, prior, verdict);
        self.conclude(work, &mut verdict);
        if work.posterior.shift.iter().all(|shift| shift.is_finite()) {
            x.iter_mut().zip(&work.posterior.shift).for_each(|(x, shift)| *x += shift);
        }
        let labels = &mut work.trials[verdict.winner];
        memory.remember(settings, &work.heard, &work.sample, labels);
        self.report(work, x, memory, &verdict, out);
        work.posterior.predict(&self.model, *k, prior);
        self.model.predict(*k, x, u, &mut work.next);
        std::mem::swap(x, &mut work.next);
        *k += 1;
    }
}

/// One step, compiled for the processor at hand.
struct Step<'a, 'b> {
    of: &'a Secure,
    state: &'a mut State,
    y: &'a [f64],
    u: &'a [f64],
    out: &'a mut Output<'b>,
}

impl dense::Work for Step<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.of.advance(self.state, self.y, self.u, self.out);
    }
}

impl Estimator for Secure {
    type State = State;
    type Plan = ();

    fn dims(&self) -> Dims {
        self.model.dims
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        &DIAGNOSTICS
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        Error::check_len("prior.x", self.model.dims.states, mean.len())?;
        if let Some(p) = covariance {
            return Ok(self.state(mean.to_vec(), Ud::new("prior.P", p, mean.len())?));
        }
        let steady = self.steady.clone().ok_or_else(|| {
            let expected = "a belief with a covariance P, because this plant has no steady state";
            Error::input("prior", expected, "none")
        })?;
        Ok(self.state(mean.to_vec(), steady))
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        self.model.check_horizon(state.k)?;
        self.arithmetic.run(Step { of: self, state, y, u, out });
        Ok(())
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        to.integer(state.k as u64);
        to.floats(&state.x);
        to.floats(&state.prior.d);
        to.floats(&state.prior.u);
        state.memory.save(to);
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let n = self.model.dims.states;
        let mut state = self.state(vec![0.0; n], Ud::zero(n));
        state.k = usize::try_from(from.integer()?).unwrap_or(usize::MAX);
        from.floats(&mut state.x)?;
        from.floats(&mut state.prior.d)?;
        from.floats(&mut state.prior.u)?;
        state.memory.load(from)?;
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        self.settings.fingerprint(self.model.fingerprint()).finish()
    }
}
