//! What is reported of an augmented state [x; θ]: x, the injections θ, and how much they leave of the trust.

use crate::kalman::model::Model;
use crate::linalg::{cholesky, dot, forward_solve};
use crate::{Error, Output, Result};

/// Which entries of the augmented state are what.
#[derive(Debug, Clone)]
pub struct Report {
    /// n, length of x.
    pub states: usize,
    /// The channel that θ_j is added to, in increasing order, (w,).
    pub weak: Vec<usize>,
    /// χ² quantile per number of channels, (m + 1,).
    pub quantiles: Vec<f64>,
}

/// Scratch for the injection of one sensor.
#[derive(Debug, Clone)]
pub struct Scratch {
    theta: Vec<f64>,
    block: Vec<f64>,
}

impl Report {
    /// Check that the lengths fit the augmented `model`.
    ///
    /// # Errors
    /// A length that does not fit, or weak channels that are no channels in increasing order.
    pub fn check(&self, model: &Model) -> Result<()> {
        let dims = model.dims;
        Error::check_len("A", dims.states, self.states + self.weak.len())?;
        Error::check_len("quantiles", dims.channels + 1, self.quantiles.len())?;
        let increasing = self.weak.windows(2).all(|pair| pair[0] < pair[1]);
        if !increasing || self.weak.last().is_some_and(|&last| last >= dims.channels) {
            return Err(Error::input("weak", "channels in increasing order", format!("{:?}", self.weak)));
        }
        if !model.channel_sensor.is_sorted() {
            return Err(Error::input("channel_sensor", "the channels of a sensor side by side", "a mixture"));
        }
        Ok(())
    }

    /// Room for one sample.
    #[must_use]
    pub fn scratch(&self) -> Scratch {
        let w = self.weak.len();
        Scratch { theta: vec![0.0; w], block: vec![0.0; w * w] }
    }

    /// Report the augmented state and its covariance; trust in the protected sensors stays.
    pub fn write(
        &self,
        model: &Model,
        y: &[f64],
        (state, covariance): (&[f64], &[f64]),
        scratch: &mut Scratch,
        out: &mut Output<'_>,
    ) {
        self.write_state(state, covariance, out);
        self.write_attack(y, state, covariance, out);
        let (owner, mut j) = (&model.channel_sensor, 0);
        while let Some(&channel) = self.weak.get(j) {
            let sensor = owner[channel];
            let count = self.weak[j..].iter().take_while(|&&c| owner[c] == sensor).count();
            let excess = self.excess(j..j + count, y, (state, covariance), scratch);
            out.trust[sensor] = 1.0 / (1.0 + excess);
            out.suspected[sensor] = u8::from(excess > 1.0);
            j += count;
        }
    }

    fn write_state(&self, state: &[f64], covariance: &[f64], out: &mut Output<'_>) {
        let (n, stride) = (self.states, state.len());
        out.x.copy_from_slice(&state[..n]);
        for (i, std) in out.x_std.iter_mut().enumerate() {
            *std = covariance[i * stride + i].sqrt();
        }
        if let Some(target) = out.covariance.as_deref_mut() {
            for (row, whole) in target.chunks_exact_mut(n).zip(covariance.chunks_exact(stride)) {
                row.copy_from_slice(&whole[..n]);
            }
        }
    }

    fn write_attack(&self, y: &[f64], state: &[f64], covariance: &[f64], out: &mut Output<'_>) {
        for (i, value) in y.iter().enumerate() {
            let honest = if value.is_nan() { f64::NAN } else { 0.0 };
            (out.attack[i], out.attack_std[i]) = (honest, honest);
        }
        for (j, &channel) in self.weak.iter().enumerate().filter(|&(_, &channel)| !y[channel].is_nan()) {
            let at = self.states + j;
            out.attack[channel] = state[at];
            out.attack_std[channel] = covariance[at * state.len() + at].sqrt();
        }
    }

    /// θᵀ P⁻¹ θ over the channels of one sensor that arrived, over its quantile; NaN if none did.
    fn excess(
        &self,
        own: std::ops::Range<usize>,
        y: &[f64],
        (state, covariance): (&[f64], &[f64]),
        scratch: &mut Scratch,
    ) -> f64 {
        let (w, stride, mut count) = (self.weak.len(), state.len(), 0);
        for j in own.clone().filter(|&j| !y[self.weak[j]].is_nan()) {
            let earlier = own.start..=j;
            let row = &covariance[(self.states + j) * stride + self.states..];
            let kept = earlier.filter(|&i| !y[self.weak[i]].is_nan());
            kept.zip(&mut scratch.block[count * w..]).for_each(|(i, target)| *target = row[i]);
            scratch.theta[count] = state[self.states + j];
            count += 1;
        }
        if count == 0 {
            return f64::NAN;
        }
        squared_distance(&mut scratch.theta[..count], &mut scratch.block, w) / self.quantiles[count]
    }
}

/// θᵀ P⁻¹ θ, or the largest θ_i² / P_ii, a lower bound, if rounding left P singular. Destroys both.
fn squared_distance(theta: &mut [f64], p: &mut [f64], stride: usize) -> f64 {
    // In units of the largest entry, so that no injection is too large to be squared.
    let size = theta.iter().fold(0.0_f64, |size, value| size.max(value.abs()));
    if size == 0.0 {
        return 0.0;
    }
    theta.iter_mut().for_each(|value| *value /= size);
    let bound = theta.iter().enumerate().fold(0.0_f64, |bound, (i, value)| {
        bound.max(value / p[i * stride + i].sqrt() * value.signum() * size)
    });
    if cholesky(p, theta.len(), stride, 0.0).is_err() {
        return bound * bound;
    }
    forward_solve(p, stride, theta);
    let distance = dot(theta, theta).sqrt() * size;
    distance * distance
}
