//! Who is honest, who lies by a constant, who by something that drifts, and who wildly: one fixed point of the beliefs,
//! from one start.
//!
//! The whitened residual of sensor i is, with e ~ N(0, P⁻) common to all,
//!
//! ```text
//!     honest       r_i ~ N(C_i e, I)
//!     constant     r_i ~ N(C_i e + b_i, (1 + s_i) I)        b_i, s_i: what is remembered of its injection
//!     drifting     ρ_i ~ N(b_i, V_i + s_i I)                the same of one that drifts
//!     wild         ½ N(0, 1 + κ) + ½ N(μ, 1 + τ²) of V_i^-½ ρ_i in every channel
//! ```
//!
//! ρ_i = r_i − m_i, V_i: how far it is from what the others expect, and what they leave open. μ and τ² are learned from
//! the wild of this sample. Only an honest sensor and one that lies by a constant say anything about e. Beliefs and sites
//! (see [`crate::secure::cavity`]) are swept until they agree: expectation propagation.
//!
//! # References
//! Minka 2001 (expectation propagation).

use crate::linalg::dot;
use crate::mixture::block::Block;
use crate::mixture::information::Information;
use crate::mixture::sample::{Arrived, Sample};
use crate::secure::cavity::{Cavity, View, Way};
use crate::secure::density::{self, Lies};
use crate::secure::settings::{CAUTION, cluster_spread};

/// Least 1 − λ H: rounding may take it below what a covariance allows.
const LEAST: f64 = 1e-14;

/// What is known of every sensor that arrived before its sample is judged.
#[derive(Debug, Clone)]
pub struct Prior {
    /// Probability that it is honest, lies by a constant, by something that drifts, wildly.
    pub probability: Vec<[f64; 4]>,
    /// s of a constant and of a drifting injection.
    pub spread: Vec<[f64; 2]>,
    /// b of a constant one, by channel heard, whitened.
    pub offset: Vec<f64>,
    /// b of a drifting one.
    pub drift: Vec<f64>,
    /// Noise that is added to a sensor that lies by a constant, in units of R.
    pub reuse: f64,
}

impl Prior {
    /// Room for N sensors and m channels.
    #[must_use]
    pub fn new(sensors: usize, channels: usize) -> Self {
        Self {
            probability: vec![[0.0; 4]; sensors],
            spread: vec![[0.0; 2]; sensors],
            offset: vec![0.0; channels],
            drift: vec![0.0; channels],
            reuse: CAUTION,
        }
    }

    /// Noise of a sensor that lies by a constant, in units of R.
    #[inline(always)]
    pub(super) fn noise(&self, index: usize) -> f64 {
        1.0 + self.spread[index][0] + self.reuse
    }
}

/// What to make of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Label {
    /// It tells the truth.
    Honest,
    /// It lies by what it lied before.
    Constant,
    /// It lies by about what it lied before.
    Drifting,
    /// It sends something else.
    Wild,
}

/// Beliefs and sites.
#[derive(Debug, Clone)]
pub struct Labels {
    /// Belief that a sensor is honest, lies by a constant, by something that drifts, wildly; by sensor that arrived.
    pub belief: Vec<[f64; 4]>,
    /// Densities of the sample in these cases, in a common unit.
    pub density: Vec<[f64; 4]>,
    /// Sites: λ, blocks of size².
    pub precision: Vec<f64>,
    /// Sites: η, by channel.
    pub eta: Vec<f64>,
    /// z, v and the turned m by channel, rows of Qᵀ in blocks of size²: see [`crate::secure::cavity`].
    pub z: Vec<f64>,
    /// See `z`.
    pub v: Vec<f64>,
    mean: Vec<f64>,
    turn: Vec<f64>,
    /// Largest change of a belief in the latest sweep.
    pub gap: f64,
    /// Sweeps so far.
    pub sweeps: usize,
    /// log evidence of the rounded beliefs.
    pub evidence: f64,
    /// Sums over the wild: beliefs, also times channels, squares of their standardised residuals, and these by channel
    /// within a sensor.
    count: f64,
    channels: f64,
    square: f64,
    sum: Vec<f64>,
}

