//! Who is believed: one fixed point of the beliefs, from one start.
//!
//! Sensor i is honest, r_i ~ N(C_i e, R_i), or attacked, S_i^-½ r_i ~ N(μ, τ² I); e ~ N(0, P⁻) is common. What every
//! sensor says about e is kept as a Gaussian site of precision λ_i and shift η_i. One sweep, in whitened channels:
//!
//! ```text
//!     the others      d = 1 / (1 − λ H),  h = d H,  m = d (e − H η),  V = h + 1,  ρ = r − m
//!     attacked        μ = Σ (1 − γ) u / (n₂ + 1),  τ² = (2κ + Σ (1 − γ)(u − μ)² + μ²) / (n₂ + 3),  n₂ = Σ (1 − γ)
//!     belief          γ = N(ρ; 0, V) p / (N(ρ; 0, V) p + N(u; μ, τ²) |S|^-½ (1 − p))
//!     site            M = γ / V · max(0, 1 − (1 − γ) ρ² / V),  λ = M / (1 − h M),  η = λ (m + γ h ρ / V) + γ ρ / V
//! ```
//!
//! λ and η are those for which the Gaussian has the mean and variance of the mixture of honest and attacked. With belief
//! weighting instead, λ = γ and η = γ r.
//!
//! # References
//! Minka 2001 (expectation propagation).

use crate::mixture::block::Block;
use crate::mixture::information::Information;
use crate::mixture::sample::{Arrived, Sample};
use crate::mixture::settings::{Attacked, Form, Settings};

/// Least 1 − λ H: rounding may take it below what a covariance allows.
const LEAST: f64 = 1e-14;

/// Evidence that a majority of liars costs, per sensor.
const MAJORITY: f64 = 1e3;

/// Prior odds and density of every sensor that arrived.
#[derive(Debug, Clone)]
pub struct Prior {
    /// Probability of an attack.
    pub attacked: Vec<f64>,
    /// Its odds, times the part of the density of an attacked sensor that no sweep changes.
    pub odds: Vec<f64>,
    /// log density of an attacked sensor, if no sweep changes it.
    pub log_density: Vec<f64>,
}

impl Prior {
    /// Room for N sensors.
    #[must_use]
    pub fn new(sensors: usize) -> Self {
        let room = || vec![0.0; sensors];
        Self { attacked: room(), odds: room(), log_density: room() }
    }

    /// Odds and densities for the probabilities in `attacked`.
    #[inline(always)]
    pub fn weigh(&mut self, sample: &Sample, settings: &Settings) {
        for (index, one) in sample.arrived.iter().enumerate() {
            let log = match settings.attacked {
                Attacked::Learned => -0.5 * sample.log_det[index],
                Attacked::Student => student(settings, sample.square[index], one.size, sample.log_det[index]),
            };
            let p = self.attacked[index];
            self.log_density[index] = log;
            self.odds[index] = p / (1.0 - p) * log.exp();
        }
    }
}

/// log t(u), without the (2π)^-m/2 that a Gaussian has.
#[inline(always)]
pub fn student(settings: &Settings, square: f64, size: usize, log_det: f64) -> f64 {
    let Settings { degrees: nu, kappa, .. } = settings;
    settings.student[size] - 0.5 * log_det - 0.5 * (nu + size as f64) * (square / (nu * kappa)).ln_1p()
}

/// What the attacked density says of a sensor, and how far its site moves.
struct Case {
    /// Odds of an attack without the exponent.
    odds: f64,
    /// |u − μ|² / τ²
    distance: f64,
    /// Share of the way to the new site.
    step: f64,
    form: Form,
}

/// Beliefs and sites.
#[derive(Debug, Clone)]
pub struct Labels {
    /// Belief that a sensor is honest, by sensor that arrived.
    pub gamma: Vec<f64>,
    /// Sites: λ, blocks of size².
    pub precision: Vec<f64>,
    /// Sites: η, by channel.
    pub eta: Vec<f64>,
    /// Largest change of a belief in the latest sweep.
    pub gap: f64,
    /// Sweeps so far.
    pub sweeps: usize,
    /// log evidence of the rounded beliefs.
    pub evidence: f64,
    /// μ, by channel within a sensor.
    mu: Vec<f64>,
    /// n₂ by channel within a sensor.
    weight: Vec<f64>,
    /// τ²
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
    pub block: Block,
}

impl Scratch {
    /// Room for m channels, at most `widest` of one sensor.
    #[must_use]
    pub fn new(m: usize, widest: usize) -> Self {
        Self { shift: vec![0.0; m], variance: vec![0.0; m], block: Block::new(widest) }
    }
}

impl Labels {
    /// Room.
    #[must_use]
    pub fn new(sensors: usize, channels: usize, blocks: usize, widest: usize) -> Self {
        Self {
            gamma: vec![0.0; sensors],
            precision: vec![0.0; blocks],
            eta: vec![0.0; channels],
            gap: 0.0,
            sweeps: 0,
            evidence: 0.0,
            mu: vec![0.0; widest],
            weight: vec![0.0; widest],
            tau2: 1.0,
        }
    }

