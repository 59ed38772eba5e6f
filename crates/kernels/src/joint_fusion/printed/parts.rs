//! Products that several of the printed equations share.

use std::ops::Range;

use crate::linalg::axpy;
use crate::matrix::Matrix;

/// A of the last step and Q; None before the first sample, when nothing has moved yet.
pub type Moved<'a> = Option<(&'a [f64], &'a [f64])>;

/// Room for one local or one pair.
#[derive(Debug, Clone)]
pub struct Work {
    /// Ξ¹.
    pub d: Matrix,
    /// Ξ².
    pub x2: Matrix,
    /// A^a Ξ².
    pub ax2: Matrix,
    /// Ξ.
    pub xi: Matrix,
    /// S.
    pub s: Matrix,
    /// For anything.
    pub one: Matrix,
    /// For anything.
    pub two: Matrix,
    /// For anything.
    pub three: Matrix,
}

impl Work {
    /// Room for matrices of as many numbers.
    #[must_use]
    pub fn room(numbers: usize) -> Self {
        let room = || Matrix::room(numbers);
        Self {
            d: room(),
            x2: room(),
            ax2: room(),
            xi: room(),
            s: room(),
            one: room(),
            two: room(),
            three: room(),
        }
    }
}

/// `out` = some columns.
pub fn keep_columns(m: &Matrix, columns: Range<usize>, out: &mut Matrix) {
    out.shape(m.rows(), columns.len());
    (0..m.rows()).for_each(|a| out.row_mut(a).copy_from_slice(&m.row(a)[columns.clone()]));
}

/// `out` = M diag(factors).
pub fn scale_columns(m: &Matrix, factors: &[f64], out: &mut Matrix) {
    out.copy_from(m);
    (0..m.rows())
        .for_each(|a| out.row_mut(a).iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor));
}

/// `out` = A^a M.
pub fn augmented(moved: Moved<'_>, n: usize, m: &Matrix, out: &mut Matrix) {
    out.copy_from(m);
    let Some((a, _)) = moved else { return };
    for i in 0..n {
        let row = out.row_mut(i);
        row.fill(0.0);
        for (l, &value) in a[i * n..(i + 1) * n].iter().enumerate() {
            axpy(value, m.row(l), row);
        }
    }
}

/// `out` = A_i^a M (A_j^a)ᵀ + Q^a.
pub fn sandwich(
    moved: Moved<'_>,
    n: usize,
    m: &Matrix,
    (one, two): (&mut Matrix, &mut Matrix),
    out: &mut Matrix,
) {
    augmented(moved, n, m, one);
    two.set_transpose(one);
    augmented(moved, n, two, one);
    out.set_transpose(one);
    let Some((_, q)) = moved else { return };
    (0..n).for_each(|a| axpy(1.0, &q[a * n..(a + 1) * n], &mut out.row_mut(a)[..n]));
}

/// `out` = A^a U − F V.
pub fn shifted(moved: Moved<'_>, n: usize, (u, v): (&Matrix, &Matrix), out: &mut Matrix) {
    augmented(moved, n, u, out);
    for q in 0..v.rows() {
        axpy(-1.0, v.row(q), out.row_mut(n + q));
    }
}