/// Scratch of a sweep.
#[derive(Debug, Clone)]
pub struct Scratch {
    /// C x − C x⁻, by channel.
    pub shift: Vec<f64>,
    /// Diagonal of C P Cᵀ, by channel.
    pub variance: Vec<f64>,
    /// For sensors with several channels.
    cavity: Cavity,
    block: Block,
    /// μ of the others' lies.
    pub(super) mu: Vec<f64>,
    /// μ, b of a constant and of a drifting injection in turned coordinates.
    turned: [Vec<f64>; 3],
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
            block: Block::new(widest),
            mu: room(),
            turned: [room(), room(), room()],
        }
    }
}

impl Labels {
    /// Room.
    #[must_use]
    pub fn new(sensors: usize, channels: usize, blocks: usize, widest: usize) -> Self {
        let channel = || vec![0.0; channels];
        Self {
            belief: vec![[0.0; 4]; sensors],
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
            count: 0.0,
            channels: 0.0,
            square: 0.0,
            sum: vec![0.0; widest],
        }
    }

    /// Overwrite with `other`, without allocation.
    pub fn copy_from(&mut self, other: &Self) {
        let pairs = [
            (&mut self.precision, &other.precision),
            (&mut self.eta, &other.eta),
            (&mut self.z, &other.z),
            (&mut self.v, &other.v),
            (&mut self.mean, &other.mean),
            (&mut self.turn, &other.turn),
            (&mut self.sum, &other.sum),
        ];
        pairs.into_iter().for_each(|(mine, theirs)| mine.copy_from_slice(theirs));
        self.belief.copy_from_slice(&other.belief);
        self.density.copy_from_slice(&other.density);
        (self.gap, self.sweeps) = (other.gap, other.sweeps);
        self.evidence = other.evidence;
        (self.count, self.channels, self.square) = (other.count, other.channels, other.square);
    }

    /// Whether a sensor that arrived is believed.
    #[inline(always)]
    #[must_use]
    pub fn believes(&self, index: usize) -> bool {
        self.belief[index][0] > 0.5
    }

    /// The label of a sensor that arrived.
    #[inline(always)]
    #[must_use]
    pub fn label(&self, index: usize) -> Label {
        let [_, constant, drifting, wild] = self.belief[index];
        match () {
            () if self.believes(index) => Label::Honest,
            () if constant >= drifting && constant >= wild => Label::Constant,
            () if drifting >= wild => Label::Drifting,
            () => Label::Wild,
        }
    }

    /// Whether others are believed than before the sample was seen.
    #[must_use]
    pub fn surprises(&self, prior: &Prior, arrived: usize) -> bool {
        (0..arrived).any(|index| self.believes(index) != (prior.probability[index][0] > 0.5))
    }

    /// Whether the same sensors are believed.
    #[must_use]
    pub fn agrees(&self, other: &Self, arrived: usize) -> bool {
        (0..arrived).all(|index| self.believes(index) == other.believes(index))
    }

    /// Believe or do not: whoever is not believed lies wildly.
    pub fn round(&mut self, arrived: usize) {
        for belief in &mut self.belief[..arrived] {
            *belief = if belief[0] > 0.5 { [1.0, 0.0, 0.0, 0.0] } else { [0.0, 0.0, 0.0, 1.0] };
        }
    }

    /// Take in another labelling with the given weight.
    pub fn merge(&mut self, other: &Self, weight: f64, arrived: usize) {
        for (mine, theirs) in self.belief[..arrived].iter_mut().zip(&other.belief) {
            mine.iter_mut().zip(theirs).for_each(|(mine, theirs)| *mine += weight * (theirs - *mine));
        }
    }