    /// Begin with `belief` of every sensor that arrived.
    #[inline(always)]
    pub fn begin(&mut self, sample: &Sample, belief: impl Fn(usize, &Arrived) -> f64) {
        (self.gap, self.sweeps, self.evidence) = (f64::INFINITY, 0, f64::NEG_INFINITY);
        for (index, one) in sample.arrived.iter().enumerate() {
            self.gamma[index] = if one.protected { 1.0 } else { belief(index, one) };
            self.believe(sample, index);
        }
    }

    /// Withdraw every belief in one sensor.
    pub fn disbelieve(&mut self, sample: &Sample, index: usize) {
        self.gamma[index] = 0.0;
        self.believe(sample, index);
    }

    /// λ = γ I, η = γ r.
    #[inline(always)]
    fn believe(&mut self, sample: &Sample, index: usize) {
        let (Arrived { first, size, block, .. }, gamma) = (sample.arrived[index], self.gamma[index]);
        self.precision[block..block + size * size].fill(0.0);
        for a in 0..size {
            self.precision[block + a * size + a] = gamma;
            self.eta[first + a] = gamma * sample.residual[first + a];
        }
    }

    /// Give the sites to `information`.
    #[inline(always)]
    pub fn weigh(&self, sample: &Sample, information: &mut Information, block: &mut Block) {
        information.clear();
        for one in &sample.arrived {
            if one.size == 1 {
                information.weigh(self.precision[one.block].sqrt(), one.first);
            } else {
                let precision = &self.precision[one.block..one.block + one.size * one.size];
                block.factors(precision, one.size, |f| information.weigh_jointly(f, one.first));
            }
        }
    }

    /// μ and τ² from the beliefs; with normal-inverse-gamma prior: one observation at 0, scale κ.
    #[inline(always)]
    fn learn(&mut self, sample: &Sample, kappa: f64) {
        let widest = sample.widest;
        self.mu[..widest].fill(0.0);
        self.weight[..widest].fill(0.0);
        for (one, gamma) in sample.arrived.iter().zip(&self.gamma) {
            for a in 0..one.size {
                self.weight[a] += 1.0 - gamma;
                self.mu[a] += (1.0 - gamma) * sample.surprise[one.first + a];
            }
        }
        let mut sum = 2.0 * kappa;
        let mut count = widest as f64 + 2.0;
        for (mu, weight) in self.mu[..widest].iter_mut().zip(&self.weight) {
            *mu /= weight + 1.0;
            sum += *mu * *mu;
            count += weight;
        }
        for (one, gamma) in sample.arrived.iter().zip(&self.gamma) {
            sum += (1.0 - gamma) * self.distance(sample, one);
        }
        self.tau2 = sum / count;
    }

    /// |S_i^-½ r_i − μ|²
    #[inline(always)]
    fn distance(&self, sample: &Sample, one: &Arrived) -> f64 {
        let surprise = &sample.surprise[one.first..one.first + one.size];
        surprise.iter().zip(&self.mu).map(|(u, mu)| (u - mu) * (u - mu)).sum()
    }

    /// One sweep over all sensors that arrived.
    #[inline(always)]
    pub fn sweep(
        &mut self,
        sample: &Sample,
        prior: &Prior,
        settings: &Settings,
        information: &mut Information,
        scratch: &mut Scratch,
    ) {
        let count = information.count();
        self.weigh(sample, information, &mut scratch.block);
        information.update();
        let (shift, variance) = (&mut scratch.shift[..count], &mut scratch.variance[..count]);
        information.expect(&self.eta[..count], shift, variance);
        let learned = settings.attacked == Attacked::Learned;
        if learned {
            self.learn(sample, settings.kappa);
        }
        let step = if self.sweeps == 0 { 1.0 } else { 0.5 };
        let inverse = if learned { 1.0 / self.tau2 } else { 0.0 };
        self.gap = 0.0;
        for index in 0..sample.arrived.len() {
            let one = sample.arrived[index];
            if one.protected {
                continue;
            }
            let case = Case {
                odds: prior.odds[index] * inverse_root(inverse, one.size, learned),
                distance: if learned { self.distance(sample, &one) * inverse } else { 0.0 },
                step,
                form: settings.form,
            };
            let gamma = if one.size == 1 {
                self.judge(&one, sample.residual[one.first], &case, scratch)
            } else {
                self.judge_jointly(&one, sample, information, &case, scratch)
            };
            self.gap = self.gap.max((gamma - self.gamma[index]).abs());
            self.gamma[index] = gamma;
            if settings.form == Form::Weight {
                self.believe(sample, index);
            }
        }
        self.sweeps += 1;
    }

    /// Where the others expect a sensor with one channel, and h, the variance of that, in `scratch` of these sites.
    #[inline(always)]
    #[must_use]
    pub fn others(&self, one: &Arrived, scratch: &Scratch) -> (f64, f64) {
        let (spread, expected) = (scratch.variance[one.first], scratch.shift[one.first]);
        let d = 1.0 / (1.0 - self.precision[one.block] * spread).max(LEAST);
        (d * (expected - spread * self.eta[one.first]), d * spread)
    }

