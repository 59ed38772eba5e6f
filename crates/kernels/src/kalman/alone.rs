//! How far every sensor alone is from a belief, in the metric S_i = C_i P C_iᵀ + R_i.
//!
//! As in the Kalman filter, one whitened channel after the other on P = U D Uᵀ, but each sensor anew from P. No S_i is
//! formed, so that a P of any size leaves the noise its digits.

use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::linalg::{axpy, dot};

/// Channels with the sensor of each, those of a sensor side by side, and their rows (channels, n), whitened per sensor.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// Owner of every channel of the plant.
    pub owner: &'a [usize],
    /// The channels.
    pub channels: &'a [usize],
    /// (channels, n)
    pub rows: &'a [f64],
}

/// Gains of every sensor as if it were alone.
#[derive(Debug, Clone)]
pub struct Alone {
    /// Gain of each whitened channel but the last of a sensor, (channels, n).
    gain: Vec<f64>,
    /// 1 / s of each whitened channel, given those of its sensor before it.
    precision: Vec<f64>,
    work: Ud,
    scratch: Vec<f64>,
}

impl Alone {
    /// Room for one sample.
    #[must_use]
    pub fn new(model: &Model) -> Self {
        let (n, m) = (model.dims.states, model.dims.channels);
        Self { gain: vec![0.0; m * n], precision: vec![0.0; m], work: Ud::zero(n), scratch: vec![0.0; n] }
    }

    /// Gains about a belief of covariance `prior`.
    pub fn listen(&mut self, of: Rows<'_>, prior: &Ud) {
        let (n, Rows { owner, channels, rows }) = (self.scratch.len(), of);
        for (j, row) in rows.chunks_exact(n).enumerate() {
            let first = j == 0 || owner[channels[j - 1]] != owner[channels[j]];
            let last = channels.get(j + 1).is_none_or(|&next| owner[next] != owner[channels[j]]);
            if first && !last {
                self.work.copy_from(prior);
            }
            let p = if first { prior } else { &self.work };
            self.precision[j] = 1.0
                / match last {
                    true => p.variance(row),
                    false => self.work.condition(row, &mut self.scratch, &mut self.gain[j * n..(j + 1) * n]),
                };
        }
    }

    /// d_i² over the quantile for as many channels as sensor i has here, (N,); NaN where it has none.
    ///
    /// `white` are the whitened distances of the channels from the belief; `shift` is scratch, (n,).
    pub fn excess(&self, of: Rows<'_>, white: &[f64], quantiles: &[f64], shift: &mut [f64], out: &mut [f64]) {
        let (n, Rows { owner, channels, rows }) = (shift.len(), of);
        out.fill(f64::NAN);
        let mut j = 0;
        while let Some(&channel) = channels.get(j) {
            let sensor = owner[channel];
            let count = channels[j..].iter().take_while(|&&c| owner[c] == sensor).count();
            let mut square = white[j] * white[j] * self.precision[j];
            if count > 1 {
                shift.fill(0.0);
            }
            for l in j + 1..j + count {
                let before = white[l - 1] - dot(&rows[(l - 1) * n..l * n], shift);
                axpy(before, &self.gain[(l - 1) * n..l * n], shift);
                let surprise = white[l] - dot(&rows[l * n..(l + 1) * n], shift);
                square += surprise * surprise * self.precision[l];
            }
            out[sensor] = square / quantiles[count];
            j += count;
        }
    }
}
