//! Who is honest, who lies steadily and who lies wildly: one fixed point of the beliefs, from one start.
//!
//! The whitened residual of sensor i is, with e ~ N(0, P⁻) common to all,
//!
//! ```text
//!     honest      r_i ~ N(C_i e, I)
//!     biased      r_i ~ N(C_i e + b_i, (1 + s_i) I),   b_i, s_i what is remembered of its injection
//!     wild        r_i ~ ⅓ N(0, V + κ I) + ⅓ N(μ, V + τ² I) + ⅓ N(μ', V + τ'² I)
//! ```
//!
//! V = h + I is what the others leave open. μ, τ² are learned from the wild of this sample, μ', τ'² from those lately.

use crate::linalg::dot;
use crate::mixture::information::Information;
use crate::mixture::sample::{Arrived, Sample};
use crate::secure::cavity::{Cavity, Way};
use crate::secure::settings::Settings;

/// Least 1 − λ H: rounding may take it below what a covariance allows.
const LEAST: f64 = 1e-14;

/// Evidence that an accusation beyond the most possible costs.
pub const MAJORITY: f64 = 1e3;

/// What is known of every sensor that arrived before its sample is judged.
#[derive(Debug, Clone)]
pub struct Prior {
    /// Probability that it is honest, lies steadily, lies wildly.
    pub honest: Vec<f64>,
    /// See `honest`.
    pub biased: Vec<f64>,
    /// See `honest`.
    pub wild: Vec<f64>,
    /// Probability that it lies by a constant.
    pub constant: Vec<f64>,
    /// b of a steady lie, by channel heard, whitened.
    pub bias: Vec<f64>,
    /// b of a constant one.
    pub offset: Vec<f64>,
    /// s
    pub spread: Vec<f64>,
    /// s of a constant one.
    pub scatter: Vec<f64>,
}

impl Prior {
    /// Room for N sensors and m channels.
    #[must_use]
    pub fn new(sensors: usize, channels: usize) -> Self {
        let room = || vec![0.0; sensors];
        Self {
            honest: room(),
            biased: room(),
            wild: room(),
            constant: room(),
            bias: vec![0.0; channels],
            offset: vec![0.0; channels],
            spread: room(),
            scatter: room(),
        }
    }
}

/// What to make of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Label {
    /// It tells the truth.
    Honest,
    /// It lies by about what it lied before.
    Biased,
    /// It lies by exactly what it lied before.
    Constant,
    /// It sends something else.
    Wild,
}

/// Beliefs and sites.
#[derive(Debug, Clone)]
pub struct Labels {
    /// Belief that a sensor is honest, by sensor that arrived.
    pub honest: Vec<f64>,
    /// The same that it lies steadily.
    pub biased: Vec<f64>,
    /// The same that it lies by a constant.
    pub constant: Vec<f64>,
    /// Densities of the sample as honest, constant, biased, wild, in a common unit.
    pub density: Vec<[f64; 4]>,
    /// Sites: λ, blocks of size².
    pub precision: Vec<f64>,
    /// Sites: η, by channel.
    pub eta: Vec<f64>,
    /// z, by channel: see [`crate::secure::cavity`].
    pub z: Vec<f64>,
    /// v, by channel.
    pub v: Vec<f64>,
    /// Turned m, by channel.
    pub mean: Vec<f64>,
    /// Rows of Qᵀ, blocks of size².
    pub turn: Vec<f64>,
    /// Largest change of a belief in the latest sweep.
    pub gap: f64,
    /// Sweeps so far.
    pub sweeps: usize,
    /// log evidence of the rounded beliefs.
    pub evidence: f64,
    mu: Vec<f64>,
    tau2: f64,
}

/// Scratch of a sweep.
#[derive(Debug, Clone)]
pub struct Scratch {
    /// C x − C x⁻, by channel.
    pub shift: Vec<f64>,
    /// Diagonal of C P Cᵀ, by channel.
    pub variance: Vec<f64>,
    /// For sensors with several channels.
    pub cavity: Cavity,
    /// μ, b and μ' in turned coordinates.
    turned: [Vec<f64>; 3],
    block: crate::mixture::block::Block,
}

