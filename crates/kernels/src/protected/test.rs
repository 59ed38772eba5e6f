//! The test of sensors that may lie against the estimate of those that do not.

use std::ops::Range;

use crate::adaptive_joint::window::LIMIT;
use crate::kalman::gains::innovation_deviations;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::linalg::{axpy, cholesky, cholesky_solve, dot, forward_solve, gemv};
use crate::{Error, Output, Result};

/// Gains of the regression of noise on noise, and the covariance of every residual.
#[derive(Debug, Clone)]
pub struct Test {
    /// χ² quantile per number of channels tested, (m + 1,).
    pub quantiles: Vec<f64>,
    /// sqrt diag(C P⁻ Cᵀ + R) of all channels, (m,).
    pub innovation_std: Vec<f64>,
    /// B, C − B C_s and V belong to the filter's cached gains.
    pub current: bool,
    /// Every sensor that may lie, with its channels.
    sensors: Vec<(usize, Range<usize>)>,
    /// Whether any noise is shared with a protected sensor.
    coupled: bool,
    /// B, (m, protected channels).
    b: Vec<f64>,
    /// C − B C_s, (m, n).
    seen: Vec<f64>,
    /// V within every sensor, (m, m).
    v: Vec<f64>,
    /// Cholesky factor of V for as many rows as arrived.
    factor: Vec<f64>,
    residual: Vec<f64>,
    white: Vec<f64>,
    /// (protected channels, protected channels)
    noise: Vec<f64>,
    scratch: Vec<f64>,
}

impl Test {
    /// Test every sensor of `model` that owns none of the channels `own`.
    ///
    /// # Errors
    /// If channels of a sensor do not follow each other.
    pub fn new(model: &Model, own: &[usize], quantiles: Vec<f64>) -> Result<Self> {
        let (n, m, owner) = (model.dims.states, model.dims.channels, &model.channel_sensor);
        if !owner.is_sorted() {
            return Err(Error::input("channel_sensor", "the channels of a sensor side by side", "a mixture"));
        }
        let channels =
            |sensor| owner.partition_point(|&o| o < sensor)..owner.partition_point(|&o| o <= sensor);
        let sensors: Vec<(usize, Range<usize>)> = (0..model.dims.sensors)
            .map(|sensor| (sensor, channels(sensor)))
            .filter(|(_, range)| !range.is_empty() && range.clone().all(|c| !own.contains(&c)))
            .collect();
        let shared = |c: usize| own.iter().any(|&o| model.noise.r[c * m + o] != 0.0);
        Ok(Self {
            quantiles,
            innovation_std: vec![0.0; m],
            current: false,
            coupled: sensors.iter().any(|(_, range)| range.clone().any(shared)),
            sensors,
            b: vec![0.0; m * own.len()],
            seen: vec![0.0; m * n],
            v: vec![0.0; m * m],
            factor: vec![0.0; m * m],
            residual: vec![0.0; m],
            white: vec![0.0; m],
            noise: vec![0.0; own.len() * own.len()],
            scratch: vec![0.0; n.max(m)],
        })
    }

    /// Deviations of the innovations, from P⁻.
    pub fn expect(&mut self, model: &Model, k: usize, prior: &Ud) {
        let m = model.dims.channels;
        innovation_deviations(model, k, prior, &mut self.scratch[..m], &mut self.innovation_std);
    }

    /// B, C − B C_s and V, from P (n, n) after the sample.
    pub fn prepare(&mut self, model: &Model, k: usize, own: &[usize], (heard, p): (&[f64], &[f64])) {
        if self.coupled {
            self.regress(model, own, heard);
        }
        for index in 0..self.sensors.len() {
            let range = self.sensors[index].1.clone();
            range.clone().for_each(|i| self.look(model, k, own, i));
            self.spread(model, own, p, range);
        }
    }

