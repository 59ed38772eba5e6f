//! The Kalman filter on all sensors, in which the noise of those that may lie grows by what their lies seem to be.
//!
//! ```text
//!     1  condition x[k|k−1] on the protected channels
//!     2  ν_j, S_j: innovation of weak channel j given these, and its variance when nobody lies
//!        η_j = max(0, mean of ν_j² − S_j over the window), at once at least ν_j² − S_j if ν_j² > gate · S_j
//!     3  condition on the weak channels, with η on the diagonal of their noise covariance
//!     4  predict
//! ```
//!
//! # References
//! Compared in docs/adaptive-joint.md with the joint fusion of Chen, Weng, Ho, Yu 2022.

mod weak;
pub mod window;

use crate::adaptive_joint::weak::Weak;
use crate::adaptive_joint::window::{LIMIT, Window};
use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::kalman::gains::Gains;
use crate::kalman::whitening::Noise;
use crate::kalman::{self, Kalman};
use crate::{Dims, Error, Estimator, Output, Result};

/// The choices of the filter.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Whether nobody can tamper with a sensor, (N,).
    pub protected: Vec<bool>,
    /// Samples over which ν² − S is averaged.
    pub window: usize,
    /// ν²/S above which a sample counts at once.
    pub gate: f64,
    /// χ² quantile per number of channels tested, (m + 1,); infinite for none.
    pub quantiles: Vec<f64>,
}

/// A Kalman filter with noise that adapts.
#[derive(Debug, Clone)]
pub struct AdaptiveJoint {
    filter: Kalman,
    settings: Settings,
    /// R with the protected channels first.
    noise: Noise,
}

/// The Kalman filter's state, the window, and scratch.
#[derive(Debug, Clone)]
pub struct State {
    filter: kalman::State,
    window: Window,
    weak: Weak,
    /// R with η on its diagonal.
    noise: Noise,
    /// η per channel, (m,).
    eta: Vec<f64>,
    /// d_i² over its quantile per sensor; NaN where nothing arrived that may lie.
    excess: Vec<f64>,
    innovation: Vec<f64>,
}

impl AdaptiveJoint {
    /// A filter on `filter`.
    ///
    /// # Errors
    /// If a length does not fit, the window is empty, or the channels of a sensor do not follow each other.
    pub fn new(filter: Kalman, settings: Settings) -> Result<Self> {
        let model = filter.model();
        Error::check_len("quantiles", model.dims.channels + 1, settings.quantiles.len())?;
        Error::check_len("protected", model.dims.sensors, settings.protected.len())?;
        if settings.window == 0 {
            return Err(Error::input("window", "at least 1", "0"));
        }
        if !model.channel_sensor.is_sorted() {
            return Err(Error::input("channel_sensor", "the channels of a sensor side by side", "a mixture"));
        }
        let noise = model.noise.with_first(|channel| settings.protected[model.channel_sensor[channel]])?;
        Ok(Self { filter, settings, noise })
    }

    fn state(&self, mut filter: kalman::State) -> State {
        let model = self.filter.model();
        let Dims { channels, sensors, .. } = model.dims;
        filter.p.gains = Gains::with_noise(model, &self.noise);
        State {
            filter,
            window: Window::new(channels, self.settings.window),
            weak: Weak::new(model),
            noise: self.noise.clone(),
            eta: vec![0.0; channels],
            excess: vec![0.0; sensors],
            innovation: vec![0.0; channels],
        }
    }

    fn is_protected(&self, channel: usize) -> bool {
        self.settings.protected[self.filter.model().channel_sensor[channel]]
    }

    /// Cut what may lie to a size that has a square; any η it leads to makes it weightless.
    fn cut(&self, innovation: &mut [f64]) {
        let weak = innovation.iter_mut().enumerate().filter(|(i, _)| !self.is_protected(*i));
        weak.for_each(|(_, value)| *value = value.clamp(-LIMIT, LIMIT));
    }

