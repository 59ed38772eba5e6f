//! The exact moments of `exact` in factored form: one orthogonalisation over all locals per sample.
//!
//! The rows of one array hold the errors of all locals, written in independent unit errors with weights:
//!
//! ```text
//!     before   z_i = [A x̃ + w; −θ̂ − φ̂; φ̂] and θ_i(k−1)           = U · N(0, D)
//!     after    s_i = z_i − J_i (C̄_i z_i + Φ_i θ_i(k) + v_i) and θ_i(k)  = [U-part, Θ-part, v-part] · N(0, [D, E, R])
//!     next     A x̃ + w, −θ̂ − φ̂, φ̂, θ(k)                            = [.., w-part]; made U' · N(0, D') again
//! ```
//!
//! Noise that two locals share is one column, so that Σ and every M_ij come from one factor and are covariances
//! together, whatever the rounding. The gains come from conditioning U D Uᵀ of one local on one reading after the
//! other, with θ_i(k) a state of variance η: no S_i is formed, whose digits a large η would take.
//!
//! # References
//! Bierman 1977, *Factorization Methods for Discrete Sequential Estimation*, ch. V and VI.

use crate::joint_fusion::exact::observe;
use crate::joint_fusion::gains::Gains;
use crate::joint_fusion::layout::{Layout, Local, Pattern};
use crate::kalman::model::Model;
use crate::kalman::ud::{Ud, semidefinite_factor, transpose};
use crate::linalg::{axpy, cholesky, dot, forward_solve};
use crate::matrix::Matrix;

/// All errors in one array.
#[derive(Debug, Clone)]
pub struct Array {
    /// [z_i; θ_i(k−1)] of all locals before the sample.
    pub prior: Ud,
    next: Ud,
    /// [s_i; θ_i(k)] after it, by rows.
    after: Matrix,
    weights: Vec<f64>,
    weighted: Vec<f64>,
    /// v = F · N(0, f), (m, m) by rows, and f.
    noise: (Vec<f64>, Vec<f64>),
    locals: Vec<Own>,
    deviations: [Vec<f64>; 2],
}

/// Room for the gains of one local.
#[derive(Debug, Clone)]
struct Own {
    /// Where its rows begin.
    first: usize,
    /// [z; θ(k−1); θ(k)].
    ud: Ud,
    part: Ud,
    rows: Matrix,
    weighted: Vec<f64>,
    seen: Matrix,
    /// Rows of L⁻¹ [C, Φ, 0, 0, Φ].
    white: Matrix,
    /// Cholesky factor of R_ii.
    factor: Vec<f64>,
    gains: Matrix,
    scratch: Vec<f64>,
    reading: Vec<f64>,
    shift: Vec<f64>,
}

impl Array {
    /// Before the first sample: every local has the same error of x, with covariance `p` (n, n).
    ///
    /// # Errors
    /// If `p` or R is no covariance.
    pub fn new(layout: &Layout, model: &Model, p: &[f64]) -> crate::Result<Self> {
        let (n, m) = (layout.n, model.dims.channels);
        let width = layout.states + 2 * layout.weak + m + model.q.len();
        let mut total = 0;
        let locals: Vec<Own> = (layout.locals.iter())
            .map(|local| {
                let own = Own::new(n, local, total, width);
                total += local.size(n) + local.weak;
                own
            })
            .collect();
        let (columns, start) = semidefinite_factor("prior.P", p, n)?;
        let by_rows = transpose(&columns, start.len(), n);
        let mut rows = vec![0.0; total * start.len()];
        for own in &locals {
            rows[own.first * start.len()..][..by_rows.len()].copy_from_slice(&by_rows);
        }
        let mut prior = Ud::zero(total);
        let mut weighted = start.clone();
        prior.orthogonalise(&mut rows, &start, &mut weighted);
        let (columns, f) = semidefinite_factor("R", &model.noise.r, m)?;
        Ok(Self {
            next: prior.clone(),
            prior,
            after: Matrix::zeros(total, width),
            weights: vec![0.0; width],
            weighted: vec![0.0; width],
            noise: (transpose(&columns, f.len(), m), f),
            locals,
            deviations: [vec![0.0; total], vec![0.0; total]],
        })
    }

