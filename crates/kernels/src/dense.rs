//! Products and eliminations of matrices too large for plain loops: tiles of four rows that stay in registers.
//!
//! Every function is inlined into its caller, so that a caller compiled for AVX2 (see [`Arithmetic`]) gets it in AVX2.
//! Tiles multiply and add in one operation where the processor has it: there the last bits differ from other machines.

use pulp::{Arch, Simd, WithSimd};

/// Rows of a tile.
const ROWS: usize = 4;

/// What the processor at hand can do.
#[derive(Debug, Clone, Copy)]
pub struct Arithmetic {
    arch: Arch,
    /// It multiplies and adds in one operation.
    fused: bool,
}

impl Default for Arithmetic {
    fn default() -> Self {
        struct Fused;
        impl WithSimd for Fused {
            type Output = bool;
            #[inline(always)]
            fn with_simd<S: Simd>(self, _: S) -> bool {
                !S::IS_SCALAR
            }
        }
        let arch = Arch::new();
        Self { arch, fused: arch.dispatch(Fused) }
    }
}

impl Arithmetic {
    /// Do `work` compiled for this processor.
    pub fn run<W: Work>(self, work: W) -> W::Output {
        self.arch.dispatch(Dispatched(work))
    }
}

/// Work that is compiled once more for AVX2.
pub trait Work {
    /// What it returns.
    type Output;

    /// The work; must be `#[inline(always)]`.
    fn run(self) -> Self::Output;
}

struct Dispatched<W>(W);

impl<W: Work> WithSimd for Dispatched<W> {
    type Output = W::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> W::Output {
        self.0.run()
    }
}

/// Σ_l a_l[i + r] b_l[c..c + C] for r < 4: the rows l of two matrices of rows `a_width` and `b_width` long.
#[inline(always)]
fn tile<const C: usize, const FUSED: bool>(
    (a, a_width, i): (&[f64], usize, usize),
    (b, b_width, c): (&[f64], usize, usize),
    depth: usize,
) -> [[f64; C]; ROWS] {
    let mut sum = [[0.0; C]; ROWS];
    for l in 0..depth {
        let a = a.get(l * a_width + i..).and_then(|a| a.first_chunk::<ROWS>());
        let b = b.get(l * b_width + c..).and_then(|b| b.first_chunk::<C>());
        let (Some(a), Some(b)) = (a, b) else { break };
        for (sum, &factor) in sum.iter_mut().zip(a) {
            for (target, &value) in sum.iter_mut().zip(b) {
                *target = if FUSED { factor.mul_add(value, *target) } else { *target + factor * value };
            }
        }
    }
    sum
}

/// Columns `from..to` of `out`, four rows of length b_width, += sign · A[i..i + 4] B, A given by its transpose.
#[inline(always)]
fn four_rows(
    arithmetic: Arithmetic,
    sign: f64,
    a: (&[f64], usize, usize),
    (b, b_width): (&[f64], usize),
    (from, to, depth): (usize, usize, usize),
    out: &mut [f64],
    width: usize,
) {
    if arithmetic.fused {
        four_rows_by::<true>(sign, a, (b, b_width), (from, to, depth), out, width);
    } else {
        four_rows_by::<false>(sign, a, (b, b_width), (from, to, depth), out, width);
    }
}

#[inline(always)]
fn four_rows_by<const FUSED: bool>(
    sign: f64,
    a: (&[f64], usize, usize),
    (b, b_width): (&[f64], usize),
    (from, to, depth): (usize, usize, usize),
    out: &mut [f64],
    width: usize,
) {
    let mut c = from;
    while c + 8 <= to {
        add(sign, &tile::<8, FUSED>(a, (b, b_width, c), depth), c, width, out);
        c += 8;
    }
    if c + 4 <= to {
        add(sign, &tile::<4, FUSED>(a, (b, b_width, c), depth), c, width, out);
        c += 4;
    }
    while c < to {
        add(sign, &tile::<1, FUSED>(a, (b, b_width, c), depth), c, width, out);
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

/// `out` (rows, width) = A B, all by rows: A by its transpose (depth, rows), B (depth, width).
#[inline(always)]
pub fn multiply(arithmetic: Arithmetic, a_t: &[f64], rows: usize, b: &[f64], width: usize, out: &mut [f64]) {
    out.fill(0.0);
    let depth = a_t.len().checked_div(rows).unwrap_or(0);
    let mut i = 0;
    while i + ROWS <= rows {
        let target = &mut out[i * width..(i + ROWS) * width];
        four_rows(arithmetic, 1.0, (a_t, rows, i), (b, width), (0, width, depth), target, width);
        i += ROWS;
    }
    for i in i..rows {
        let target = &mut out[i * width..(i + 1) * width];
        for l in 0..depth {
            add_row(a_t[l * rows + i], &b[l * width..(l + 1) * width], target);
        }
    }
}

/// The upper triangle of `out` (n, stride) += Sᵀ S, S (rows, n).
#[inline(always)]
pub fn add_gram(arithmetic: Arithmetic, s: &[f64], n: usize, out: &mut [f64], stride: usize) {
    let rows = s.len() / n;
    let mut i = 0;
    while i + ROWS <= n {
        four_rows(arithmetic, 1.0, (s, n, i), (s, n), (i, n, rows), &mut out[i * stride..], stride);
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
pub fn eliminate(arithmetic: Arithmetic, work: &mut [f64], n: usize, width: usize) {
    let mut j = 0;
    while j + ROWS <= n {
        let (done, rest) = work.split_at_mut(j * width);
        let rows = &mut rest[..ROWS * width];
        four_rows(arithmetic, -1.0, (done, width, j), (done, width), (j, width, j), rows, width);
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

/// `out` (columns, rows) = Aᵀ of A (rows, columns), a few rows at a time so that what is written stays together.
#[inline(always)]
pub fn transpose(a: &[f64], columns: usize, out: &mut [f64]) {
    const BLOCK: usize = 8;
    let rows = a.len().checked_div(columns).unwrap_or(0);
    for from in (0..rows).step_by(BLOCK) {
        let to = (from + BLOCK).min(rows);
        for j in 0..columns {
            for (i, target) in out[j * rows + from..j * rows + to].iter_mut().enumerate() {
                *target = a[(from + i) * columns + j];
            }
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
        let arithmetic = Arithmetic::default();
        for rows in 1..11 {
            for width in 1..20 {
                let depth = 1 + (rows * width) % 7;
                let (a, b) = (numbers(rows * depth, 1), numbers(depth * width, 2));
                let mut out = vec![7.0; rows * width];
                let mut a_t = vec![0.0; a.len()];
                transpose(&a, depth, &mut a_t);
                multiply(arithmetic, &a_t, rows, &b, width, &mut out);
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
        let arithmetic = Arithmetic::default();
        for n in 1..15 {
            for extra in [0, 1, 3, 8, 17] {
                let width = n + extra;
                let (s, b) = (numbers((n + 3) * n, n), numbers(n * extra, 3));
                let mut work = vec![0.0; n * width];
                for i in 0..n {
                    work[i * width + i] = 1.0;
                    work[i * width + n..(i + 1) * width].copy_from_slice(&b[i * extra..(i + 1) * extra]);
                }
                add_gram(arithmetic, &s, n, &mut work, width);
                let j = work.clone();
                eliminate(arithmetic, &mut work, n, width);
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
