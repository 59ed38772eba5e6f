//! Covariance intersection: weights that need no cross-covariance.
//!
//! ```text
//!     P = (Σ ω_i P_i⁻¹)⁻¹,  G_i = ω_i P P_i⁻¹,  ω ≥ 0 of sum 1 minimises tr P
//!     ω_i ← ω_i √tr(P P_i⁻¹ P), then scaled to sum 1:  tr P never grows
//! ```
//!
//! # References
//! Julier, Uhlmann 1997. The iteration is that of A-optimal designs (Torsney 1983).

use crate::linalg::{cholesky, cholesky_solve, dot};
use crate::matrix::Matrix;

/// Steps of the search for ω; the largest change after which it ends.
const SEARCH: usize = 500;
const CLOSE: f64 = 1e-9;

/// Room for the search.
#[derive(Debug, Clone)]
pub struct Intersection {
    n: usize,
    count: usize,
    share: Vec<f64>,
    /// P_i⁻¹ side by side, (n, n r).
    information: Matrix,
    p: Matrix,
    factor: Matrix,
}

impl Intersection {
    /// Room for `count` local estimates of n states.
    #[must_use]
    pub fn new(n: usize, count: usize) -> Self {
        Self {
            n,
            count,
            share: vec![0.0; count],
            information: Matrix::zeros(n, n * count),
            p: Matrix::zeros(n, n),
            factor: Matrix::zeros(n, n),
        }
    }

    /// [G_1 … G_r] for the diagonal blocks of Σ; false if one of them is no covariance.
    pub fn weigh(&mut self, sigma: &Matrix, weights: &mut Matrix) -> bool {
        let n = self.n;
        for i in 0..self.count {
            for a in 0..n {
                self.factor.row_mut(a).copy_from_slice(&sigma.row(i * n + a)[i * n..(i + 1) * n]);
            }
            if !invert(&mut self.factor, &mut self.p) {
                weights.set_zero();
                return false;
            }
            (0..n).for_each(|a| {
                self.information.row_mut(a)[i * n..(i + 1) * n].copy_from_slice(self.p.row(a));
            });
        }
        self.share.fill(1.0 / self.count as f64);
        let mut sound = true;
        for _ in 0..SEARCH {
            sound &= self.combine(weights);
            if self.improve(weights) <= CLOSE {
                break;
            }
        }
        sound && self.combine(weights)
    }

    /// P and G_i of the present ω.
    fn combine(&mut self, weights: &mut Matrix) -> bool {
        let n = self.n;
        self.factor.set_zero();
        for (i, &share) in self.share.iter().enumerate() {
            for a in 0..n {
                let part = &self.information.row(a)[i * n..(i + 1) * n];
                crate::linalg::axpy(share, part, self.factor.row_mut(a));
            }
        }
        let sound = invert(&mut self.factor, &mut self.p);
        weights.set_product(&self.p, &self.information);
        for a in 0..n {
            for (part, &share) in weights.row_mut(a).chunks_exact_mut(n).zip(&self.share) {
                part.iter_mut().for_each(|g| *g *= share);
            }
        }
        sound
    }

    /// One step of ω; returns its largest change. tr(P P_i⁻¹ P) = tr(G_i P) / ω_i.
    fn improve(&mut self, weights: &Matrix) -> f64 {
        let n = self.n;
        let moved = |i: usize, share: f64| {
            let part = |a: usize| dot(&weights.row(a)[i * n..(i + 1) * n], self.p.row(a));
            (share * (0..n).map(part).sum::<f64>().max(0.0)).sqrt()
        };
        let total: f64 = self.share.iter().enumerate().map(|(i, &share)| moved(i, share)).sum();
        let mut change: f64 = 0.0;
        for i in 0..self.count {
            let next = moved(i, self.share[i]) / total;
            change = change.max((next - self.share[i]).abs());
            self.share[i] = next;
        }
        change
    }
}

/// `out` = A⁻¹ of a covariance A, which is destroyed; false if it is none.
fn invert(a: &mut Matrix, out: &mut Matrix) -> bool {
    let n = a.rows();
    out.set_identity(n);
    if cholesky(a.numbers_mut(), n, n, 0.0).is_err() {
        return false;
    }
    (0..n).for_each(|i| cholesky_solve(a.numbers(), n, out.row_mut(i)));
    true
}