impl Scratch {
    /// Room for m channels, at most `widest` of one sensor.
    #[must_use]
    pub fn new(m: usize, widest: usize) -> Self {
        let room = || vec![0.0; widest];
        Self {
            shift: vec![0.0; m],
            variance: vec![0.0; m],
            cavity: Cavity::new(widest),
            turned: [room(), room(), room()],
            block: crate::mixture::block::Block::new(widest),
        }
    }
}

impl Labels {
    /// Room.
    #[must_use]
    pub fn new(sensors: usize, channels: usize, blocks: usize, widest: usize) -> Self {
        let (sensor, channel) = (|| vec![0.0; sensors], || vec![0.0; channels]);
        Self {
            honest: sensor(),
            biased: sensor(),
            constant: sensor(),
            density: vec![[0.0; 4]; sensors],
            precision: vec![0.0; blocks],
            eta: channel(),
            z: channel(),
            v: channel(),
            mean: channel(),
            turn: vec![0.0; blocks],
            gap: 0.0,
            sweeps: 0,
            evidence: 0.0,
            mu: vec![0.0; widest],
            tau2: 1.0,
        }
    }

    /// Overwrite with `other`, without allocation.
    pub fn copy_from(&mut self, other: &Self) {
        let pairs = [
            (&mut self.honest, &other.honest),
            (&mut self.biased, &other.biased),
            (&mut self.constant, &other.constant),
            (&mut self.precision, &other.precision),
            (&mut self.eta, &other.eta),
            (&mut self.z, &other.z),
            (&mut self.v, &other.v),
            (&mut self.mean, &other.mean),
            (&mut self.turn, &other.turn),
            (&mut self.mu, &other.mu),
        ];
        pairs.into_iter().for_each(|(mine, theirs)| mine.copy_from_slice(theirs));
        self.density.copy_from_slice(&other.density);
        (self.gap, self.sweeps, self.evidence, self.tau2) = (other.gap, other.sweeps, other.evidence, other.tau2);
    }

    /// The label of a sensor that arrived.
    #[inline(always)]
    #[must_use]
    pub fn label(&self, index: usize) -> Label {
        let (honest, biased, constant) = (self.honest[index], self.biased[index], self.constant[index]);
        let wild = 1.0 - honest - biased - constant;
        if honest > 0.5 {
            Label::Honest
        } else if constant >= biased && constant >= wild {
            Label::Constant
        } else if biased >= wild {
            Label::Biased
        } else {
            Label::Wild
        }
    }

    /// Begin from beliefs (honest, biased).
    #[inline(always)]
    pub fn begin(&mut self, sample: &Sample, prior: &Prior, mut belief: impl FnMut(usize, &Arrived) -> (f64, f64)) {
        self.sweeps = 0;
        for (index, one) in sample.arrived.iter().enumerate() {
            let (honest, constant) = if one.protected { (1.0, 0.0) } else { belief(index, one) };
            (self.honest[index], self.biased[index], self.constant[index]) = (honest, 0.0, constant);
            let share = constant / (1.0 + prior.scatter[index]);
            let block = &mut self.precision[one.block..one.block + one.size * one.size];
            block.fill(0.0);
            for a in 0..one.size {
                let channel = one.first + a;
                let residual = sample.residual[channel];
                block[a * one.size + a] = honest + share;
                self.eta[channel] = honest * residual + share * (residual - prior.offset[channel]);
            }
        }
    }

    /// Give the sites to `information`.
    #[inline(always)]
    pub fn weigh(&self, sample: &Sample, information: &mut Information, scratch: &mut Scratch) {
        information.clear();
        for one in &sample.arrived {
            if one.size == 1 {
                information.weigh(self.precision[one.block].sqrt(), one.first);
            } else {
                let precision = &self.precision[one.block..one.block + one.size * one.size];
                scratch.block.factors(precision, one.size, |f| information.weigh_jointly(f, one.first));
            }
        }
    }

