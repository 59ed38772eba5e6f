//! The secure filter.

pub mod cavity;
pub mod labels;
pub mod memory;
mod report;
pub mod robust;
pub mod settings;

use crate::codec::{Decoder, Encoder};
use crate::dense::{self, Arithmetic};
use crate::kalman::heard::Heard;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::kalman::whitening::Noise;
use crate::mixture::information::Information;
use crate::mixture::posterior::Posterior;
use crate::mixture::sample::Sample;
use crate::secure::labels::{Label, Labels, Prior, Scratch};
use crate::secure::memory::Memory;
use crate::secure::robust::Regression;
use crate::secure::settings::Settings;
use crate::{Dims, Error, Estimator, Output, Result};

/// Beliefs that sweeps begin from.
const STARTS: usize = 4;

/// Names of the diagnostics.
const DIAGNOSTICS: [&str; 8] = ["channels", "sweeps", "gap", "distrusted", "rival", "beliefs", "age", "score"];

/// The estimator.
#[derive(Debug, Clone)]
pub struct Secure {
    model: Model,
    noise: Noise,
    settings: Settings,
    steady: Option<Ud>,
    arithmetic: Arithmetic,
    blocks: usize,
    widest: usize,
}

/// One way to see the past: belief about x[k|k−1], and what is remembered of the sensors.
#[derive(Debug, Clone)]
struct Belief {
    x: Vec<f64>,
    prior: Ud,
    memory: Memory,
    /// log of its weight among all.
    weight: f64,
}

/// What a belief became with one labelling of the sample.
#[derive(Debug, Clone)]
struct Candidate {
    labels: Labels,
    parent: usize,
    weight: f64,
    x: Vec<f64>,
    root: Vec<f64>,
    accused: usize,
}

/// A belief on trial.
#[derive(Debug, Clone)]
struct Rival {
    belief: Belief,
    /// Samples since it started over, 0 = none.
    age: u64,
    pause: u64,
    /// It trusts fewer than a majority less, and others.
    useful: bool,
    /// log evidence over that of the filter.
    score: f64,
}

/// Beliefs and scratch.
#[derive(Debug, Clone)]
pub struct State {
    k: usize,
    beliefs: Vec<Belief>,
    count: usize,
    spare: Vec<Belief>,
    rival: Rival,
    work: Box<Work>,
}

/// Scratch.
#[derive(Debug, Clone)]
struct Work {
    heard: Heard,
    complete: bool,
    sample: Sample,
    prior: Prior,
    information: Information,
    scratch: Scratch,
    regression: Regression,
    trials: Vec<Labels>,
    candidates: Vec<Candidate>,
    found: usize,
    kept: Vec<usize>,
    posterior: Posterior,
    next: Vec<f64>,
    innovation: Vec<f64>,
    /// Innovation and deviation of the heaviest belief, to report.
    channel: Vec<f64>,
    eta: Vec<f64>,
    /// Trust after all is said, by sensor that arrived.
    trust: Vec<f64>,
}

