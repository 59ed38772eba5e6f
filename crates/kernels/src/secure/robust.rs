//! A start that does not trust the prediction: whom a robust regression of the residuals believes.

use crate::mixture::information::Information;
use crate::mixture::sample::Sample;
use crate::secure::labels::{Labels, Prior, Scratch};
use crate::secure::settings::Settings;

/// P⁻ is taken to be this much larger.
const VAGUE: f64 = 100.0;

/// Rounds of reweighting.
const ROUNDS: usize = 10;

/// Squared residual per channel up to which a sensor fits, and the floor that keeps weights finite.
const FIT: (f64, f64) = (6.0, 0.1);

/// Scratch.
#[derive(Debug, Clone)]
pub struct Regression {
    /// w, then squared residuals, by sensor that arrived.
    weight: Vec<f64>,
    square: Vec<f64>,
    order: Vec<usize>,
    eta: Vec<f64>,
}

impl Regression {
    /// Room.
    #[must_use]
    pub fn new(sensors: usize, channels: usize) -> Self {
        Self {
            weight: vec![0.0; sensors],
            square: vec![0.0; sensors],
            order: Vec::with_capacity(sensors),
            eta: vec![0.0; channels],
        }
    }

    /// Begin `labels` from those who fit, at least as many as must be honest.
    #[inline(always)]
    pub fn begin(
        &mut self,
        labels: &mut Labels,
        (sample, prior): (&Sample, &Prior),
        settings: &Settings,
        information: &mut Information,
        scratch: &mut Scratch,
    ) {
        let arrived = sample.arrived.len();
        self.weight.iter_mut().zip(&prior.probability[..arrived]).for_each(|(weight, p)| *weight = p[0]);
        let count = information.count();
        for _ in 0..ROUNDS {
            information.clear();
            for (one, weight) in sample.arrived.iter().zip(&self.weight) {
                for channel in one.first..one.first + one.size {
                    self.eta[channel] = VAGUE * weight * sample.residual[channel];
                    information.weigh((VAGUE * weight).sqrt(), channel);
                }
            }
            information.update();
            information.expect(
                &self.eta[..count],
                &mut scratch.shift[..count],
                &mut scratch.variance[..count],
            );
            for (index, one) in sample.arrived.iter().enumerate() {
                let channels = one.first..one.first + one.size;
                let square: f64 = channels.map(|c| (sample.residual[c] - scratch.shift[c]).powi(2)).sum();
                self.square[index] = square / one.size as f64;
                self.weight[index] = prior.probability[index][0] / (square + FIT.1).sqrt();
            }
        }
        self.order.clear();
        self.order.extend(0..arrived);
        let square = &self.square;
        self.order.sort_unstable_by(|&a, &b| square[a].total_cmp(&square[b]));
        let least = arrived - settings.most(sample).min(arrived);
        for (rank, &index) in self.order.iter().enumerate() {
            self.weight[index] = f64::from(u8::from(rank < least || self.square[index] < FIT.0));
        }
        labels.begin(sample, prior, |index, _| (self.weight[index], 0.0));
    }
}
