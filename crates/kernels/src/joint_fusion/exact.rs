//! Exact second moments of all local errors, in the form of Joseph.
//!
//! With s_i = [x̃; −θ̂; φ̂] after a sample and z_i = [A x̃ + w; −θ̂ − φ̂; φ̂] before the next,
//!
//! ```text
//!     ỹ_i  = C̄_i z_i + Φ_i θ_i(k) + v_i,           C̄_i = [C_i, Φ_i, 0]                       (7)
//!     s_i  = z_i − J_i ỹ_i,                         J_i = [K_i; −Γ_i]                         (6)
//!     S_i  = C̄_i M⁻_ii C̄_iᵀ + Φ_i E_i Φ_iᵀ + R_ii,  E_i = diag η_i(k)
//!     J_i  = (M⁻_ii C̄_iᵀ + [0; E_i Φ_iᵀ; Θ_i C̄_iᵀ − E_i Φ_iᵀ]) S_i⁻¹                           optimal one step ahead
//!     M_ij = B_i M⁻_ij B_jᵀ + J_i R_ij J_jᵀ (+ J_i Φ_i E_i Φ_iᵀ J_iᵀ if i = j),  B_i = I − J_i C̄_i
//!     Θ_i  = E θ_i(k−1) z_iᵀ,                       E θ_i(k) s_iᵀ = −E_i Φ_iᵀ J_iᵀ
//! ```
//!
//! θ(k−1) leaves the state because A^a F = F: s is Markov, and nothing is assumed about E φ̂ φ̃ᵀ, which (19) and (25)
//! of the paper take for zero. R_ij = E v_i v_jᵀ is that of the sensors two locals share, which (45)–(49) lack.
//! A row that did not arrive is zero in C̄ and Φ.

use crate::joint_fusion::gains::Gains;
use crate::joint_fusion::layout::{Layout, Local, Pattern};
use crate::kalman::model::Model;
use crate::linalg::{cholesky, cholesky_solve};
use crate::matrix::Matrix;

/// Rounding of one step, in units of the sizes that enter it.
const SETTLED: f64 = 16.0;

/// M⁻_ij of all pairs i ≤ j, Θ_i of all locals, and room to move them on.
#[derive(Debug, Clone)]
pub struct Exact {
    /// M⁻_ij before the sample.
    pub prior: Vec<Matrix>,
    /// Θ_i = E θ_i(k−1) z_iᵀ.
    pub theta: Vec<Matrix>,
    /// M_ij after the sample; between steps the next M⁻_ij.
    pub work: Vec<Matrix>,
    /// M_ii after the sample without the injection, which hides the other digits if η is large.
    apart: Vec<Matrix>,
    /// E θ_i(k) s_iᵀ.
    theta_after: Vec<Matrix>,
    /// C̄_i.
    seen: Vec<Matrix>,
    /// B_i.
    closed: Vec<Matrix>,
    scratch: [Matrix; 3],
}

impl Exact {
    /// Before the first sample: every local has the same error of x, with covariance `p` (n, n).
    #[must_use]
    pub fn new(layout: &Layout, p: &[f64]) -> Self {
        let (n, locals) = (layout.n, &layout.locals);
        let size = |i: usize| locals[i].size(n);
        let start = |(i, j)| Matrix::corner(size(i), size(j), n, p);
        let prior: Vec<Matrix> = layout.pairs().map(start).collect();
        let theta: Vec<Matrix> = locals.iter().map(|l| Matrix::zeros(l.weak, l.size(n))).collect();
        let widest = locals.iter().map(|l| l.size(n).max(l.height())).max().unwrap_or(0);
        Self {
            work: prior.clone(),
            prior,
            apart: locals.iter().map(|l| Matrix::zeros(l.size(n), l.size(n))).collect(),
            theta_after: theta.clone(),
            theta,
            seen: locals.iter().map(|l| Matrix::zeros(l.height(), l.size(n))).collect(),
            closed: locals.iter().map(|l| Matrix::zeros(l.size(n), l.size(n))).collect(),
            scratch: std::array::from_fn(|_| Matrix::room(widest * widest)),
        }
    }

    /// Gains for one sample, then all moments after it.
    pub fn correct(
        &mut self,
        layout: &Layout,
        model: &Model,
        k: usize,
        pattern: &Pattern,
        gains: &mut Gains,
    ) {
        gains.broken = false;
        for i in 0..layout.count() {
            observe(layout, model, (i, k), pattern, &mut self.seen[i]);
            let solved = self.gain(layout, model, i, pattern, &mut gains.j[i]);
            gains.broken |= !solved;
            let (j, closed) = (&gains.j[i], &mut self.closed[i]);
            closed.set_identity(j.rows());
            closed.add_product(-1.0, j, &self.seen[i]);
        }
        for (i, j) in layout.pairs() {
            self.correct_pair(layout, model, (i, j), gains);
        }
        for (i, local) in layout.locals.iter().enumerate() {
            self.inject(layout, i, local, pattern, gains);
        }
    }

