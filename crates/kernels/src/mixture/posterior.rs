//! The estimate after the labels are known, and how it moves on.

use crate::dense::{Arithmetic, add_gram, multiply, transpose};
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::mixture::information::Information;

/// P = Fᵀ F with rows of F, and x − x⁻.
#[derive(Debug, Clone)]
pub struct Posterior {
    arithmetic: Arithmetic,
    n: usize,
    /// Rows of F in use.
    rows: usize,
    /// F, (rows, n); room for two labellings and what lies between them.
    root: Vec<f64>,
    /// x − x⁻, (n,).
    pub shift: Vec<f64>,
    other: Vec<f64>,
    turned: Vec<f64>,
    moved: Vec<f64>,
    stack: Vec<f64>,
    weights: Vec<f64>,
    weighted: Vec<f64>,
    product: Vec<f64>,
}

impl Posterior {
    /// Room for a plant.
    #[must_use]
    pub fn new(arithmetic: Arithmetic, model: &Model) -> Self {
        let (n, noise) = (model.dims.states, model.q.len());
        let rows = 2 * n + 1;
        Self {
            arithmetic,
            n,
            rows: n,
            root: vec![0.0; rows * n],
            shift: vec![0.0; n],
            other: vec![0.0; n],
            turned: vec![0.0; rows * n],
            moved: vec![0.0; rows * n],
            stack: vec![0.0; n * (rows + noise)],
            weights: vec![0.0; rows + noise],
            weighted: vec![0.0; rows + noise],
            product: vec![0.0; n * n],
        }
    }

    /// The belief for the sites that `information` holds.
    #[inline(always)]
    pub fn conclude(&mut self, information: &mut Information, eta: &[f64]) {
        self.rows = self.n;
        information.conclude(eta, &mut self.root[..self.n * self.n], &mut self.shift);
    }

    /// Become the belief with this root (n, n).
    #[inline(always)]
    pub fn take(&mut self, root: &[f64]) {
        self.rows = self.n;
        self.root[..self.n * self.n].copy_from_slice(root);
    }

    /// Take in another labelling, whose sites `information` now holds, with the given weight.
    #[inline(always)]
    pub fn merge(&mut self, information: &mut Information, eta: &[f64], weight: f64) -> f64 {
        let n = self.n;
        self.rows = 2 * n + 1;
        let (first, rest) = self.root.split_at_mut(n * n);
        let (second, between) = rest.split_at_mut(n * n);
        information.conclude(eta, second, &mut self.other);
        let (mine, theirs) = ((1.0 - weight).sqrt(), weight.sqrt());
        let mut furthest = 0.0_f64;
        for (i, target) in between.iter_mut().enumerate() {
            let difference = self.other[i] - self.shift[i];
            let variance: f64 = first.chunks_exact(n).map(|row| row[i] * row[i]).sum();
            furthest = furthest.max(difference.abs() / variance.sqrt().max(f64::MIN_POSITIVE));
            self.shift[i] += weight * difference;
            *target = mine * theirs * difference;
        }
        first.iter_mut().for_each(|value| *value *= mine);
        second.iter_mut().for_each(|value| *value *= theirs);
        furthest
    }

    /// Deviations of x, and P if wanted.
    #[inline(always)]
    pub fn report(&mut self, deviations: &mut [f64], covariance: Option<&mut [f64]>) {
        let n = self.n;
        deviations.fill(0.0);
        for row in self.root[..self.rows * n].chunks_exact(n) {
            for (variance, value) in deviations.iter_mut().zip(row) {
                *variance += value * value;
            }
        }
        deviations.iter_mut().for_each(|variance| *variance = variance.sqrt());
        let Some(covariance) = covariance else { return };
        self.product.fill(0.0);
        add_gram(self.arithmetic, &self.root[..self.rows * n], n, &mut self.product, n);
        for i in 0..n {
            for j in i..n {
                covariance[i * n + j] = self.product[i * n + j];
                covariance[j * n + i] = self.product[i * n + j];
            }
        }
    }

    /// P[k+1|k] = A P Aᵀ + Q: the rows [A Fᵀ, G], made orthogonal.
    #[inline(always)]
    pub fn predict(&mut self, model: &Model, k: usize, prior: &mut Ud) {
        let (n, rows, noise) = (self.n, self.rows, model.q.len());
        let width = rows + noise;
        let turned = &mut self.turned[..rows * n];
        transpose(&self.root[..rows * n], n, turned);
        let moved = &mut self.moved[..rows * n];
        multiply(self.arithmetic, model.a_t(k), n, turned, rows, moved);
        self.weights[..rows].fill(1.0);
        self.weights[rows..width].copy_from_slice(&model.q);
        let stack = &mut self.stack[..n * width];
        let parts = moved.chunks_exact(rows).zip(model.g.chunks(noise.max(1)));
        if noise == 0 {
            stack.copy_from_slice(moved);
        }
        for (row, (moved, g)) in stack.chunks_exact_mut(width).zip(parts) {
            row[..rows].copy_from_slice(moved);
            row[rows..].copy_from_slice(g);
        }
        prior.orthogonalise(stack, &self.weights[..width], &mut self.weighted[..width]);
    }
}
