//! The covariances P_i of the honest component as the mixture needs them: factors of their inverses, and log det P_i.

use crate::kalman::ud::Ud;
use crate::kalman::whitening::LogProduct;
use crate::linalg::dot;

/// Share of its variance below which what others say of a state leaves it no more certain.
const SINGULAR: f64 = 1e-12;

/// One covariance per sensor.
#[derive(Debug, Clone)]
pub struct Known {
    n: usize,
    /// W_i = D^(−1/2) U⁻¹ with P_i = U D Uᵀ, upper triangular by rows, so that P_i⁻¹ = W_iᵀ W_i, (N, n, n).
    root: Vec<f64>,
    /// log det P_i, (N,).
    log_det: Vec<f64>,
    /// diag P_i, (N, n).
    variance: Vec<f64>,
    /// P_i⁻¹, (N, n, n); empty if nobody asks for it.
    precision: Vec<f64>,
}

impl Known {
    /// Room for `sensors` covariances of `n` states.
    #[must_use]
    pub fn new(sensors: usize, n: usize, precision: bool) -> Self {
        Self {
            n,
            root: vec![0.0; sensors * n * n],
            log_det: vec![0.0; sensors],
            variance: vec![0.0; sensors * n],
            precision: vec![0.0; if precision { sensors * n * n } else { 0 }],
        }
    }

    /// Take in P_i. A pivot below 1e-12 of its variance is that large: the inverse exists even if P_i is singular.
    pub fn set(&mut self, i: usize, p: &Ud) {
        let n = self.n;
        let variance = &mut self.variance[i * n..(i + 1) * n];
        p.variances(variance);
        let root = &mut self.root[i * n * n..(i + 1) * n * n];
        let mut product = LogProduct::default();
        for j in 0..n {
            root[j * n + j] = 1.0;
            for row in (0..j).rev() {
                let known: f64 = (row + 1..=j).map(|l| p.u[l * n + row] * root[l * n + j]).sum();
                root[row * n + j] = -known;
            }
        }
        for (j, row) in root.chunks_exact_mut(n).enumerate() {
            let least = SINGULAR * if variance[j] > 0.0 { variance[j] } else { 1.0 };
            let pivot = p.d[j].max(least);
            product.multiply(pivot);
            let scale = 1.0 / pivot.sqrt();
            row[j..].iter_mut().for_each(|value| *value *= scale);
        }
        self.log_det[i] = product.log();
        if !self.precision.is_empty() {
            square(root, n, &mut self.precision[i * n * n..(i + 1) * n * n]);
        }
    }

    /// Take P_i from `other`, without allocation.
    pub fn copy_one(&mut self, i: usize, other: &Self) {
        let (n, square) = (self.n, i * self.n * self.n..(i + 1) * self.n * self.n);
        self.root[square.clone()].copy_from_slice(&other.root[square.clone()]);
        self.log_det[i] = other.log_det[i];
        self.variance[i * n..(i + 1) * n].copy_from_slice(&other.variance[i * n..(i + 1) * n]);
        if !self.precision.is_empty() {
            self.precision[square.clone()].copy_from_slice(&other.precision[square]);
        }
    }

    /// log det P_i.
    #[must_use]
    pub fn log_det(&self, i: usize) -> f64 {
        self.log_det[i]
    }

    /// diag P_i.
    #[must_use]
    pub fn variance(&self, i: usize) -> &[f64] {
        &self.variance[i * self.n..(i + 1) * self.n]
    }

    /// P_i⁻¹ by rows, if it was asked for.
    #[must_use]
    pub fn precision(&self, i: usize) -> &[f64] {
        let size = self.n * self.n;
        &self.precision[i * size..(i + 1) * size]
    }

    /// dᵀ P_i⁻¹ d
    #[must_use]
    pub fn distance(&self, i: usize, d: &[f64]) -> f64 {
        if let [value] = d {
            let part = self.root[i] * value;
            return part * part;
        }
        let n = self.n;
        let root = self.root[i * n * n..(i + 1) * n * n].chunks_exact(n);
        root.enumerate().map(|(j, row)| dot(&row[j..], &d[j..])).map(|part| part * part).sum()
    }
}

/// `out` = Wᵀ W, W (n, n) upper triangular.
fn square(w: &[f64], n: usize, out: &mut [f64]) {
    for a in 0..n {
        for b in 0..n {
            out[a * n + b] = (0..=a.min(b)).map(|i| w[i * n + a] * w[i * n + b]).sum();
        }
    }
}
