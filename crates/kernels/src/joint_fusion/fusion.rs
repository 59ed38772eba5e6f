//! The fused estimate x̂_0 = Σ G_i x̂_i with Σ G_i = I, (8).
//!
//! ```text
//!     optimal   G minimises tr P_0: regression of the error e_1 on the differences e_i − e_1,
//!               the same as (12), (HᵀΣ⁻¹H)⁻¹HᵀΣ⁻¹, but for any Σ, also one that has no inverse
//!     average   G_i = I / r
//!     covariance intersection   G_i = ω_i P P_i⁻¹, P = (Σ ω_i P_i⁻¹)⁻¹, ω ≥ 0 of sum 1 minimises tr P;
//!               the mean if a P_i has no inverse, as when a state is known exactly
//!     P_0 = Σ_ij G_i P_ij G_jᵀ for every rule
//! ```
//!
//! # References
//! Chen, Weng, Ho, Yu 2022, (8), (12), (13). Julier, Uhlmann 1997 (covariance intersection).

use crate::joint_fusion::gains::Gains;
use crate::joint_fusion::intersection::Intersection;
use crate::joint_fusion::semidefinite::Semidefinite;
use crate::matrix::Matrix;

/// A difference between two local estimates whose variance is this small beside theirs is zero.
///
/// With more of them the weights grow: at 1e-10 they reach some thousands, and P_0 keeps nine digits.
const SAME: f64 = 1e-10;

/// How local estimates are put together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// Least variance, (12).
    Optimal,
    /// Their mean.
    Average,
    /// Least trace without cross-covariances.
    CovarianceIntersection,
}

/// Σ = {P_ij} and room for its factors.
#[derive(Debug, Clone)]
pub struct Fusion {
    rule: Rule,
    n: usize,
    count: usize,
    /// Σ, (n r, n r).
    pub sigma: Matrix,
    differences: Semidefinite,
    intersection: Intersection,
    scratch: Matrix,
}

impl Fusion {
    /// Room for `count` local estimates of n states.
    #[must_use]
    pub fn new(rule: Rule, n: usize, count: usize) -> Self {
        let size = n * count;
        Self {
            rule,
            n,
            count,
            sigma: Matrix::zeros(size, size),
            differences: Semidefinite::new(size),
            intersection: Intersection::new(n, count),
            scratch: Matrix::room(n * size),
        }
    }

    /// Note P_ij = the upper left part of M_ij, and P_ji.
    pub fn put(&mut self, (i, j): (usize, usize), moments: &Matrix) {
        let n = self.n;
        for a in 0..n {
            for (b, &value) in moments.row(a)[..n].iter().enumerate() {
                self.sigma[(i * n + a, j * n + b)] = value;
                self.sigma[(j * n + b, i * n + a)] = value;
            }
        }
    }

    /// Weights and covariance of the fused estimate; broken if Σ is no covariance.
    pub fn fuse(&mut self, gains: &mut Gains) {
        let (n, count) = (self.n, self.count);
        let mut sound = true;
        match self.rule {
            _ if count == 1 => gains.weights.set_identity(n),
            Rule::Average => self.average(&mut gains.weights),
            Rule::Optimal => sound = self.regress(&mut gains.weights),
            Rule::CovarianceIntersection => {
                if !self.intersection.weigh(&self.sigma, &mut gains.weights) {
                    self.average(&mut gains.weights);
                }
            }
        }
        let half = &mut self.scratch;
        half.set_product(&gains.weights, &self.sigma);
        gains.covariance.set_product_transposed(half, &gains.weights);
        gains.covariance.symmetrise();
        for (i, deviation) in gains.x_std.iter_mut().enumerate() {
            sound &= gains.covariance[(i, i)] >= 0.0;
            *deviation = gains.covariance[(i, i)].max(0.0).sqrt();
        }
        gains.broken |= !sound || !gains.covariance.is_finite() || !gains.weights.is_finite();
    }

    fn average(&self, weights: &mut Matrix) {
        weights.shape(self.n, self.n * self.count);
        let share = 1.0 / self.count as f64;
        for i in 0..self.count {
            (0..self.n).for_each(|a| weights[(a, i * self.n + a)] = share);
        }
    }

    /// G_i = −Cov(e_1, e_i − e_1) D⁺ for i > 1 and G_1 = I − Σ G_i, with D the covariance of all differences.
    fn regress(&mut self, weights: &mut Matrix) -> bool {
        let (n, size) = (self.n, self.n * (self.count - 1));
        let (sigma, d) = (&self.sigma, &mut self.differences);
        d.a.shape(size, size);
        for a in 0..size {
            for b in 0..size {
                d.a[(a, b)] = sigma[(n + a, n + b)] - sigma[(n + a, b % n)] - sigma[(a % n, n + b)]
                    + sigma[(a % n, b % n)];
            }
            let both = sigma[(n + a, n + a)].abs() + sigma[(a % n, a % n)].abs();
            d.scale[a] = both.max(f64::MIN_POSITIVE).sqrt();
        }
        let sound = d.factor(SAME);
        let row = &mut self.scratch;
        weights.shape(n, n * self.count);
        for a in 0..n {
            row.shape(1, size);
            for b in 0..size {
                row[(0, b)] = sigma[(a, b % n)] - sigma[(a, n + b)];
            }
            d.solve(row.row_mut(0));
            weights.row_mut(a)[n..].copy_from_slice(row.row(0));
            weights[(a, a)] = 1.0;
            for b in 0..size {
                weights[(a, b % n)] -= row[(0, b)];
            }
        }
        sound
    }
}