impl Secure {
    /// The estimator of `model`.
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
        settings.check(model.dims.sensors)?;
        let steady = steady.map(|p| Ud::new("prior covariance", p, n)).transpose()?;
        let blocks = settings.sizes.iter().map(|size| size * size).sum();
        Ok(Self { noise, settings, steady, arithmetic: Arithmetic::default(), blocks, widest, model })
    }

    fn state(&self, mean: Vec<f64>, prior: Ud) -> State {
        let Dims { states: n, channels: m, sensors, .. } = self.model.dims;
        let labels = Labels::new(sensors, m, self.blocks, self.widest);
        let beam = self.settings.beam;
        let candidate = Candidate {
            labels: labels.clone(),
            parent: 0,
            weight: 0.0,
            x: vec![0.0; n],
            root: vec![0.0; n * n],
            accused: 0,
        };
        let belief = Belief { x: mean, prior, memory: Memory::new(&self.settings, sensors, m, self.widest), weight: 0.0 };
        let work = Work {
            heard: Heard::new(&self.model, &self.noise),
            complete: false,
            sample: Sample::new(m, sensors),
            prior: Prior::new(sensors, m, self.widest),
            information: Information::new(self.arithmetic, n, m),
            scratch: Scratch::new(m, self.widest),
            regression: Regression::new(sensors, m),
            trials: vec![labels; STARTS],
            candidates: vec![candidate; STARTS * (beam + 1)],
            found: 0,
            kept: Vec::with_capacity(beam),
            posterior: Posterior::new(self.arithmetic, &self.model),
            next: vec![0.0; n],
            innovation: vec![0.0; m],
            channel: vec![0.0; m],
            eta: vec![0.0; m],
            trust: vec![0.0; sensors],
        };
        State { k: 0, beliefs: vec![belief.clone(); beam + 1], count: 1, spare: vec![belief.clone(); beam + 1], rival: Rival { belief, age: 0, pause: 0, useful: true, score: 0.0 }, work: Box::new(work) }
    }

    /// Who arrived, and how far everyone is from what a belief predicts.
    #[inline(always)]
    fn look(&self, work: &mut Work, belief: &mut Belief, k: usize, y: &[f64], u: &[f64]) {
        let Work { sample, prior, information, innovation, heard, eta, .. } = work;
        self.model.innovation(k, &belief.x, (y, u), innovation);
        let white = heard.whiten(innovation, eta);
        sample.residual[..white.len()].copy_from_slice(white);
        information.see(&belief.prior, heard.rows());
        sample.measure(information);
        belief.memory.expect(&self.settings, heard, sample, prior);
    }

    /// Every labelling that explains the sample by one belief.
    #[inline(always)]
    fn explain(&self, work: &mut Work, weight: f64, parent: usize) {
        let settings = &self.settings;
        let arrived = work.sample.arrived.len();
        let mut tried = 0;
        for start in 0..STARTS {
            if !settings.starts[start] || (start == 3 && tried == 0) {
                continue;
            }
            let Work { sample, prior, information, scratch, trials, regression, eta, .. } = work;
            let (before, rest) = trials.split_at_mut(tried);
            let trial = &mut rest[0];
            match start {
                0 => trial.begin(sample, prior, |index, _| (prior.honest[index], prior.constant[index])),
                1 => trial.begin(sample, prior, |index, one| (gate(settings, sample, prior, index, one.size), 0.0)),
                2 => regression.begin(trial, (sample, prior), settings, information, scratch),
                _ => {
                    let first = &before[0];
                    let accused = (0..arrived).filter(|&i| first.label(i) != Label::Honest).count();
                    if 3 * accused < arrived || settings.most(sample) + 1 < arrived.saturating_sub(accused) {
                        continue;
                    }
                    trial.begin(sample, prior, |index, _| (f64::from(u8::from(first.honest[index] <= 0.5)), 0.0));
                }
            }
            for _ in 0..settings.cap {
                trial.sweep((sample, prior), settings, information, scratch);
                if trial.gap < settings.tolerance {
                    break;
                }
            }
            if before.iter().any(|other| other.agrees(trial, arrived)) {
                continue;
            }
            let count = information.count();
            trial.weigh_evidence((sample, prior), settings, information, scratch, &mut eta[..count]);
            tried += 1;
        }
        for index in 0..tried {
            self.note(work, index, weight, parent);
        }
    }

    /// Note a labelling as a candidate, if it is not hopeless.
    #[inline(always)]
    fn note(&self, work: &mut Work, index: usize, weight: f64, parent: usize) {
        let Work { sample, information, scratch, trials, candidates, found, next, .. } = work;
        let trial = &trials[index];
        let weight = weight + trial.evidence;
        let best = candidates[..*found].iter().fold(f64::NEG_INFINITY, |best, one| best.max(one.weight));
        if weight.is_nan() || weight < best - self.settings.drop {
            return;
        }
        let candidate = &mut candidates[*found];
        *found += 1;
        candidate.labels.copy_from(trial);
        candidate.parent = parent;
        candidate.weight = weight;
        candidate.accused = (0..sample.arrived.len()).filter(|&i| trial.label(i) != Label::Honest).count();
        trial.weigh(sample, information, scratch);
        let count = information.count();
        information.conclude(&trial.eta[..count], &mut candidate.root, next);
        candidate.x.copy_from_slice(next);
    }

    /// One sample.
    #[inline(always)]
    fn advance(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) {
        let settings = &self.settings;
        let State { k, beliefs, count, spare, work, rival } = state;
        let all = y.iter().all(|value| !value.is_nan());
        if !(all && work.complete) {
            work.heard.listen(&self.model, &self.noise, *k, y);
            work.sample.listen(&work.heard, &self.model.channel_sensor, &settings.protected);
            work.complete = all && self.model.horizon.is_none();
        }
        work.found = 0;
        for (parent, belief) in beliefs[..*count].iter_mut().enumerate() {
            if *k > 0 {
                belief.memory.move_on(settings, &work.heard);
            }
            self.look(work, belief, *k, y, u);
            if parent == 0 {
                out.innovation.copy_from_slice(&work.innovation);
                self.innovation_std(work, *k, &belief.prior, out.innovation_std);
            }
            self.explain(work, belief.weight, parent);
            for candidate in &mut work.candidates[..work.found] {
                if candidate.parent == parent {
                    candidate.x.iter_mut().zip(&belief.x).for_each(|(shift, x)| *shift += x);
                }
            }
        }
        if settings.doubt.0 > 0 {
            self.doubt(beliefs, *count, work, *k, y, u);
        }
        let before = total(beliefs[..*count].iter().map(|belief| belief.weight));
        let after = total(work.candidates[..work.found].iter().map(|candidate| candidate.weight));
        let forgiven = match best(&work.candidates[..work.found]) {
            Some(best) => {
                let beyond = work.candidates[best].accused.saturating_sub(settings.most(&work.sample));
                beyond as f64 * (labels::MAJORITY - 7.0)
            }
            None => 0.0,
        };
        self.select(work);
        self.report(work, out);
        out.diagnostics[6] = rival.age as f64;
        out.diagnostics[7] = rival.score;
        for (place, &chosen) in work.kept.iter().enumerate() {
            let candidate = &work.candidates[chosen];
            let target = &mut spare[place];
            target.weight = candidate.weight - work.candidates[work.kept[0]].weight;
            target.memory.copy_from(&beliefs[candidate.parent].memory);
            target.memory.remember(settings, &work.heard, &work.sample, &candidate.labels);
            let violated = candidate.accused > settings.most(&work.sample);
            target.memory.violated = if violated { target.memory.violated + 1 } else { 0 };
            if place == 0 {
                target.memory.report(settings, &work.heard, &work.sample, &candidate.labels, &work.trust, out);
            }
            work.posterior.take(&candidate.root);
            target.prior.copy_from(&beliefs[candidate.parent].prior);
            work.posterior.predict(&self.model, *k, &mut target.prior);
            self.model.predict(*k, &candidate.x, u, &mut target.x);
        }
        *count = work.kept.len();
        std::mem::swap(beliefs, spare);
        self.challenge(state, after - before + forgiven, y, u);
        self.begin_trial(state);
        state.k += 1;
    }

    /// Too many were accused several times in a row: the prediction or the memory is wrong. Try without either.
    #[inline(always)]
    fn doubt(&self, beliefs: &mut [Belief], count: usize, work: &mut Work, k: usize, y: &[f64], u: &[f64]) {
        let settings = &self.settings;
        let (steps, inflation) = settings.doubt;
        let best = best(&work.candidates[..work.found]);
        let Some(best) = best else { return };
        let candidate = &work.candidates[best];
        let (parent, violated) = (candidate.parent, candidate.accused > settings.most(&work.sample));
        if steps == 0 || !violated || beliefs[parent].memory.violated + 1 < steps as u64 {
            return;
        }
        let (before, rest) = beliefs.split_at_mut(count);
        let fresh = &mut rest[0];
        fresh.x.copy_from_slice(&before[parent].x);
        fresh.prior.copy_from(&before[parent].prior);
        fresh.prior.d.iter_mut().for_each(|d| *d *= inflation);
        fresh.memory.copy_from(&before[parent].memory);
        fresh.memory.clear(settings);
        fresh.weight = before[parent].weight;
        self.look(work, fresh, k, y, u);
        let from = work.found;
        self.explain(work, fresh.weight, count);
        for candidate in &mut work.candidates[from..work.found] {
            candidate.x.iter_mut().zip(&fresh.x).for_each(|(shift, x)| *shift += x);
        }
    }

    /// A rival that starts over is tried beside the filter while that accuses somebody; the one of larger evidence stays.
    #[inline(always)]
    fn challenge(&self, state: &mut State, evidence: f64, y: &[f64], u: &[f64]) {
        let settings = &self.settings;
        let (length, pause, inflation, against) = settings.trial;
        let State { k, beliefs, count, rival, work, .. } = state;
        if rival.pause > 0 {
            rival.pause -= 1;
        }
        if rival.age == 0 {
            return;
        }
        let _ = (inflation, pause, against);
        work.found = 0;
        if rival.age > 1 {
            rival.belief.memory.move_on(settings, &work.heard);
        }
        self.look(work, &mut rival.belief, *k, y, u);
        self.explain(work, 0.0, 0);
        let Some(best) = best(&work.candidates[..work.found]) else {
            rival.age = 0;
            return;
        };
        let arrived = work.sample.arrived.len();
        let candidate = &mut work.candidates[best];
        let crossed = (0..arrived).any(|i| work.trust[i] > 0.5 && candidate.labels.honest[i] < 0.5);
        let beyond = candidate.accused.saturating_sub(settings.most(&work.sample));
        rival.score += candidate.weight + beyond as f64 * (labels::MAJORITY - 7.0) - evidence;
        let violated = beliefs[0].memory.violated > 0;
        candidate.x.iter_mut().zip(&rival.belief.x).for_each(|(shift, x)| *shift += x);
        rival.belief.memory.remember(settings, &work.heard, &work.sample, &candidate.labels);
        work.posterior.take(&candidate.root);
        work.posterior.predict(&self.model, *k, &mut rival.belief.prior);
        self.model.predict(*k, &candidate.x, u, &mut rival.belief.x);
        rival.age += 1;
        let over = rival.age > length;
        let sure = violated || rival.score > settings.strong;
        let wait = if sure { settings.haste } else { length / 2 };
        rival.useful = crossed && beyond == 0;
        let clear = rival.age > wait && rival.score > against && beyond == 0;
        if crossed && clear {
            let target = &mut beliefs[0];
            target.x.copy_from_slice(&rival.belief.x);
            target.prior.copy_from(&rival.belief.prior);
            target.memory.copy_from(&rival.belief.memory);
            target.weight = 0.0;
            *count = 1;
            rival.age = 0;
            rival.pause = pause;
        } else if over {
            rival.age = 0;
            rival.pause = pause;
        }
    }

    /// Begin a trial if somebody is accused.
    #[inline(always)]
    fn begin_trial(&self, state: &mut State) {
        let settings = &self.settings;
        let (length, _, inflation, against) = settings.trial;
        let State { beliefs, rival, .. } = state;
        let debt = beliefs[0].memory.debt();
        let violated = beliefs[0].memory.violated > 0;
        let useless = violated && !rival.useful;
        if length == 0 || (rival.age > 0 && !useless) || (rival.pause > 0 && !violated) || debt == 0.0 {
            return;
        }
        rival.belief.x.copy_from_slice(&beliefs[0].x);
        rival.belief.prior.copy_from(&beliefs[0].prior);
        rival.belief.prior.d.iter_mut().for_each(|d| *d *= inflation);
        rival.belief.memory.copy_from(&beliefs[0].memory);
        rival.belief.memory.clear(settings);
        rival.age = 1;
        rival.useful = true;
        rival.score = -debt * settings.charge;
        let _ = against;
    }

    /// The candidates to keep, heaviest first.
    #[inline(always)]
    fn select(&self, work: &mut Work) {
        let Work { candidates, found, kept, sample, .. } = work;
        let settings = &self.settings;
        let arrived = sample.arrived.len();
        kept.clear();
        let candidates = &mut candidates[..*found];
        while kept.len() < settings.beam {
            let rest = (0..candidates.len()).filter(|i| !kept.contains(i) && candidates[*i].weight.is_finite());
            let Some(next) = rest.reduce(|a, b| if candidates[b].weight > candidates[a].weight { b } else { a }) else {
                break;
            };
            if let Some(&first) = kept.first() {
                if candidates[next].weight < candidates[first].weight - settings.drop {
                    break;
                }
            }
            let twin = kept.iter().copied().find(|&other| {
                let (a, b) = (&candidates[other], &candidates[next]);
                a.labels.agrees(&b.labels, arrived) && close(a, b, settings.same)
            });
            if let Some(twin) = twin {
                let (a, b) = (candidates[twin].weight, candidates[next].weight);
                candidates[twin].weight = a + (b - a).exp().ln_1p();
                candidates[next].weight = f64::NEG_INFINITY;
                continue;
            }
            kept.push(next);
        }
    }
}