    /// Gains for one sample, then all errors after it.
    pub fn correct(
        &mut self,
        layout: &Layout,
        model: &Model,
        k: usize,
        pattern: &Pattern,
        gains: &mut Gains,
    ) {
        gains.broken = false;
        self.unfold(layout, pattern);
        for (i, own) in self.locals.iter_mut().enumerate() {
            own.seen.shape(layout.locals[i].height(), layout.locals[i].size(layout.n));
            observe(layout, model, (i, k), pattern, &mut own.seen);
            let solved = own.gain(&layout.locals[i], layout.n, model, pattern, (&self.after, &self.prior.d));
            gains.broken |= !solved;
            own.hand_over(&layout.locals[i], layout.n, &mut gains.j[i]);
        }
        for (i, local) in layout.locals.iter().enumerate() {
            self.correct_local(layout, i, local, &gains.j[i]);
            for q in 0..local.weak {
                let (row, column) = (self.locals[i].first + layout.n + q, self.injection(local, q));
                self.after[(row, column)] += 1.0; // θ − θ̂
                let variance = self.product(row, row);
                self.after[(row, column)] -= 1.0;
                gains.attack_std[local.first_weak + q] = variance.sqrt();
            }
        }
    }

    /// The column of θ_i(k).
    fn injection(&self, local: &Local, q: usize) -> usize {
        self.prior.d.len() + local.first_weak + q
    }

    /// U by rows with room for θ(k), v and w, and all weights.
    fn unfold(&mut self, layout: &Layout, pattern: &Pattern) {
        let total = self.prior.d.len();
        self.after.set_zero();
        for column in 0..total {
            for (row, &value) in self.prior.column(column).iter().enumerate() {
                self.after[(row, column)] = value;
            }
            self.after[(column, column)] = 1.0;
        }
        let (d, rest) = self.weights.split_at_mut(total);
        d.copy_from_slice(&self.prior.d);
        rest.fill(0.0);
        let (eta, rest) = rest.split_at_mut(layout.weak);
        for local in &layout.locals {
            (0..local.weak).for_each(|q| eta[local.first_weak + q] = pattern.variance(local, q));
        }
        rest[..self.noise.1.len()].copy_from_slice(&self.noise.1);
    }

    /// Rows of s_i = B_i z_i − J_i Φ_i θ_i(k) − J_i v_i and of θ_i(k).
    fn correct_local(&mut self, layout: &Layout, i: usize, local: &Local, j: &Matrix) {
        let (size, first, total) = (local.size(layout.n), self.locals[i].first, self.prior.d.len());
        let own = &mut self.locals[i];
        own.rows.shape(size, total);
        (0..size).for_each(|a| own.rows.row_mut(a).copy_from_slice(&self.after.row(first + a)[..total]));
        for row in 0..local.height() {
            // C̄ z of this row.
            self.weighted[..total].fill(0.0);
            for a in (0..size).filter(|&a| own.seen[(row, a)] != 0.0) {
                axpy(own.seen[(row, a)], own.rows.row(a), &mut self.weighted[..total]);
            }
            let noise = &self.noise.0[local.channels[row] * self.noise.1.len()..][..self.noise.1.len()];
            for a in 0..size {
                let target = self.after.row_mut(first + a);
                axpy(-j[(a, row)], &self.weighted[..total], &mut target[..total]);
                axpy(-j[(a, row)], noise, &mut target[total + layout.weak..][..noise.len()]);
            }
        }
        for q in 0..local.weak {
            let column = total + local.first_weak + q;
            (0..size).for_each(|a| self.after[(first + a, column)] = -j[(a, q)]);
            let kept = self.after.row_mut(first + size + q);
            kept.fill(0.0);
            kept[column] = 1.0;
        }
    }

    /// E of the product of two rows after the sample.
    fn product(&self, a: usize, b: usize) -> f64 {
        let both = self.after.row(a).iter().zip(self.after.row(b)).zip(&self.weights);
        both.map(|((a, b), w)| a * b * w).sum()
    }