    /// z, v for every sensor that arrived, from the sites as they are.
    #[inline(always)]
    pub fn leave_out(&mut self, sample: &Sample, information: &mut Information, scratch: &mut Scratch) {
        let count = information.count();
        self.weigh(sample, information, scratch);
        information.update();
        information.expect(
            &self.eta[..count],
            &mut scratch.shift[..count],
            &mut scratch.variance[..count],
        );
        for one in &sample.arrived {
            let Arrived { first, size, block: at, .. } = *one;
            if size == 1 {
                let (spread, expected) = (scratch.variance[first], scratch.shift[first]);
                let d = 1.0 / (1.0 - self.precision[at] * spread).max(LEAST);
                let mean = d * (expected - spread * self.eta[first]);
                self.mean[first] = mean;
                self.z[first] = sample.residual[first] - mean;
                self.v[first] = 1.0 + d * spread;
                self.turn[at] = 1.0;
                continue;
            }
            let cavity = &mut scratch.cavity;
            cavity.spread[..size * size].fill(0.0);
            for w in information.w_t() {
                for a in 0..size {
                    for b in 0..size {
                        cavity.spread[a * size + b] += w[first + a] * w[first + b];
                    }
                }
            }
            let (range, block) = (first..first + size, at..at + size * size);
            cavity.leave_out(
                (&self.precision[block.clone()], &self.eta[range.clone()]),
                (&scratch.shift[range.clone()], &sample.residual[range.clone()]),
                (
                    &mut self.z[range.clone()],
                    &mut self.v[range.clone()],
                    &mut self.mean[range],
                    &mut self.turn[block],
                ),
            );
        }
    }

    /// Qᵀ-th component back to the channels of the sensor: (Q z)_a.
    #[inline(always)]
    #[must_use]
    pub fn unturned(&self, one: &Arrived, a: usize) -> f64 {
        let size = one.size;
        (0..size).map(|c| self.turn[one.block + c * size + a] * self.z[one.first + c]).sum()
    }

    /// The same of z over its deviation.
    #[inline(always)]
    fn standardised(&self, one: &Arrived, a: usize) -> f64 {
        let size = one.size;
        let part = |c: usize| self.z[one.first + c] / self.v[one.first + c].sqrt();
        (0..size).map(|c| self.turn[one.block + c * size + a] * part(c)).sum()
    }

    /// μ and τ² from the wild; with normal-inverse-gamma prior: one observation at 0.
    #[inline(always)]
    fn learn(&mut self, sample: &Sample, settings: &Settings) {
        let widest = sample.widest;
        let (mut count, mut square) = (0.0, 0.0);
        let mut mu = std::mem::take(&mut self.mu);
        mu[..widest].fill(0.0);
        for (index, one) in sample.arrived.iter().enumerate() {
            let weight = 1.0 - self.honest[index] - self.biased[index] - self.constant[index];
            count += weight;
            for (a, mu) in mu[..one.size].iter_mut().enumerate() {
                let value = self.standardised(one, a);
                *mu += weight * value;
                square += weight * value * value;
            }
        }
        mu[..widest].iter_mut().for_each(|mu| *mu /= count + 1.0);
        self.mu = mu;
        self.tau2 = settings.cluster_spread(count, square, &self.mu[..widest]);
    }

    /// One sweep over all sensors that arrived.
    #[inline(always)]
    pub fn sweep(
        &mut self,
        (sample, prior): (&Sample, &Prior),
        settings: &Settings,
        information: &mut Information,
        scratch: &mut Scratch,
    ) {
        self.leave_out(sample, information, scratch);
        self.learn(sample, settings);
        let step = if self.sweeps == 0 { 1.0 } else { 0.5 };
        self.gap = 0.0;
        for index in 0..sample.arrived.len() {
            let one = sample.arrived[index];
            if one.protected {
                self.density[index] = [1.0, 0.0, 0.0, 0.0];
                continue;
            }
            self.turn(&one, prior, scratch);
            let density = self.densities(&one, index, prior, settings, scratch);
            let joint = [
                prior.honest[index] * density[0],
                prior.constant[index] * density[1],
                prior.biased[index] * density[2],
                prior.wild[index] * density[3],
            ];
            let sum = joint[0] + joint[1] + joint[2] + joint[3];
            let scale = if sum > 0.0 { 1.0 / sum } else { 0.0 };
            let (honest, constant, biased) = (joint[0] * scale, joint[1] * scale, joint[2] * scale);
            self.density[index] = density;
            self.gap = self.gap.max((honest - self.honest[index]).abs());
            (self.honest[index], self.biased[index], self.constant[index]) = (honest, biased, constant);
            self.place(&one, index, prior, settings, step, scratch);
        }
        self.sweeps += 1;
    }

