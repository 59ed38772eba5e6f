//! Local estimates clustered by a Gaussian mixture, and a Kalman filter that weighs sensors by what that says of them.
//!
//! ```text
//!     1  local estimates x_i of every sensor that sent something                       (8), (10)
//!     2  γ_i, the belief that sensor i is honest, by expectation maximisation          (13)–(19)
//!     3  γ̂_i = 1 − γ_i for all if the mean of 1 − γ_i is above ε, otherwise γ_i        (20), (21)
//!     4  P⁻¹ = (P⁻)⁻¹ + Σ γ̂_i C_iᵀ R_i⁻¹ C_i,  x = x⁻ + P Σ γ̂_i C_iᵀ R_i⁻¹ r_i       (22c), (22d)
//!     5  predict                                                                       (22a), (22b)
//! ```
//!
//! Deviations from the paper: (22d) is printed with γ; the literal form has that, and is left for a sample at which x
//! would leave the range of numbers. The paper knows no inputs and no sensors that are missing, and leaves open what
//! [`em`] and [`locals`] say.
//!
//! # References
//! Zhu et al. 2022, Algorithm 1; without step 3 Guo et al. 2019.

pub mod em;
pub mod known;
pub mod locals;
mod principal;

use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::kalman::{self, Kalman};
use crate::linalg::axpy;
use crate::mixture_fusion::em::{Mixture, Outcome, Rules};
use crate::mixture_fusion::locals::{Design, Locals};
use crate::{Dims, Error, Estimator, Output, Result, Status};

/// Readings, and estimates that no reading corrects, are no further from zero than this: squares stay finite.
pub const LIMIT: f64 = 1e100;

/// The choices of the method.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// ε, or None for no compensator.
    pub epsilon: Option<f64>,
    /// (22d) as printed.
    pub literal: bool,
    /// Samples before which every sensor is believed.
    pub start: usize,
    /// The choices of the expectation maximisation.
    pub rules: Rules,
}

/// Mixture fusion on a Kalman filter.
#[derive(Debug, Clone)]
pub struct MixtureFusion {
    filter: Kalman,
    locals: Design,
    settings: Settings,
}

/// The Kalman filter's state, the local estimates, and scratch.
#[derive(Debug, Clone)]
pub struct State {
    filter: kalman::State,
    locals: Locals,
    mixture: Mixture,
    /// y no larger than [`LIMIT`].
    heard: Vec<f64>,
    /// y − D u, then what is left of y by x[k|k].
    reading: Vec<f64>,
    /// y − C x[k|k−1] − D u of `heard`.
    innovation: Vec<f64>,
    /// γ and γ̂ of every sensor; 1 where none was asked for.
    belief: Vec<f64>,
    corrected: Vec<f64>,
    /// √γ̂ per channel.
    weights: Vec<f64>,
    information: Vec<f64>,
    shift: Vec<f64>,
}

/// What steps 2 and 3 found.
struct Judgement {
    outcome: Outcome,
    mean_attacked: f64,
    swapped: bool,
}

/// Nobody was judged.
const TRUSTING: Judgement = Judgement {
    outcome: Outcome { likelihood: f64::NAN, gap: 0.0, iterations: 0 },
    mean_attacked: 0.0,
    swapped: false,
};

impl MixtureFusion {
    /// Mixture fusion on `filter`. `priors` is the steady P_i⁻ of every sensor's own filter (N, n, n), or None for
    /// local filters that start from the fused prediction at every sample.
    ///
    /// # Errors
    /// A plant that varies, noise that correlates sensors, channels of a sensor that do not follow each other, or a
    /// length that does not fit.
    pub fn new(filter: Kalman, priors: Option<&[f64]>, settings: Settings) -> Result<Self> {
        let model = filter.model();
        if model.horizon.is_some() {
            return Err(Error::input("plant", "matrices that do not vary", "A or C for every sample"));
        }
        if !model.channel_sensor.is_sorted() {
            return Err(Error::input("channel_sensor", "the channels of a sensor side by side", "a mixture"));
        }
        if model.noise.within(&model.channel_sensor)? != model.noise {
            return Err(Error::input("R", "no correlation between sensors", "one"));
        }
        if settings.rules.cap == 0 {
            return Err(Error::input("cap", "at least 1", "0"));
        }
        let locals = Design::new(model, priors, settings.rules.precise)?;
        Ok(Self { filter, locals, settings })
    }

