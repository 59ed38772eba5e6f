//! The channels that count in one correction, with their noise made independent.

use crate::kalman::model::Model;
use crate::kalman::whitening::{Noise, Whitening};

const LOG_2PI: f64 = 1.837_877_066_409_345_5;

/// Channels in the order of their noise, and the rows of L⁻¹ C for them.
#[derive(Debug, Clone)]
pub struct Heard {
    channels: Vec<usize>,
    /// Where in that order they stand.
    places: Vec<usize>,
    count: usize,
    whitening: Whitening,
    rows: Vec<f64>,
    /// log det(2π L Lᵀ)
    pub log_det: f64,
}

impl Heard {
    /// Room for all channels, whose noise is `noise`.
    #[must_use]
    pub fn new(model: &Model, noise: &Noise) -> Self {
        let (n, m) = (model.dims.states, model.dims.channels);
        Self {
            channels: vec![0; m],
            places: vec![0; m],
            count: 0,
            whitening: Whitening::new(noise),
            rows: vec![0.0; m * n],
            log_det: 0.0,
        }
    }

    /// Overwrite with `other`, without allocation.
    pub fn copy_from(&mut self, other: &Self) {
        self.count = other.count;
        self.channels.copy_from_slice(&other.channels);
        self.places.copy_from_slice(&other.places);
        self.whitening.copy_from(&other.whitening);
        self.rows.copy_from_slice(&other.rows);
        self.log_det = other.log_det;
    }

    /// Note which channels of y are not NaN. `noise` is that of the model, maybe in another order, with some of its
    /// correlations left out, or with larger variances.
    pub fn listen(&mut self, model: &Model, noise: &Noise, k: usize, y: &[f64]) {
        let n = model.dims.states;
        self.count = 0;
        for (place, &channel) in noise.order.iter().enumerate() {
            if !y[channel].is_nan() {
                self.channels[self.count] = channel;
                self.places[self.count] = place;
                self.count += 1;
            }
        }
        let (arrived, c) = (&self.channels[..self.count], model.c(k));
        for (row, &channel) in self.rows.chunks_exact_mut(n).zip(arrived) {
            row.copy_from_slice(&c[channel * n..(channel + 1) * n]);
        }
        // R is positive definite, hence so is every principal part of it.
        self.whitening.factorise(noise, &self.places[..self.count]);
        self.whitening.apply_to_rows(&mut self.rows[..self.count * n], n);
        self.log_det = self.count as f64 * LOG_2PI + 2.0 * self.whitening.log_det(self.count);
    }

    /// Multiply the row of every channel by its weight, (m,); channels with correlated noise must have the same.
    pub fn weigh(&mut self, weights: &[f64]) {
        let n = self.rows.len() / self.channels.len();
        for (row, &channel) in self.rows.chunks_exact_mut(n).zip(&self.channels[..self.count]) {
            row.iter_mut().for_each(|value| *value *= weights[channel]);
        }
    }

    /// The channels, in the order of their noise.
    #[must_use]
    pub fn channels(&self) -> &[usize] {
        &self.channels[..self.count]
    }

    /// Rows of L⁻¹ C, (channels, n).
    #[must_use]
    pub fn rows(&self) -> &[f64] {
        let n = self.rows.len() / self.channels.len();
        &self.rows[..self.count * n]
    }

    /// L⁻¹ of the innovations (m,) of these channels, at the front of `white`.
    pub fn whiten<'a>(&self, innovation: &[f64], white: &'a mut [f64]) -> &'a [f64] {
        let white = &mut white[..self.count];
        for (value, &channel) in white.iter_mut().zip(&self.channels) {
            *value = innovation[channel];
        }
        self.whitening.apply(white);
        white
    }

    /// The Cholesky factor of the noise covariance.
    #[must_use]
    pub fn whitening(&self) -> &Whitening {
        &self.whitening
    }
}
