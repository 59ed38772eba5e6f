//! The reduced problem of sparse fusion and its exact duality gap, shared by both solvers.
//!
//! `min ½ gᵀH g − νᵀ₀ g + Σ_j γ_j ‖g_j‖₂` over groups j; a group of one element makes it a LASSO. γ_j = 0 frees
//! a group. It is problem (31) of Liu, Mo, Garone 2020 after x and φ have been eliminated.

use crate::linalg::{axpy, dot, norm};

/// Data of one problem. H is symmetric, positive semidefinite, with diagonal blocks diag(λ) per group.
#[derive(Debug, Clone, Copy)]
pub struct Problem<'a> {
    /// H, (d, d).
    pub hessian: &'a [f64],
    /// ν₀, (d,).
    pub linear: &'a [f64],
    /// First element of every group, and d at the end.
    pub starts: &'a [usize],
    /// γ per group; 0 = free.
    pub gamma: &'a [f64],
    /// q = ζᵀ N ζ, twice the cost of g = 0: makes the gap absolute.
    pub energy: f64,
}

/// How a solve ended.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Outcome {
    /// Linear systems solved and sweeps made.
    pub iterations: usize,
    /// Duality gap relative to max(1, cost).
    pub gap: f64,
}

/// A relative gap up to this is a solution.
pub const SOLVED: f64 = 1e-9;

impl Problem<'_> {
    /// d, number of elements.
    #[must_use]
    pub fn len(&self) -> usize {
        self.linear.len()
    }

    /// Whether there is nothing to solve for.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.linear.is_empty()
    }

    /// Number of groups.
    #[must_use]
    pub fn groups(&self) -> usize {
        self.gamma.len()
    }

    /// Elements of group j.
    #[must_use]
    pub fn range(&self, j: usize) -> std::ops::Range<usize> {
        self.starts[j]..self.starts[j + 1]
    }

    /// Row i of H.
    #[must_use]
    pub fn row(&self, i: usize) -> &[f64] {
        &self.hessian[i * self.len()..(i + 1) * self.len()]
    }

    /// Whether g = 0 is the solution: every dual norm is within its bound (the event of Theorem 3).
    #[must_use]
    pub fn zero_is_optimal(&self) -> bool {
        (0..self.groups()).all(|j| norm(&self.linear[self.range(j)]) <= self.gamma[j])
    }

    /// ν = ν₀ − H g.
    pub fn residual(&self, g: &[f64], nu: &mut [f64]) {
        nu.copy_from_slice(self.linear);
        for (i, &value) in g.iter().enumerate() {
            if value != 0.0 {
                axpy(-value, self.row(i), nu);
            }
        }
    }

    /// Exact duality gap at g with ν = ν₀ − H g, relative to max(1, cost).
    ///
    /// The dual point is α ν with α = min(1, min γ_j / ‖ν_j‖) over the penalised groups. With e = q − gᵀ(ν₀ + ν),
    /// gap = ½ e (1 − α)² + Σ (γ_j ‖g_j‖ − α ν_jᵀ g_j), which has no large terms that cancel. Free groups are
    /// eliminated: a dual point has ν_j = 0 there, and what is left of ν_j costs ½ ‖ν_j‖² / λ.
    #[must_use]
    pub fn relative_gap(&self, g: &[f64], nu: &[f64]) -> f64 {
        let mut alpha = 1.0_f64;
        for j in 0..self.groups() {
            let size = norm(&nu[self.range(j)]);
            if self.gamma[j] > 0.0 && size > self.gamma[j] {
                alpha = alpha.min(self.gamma[j] / size);
            }
        }
        let (mut penalty, mut slack) = (0.0, 0.0);
        for j in 0..self.groups() {
            let (gj, nuj) = (&g[self.range(j)], &nu[self.range(j)]);
            if self.gamma[j] == 0.0 {
                let lambda = self.range(j).map(|i| self.row(i)[i]).fold(0.0, f64::max);
                slack += 0.5 * dot(nuj, nuj) / lambda.max(f64::MIN_POSITIVE);
                continue;
            }
            let term = self.gamma[j] * norm(gj);
            penalty += term;
            slack += term - alpha * dot(nuj, gj);
        }
        let energy = (self.energy - dot(g, self.linear) - dot(g, nu)).max(0.0);
        let gap = 0.5 * energy * (1.0 - alpha) * (1.0 - alpha) + slack;
        gap.abs() / (0.5 * energy + penalty).max(1.0)
    }
}