    /// J_i; false, and zero, if S_i is no covariance.
    fn gain(
        &mut self,
        layout: &Layout,
        model: &Model,
        i: usize,
        pattern: &Pattern,
        gain: &mut Matrix,
    ) -> bool {
        let (local, n) = (&layout.locals[i], layout.n);
        let [moved, s, remembered] = &mut self.scratch;
        moved.set_product(&self.seen[i], &self.prior[layout.pair(i, i)]);
        s.set_product_transposed(moved, &self.seen[i]);
        add_noise(local, model, pattern, s);
        gain.set_transpose(moved);
        remembered.set_product_transposed(&self.theta[i], &self.seen[i]);
        for q in 0..local.weak {
            let eta = pattern.variance(local, q);
            let below = n + local.weak + q;
            s[(q, q)] += eta;
            gain[(n + q, q)] += eta;
            gain[(below, q)] -= eta;
            for (target, value) in gain.row_mut(below).iter_mut().zip(remembered.row(q)) {
                *target += value;
            }
        }
        let height = local.height();
        if cholesky(s.numbers_mut(), height, height, 0.0).is_err() {
            gain.numbers_mut().fill(0.0);
            return false;
        }
        (0..gain.rows()).for_each(|a| cholesky_solve(s.numbers(), height, gain.row_mut(a)));
        true
    }

    /// M_ij without the injection.
    fn correct_pair(&mut self, layout: &Layout, model: &Model, (i, j): (usize, usize), gains: &Gains) {
        let (pair, [half, noise, _]) = (layout.pair(i, j), &mut self.scratch);
        half.set_product(&self.closed[i], &self.prior[pair]);
        let after = &mut self.work[pair];
        after.set_product_transposed(half, &self.closed[j]);
        carry_noise(&layout.locals[i], &layout.locals[j], model, &gains.j[i], noise);
        after.add_product_transposed(1.0, noise, &gains.j[j]);
        if i == j {
            after.symmetrise();
        }
    }

    /// The injection's part of M_ii, the variance of its estimate, and E θ_i s_iᵀ.
    fn inject(&mut self, layout: &Layout, i: usize, local: &Local, pattern: &Pattern, gains: &mut Gains) {
        let (n, j, after) = (layout.n, &gains.j[i], &mut self.work[layout.pair(i, i)]);
        for q in 0..local.weak {
            let rest = (0..local.weak).map(|l| {
                let left = f64::from(u8::from(l == q)) - j[(n + q, l)];
                left * left * pattern.variance(local, l)
            });
            let variance = after[(n + q, n + q)] + rest.sum::<f64>();
            gains.attack_std[local.first_weak + q] = variance.max(0.0).sqrt();
        }
        self.apart[i].copy_from(after);
        for q in 0..local.weak {
            let eta = pattern.variance(local, q);
            for a in 0..j.rows() {
                for b in 0..j.rows() {
                    after[(a, b)] += eta * (j[(a, q)] * j[(b, q)]);
                }
                self.theta_after[i][(q, a)] = -eta * j[(a, q)];
            }
        }
    }

    /// From s to z of the next sample: x̃ ← A x̃ + w, −θ̂ ← −θ̂ − φ̂.
    pub fn predict(&mut self, layout: &Layout, model: &Model, k: usize, q: &[f64]) {
        let (n, a) = (layout.n, model.a(k));
        for (i, j) in layout.pairs() {
            let (pair, [half, turned, _]) = (layout.pair(i, j), &mut self.scratch);
            move_rows(a, n, layout.locals[i].weak, &self.work[pair], half);
            turned.set_transpose(half);
            move_rows(a, n, layout.locals[j].weak, turned, half);
            let next = &mut self.work[pair];
            next.set_transpose(half);
            for row in 0..n {
                crate::linalg::axpy(1.0, &q[row * n..(row + 1) * n], &mut next.row_mut(row)[..n]);
            }
            if i == j {
                next.symmetrise();
            }
        }
        for (i, local) in layout.locals.iter().enumerate() {
            let [half, turned, _] = &mut self.scratch;
            turned.set_transpose(&self.theta_after[i]);
            move_rows(a, n, local.weak, turned, half);
            self.theta[i].set_transpose(half);
        }
    }

