//! What the states of a record were, given all of it, while channels are missing one by one.
//!
//! x[k+1] = A x[k] + g[k] + w[k],  y[k] = C x[k] + v[k],  w ~ N(0, Q),  v ~ N(0, diag r),  x[0] ~ N(0, P0)
//!
//! Forwards a Kalman filter that takes one channel at a time; backwards, with J = P[k|k] Aᵀ P[k+1|k]⁻¹,
//!
//! x[k|N] = x[k|k] + J (x[k+1|N] − x[k+1|k]),   P[k|N] = P[k|k] + J (P[k+1|N] − P[k+1|k]) Jᵀ
//!
//! # References
//! Rauch, Tung, Striebel 1965.

use std::f64::consts::TAU;

use crate::linalg::{axpy, cholesky, cholesky_solve, dot, gemv};
use crate::matrix::Matrix;
use crate::{Error, Result};

/// The model, row-major: `a` (n, n), `c` (m, n), `q` (n, n), `r` (m), `start` P0 (n, n).
#[derive(Debug, Clone)]
pub struct Smoother {
    a: Matrix,
    c: Matrix,
    q: Matrix,
    r: Vec<f64>,
    start: Matrix,
}

/// Sums of smoothed covariances over one segment, and the likelihood of what was read.
#[derive(Debug)]
pub struct Sums {
    /// Σ P[k|N] over all samples, (n, n).
    pub whole: Matrix,
    /// P[0|N], (n, n).
    pub first: Matrix,
    /// P[N-1|N], (n, n).
    pub last: Matrix,
    /// Σ cov(x[k], x[k+1] | all), (n, n).
    pub crossed: Matrix,
    /// Σ P[k|N] over the samples at which a channel is missing, one (n, n) per channel.
    pub absent: Vec<Matrix>,
    /// log p(y), nats.
    pub likelihood: f64,
}

/// Room for the work of one step.
struct Work {
    moved: Matrix,
    predicted: Matrix,
    factor: Matrix,
    gain: Matrix,
    change: Matrix,
    x: Vec<f64>,
    seen: Vec<f64>,
}

impl Smoother {
    /// From numbers by rows.
    ///
    /// # Errors
    /// A wrong length.
    pub fn new(a: &[f64], c: &[f64], q: &[f64], r: &[f64], start: &[f64]) -> Result<Self> {
        let m = r.len();
        let n = c.len().checked_div(m).unwrap_or(0);
        Error::check_len("C", m * n, c.len())?;
        for (name, numbers) in [("A", a), ("Q", q), ("start", start)] {
            Error::check_len(name, n * n, numbers.len())?;
        }
        let square = |numbers| Matrix::from_rows(n, n, numbers);
        Ok(Self {
            a: square(a),
            c: Matrix::from_rows(m, n, c),
            q: square(q),
            r: r.to_vec(),
            start: square(start),
        })
    }

    /// Smooth one segment: `drive` g (N, n), `y` (N, m) with NaN where missing; `states` (N, n) receives x[k|N].
    ///
    /// # Errors
    /// A wrong length, or a predicted covariance that is not positive definite.
    pub fn smooth(&self, drive: &[f64], y: &[f64], states: &mut [f64]) -> Result<Sums> {
        let (n, m) = (self.a.rows(), self.r.len());
        let steps = y.len().checked_div(m).unwrap_or(0);
        Error::check_len("y", steps * m, y.len())?;
        Error::check_len("drive", steps * n, drive.len())?;
        Error::check_len("states", steps * n, states.len())?;
        let mut covariances = vec![0.0; steps * n * n];
        let mut work = Work::new(n);
        let likelihood = self.forwards(drive, y, states, &mut covariances, &mut work);
        let mut sums = Sums::new(n, m, likelihood);
        self.backwards(drive, y, states, &covariances, &mut sums, &mut work)?;
        Ok(sums)
    }

