//! What is remembered of every sensor: whether it lies, in what habit, and what it injects.
//!
//! ```text
//!     habits     every habit e is a two-state chain per sensor; their weights are shared by all sensors
//!                p_e⁻ = p_e (1 − recovery_e) + (1 − p_e) onset_e,   π = Σ w_e duty_e p_e⁻
//!     injection  b, s of a steady lie: begun just now N(0, σ₀²), going on N(b, s + q), or what was sent wildly before,
//!                merged to the first two moments
//! ```

use crate::Result;
use crate::codec::{Decoder, Encoder};
use crate::kalman::heard::Heard;
use crate::mixture::sample::Sample;
use crate::secure::labels::{Label, Labels, Prior};
use crate::secure::settings::Settings;

/// Beliefs about a sensor are kept this far from certainty.
const CERTAIN: f64 = 1e-6;

/// What is remembered.
#[derive(Debug, Clone)]
pub struct Memory {
    sensors: usize,
    /// Weight of every habit.
    weight: Vec<f64>,
    /// Belief that a sensor lies, by habit and sensor.
    lying: Vec<f64>,
    /// Belief that a sensor lies steadily; that it lied wildly at its latest sample; s; v of that sample.
    steady: Vec<f64>,
    constant: Vec<f64>,
    wild: Vec<f64>,
    spread: Vec<f64>,
    scatter: Vec<f64>,
    open: Vec<f64>,
    /// b and the latest residual, by channel of the plant, in its units.
    bias: Vec<f64>,
    offset: Vec<f64>,
    latest: Vec<f64>,
    /// Samples in a row with too many accused.
    pub violated: u64,
}

impl Memory {
    /// Before the first sample.
    #[must_use]
    pub fn new(settings: &Settings, sensors: usize, channels: usize) -> Self {
        let sensor = || vec![0.0; sensors];
        let mut memory = Self {
            sensors,
            weight: settings.habits.iter().map(|habit| habit.weight).collect(),
            lying: vec![0.0; settings.habits.len() * sensors],
            steady: sensor(),
            constant: sensor(),
            wild: sensor(),
            spread: sensor(),
            scatter: sensor(),
            open: sensor(),
            bias: vec![0.0; channels],
            offset: vec![0.0; channels],
            latest: vec![0.0; channels],
            violated: 0,
        };
        memory.clear(settings);
        memory
    }

    /// Forget everything but how sensors use to lie.
    pub fn clear(&mut self, settings: &Settings) {
        for (e, habit) in settings.habits.iter().enumerate() {
            self.lying[e * self.sensors..(e + 1) * self.sensors].fill(habit.onset);
        }
        for numbers in [&mut self.steady, &mut self.constant, &mut self.wild, &mut self.bias, &mut self.offset, &mut self.latest]
        {
            numbers.fill(0.0);
        }
        self.spread.fill(settings.bias.0);
        self.scatter.fill(settings.bias.0);
        self.open.fill(1.0);
        self.violated = 0;
    }

    /// Overwrite with `other`, without allocation.
    pub fn copy_from(&mut self, other: &Self) {
        self.weight.copy_from_slice(&other.weight);
        self.lying.copy_from_slice(&other.lying);
        self.steady.copy_from_slice(&other.steady);
        self.constant.copy_from_slice(&other.constant);
        self.wild.copy_from_slice(&other.wild);
        self.spread.copy_from_slice(&other.spread);
        self.scatter.copy_from_slice(&other.scatter);
        self.open.copy_from_slice(&other.open);
        self.bias.copy_from_slice(&other.bias);
        self.offset.copy_from_slice(&other.offset);
        self.latest.copy_from_slice(&other.latest);
        self.violated = other.violated;
    }

