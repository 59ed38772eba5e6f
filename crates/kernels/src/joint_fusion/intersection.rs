//! Covariance intersection: weights that need no cross-covariance.
//!
//! ```text
//!     P = (Σ ω_i P_i⁻¹)⁻¹,  G_i = ω_i P P_i⁻¹,  ω ≥ 0 of sum 1 minimises f = tr P, which is convex in ω
//!     −∂f/∂ω_i = tr M_i,   ∂²f/∂ω_i∂ω_j = 2 tr(M_i P_j⁻¹ P),   M_i = P P_i⁻¹ P,   Σ ω_i tr M_i = f
//!     optimal   if and only if tr M_i ≤ f for all i; f exceeds the least by no more than max tr M_i − f
//! ```
//!
//! Newton's method on the ω_i that are above zero or want to be, each step as far as ω stays ≥ 0 and f falls.
//!
//! # References
//! Julier, Uhlmann 1997.

use crate::linalg::{axpy, cholesky, cholesky_solve, dot};
use crate::matrix::Matrix;

/// Steps of the search for ω, and how often a step is halved.
const SEARCH: usize = 50;
const HALVINGS: usize = 30;
/// Relative excess over the least trace at which the search ends.
const CLOSE: f64 = 1e-14;
/// Added to the second derivatives, relative to their mean: two locals may know the same.
const RIDGE: f64 = 1e-12;

/// Room for the search.
#[derive(Debug, Clone)]
pub struct Intersection {
    n: usize,
    count: usize,
    share: Vec<f64>,
    trial: Vec<f64>,
    /// −∂f/∂ω.
    slope: Vec<f64>,
    free: Vec<bool>,
    step: Vec<f64>,
    ones: Vec<f64>,
    /// P_i⁻¹ side by side, (n, n r).
    information: Matrix,
    /// P P_i⁻¹ side by side.
    half: Matrix,
    /// M_i side by side.
    turned: Matrix,
    curvature: Matrix,
    system: Matrix,
    p: Matrix,
    factor: Matrix,
}

impl Intersection {
    /// Room for `count` local estimates of n states.
    #[must_use]
    pub fn new(n: usize, count: usize) -> Self {
        let wide = || Matrix::zeros(n, n * count);
        let (vector, square) = (|| vec![0.0; count], || Matrix::zeros(n, n));
        Self {
            n,
            count,
            share: vector(),
            trial: vector(),
            slope: vector(),
            free: vec![true; count],
            step: vector(),
            ones: vector(),
            information: wide(),
            half: wide(),
            turned: wide(),
            curvature: Matrix::zeros(count, count),
            system: Matrix::zeros(count, count),
            p: square(),
            factor: square(),
        }
    }

    /// [G_1 … G_r] for the diagonal blocks of Σ; false if one of them has no inverse.
    pub fn weigh(&mut self, sigma: &Matrix, weights: &mut Matrix) -> bool {
        let n = self.n;
        weights.set_zero();
        for i in 0..self.count {
            for a in 0..n {
                self.factor.row_mut(a).copy_from_slice(&sigma.row(i * n + a)[i * n..(i + 1) * n]);
            }
            if !invert(&mut self.factor, &mut self.p) {
                return false;
            }
            (0..n).for_each(|a| {
                self.information.row_mut(a)[i * n..(i + 1) * n].copy_from_slice(self.p.row(a));
            });
        }
        self.trial.fill(1.0 / self.count as f64);
        let mut least = self.mix();
        for _ in 0..SEARCH {
            self.share.copy_from_slice(&self.trial);
            match least.and_then(|value| self.improve(value)) {
                Some(value) => least = Some(value),
                None => break,
            }
        }
        self.trial.copy_from_slice(&self.share);
        if self.mix().is_none() {
            return false;
        }
        weights.set_product(&self.p, &self.information);
        for a in 0..n {
            for (part, &share) in weights.row_mut(a).chunks_exact_mut(n).zip(&self.share) {
                part.iter_mut().for_each(|g| *g *= share);
            }
        }
        true
    }