    /// The filter; `states` and `covariances` receive x[k|k] and P[k|k].
    fn forwards(
        &self,
        drive: &[f64],
        y: &[f64],
        states: &mut [f64],
        covariances: &mut [f64],
        work: &mut Work,
    ) -> f64 {
        let (n, m) = (self.a.rows(), self.r.len());
        let mut p = self.start.clone();
        let mut x = vec![0.0; n];
        let mut likelihood = 0.0;
        for (k, sample) in y.chunks_exact(m).enumerate() {
            for (i, &value) in sample.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
                likelihood += self.hear(i, value, &mut x, &mut p, &mut work.seen);
            }
            states[k * n..(k + 1) * n].copy_from_slice(&x);
            covariances[k * n * n..(k + 1) * n * n].copy_from_slice(p.numbers());
            self.predict(&p, work);
            std::mem::swap(&mut p, &mut work.predicted);
            gemv(self.a.numbers(), &x, &mut work.x);
            axpy(1.0, &drive[k * n..(k + 1) * n], &mut work.x);
            x.copy_from_slice(&work.x);
        }
        likelihood
    }

    /// Condition on one channel; the logarithm of its density.
    fn hear(&self, i: usize, value: f64, x: &mut [f64], p: &mut Matrix, seen: &mut [f64]) -> f64 {
        let c = self.c.row(i);
        gemv(p.numbers(), c, seen);
        let s = dot(c, seen) + self.r[i];
        let e = value - dot(c, x);
        axpy(e / s, seen, x);
        for (a, &factor) in seen.iter().enumerate() {
            axpy(-factor / s, seen, p.row_mut(a));
        }
        -0.5 * (e * e / s + (TAU * s).ln())
    }

    /// `work.moved` = A P, `work.predicted` = A P Aᵀ + Q.
    fn predict(&self, p: &Matrix, work: &mut Work) {
        work.moved.set_product(&self.a, p);
        work.predicted.set_product_transposed(&work.moved, &self.a);
        work.predicted.add(1.0, &self.q);
        work.predicted.symmetrise();
    }

    /// The smoother; `states` become x[k|N].
    fn backwards(
        &self,
        drive: &[f64],
        y: &[f64],
        states: &mut [f64],
        covariances: &[f64],
        sums: &mut Sums,
        work: &mut Work,
    ) -> Result<()> {
        let (n, m) = (self.a.rows(), self.r.len());
        let steps = y.len() / m;
        let Some(end) = steps.checked_sub(1) else { return Ok(()) };
        let mut later = Matrix::from_rows(n, n, &covariances[end * n * n..]);
        let mut p = Matrix::zeros(n, n);
        sums.last.copy_from(&later);
        sums.count(&later, &y[end * m..]);
        for k in (0..end).rev() {
            p.numbers_mut().copy_from_slice(&covariances[k * n * n..(k + 1) * n * n]);
            self.predict(&p, work);
            work.factor.copy_from(&work.predicted);
            cholesky(work.factor.numbers_mut(), n, n, 0.0).map_err(|pivot| {
                Error::input("Q", "a covariance that reaches every state", format!("pivot {pivot}"))
            })?;
            work.gain.set_transpose(&work.moved);
            for i in 0..n {
                cholesky_solve(work.factor.numbers(), n, work.gain.row_mut(i));
            }
            let (before, after) = states.split_at_mut((k + 1) * n);
            let x = &mut before[k * n..];
            gemv(self.a.numbers(), x, &mut work.x);
            axpy(1.0, &drive[k * n..(k + 1) * n], &mut work.x);
            for (predicted, smoothed) in work.x.iter_mut().zip(&after[..n]) {
                *predicted = smoothed - *predicted;
            }
            gemv(work.gain.numbers(), &work.x, &mut work.seen);
            axpy(1.0, &work.seen, x);
            sums.crossed.add_product(1.0, &work.gain, &later);
            work.change.copy_from(&later);
            work.change.add(-1.0, &work.predicted);
            work.moved.set_product(&work.gain, &work.change);
            later.copy_from(&p);
            later.add_product_transposed(1.0, &work.moved, &work.gain);
            later.symmetrise();
            sums.count(&later, &y[k * m..(k + 1) * m]);
        }
        sums.first.copy_from(&later);
        Ok(())
    }
}

impl Work {
    fn new(n: usize) -> Self {
        let square = || Matrix::zeros(n, n);
        Self {
            moved: square(),
            predicted: square(),
            factor: square(),
            gain: square(),
            change: square(),
            x: vec![0.0; n],
            seen: vec![0.0; n],
        }
    }
}

impl Sums {
    fn new(n: usize, m: usize, likelihood: f64) -> Self {
        let square = || Matrix::zeros(n, n);
        Self {
            whole: square(),
            first: square(),
            last: square(),
            crossed: square(),
            absent: (0..m).map(|_| square()).collect(),
            likelihood,
        }
    }

    /// Count the covariance of one sample.
    fn count(&mut self, p: &Matrix, sample: &[f64]) {
        self.whole.add(1.0, p);
        for (sum, _) in self.absent.iter_mut().zip(sample).filter(|(_, value)| value.is_nan()) {
            sum.add(1.0, p);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two samples of a random walk: the smoothed mean is that of the joint Gaussian.
    #[test]
    fn two_samples_are_smoothed_as_the_joint_gaussian_says() {
        let smoother = Smoother::new(&[1.0], &[1.0], &[1.0], &[1.0], &[2.0]).unwrap();
        let mut states = [0.0; 2];
        let sums = smoother.smooth(&[0.0, 0.0], &[f64::NAN, 3.0], &mut states).unwrap();
        // x0 ~ N(0, 2), x1 = x0 + w, y1 = x1 + v: cov(x0, y1) = 2, var(y1) = 4.
        assert!((states[0] - 1.5).abs() < 1e-12 && (states[1] - 2.25).abs() < 1e-12);
        assert!((sums.first[(0, 0)] - 1.0).abs() < 1e-12 && (sums.last[(0, 0)] - 0.75).abs() < 1e-12);
        assert!((sums.crossed[(0, 0)] - 0.5).abs() < 1e-12);
        assert_eq!(sums.absent[0], sums.first);
        assert!((sums.likelihood + 0.5 * (9.0 / 4.0 + (TAU * 4.0).ln())).abs() < 1e-12);
    }

    #[test]
    fn wrong_lengths_are_refused() {
        assert!(Smoother::new(&[1.0, 0.0], &[1.0], &[1.0], &[1.0], &[1.0]).is_err());
        let smoother = Smoother::new(&[1.0], &[1.0], &[1.0], &[1.0], &[1.0]).unwrap();
        assert!(smoother.smooth(&[0.0], &[1.0, 2.0], &mut [0.0; 2]).is_err());
    }
}
