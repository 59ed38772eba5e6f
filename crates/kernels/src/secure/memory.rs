//! What is remembered of every sensor: whether it lies, in what habit, and what it injects.
//!
//! ```text
//!     habits     p_e⁻ = p_e (1 − recovery_e) + (1 − p_e) onset_e,   π = Σ w_e p_e⁻
//!                p_e = p_e⁻ r / (p_e⁻ r + 1 − p_e⁻),   w_e ∝ w_e^(1 − fade) Π (p_e⁻ r + 1 − p_e⁻)
//!     steady     N(b, s) of an injection that drifts (s grows by q per sample) and of one that is constant, with the
//!                probability of either; each begins as N(0, 4 v), goes on, or takes over from the other or from what was
//!                last sent wildly, merged to the first two moments
//! ```
//!
//! r is the likelihood ratio of this sample alone, wild against all else: what is remembered never counts twice. The
//! weights w of habits are shared by all sensors.
//!
//! # References
//! Blom, Bar-Shalom 1988 (merging before the sample is seen: interacting multiple models).

use crate::Result;
use crate::codec::{Decoder, Encoder};
use crate::kalman::heard::Heard;
use crate::mixture::sample::{Arrived, Sample};
use crate::secure::labels::{Label, Labels, Prior};
use crate::secure::settings::{CAUTION, CHANGE, END, FADE, FIRST, HABITS, Part, SETTLE, Settings, TURN};

/// Beliefs about a sensor are kept this far from certainty, in odds at the most of 10^6.
const CERTAIN: f64 = 1e-6;

/// Noise added to a liar that is used less its injection, where it is not to be used: too large to count.
const UNUSED: f64 = 1e6;

/// Most that a lie ends per sample because the others say little of the sensor.
const FASTEST: f64 = 0.5;

/// Most that one sample says for or against a lie, as a ratio.
const DECISIVE: f64 = 1e13;

/// Injections of one kind, steady lies that drift or that are constant.
#[derive(Debug, Clone)]
struct Steady {
    /// Probability, by sensor.
    belief: Vec<f64>,
    /// s, by sensor, in units of R.
    spread: Vec<f64>,
    /// b, by channel of the plant, in its units.
    bias: Vec<f64>,
    /// Growth of s per sample.
    change: f64,
}

impl Steady {
    fn new(sensors: usize, channels: usize, change: f64) -> Self {
        let sensor = || vec![0.0; sensors];
        Self { belief: sensor(), spread: vec![FIRST; sensors], bias: vec![0.0; channels], change }
    }

    fn numbers(&mut self) -> [&mut Vec<f64>; 3] {
        [&mut self.belief, &mut self.spread, &mut self.bias]
    }

    /// Where an injection of this kind can come from, merged.
    #[inline(always)]
    fn merge(&mut self, sensor: usize, belief: f64, spread: f64) {
        (self.belief[sensor], self.spread[sensor]) = (belief, spread);
    }

    /// Take in what the others do not expect: residual of variance v.
    #[inline(always)]
    fn correct(&mut self, sensor: usize, v: f64) -> f64 {
        let gain = self.spread[sensor] / (self.spread[sensor] + v);
        self.spread[sensor] *= 1.0 - gain;
        gain
    }
}

/// What is remembered.
#[derive(Debug, Clone)]
pub struct Memory {
    /// Weight of every habit.
    weight: Vec<f64>,
    /// Belief that a sensor lies, by habit and sensor.
    lying: Vec<f64>,
    drifting: Steady,
    constant: Steady,
    /// Belief that the latest sample of a sensor was a wild lie, and v then.
    wild: Vec<f64>,
    open: Vec<f64>,
    /// The latest residual, by channel of the plant, in its units.
    latest: Vec<f64>,
    /// Scratch: r of the sensors that arrived.
    ratio: Vec<f64>,
    /// Samples in a row in which the accused outvoted the believed.
    pub outvoted: u64,
}

impl Memory {
    /// Before the first sample.
    #[must_use]
    pub fn new(settings: &Settings) -> Self {
        let (sensors, channels) = (settings.protected.len(), settings.deviations.len());
        let mut memory = Self {
            weight: HABITS.iter().map(|habit| habit.weight).collect(),
            lying: vec![0.0; HABITS.len() * sensors],
            drifting: Steady::new(sensors, channels, CHANGE.0),
            constant: Steady::new(sensors, channels, CHANGE.1),
            wild: vec![0.0; sensors],
            open: vec![1.0; sensors],
            latest: vec![0.0; channels],
            ratio: vec![0.0; sensors],
            outvoted: 0,
        };
        memory.clear(settings);
        memory
    }

    /// Forget everything but in what habits sensors lie.
    pub fn clear(&mut self, settings: &Settings) {
        let sensors = settings.protected.len();
        for (lying, habit) in self.lying.chunks_exact_mut(sensors).zip(&HABITS) {
            lying.iter_mut().enumerate().for_each(|(i, p)| *p = settings.onset(habit, i));
        }
        for steady in [&mut self.drifting, &mut self.constant] {
            steady.belief.fill(0.0);
            steady.spread.fill(FIRST);
            steady.bias.fill(0.0);
        }
        self.wild.fill(0.0);
        self.outvoted = 0;
    }

