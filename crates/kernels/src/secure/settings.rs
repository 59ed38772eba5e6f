//! The constants behind the beliefs.

use crate::codec::Fingerprint;
use crate::mixture::sample::Sample;
use crate::{Error, Result};

/// A habit of lying: how likely a sensor begins, how likely it ends, and how often it lies in between.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Habit {
    /// Probability that an honest sensor begins to lie, per sample.
    pub onset: f64,
    /// Probability that a liar becomes honest, per sample.
    pub recovery: f64,
    /// Share of the samples that a liar falsifies.
    pub duty: f64,
    /// Weight before the first sample.
    pub weight: f64,
}

/// All of them.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Habits.
    pub habits: Vec<Habit>,
    /// Forgetting of the weights of habits, and the share given back to the first weights.
    pub forgetting: (f64, f64),
    /// Variance of a wild injection, in units of R.
    pub kappa: f64,
    /// Shares of the parts of a wild density: broad, learned.
    pub shares: [f64; 2],
    /// Least pseudo-scale of a learned cluster.
    pub scale: f64,
    /// Probability that an honest sensor begins to lie steadily; that a wild one does; that it ends.
    pub steady: (f64, f64, f64),
    /// Variance of an injection that begins, in units of R, and of its change per sample.
    pub bias: (f64, f64),
    /// Whether a sensor that lies steadily says something about the state, less its injection: 1 or 0.
    pub reuse: f64,
    /// Change of a constant injection per sample, and chance to turn from constant to drifting or back.
    pub wander: f64,
    /// See `wander`.
    pub turn: f64,
    /// Starts: prior, gate, robust, complement: which are tried.
    pub starts: [bool; 3],
    /// Sweeps at most.
    pub cap: usize,
    /// Change of beliefs that counts as none.
    pub tolerance: f64,
    /// Samples in a row with too many accused before memory is doubted, 0 = never; inflation of P⁻ then.
    pub doubt: (usize, f64),
    /// Votes of the accused against the believed from which on they are too many; 0 = only heads are counted.
    pub votes: f64,
    /// Channels of every sensor, (N,), and standard deviation of their noise, (m,).
    pub sizes: Vec<usize>,
    /// See `sizes`.
    pub deviations: Vec<f64>,
    /// Nobody can tamper with these, (N,).
    pub protected: Vec<bool>,
}

impl Settings {
    /// τ² of a cluster of so many lies with sum of squares about a mean shrunk to 0.
    #[inline(always)]
    #[must_use]
    pub fn cluster_spread(&self, count: f64, square: f64, mean: &[f64]) -> f64 {
        let m = mean.len() as f64;
        let about: f64 = mean.iter().map(|mu| mu * mu).sum();
        let pseudo = 2.0 * self.scale * self.scale;
        ((square - (count + 1.0) * about + pseudo) / (m * count + m + 2.0) - 1.0).max(0.25)
    }

    /// Most sensors that can be lying among those that arrived.
    #[inline(always)]
    #[must_use]
    pub fn most(&self, sample: &Sample) -> usize {
        let arrived = sample.arrived.len();
        let protected = sample.arrived.iter().filter(|one| one.protected).count();
        let minority = arrived.saturating_sub(1) / 2;
        if protected > 0 { arrived - protected } else { minority }
    }

    /// Check ranges.
    ///
    /// # Errors
    /// A number out of range.
    pub fn check(&self, sensors: usize) -> Result<()> {
        Error::check_len("protected", sensors, self.protected.len())
    }

    /// Mix in every choice.
    #[must_use]
    pub fn fingerprint(&self, hash: Fingerprint) -> Fingerprint {
        let protected: Vec<usize> = self.protected.iter().map(|&p| usize::from(p)).collect();
        let habits: Vec<f64> =
            self.habits.iter().flat_map(|h| [h.onset, h.recovery, h.duty, h.weight]).collect();
        hash.sizes(&protected).floats(&habits).floats(&[self.steady.0, self.kappa])
    }
}
