//! One correction of the Kalman filter in two parts: what does not depend on the data, and what does.
//!
//! Which channels arrived fixes gains and covariances; the data part is a few products along contiguous memory.
//! Runs that miss the same samples share the first part and stay equal to the bit.

use crate::kalman::heard::Heard;
use crate::kalman::model::{Model, add_product};
use crate::kalman::ud::Ud;
use crate::kalman::whitening::{LogProduct, Noise};
use crate::lanes::{self, LANES, Lanes, zip};
use crate::linalg::{axpy, dot};
use crate::{Dims, Output, Status};
use std::ops::Range;

/// Everything about a correction that the data do not change.
#[derive(Debug, Clone)]
pub struct Gains {
    /// The channels that arrived.
    heard: Heard,
    /// Gain of each whitened channel, (channels, n).
    gain: Vec<f64>,
    /// 1 / s of each whitened channel, given those before it.
    precision: Vec<f64>,
    /// Of the s so far.
    product: LogProduct,
    /// log det(2π S) over the channels that arrived.
    log_det: f64,
    status: Status,
    x_std: Vec<f64>,
    innovation_std: Vec<f64>,
    /// P[k|k], (n, n); up to date only if it was asked for.
    covariance: Vec<f64>,
}

/// Scratch of the data part and of the covariance part.
#[derive(Debug, Clone)]
pub struct Scratch {
    /// (n,)
    pub state: Vec<f64>,
    /// (m,)
    pub channel: Vec<f64>,
}

impl Scratch {
    /// Room for one sample.
    #[must_use]
    pub fn new(dims: Dims) -> Self {
        Self { state: vec![0.0; dims.states], channel: vec![0.0; dims.channels] }
    }
}

impl Gains {
    /// Room for one sample with the noise of the model.
    #[must_use]
    pub fn new(model: &Model) -> Self {
        Self::with_noise(model, &model.noise)
    }

    /// Room for one sample with noise in an order of its own.
    #[must_use]
    pub fn with_noise(model: &Model, noise: &Noise) -> Self {
        let (n, m) = (model.dims.states, model.dims.channels);
        Self {
            heard: Heard::new(model, noise),
            gain: vec![0.0; m * n],
            precision: vec![0.0; m],
            product: LogProduct::default(),
            log_det: 0.0,
            status: Status::NoMeasurement,
            x_std: vec![0.0; n],
            innovation_std: vec![0.0; m],
            covariance: vec![0.0; n * n],
        }
    }

    /// Bytes that one sample takes.
    #[must_use]
    pub fn size(model: &Model) -> usize {
        let (n, m) = (model.dims.states, model.dims.channels);
        size_of::<f64>() * (2 * m * n + 4 * m + n + n * n)
    }

    /// Overwrite with the gains of `full`, made by [`Gains::listen`] with every channel present.
    pub fn listen_to_all(&mut self, full: &Self) {
        self.heard.copy_from(&full.heard);
    }

    /// Note which channels of y arrived and make their noise independent.
    pub fn listen(&mut self, model: &Model, k: usize, y: &[f64]) {
        self.heard.listen(model, &model.noise, k, y);
    }

    /// As [`Gains::listen`] with other noise; see [`Heard::listen`].
    pub fn listen_with(&mut self, model: &Model, noise: &Noise, k: usize, y: &[f64]) {
        self.heard.listen(model, noise, k, y);
    }

    /// As [`Heard::weigh`]: innovations must be weighted likewise.
    pub fn weigh(&mut self, weights: &[f64]) {
        self.heard.weigh(weights);
    }

    /// What these gains hear.
    #[must_use]
    pub fn heard(&self) -> &Heard {
        &self.heard
    }

    /// The channels that these gains use, in the order of their noise.
    #[must_use]
    pub fn channels(&self) -> &[usize] {
        self.heard.channels()
    }

