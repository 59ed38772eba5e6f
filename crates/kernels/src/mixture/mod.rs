//! Every sensor is honest or attacked, and which one may change at every sample: beliefs about the measurements, given
//! the prediction.
//!
//! ```text
//!     1  innovations about N(C x⁻, C P⁻ Cᵀ + R), prior probability of an attack from the past of each sensor
//!     2  beliefs and sites to their fixed point, from two opposite starts ([`labels`])
//!     3  the labelling of largest evidence; rivals that are close are merged, their spread included
//!     4  x, P by the sites; what a distrusted sensor sends, less what the others expect, estimates the injection
//!     5  remember the beliefs; predict
//! ```
//!
//! # References
//! After Zhu, Wang, Zang, Li, Zheng 2022, whose beliefs are about local estimates; docs/mixture-fusion.md compares.

pub mod block;
pub mod information;
pub mod labels;
pub mod memory;
pub mod posterior;
mod report;
pub mod sample;
pub mod settings;

use crate::codec::{Decoder, Encoder};
use crate::dense::{self, Arithmetic};
use crate::kalman::heard::Heard;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::kalman::whitening::Noise;
use crate::mixture::information::Information;
use crate::mixture::labels::{Labels, Prior, Scratch};
use crate::mixture::memory::Past;
use crate::mixture::posterior::Posterior;
use crate::mixture::sample::Sample;
use crate::mixture::settings::{Form, Settings};
use crate::{Dims, Error, Estimator, Output, Result};

/// Beliefs that sweeps begin from: the gate, and trust in all.
const STARTS: usize = 2;

/// Weight of the second labelling from which on it is merged.
const RIVAL: f64 = 0.01;

/// Deviations by which labellings must disagree on a state to be called ambiguous, and the weight from which on.
const APART: (f64, f64) = (1.0, 0.05);

/// Change of beliefs at the cap that is worth a status.
const LOOSE: f64 = 0.05;

/// Names of the diagnostics.
const DIAGNOSTICS: [&str; 5] = ["channels", "sweeps", "gap", "distrusted", "rival"];

/// The estimator.
#[derive(Debug, Clone)]
pub struct Mixture {
    model: Model,
    noise: Noise,
    settings: Settings,
    steady: Option<Ud>,
    arithmetic: Arithmetic,
    /// Sum of the squares of the sensors' channels, and the most channels of one.
    blocks: usize,
    widest: usize,
}

/// Belief about x[k|k−1], what is remembered, and scratch.
#[derive(Debug, Clone)]
pub struct State {
    k: usize,
    x: Vec<f64>,
    prior: Ud,
    past: Past,
    work: Box<Work>,
}

/// Scratch.
#[derive(Debug, Clone)]
struct Work {
    heard: Heard,
    /// Every channel of a plant whose matrices do not change is what `heard` holds.
    complete: bool,
    sample: Sample,
    odds: Prior,
    information: Information,
    scratch: Scratch,
    starts: Vec<Labels>,
    posterior: Posterior,
    next: Vec<f64>,
    /// Beliefs after all is said, by sensor that arrived.
    gamma: Vec<f64>,
    innovation: Vec<f64>,
    /// Scratch by channel.
    channel: Vec<f64>,
    /// Square of the drift over its quantile, by sensor that arrived.
    excess: Vec<f64>,
}

