//! Positive semidefinite matrices that may have no inverse: Cholesky with complete pivoting on their correlations.

use crate::linalg::axpy;
use crate::matrix::Matrix;

/// A pivot that is this far below zero is no rounding.
const INDEFINITE: f64 = 1e-9;

/// The factor, and the order in which its rows were taken.
#[derive(Debug, Clone)]
pub struct Semidefinite {
    /// The matrix; [`Semidefinite::factor`] replaces it by its factor.
    pub a: Matrix,
    /// What every row is measured in; its square times `tolerance` is zero.
    pub scale: Vec<f64>,
    order: Vec<usize>,
    rank: usize,
    pivot: Vec<f64>,
}

impl Semidefinite {
    /// Room for `size` rows.
    #[must_use]
    pub fn new(size: usize) -> Self {
        Self {
            a: Matrix::room(size * size),
            scale: vec![1.0; size],
            order: vec![0; size],
            rank: 0,
            pivot: vec![0.0; size],
        }
    }

    /// Factorise until what is left is below `tolerance`; false if the matrix is not positive semidefinite.
    pub fn factor(&mut self, tolerance: f64) -> bool {
        let size = self.a.rows();
        for i in 0..size {
            self.order[i] = i;
            for j in 0..size {
                self.a[(i, j)] /= self.scale[i] * self.scale[j];
            }
        }
        self.rank = 0;
        while self.rank < size {
            let t = self.rank;
            let best =
                (t..size).fold(t, |best, i| if self.a[(i, i)] > self.a[(best, best)] { i } else { best });
            let largest = self.a[(best, best)];
            if largest.is_nan() || largest <= tolerance {
                break;
            }
            self.exchange(t, best);
            self.eliminate(t, largest.sqrt());
            self.rank += 1;
        }
        (self.rank..size).all(|i| self.a[(i, i)] >= -INDEFINITE)
    }

    fn exchange(&mut self, i: usize, j: usize) {
        if i == j {
            return;
        }
        self.order.swap(i, j);
        for k in 0..self.a.rows() {
            let (a, b) = (self.a[(k, i)], self.a[(k, j)]);
            (self.a[(k, i)], self.a[(k, j)]) = (b, a);
        }
        for k in 0..self.a.rows() {
            let (a, b) = (self.a[(i, k)], self.a[(j, k)]);
            (self.a[(i, k)], self.a[(j, k)]) = (b, a);
        }
    }

    /// Column t of the factor, and what it explains taken from the rest.
    fn eliminate(&mut self, t: usize, root: f64) {
        let size = self.a.rows();
        self.a[(t, t)] = root;
        for i in t + 1..size {
            self.a[(i, t)] /= root;
            self.pivot[i] = self.a[(i, t)];
        }
        for i in t + 1..size {
            let factor = self.pivot[i];
            axpy(-factor, &self.pivot[t + 1..size], &mut self.a.row_mut(i)[t + 1..]);
        }
    }

    /// x ← A⁺ b on the part that was factorised, 0 elsewhere.
    pub fn solve(&mut self, x: &mut [f64]) {
        for t in 0..self.rank {
            self.pivot[t] = x[self.order[t]] / self.scale[self.order[t]];
        }
        x.fill(0.0);
        for t in 0..self.rank {
            let known: f64 = self.a.row(t)[..t].iter().zip(&self.pivot).map(|(l, y)| l * y).sum();
            self.pivot[t] = (self.pivot[t] - known) / self.a[(t, t)];
        }
        for t in (0..self.rank).rev() {
            let value = self.pivot[t] / self.a[(t, t)];
            axpy(-value, &self.a.row(t)[..t], &mut self.pivot[..t]);
            x[self.order[t]] = value / self.scale[self.order[t]];
        }
    }
}