    /// Every chain and injection one sample on: before the sample is seen.
    #[inline(always)]
    pub fn move_on(&mut self, settings: &Settings) {
        for (lying, habit) in self.lying.chunks_exact_mut(self.sensors).zip(&settings.habits) {
            for p in lying {
                *p = *p * (1.0 - habit.recovery) + (1.0 - *p) * habit.onset;
            }
        }
        let (begin, settle, end) = settings.steady;
        let (first, change) = settings.bias;
        let first_of = first;
        let wander = settings.wander;
        let mut channel = 0;
        for (i, &size) in settings.sizes.iter().enumerate() {
            let range = channel..channel + size;
            channel += size;
            if settings.protected[i] {
                continue;
            }
            let (constant, steady) = (self.constant[i], self.steady[i]);
            let new = (1.0 - steady - constant - self.wild[i]).max(0.0) * begin / 2.0;
            let from = self.wild[i] * settle / 2.0;
            let first = first_of * self.open[i];
            let turn = settings.turn;
            let sum = |on: f64, other: f64| on * (1.0 - end - turn) + other * turn + new + from;
            let parts = [
                (constant * (1.0 - end - turn), self.scatter[i] + wander),
                (steady * turn, self.spread[i] + wander),
                (new, first),
                (from, self.open[i] + wander),
            ];
            let sources = |a: usize, d: f64, m: &Self| [m.offset[a] / d, m.bias[a] / d, 0.0, m.latest[a] / d];
            let total_constant = sum(constant, steady);
            let mut scatter = parts.iter().map(|(w, s)| w * s).sum::<f64>() / total_constant;
            let other = [
                (steady * (1.0 - end - turn), self.spread[i] + change),
                (constant * turn, self.scatter[i] + change),
                (new, first),
                (from, self.open[i] + change),
            ];
            let total_steady = sum(steady, constant);
            let mut spread = other.iter().map(|(w, s)| w * s).sum::<f64>() / total_steady;
            for a in range {
                let d = settings.deviations[a];
                let at = sources(a, d, self);
                let mean: f64 = parts.iter().zip(&at).map(|((w, _), b)| w * b).sum::<f64>() / total_constant;
                let square: f64 = parts.iter().zip(&at).map(|((w, _), b)| w * b * b).sum::<f64>() / total_constant;
                scatter += (square - mean * mean).max(0.0) / size as f64;
                let at = [at[1], at[0], 0.0, at[3]];
                let drift: f64 = other.iter().zip(&at).map(|((w, _), b)| w * b).sum::<f64>() / total_steady;
                let square: f64 = other.iter().zip(&at).map(|((w, _), b)| w * b * b).sum::<f64>() / total_steady;
                spread += (square - drift * drift).max(0.0) / size as f64;
                self.offset[a] = mean * d;
                self.bias[a] = drift * d;
            }
            self.constant[i] = total_constant;
            self.steady[i] = total_steady;
            self.wild[i] = 0.0;
            self.spread[i] = spread;
            self.scatter[i] = scatter;
        }
    }

    /// What to expect of the sensors that arrived.
    #[inline(always)]
    pub fn expect(&self, settings: &Settings, heard: &Heard, sample: &Sample, prior: &mut Prior) {
        let channels = heard.channels();
        for (place, &channel) in channels.iter().enumerate() {
            prior.bias[place] = self.bias[channel];
            prior.offset[place] = self.offset[channel];
        }
        heard.whitening().apply(&mut prior.offset[..channels.len()]);
        heard.whitening().apply(&mut prior.bias[..channels.len()]);
        for (index, one) in sample.arrived.iter().enumerate() {
            let i = one.sensor;
            let lies = self.lies(settings, i).clamp(CERTAIN, 1.0 - CERTAIN);
            let both = self.steady[i] + self.constant[i];
            let cut = (1.0 - CERTAIN).min(both) / both.max(f64::MIN_POSITIVE);
            prior.biased[index] = self.steady[i] * cut;
            prior.constant[index] = self.constant[i] * cut;
            prior.wild[index] = (1.0 - both * cut) * lies;
            prior.honest[index] = (1.0 - both * cut) * (1.0 - lies);
            prior.spread[index] = self.spread[i];
            prior.scatter[index] = self.scatter[i];
        }
    }

    /// π of a sensor.
    #[inline(always)]
    fn lies(&self, settings: &Settings, i: usize) -> f64 {
        let habits = settings.habits.iter().zip(&self.weight).enumerate();
        habits.map(|(e, (habit, weight))| weight * habit.duty * self.lying[e * self.sensors + i]).sum()
    }

