//! How likely a sample is if its sensor is honest or lies in one way or another, and how well a labelling of all sensors
//! explains the sample.

use crate::mixture::information::Information;
use crate::mixture::sample::{Arrived, Sample};
use crate::secure::labels::{Label, Labels, Prior, Scratch};
use crate::secure::settings::{BROAD, SHARES, Settings};

/// log evidence that an accusation beyond the most possible costs.
const MAJORITY: f64 = 1e3;

/// Lies to compare with, in turned coordinates.
#[derive(Debug, Clone, Copy)]
pub struct Lies<'a> {
    /// μ of the wild.
    pub mu: &'a [f64],
    /// τ² of the wild.
    pub tau2: f64,
    /// b of a constant injection.
    pub offset: &'a [f64],
    /// b of a drifting one.
    pub drift: &'a [f64],
    /// s of both.
    pub spread: [f64; 2],
}

/// Variances from which on products are taken to logarithms, so that they do not overflow.
const LARGE: f64 = 1e100;

/// log N(z; b, v + s I) without 2π, in two parts: one to be exponentiated, and a factor.
#[inline(always)]
fn gauss(z: &[f64], v: &[f64], center: impl Fn(usize) -> f64, added: f64) -> (f64, f64) {
    let (mut log, mut det) = (0.0, 1.0);
    for (a, (z, v)) in z.iter().zip(v).enumerate() {
        let (variance, d) = (v + added, z - center(a));
        log -= 0.5 * d * d / variance;
        det *= variance;
        if det > LARGE {
            (log, det) = (log - 0.5 * det.ln(), 1.0);
        }
    }
    (log, 1.0 / det.sqrt())
}

/// The same for z_a v_a^-½ ~ N(b_a, 1 + s).
#[inline(always)]
fn wide(z: &[f64], v: &[f64], center: impl Fn(usize) -> f64, added: f64) -> (f64, f64) {
    let (mut log, mut det) = (0.0, 1.0);
    for (a, (z, v)) in z.iter().zip(v).enumerate() {
        let d = z / v.sqrt() - center(a);
        log -= 0.5 * d * d / (1.0 + added);
        det *= v * (1.0 + added);
        if det > LARGE {
            (log, det) = (log - 0.5 * det.ln(), 1.0);
        }
    }
    (log, 1.0 / det.sqrt())
}

/// Densities of z as honest, constant, drifting and wild, over the largest of their exponentials.
#[inline(always)]
pub fn densities(z: &[f64], v: &[f64], lies: &Lies<'_>) -> [f64; 4] {
    let parts = [
        gauss(z, v, |_| 0.0, 0.0),
        gauss(z, v, |a| lies.offset[a], lies.spread[0]),
        gauss(z, v, |a| lies.drift[a], lies.spread[1]),
        wide(z, v, |_| 0.0, BROAD),
        wide(z, v, |a| lies.mu[a], lies.tau2),
    ];
    let largest = parts.iter().fold(f64::NEG_INFINITY, |largest, part| largest.max(part.0));
    if !largest.is_finite() {
        return [0.0, 0.0, 0.0, 1.0];
    }
    let [honest, constant, drifting, broad, learned] =
        parts.map(|(log, scale)| scale * (log - largest).exp());
    [honest, constant, drifting, SHARES.0 * broad + SHARES.1 * learned]
}

/// Belief that a sensor is honest by its innovation alone, against the broad density of the wild.
#[inline(always)]
pub fn gate(sample: &Sample, prior: &Prior, index: usize, size: usize) -> f64 {
    let exponent = 0.5 * sample.square[index] * BROAD / (1.0 + BROAD) - 0.5 * size as f64 * BROAD.ln_1p();
    let honest = prior.probability[index][0];
    1.0 / (1.0 + (1.0 - honest) / honest.max(f64::MIN_POSITIVE) * exponent.min(500.0).exp())
}

impl Labels {
    /// log evidence of the rounded beliefs: exact for those who say something about the state, given them for the others.
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
        eta.fill(0.0);
        let (mut log, mut accused) = (0.0, 0_usize);
        for (index, one) in sample.arrived.iter().enumerate() {
            let label = self.label(index);
            accused += usize::from(label != Label::Honest);
            log += if one.protected { 0.0 } else { prior.probability[index][label as usize].ln() };
            let noise = match label {
                Label::Honest => 1.0,
                Label::Constant => prior.noise(index),
                Label::Drifting | Label::Wild => continue,
            };
            for (offset, eta) in eta[one.first..one.first + one.size].iter_mut().enumerate() {
                let channel = one.first + offset;
                let bias = if label == Label::Constant { prior.offset[channel] } else { 0.0 };
                let residual = sample.residual[channel] - bias;
                log -= 0.5 * (residual * residual / noise + noise.ln());
                *eta = residual / noise;
                information.weigh((1.0 / noise).sqrt(), channel);
            }
        }
        information.update();
        let (log_det, square) = information.evidence(eta);
        let count = information.count();
        information.expect(eta, &mut scratch.shift[..count], &mut scratch.variance[..count]);
        log += square - log_det;
        for (index, one) in sample.arrived.iter().enumerate() {
            log += self.outside(one, index, (sample, prior), scratch);
        }
        self.evidence = log - MAJORITY * accused.saturating_sub(settings.most(sample)) as f64;
    }

    /// log density of a sensor that says nothing about the state, given those that do; as if its channels were
    /// independent. 0 for the others.
    #[inline(always)]
    fn outside(
        &self,
        one: &Arrived,
        index: usize,
        (sample, prior): (&Sample, &Prior),
        scratch: &mut Scratch,
    ) -> f64 {
        let tau2 = self.cluster(one, self.belief[index][3], &mut scratch.mu);
        let scratch = &*scratch;
        let log = |each: &dyn Fn(usize, f64, f64) -> (f64, f64)| {
            (0..one.size).fold((0.0, 1.0), |(log, scale), a| {
                let channel = one.first + a;
                let residual = sample.residual[channel] - scratch.shift[channel];
                let part = each(a, residual, 1.0 + scratch.variance[channel]);
                (log + part.0, scale * part.1)
            })
        };
        match self.label(index) {
            Label::Honest | Label::Constant => 0.0,
            Label::Drifting => {
                let part =
                    log(&|a, z, v| gauss(&[z], &[v], |_| prior.drift[one.first + a], prior.spread[index][1]));
                part.0 + part.1.ln()
            }
            Label::Wild => {
                let broad = log(&|_, z, v| wide(&[z], &[v], |_| 0.0, BROAD));
                let learned = log(&|a, z, v| wide(&[z], &[v], |_| scratch.mu[a], tau2));
                let largest = broad.0.max(learned.0);
                let part = |share: f64, part: (f64, f64)| share * part.1 * (part.0 - largest).exp();
                largest + (part(SHARES.0, broad) + part(SHARES.1, learned)).ln()
            }
        }
    }
}