    /// μ, b, μ' in the coordinates of the sensor.
    #[inline(always)]
    fn turn(&self, one: &Arrived, prior: &Prior, scratch: &mut Scratch) {
        let Arrived { first, size, block, .. } = *one;
        let range = first..first + size;
        let sources =
            [&self.mu[..size], &prior.offset[range.clone()], &prior.bias[range]];
        for (turned, source) in scratch.turned.iter_mut().zip(sources) {
            if size == 1 {
                turned[0] = source[0];
                continue;
            }
            for (a, value) in turned[..size].iter_mut().enumerate() {
                *value = dot(&self.turn[block + a * size..block + (a + 1) * size], source);
            }
        }
    }

    /// Densities as honest, biased, wild, over the largest of their parts.
    #[inline(always)]
    fn densities(&self, one: &Arrived, index: usize, prior: &Prior, settings: &Settings, scratch: &Scratch) -> [f64; 4] {
        let Arrived { first, size, .. } = *one;
        let (z, v) = (&self.z[first..first + size], &self.v[first..first + size]);
        let gauss = |center: Option<&[f64]>, added: f64| {
            let (mut square, mut det) = (0.0, 1.0);
            for a in 0..size {
                let variance = v[a] + added;
                let d = z[a] - center.map_or(0.0, |center| center[a]);
                square += d * d / variance;
                det *= variance;
            }
            (-0.5 * square, 1.0 / det.sqrt())
        };
        let wide = |center: Option<&[f64]>, added: f64| {
            let (mut square, mut det) = (0.0, 1.0);
            for a in 0..size {
                let d = z[a] / v[a].sqrt() - center.map_or(0.0, |center| center[a]);
                square += d * d;
                det *= v[a] * (1.0 + added);
            }
            (-0.5 * square / (1.0 + added), 1.0 / det.sqrt())
        };
        let parts = [
            gauss(None, 0.0),
            gauss(Some(&scratch.turned[1]), prior.scatter[index]),
            gauss(Some(&scratch.turned[2]), prior.spread[index]),
            wide(None, settings.kappa),
            wide(Some(&scratch.turned[0]), self.tau2),
        ];
        let largest = parts.iter().fold(f64::NEG_INFINITY, |largest, part| largest.max(part.0));
        if !largest.is_finite() {
            return [0.0, 0.0, 0.0, 1.0];
        }
        let density = |part: (f64, f64)| part.1 * (part.0 - largest).exp();
        let wild: f64 =
            parts[3..].iter().zip(&settings.shares).filter(|(_, share)| **share > 0.0).map(|(part, share)| share * density(*part)).sum();
        [density(parts[0]), density(parts[1]), density(parts[2]), wild]
    }

    /// The site of a sensor for its beliefs.
    #[inline(always)]
    fn place(&mut self, one: &Arrived, index: usize, prior: &Prior, settings: &Settings, step: f64, scratch: &mut Scratch) {
        let Arrived { first, size, block: at, .. } = *one;
        let (honest, biased) = (self.honest[index], self.constant[index]);
        let added = prior.scatter[index] + settings.reuse;
        if size > 1 {
            let Scratch { cavity, turned, .. } = scratch;
            let ways = [
                Way { belief: honest, bias: None, added: 0.0 },
                Way { belief: biased, bias: Some(&turned[1]), added },
            ];
            let (range, block) = (first..first + size, at..at + size * size);
            let view = (&self.z[range.clone()], &self.v[range.clone()], &self.mean[range.clone()], &self.turn[block.clone()]);
            cavity.match_moments(&ways, view, step, (&mut self.precision[block], &mut self.eta[range]));
            return;
        }
        let (z, v, mean) = (self.z[first], self.v[first], self.mean[first]);
        let (w, wb) = (1.0 / v, 1.0 / (v + added));
        let (g, gb) = (z * w, (z - prior.offset[first]) * wb);
        let pull = honest * g + biased * gb;
        let curvature = honest * w + biased * wb - (honest * g * g + biased * gb * gb - pull * pull);
        let h = v - 1.0;
        let new = if curvature > 0.0 { curvature / (1.0 - h * curvature) } else { 0.0 };
        let shift = new * (mean + h * pull) + pull;
        let (lambda, eta) = (&mut self.precision[at], &mut self.eta[first]);
        *lambda = (1.0 - step) * *lambda + step * new;
        *eta = (1.0 - step) * *eta + step * shift;
    }