    /// P_ij^x of two locals, at the upper left of `out` (n, n).
    pub fn block(&self, n: usize, (i, j): (usize, usize), out: &mut Matrix) {
        out.shape(n, n);
        for a in 0..n {
            for b in 0..n {
                out[(a, b)] = self.product(self.locals[i].first + a, self.locals[j].first + b);
            }
        }
    }

    /// Covariance of x⁻ of one local, (n, n).
    pub fn local_prior(&self, n: usize, i: usize, out: &mut Matrix) {
        let (first, total) = (self.locals[i].first, self.prior.d.len());
        out.set_zero();
        for column in first..total {
            let (d, u) = (self.prior.d[column], self.prior.column(column));
            let entry =
                |a: usize| if first + a == column { 1.0 } else { u.get(first + a).copied().unwrap_or(0.0) };
            for a in 0..n {
                (0..n).for_each(|b| out[(a, b)] += d * entry(a) * entry(b));
            }
        }
    }

    /// Covariance of [X̃; φ̂] of one local, X̃ = [x̃; θ − θ̂].
    #[must_use]
    pub fn papers(&self, n: usize, i: usize, local: &Local, pattern: &Pattern) -> Matrix {
        let (size, first) = (local.size(n), self.locals[i].first);
        let mut rows: Vec<Vec<f64>> = (0..size).map(|a| self.after.row(first + a).to_vec()).collect();
        (0..local.weak).for_each(|q| rows[n + q][self.injection(local, q)] += 1.0);
        let mut whole = Matrix::zeros(size, size);
        for (a, row) in rows.iter().enumerate() {
            for (b, column) in rows.iter().enumerate() {
                let both = row.iter().zip(column).zip(&self.weights);
                whole[(a, b)] = both.map(|((a, b), w)| a * b * w).sum();
            }
        }
        for q in 0..local.weak {
            // What is injected into a channel that did not arrive.
            whole[(n + q, n + q)] += pattern.eta[local.first_weak + q] - pattern.variance(local, q);
        }
        whole
    }

    /// From s to z of the next sample, made U D Uᵀ again.
    pub fn predict(&mut self, layout: &Layout, model: &Model, k: usize) {
        let (n, a) = (layout.n, model.a(k));
        let noise = self.weights.len() - model.q.len();
        self.weights[noise..].copy_from_slice(&model.q);
        for (own, local) in self.locals.iter_mut().zip(&layout.locals) {
            let width = self.after.columns();
            own.rows.shape(n, width);
            (0..n).for_each(|row| own.rows.row_mut(row).copy_from_slice(self.after.row(own.first + row)));
            for row in 0..n {
                let target = self.after.row_mut(own.first + row);
                target.fill(0.0);
                for (l, &value) in a[row * n..(row + 1) * n].iter().enumerate() {
                    axpy(value, own.rows.row(l), target);
                }
                target[noise..].copy_from_slice(&model.g[row * model.q.len()..(row + 1) * model.q.len()]);
            }
            let (theta, phi) = (own.first + n, own.first + n + local.weak);
            (0..local.weak).for_each(|q| self.after.add_row(-1.0, phi + q, theta + q));
        }
        self.next.orthogonalise(self.after.numbers_mut(), &self.weights, &mut self.weighted);
    }

    /// Whether the next errors differ from the last ones by no more than rounding.
    pub fn repeats(&mut self) -> bool {
        let [before, after] = &mut self.deviations;
        self.prior.variances(before);
        self.next.variances(after);
        let tolerance = 8.0 * before.len() as f64 * f64::EPSILON;
        self.prior.is_close(&self.next, before, after, tolerance)
    }

    /// Make the errors found by `predict` those before the next sample.
    pub fn take_over(&mut self) {
        std::mem::swap(&mut self.prior, &mut self.next);
    }
}