    /// Begin from beliefs that a sensor is honest, and that it lies by a constant.
    #[inline(always)]
    pub fn begin(&mut self, sample: &Sample, prior: &Prior, belief: impl Fn(usize, &Arrived) -> (f64, f64)) {
        self.sweeps = 0;
        for (index, one) in sample.arrived.iter().enumerate() {
            let (honest, constant) = if one.protected { (1.0, 0.0) } else { belief(index, one) };
            self.belief[index] = [honest, constant, 0.0, 1.0 - honest - constant];
            let share = constant / prior.noise(index);
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

    /// What the others expect of every sensor that arrived, from the sites as they are.
    #[inline(always)]
    pub fn leave_out(&mut self, sample: &Sample, information: &mut Information, scratch: &mut Scratch) {
        let count = information.count();
        self.weigh(sample, information, scratch);
        information.update();
        let Scratch { shift, variance, cavity, .. } = scratch;
        information.expect(&self.eta[..count], &mut shift[..count], &mut variance[..count]);
        for one in &sample.arrived {
            let Arrived { first, size, block: at, .. } = *one;
            if size == 1 {
                let (spread, expected) = (variance[first], shift[first]);
                let d = 1.0 / (1.0 - self.precision[at] * spread).max(LEAST);
                let mean = d * (expected - spread * self.eta[first]);
                (self.mean[first], self.turn[at]) = (mean, 1.0);
                self.z[first] = sample.residual[first] - mean;
                self.v[first] = 1.0 + d * spread;
                continue;
            }
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
                (&shift[range.clone()], &sample.residual[range.clone()]),
                (&mut self.z[range.clone()], &mut self.v[range.clone()]),
                (&mut self.mean[range], &mut self.turn[block]),
            );
        }
    }

    /// ρ_a, from the turned z.
    #[inline(always)]
    #[must_use]
    pub fn residual(&self, one: &Arrived, a: usize) -> f64 {
        (0..one.size).map(|c| self.turn[one.block + c * one.size + a] * self.z[one.first + c]).sum()
    }

    /// (V^-½ ρ)_a
    #[inline(always)]
    fn standardised(&self, one: &Arrived, a: usize) -> f64 {
        let part = |c: usize| self.z[one.first + c] / self.v[one.first + c].sqrt();
        (0..one.size).map(|c| self.turn[one.block + c * one.size + a] * part(c)).sum()
    }

    /// Sum up the wild.
    #[inline(always)]
    fn learn(&mut self, sample: &Sample) {
        (self.count, self.channels, self.square) = (0.0, 0.0, 0.0);
        self.sum[..sample.widest].fill(0.0);
        for (index, one) in sample.arrived.iter().enumerate() {
            let weight = self.belief[index][3];
            self.count += weight;
            self.channels += weight * one.size as f64;
            for a in 0..one.size {
                let value = self.standardised(one, a);
                self.sum[a] += weight * value;
                self.square += weight * value * value;
            }
        }
    }

    /// μ into `mu`, and τ², from all wild but one sensor, whose belief is or was `weight`; with normal-inverse-gamma prior:
    /// one observation at 0. A sensor that took part in what it is compared with would explain itself.
    #[inline(always)]
    pub(super) fn cluster(&self, one: &Arrived, weight: f64, mu: &mut [f64]) -> f64 {
        let count = (self.count - weight).max(0.0);
        let mut square = self.square;
        for (a, mu) in mu[..one.size].iter_mut().enumerate() {
            let value = self.standardised(one, a);
            square -= weight * value * value;
            *mu = (self.sum[a] - weight * value) / (count + 1.0);
        }
        let channels = (self.channels - weight * one.size as f64).max(0.0);
        cluster_spread((count, channels), square.max(0.0), &mu[..one.size])
    }

    /// One sweep over all sensors that arrived.
    #[inline(always)]
    pub fn sweep(
        &mut self,
        (sample, prior): (&Sample, &Prior),
        information: &mut Information,
        scratch: &mut Scratch,
    ) {
        self.leave_out(sample, information, scratch);
        self.learn(sample);
        let step = if self.sweeps == 0 { 1.0 } else { 0.5 };
        self.gap = 0.0;
        for (index, one) in sample.arrived.iter().enumerate() {
            if one.protected {
                self.density[index] = [1.0, 0.0, 0.0, 0.0];
                continue;
            }
            let Scratch { mu, .. } = scratch;
            let tau2 = self.cluster(one, self.belief[index][3], mu);
            self.turn(one, prior, scratch);
            let density = self.judge(one, prior.spread[index], tau2, scratch);
            let mut belief = prior.probability[index];
            belief.iter_mut().zip(&density).for_each(|(p, density)| *p *= density);
            let sum: f64 = belief.iter().sum();
            if sum > 0.0 {
                belief.iter_mut().for_each(|p| *p /= sum);
            } else {
                belief = [0.0, 0.0, 0.0, 1.0];
            }
            self.gap = self.gap.max((belief[0] - self.belief[index][0]).abs());
            (self.belief[index], self.density[index]) = (belief, density);
            self.place(
                one,
                (belief[0], belief[1]),
                (prior.offset[one.first], prior.noise(index)),
                step,
                scratch,
            );
        }
        self.sweeps += 1;
    }

    /// μ and b in the coordinates of the sensor.
    #[inline(always)]
    fn turn(&self, one: &Arrived, prior: &Prior, scratch: &mut Scratch) {
        let Arrived { first, size, block, .. } = *one;
        let range = first..first + size;
        let sources = [&scratch.mu[..size], &prior.offset[range.clone()], &prior.drift[range]];
        for (turned, source) in scratch.turned.iter_mut().zip(sources) {
            for (a, value) in turned[..size].iter_mut().enumerate() {
                *value = dot(&self.turn[block + a * size..block + (a + 1) * size], source);
            }
        }
    }

    /// Densities of a sensor in all cases.
    #[inline(always)]
    fn judge(&self, one: &Arrived, spread: [f64; 2], tau2: f64, scratch: &Scratch) -> [f64; 4] {
        let range = one.first..one.first + one.size;
        let [mu, offset, drift] = &scratch.turned;
        let lies = Lies { mu, tau2, offset, drift, spread };
        density::densities(&self.z[range.clone()], &self.v[range], &lies)
    }

    /// The site of a sensor for the beliefs that it is honest and that it lies by a constant.
    #[inline(always)]
    fn place(
        &mut self,
        one: &Arrived,
        (honest, constant): (f64, f64),
        (offset, noise): (f64, f64),
        step: f64,
        scratch: &mut Scratch,
    ) {
        let Arrived { first, size, block: at, .. } = *one;
        if size > 1 {
            let Scratch { cavity, turned, .. } = scratch;
            let ways = [
                Way { belief: honest, bias: None, added: 0.0 },
                Way { belief: constant, bias: Some(&turned[1]), added: noise - 1.0 },
            ];
            let (range, block) = (first..first + size, at..at + size * size);
            let view = View {
                z: &self.z[range.clone()],
                v: &self.v[range.clone()],
                mean: &self.mean[range.clone()],
                turn: &self.turn[block.clone()],
            };
            let (precision, eta) = (&mut self.precision[block], &mut self.eta[range]);
            cavity.match_moments(&ways, &view, step, (precision, eta));
            if !precision.iter().chain(&*eta).all(|value| value.is_finite()) {
                precision.iter_mut().chain(eta).for_each(|value| *value = 0.0);
            }
            return;
        }
        let (z, h, mean) = (self.z[first], self.v[first] - 1.0, self.mean[first]);
        let (w, wb) = (1.0 / (h + 1.0), 1.0 / (h + noise));
        let (g, gb) = (z * w, (z - offset) * wb);
        let pull = honest * g + constant * gb;
        let curvature = honest * w + constant * wb - (honest * g * g + constant * gb * gb - pull * pull);
        let new = if curvature > 0.0 { curvature / (1.0 - h * curvature) } else { 0.0 };
        let shift = new * (mean + h * pull) + pull;
        let (new, shift) = if shift.is_finite() { (new, shift) } else { (0.0, 0.0) };
        let (lambda, eta) = (&mut self.precision[at], &mut self.eta[first]);
        *lambda = (1.0 - step) * *lambda + step * new;
        *eta = (1.0 - step) * *eta + step * shift;
    }
}
