//! The constants behind the beliefs, and what is chosen per plant.

use crate::codec::Fingerprint;
use crate::mixture::sample::Sample;
use crate::{Error, Result};

/// A habit of lying: a two-state chain per sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Habit {
    /// Probability that an honest sensor begins to lie, per sample; None = what the false alarm rate allows.
    pub onset: Option<f64>,
    /// Probability that a liar becomes honest, per sample.
    pub recovery: f64,
    /// Weight before the first sample.
    pub weight: f64,
}

/// For long, for a few samples, and two for attacks that choose their sensors anew every time.
pub const HABITS: [Habit; 4] = [
    Habit { onset: None, recovery: 0.01, weight: 0.5 },
    Habit { onset: None, recovery: 0.3, weight: 0.35 },
    Habit { onset: Some(0.1), recovery: 0.9, weight: 0.075 },
    Habit { onset: Some(0.4), recovery: 0.6, weight: 0.075 },
];

/// Sensors that make the weights of habits forget at full speed, what they forget then per sample, and what they are
/// given back of their first values.
pub const CROWD: f64 = 15.0;
/// See [`CROWD`].
pub const FADE: (f64, f64) = (0.02, 0.01);

/// κ: variance of a wild lie, in units of what the others leave open. The false alarm rate is calibrated for it.
pub const BROAD: f64 = 15.0;

/// Shares of the broad and of the learned density among wild lies.
pub const SHARES: (f64, f64) = (0.5, 0.5);

/// Deviation of a learned cluster of lies before there is one, and its least variance, in the same unit.
pub const CLUSTER: (f64, f64) = (1.5, 0.25);

/// Variance of a steady lie that begins, in the same unit.
pub const FIRST: f64 = 4.0;

/// Change of a drifting and of a constant lie per sample, as variances in units of R.
pub const CHANGE: (f64, f64) = (0.2, 1e-4);

/// Probabilities per sample that a wild lie becomes steady, that a steady one ends, and that it turns from drifting to
/// constant or back.
pub const SETTLE: f64 = 0.05;
/// See [`SETTLE`].
pub const END: f64 = 0.01;
/// See [`SETTLE`].
pub const TURN: f64 = 0.01;

/// Noise that is added where the reading of a liar is used less its constant injection, in units of R.
pub const CAUTION: f64 = 0.5;

/// Samples in a row in which the accused outvote the believed before everything is doubted, and how much larger P⁻ is
/// taken to be then.
pub const DOUBT: (u64, f64) = (3, 25.0);

/// Sweeps at most, and the change of beliefs that ends them.
pub const SWEEPS: (usize, f64) = (15, 1e-3);

/// A part of the filter that can be left out, to measure what it is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Habits: every sensor is as likely to lie at every sample as one that begins.
    Habits,
    /// Steady lies: every lie is wild.
    Steady,
    /// The use of sensors that lie by a constant.
    Reuse,
    /// The start from a robust regression.
    Regression,
    /// The doubt of everything once the accused outvote the believed.
    Doubt,
    /// The count of votes by direction of the state; heads are still counted.
    Votes,
}

impl Part {
    /// All of them by name.
    pub const NAMES: [(&'static str, Self); 6] = [
        ("habits", Self::Habits),
        ("steady", Self::Steady),
        ("reuse", Self::Reuse),
        ("regression", Self::Regression),
        ("doubt", Self::Doubt),
        ("votes", Self::Votes),
    ];
}

/// What is chosen per plant.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Probability that an honest sensor begins to lie, per sample, (N,).
    pub onset: Vec<f64>,
    /// The same that it begins to lie steadily.
    pub steady: f64,
    /// Nobody can tamper with these, (N,).
    pub protected: Vec<bool>,
    /// Channels of every sensor, (N,), and its first one.
    pub sizes: Vec<usize>,
    /// See `sizes`.
    pub first: Vec<usize>,
    /// Standard deviation of the noise of every channel, (m,).
    pub deviations: Vec<f64>,
    /// Share of [`FADE`] that the sensors of the plant make up.
    pub crowd: f64,
    /// Parts left out.
    pub without: Vec<Part>,
}

impl Settings {
    /// The settings for sensors with these channels.
    ///
    /// # Errors
    /// A number out of range.
    pub fn new(
        (onset, steady): (Vec<f64>, f64),
        protected: Vec<bool>,
        channel_sensor: &[usize],
        deviations: Vec<f64>,
    ) -> Result<Self> {
        let sensors = protected.len();
        Error::check_len("onset", sensors, onset.len())?;
        Error::check_len("deviations", channel_sensor.len(), deviations.len())?;
        for &p in onset.iter().chain([&steady]) {
            if !(p > 0.0 && p < 0.5) {
                return Err(Error::input("onset", "probabilities in (0, 0.5)", format!("{p}")));
            }
        }
        let mut sizes = vec![0; sensors];
        channel_sensor.iter().for_each(|&sensor| sizes[sensor] += 1);
        let first = sizes.iter().scan(0, |next, size| {
            let first = *next;
            *next += size;
            Some(first)
        });
        let first = first.collect();
        let open = protected.iter().filter(|&&protected| !protected).count();
        let crowd = (open as f64 / CROWD).min(1.0);
        Ok(Self { onset, steady, protected, sizes, first, deviations, crowd, without: Vec::new() })
    }

    /// Whether a part is in use.
    #[inline(always)]
    #[must_use]
    pub fn has(&self, part: Part) -> bool {
        !self.without.contains(&part)
    }

    /// Channels of a sensor.
    #[must_use]
    pub fn channels(&self, sensor: usize) -> std::ops::Range<usize> {
        self.first[sensor]..self.first[sensor] + self.sizes[sensor]
    }

    /// Probability that a sensor begins to lie in a habit.
    #[inline(always)]
    #[must_use]
    pub fn onset(&self, habit: &Habit, sensor: usize) -> f64 {
        habit.onset.unwrap_or(self.onset[sensor])
    }

    /// Most sensors that can be lying among those that arrived: a minority, or all that are not protected.
    #[inline(always)]
    #[must_use]
    pub fn most(&self, sample: &Sample) -> usize {
        let arrived = sample.arrived.len();
        let protected = sample.arrived.iter().filter(|one| one.protected).count();
        if protected > 0 { arrived - protected } else { arrived.saturating_sub(1) / 2 }
    }

    /// Mix in every choice.
    #[must_use]
    pub fn fingerprint(&self, hash: Fingerprint) -> Fingerprint {
        let protected: Vec<usize> = self.protected.iter().map(|&p| usize::from(p)).collect();
        let without: Vec<usize> = self.without.iter().map(|&part| part as usize).collect();
        hash.sizes(&protected).sizes(&without).floats(&self.onset).floats(&[self.steady])
    }
}

/// τ² of a cluster of so many lies, in so many channels, with this sum of squares about a mean shrunk towards 0.
#[inline(always)]
#[must_use]
pub fn cluster_spread((count, channels): (f64, f64), square: f64, mean: &[f64]) -> f64 {
    let about: f64 = mean.iter().map(|mu| mu * mu).sum();
    let pseudo = 2.0 * CLUSTER.0 * CLUSTER.0;
    let freedom = channels + mean.len() as f64 + 2.0;
    ((square - (count + 1.0) * about + pseudo) / freedom - 1.0).max(CLUSTER.1)
}