    fn state(&self, filter: kalman::State) -> State {
        let Dims { states: n, channels: m, sensors, .. } = self.filter.dims();
        State {
            locals: self.locals.start(&filter.x),
            filter,
            mixture: Mixture::new(sensors, n),
            heard: vec![0.0; m],
            reading: vec![0.0; m],
            innovation: vec![0.0; m],
            belief: vec![1.0; sensors],
            corrected: vec![1.0; sensors],
            weights: vec![1.0; m],
            information: vec![0.0; n],
            shift: vec![0.0; n],
        }
    }

    /// Step 1.
    fn estimate_locally(&self, state: &mut State, u: &[f64]) {
        let State { filter, locals, mixture, heard, reading, .. } = state;
        reading.copy_from_slice(heard);
        self.filter.model().subtract_feedthrough(u, reading);
        mixture.clear();
        let kalman::State { x, p, .. } = filter;
        let each = |sensor: usize, estimate: &[f64]| mixture.add(sensor, estimate);
        self.locals.correct(locals, p.gains.heard(), reading, (x, &p.prior), each);
    }

    /// Steps 2 and 3.
    fn judge(&self, state: &mut State) -> Judgement {
        let State { filter, locals, mixture, belief, corrected, .. } = state;
        belief.fill(1.0);
        corrected.fill(1.0);
        if filter.k < self.settings.start || mixture.count() < 2 {
            return TRUSTING;
        }
        let outcome = mixture.fit(&self.settings.rules, &locals.known, &filter.x);
        if outcome.overflowed() {
            return Judgement { outcome, ..TRUSTING };
        }
        let total: f64 = mixture.beliefs().map(|(_, _, attacked)| attacked).sum();
        let mean_attacked = total / mixture.count() as f64;
        let swapped = self.settings.epsilon.is_some_and(|epsilon| mean_attacked > epsilon);
        for (sensor, honest, attacked) in mixture.beliefs() {
            belief[sensor] = honest;
            corrected[sensor] = if swapped { attacked } else { honest };
        }
        Judgement { outcome, mean_attacked, swapped }
    }

    /// Step 4; false if the literal form would have led out of the range of numbers and γ̂ went into (22d) after all.
    fn fuse(&self, state: &mut State, swapped: bool, out: &mut Output<'_>) -> bool {
        let literally = self.settings.literal && swapped;
        if literally && self.fuse_literally(state, out) {
            return true;
        }
        if state.corrected.iter().all(|&belief| belief == 1.0) {
            self.fuse_plainly(state, out);
        } else {
            self.fuse_weighted(state, out);
        }
        !literally
    }

    /// The Kalman filter.
    fn fuse_plainly(&self, state: &mut State, out: &mut Output<'_>) {
        let kalman::State { k, x, p, scratch, .. } = &mut state.filter;
        self.filter.recursion.correct(p, *k, &state.heard, out.covariance.is_some());
        out.innovation.copy_from_slice(&state.innovation);
        p.gains.correct_with_innovation(self.filter.model(), x, scratch, out);
        self.filter.recursion.predict(p, *k);
    }

    /// (22c) and (22d) with γ̂ in both.
    fn fuse_weighted(&self, state: &mut State, out: &mut Output<'_>) {
        let model = self.filter.model();
        weigh(&state.corrected, &model.channel_sensor, &mut state.weights);
        let kalman::State { k, x, p, scratch, .. } = &mut state.filter;
        self.filter.recursion.listen(p, *k, &state.heard);
        p.correct_weighted(model, *k, &state.weights, out.covariance.is_some());
        let weighted = state.innovation.iter().zip(&state.weights).map(|(value, weight)| value * weight);
        out.innovation.iter_mut().zip(weighted).for_each(|(target, value)| *target = value);
        p.gains.correct_with_innovation(model, x, scratch, out);
        self.predict_covariance(state);
    }

    /// (22c) with γ̂ and (22d) with γ, as printed; false if x would leave the range of numbers.
    fn fuse_literally(&self, state: &mut State, out: &mut Output<'_>) -> bool {
        let (model, n) = (self.filter.model(), state.shift.len());
        let kalman::State { k, x, p, scratch, .. } = &mut state.filter;
        self.filter.recursion.listen(p, *k, &state.heard);
        let heard = p.gains.heard();
        let white = heard.whiten(&state.innovation, &mut scratch.channel);
        state.information.fill(0.0);
        for ((row, value), &channel) in heard.rows().chunks_exact(n).zip(white).zip(heard.channels()) {
            axpy(state.corrected[model.channel_sensor[channel]] * value, row, &mut state.information);
        }
        weigh(&state.belief, &model.channel_sensor, &mut state.weights);
        p.correct_weighted(model, *k, &state.weights, out.covariance.is_some());
        p.posterior().apply(&state.information, &mut scratch.state, &mut state.shift);
        axpy(1.0, x, &mut state.shift);
        if !state.shift.iter().all(|value| value.abs() < LIMIT) {
            return false;
        }
        x.copy_from_slice(&state.shift);
        p.gains.report(model, f64::NAN, x, out);
        self.predict_covariance(state);
        true
    }

