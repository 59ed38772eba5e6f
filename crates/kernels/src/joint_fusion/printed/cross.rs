//! Theorem 2: the moments between two local estimators.

use crate::joint_fusion::printed::Own;
use crate::joint_fusion::printed::parts::{Moved, Work, augmented, sandwich, shifted};
use crate::matrix::Matrix;

/// P^X, P^φ, U, Y, V of two locals, both ways where they are not transposes.
#[derive(Debug, Clone)]
pub struct Cross {
    /// P_ij^X.
    pub px: Matrix,
    /// P_ij^φ.
    pub pf: Matrix,
    /// U_ij and U_ji.
    pub u: [Matrix; 2],
    /// Y_ij and Y_ji.
    pub y: [Matrix; 2],
    /// V_ij.
    pub v: Matrix,
}

/// What Theorem 2 needs of one local at one sample.
#[derive(Debug, Clone)]
pub struct Step {
    /// K.
    pub k: Matrix,
    /// Γ.
    pub gamma: Matrix,
    /// C^a.
    pub c: Matrix,
    /// K^a = I − K C^a.
    pub ka: Matrix,
    /// Γ C^a.
    pub gc: Matrix,
    /// Γ^b = Γ C^a A^a.
    pub gb: Matrix,
}

impl Step {
    /// Room for matrices of as many numbers.
    #[must_use]
    pub fn room(numbers: usize) -> Self {
        let room = || Matrix::room(numbers);
        Self { k: room(), gamma: room(), c: room(), ka: room(), gc: room(), gb: room() }
    }
}

impl Cross {
    /// P_ij^x(0) is the prior `p` (n, n) both share; the rest is zero.
    #[must_use]
    pub fn new(n: usize, (a, b): (usize, usize), p: &[f64]) -> Self {
        Self {
            px: Matrix::corner(n + a, n + b, n, p),
            pf: Matrix::zeros(a, b),
            u: [Matrix::zeros(n + a, b), Matrix::zeros(n + b, a)],
            y: [Matrix::zeros(a, b), Matrix::zeros(b, a)],
            v: Matrix::zeros(a, b),
        }
    }

    /// Everything, in order.
    #[must_use]
    pub fn all(&self) -> [&Matrix; 7] {
        let ([u, u_ji], [y, y_ji]) = (&self.u, &self.y);
        [&self.px, &self.pf, u, u_ji, y, y_ji, &self.v]
    }

    /// Everything, in order, to be changed.
    pub fn all_mut(&mut self) -> [&mut Matrix; 7] {
        let ([u, u_ji], [y, y_ji]) = (&mut self.u, &mut self.y);
        [&mut self.px, &mut self.pf, u, u_ji, y, y_ji, &mut self.v]
    }

    /// (45)-(50), from the moments of the sample before.
    pub fn correct(
        &mut self,
        n: usize,
        b: &Self,
        (i, own_i): (&Step, &Own),
        (j, own_j): (&Step, &Own),
        moved: Moved<'_>,
        w: &mut Work,
    ) {
        w.d.copy_from(&b.pf); // Ξ¹ (50)
        w.d.add(1.0, &b.y[0]);
        w.d.add_transpose(1.0, &b.y[1]);
        self.expect(n, b, moved, w);
        w.one.set_product(&i.gc, &w.xi);
        w.x2.set_product_transposed(&w.one, &j.gc); // Γ_i C_i Ξ (Γ_j C_j)ᵀ
        w.one.set_product(&j.gb, &b.u[1]);
        w.ax2.set_product(&i.gb, &b.u[0]);
        w.ax2.add_transpose(1.0, &w.one); // (Γ_j^b U_ji)ᵀ + Γ_i^b U_ij
        w.one.set_product(&i.ka, &w.xi);
        self.px.set_product_transposed(&w.one, &j.ka); // (46)
        self.u[0].set_product_transposed(&w.one, &j.gc); // (47)
        shifted(moved, n, (&b.u[0], &b.v), &mut w.one);
        self.u[0].add_product(1.0, &i.ka, &w.one);
        w.two.set_transpose(&w.xi);
        w.one.set_product(&j.ka, &w.two);
        self.u[1].set_product_transposed(&w.one, &i.gc); // (47), ji
        w.two.set_transpose(&b.v);
        shifted(moved, n, (&b.u[1], &w.two), &mut w.one);
        self.u[1].add_product(1.0, &j.ka, &w.one);
        self.inputs(b, &own_i.g, &own_j.g, w);
    }

    /// Ξ_ij of (50).
    fn expect(&self, n: usize, b: &Self, moved: Moved<'_>, w: &mut Work) {
        sandwich(moved, n, &b.px, (&mut w.one, &mut w.two), &mut w.xi);
        augmented(moved, n, &b.u[0], &mut w.one);
        augmented(moved, n, &b.u[1], &mut w.two);
        for q in 0..b.v.columns() {
            (0..w.one.rows()).for_each(|a| w.xi[(a, n + q)] -= w.one[(a, q)]);
        }
        for q in 0..b.v.rows() {
            (0..w.two.rows()).for_each(|a| w.xi[(n + q, a)] -= w.two[(a, q)]);
            (0..b.v.columns()).for_each(|l| w.xi[(n + q, n + l)] -= w.d[(q, l)]);
        }
    }

    /// (45), (48) and (49): P^φ, Y and V.
    fn inputs(&mut self, b: &Self, g_i: &Matrix, g_j: &Matrix, w: &mut Work) {
        let (core, both, xi1) = (&w.x2, &w.ax2, &w.d);
        self.pf.copy_from(core); // (45)
        self.pf.add(1.0, both);
        self.pf.add_product(1.0, g_i, xi1);
        self.pf.add(-1.0, xi1);
        self.pf.add_product_transposed(1.0, xi1, g_j);
        w.one.copy_from(core);
        w.one.add(1.0, both);
        self.y[0].set_zero(); // (48)
        self.y[0].add(-1.0, &w.one);
        self.y[0].add_product_transposed(-1.0, xi1, g_j);
        self.y[0].add(-1.0, &b.v);
        self.y[0].add_product(1.0, g_i, &b.v);
        w.three.set_transpose(xi1);
        self.y[1].set_zero(); // (48), ji
        self.y[1].add_transpose(-1.0, &w.one);
        self.y[1].add_product_transposed(-1.0, &w.three, g_i);
        w.three.set_transpose(&b.v);
        self.y[1].add(-1.0, &w.three);
        self.y[1].add_product(1.0, g_j, &w.three);
        self.v.copy_from(&w.one); // (49)
        self.v.add(1.0, &b.v);
        self.v.add_product_transposed(-1.0, &b.v, g_j);
        self.v.add_product(-1.0, g_i, &b.v);
    }
}
