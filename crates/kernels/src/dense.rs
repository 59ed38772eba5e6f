//! Products and eliminations of matrices too large for plain loops: tiles of four rows that stay in registers.
//!
//! Every function is inlined into its caller, so that a caller compiled for AVX2 (see [`Vectorised`]) gets it in AVX2.
//! No operation is fused and every sum keeps its order: the bits are the same on every processor.

use pulp::{Arch, Simd, WithSimd};

/// Rows of a tile.
const ROWS: usize = 4;

/// Work that is compiled for AVX2 too and runs so where the processor can.
pub trait Vectorised {
    /// What it returns.
    type Output;

    /// The work; must be `#[inline(always)]`.
    fn run(self) -> Self::Output;

    /// Do it.
    fn vectorised(self, arch: Arch) -> Self::Output
    where
        Self: Sized,
    {
        arch.dispatch(Dispatched(self))
    }
}

struct Dispatched<W>(W);

impl<W: Vectorised> WithSimd for Dispatched<W> {
    type Output = W::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> W::Output {
        self.0.run()
    }
}

/// A matrix as numbers with the distance of its rows and of its columns.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// The numbers.
    pub data: &'a [f64],
    /// Distance between rows.
    pub row: usize,
    /// Distance between columns.
    pub column: usize,
}

impl<'a> View<'a> {
    /// Rows one after the other, each `width` long.
    #[must_use]
    pub fn rows(data: &'a [f64], width: usize) -> Self {
        Self { data, row: width, column: 1 }
    }

    /// Its transpose.
    #[must_use]
    pub fn transposed(self) -> Self {
        Self { row: self.column, column: self.row, ..self }
    }
}

/// Σ_l a(i + r, l) b_l[c..c + C] for r < 4, l < depth; `b` has rows of length `width`.
#[inline(always)]
fn tile<const C: usize>(
    a: View<'_>,
    i: usize,
    b: &[f64],
    width: usize,
    c: usize,
    depth: usize,
) -> [[f64; C]; ROWS] {
    let mut sum = [[0.0; C]; ROWS];
    for l in 0..depth {
        let Some(b) = b.get(l * width + c..).and_then(|b| b.first_chunk::<C>()) else { break };
        for (r, sum) in sum.iter_mut().enumerate() {
            let factor = a.data[(i + r) * a.row + l * a.column];
            for (target, value) in sum.iter_mut().zip(b) {
                *target += factor * value;
            }
        }
    }
    sum
}

/// `out`[i..i + 4, from..to] += sign · A[i..i + 4, ..depth] B, all of row length `width` but A.
#[inline(always)]
fn four_rows(
    sign: f64,
    a: View<'_>,
    i: usize,
    b: &[f64],
    (width, depth): (usize, usize),
    (from, to): (usize, usize),
    out: &mut [f64],
) {
    let mut c = from;
    while c + 8 <= to {
        let sum = tile::<8>(a, i, b, width, c, depth);
        add(sign, &sum, c, width, out);
        c += 8;
    }
    if c + 4 <= to {
        let sum = tile::<4>(a, i, b, width, c, depth);
        add(sign, &sum, c, width, out);
        c += 4;
    }
    while c < to {
        let sum = tile::<1>(a, i, b, width, c, depth);
        add(sign, &sum, c, width, out);
        c += 1;
    }
}

#[inline(always)]
fn add<const C: usize>(sign: f64, sum: &[[f64; C]; ROWS], c: usize, width: usize, out: &mut [f64]) {
    for (r, sum) in sum.iter().enumerate() {
        for (target, value) in out[r * width + c..r * width + c + C].iter_mut().zip(sum) {
            *target += sign * value;
        }
    }
}

#[inline(always)]
fn add_row(factor: f64, row: &[f64], out: &mut [f64]) {
    for (target, value) in out.iter_mut().zip(row) {
        *target += factor * value;
    }
}

/// `out` = A B: A (rows, depth), B (depth, width) and `out` (rows, width) by rows.
#[inline(always)]
pub fn multiply(a: View<'_>, depth: usize, b: &[f64], width: usize, out: &mut [f64]) {
    out.fill(0.0);
    let rows = out.len().checked_div(width).unwrap_or(0);
    let mut i = 0;
    while i + ROWS <= rows {
        four_rows(1.0, a, i, b, (width, depth), (0, width), &mut out[i * width..(i + ROWS) * width]);
        i += ROWS;
    }
    for i in i..rows {
        let target = &mut out[i * width..(i + 1) * width];
        for l in 0..depth {
            add_row(a.data[i * a.row + l * a.column], &b[l * width..(l + 1) * width], target);
        }
    }
}

