//! Correlated measurement noise made independent: L⁻¹ v has unit covariance when v ~ N(0, L Lᵀ).
//!
//! L is stored by rows from their first entry that is not zero, so independent channels cost nothing extra.

use crate::lanes::{self, Lane};
use crate::linalg::{axpy, dot};
use crate::{Error, Result};

/// The noise covariance R of all channels, in the order in which they are taken in.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// R in that order, (m, m).
    pub r: Vec<f64>,
    /// The channel at each place, (m,).
    pub order: Vec<usize>,
    /// First place that place i is correlated with, (m,).
    first: Vec<usize>,
}

impl Noise {
    /// Find out who is correlated with whom.
    ///
    /// # Errors
    /// If R is not (m, m) or not positive definite.
    pub fn new(r: Vec<f64>, m: usize) -> Result<Self> {
        Error::check_len("R", m * m, r.len())?;
        let first = (0..m).map(|i| (0..i).find(|&j| r[i * m + j] != 0.0).unwrap_or(i)).collect();
        let noise = Self { r, order: (0..m).collect(), first };
        let mut whitening = Whitening::new(&noise);
        let all: Vec<usize> = (0..m).collect();
        if whitening.factorise(&noise, &all) {
            return Ok(noise);
        }
        Err(Error::input("R", "a positive definite matrix", "a singular or indefinite one"))
    }

    /// The same without the correlation between channels of different owners.
    ///
    /// # Errors
    /// None for a noise that exists: its diagonal blocks are positive definite.
    pub fn within(&self, owner: &[usize]) -> Result<Self> {
        let m = owner.len();
        let mut r = self.r.clone();
        for (i, value) in r.iter_mut().enumerate() {
            if owner[i / m] != owner[i % m] {
                *value = 0.0;
            }
        }
        Self::new(r, m)
    }

    /// The same, taken in with the channels that `leads` names first, otherwise in increasing order.
    ///
    /// # Errors
    /// None for a noise that exists.
    pub fn with_first(&self, leads: impl Fn(usize) -> bool) -> Result<Self> {
        let m = self.channels();
        let (mut order, others): (Vec<_>, Vec<_>) = (0..m).partition(|&channel| leads(channel));
        order.extend(others);
        let r = (0..m * m).map(|k| self.r[order[k / m] * m + order[k % m]]).collect();
        Ok(Self { order, ..Self::new(r, m)? })
    }

    /// Unit noise with room for a correlation among the channels of each owner.
    #[must_use]
    pub fn blocks(owner: &[usize]) -> Self {
        let m = owner.len();
        let r = (0..m * m).map(|k| f64::from(u8::from(k / m == k % m))).collect();
        let first = (0..m).map(|i| (0..i).find(|&j| owner[j] == owner[i]).unwrap_or(i)).collect();
        Self { r, order: (0..m).collect(), first }
    }

    /// Become `honest` with `added` (m,), by channel, on the diagonal.
    pub fn inflate(&mut self, honest: &Self, added: &[f64]) {
        let m = self.channels();
        for (place, &channel) in honest.order.iter().enumerate() {
            self.r[place * m + place] = honest.r[place * m + place] + added[channel];
        }
    }

    /// Number of channels.
    fn channels(&self) -> usize {
        self.first.len()
    }
}

/// The Cholesky factor L of the covariance of the channels that arrived.
#[derive(Debug, Clone, PartialEq)]
pub struct Whitening {
    entries: Vec<f64>,
    /// Where row i starts in `entries`, one more than there are rows.
    start: Vec<usize>,
}

impl Whitening {
    /// Room for all channels.
    #[must_use]
    pub fn new(noise: &Noise) -> Self {
        let m = noise.channels();
        Self { entries: vec![0.0; (0..m).map(|i| i - noise.first[i] + 1).sum()], start: vec![0; m + 1] }
    }

    /// Overwrite with `other`, without allocation.
    pub fn copy_from(&mut self, other: &Self) {
        self.entries.copy_from_slice(&other.entries);
        self.start.copy_from_slice(&other.start);
    }

