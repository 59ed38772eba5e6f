//! The recursions as the paper prints them, for reproduction: Lemma 1, Theorem 1 and Theorem 2.
//!
//! In (19) the superscript of {Γ_i^a(k−1)}ᵀ is restored, without which the dimensions do not fit. Everything else
//! stays: Ξ¹ takes E φ̂ φ̃ᵀ for zero, and (45)–(49) have no R_ij. Under dropouts or a changing η, Ξ becomes indefinite
//! and the recursion can diverge; then the gains are reported as broken.
//!
//! A(k) of the paper moves x(k−1) to x(k); it is A\[k−1\] here, and nothing before the first sample.

pub mod cross;
mod parts;

use crate::joint_fusion::exact::{add_noise, carry_noise, observe};
use crate::joint_fusion::gains::Gains;
use crate::joint_fusion::layout::{Layout, Local, Pattern};
use crate::joint_fusion::printed::cross::{Cross, Step};
use crate::joint_fusion::printed::parts::{
    Moved, Work, augmented, keep_columns, sandwich, scale_columns, shifted,
};
use crate::joint_fusion::semidefinite::Semidefinite;
use crate::kalman::model::Model;
use crate::linalg::{axpy, cholesky, cholesky_solve};
use crate::matrix::Matrix;

/// Rounding of one step, in units of the largest number; these recursions subtract more than those of Joseph.
const ROUNDING: f64 = 1024.0;

/// P^X, P^φ, U, V of one local, with Γ C Φ and K^a Φ of the last sample.
#[derive(Debug, Clone)]
pub struct Own {
    /// P^X, (n + p, n + p).
    pub px: Matrix,
    /// P^φ, (p, p).
    pub pf: Matrix,
    /// U, (n + p, p).
    pub u: Matrix,
    /// V, (p, p).
    pub v: Matrix,
    /// Γ C^a Φ^a, (p, p).
    pub g: Matrix,
    /// K^a Φ^a, (n + p, p).
    pub kaf: Matrix,
}

/// All recursions of the paper.
#[derive(Debug, Clone)]
pub struct Printed {
    /// Per local.
    pub own: Vec<Own>,
    /// Per pair i < j, in the order of [`Layout::pairs`].
    pub cross: Vec<Cross>,
    before: (Vec<Own>, Vec<Cross>),
    steps: Vec<Step>,
    seen: Matrix,
    test: Semidefinite,
    work: Work,
    /// Whether a sample was before: then A moves the state in between.
    pub moved: bool,
}

impl Own {
    fn new(n: usize, local: &Local, p: &[f64], eta: &[f64]) -> Self {
        let (size, w) = (n + local.weak, local.weak);
        let (mut px, mut pf, mut kaf) =
            (Matrix::corner(size, size, n, p), Matrix::zeros(w, w), Matrix::zeros(size, w));
        for q in 0..w {
            px[(n + q, n + q)] = eta[local.first_weak + q];
            pf[(q, q)] = 2.0 * eta[local.first_weak + q];
            kaf[(n + q, q)] = 1.0;
        }
        Self { px, pf, u: Matrix::zeros(size, w), v: Matrix::zeros(w, w), g: Matrix::zeros(w, w), kaf }
    }

    /// Everything, in order.
    #[must_use]
    pub fn all(&self) -> [&Matrix; 6] {
        [&self.px, &self.pf, &self.u, &self.v, &self.g, &self.kaf]
    }

    /// Everything, in order, to be changed.
    pub fn all_mut(&mut self) -> [&mut Matrix; 6] {
        [&mut self.px, &mut self.pf, &mut self.u, &mut self.v, &mut self.g, &mut self.kaf]
    }
}

impl Printed {
    /// K(0) = Γ(0) = 0, φ̂(0) = 0, P^X(0) = diag(p, η), P^φ(0) = 2η, P_ij^x(0) = p.
    #[must_use]
    pub fn new(layout: &Layout, p: &[f64], eta: &[f64]) -> Self {
        let (n, locals) = (layout.n, &layout.locals);
        let own: Vec<Own> = locals.iter().map(|local| Own::new(n, local, p, eta)).collect();
        let between = |(i, j): (usize, usize)| Cross::new(n, (locals[i].weak, locals[j].weak), p);
        let cross: Vec<Cross> = layout.pairs().filter(|(i, j)| i < j).map(between).collect();
        let widest = locals.iter().map(|l| l.size(n).max(l.height())).max().unwrap_or(0);
        Self {
            before: (own.clone(), cross.clone()),
            own,
            cross,
            steps: locals.iter().map(|_| Step::room(widest * widest)).collect(),
            seen: Matrix::room(widest * widest),
            test: Semidefinite::new(widest),
            work: Work::room(widest * widest),
            moved: false,
        }
    }