    /// Step 1, and what the weak channels say given it; x[k|k−1] itself does not move yet.
    fn hear_protected(&self, state: &mut State, y: &[f64], innovation: &[f64]) {
        let model = self.filter.model();
        let kalman::State { k, p, scratch, .. } = &mut state.filter;
        p.gains.listen_with(model, &self.noise, *k, y);
        let from = p.gains.channels().iter().take_while(|&&channel| self.is_protected(channel)).count();
        p.expect(model, *k);
        p.condition(0..from);
        state.weak.listen(model, *k, p.gains.heard(), from, p.posterior());
        p.gains.shift_by(from, innovation, scratch);
        let quantiles = &self.settings.quantiles;
        state.weak.measure(
            model,
            p.gains.heard(),
            (innovation, LIMIT),
            quantiles,
            scratch,
            &mut state.excess,
        );
    }

    /// Step 2: η of the weak channels that arrived; returns the largest over R. Cuts ν as [`AdaptiveJoint::cut`] does.
    fn adapt(&self, state: &mut State, innovation: &mut [f64]) -> f64 {
        let State { filter, window, weak, eta, .. } = state;
        let (r, m) = (&self.filter.model().noise.r, eta.len());
        let mut largest = 0.0_f64;
        let heard = filter.p.gains.channels()[weak.from..].iter().zip(&weak.nu).zip(&weak.variance);
        for ((&channel, &nu), &variance) in heard {
            eta[channel] = window.eta(channel, nu, variance, self.settings.gate);
            largest = largest.max(eta[channel] / r[channel * m + channel]);
            innovation[channel] -= nu - nu.clamp(-LIMIT, LIMIT);
        }
        largest
    }

    /// Step 3 for the covariance.
    fn hear_weak(&self, state: &mut State, y: &[f64], keep: bool) {
        let kalman::State { k, p, .. } = &mut state.filter;
        state.noise.inflate(&self.noise, &state.eta);
        p.gains.listen_with(self.filter.model(), &state.noise, *k, y);
        p.condition(state.weak.from..p.gains.channels().len());
        p.conclude(keep);
    }

    /// Attack, trust and suspicion.
    fn report(&self, state: &State, y: &[f64], out: &mut Output<'_>) {
        for (i, value) in y.iter().enumerate() {
            let none = if value.is_nan() { f64::NAN } else { 0.0 };
            (out.attack[i], out.attack_std[i]) = (none, none);
        }
        let weak = &state.weak;
        let heard = state.filter.p.gains.channels()[weak.from..].iter().zip(&weak.nu).zip(&weak.variance);
        for ((&channel, &nu), &variance) in heard {
            (out.attack[channel], out.attack_std[channel]) = (nu, variance.sqrt());
        }
        for (sensor, &excess) in state.excess.iter().enumerate().filter(|(_, excess)| !excess.is_nan()) {
            out.trust[sensor] = 1.0 / (1.0 + excess);
            out.suspected[sensor] = u8::from(excess > 1.0);
        }
    }
}

impl Estimator for AdaptiveJoint {
    type State = State;
    type Plan = ();

    fn dims(&self) -> Dims {
        self.filter.dims()
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        &["log_likelihood", "nis", "channels", "eta"]
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        Ok(self.state(self.filter.start(mean, covariance)?))
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let (model, keep) = (self.filter.model(), out.covariance.is_some());
        self.filter.check_horizon(state.filter.k)?;
        model.innovation(state.filter.k, &state.filter.x, (y, u), out.innovation);
        state.innovation.copy_from_slice(out.innovation);
        self.cut(out.innovation);
        self.hear_protected(state, y, out.innovation);
        out.diagnostics[3] = self.adapt(state, out.innovation);
        self.hear_weak(state, y, keep);
        let kalman::State { k, x, p, scratch, .. } = &mut state.filter;
        p.gains.correct_with_innovation(model, x, scratch, out);
        self.filter.recursion.predict(p, *k);
        out.innovation.copy_from_slice(&state.innovation);
        self.report(state, y, out);
        self.filter.predict_mean(&mut state.filter, u);
        Ok(())
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        self.filter.save(&state.filter, to);
        state.window.save(to);
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let mut state = self.state(self.filter.load(from)?);
        state.window.load(from)?;
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        let Settings { protected, window, gate, quantiles } = &self.settings;
        let protected: Vec<usize> = protected.iter().map(|&one| usize::from(one)).collect();
        Fingerprint::default()
            .bytes(&self.filter.fingerprint().to_le_bytes())
            .sizes(&protected)
            .sizes(&[*window])
            .floats(&[*gate])
            .floats(quantiles)
            .finish()
    }
}