    /// Row i of L from its first entry to its diagonal.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        &self.entries[self.start[i]..self.start[i + 1]]
    }

    /// L for the channels at these places, in increasing order; false if their covariance is not positive definite.
    pub fn factorise(&mut self, noise: &Noise, places: &[usize]) -> bool {
        let m = noise.channels();
        for (i, &place) in places.iter().enumerate() {
            let earlier = places[..i].iter().rev();
            let width = earlier.take_while(|&&p| p >= noise.first[place]).count();
            let begin = self.start[i];
            self.start[i + 1] = begin + width + 1;
            let (done, rest) = self.entries.split_at_mut(begin);
            let row = &mut rest[..=width];
            for column in 0..width {
                let j = i - width + column;
                let above = &done[self.start[j]..self.start[j + 1]];
                let shared = column.min(above.len() - 1);
                let known =
                    dot(&row[column - shared..column], &above[above.len() - 1 - shared..above.len() - 1]);
                row[column] = (noise.r[place * m + places[j]] - known) / above[above.len() - 1];
            }
            let variance = noise.r[place * m + place];
            let pivot = variance - dot(&row[..width], &row[..width]);
            if pivot.is_nan() || pivot <= m as f64 * f64::EPSILON * variance {
                return false;
            }
            row[width] = pivot.sqrt();
        }
        true
    }

    /// v ← L⁻¹ v.
    pub fn apply(&self, v: &mut [f64]) {
        for i in 0..v.len() {
            let (coupling, scale) = split(self.row(i));
            let known = dot(coupling, &v[i - coupling.len()..i]);
            v[i] = (v[i] - known) / scale;
        }
    }

    /// As [`Whitening::apply`], to the bit, for several runs.
    #[inline(always)]
    pub fn apply_lanes(&self, v: &mut [Lane]) {
        for i in 0..v.len() {
            let (coupling, scale) = split(self.row(i));
            let known = lanes::dot(coupling, &v[i - coupling.len()..i]);
            v[i] = lanes::zip(&v[i], &known, |v, known| (v - known) / scale);
        }
    }

    /// C ← L⁻¹ C, C (rows, n) row-major.
    pub fn apply_to_rows(&self, c: &mut [f64], n: usize) {
        for i in 0..c.len() / n {
            let (coupling, scale) = split(self.row(i));
            let (done, rest) = c.split_at_mut(i * n);
            let row = &mut rest[..n];
            for (l, other) in coupling.iter().zip(done[(i - coupling.len()) * n..].chunks_exact(n)) {
                axpy(-l, other, row);
            }
            let inverse = 1.0 / scale;
            row.iter_mut().for_each(|value| *value *= inverse);
        }
    }

    /// L_il for the columns l < `from`, and the first such l: by these the whitened rows before `from` tell of row i.
    #[must_use]
    pub fn coupling(&self, i: usize, from: usize) -> (usize, &[f64]) {
        let row = self.row(i);
        let first = i + 1 - row.len();
        (first.min(from), &row[..from.saturating_sub(first)])
    }

    /// Covariance of the noise of rows i ≥ j, given that of all rows before `from`.
    #[must_use]
    pub fn covariance_given(&self, from: usize, i: usize, j: usize) -> f64 {
        let (a, b) = (self.row_from(from, i), self.row_from(from, j));
        let reach = a.len().saturating_sub(i - j);
        let shared = reach.min(b.len());
        dot(&a[reach - shared..reach], &b[b.len() - shared..])
    }

    /// Row i of L without what lies before column `from`.
    fn row_from(&self, from: usize, i: usize) -> &[f64] {
        let row = self.row(i);
        &row[row.len() - row.len().min(i + 1 - from)..]
    }

    /// log det L of the first `rows` rows.
    #[must_use]
    pub fn log_det(&self, rows: usize) -> f64 {
        let mut product = LogProduct::default();
        (0..rows).for_each(|i| product.multiply(split(self.row(i)).1));
        product.log()
    }
}

/// A row of L without its diagonal, and the diagonal.
fn split(row: &[f64]) -> (&[f64], f64) {
    let (diagonal, coupling) = row.split_last().unwrap_or((&1.0, &[]));
    (coupling, *diagonal)
}

/// The logarithm of a product of positive numbers, with one logarithm for many factors.
#[derive(Debug, Clone)]
pub struct LogProduct {
    product: f64,
    log: f64,
}

impl Default for LogProduct {
    fn default() -> Self {
        Self { product: 1.0, log: 0.0 }
    }
}

impl LogProduct {
    /// Take in one more factor.
    pub fn multiply(&mut self, factor: f64) {
        const SAFE: std::ops::Range<f64> = 1e-100..1e100;
        if !SAFE.contains(&factor) {
            self.log += factor.ln();
            return;
        }
        self.product *= factor;
        if !SAFE.contains(&self.product) {
            self.log += self.product.ln();
            self.product = 1.0;
        }
    }

    /// The logarithm of all factors so far.
    #[must_use]
    pub fn log(&self) -> f64 {
        self.log + self.product.ln()
    }
}