    fn numbers(&mut self) -> [&mut Vec<f64>; 11] {
        let [a, b, c] = self.drifting.numbers();
        let [d, e, f] = self.constant.numbers();
        let Self { weight, lying, wild, open, latest, .. } = self;
        [weight, lying, a, b, c, d, e, f, wild, open, latest]
    }

    /// Overwrite with `other`, without allocation.
    pub fn copy_from(&mut self, other: &mut Self) {
        self.outvoted = other.outvoted;
        for (mine, theirs) in self.numbers().into_iter().zip(other.numbers()) {
            mine.copy_from_slice(theirs);
        }
    }

    /// Chains and injections of the sensors that arrived one sample on: before the sample is seen. Who is silent is
    /// remembered as it was.
    #[inline(always)]
    pub fn move_on(&mut self, settings: &Settings, sample: &Sample) {
        let sensors = settings.protected.len();
        for (lying, habit) in self.lying.chunks_exact_mut(sensors).zip(&HABITS) {
            for i in sample.arrived.iter().map(|one| one.sensor) {
                let p = &mut lying[i];
                let recovery = (habit.recovery * self.open[i]).min(habit.recovery.max(FASTEST));
                *p = *p * (1.0 - recovery) + (1.0 - *p) * settings.onset(habit, i);
            }
        }
        for i in sample.arrived.iter().filter(|one| !one.protected).map(|one| one.sensor) {
            self.move_injection(settings, i, settings.channels(i));
        }
    }

    /// Merge where the steady lies of a sensor can come from: the same, the other kind, nothing, a wild one.
    #[inline(always)]
    fn move_injection(&mut self, settings: &Settings, i: usize, channels: std::ops::Range<usize>) {
        let Self { drifting, constant, wild, open, latest, .. } = self;
        let (drifts, rests) = (drifting.belief[i], constant.belief[i]);
        let honest = (1.0 - drifts - rests - wild[i]).max(0.0);
        let end = (END * open[i]).min(FASTEST);
        let (begins, settles) = (0.5 * honest * settings.steady, 0.5 * wild[i] * SETTLE);
        let size = channels.len() as f64;
        let mut spreads = [0.0; 2];
        let mut beliefs = [0.0; 2];
        let mut shares = [[0.0; 4]; 2];
        let kinds = [(drifts, rests, drifting.change), (rests, drifts, constant.change)];
        let before = [drifting.spread[i], constant.spread[i]];
        for (kind, &(own, other, change)) in kinds.iter().enumerate() {
            let parts = [own * (1.0 - end - TURN), other * TURN, begins, settles];
            let belief: f64 = parts.iter().sum();
            shares[kind] = parts.map(|part| part / belief);
            let variances =
                [before[kind] + change, before[1 - kind] + change, FIRST * open[i], open[i] + change];
            spreads[kind] = shares[kind].iter().zip(&variances).map(|(share, s)| share * s).sum();
            beliefs[kind] = belief;
        }
        for a in channels {
            let deviation = settings.deviations[a];
            let biases = [drifting.bias[a], constant.bias[a]];
            for (kind, bias) in [&mut drifting.bias[a], &mut constant.bias[a]].into_iter().enumerate() {
                let sources = [biases[kind], biases[1 - kind], 0.0, latest[a]].map(|b| b / deviation);
                let parts = || shares[kind].iter().zip(&sources);
                let mean: f64 = parts().map(|(share, b)| share * b).sum();
                let scatter: f64 = parts().map(|(share, b)| share * (b - mean) * (b - mean)).sum();
                spreads[kind] += scatter / size;
                *bias = mean * deviation;
            }
        }
        drifting.merge(i, beliefs[0], spreads[0]);
        constant.merge(i, beliefs[1], spreads[1]);
        wild[i] = 0.0;
    }