/// The upper triangle of `out` (n, stride) += Sᵀ S, S (rows, n).
#[inline(always)]
pub fn add_gram(s: &[f64], n: usize, out: &mut [f64], stride: usize) {
    let rows = s.len() / n;
    let a = View::rows(s, n).transposed();
    let mut i = 0;
    while i + ROWS <= n {
        let target = &mut out[i * stride..];
        let mut c = i;
        while c + 8 <= n {
            add(1.0, &tile::<8>(a, i, s, n, c, rows), c, stride, target);
            c += 8;
        }
        if c + 4 <= n {
            add(1.0, &tile::<4>(a, i, s, n, c, rows), c, stride, target);
            c += 4;
        }
        while c < n {
            add(1.0, &tile::<1>(a, i, s, n, c, rows), c, stride, target);
            c += 1;
        }
        i += ROWS;
    }
    for row in s.chunks_exact(n) {
        for i in i..n {
            add_row(row[i], &row[i..], &mut out[i * stride + i..i * stride + n]);
        }
    }
}

/// From [J | B] (n, width), J − I positive semidefinite and J given by its upper triangle, to [U | U⁻ᵀ B] with
/// J = Uᵀ U, U upper triangular. No pivot of such a J is below 1, and none is taken for less: where J is so large that
/// rounding hides the 1, the result is wrong there and still finite.
#[inline(always)]
pub fn eliminate(work: &mut [f64], n: usize, width: usize) {
    let mut j = 0;
    while j + ROWS <= n {
        let (done, rest) = work.split_at_mut(j * width);
        let rows = &mut rest[..ROWS * width];
        four_rows(-1.0, View::rows(done, width).transposed(), j, done, (width, j), (j, width), rows);
        for r in 0..ROWS {
            let (above, row) = rows.split_at_mut(r * width);
            finish(above, j, r, &mut row[..width]);
        }
        j += ROWS;
    }
    for j in j..n {
        let (above, row) = work.split_at_mut(j * width);
        finish(above, 0, j, &mut row[..width]);
    }
}

/// Row `first + count` of the elimination: take away the `count` rows of `above`, then divide by the root of the pivot.
#[inline(always)]
fn finish(above: &[f64], first: usize, count: usize, row: &mut [f64]) {
    let (j, width) = (first + count, row.len());
    for above in above.chunks_exact(width) {
        add_row(-above[j], &above[j..], &mut row[j..]);
    }
    row[j] = row[j].max(1.0);
    let inverse = 1.0 / row[j].sqrt();
    row[j..].iter_mut().for_each(|value| *value *= inverse);
}

/// `out` (columns, rows) = Aᵀ of A (rows, columns).
#[inline(always)]
pub fn transpose(a: &[f64], columns: usize, out: &mut [f64]) {
    let rows = a.len().checked_div(columns).unwrap_or(0);
    for (i, row) in a.chunks_exact(columns.max(1)).enumerate() {
        for (j, &value) in row.iter().enumerate() {
            out[j * rows + i] = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, seed: usize) -> Vec<f64> {
        (0..count).map(|i| ((i * 37 + seed * 11) % 101) as f64 / 50.0 - 1.0).collect()
    }

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-12 * (1.0 + a.abs())
    }

    #[test]
    fn products_of_every_size_equal_the_sums_that_define_them() {
        for rows in 1..11 {
            for width in 1..20 {
                let depth = 1 + (rows * width) % 7;
                let (a, b) = (numbers(rows * depth, 1), numbers(depth * width, 2));
                let mut out = vec![7.0; rows * width];
                multiply(View::rows(&a, depth), depth, &b, width, &mut out);
                for i in 0..rows {
                    for c in 0..width {
                        let sum: f64 = (0..depth).map(|l| a[i * depth + l] * b[l * width + c]).sum();
                        assert!(close(out[i * width + c], sum), "{rows} {width}");
                    }
                }
            }
        }
    }

    #[test]
    fn elimination_of_every_size_solves_the_triangular_system() {
        for n in 1..15 {
            for extra in [0, 1, 3, 8, 17] {
                let width = n + extra;
                let (s, b) = (numbers((n + 3) * n, n), numbers(n * extra, 3));
                let mut work = vec![0.0; n * width];
                for i in 0..n {
                    work[i * width + i] = 1.0;
                    work[i * width + n..(i + 1) * width].copy_from_slice(&b[i * extra..(i + 1) * extra]);
                }
                add_gram(&s, n, &mut work, width);
                let j = work.clone();
                eliminate(&mut work, n, width);
                for a in 0..n {
                    for c in a..width {
                        // Uᵀ [U | U⁻ᵀ B] = [J | B]
                        let sum: f64 = (0..=a).map(|l| work[l * width + a] * work[l * width + c]).sum();
                        assert!(close(j[a * width + c], sum), "{n} {extra}");
                    }
                }
            }
        }
    }
}
