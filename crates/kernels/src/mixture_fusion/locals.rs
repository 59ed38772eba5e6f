//! The local Kalman filters: every sensor estimates the whole state from its own readings.
//!
//! ```text
//!     x_i = x_i⁻ + P_i C_iᵀ R_i⁻¹ (y_i − C_i x_i⁻ − D_i u),   P_i⁻¹ = (P_i⁻)⁻¹ + C_iᵀ R_i⁻¹ C_i      (8), (10)
//! ```
//!
//! P_i⁻ is that of the steady state at every sample, whatever arrived before, and C_i has the rows that arrived. With
//! feedback x_i⁻ and P_i⁻ are the fused prediction and its covariance.

use crate::kalman::heard::Heard;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::linalg::{axpy, dot};
use crate::mixture_fusion::LIMIT;
use crate::mixture_fusion::known::Known;
use crate::{Error, Result};

/// What the local filters do with complete readings, known beforehand.
#[derive(Debug, Clone)]
pub struct Design {
    /// P_i⁻, one per sensor; none with feedback.
    priors: Vec<Ud>,
    /// First channel of every sensor, and m.
    first: Vec<usize>,
    /// Gain of every whitened channel given those of its sensor before it, (m, n).
    gains: Vec<f64>,
    /// P_i.
    known: Known,
}

/// The local estimates of one run.
#[derive(Debug, Clone)]
pub struct Locals {
    /// x_i[k|k−1], (N, n).
    pub x: Vec<f64>,
    /// x_i[k|k], (N, n).
    pub estimates: Vec<f64>,
    /// P_i of this sample.
    pub known: Known,
    /// Whether P_i is that of a complete reading.
    complete: Vec<bool>,
    prior: Ud,
    gain: Vec<f64>,
    scratch: Vec<f64>,
    white: Vec<f64>,
}

impl Design {
    /// `priors` holds P_i⁻ (N, n, n), or is None with feedback.
    ///
    /// # Errors
    /// A length that does not fit, or a P_i⁻ that is not a covariance.
    pub fn new(model: &Model, priors: Option<&[f64]>, precise: bool) -> Result<Self> {
        let (n, m, sensors) = (model.dims.states, model.dims.channels, model.dims.sensors);
        let first = (0..=sensors).map(|i| model.channel_sensor.partition_point(|&owner| owner < i)).collect();
        let mut design = Self {
            priors: Vec::new(),
            first,
            gains: vec![0.0; m * n],
            known: Known::new(sensors, n, precise),
        };
        let Some(priors) = priors else { return Ok(design) };
        Error::check_len("local priors", sensors * n * n, priors.len())?;
        let mut heard = Heard::new(model, &model.noise);
        heard.listen(model, &model.noise, 0, &vec![0.0; m]);
        for (i, prior) in priors.chunks_exact(n * n).enumerate() {
            let prior = Ud::new("local priors", prior, n)?;
            let mut posterior = prior.clone();
            for j in design.first[i]..design.first[i + 1] {
                let row = &heard.rows()[j * n..(j + 1) * n];
                posterior.condition(row, &mut vec![0.0; n], &mut design.gains[j * n..(j + 1) * n]);
            }
            design.known.set(i, &posterior);
            design.priors.push(prior);
        }
        Ok(design)
    }

    /// All numbers that decide, for the fingerprint.
    pub fn numbers(&self) -> impl Iterator<Item = &[f64]> + '_ {
        self.priors.iter().flat_map(|prior| [&prior.d[..], &prior.u[..]])
    }

    /// Whether local filters start from the fused prediction at every sample.
    #[must_use]
    pub fn feedback(&self) -> bool {
        self.priors.is_empty()
    }

    /// Room for the estimates of one run.
    #[must_use]
    pub fn start(&self, mean: &[f64]) -> Locals {
        let (n, sensors, m) = (mean.len(), self.first.len() - 1, self.gains.len() / mean.len());
        Locals {
            x: mean.repeat(sensors),
            estimates: vec![0.0; sensors * n],
            known: self.known.clone(),
            complete: vec![!self.feedback(); sensors],
            prior: Ud::zero(n),
            gain: vec![0.0; n],
            scratch: vec![0.0; n],
            white: vec![0.0; m],
        }
    }

    /// Local estimates from what `heard` heard. `reading` (m,) is y − D u, `fused` the fused prediction. `each` gets
    /// every sensor that sent something and its estimate.
    pub fn correct(
        &self,
        locals: &mut Locals,
        heard: &Heard,
        reading: &[f64],
        (x, p): (&[f64], &Ud),
        mut each: impl FnMut(usize, &[f64]),
    ) {
        let n = x.len();
        let white = heard.whiten(reading, &mut locals.white);
        let (mut white, mut rows) = (white, heard.rows());
        let mut channels = heard.channels();
        for (i, estimate) in locals.estimates.chunks_exact_mut(n).enumerate() {
            let before = if self.feedback() { x } else { &locals.x[i * n..(i + 1) * n] };
            estimate.copy_from_slice(before);
            let own = channels.partition_point(|&channel| channel < self.first[i + 1]);
            if own == 0 {
                continue;
            }
            let (readings, others) = white.split_at(own);
            let (own_rows, other_rows) = rows.split_at(own * n);
            (white, rows, channels) = (others, other_rows, &channels[own..]);
            if !self.feedback() && own == self.first[i + 1] - self.first[i] {
                if !locals.complete[i] {
                    locals.known.copy_one(i, &self.known);
                    locals.complete[i] = true;
                }
                let gains = self.gains[self.first[i] * n..].chunks_exact(n);
                for ((value, row), gain) in readings.iter().zip(own_rows.chunks_exact(n)).zip(gains) {
                    axpy(value - dot(row, estimate), gain, estimate);
                }
            } else {
                locals.prior.copy_from(if self.feedback() { p } else { &self.priors[i] });
                for (value, row) in readings.iter().zip(own_rows.chunks_exact(n)) {
                    locals.prior.condition(row, &mut locals.scratch, &mut locals.gain);
                    axpy(value - dot(row, estimate), &locals.gain, estimate);
                }
                locals.known.set(i, &locals.prior);
                locals.complete[i] = false;
            }
            each(i, estimate);
        }
    }

    /// x_i[k+1|k]. One that has left the range of numbers, because nothing arrived for too long in a plant that is not
    /// stable, starts again from the fused prediction `x`.
    pub fn predict(&self, locals: &mut Locals, model: &Model, (k, u): (usize, &[f64]), x: &[f64]) {
        if self.feedback() {
            return;
        }
        let n = x.len();
        for (next, estimate) in locals.x.chunks_exact_mut(n).zip(locals.estimates.chunks_exact(n)) {
            model.predict(k, estimate, u, next);
            if !next.iter().all(|value| value.abs() < LIMIT) {
                next.copy_from_slice(x);
            }
        }
    }
}
