//! How far every sensor alone is from the fused prediction, in the metric S_i = C_i P⁻ C_iᵀ + R_i.
//!
//! As in the Kalman filter, one channel after the other on P⁻ = U D Uᵀ, but each sensor anew from P⁻ and with the
//! noise of its own channels only. No S_i is formed, so that a P⁻ of any size leaves the noise its digits.

use crate::Result;
use crate::kalman::gains::Scratch;
use crate::kalman::heard::Heard;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::kalman::whitening::Noise;
use crate::linalg::{axpy, dot};

/// Gains of every sensor as if it were alone.
#[derive(Debug, Clone)]
pub struct Apart {
    /// R without the correlation between sensors.
    noise: Noise,
    heard: Heard,
    /// Gain of each whitened channel but the last of a sensor, (channels, n).
    gain: Vec<f64>,
    /// 1 / s of each whitened channel, given those of its sensor before it.
    precision: Vec<f64>,
    work: Ud,
    scratch: Vec<f64>,
    /// The gains belong to P⁻ with every channel present.
    current: bool,
}

impl Apart {
    /// Room for one sample.
    ///
    /// # Errors
    /// None for a model that exists.
    pub fn new(model: &Model) -> Result<Self> {
        let (n, m) = (model.dims.states, model.dims.channels);
        Ok(Self {
            noise: model.noise.within(&model.channel_sensor)?,
            heard: Heard::new(model),
            gain: vec![0.0; m * n],
            precision: vec![0.0; m],
            work: Ud::zero(n),
            scratch: vec![0.0; n],
            current: false,
        })
    }

    /// Gains for the channels of y that are not NaN.
    pub fn listen(&mut self, model: &Model, k: usize, y: &[f64], prior: &Ud) {
        let all = y.iter().all(|value| !value.is_nan());
        if all && self.current {
            return;
        }
        self.current = all;
        self.heard.listen(model, &self.noise, k, y);
        let (n, owner) = (model.dims.states, &model.channel_sensor);
        let (channels, rows) = (self.heard.channels(), self.heard.rows());
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

    /// d_i² over the quantile for as many channels as arrived of sensor i, (N,); NaN where none did.
    pub fn excess(
        &self,
        model: &Model,
        innovation: &[f64],
        quantiles: &[f64],
        scratch: &mut Scratch,
        out: &mut [f64],
    ) {
        let (n, owner, channels) = (model.dims.states, &model.channel_sensor, self.heard.channels());
        let (white, shift) = (self.heard.whiten(innovation, &mut scratch.channel), &mut scratch.state);
        let rows = self.heard.rows();
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

    /// After a step: whether P⁻ stayed what it was.
    pub fn keep(&mut self, same: bool) {
        self.current &= same;
    }
}