    /// Rows of B: R_ws R_ss⁻¹ over the protected channels that arrived, zero for the others.
    fn regress(&mut self, model: &Model, own: &[usize], heard: &[f64]) {
        let (m, s) = (model.dims.channels, own.len());
        let both = |a: usize, b: usize| !heard[a].is_nan() && !heard[b].is_nan();
        for a in 0..s {
            for b in 0..s {
                let r = model.noise.r[own[a] * m + own[b]];
                self.noise[a * s + b] = if both(a, b) { r } else { f64::from(u8::from(a == b)) };
            }
        }
        // R is positive definite, hence so is every principal part of it.
        let _ = cholesky(&mut self.noise, s, s, 0.0);
        for index in 0..self.sensors.len() {
            for i in self.sensors[index].1.clone() {
                let row = &mut self.b[i * s..(i + 1) * s];
                for (a, value) in row.iter_mut().enumerate() {
                    *value = if heard[a].is_nan() { 0.0 } else { model.noise.r[i * m + own[a]] };
                }
                cholesky_solve(&self.noise, s, row);
            }
        }
    }

    /// Row i of C − B C_s.
    fn look(&mut self, model: &Model, k: usize, own: &[usize], i: usize) {
        let (n, c) = (model.dims.states, model.c(k));
        let seen = &mut self.seen[i * n..(i + 1) * n];
        seen.copy_from_slice(&c[i * n..(i + 1) * n]);
        for (&b, &s) in self.b[i * own.len()..(i + 1) * own.len()].iter().zip(own) {
            if b != 0.0 {
                axpy(-b, &c[s * n..(s + 1) * n], seen);
            }
        }
    }

    /// V of one sensor.
    fn spread(&mut self, model: &Model, own: &[usize], p: &[f64], range: Range<usize>) {
        let (n, m) = (model.dims.states, model.dims.channels);
        for i in range.clone() {
            gemv(p, &self.seen[i * n..(i + 1) * n], &mut self.scratch[..n]);
            for j in range.start..=i {
                let known: f64 = (self.b[i * own.len()..].iter().zip(own))
                    .map(|(&b, &s)| b * model.noise.r[j * m + s])
                    .sum();
                let spread = dot(&self.scratch[..n], &self.seen[j * n..(j + 1) * n]);
                self.v[i * m + j] = spread + model.noise.r[i * m + j] - known;
                self.v[j * m + i] = self.v[i * m + j];
            }
        }
    }

    /// Trust, suspicion and attack of every sensor that may lie, from x after the sample in `out`.
    pub fn judge(
        &mut self,
        model: &Model,
        k: usize,
        own: &[usize],
        (y, u): (&[f64], &[f64]),
        out: &mut Output<'_>,
    ) {
        let m = model.dims.channels;
        model.innovation(k, out.x, (y, u), &mut self.residual);
        for index in 0..self.sensors.len() {
            let (sensor, range) = self.sensors[index].clone();
            for i in range.clone().filter(|&i| !y[i].is_nan()) {
                let shared = self.b[i * own.len()..(i + 1) * own.len()].iter().zip(own);
                let known =
                    shared.filter(|(b, _)| **b != 0.0).map(|(b, &s)| b * self.residual[s]).sum::<f64>();
                out.attack[i] = self.residual[i] - known;
                out.attack_std[i] = self.v[i * m + i].sqrt();
            }
            if let Some(excess) = self.excess(m, range, out.attack) {
                out.trust[sensor] = 1.0 / (1.0 + excess);
                out.suspected[sensor] = u8::from(excess > 1.0);
            }
        }
    }

    /// d² over its quantile for the channels that arrived; None if none did, or nothing is known of the state.
    fn excess(&mut self, m: usize, range: Range<usize>, attack: &[f64]) -> Option<f64> {
        if range.len() == 1 {
            let (value, variance) = (attack[range.start], self.v[range.start * m + range.start]);
            let square = value.clamp(-LIMIT, LIMIT).powi(2) / variance;
            return (square.is_finite() && variance.is_finite()).then(|| square / self.quantiles[1]);
        }
        let mut count = 0;
        for i in range.clone().filter(|&i| !attack[i].is_nan()) {
            self.white[count] = attack[i].clamp(-LIMIT, LIMIT);
            for (target, j) in
                (self.factor[count * m..].iter_mut()).zip((range.start..=i).filter(|&j| !attack[j].is_nan()))
            {
                *target = self.v[i * m + j];
            }
            count += 1;
        }
        if count == 0 || cholesky(&mut self.factor, count, m, 0.0).is_err() {
            return None;
        }
        let white = &mut self.white[..count];
        forward_solve(&self.factor, m, white);
        let square = dot(white, white);
        square.is_finite().then(|| square / self.quantiles[count])
    }
}