impl Own {
    fn new(n: usize, local: &Local, first: usize, width: usize) -> Self {
        let (kept, height) = (local.size(n) + local.weak, local.height());
        let size = kept + local.weak;
        Self {
            first,
            ud: Ud::zero(size),
            part: Ud::zero(kept),
            rows: Matrix::room(kept * width),
            weighted: vec![0.0; width],
            seen: Matrix::zeros(height, local.size(n)),
            white: Matrix::zeros(height, size),
            factor: vec![0.0; height * height],
            gains: Matrix::zeros(height, size),
            scratch: vec![0.0; size],
            reading: vec![0.0; height],
            shift: vec![0.0; size],
        }
    }

    /// Gains of [z; θ(k−1); θ(k)] for every whitened reading; false if R is no covariance.
    fn gain(
        &mut self,
        local: &Local,
        n: usize,
        model: &Model,
        pattern: &Pattern,
        (rows, d): (&Matrix, &[f64]),
    ) -> bool {
        let (total, kept, size) = (d.len(), local.size(n) + local.weak, self.ud.d.len());
        self.rows.shape(kept, total);
        (0..kept).for_each(|a| self.rows.row_mut(a).copy_from_slice(&rows.row(self.first + a)[..total]));
        self.part.orthogonalise(self.rows.numbers_mut(), d, &mut self.weighted[..total]);
        self.ud.u.fill(0.0);
        for column in 0..kept {
            self.ud.d[column] = self.part.d[column];
            self.ud.u[column * size..column * size + column].copy_from_slice(self.part.column(column));
        }
        (0..local.weak).for_each(|q| self.ud.d[kept + q] = pattern.variance(local, q));
        if !self.whiten(local, kept, model, pattern) {
            self.gains.set_zero();
            return false;
        }
        for row in 0..local.height() {
            self.ud.condition(self.white.row(row), &mut self.scratch, self.gains.row_mut(row));
        }
        true
    }

    /// L⁻¹ [C̄, 0, Φ], with R = L Lᵀ over the rows that arrived and zeros for the others.
    fn whiten(&mut self, local: &Local, kept: usize, model: &Model, pattern: &Pattern) -> bool {
        let (m, height) = (model.dims.channels, local.height());
        let heard = |row: usize| pattern.heard[local.first_row + row];
        self.white.set_zero();
        for a in 0..height {
            for b in 0..height {
                let r = model.noise.r[local.channels[a] * m + local.channels[b]];
                self.factor[a * height + b] =
                    if heard(a) && heard(b) { r } else { f64::from(u8::from(a == b)) };
            }
            let width = self.seen.columns();
            self.white.row_mut(a)[..width].copy_from_slice(self.seen.row(a));
            if a < local.weak && heard(a) {
                self.white[(a, kept + a)] = 1.0;
            }
        }
        if cholesky(&mut self.factor, height, height, 0.0).is_err() {
            return false;
        }
        for a in 0..height {
            (0..a).for_each(|b| self.white.add_row(-self.factor[a * height + b], b, a));
            let scale = 1.0 / self.factor[a * height + a];
            self.white.row_mut(a).iter_mut().for_each(|value| *value *= scale);
        }
        true
    }

    /// J = [K; −Γ]: K_x, K_θ = gain of z_θ + θ(k), Γ = gain of θ(k) − θ(k−1) − φ̂.
    fn hand_over(&mut self, local: &Local, n: usize, j: &mut Matrix) {
        let (height, p) = (local.height(), local.weak);
        for column in 0..height {
            self.reading.fill(0.0);
            self.reading[column] = 1.0;
            forward_solve(&self.factor, height, &mut self.reading);
            self.shift.fill(0.0);
            for row in 0..height {
                let surprise = self.reading[row] - dot(self.white.row(row), &self.shift);
                axpy(surprise, self.gains.row(row), &mut self.shift);
            }
            let (z, injections) = self.shift.split_at(n + 2 * p);
            let (past, present) = injections.split_at(p);
            (0..n).for_each(|a| j[(a, column)] = z[a]);
            for q in 0..p {
                j[(n + q, column)] = z[n + q] + present[q];
                j[(n + p + q, column)] = past[q] + z[n + p + q] - present[q];
            }
        }
    }
}