    /// Remember what was believed of the sensors that arrived.
    #[inline(always)]
    pub fn remember(&mut self, settings: &Settings, heard: &Heard, sample: &Sample, labels: &Labels) {
        self.weigh_habits(settings, sample, labels);
        for (index, one) in sample.arrived.iter().enumerate() {
            if one.protected {
                continue;
            }
            let i = one.sensor;
            let (honest, biased, constant) = (labels.honest[index], labels.biased[index], labels.constant[index]);
            let wild = (1.0 - honest - biased - constant).max(0.0);
            let range = one.first..one.first + one.size;
            let v = labels.v[range].iter().sum::<f64>() / one.size as f64;
            let gain = self.spread[i] / (self.spread[i] + v);
            let slow = self.scatter[i] / (self.scatter[i] + v);
            for a in 0..one.size {
                let row = heard.whitening().row(one.first + a);
                let from = a + 1 - row.len();
                let raw: f64 = row.iter().enumerate().map(|(b, l)| l * labels.unturned(one, from + b)).sum();
                let channel = heard.channels()[one.first + a];
                self.latest[channel] = raw;
                self.bias[channel] += gain * (raw - self.bias[channel]);
                self.offset[channel] += slow * (raw - self.offset[channel]);
            }
            self.spread[i] *= 1.0 - gain;
            self.scatter[i] *= 1.0 - slow;
            self.open[i] = v;
            self.steady[i] = biased;
            self.constant[i] = constant;
            self.wild[i] = wild;
        }
    }

    #[inline(always)]
    fn weigh_habits(&mut self, settings: &Settings, sample: &Sample, labels: &Labels) {
        let (forgetting, share) = settings.forgetting;
        let mut largest = f64::NEG_INFINITY;
        for (e, habit) in settings.habits.iter().enumerate() {
            let mut log = forgetting * self.weight[e].max(f64::MIN_POSITIVE).ln();
            for (index, one) in sample.arrived.iter().enumerate() {
                if one.protected {
                    continue;
                }
                let [honest, same, biased, wild] = labels.density[index];
                let (steady, constant) = (self.steady[one.sensor], self.constant[one.sensor]); // the prior
                let not = (1.0 - steady - constant).max(0.0) * honest + steady * biased + constant * same;
                let not = not.max(f64::MIN_POSITIVE);
                let ratio = (wild / not).clamp(1e-13, 1e13);
                let ratio = 1.0 - habit.duty + habit.duty * ratio;
                let p = &mut self.lying[e * self.sensors + one.sensor];
                let sum = *p * ratio + 1.0 - *p;
                log += sum.ln();
                *p = *p * ratio / sum;
            }
            self.weight[e] = log;
            largest = largest.max(log);
        }
        let mut sum = 0.0;
        for weight in &mut self.weight {
            *weight = (*weight - largest).exp();
            sum += *weight;
        }
        for (weight, habit) in self.weight.iter_mut().zip(&settings.habits) {
            *weight = (1.0 - share) * *weight / sum + share * habit.weight;
        }
    }

    /// Write everything.
    pub fn save(&self, to: &mut Encoder) {
        for numbers in [
            &self.weight,
            &self.lying,
            &self.steady,
            &self.constant,
            &self.wild,
            &self.spread,
            &self.scatter,
            &self.open,
            &self.bias,
            &self.offset,
            &self.latest,
        ] {
            to.floats(numbers);
        }
        to.integer(self.violated);
    }

    /// Read it back.
    ///
    /// # Errors
    /// [`crate::Error::Resume`] if the bytes do not fit.
    pub fn load(&mut self, from: &mut Decoder<'_>) -> Result<()> {
        for numbers in [
            &mut self.weight,
            &mut self.lying,
            &mut self.steady,
            &mut self.constant,
            &mut self.wild,
            &mut self.spread,
            &mut self.scatter,
            &mut self.open,
            &mut self.bias,
            &mut self.offset,
            &mut self.latest,
        ] {
            from.floats(numbers)?;
        }
        self.violated = from.integer()?;
        Ok(())
    }
}

impl Memory {
    /// What a sensor injects, by channel of the plant, and its variance in units of R.
    #[must_use]
    pub fn injection(&self, sensor: usize, label: Label) -> (&[f64], f64) {
        match label {
            Label::Constant => (&self.offset, self.scatter[sensor]),
            Label::Biased => (&self.bias, self.spread[sensor]),
            _ => (&self.latest, self.open[sensor]),
        }
    }
}
