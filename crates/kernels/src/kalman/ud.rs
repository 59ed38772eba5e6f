//! A covariance as P = U D Uᵀ, U unit upper triangular, D ≥ 0: positive semidefinite whatever the rounding.
//!
//! # References
//! Bierman 1977, *Factorization Methods for Discrete Sequential Estimation*, ch. V (measurement update) and
//! VI (Thornton's weighted Gram–Schmidt time update).

use crate::linalg::{axpy, dot};
use crate::{Error, Result};

/// Below this a variance is zero: it only keeps quotients of subnormal numbers out of U.
const FLOOR: f64 = f64::MIN_POSITIVE / (f64::EPSILON * f64::EPSILON);

/// Relative size of negative pivots that are still rounding.
const INDEFINITE: f64 = 1e-8;

/// P = U D Uᵀ.
#[derive(Debug, Clone, PartialEq)]
pub struct Ud {
    /// U by columns, (n, n): `u[j·n + i]` = U_ij for i < j; the rest is not used.
    pub u: Vec<f64>,
    /// Diagonal of D, (n,).
    pub d: Vec<f64>,
}

impl Ud {
    /// P = 0.
    #[must_use]
    pub fn zero(n: usize) -> Self {
        Self { u: vec![0.0; n * n], d: vec![0.0; n] }
    }

    /// The factors of a covariance (n, n).
    ///
    /// # Errors
    /// If `p` is not positive semidefinite; `argument` names it.
    pub fn new(argument: &'static str, p: &[f64], n: usize) -> Result<Self> {
        let (columns, weights) = semidefinite_factor(argument, p, n)?;
        let mut rows = transpose(&columns, weights.len(), n);
        let mut factors = Self::zero(n);
        factors.orthogonalise(&mut rows, &weights, &mut vec![0.0; weights.len()]);
        Ok(factors)
    }

    /// Column j of U above the diagonal.
    #[must_use]
    pub fn column(&self, j: usize) -> &[f64] {
        let n = self.d.len();
        &self.u[j * n..j * n + j]
    }

    /// Overwrite with `other`, without allocation.
    pub fn copy_from(&mut self, other: &Self) {
        self.u.copy_from_slice(&other.u);
        self.d.copy_from_slice(&other.d);
    }

    /// Condition on one scalar h x + v with Var v = 1; returns s = h P hᵀ + 1 and leaves P hᵀ / s in `gain`.
    ///
    /// `f` is scratch, (n,).
    pub fn condition(&mut self, h: &[f64], f: &mut [f64], gain: &mut [f64]) -> f64 {
        let n = self.d.len();
        for (j, value) in f.iter_mut().enumerate() {
            *value = h[j] + dot(self.column(j), &h[..j]); // f = Uᵀ h
        }
        let mut s = 1.0;
        for (j, &fj) in f.iter().enumerate() {
            let v = self.d[j] * fj;
            let next = s + fj * v;
            let lambda = -fj / s;
            self.d[j] *= s / next;
            let column = &mut self.u[j * n..j * n + j];
            for (u, b) in column.iter_mut().zip(gain.iter_mut()) {
                let old = *u;
                *u += lambda * *b;
                *b += old * v;
            }
            gain[j] = v;
            s = next;
        }
        let inverse = 1.0 / s;
        gain.iter_mut().for_each(|b| *b *= inverse);
        s
    }

    /// P ← diag(factors) P diag(factors), no factor zero.
    pub fn scale(&mut self, factors: &[f64]) {
        let n = self.d.len();
        for (j, d) in self.d.iter_mut().enumerate() {
            *d *= factors[j] * factors[j];
            for (u, factor) in self.u[j * n..j * n + j].iter_mut().zip(factors) {
                *u *= factor / factors[j];
            }
        }
    }

    /// `out` = P v; `f` is scratch, (n,).
    pub fn apply(&self, v: &[f64], f: &mut [f64], out: &mut [f64]) {
        for (j, value) in f.iter_mut().enumerate() {
            *value = self.d[j] * (v[j] + dot(self.column(j), &v[..j])); // D Uᵀ v
        }
        out.copy_from_slice(f);
        for (j, &value) in f.iter().enumerate() {
            axpy(value, self.column(j), out);
        }
    }

    /// s = h P hᵀ + 1, to the bit as [`Ud::condition`] returns it.
    #[must_use]
    pub fn variance(&self, h: &[f64]) -> f64 {
        self.d.iter().enumerate().fold(1.0, |s, (j, d)| {
            let f = h[j] + dot(self.column(j), &h[..j]);
            s + f * (d * f)
        })
    }

    /// Become the factors of W diag(weights) Wᵀ, W (n, weights.len()) by rows; W is destroyed.
    ///
    /// `weighted` is scratch, (weights.len(),).
    #[inline(always)]
    pub fn orthogonalise(&mut self, w: &mut [f64], weights: &[f64], weighted: &mut [f64]) {
        let (n, width) = (self.d.len(), weights.len());
        for j in (0..n).rev() {
            let (above, rest) = w.split_at_mut(j * width);
            let row = &rest[..width];
            for ((target, a), b) in weighted.iter_mut().zip(row).zip(weights) {
                *target = a * b;
            }
            let variance = dot(weighted, row);
            let column = &mut self.u[j * n..j * n + j];
            if variance <= FLOOR {
                self.d[j] = 0.0;
                column.fill(0.0);
                continue;
            }
            self.d[j] = variance;
            for (i, u) in column.iter_mut().enumerate() {
                let other = &mut above[i * width..(i + 1) * width];
                *u = dot(weighted, other) / variance;
                axpy(-*u, row, other);
            }
        }
    }