    /// What to expect of the sensors that arrived.
    #[inline(always)]
    pub fn expect(&self, settings: &Settings, heard: &Heard, sample: &Sample, prior: &mut Prior) {
        let channels = heard.channels();
        let steady = [(&self.drifting, &mut prior.drift), (&self.constant, &mut prior.offset)];
        for (steady, target) in steady {
            for (target, &channel) in target.iter_mut().zip(channels) {
                *target = steady.bias[channel];
            }
            heard.whitening().apply(&mut target[..channels.len()]);
        }
        let sensors = self.wild.len();
        for (index, one) in sample.arrived.iter().enumerate() {
            let i = one.sensor;
            let lies: f64 =
                self.lying.chunks_exact(sensors).zip(&self.weight).map(|(lying, w)| w * lying[i]).sum();
            let lies = if settings.has(Part::Habits) { lies } else { settings.onset[i] };
            let lies = lies.clamp(CERTAIN, 1.0 - CERTAIN);
            let kept = if settings.has(Part::Steady) { 1.0 } else { 0.0 };
            let (drifting, constant) = (kept * self.drifting.belief[i], kept * self.constant.belief[i]);
            let steady = drifting + constant;
            let cut = (1.0 - CERTAIN).min(steady) / steady.max(f64::MIN_POSITIVE);
            let rest = 1.0 - steady * cut;
            prior.probability[index] = [rest * (1.0 - lies), constant * cut, drifting * cut, rest * lies];
            prior.spread[index] = [self.constant.spread[i], self.drifting.spread[i]];
            prior.reuse = if settings.has(Part::Reuse) && self.outvoted == 0 { CAUTION } else { UNUSED };
        }
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
            let [_, constant, drifting, wild] = labels.belief[index];
            let v = labels.v[one.first..one.first + one.size].iter().sum::<f64>() / one.size as f64;
            let (fast, slow) = (self.drifting.correct(i, v), self.constant.correct(i, v));
            for a in 0..one.size {
                let channel = heard.channels()[one.first + a];
                let residual = colour(heard, one, a, |b| labels.residual(one, b));
                self.latest[channel] = residual;
                self.drifting.bias[channel] += fast * (residual - self.drifting.bias[channel]);
                self.constant.bias[channel] += slow * (residual - self.constant.bias[channel]);
            }
            (self.drifting.belief[i], self.constant.belief[i]) = (drifting, constant);
            (self.wild[i], self.open[i]) = (wild, v);
        }
    }

    /// Chains and weights of the habits.
    #[inline(always)]
    fn weigh_habits(&mut self, settings: &Settings, sample: &Sample, labels: &Labels) {
        for (index, one) in sample.arrived.iter().enumerate() {
            self.ratio[index] = self.ratio(labels.density[index], one.sensor);
        }
        let sensors = self.wild.len();
        let (fade, back) = (FADE.0 * settings.crowd, FADE.1 * settings.crowd);
        let mut largest = f64::NEG_INFINITY;
        for (lying, weight) in self.lying.chunks_exact_mut(sensors).zip(&mut self.weight) {
            let (mut log, mut product) = ((1.0 - fade) * weight.max(f64::MIN_POSITIVE).ln(), 1.0_f64);
            for (index, one) in sample.arrived.iter().enumerate().filter(|(_, one)| !one.protected) {
                let p = &mut lying[one.sensor];
                let ratio = self.ratio[index];
                let sum = *p * ratio + 1.0 - *p;
                product *= sum;
                if !(1e-200..1e200).contains(&product) {
                    log += product.ln();
                    product = 1.0;
                }
                *p = *p * ratio / sum;
            }
            *weight = log + product.ln();
            largest = largest.max(*weight);
        }
        self.weight.iter_mut().for_each(|weight| *weight = (*weight - largest).exp());
        let sum: f64 = self.weight.iter().sum();
        for (weight, habit) in self.weight.iter_mut().zip(&HABITS) {
            *weight = (1.0 - back) * *weight / sum + back * habit.weight;
        }
    }

    /// r of a sensor whose densities as honest, constant, drifting and wild are these.
    #[inline(always)]
    fn ratio(&self, [honest, same, drift, wild]: [f64; 4], sensor: usize) -> f64 {
        let (drifting, constant) = (self.drifting.belief[sensor], self.constant.belief[sensor]);
        let other = (1.0 - drifting - constant).max(0.0) * honest + constant * same + drifting * drift;
        (wild / other.max(f64::MIN_POSITIVE)).clamp(1.0 / DECISIVE, DECISIVE)
    }

    /// What a sensor injects, by channel of the plant, and its variance in units of R.
    #[must_use]
    pub fn injection(&self, sensor: usize, label: Label) -> (&[f64], f64) {
        match label {
            Label::Constant => (&self.constant.bias, self.constant.spread[sensor]),
            Label::Drifting => (&self.drifting.bias, self.drifting.spread[sensor]),
            _ => (&self.latest, self.open[sensor]),
        }
    }

    /// Write everything.
    pub fn save(&self, to: &mut Encoder) {
        self.clone().numbers().into_iter().for_each(|numbers| to.floats(numbers));
        to.integer(self.outvoted);
    }

    /// Read it back.
    ///
    /// # Errors
    /// [`crate::Error::Resume`] if the bytes do not fit.
    pub fn load(&mut self, from: &mut Decoder<'_>) -> Result<()> {
        for numbers in self.numbers() {
            from.floats(numbers)?;
        }
        self.outvoted = from.integer()?;
        Ok(())
    }
}

/// (L v)_a of a sensor with R = L Lᵀ, v by its channels.
#[inline(always)]
pub(super) fn colour(heard: &Heard, one: &Arrived, a: usize, v: impl Fn(usize) -> f64) -> f64 {
    let row = heard.whitening().row(one.first + a);
    let from = a + 1 - row.len();
    row.iter().enumerate().map(|(b, l)| l * v(from + b)).sum()
}
