//! The information filter about a square root of the prior: what a belief becomes when channels count with precisions.
//!
//! With P⁻ = L Lᵀ, whitened channels y = C x + v, Var v = I, and Λ the precisions given to them:
//!
//! ```text
//!     Z = C L,   J = I + Zᵀ Λ Z = Uᵀ U,   W = Z U⁻¹
//!     x = x⁻ + L U⁻¹ Wᵀ η,   P = (L U⁻¹)(L U⁻¹)ᵀ,   C P Cᵀ = W Wᵀ,   det(I + Zᵀ Λ Z) = det(U)²
//! ```
//!
//! No matrix is inverted but U, whose pivots are at least 1: a P⁻ that is singular is as good as another. One that is
//! larger than R by 10^d, in units of C x, costs d digits in the directions that the channels do not see.

use crate::dense::{self, Arithmetic, add_gram, eliminate, multiply};
use crate::kalman::ud::Ud;
use crate::linalg::{axpy, dot};

/// A prior, the channels seen through it, and the latest precisions.
#[derive(Debug, Clone)]
pub struct Information {
    arithmetic: Arithmetic,
    n: usize,
    /// Channels heard.
    count: usize,
    /// L (n, n) by rows, and its transpose.
    root: Vec<f64>,
    root_t: Vec<f64>,
    /// Cᵀ (n, count) by rows.
    c_t: Vec<f64>,
    /// Z by rows, (count, n).
    z: Vec<f64>,
    /// Zᵀ by rows, (n, count).
    z_t: Vec<f64>,
    /// Λ½ Z by rows, only those that are not zero.
    scaled: Vec<f64>,
    /// Numbers of `scaled` in use.
    used: usize,
    /// [J | Zᵀ], then [U | Wᵀ], (n, n + count); or [J | Zᵀ η, Lᵀ].
    work: Vec<f64>,
}

impl Information {
    /// Room for n states and m channels.
    #[must_use]
    pub fn new(arithmetic: Arithmetic, n: usize, m: usize) -> Self {
        Self {
            arithmetic,
            n,
            count: 0,
            root: vec![0.0; n * n],
            root_t: vec![0.0; n * n],
            c_t: vec![0.0; n * m],
            z: vec![0.0; m * n],
            z_t: vec![0.0; n * m],
            scaled: vec![0.0; m * n],
            used: 0,
            work: vec![0.0; n * (n + m.max(n + 1))],
        }
    }

    /// Take a prior and the whitened rows of C that arrived, (count, n).
    #[inline(always)]
    pub fn see(&mut self, prior: &Ud, rows: &[f64]) {
        let n = self.n;
        self.count = rows.len() / n;
        for (j, row) in self.root_t.chunks_exact_mut(n).enumerate() {
            let deviation = prior.d[j].sqrt(); // L = U √D
            for (target, u) in row[..j].iter_mut().zip(prior.column(j)) {
                *target = deviation * u;
            }
            row[j] = deviation;
            row[j + 1..].fill(0.0);
        }
        dense::transpose(&self.root_t, n, &mut self.root);
        let z_t = &mut self.z_t[..n * self.count];
        let c_t = &mut self.c_t[..n * self.count];
        dense::transpose(rows, n, c_t);
        multiply(self.arithmetic, &self.root, n, c_t, self.count, z_t); // Zᵀ = Lᵀ Cᵀ
        dense::transpose(z_t, self.count, &mut self.z[..n * self.count]);
    }

    /// Number of channels heard.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Length of x.
    #[must_use]
    pub fn states(&self) -> usize {
        self.n
    }

    /// Row i of Z.
    #[inline(always)]
    #[must_use]
    pub fn z(&self, i: usize) -> &[f64] {
        &self.z[i * self.n..(i + 1) * self.n]
    }

