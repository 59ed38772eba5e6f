//! How much larger than expected the latest innovations of every channel were, squared.

use crate::Result;
use crate::codec::{Decoder, Encoder};

/// Distances in C x beyond which a reading says no more: their squares and sums of these stay finite.
pub const LIMIT: f64 = 1e140;

/// The latest ν² − S of every channel, and how many there were.
#[derive(Debug, Clone)]
pub struct Window {
    length: usize,
    /// (m, length), each row overwritten from its front when it is full.
    excess: Vec<f64>,
    /// Samples in which the channel arrived, (m,).
    count: Vec<u64>,
}

impl Window {
    /// Empty, for `channels` channels and `length` samples.
    #[must_use]
    pub fn new(channels: usize, length: usize) -> Self {
        Self { length, excess: vec![0.0; channels * length], count: vec![0; channels] }
    }

    /// Take in ν and S of a channel that arrived; returns its η: the mean of ν² − S over the window, at least that of
    /// this sample if ν² > gate · S, never negative.
    pub fn eta(&mut self, channel: usize, nu: f64, variance: f64, gate: f64) -> f64 {
        let now = excess(nu, variance);
        let row = &mut self.excess[channel * self.length..(channel + 1) * self.length];
        let count = &mut self.count[channel];
        row[(*count % self.length as u64) as usize] = now;
        *count = count.saturating_add(1);
        let filled = (*count).min(self.length as u64) as usize;
        let mean = row[..filled].iter().sum::<f64>() / filled as f64;
        let least = if nu * nu > gate * variance { now } else { 0.0 };
        mean.max(least).max(0.0)
    }

    /// Write everything.
    pub fn save(&self, to: &mut Encoder) {
        self.count.iter().for_each(|&count| to.integer(count));
        to.floats(&self.excess);
    }

    /// Read it back.
    ///
    /// # Errors
    /// If the bytes do not fit.
    pub fn load(&mut self, from: &mut Decoder<'_>) -> Result<()> {
        for count in &mut self.count {
            *count = from.integer()?;
        }
        from.floats(&mut self.excess)
    }
}

/// ν² − S within what numbers can tell; 0 where S is beyond that.
fn excess(nu: f64, variance: f64) -> f64 {
    let nu = nu.clamp(-LIMIT, LIMIT);
    if variance.is_finite() { (nu * nu - variance).max(-LIMIT * LIMIT) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eta_is_the_mean_over_the_window_and_never_negative() {
        let mut window = Window::new(2, 2);
        let eta = |window: &mut Window, nu| window.eta(1, nu, 1.0, 9.0);
        assert_eq!(eta(&mut window, 0.0), 0.0);
        assert_eq!(eta(&mut window, 2.0), 1.0);
        assert_eq!(eta(&mut window, 1.0), 1.5);
        assert_eq!(eta(&mut window, 0.0), 0.0);
    }

    #[test]
    fn a_distance_beyond_the_gate_counts_at_once() {
        let mut window = Window::new(1, 20);
        for _ in 0..19 {
            assert_eq!(window.eta(0, 0.0, 1.0, 9.0), 0.0);
        }
        assert_eq!(window.eta(0, 4.0, 1.0, 9.0), 15.0);
        assert_eq!(window.eta(0, 3.0, 1.0, 9.0), (15.0 + 8.0 - 18.0) / 20.0);
    }

    #[test]
    fn no_size_of_distance_or_variance_gives_a_number_that_is_none() {
        let sizes = [0.0, 1e-300, 1.0, 1e150, 1e300, f64::MAX];
        for nu in sizes {
            for variance in [1e-300, 1.0, 1e300, f64::INFINITY, f64::NAN] {
                let mut window = Window::new(1, 10_000);
                for _ in 0..3 {
                    let eta = window.eta(0, nu, variance, 9.0);
                    assert!((0.0..=LIMIT * LIMIT).contains(&eta), "{nu} {variance}");
                }
            }
        }
    }
}