/// log Σ exp
fn total(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    largest + logs.map(|log| (log - largest).exp()).sum::<f64>().ln()
}

/// The heaviest candidate.
fn best(candidates: &[Candidate]) -> Option<usize> {
    (0..candidates.len()).reduce(|a, b| if candidates[b].weight > candidates[a].weight { b } else { a })
}

/// Whether two candidates are within `same` deviations of each other in every state.
fn close(a: &Candidate, b: &Candidate, same: f64) -> bool {
    let n = a.x.len();
    (0..n).all(|i| {
        let variance: f64 = a.root.chunks_exact(n).map(|row| row[i] * row[i]).sum();
        (a.x[i] - b.x[i]).abs() <= same * variance.sqrt()
    })
}

/// Belief of a sensor by the innovation alone, against a broad density.
#[inline(always)]
fn gate(settings: &Settings, sample: &Sample, prior: &Prior, index: usize, size: usize) -> f64 {
    let square = sample.square[index];
    let broad = 1.0 + settings.kappa / sample.log_det[index].exp().powf(1.0 / size as f64);
    let exponent = 0.5 * square * (1.0 - 1.0 / broad) - 0.5 * size as f64 * broad.ln();
    let lies = 1.0 - prior.honest[index];
    1.0 / (1.0 + lies / prior.honest[index].max(1e-12) * exponent.clamp(-50.0, 50.0).exp())
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
        to.integer(state.count as u64);
        for belief in &state.beliefs[..state.count] {
            to.floats(&belief.x);
            to.floats(&belief.prior.d);
            to.floats(&belief.prior.u);
            belief.memory.save(to);
            to.floats(&[belief.weight]);
        }
        to.integer(state.rival.age);
        to.integer(state.rival.pause);
        to.floats(&[state.rival.score]);
        let belief = &state.rival.belief;
        to.floats(&belief.x);
        to.floats(&belief.prior.d);
        to.floats(&belief.prior.u);
        belief.memory.save(to);
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let n = self.model.dims.states;
        let mut state = self.state(vec![0.0; n], Ud::zero(n));
        state.k = usize::try_from(from.integer()?).unwrap_or(usize::MAX);
        state.count = usize::try_from(from.integer()?).unwrap_or(usize::MAX).clamp(1, self.settings.beam);
        for belief in &mut state.beliefs[..state.count] {
            from.floats(&mut belief.x)?;
            from.floats(&mut belief.prior.d)?;
            from.floats(&mut belief.prior.u)?;
            belief.memory.load(from)?;
            from.floats(std::slice::from_mut(&mut belief.weight))?;
        }
        state.rival.age = from.integer()?;
        state.rival.pause = from.integer()?;
        from.floats(std::slice::from_mut(&mut state.rival.score))?;
        let belief = &mut state.rival.belief;
        from.floats(&mut belief.x)?;
        from.floats(&mut belief.prior.d)?;
        from.floats(&mut belief.prior.u)?;
        belief.memory.load(from)?;
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        self.settings.fingerprint(self.model.fingerprint()).finish()
    }
}