    /// From P[k|k−1] in `p` to P[k|k], one channel after the other; notes gains and standard deviations.
    pub fn correct_covariance(
        &mut self,
        model: &Model,
        k: usize,
        p: &mut Ud,
        scratch: &mut Scratch,
        keep_covariance: bool,
    ) {
        self.expect(model, k, p, scratch);
        self.condition(0..self.channels().len(), p, scratch);
        self.conclude(p, keep_covariance);
    }

    /// First part of [`Gains::correct_covariance`]: how far the channels may be from the prediction of P[k|k−1].
    pub fn expect(&mut self, model: &Model, k: usize, p: &Ud, scratch: &mut Scratch) {
        innovation_deviations(model, k, p, &mut scratch.channel, &mut self.innovation_std);
        self.product = LogProduct::default();
    }

    /// Second part: take in some of the channels, counted among those heard, given all before them.
    pub fn condition(&mut self, some: Range<usize>, p: &mut Ud, scratch: &mut Scratch) {
        let n = scratch.state.len();
        for i in some {
            let row = &self.heard.rows()[i * n..(i + 1) * n];
            let s = p.condition(row, &mut scratch.state, &mut self.gain[i * n..(i + 1) * n]);
            self.product.multiply(s);
            self.precision[i] = 1.0 / s;
        }
    }

    /// Last part: note P[k|k].
    pub fn conclude(&mut self, p: &Ud, keep_covariance: bool) {
        self.log_det = self.heard.log_det + self.product.log();
        p.variances(&mut self.x_std);
        self.x_std.iter_mut().for_each(|v| *v = v.sqrt());
        if keep_covariance {
            p.covariance(&mut self.covariance);
        }
        self.status = match self.channels().len() {
            _ if !self.x_std.iter().all(|v| v.is_finite()) => Status::IllConditioned,
            0 => Status::NoMeasurement,
            _ => Status::Ok,
        };
    }

    /// From x[k|k−1] to x[k|k] in `x`, and everything there is to report.
    pub fn correct(
        &self,
        model: &Model,
        k: usize,
        x: &mut [f64],
        (y, u): (&[f64], &[f64]),
        scratch: &mut Scratch,
        out: &mut Output<'_>,
    ) {
        model.innovation(k, x, (y, u), out.innovation);
        self.correct_with_innovation(model, x, scratch, out);
    }

    /// As [`Gains::correct`] with the innovation in `out` already; channels without a gain keep theirs.
    pub fn correct_with_innovation(
        &self,
        model: &Model,
        x: &mut [f64],
        scratch: &mut Scratch,
        out: &mut Output<'_>,
    ) {
        let nis = self.shift(out.innovation, scratch);
        axpy(1.0, &scratch.state, x);
        self.report(model, nis, x, out);
    }

    /// Leaves x[k|k] − x[k|k−1] in `scratch`; returns the normalised innovation squared.
    pub fn shift(&self, innovation: &[f64], scratch: &mut Scratch) -> f64 {
        self.shift_by(self.channels().len(), innovation, scratch)
    }

    /// The same by the first `count` channels only; leaves L⁻¹ of all innovations at the front of `scratch.channel`.
    pub fn shift_by(&self, count: usize, innovation: &[f64], scratch: &mut Scratch) -> f64 {
        let mut nis = 0.0;
        self.walk(count, innovation, scratch, |_, surprise, precision| {
            nis += surprise * surprise * precision;
        });
        nis
    }

    /// As [`Gains::shift`]; writes what is new in each channel that arrived, in units of its standard deviation, to
    /// the front of `out`.
    pub fn surprises(&self, innovation: &[f64], scratch: &mut Scratch, out: &mut [f64]) {
        let count = self.channels().len();
        self.walk(count, innovation, scratch, |j, surprise, precision| out[j] = surprise * precision.sqrt());
    }

    /// log det(2π S) over the channels that arrived.
    #[must_use]
    pub fn log_det(&self) -> f64 {
        self.log_det
    }