    /// Covariance of [X̃; φ̂] of one local, X̃ = [x̃; θ − θ̂]: M_ii without the injection + Σ η h hᵀ, h = F − J Φ.
    #[must_use]
    pub fn papers(&self, n: usize, i: usize, local: &Local, (pattern, j): (&Pattern, &Matrix)) -> Matrix {
        let mut whole = self.apart[i].clone();
        for q in 0..local.weak {
            let eta = pattern.eta[local.first_weak + q];
            let left = |a: usize| f64::from(u8::from(a == n + q)) - j[(a, q)];
            for a in 0..j.rows() {
                (0..j.rows()).for_each(|b| whole[(a, b)] += eta * (left(a) * left(b)));
            }
        }
        whole
    }

    /// Covariance of x⁻ of one local, (n, n).
    pub fn local_prior(&self, n: usize, i: usize, out: &mut Matrix) {
        let count = self.theta.len();
        let own = &self.prior[i * count - i * (i + 1) / 2 + i];
        (0..n).for_each(|a| out.row_mut(a).copy_from_slice(&own.row(a)[..n]));
    }

    /// Make the moments in `work` those before the next sample.
    pub fn take_over(&mut self) {
        std::mem::swap(&mut self.prior, &mut self.work);
    }

    /// Whether the next moments differ from the last ones by no more than rounding.
    #[must_use]
    pub fn repeats(&self, layout: &Layout) -> bool {
        layout.pairs().all(|(i, j)| {
            let pair = layout.pair(i, j);
            let (rows, columns) = (&self.prior[layout.pair(i, i)], &self.prior[layout.pair(j, j)]);
            let tolerance = SETTLED * (rows.rows() + columns.rows()) as f64 * f64::EPSILON;
            (0..rows.rows()).all(|a| {
                (0..columns.rows()).all(|b| {
                    let size = (rows[(a, a)] * columns[(b, b)]).sqrt();
                    (self.work[pair][(a, b)] - self.prior[pair][(a, b)]).abs() <= tolerance * size
                })
            })
        })
    }
}

/// C̄_i = [C_i, Φ_i, 0] with zeros for what did not arrive.
pub fn observe(layout: &Layout, model: &Model, (i, k): (usize, usize), pattern: &Pattern, seen: &mut Matrix) {
    let (local, n, c) = (&layout.locals[i], layout.n, model.c(k));
    for (row, &channel) in local.channels.iter().enumerate() {
        let target = seen.row_mut(row);
        target.fill(0.0);
        if pattern.heard[local.first_row + row] {
            target[..n].copy_from_slice(&c[channel * n..(channel + 1) * n]);
            if row < local.weak {
                target[n + row] = 1.0;
            }
        }
    }
}

/// S += R over the rows that arrived; 1 where nothing did, so that S keeps an inverse.
pub fn add_noise(local: &Local, model: &Model, pattern: &Pattern, s: &mut Matrix) {
    let (m, height) = (model.dims.channels, local.height());
    let heard = |row: usize| pattern.heard[local.first_row + row];
    for a in 0..height {
        for b in 0..height {
            if heard(a) && heard(b) {
                s[(a, b)] += model.noise.r[local.channels[a] * m + local.channels[b]];
            }
        }
        if !heard(a) {
            s[(a, a)] += 1.0;
        }
    }
}

/// `out` = J_i R_ij.
pub fn carry_noise(i: &Local, j: &Local, model: &Model, gain: &Matrix, out: &mut Matrix) {
    let m = model.dims.channels;
    out.shape(gain.rows(), j.height());
    for (a, &own) in i.channels.iter().enumerate() {
        for (b, &other) in j.channels.iter().enumerate() {
            let r = model.noise.r[own * m + other];
            if r != 0.0 {
                (0..gain.rows()).for_each(|row| out[(row, b)] += gain[(row, a)] * r);
            }
        }
    }
}

/// `out` = T M with T = [A, 0, 0; 0, I, −I; 0, 0, I].
pub fn move_rows(a: &[f64], n: usize, weak: usize, m: &Matrix, out: &mut Matrix) {
    out.copy_from(m);
    for i in 0..n {
        let row = out.row_mut(i);
        row.fill(0.0);
        for (&value, source) in a[i * n..(i + 1) * n].iter().zip(0..n) {
            if value != 0.0 {
                crate::linalg::axpy(value, m.row(source), row);
            }
        }
    }
    (0..weak).for_each(|q| out.add_row(-1.0, n + weak + q, n + q));
}