    /// Diagonal of P.
    pub fn variances(&self, out: &mut [f64]) {
        out.fill(0.0);
        for (j, &d) in self.d.iter().enumerate() {
            for (target, u) in out.iter_mut().zip(self.column(j)) {
                *target += d * u * u;
            }
            out[j] += d;
        }
    }

    /// P, (n, n); its diagonal is that of [`Ud::variances`] to the bit.
    pub fn covariance(&self, out: &mut [f64]) {
        let n = self.d.len();
        out.fill(0.0);
        for (j, &d) in self.d.iter().enumerate() {
            let column = self.column(j);
            for (i, &u) in column.iter().enumerate() {
                axpy(d * u, &column[..=i], &mut out[i * n..=i * n + i]);
            }
            axpy(d, column, &mut out[j * n..j * n + j]);
            out[j * n + j] += d;
        }
        for i in 0..n {
            for j in 0..i {
                out[j * n + i] = out[i * n + j];
            }
        }
    }

    /// P_ij, i ≤ j.
    fn entry(&self, i: usize, j: usize) -> f64 {
        let n = self.d.len();
        let unit = |row: usize, l: usize| if row == l { 1.0 } else { self.u[l * n + row] };
        (j..n).map(|l| self.d[l] * unit(i, l) * unit(j, l)).sum()
    }

    /// Whether every |P_ij − P'_ij| ≤ tolerance · std_i · std_j.
    ///
    /// `mine` and `theirs` are the variances of both.
    #[must_use]
    pub fn is_close(&self, other: &Self, mine: &[f64], theirs: &[f64], tolerance: f64) -> bool {
        let mut diagonal = mine.iter().zip(theirs);
        if !diagonal.all(|(a, b)| (a - b).abs() <= tolerance * a) {
            return false;
        }
        (0..mine.len()).all(|j| {
            (0..j).all(|i| {
                let change = (self.entry(i, j) - other.entry(i, j)).abs();
                change <= tolerance * (mine[i] * mine[j]).sqrt()
            })
        })
    }
}

/// A covariance P (n, n) as Σ weight_l g_l g_lᵀ: the columns g_l one after the other, and the weights.
///
/// Complete pivoting on the correlation matrix, so that small variances keep their relative accuracy.
///
/// # Errors
/// If `p` is not positive semidefinite; `argument` names it.
pub fn semidefinite_factor(argument: &'static str, p: &[f64], n: usize) -> Result<(Vec<f64>, Vec<f64>)> {
    Error::check_len(argument, n * n, p.len())?;
    let refuse = || Error::input(argument, "a positive semidefinite matrix", "an indefinite one");
    let scale: Vec<f64> = (0..n).map(|i| p[i * n + i].max(0.0).sqrt()).collect();
    let mut rest = correlation(p, &scale).ok_or_else(refuse)?;
    let (mut columns, mut weights) = (Vec::new(), Vec::new());
    loop {
        let pivot = (0..n).fold(0, |best, i| if rest[i * n + i] > rest[best * n + best] { i } else { best });
        let weight = rest[pivot * n + pivot];
        if weight <= n as f64 * f64::EPSILON {
            break;
        }
        let column: Vec<f64> = (0..n).map(|i| rest[i * n + pivot] / weight).collect();
        for i in 0..n {
            axpy(-weight * column[i], &column, &mut rest[i * n..(i + 1) * n]);
        }
        for i in 0..n {
            rest[i * n + pivot] = 0.0;
            rest[pivot * n + i] = 0.0;
        }
        columns.extend(column.iter().zip(&scale).map(|(g, s)| g * s));
        weights.push(weight);
    }
    if rest.iter().any(|value| value.abs() > INDEFINITE) {
        return Err(refuse());
    }
    Ok((columns, weights))
}

/// P_ij / (scale_i scale_j), zero where a scale is; None if P is not finite or cannot be a covariance.
fn correlation(p: &[f64], scale: &[f64]) -> Option<Vec<f64>> {
    let n = scale.len();
    let mut out = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..n {
            let (value, size) = (p[i * n + j], scale[i] * scale[j]);
            if size > 0.0 {
                out[i * n + j] = value / scale[i] / scale[j];
            } else if value != 0.0 {
                return None;
            }
        }
    }
    out.iter().all(|value| value.is_finite()).then_some(out)
}

/// Aᵀ of A (rows, columns), row-major.
#[must_use]
pub fn transpose(a: &[f64], rows: usize, columns: usize) -> Vec<f64> {
    let mut out = vec![0.0; a.len()];
    for i in 0..rows {
        for j in 0..columns {
            out[j * rows + i] = a[i * columns + j];
        }
    }
    out
}