impl Mixture {
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
        let sizes = |sensor: usize| owner.iter().filter(|&&o| o == sensor).count();
        let sizes: Vec<usize> = (0..model.dims.sensors).map(sizes).collect();
        let widest = sizes.iter().copied().max().unwrap_or(0);
        settings.check(widest, model.dims.sensors)?;
        let steady = steady.map(|p| Ud::new("prior covariance", p, n)).transpose()?;
        let blocks = sizes.iter().map(|size| size * size).sum();
        Ok(Self { noise, settings, steady, arithmetic: Arithmetic::default(), blocks, widest, model })
    }

    fn state(&self, mean: Vec<f64>, prior: Ud) -> State {
        let Dims { states: n, channels: m, sensors, .. } = self.model.dims;
        let labels = Labels::new(sensors, m, self.blocks, self.widest);
        let work = Work {
            heard: Heard::new(&self.model, &self.noise),
            complete: false,
            sample: Sample::new(m, sensors),
            odds: Prior::new(sensors),
            information: Information::new(self.arithmetic, n, m),
            scratch: Scratch::new(m, self.widest),
            starts: vec![labels; STARTS + 1],
            posterior: Posterior::new(self.arithmetic, &self.model),
            next: vec![0.0; n],
            gamma: vec![0.0; sensors],
            innovation: vec![0.0; m],
            channel: vec![0.0; m],
            excess: vec![0.0; sensors],
        };
        State { k: 0, x: mean, prior, past: Past::new(sensors, m), work: Box::new(work) }
    }

    /// Who arrived, and how far everyone is from the prediction.
    #[inline(always)]
    fn look(&self, state: &mut State, y: &[f64], u: &[f64]) {
        let State { k, x, prior, past, work } = state;
        let Work { heard, complete, sample, odds, information, innovation, channel, .. } = &mut **work;
        let all = y.iter().all(|value| !value.is_nan());
        if !(all && *complete) {
            heard.listen(&self.model, &self.noise, *k, y);
            sample.listen(heard, &self.model.channel_sensor, &self.settings.protected);
            *complete = all && self.model.horizon.is_none();
        }
        self.model.innovation(*k, x, (y, u), innovation);
        let white = heard.whiten(innovation, channel);
        sample.residual[..white.len()].copy_from_slice(white);
        information.see(prior, heard.rows());
        sample.measure(information);
        past.expect(&self.settings, sample, odds);
        odds.weigh(sample, &self.settings);
    }

    /// Sweep both starts to their fixed points.
    #[inline(always)]
    fn settle(&self, work: &mut Work) {
        let Work { sample, odds, information, scratch, starts, .. } = work;
        let settings = &self.settings;
        let starts = &mut starts[..STARTS];
        starts[0].begin(sample, |index, one| gate(settings, sample, index, one.size));
        starts[1].begin(sample, |_, _| 1.0);
        match settings.form {
            Form::Propagation => {
                for start in starts {
                    self.sweep_to_the_end(start, sample, odds, information, scratch);
                }
            }
            Form::Weight => {
                for _ in 0..settings.cap {
                    for start in &mut *starts {
                        start.sweep(sample, odds, settings, information, scratch);
                    }
                    if starts.iter().all(|start| start.gap <= settings.tolerance) {
                        break;
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn sweep_to_the_end(
        &self,
        start: &mut Labels,
        sample: &Sample,
        odds: &Prior,
        information: &mut Information,
        scratch: &mut Scratch,
    ) {
        for _ in 0..self.settings.cap {
            start.sweep(sample, odds, &self.settings, information, scratch);
            if start.gap < self.settings.tolerance {
                break;
            }
        }
    }

    /// The start of largest evidence, and its rival if one is close: index and weight.
    #[inline(always)]
    fn choose(&self, work: &mut Work) -> (usize, Option<(usize, f64)>) {
        let Work { sample, odds, information, scratch, starts, .. } = work;
        let (arrived, settings) = (sample.arrived.len(), &self.settings);
        let same = starts[1].agrees(&starts[0], arrived);
        if same && settings.form == Form::Propagation && !self.has_complement(&starts[0], sample) {
            return (0, None);
        }
        for start in &mut starts[..STARTS] {
            start.weigh_evidence(sample, odds, settings, information, scratch);
        }
        let mut winner = best(&starts[..STARTS]);
        let mut count = STARTS;
        if self.has_complement(&starts[winner], sample) {
            let (before, after) = starts.split_at_mut(STARTS);
            let (turned, opposite) = (&before[winner].gamma, &mut after[0]);
            opposite.begin(sample, |index, _| f64::from(u8::from(turned[index] <= 0.5)));
            self.sweep_to_the_end(opposite, sample, odds, information, scratch);
            opposite.weigh_evidence(sample, odds, settings, information, scratch);
            count += 1;
            winner = best(&starts[..count]);
        }
        let mut rival: Option<(usize, f64)> = None;
        for (i, start) in starts[..count].iter().enumerate().filter(|_| settings.merge) {
            let weight = 1.0 / (1.0 + (starts[winner].evidence - start.evidence).exp());
            let larger = rival.is_none_or(|(_, other)| weight > other);
            if weight >= RIVAL && larger && !start.agrees(&starts[winner], arrived) {
                rival = Some((i, weight));
            }
        }
        (winner, rival)
    }

    /// Whether half of the sensors accuse the other half: the opposite labelling is then as admissible.
    #[inline(always)]
    fn has_complement(&self, labels: &Labels, sample: &Sample) -> bool {
        let arrived = sample.arrived.len();
        let believed = |turned: bool| {
            let each = sample.arrived.iter().zip(&labels.gamma);
            each.filter(|(one, gamma)| one.protected || (**gamma <= 0.5) == turned).count()
        };
        self.settings.merge && arrived > 1 && 2 * believed(true) >= arrived && 2 * believed(false) >= arrived
    }

    /// The estimate of the winner, its rival merged into it.
    #[inline(always)]
    fn conclude(&self, work: &mut Work, winner: usize, rival: Option<(usize, f64)>) -> Verdict {
        let Work { sample, information, scratch, starts, posterior, gamma, .. } = work;
        let channels = information.count();
        let arrived = sample.arrived.len();
        gamma[..arrived].copy_from_slice(&starts[winner].gamma[..arrived]);
        starts[winner].weigh(sample, information, &mut scratch.block);
        posterior.conclude(information, &starts[winner].eta[..channels]);
        let Some((index, weight)) = rival else { return Verdict { winner, rival: 0.0, ambiguous: false } };
        starts[index].weigh(sample, information, &mut scratch.block);
        let apart = posterior.merge(information, &starts[index].eta[..channels], weight);
        for (mine, theirs) in gamma[..arrived].iter_mut().zip(&starts[index].gamma) {
            *mine += weight * (theirs - *mine);
        }
        Verdict { winner, rival: weight, ambiguous: apart > APART.0 && weight >= APART.1 }
    }

    /// One sample.
    #[inline(always)]
    fn advance(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) {
        self.look(state, y, u);
        let State { k, x, prior, past, work } = state;
        self.settle(work);
        let (winner, rival) = self.choose(work);
        let rival = if self.monitor(past, work, winner) { None } else { rival };
        let verdict = self.conclude(work, winner, rival);
        x.iter_mut().zip(&work.posterior.shift).for_each(|(x, shift)| *x += shift);
        self.report(work, (*k, x, prior), &verdict, out);
        past.remember(&self.settings, &work.sample, &work.odds, &work.gamma);
        work.posterior.predict(&self.model, *k, prior);
        self.model.predict(*k, x, u, &mut work.next);
        std::mem::swap(x, &mut work.next);
        *k += 1;
    }
}

/// The labels of largest evidence, the first of several.
fn best(starts: &[Labels]) -> usize {
    (1..starts.len()).fold(0, |best, i| if starts[i].evidence > starts[best].evidence { i } else { best })
}

/// Which labelling won, and how sure that is.
struct Verdict {
    winner: usize,
    /// Weight of the one merged into it.
    rival: f64,
    ambiguous: bool,
}

/// Belief of the first start: the innovation alone, against a broad density.
#[inline(always)]
fn gate(settings: &Settings, sample: &Sample, index: usize, size: usize) -> f64 {
    let square = sample.square[index];
    let honest = -0.5 * square; // the log det is common to both
    let attacked = match settings.form {
        Form::Propagation => -0.5 * (size as f64 * BROAD.ln() + square / BROAD),
        Form::Weight => labels::student(settings, square, size, 0.0),
    };
    1.0 / (1.0 + (attacked - honest).clamp(-50.0, 50.0).exp())
}

/// Variance of that density.
const BROAD: f64 = 81.0;

/// One step, compiled for the processor at hand.
struct Step<'a, 'b> {
    of: &'a Mixture,
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

impl Estimator for Mixture {
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
        state.past.save(to);
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let n = self.model.dims.states;
        let mut state = self.state(vec![0.0; n], Ud::zero(n));
        state.k = usize::try_from(from.integer()?).unwrap_or(usize::MAX);
        from.floats(&mut state.x)?;
        from.floats(&mut state.prior.d)?;
        from.floats(&mut state.prior.u)?;
        state.past.load(from)?;
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        self.settings.fingerprint(self.model.fingerprint()).finish()
    }
}
