//! The direction in which a cloud of points is widest, by Jacobi rotations.

/// Sweeps over all pairs of states after which every practical matrix is diagonal.
const SWEEPS: usize = 30;

/// √λ e for the largest eigenvalue λ of the symmetric matrix `s` (n, n), which is destroyed, and its unit vector e,
/// whose largest entry is positive. `vectors` is scratch, (n, n).
pub fn widest(s: &mut [f64], vectors: &mut [f64], n: usize, out: &mut [f64]) {
    vectors.iter_mut().enumerate().for_each(|(k, v)| *v = f64::from(u8::from(k % (n + 1) == 0)));
    for _ in 0..SWEEPS {
        let mut rotated = false;
        for p in 0..n {
            for q in p + 1..n {
                rotated |= rotate(s, vectors, n, p, q);
            }
        }
        if !rotated {
            break;
        }
    }
    let best = (0..n).fold(0, |best, i| if s[i * n + i] > s[best * n + best] { i } else { best });
    let axis = &vectors[best * n..(best + 1) * n];
    let largest = axis.iter().fold(0.0_f64, |a, &b| if b.abs() > a.abs() { b } else { a });
    let length = s[best * n + best].max(0.0).sqrt().copysign(largest);
    out.iter_mut().zip(axis).for_each(|(target, value)| *target = length * value);
}

/// Make s_pq zero by a rotation of rows and columns p and q; false if it was nothing beside its diagonal. Rows of
/// `vectors` turn along.
fn rotate(s: &mut [f64], vectors: &mut [f64], n: usize, p: usize, q: usize) -> bool {
    let (app, aqq, apq) = (s[p * n + p], s[q * n + q], s[p * n + q]);
    let size = app.abs().max(f64::MIN_POSITIVE).sqrt() * aqq.abs().max(f64::MIN_POSITIVE).sqrt();
    if apq.abs() <= f64::EPSILON * size {
        return false;
    }
    let theta = (aqq - app) / (2.0 * apq);
    let t = 1.0_f64.copysign(theta) / (theta.abs() + theta.hypot(1.0));
    let cosine = 1.0 / t.hypot(1.0);
    let sine = t * cosine;
    for k in 0..n {
        let (a, b) = (s[k * n + p], s[k * n + q]);
        (s[k * n + p], s[k * n + q]) = (cosine * a - sine * b, sine * a + cosine * b);
    }
    for k in 0..n {
        let (a, b) = (s[p * n + k], s[q * n + k]);
        (s[p * n + k], s[q * n + k]) = (cosine * a - sine * b, sine * a + cosine * b);
        let (a, b) = (vectors[p * n + k], vectors[q * n + k]);
        (vectors[p * n + k], vectors[q * n + k]) = (cosine * a - sine * b, sine * a + cosine * b);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_longest_axis_of_an_ellipsoid_with_its_largest_entry_positive() {
        let axis = [0.36, -0.48, 0.8];
        let mut s = [0.0; 9];
        for i in 0..3 {
            for j in 0..3 {
                s[3 * i + j] = 8.0 * axis[i] * axis[j] + if i == j { 1.0 } else { 0.0 };
            }
        }
        let mut out = [0.0; 3];
        widest(&mut s, &mut [0.0; 9], 3, &mut out);
        for (got, want) in out.iter().zip(axis) {
            assert!((got - 3.0 * want).abs() < 1e-12, "{out:?}");
        }
    }

    #[test]
    fn a_point_has_no_axis() {
        let mut out = [1.0; 2];
        widest(&mut [0.0; 4], &mut [0.0; 4], 2, &mut out);
        assert_eq!(out.map(f64::abs), [0.0, 0.0]);
    }
}