    /// Step 5 for P after a weighted correction, which settles nothing.
    fn predict_covariance(&self, state: &mut State) {
        let kalman::State { k, p, .. } = &mut state.filter;
        self.filter.recursion.predict(p, *k);
        p.settled = false;
    }

    /// Trust, suspicion and attack of those heard; returns how many are suspected. x is x[k|k].
    fn report(&self, state: &mut State, (y, u): (&[f64], &[f64]), out: &mut Output<'_>) -> usize {
        let model = self.filter.model();
        for (sensor, _, _) in state.mixture.beliefs() {
            out.trust[sensor] = state.corrected[sensor];
            out.suspected[sensor] = u8::from(state.corrected[sensor] < 0.5);
        }
        model.innovation(state.filter.k, &state.filter.x, (y, u), &mut state.reading);
        for (i, &sensor) in model.channel_sensor.iter().enumerate() {
            let attack = if out.suspected[sensor] == 1 { state.reading[i] } else { 0.0 };
            out.attack[i] = if y[i].is_nan() { f64::NAN } else { attack };
        }
        out.suspected.iter().filter(|&&suspected| suspected == 1).count()
    }
}

/// How a step went in which something arrived.
fn status(outcome: &Outcome, went_through: bool, majority: bool) -> Status {
    let judged = outcome.iterations > 0;
    if !went_through || judged && outcome.overflowed() {
        Status::BrokenDown
    } else if majority {
        Status::MajoritySuspect
    } else if judged && !outcome.converged() {
        Status::NotConverged
    } else {
        Status::Ok
    }
}

/// √belief of the owner of every channel.
fn weigh(beliefs: &[f64], owners: &[usize], weights: &mut [f64]) {
    for (weight, &owner) in weights.iter_mut().zip(owners) {
        *weight = beliefs[owner].sqrt();
    }
}

impl Estimator for MixtureFusion {
    type State = State;
    type Plan = ();

    fn dims(&self) -> Dims {
        self.filter.dims()
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        &["log_likelihood", "iterations", "mean_attacked", "swapped", "gap", "channels"]
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        Ok(self.state(self.filter.start(mean, covariance)?))
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let model = self.filter.model();
        for (target, value) in state.heard.iter_mut().zip(y) {
            *target = value.clamp(-LIMIT, LIMIT);
        }
        let kalman::State { k, x, p, .. } = &mut state.filter;
        model.innovation(*k, x, (&state.heard, u), &mut state.innovation);
        self.filter.recursion.listen(p, *k, &state.heard);
        self.estimate_locally(state, u);
        let Judgement { outcome, mean_attacked, swapped } = self.judge(state);
        let went_through = self.fuse(state, swapped, out);
        for (i, target) in out.innovation.iter_mut().enumerate() {
            *target = state.innovation[i] + (y[i] - state.heard[i]);
        }
        let suspects = self.report(state, (y, u), out);
        let majority = 2 * suspects > state.mixture.count();
        if *out.status == Status::Ok as u8 {
            *out.status = status(&outcome, went_through, majority) as u8;
        }
        let channels = y.iter().filter(|value| !value.is_nan()).count() as f64;
        let Outcome { likelihood, gap, iterations } = outcome;
        let swapped = f64::from(u8::from(swapped));
        let numbers = [likelihood, iterations as f64, mean_attacked, swapped, gap, channels];
        out.diagnostics.copy_from_slice(&numbers);
        let at = state.filter.k;
        self.filter.predict_mean(&mut state.filter, u);
        self.locals.predict(&mut state.locals, model, (at, u), &state.filter.x);
        Ok(())
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        self.filter.save(&state.filter, to);
        if !self.locals.feedback() {
            to.floats(&state.locals.x);
        }
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let mut state = self.state(self.filter.load(from)?);
        if !self.locals.feedback() {
            from.floats(&mut state.locals.x)?;
        }
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        let Settings { epsilon, literal, start, rules } = self.settings;
        let switches = [literal, rules.precise, rules.prior_floor].map(usize::from);
        let own = Fingerprint::default()
            .bytes(&self.filter.fingerprint().to_le_bytes())
            .floats(epsilon.as_slice())
            .sizes(&switches)
            .sizes(&[start, rules.start as usize, rules.cap]);
        self.locals.numbers().fold(own, Fingerprint::floats).finish()
    }
}