    /// One sample: gains and all moments after it.
    pub fn correct(
        &mut self,
        layout: &Layout,
        model: &Model,
        k: usize,
        (pattern, q): (&Pattern, &[f64]),
        gains: &mut Gains,
    ) {
        std::mem::swap(&mut self.before.0, &mut self.own);
        std::mem::swap(&mut self.before.1, &mut self.cross);
        let moved = self.moved.then(|| (model.a(k.saturating_sub(1)), q));
        self.moved = true;
        gains.broken = false;
        for i in 0..layout.count() {
            let local = &layout.locals[i];
            self.seen.shape(local.height(), local.size(layout.n));
            observe(layout, model, (i, k), pattern, &mut self.seen);
            keep_columns(&self.seen, 0..layout.n + local.weak, &mut self.steps[i].c);
            let eta = &pattern.eta[local.first_weak..local.first_weak + local.weak];
            let sound = self.expect(i, layout.n, eta, moved) & self.gain(layout, model, i, pattern);
            gains.broken |= !sound;
            self.close(i, layout.n, moved);
            self.moments(layout, model, i, eta, moved);
            self.hand_over(i, layout.n, &mut gains.j[i]);
            for q in 0..local.weak {
                let variance = self.own[i].px[(layout.n + q, layout.n + q)];
                gains.attack_std[local.first_weak + q] = variance.max(0.0).sqrt();
            }
        }
        for (pair, (i, j)) in layout.pairs().filter(|(i, j)| i < j).enumerate() {
            let (ours, theirs) = ((&self.steps[i], &self.own[i]), (&self.steps[j], &self.own[j]));
            self.cross[pair].correct(layout.n, &self.before.1[pair], ours, theirs, moved, &mut self.work);
        }
    }

    /// Back to the moments before the sample, which those after it repeat: gains found anew from them are the same.
    pub fn stay(&mut self) {
        std::mem::swap(&mut self.before.0, &mut self.own);
        std::mem::swap(&mut self.before.1, &mut self.cross);
    }

    /// Ξ¹, Ξ², A^a Ξ² and Ξ of (19); false if Ξ is no covariance.
    fn expect(&mut self, i: usize, n: usize, eta: &[f64], moved: Moved<'_>) -> bool {
        let (b, w, p) = (&self.before.0[i], &mut self.work, eta.len());
        w.d.copy_from(&b.pf);
        for a in 0..p {
            for c in 0..p {
                let one = f64::from(u8::from(a == c));
                w.d[(a, c)] = 6.0 * eta[a] * one
                    - b.pf[(a, c)]
                    - eta[a] * (one - b.g[(c, a)])
                    - eta[c] * (one - b.g[(a, c)]);
            }
        }
        w.x2.copy_from(&b.u);
        for a in 0..n + p {
            for (c, &eta) in eta.iter().enumerate() {
                w.x2[(a, c)] += b.kaf[(a, c)] * eta;
            }
        }
        augmented(moved, n, &w.x2, &mut w.ax2);
        sandwich(moved, n, &b.px, (&mut w.one, &mut w.two), &mut w.xi);
        for a in 0..p {
            for c in 0..p {
                w.xi[(n + a, n + c)] += w.d[(a, c)];
            }
            for c in 0..n + p {
                w.xi[(c, n + a)] -= w.ax2[(c, a)];
                w.xi[(n + a, c)] -= w.ax2[(c, a)];
            }
        }
        self.test.a.copy_from(&w.xi);
        for (a, scale) in self.test.scale[..n + p].iter_mut().enumerate() {
            *scale = w.xi[(a, a)].abs().max(f64::MIN_POSITIVE).sqrt();
        }
        self.test.factor(0.0)
    }

    /// K of (37) and Γ of (36); false, and zero, if S is no covariance.
    fn gain(&mut self, layout: &Layout, model: &Model, i: usize, pattern: &Pattern) -> bool {
        let (local, n, w, step) = (&layout.locals[i], layout.n, &mut self.work, &mut self.steps[i]);
        w.one.set_product(&step.c, &w.xi);
        w.s.set_product_transposed(&w.one, &step.c);
        add_noise(local, model, pattern, &mut w.s);
        step.k.set_transpose(&w.one);
        keep_columns(&step.c, n..n + local.weak, &mut w.two);
        step.gamma.set_product_transposed(&w.d, &w.two);
        w.one.set_product(&step.c, &w.ax2);
        step.gamma.add_transpose(-1.0, &w.one);
        let height = local.height();
        w.one.copy_from(&w.s);
        let sound = cholesky(w.one.numbers_mut(), height, height, 0.0).is_ok();
        for gain in [&mut step.k, &mut step.gamma] {
            if !sound {
                gain.set_zero();
            }
            (0..gain.rows())
                .filter(|_| sound)
                .for_each(|a| cholesky_solve(w.one.numbers(), height, gain.row_mut(a)));
        }
        sound
    }