    /// P of `trial` and its trace; None if that is no covariance.
    fn mix(&mut self) -> Option<f64> {
        let n = self.n;
        self.factor.set_zero();
        for (i, &share) in self.trial.iter().enumerate() {
            for a in 0..n {
                axpy(share, &self.information.row(a)[i * n..(i + 1) * n], self.factor.row_mut(a));
            }
        }
        invert(&mut self.factor, &mut self.p).then(|| (0..n).map(|a| self.p[(a, a)]).sum())
    }

    /// From `share`, with P and its trace `value`, to a better `trial`; None if there is none.
    fn improve(&mut self, value: f64) -> Option<f64> {
        self.differentiate();
        let largest = self.slope.iter().fold(0.0, |largest: f64, &slope| largest.max(slope));
        if largest - value <= CLOSE * value {
            return None;
        }
        for i in 0..self.count {
            self.free[i] = self.share[i] > 0.0 || self.slope[i] > value;
        }
        while !self.aim() {}
        let room = self.share.iter().zip(&self.step).filter(|(_, step)| **step < 0.0);
        let room = room.fold(f64::INFINITY, |room: f64, (share, step)| room.min(-share / step));
        let mut length = room.min(1.0);
        for _ in 0..HALVINGS {
            let ends = length == room;
            for i in 0..self.count {
                let (share, step) = (self.share[i], self.step[i]);
                let stays = !(ends && step < 0.0 && -share / step == room);
                self.trial[i] = if stays { (share + length * step).max(0.0) } else { 0.0 };
            }
            let total: f64 = self.trial.iter().sum();
            self.trial.iter_mut().for_each(|share| *share /= total);
            if let Some(better) = self.mix().filter(|&better| better < value) {
                return Some(better);
            }
            length /= 2.0;
        }
        None
    }

    /// First and second derivatives at P.
    fn differentiate(&mut self) {
        let n = self.n;
        self.half.set_product(&self.p, &self.information);
        for i in 0..self.count {
            let part = i * n..(i + 1) * n;
            for a in 0..n {
                for b in 0..n {
                    self.turned[(a, i * n + b)] = dot(&self.half.row(a)[part.clone()], self.p.row(b));
                }
            }
            self.slope[i] = (0..n).map(|a| self.turned[(a, i * n + a)]).sum();
        }
        for i in 0..self.count {
            for j in 0..self.count {
                let (own, other) = (i * n..(i + 1) * n, j * n..(j + 1) * n);
                let rows =
                    (0..n).map(|a| dot(&self.turned.row(a)[own.clone()], &self.half.row(a)[other.clone()]));
                self.curvature[(i, j)] = 2.0 * rows.sum::<f64>();
            }
        }
    }

    /// Newton's step of sum 0 within the free ω; false if one of them at zero would fall, which is free no more.
    fn aim(&mut self) -> bool {
        let count = self.count;
        let mean = (0..count).map(|i| self.curvature[(i, i)]).sum::<f64>() / count as f64;
        let h = &mut self.system;
        for i in 0..count {
            for j in 0..count {
                let apart = if i == j { 1.0 } else { 0.0 };
                let both = self.free[i] && self.free[j];
                h[(i, j)] = if both { self.curvature[(i, j)] + RIDGE * mean * apart } else { mean * apart };
            }
            self.step[i] = if self.free[i] { self.slope[i] } else { 0.0 };
            self.ones[i] = f64::from(u8::from(self.free[i]));
        }
        if cholesky(h.numbers_mut(), count, count, 0.0).is_err() {
            self.step.fill(0.0);
            return true;
        }
        cholesky_solve(h.numbers(), count, &mut self.step);
        cholesky_solve(h.numbers(), count, &mut self.ones);
        let multiplier = self.step.iter().sum::<f64>() / self.ones.iter().sum::<f64>();
        axpy(-multiplier, &self.ones, &mut self.step);
        let falls = |i: &usize| self.free[*i] && self.share[*i] == 0.0 && self.step[*i] < 0.0;
        let Some(first) = (0..count).find(falls) else { return true };
        self.free[first] = false;
        false
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