    /// Correct by the first `count` whitened channels; `each` gets its number, what is new in it and 1 / s.
    #[inline(always)]
    fn walk(
        &self,
        count: usize,
        innovation: &[f64],
        scratch: &mut Scratch,
        mut each: impl FnMut(usize, f64, f64),
    ) {
        let (white, shift) = (self.heard.whiten(innovation, &mut scratch.channel), &mut scratch.state);
        let (n, white) = (shift.len(), &white[..count]);
        shift.fill(0.0);
        let rows = self.heard.rows().chunks_exact(n).zip(self.gain.chunks_exact(n));
        for (j, (((row, gain), precision), value)) in rows.zip(&self.precision).zip(white).enumerate() {
            let surprise = *value - dot(row, shift);
            each(j, surprise, *precision);
            axpy(surprise, gain, shift);
        }
    }

    /// As [`Gains::correct`], to the bit, for several runs; reports only what the data change.
    #[inline(always)]
    pub fn correct_lanes(&self, model: &Model, k: usize, runs: &mut Lanes) {
        let n = runs.x.len();
        model.innovation_lanes(k, &runs.x, (&runs.y, &runs.u), &mut runs.innovation);
        let channels = self.heard.channels();
        let white = &mut runs.white[..channels.len()];
        for (value, &channel) in white.iter_mut().zip(channels) {
            *value = runs.innovation[channel];
        }
        self.heard.whitening().apply_lanes(white);
        let shift = &mut runs.next;
        shift.fill([0.0; LANES]);
        let mut nis = [0.0; LANES];
        let rows = self.heard.rows().chunks_exact(n).zip(self.gain.chunks_exact(n));
        for (((row, gain), precision), value) in rows.zip(&self.precision).zip(white) {
            let surprise = zip(value, &lanes::dot(row, shift), |value, known| value - known);
            nis = zip(&nis, &surprise, |nis, surprise| nis + surprise * surprise * precision);
            lanes::axpy(&surprise, gain, shift);
        }
        for (x, shift) in runs.x.iter_mut().zip(shift) {
            *x = zip(x, shift, |x, shift| x + shift);
        }
        let numbers = [nis.map(|nis| -0.5 * (self.log_det + nis)), nis, [channels.len() as f64; LANES]];
        runs.diagnostics.copy_from_slice(&numbers);
    }

    /// Everything there is to report but the innovation.
    pub fn report(&self, model: &Model, nis: f64, x: &[f64], out: &mut Output<'_>) {
        out.x.copy_from_slice(x);
        out.x_std.copy_from_slice(&self.x_std);
        out.innovation_std.copy_from_slice(&self.innovation_std);
        if let Some(covariance) = out.covariance.as_deref_mut() {
            covariance.copy_from_slice(&self.covariance);
        }
        out.attack.fill(f64::NAN);
        out.attack_std.fill(f64::NAN);
        out.suspected.fill(0);
        out.trust.fill(f64::NAN);
        for &channel in self.channels() {
            out.trust[model.channel_sensor[channel]] = 1.0;
        }
        let numbers = [-0.5 * (self.log_det + nis), nis, self.channels().len() as f64];
        out.diagnostics[..3].copy_from_slice(&numbers);
        *out.status = self.status as u8;
    }
}

/// sqrt diag(C P Cᵀ + R) of all channels, whether they arrived or not.
pub fn innovation_deviations(model: &Model, k: usize, p: &Ud, f: &mut [f64], out: &mut [f64]) {
    let (m, c_t) = (out.len(), model.c_t(k));
    for (i, variance) in out.iter_mut().enumerate() {
        *variance = model.noise.r[i * m + i];
    }
    for (j, &d) in p.d.iter().enumerate() {
        f.copy_from_slice(&c_t[j * m..(j + 1) * m]); // column j of C U
        add_product(1.0, &c_t[..j * m], p.column(j), f);
        for (variance, &value) in out.iter_mut().zip(f.iter()) {
            *variance += d * value * value;
        }
    }
    out.iter_mut().for_each(|variance| *variance = variance.sqrt());
}