    /// log evidence of the rounded beliefs: exact for those who say something about the state, given them for the wild.
    /// Leaves the sites of the rounded beliefs' estimate in `information`, η in `scratch.shift`.
    #[inline(always)]
    pub fn weigh_evidence(
        &mut self,
        (sample, prior): (&Sample, &Prior),
        settings: &Settings,
        information: &mut Information,
        scratch: &mut Scratch,
        eta: &mut [f64],
    ) {
        information.clear();
        let (mut log, mut accused) = (0.0, 0_usize);
        eta.fill(0.0);
        for (index, one) in sample.arrived.iter().enumerate() {
            let label = self.label(index);
            let p = match label {
                Label::Honest => prior.honest[index],
                Label::Biased => prior.biased[index],
                Label::Constant => prior.constant[index],
                Label::Wild => prior.wild[index],
            };
            log += if one.protected { 0.0 } else { p.ln() };
            accused += usize::from(label != Label::Honest);
            if label == Label::Wild || label == Label::Biased {
                continue;
            }
            let constant = label == Label::Constant;
            let added = if constant { 1.0 + prior.scatter[index] + settings.reuse } else { 1.0 };
            for channel in one.first..one.first + one.size {
                let bias = if constant { prior.offset[channel] } else { 0.0 };
                let residual = sample.residual[channel] - bias;
                log -= 0.5 * (residual * residual / added + added.ln());
                eta[channel] = residual / added;
                information.weigh((1.0 / added).sqrt(), channel);
            }
        }
        information.update();
        let (log_det, square) = information.evidence(eta);
        let count = information.count();
        information.expect(eta, &mut scratch.shift[..count], &mut scratch.variance[..count]);
        log += square - log_det;
        for (index, one) in sample.arrived.iter().enumerate() {
            match self.label(index) {
                Label::Wild => log += self.outside(one, None, (sample, prior), settings, scratch),
                Label::Biased => {
                    log += self.outside(one, Some(index), (sample, prior), settings, scratch);
                }
                _ => {}
            }
        }
        let beyond = accused.saturating_sub(settings.most(sample));
        self.evidence = log - MAJORITY * beyond as f64;
    }

    /// log density of a sensor that says nothing about the state, given those that do; as if its channels were
    /// independent.
    fn outside(
        &self,
        one: &Arrived,
        biased: Option<usize>,
        (sample, prior): (&Sample, &Prior),
        settings: &Settings,
        scratch: &Scratch,
    ) -> f64 {
        let gauss = |center: Option<&[f64]>, added: f64| {
            (0..one.size).fold(0.0, |log, a| {
                let channel = one.first + a;
                let variance = 1.0 + scratch.variance[channel] + added;
                let d = sample.residual[channel] - scratch.shift[channel] - center.map_or(0.0, |center| center[a]);
                log - 0.5 * (d * d / variance + variance.ln())
            })
        };
        if let Some(index) = biased {
            return gauss(Some(&prior.bias[one.first..one.first + one.size]), prior.spread[index]);
        }
        let wide = |center: Option<&[f64]>, added: f64| {
            (0..one.size).fold(0.0, |log, a| {
                let channel = one.first + a;
                let variance = 1.0 + scratch.variance[channel];
                let d = (sample.residual[channel] - scratch.shift[channel]) / variance.sqrt();
                let d = d - center.map_or(0.0, |center| center[a]);
                log - 0.5 * (d * d / (1.0 + added) + (variance * (1.0 + added)).ln())
            })
        };
        let parts = [wide(None, settings.kappa), wide(Some(&self.mu), self.tau2)];
        let largest = parts.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
        let sum: f64 = parts.iter().zip(&settings.shares).map(|(log, share)| share * (log - largest).exp()).sum();
        largest + sum.ln()
    }

    /// Take in another labelling with the given weight.
    pub fn merge(&mut self, other: &Self, weight: f64, arrived: usize) {
        let mix = |mine: &mut f64, theirs: f64| *mine += weight * (theirs - *mine);
        for index in 0..arrived {
            mix(&mut self.honest[index], other.honest[index]);
            mix(&mut self.biased[index], other.biased[index]);
            mix(&mut self.constant[index], other.constant[index]);
        }
    }

    /// Whether the rounded beliefs are the same.
    #[must_use]
    pub fn agrees(&self, other: &Self, arrived: usize) -> bool {
        (0..arrived).all(|index| (self.honest[index] > 0.5) == (other.honest[index] > 0.5))
    }
}