    /// The same for a sensor with several channels, left in the block of `scratch`.
    pub fn others_jointly(
        &self,
        one: &Arrived,
        sample: &Sample,
        information: &Information,
        scratch: &mut Scratch,
    ) {
        let Arrived { first, size, block: at, .. } = *one;
        let block = &mut scratch.block;
        block.spread[..size * size].fill(0.0);
        for w in information.w_t() {
            for a in 0..size {
                for b in 0..size {
                    block.spread[a * size + b] += w[first + a] * w[first + b];
                }
            }
        }
        let site = (&self.precision[at..at + size * size], &self.eta[first..first + size]);
        block.leave_out(site, &scratch.shift[first..first + size], &sample.residual[first..]);
    }

    /// Belief and site of a sensor with one channel.
    #[inline(always)]
    fn judge(&mut self, one: &Arrived, residual: f64, case: &Case, scratch: &Scratch) -> f64 {
        let (m, h) = self.others(one, scratch);
        let (v, rho) = (h + 1.0, residual - m);
        let square = rho * rho / v;
        let gamma = belief(case.odds * v.sqrt() * (0.5 * (square - case.distance)).exp());
        if case.form == Form::Propagation {
            let share = gamma / v;
            let curvature = gamma * (1.0 - (1.0 - gamma) * square).max(0.0); // V M
            let new = match curvature {
                0.0 => 0.0,
                _ => curvature / (1.0 + h * (1.0 - gamma) * (1.0 + gamma * square)), // M / (1 − h M)
            };
            let shift = new * (m + h * share * rho) + share * rho;
            let (lambda, eta) = (&mut self.precision[one.block], &mut self.eta[one.first]);
            *lambda = (1.0 - case.step) * *lambda + case.step * new;
            *eta = (1.0 - case.step) * *eta + case.step * shift;
        }
        gamma
    }

    /// The same for several channels.
    fn judge_jointly(
        &mut self,
        one: &Arrived,
        sample: &Sample,
        information: &Information,
        case: &Case,
        scratch: &mut Scratch,
    ) -> f64 {
        self.others_jointly(one, sample, information, scratch);
        let Arrived { first, size, block: at, .. } = *one;
        let block = &mut scratch.block;
        let gamma = belief(case.odds * (0.5 * (block.square - case.distance + block.log_det)).exp());
        if case.form == Form::Propagation {
            let precision = &mut self.precision[at..at + size * size];
            block.match_moments(gamma, case.step, precision, &mut self.eta[first..first + size]);
        }
        gamma
    }

    /// log evidence of the rounded beliefs: exact for the honest, the learned density for the attacked.
    #[inline(always)]
    pub fn weigh_evidence(
        &mut self,
        sample: &Sample,
        prior: &Prior,
        settings: &Settings,
        information: &mut Information,
        scratch: &mut Scratch,
    ) {
        let learned = settings.attacked == Attacked::Learned;
        let eta = &mut scratch.shift[..information.count()];
        eta.fill(0.0);
        information.clear();
        let (mut log, mut honest) = (0.0, 0);
        for (index, one) in sample.arrived.iter().enumerate() {
            let channels = one.first..one.first + one.size;
            let p = prior.attacked[index];
            if self.gamma[index] > 0.5 {
                honest += 1;
                log += if one.protected { 0.0 } else { (-p).ln_1p() };
                for channel in channels {
                    let residual = sample.residual[channel];
                    log -= 0.5 * residual * residual;
                    eta[channel] = residual;
                    information.weigh(1.0, channel);
                }
            } else {
                let size = one.size as f64;
                let distance = self.distance(sample, one) / self.tau2;
                let learned = if learned { -0.5 * (size * self.tau2.ln() + distance) } else { 0.0 };
                log += prior.log_density[index] + learned + p.ln();
            }
        }
        information.update();
        let (log_det, square) = information.evidence(eta);
        let lacking = sample.arrived.len().div_ceil(2).saturating_sub(honest);
        self.evidence = log - log_det + square - MAJORITY * lacking as f64;
    }

    /// Whether the rounded beliefs are the same.
    #[must_use]
    pub fn agrees(&self, other: &Self, arrived: usize) -> bool {
        let believed = |gamma: &f64| *gamma > 0.5;
        self.gamma[..arrived].iter().map(believed).eq(other.gamma[..arrived].iter().map(believed))
    }
}

/// τ^-m
#[inline(always)]
fn inverse_root(inverse: f64, size: usize, learned: bool) -> f64 {
    match (learned, size) {
        (false, _) => 1.0,
        (true, 1) => inverse.sqrt(),
        (true, _) => inverse.sqrt().powi(size as i32),
    }
}

/// γ for the odds of an attack.
#[inline(always)]
fn belief(odds: f64) -> f64 {
    let gamma = 1.0 / (1.0 + odds);
    if gamma.is_nan() { 0.0 } else { gamma }
}
