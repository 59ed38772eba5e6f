//! How far every sensor alone is from the fused prediction, with the noise of its own channels only.

use crate::Result;
use crate::kalman::alone::{Alone, Rows};
use crate::kalman::gains::Scratch;
use crate::kalman::heard::Heard;
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::kalman::whitening::Noise;

/// Gains of every sensor as if it were alone.
#[derive(Debug, Clone)]
pub struct Apart {
    /// R without the correlation between sensors.
    noise: Noise,
    heard: Heard,
    alone: Alone,
    /// The gains belong to P⁻ with every channel present.
    current: bool,
}

impl Apart {
    /// Room for one sample.
    ///
    /// # Errors
    /// None for a model that exists.
    pub fn new(model: &Model) -> Result<Self> {
        let noise = model.noise.within(&model.channel_sensor)?;
        Ok(Self { heard: Heard::new(model, &noise), noise, alone: Alone::new(model), current: false })
    }

    /// Gains for the channels of y that are not NaN.
    pub fn listen(&mut self, model: &Model, k: usize, y: &[f64], prior: &Ud) {
        let all = y.iter().all(|value| !value.is_nan());
        if all && self.current {
            return;
        }
        self.current = all;
        self.heard.listen(model, &self.noise, k, y);
        self.alone.listen(rows(model, &self.heard), prior);
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
        let white = self.heard.whiten(innovation, &mut scratch.channel);
        self.alone.excess(rows(model, &self.heard), white, quantiles, &mut scratch.state, out);
    }

    /// After a step: whether P⁻ stayed what it was.
    pub fn keep(&mut self, same: bool) {
        self.current &= same;
    }
}

fn rows<'a>(model: &'a Model, heard: &'a Heard) -> Rows<'a> {
    Rows { owner: &model.channel_sensor, channels: heard.channels(), rows: heard.rows() }
}