    /// K^a, Γ C^a and Γ^b of (10).
    fn close(&mut self, i: usize, n: usize, moved: Moved<'_>) {
        let (step, own, size) = (&mut self.steps[i], &mut self.own[i], self.work.xi.rows());
        step.ka.set_identity(size);
        step.ka.add_product(-1.0, &step.k, &step.c);
        step.gc.set_product(&step.gamma, &step.c);
        step.gb.copy_from(&step.gc);
        if let Some((a, _)) = moved {
            for row in 0..step.gc.rows() {
                step.gb.row_mut(row)[..n].fill(0.0);
                for l in 0..n {
                    let value = step.gc[(row, l)];
                    axpy(value, &a[l * n..(l + 1) * n], &mut step.gb.row_mut(row)[..n]);
                }
            }
        }
        keep_columns(&step.gc, n..size, &mut own.g);
        keep_columns(&step.ka, n..size, &mut own.kaf);
    }

    /// (15)-(18).
    fn moments(&mut self, layout: &Layout, model: &Model, i: usize, eta: &[f64], moved: Moved<'_>) {
        let (local, n) = (&layout.locals[i], layout.n);
        let (b, own, step, w) = (&self.before.0[i], &mut self.own[i], &self.steps[i], &mut self.work);
        w.one.set_product(&step.gamma, &w.s);
        w.two.set_product_transposed(&w.one, &step.gamma); // Γ S Γᵀ
        own.pf.copy_from(&w.d); // (15)
        own.pf.add_product(-1.0, &own.g, &w.d);
        own.pf.add_product_transposed(-1.0, &w.d, &own.g);
        w.one.set_product(&step.gb, &w.x2);
        own.pf.add(1.0, &w.one);
        own.pf.add_transpose(1.0, &w.one);
        own.pf.add(1.0, &w.two);
        own.v.copy_from(&w.two); // (18)
        w.one.set_product(&step.gb, &b.u);
        own.v.add(1.0, &w.one);
        own.v.add_transpose(1.0, &w.one);
        own.v.add(1.0, &b.v);
        own.v.add_product_transposed(-1.0, &b.v, &own.g);
        own.v.add_product(-1.0, &own.g, &b.v);
        scale_columns(&own.g, eta, &mut w.one);
        w.two.set_product_transposed(&w.one, &b.g);
        own.v.add(-1.0, &w.two);
        own.v.add_transpose(-1.0, &w.two);
        w.one.set_product(&step.ka, &w.xi);
        own.px.set_product_transposed(&w.one, &step.ka); // (16)
        own.u.set_product_transposed(&w.one, &step.gc); // (17)
        carry_noise(local, local, model, &step.k, &mut w.two);
        own.px.add_product_transposed(1.0, &w.two, &step.k);
        own.px.symmetrise();
        own.u.add_product_transposed(-1.0, &w.two, &step.gamma);
        scale_columns(&own.kaf, eta, &mut w.one);
        own.u.add_product_transposed(-1.0, &w.one, &b.g);
        shifted(moved, n, (&b.u, &b.v), &mut w.one);
        own.u.add_product(1.0, &step.ka, &w.one);
    }

    /// J = [K; −Γ].
    fn hand_over(&self, i: usize, n: usize, j: &mut Matrix) {
        let step = &self.steps[i];
        let (size, p) = (step.k.rows(), step.gamma.rows());
        debug_assert_eq!(size, n + p);
        (0..size).for_each(|a| j.row_mut(a).copy_from_slice(step.k.row(a)));
        for q in 0..p {
            for (target, gamma) in j.row_mut(size + q).iter_mut().zip(step.gamma.row(q)) {
                *target = -gamma;
            }
        }
    }
}

impl Printed {
    /// Whether the moments of the last two samples differ by no more than rounding.
    #[must_use]
    pub fn repeats(&self) -> bool {
        let same = |a: &Matrix, b: &Matrix| {
            let largest = a.numbers().iter().fold(0.0, |size: f64, value| size.max(value.abs()));
            let tolerance = ROUNDING * f64::EPSILON * largest;
            a.numbers().iter().zip(b.numbers()).all(|(a, b)| (a - b).abs() <= tolerance)
        };
        let own = self.own.iter().zip(&self.before.0);
        let cross = self.cross.iter().zip(&self.before.1);
        own.clone().all(|(a, b)| same(&a.px, &b.px) && same(&a.pf, &b.pf) && same(&a.u, &b.u))
            && cross.clone().all(|(a, b)| same(&a.px, &b.px) && same(&a.u[0], &b.u[0]))
    }
}