    /// Forget all precisions.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.used = 0;
    }

    /// Give channel i the precision factor².
    #[inline(always)]
    pub fn weigh(&mut self, factor: f64, i: usize) {
        if factor != 0.0 {
            let row = &self.z[i * self.n..(i + 1) * self.n];
            let target = &mut self.scaled[self.used..self.used + self.n];
            target.iter_mut().zip(row).for_each(|(target, z)| *target = factor * z);
            self.used += self.n;
        }
    }

    /// Give the channels from `first` on the precision f fᵀ.
    #[inline(always)]
    pub fn weigh_jointly(&mut self, f: &[f64], first: usize) {
        let n = self.n;
        let target = &mut self.scaled[self.used..self.used + n];
        target.fill(0.0);
        for (offset, &factor) in f.iter().enumerate() {
            axpy(factor, &self.z[(first + offset) * n..(first + offset + 1) * n], target);
        }
        self.used += n;
    }

    /// [J | ·] with rows of length n + extra.
    #[inline(always)]
    fn set_up(&mut self, extra: usize) {
        let (n, width) = (self.n, self.n + extra);
        for (i, row) in self.work[..n * width].chunks_exact_mut(width).enumerate() {
            row[..n].fill(0.0);
            row[i] = 1.0;
        }
        add_gram(self.arithmetic, &self.scaled[..self.used], n, &mut self.work, width);
    }

    /// U and W for the precisions given.
    #[inline(always)]
    pub fn update(&mut self) {
        let (n, count) = (self.n, self.count);
        self.set_up(count);
        for (j, row) in self.work[..n * (n + count)].chunks_exact_mut(n + count).enumerate() {
            row[n..].copy_from_slice(&self.z_t[j * count..(j + 1) * count]);
        }
        eliminate(self.arithmetic, &mut self.work[..n * (n + count)], n, n + count);
    }

    /// Wᵀ by rows, (n, count).
    #[inline(always)]
    pub fn w_t(&self) -> impl Iterator<Item = &[f64]> {
        let (n, width) = (self.n, self.n + self.count);
        self.work[..n * width].chunks_exact(width).map(move |row| &row[n..])
    }

    /// `out` = W Wᵀ η, where the channels now are about where they were, and the diagonal of W Wᵀ.
    #[inline(always)]
    pub fn expect(&mut self, eta: &[f64], shift: &mut [f64], variance: &mut [f64]) {
        shift.fill(0.0);
        variance.fill(0.0);
        let (n, width) = (self.n, self.n + self.count);
        for row in self.work[..n * width].chunks_exact(width) {
            let w = &row[n..];
            let t = dot(w, eta);
            for ((shift, variance), &w) in shift.iter_mut().zip(variance.iter_mut()).zip(w) {
                *shift += t * w;
                *variance += w * w;
            }
        }
    }

    /// log det(I + Zᵀ Λ Z) / 2 and |Wᵀ η|² / 2 after [`Information::update`].
    #[must_use]
    pub fn evidence(&self, eta: &[f64]) -> (f64, f64) {
        let (n, width) = (self.n, self.n + self.count);
        let rows = self.work[..n * width].chunks_exact(width).enumerate();
        rows.fold((0.0, 0.0), |(log, square), (j, row)| {
            let t = dot(&row[n..], eta);
            (log + row[j].ln(), square + 0.5 * t * t)
        })
    }

    /// The posterior for the precisions given: its root (L U⁻¹)ᵀ (n, n) by rows, and x − x⁻.
    #[inline(always)]
    pub fn conclude(&mut self, eta: &[f64], root: &mut [f64], shift: &mut [f64]) {
        let (n, width) = (self.n, 2 * self.n + 1);
        self.set_up(n + 1);
        let rows = self.work[..n * width].chunks_exact_mut(width);
        for (i, (row, from)) in rows.zip(self.root_t.chunks_exact(n)).enumerate() {
            row[n] = dot(&self.z_t[i * self.count..(i + 1) * self.count], eta);
            row[n + 1..].copy_from_slice(from);
        }
        eliminate(self.arithmetic, &mut self.work[..n * width], n, width);
        shift.fill(0.0);
        let rows = self.work[..n * width].chunks_exact(width);
        for (row, root) in rows.zip(root.chunks_exact_mut(n)) {
            root.copy_from_slice(&row[n + 1..]);
            axpy(row[n], root, shift); // L U⁻¹ Wᵀ η
        }
    }
}
