//! Small dense linear algebra on flat row-major `f64`, in place, without allocation.

/// Σ a_i b_i, summed in eight lanes so that the compiler can use vector registers and hide their latency.
#[must_use]
#[inline(always)]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let (a8, a_rest) = a.as_chunks::<8>();
    let (b8, b_rest) = b.as_chunks::<8>();
    for (p, q) in a8.iter().zip(b8) {
        for lane in 0..8 {
            lanes[lane] += p[lane] * q[lane];
        }
    }
    let tail: f64 = a_rest.iter().zip(b_rest).map(|(p, q)| p * q).sum();
    let half = [lanes[0] + lanes[4], lanes[1] + lanes[5], lanes[2] + lanes[6], lanes[3] + lanes[7]];
    (half[0] + half[2]) + (half[1] + half[3]) + tail
}

/// y += alpha x
#[inline(always)]
pub fn axpy(alpha: f64, x: &[f64], y: &mut [f64]) {
    for (target, value) in y.iter_mut().zip(x) {
        *target += alpha * value;
    }
}

/// y = A x, A row-major (rows, columns) with `columns = x.len()`.
pub fn gemv(a: &[f64], x: &[f64], y: &mut [f64]) {
    if x.is_empty() {
        y.fill(0.0);
        return;
    }
    for (row, target) in a.chunks_exact(x.len()).zip(y) {
        *target = dot(row, x);
    }
}

/// y += A x, A row-major (rows, columns) with `columns = x.len()`.
pub fn add_gemv(a: &[f64], x: &[f64], y: &mut [f64]) {
    if x.is_empty() {
        return;
    }
    for (row, target) in a.chunks_exact(x.len()).zip(y) {
        *target += dot(row, x);
    }
}

/// y += Aᵀ x, A row-major (rows, columns) with `columns = y.len()`: one pass over the rows of A.
pub fn add_gemv_transposed(a: &[f64], x: &[f64], y: &mut [f64]) {
    if y.is_empty() {
        return;
    }
    for (row, &value) in a.chunks_exact(y.len()).zip(x) {
        if value != 0.0 {
            axpy(value, row, y);
        }
    }
}

/// Euclidean norm.
#[must_use]
pub fn norm(x: &[f64]) -> f64 {
    dot(x, x).sqrt()
}

/// Lower Cholesky factor of the leading (k, k) part of `a` (row stride `stride`), in place, lower triangle only.
///
/// Returns the first pivot that is not larger than `tolerance` times its diagonal entry, if there is one.
///
/// # Errors
/// The index of the failing pivot.
pub fn cholesky(a: &mut [f64], k: usize, stride: usize, tolerance: f64) -> Result<(), usize> {
    for i in 0..k {
        let (done, rest) = a.split_at_mut(i * stride);
        let row = &mut rest[..=i];
        let diagonal = row[i];
        for j in 0..i {
            let above = &done[j * stride..=j * stride + j];
            row[j] = (row[j] - dot(&row[..j], &above[..j])) / above[j];
        }
        let pivot = diagonal - dot(&row[..i], &row[..i]);
        if pivot.is_nan() || pivot <= tolerance * diagonal || pivot <= 0.0 {
            return Err(i);
        }
        row[i] = pivot.sqrt();
    }
    Ok(())
}

/// Solve L Lᵀ x = b in place, L as [`cholesky`] leaves it.
pub fn cholesky_solve(l: &[f64], stride: usize, x: &mut [f64]) {
    forward_solve(l, stride, x);
    backward_solve(l, stride, x);
}

/// Solve L x = b in place.
pub fn forward_solve(l: &[f64], stride: usize, x: &mut [f64]) {
    for i in 0..x.len() {
        let row = &l[i * stride..=i * stride + i];
        x[i] = (x[i] - dot(&row[..i], &x[..i])) / row[i];
    }
}

/// Solve Lᵀ x = b in place.
pub fn backward_solve(l: &[f64], stride: usize, x: &mut [f64]) {
    for i in (0..x.len()).rev() {
        x[i] /= l[i * stride + i];
        let value = x[i];
        axpy(-value, &l[i * stride..i * stride + i], &mut x[..i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spd(k: usize) -> Vec<f64> {
        let g: Vec<f64> = (0..k * k).map(|i| f64::from((i * 37 % 17) as u32) / 7.0 - 1.0).collect();
        let mut a = vec![0.0; k * k];
        for i in 0..k {
            for j in 0..k {
                a[i * k + j] =
                    dot(&g[i * k..(i + 1) * k], &g[j * k..(j + 1) * k]) + if i == j { 1.0 } else { 0.0 };
            }
        }
        a
    }

    #[test]
    fn cholesky_solves_every_size() {
        for k in 1..12 {
            let a = spd(k);
            let x: Vec<f64> = (0..k).map(|i| i as f64 - 2.5).collect();
            let mut b = vec![0.0; k];
            gemv(&a, &x, &mut b);
            let mut l = a.clone();
            cholesky(&mut l, k, k, 0.0).unwrap();
            cholesky_solve(&l, k, &mut b);
            for (got, want) in b.iter().zip(&x) {
                assert!((got - want).abs() < 1e-9, "size {k}");
            }
        }
    }

    #[test]
    fn a_singular_matrix_names_its_pivot() {
        let mut a = vec![1.0, 1.0, 1.0, 1.0];
        assert_eq!(cholesky(&mut a, 2, 2, 1e-12), Err(1));
    }

    #[test]
    fn transposed_product_matches_the_plain_one() {
        let a = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let mut y = [0.0; 3];
        add_gemv_transposed(&a, &[2.0, -1.0], &mut y);
        assert_eq!(y, [-2.0, -1.0, 0.0]);
    }
}
