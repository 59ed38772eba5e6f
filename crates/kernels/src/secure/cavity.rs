//! What the others expect of one sensor, in coordinates in which its channels are independent.
//!
//! ```text
//!     h = (I − H Λ)⁻¹ H = Q diag(v − 1) Qᵀ,   m = (I − H Λ)⁻¹ (e − H η),   z = Qᵀ (r − m)
//! ```
//!
//! A sensor that lies by N(b, c I) then sends independent z_a ~ N((Qᵀ b)_a, v_a + c). With beliefs γ_j, injections b_j
//! and noise 1 + c_j, the Gaussian site that gives the mixture its mean, and its covariance as far as a site can (it never widens the cavity: t, M ≥ 0), is
//!
//! ```text
//!     g_j = (z − Qᵀ b_j) / (v + c_j),   ḡ = Σ γ_j g_j
//!     M = diag(Σ γ_j / (v + c_j)) − t (Σ γ_j g_j g_jᵀ − ḡ ḡᵀ),   t ≤ 1 so that M is a covariance
//!     Λ' = (I − M h)⁻¹ M,   η' = Λ' (m + h ḡ) + ḡ
//! ```
//!
//! No h is inverted: a sensor may measure the same thing twice, or something that is known.

use crate::linalg::{axpy, dot};
use crate::mixture::block::solve;

/// Sweeps of Jacobi's rotations: quadratic convergence, and the matrices are small.
const ROTATIONS: usize = 12;

/// A way to explain a sensor that says something about the state: belief, where its injection lies, noise added.
#[derive(Debug, Clone, Copy)]
pub struct Way<'a> {
    /// γ_j
    pub belief: f64,
    /// Qᵀ b_j, or none.
    pub bias: Option<&'a [f64]>,
    /// c_j
    pub added: f64,
}

/// A sensor seen from the others: z, v, the turned m, and the rows of Qᵀ.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// (m,)
    pub z: &'a [f64],
    /// (m,)
    pub v: &'a [f64],
    /// (m,)
    pub mean: &'a [f64],
    /// (m, m)
    pub turn: &'a [f64],
}

/// Scratch for sensors with up to so many channels.
#[derive(Debug, Clone)]
pub struct Cavity {
    /// C_i P C_iᵀ from all sensors, (m, m).
    pub spread: Vec<f64>,
    system: Vec<f64>,
    right: Vec<f64>,
    /// h, then its eigenvectors are in `turn`.
    h: Vec<f64>,
    /// M
    tilt: Vec<f64>,
    pull: Vec<f64>,
    pulls: Vec<f64>,
    vector: Vec<f64>,
}

impl Cavity {
    /// Room for m channels.
    #[must_use]
    pub fn new(m: usize) -> Self {
        let square = || vec![0.0; m * m];
        Self {
            spread: square(),
            system: square(),
            right: vec![0.0; m * (m + 1)],
            h: square(),
            tilt: square(),
            pull: vec![0.0; m],
            pulls: vec![0.0; 3 * m],
            vector: vec![0.0; m],
        }
    }

    /// Leave out the site (`precision`, `eta`): z, v and the rows of Qᵀ into `z`, `v` and `turn` (m, m), and the
    /// turned m into `mean`.
    pub fn leave_out(
        &mut self,
        (precision, eta): (&[f64], &[f64]),
        (expected, residual): (&[f64], &[f64]),
        (z, v): (&mut [f64], &mut [f64]),
        (mean, turn): (&mut [f64], &mut [f64]),
    ) {
        let m = eta.len();
        for (a, expected) in expected.iter().enumerate() {
            let row = &self.spread[a * m..(a + 1) * m];
            for b in 0..m {
                let known: f64 = (0..m).map(|c| row[c] * precision[c * m + b]).sum();
                self.system[a * m + b] = f64::from(u8::from(a == b)) - known;
            }
            self.right[a * (m + 1)..a * (m + 1) + m].copy_from_slice(row);
            self.right[a * (m + 1) + m] = expected - dot(row, eta);
        }
        solve(&mut self.system[..m * m], &mut self.right[..m * (m + 1)], m);
        for a in 0..m {
            for b in 0..m {
                self.h[a * m + b] = 0.5 * (self.right[a * (m + 1) + b] + self.right[b * (m + 1) + a]);
            }
            self.vector[a] = self.right[a * (m + 1) + m];
        }
        diagonalise(&mut self.h[..m * m], turn, m);
        for a in 0..m {
            let row = &turn[a * m..(a + 1) * m];
            v[a] = 1.0 + self.h[a * m + a].max(0.0);
            mean[a] = dot(row, &self.vector[..m]);
            z[a] = dot(row, residual) - mean[a];
        }
    }

    /// The site of the ways to explain a sensor, mixed into the old one with weight `step`.
    pub fn match_moments(
        &mut self,
        ways: &[Way<'_>; 2],
        view: &View<'_>,
        step: f64,
        (precision, eta): (&mut [f64], &mut [f64]),
    ) {
        let View { z, v, mean, turn } = *view;
        let m = eta.len();
        let pulls = &mut self.pulls[..2 * m];
        let (mut idle, mut trace) = (1.0, 0.0);
        self.pull[..m].fill(0.0);
        self.tilt[..m * m].fill(0.0);
        for (j, way) in ways.iter().enumerate() {
            idle -= way.belief;
            for a in 0..m {
                let w = 1.0 / (v[a] + way.added);
                let g = (z[a] - way.bias.map_or(0.0, |bias| bias[a])) * w;
                pulls[j * m + a] = g;
                self.pull[a] += way.belief * g;
                self.tilt[a * m + a] += way.belief * w;
            }
        }
        // The trace bounds the largest eigenvalue of D^-½ Cov D^-½, and equals it where two explanations compete.
        for a in 0..m {
            let square = |g: f64| (g - self.pull[a]) * (g - self.pull[a]);
            let spread: f64 =
                ways.iter().enumerate().map(|(j, way)| way.belief * square(pulls[j * m + a])).sum();
            let spread = spread + idle.max(0.0) * square(0.0);
            trace += spread / self.tilt[a * m + a].max(f64::MIN_POSITIVE);
        }
        let share = if trace > 1.0 { 1.0 / trace } else { 1.0 };
        for a in 0..m {
            for b in 0..m {
                let product = |j: usize| pulls[j * m + a] * pulls[j * m + b];
                let mixed: f64 = ways.iter().enumerate().map(|(j, way)| way.belief * product(j)).sum();
                self.tilt[a * m + b] -= share * (mixed - self.pull[a] * self.pull[b]);
            }
        }
        for a in 0..m {
            for (b, v) in v.iter().enumerate() {
                let known = self.tilt[a * m + b] * (v - 1.0);
                self.system[a * m + b] = f64::from(u8::from(a == b)) - known;
            }
        }
        let right = &mut self.right[..m * m];
        right.copy_from_slice(&self.tilt[..m * m]);
        solve(&mut self.system[..m * m], right, m);
        for a in 0..m {
            self.vector[a] = mean[a] + (v[a] - 1.0) * self.pull[a];
        }
        // Back from the turned coordinates: Λ = Qᵀᵀ Λ' Qᵀ.
        for a in 0..m {
            self.pulls[a] =
                (0..m).map(|b| 0.5 * (right[a * m + b] + right[b * m + a]) * self.vector[b]).sum();
            self.pulls[a] += self.pull[a];
        }
        for c in 0..m {
            let row = &mut self.system[c * m..(c + 1) * m];
            row.fill(0.0);
            for d in 0..m {
                let site = 0.5 * (right[c * m + d] + right[d * m + c]);
                axpy(site, &turn[d * m..(d + 1) * m], row);
            }
        }
        for a in 0..m {
            for b in 0..m {
                let value: f64 = (0..m).map(|c| turn[c * m + a] * self.system[c * m + b]).sum();
                precision[a * m + b] = (1.0 - step) * precision[a * m + b] + step * value;
            }
            let new: f64 = (0..m).map(|c| turn[c * m + a] * self.pulls[c]).sum();
            eta[a] = (1.0 - step) * eta[a] + step * new;
        }
    }
}

/// Rotate a symmetric matrix (m, m) to a diagonal one; the rows of `turn` are its eigenvectors.
fn diagonalise(matrix: &mut [f64], turn: &mut [f64], m: usize) {
    turn[..m * m].fill(0.0);
    (0..m).for_each(|a| turn[a * m + a] = 1.0);
    for _ in 0..ROTATIONS {
        let mut off = 0.0_f64;
        for p in 0..m {
            for q in p + 1..m {
                let (app, aqq, apq) = (matrix[p * m + p], matrix[q * m + q], matrix[p * m + q]);
                if apq.abs() <= f64::EPSILON * (app.abs() + aqq.abs()) {
                    continue;
                }
                off = off.max(apq.abs());
                let theta = (aqq - app) / (2.0 * apq);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let c = 1.0 / t.hypot(1.0);
                let s = t * c;
                for k in 0..m {
                    let (kp, kq) = (matrix[k * m + p], matrix[k * m + q]);
                    matrix[k * m + p] = c * kp - s * kq;
                    matrix[k * m + q] = s * kp + c * kq;
                }
                for k in 0..m {
                    let (pk, qk) = (matrix[p * m + k], matrix[q * m + k]);
                    matrix[p * m + k] = c * pk - s * qk;
                    matrix[q * m + k] = s * pk + c * qk;
                    let (tp, tq) = (turn[p * m + k], turn[q * m + k]);
                    turn[p * m + k] = c * tp - s * tq;
                    turn[q * m + k] = s * tp + c * tq;
                }
            }
        }
        if off == 0.0 {
            break;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that look random, in (-1, 1).
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }

        fn vector(&mut self, m: usize) -> Vec<f64> {
            (0..m).map(|_| self.next()).collect()
        }

        /// size F Fᵀ, F (m, rank).
        fn square(&mut self, m: usize, rank: usize, size: f64) -> Vec<f64> {
            let f = self.vector(m * rank);
            let part = |k: usize| dot(&f[k / m * rank..][..rank], &f[k % m * rank..][..rank]);
            (0..m * m).map(|k| size * part(k)).collect()
        }
    }

    fn product(a: &[f64], b: &[f64], m: usize) -> Vec<f64> {
        let width = b.len() / m;
        let row = |k: usize| (0..m).map(|c| a[k / width * m + c] * b[c * width + k % width]).sum();
        (0..m * width).map(row).collect()
    }

    fn inverse(a: &[f64], m: usize) -> Vec<f64> {
        let (mut a, mut b) = (a.to_vec(), identity(m));
        solve(&mut a, &mut b, m);
        b
    }

    fn identity(m: usize) -> Vec<f64> {
        (0..m * m).map(|k| f64::from(u8::from(k / m == k % m))).collect()
    }

    fn sum(a: &[f64], b: &[f64], factor: f64) -> Vec<f64> {
        a.iter().zip(b).map(|(a, b)| a + factor * b).collect()
    }

    fn transposed(a: &[f64], m: usize) -> Vec<f64> {
        (0..m * m).map(|k| a[k % m * m + k / m]).collect()
    }

    fn assert_close(mine: &[f64], truth: &[f64], tolerance: f64, what: &str) {
        let size = truth.iter().fold(1e-300_f64, |size, value| size.max(value.abs()));
        for (mine, truth) in mine.iter().zip(truth) {
            assert!((mine - truth).abs() <= tolerance * size, "{what}: {mine} is not {truth}");
        }
    }

    /// A sensor that the others expect at N(m, h), left out of a posterior in which its site is Λ, η.
    struct Case {
        m: usize,
        mean: Vec<f64>,
        h: Vec<f64>,
        residual: Vec<f64>,
        cavity: Cavity,
        z: Vec<f64>,
        v: Vec<f64>,
        turned: Vec<f64>,
        turn: Vec<f64>,
    }

    impl Case {
        fn new(seed: u64) -> Self {
            let mut numbers = Numbers(seed);
            let m = 1 + seed as usize % 3;
            let h = sum(&numbers.square(m, m, 3.0), &identity(m), 0.1);
            let mean = numbers.vector(m);
            let residual: Vec<f64> = numbers.vector(m).iter().map(|r| 4.0 * r).collect();
            let (precision, eta) = (numbers.square(m, 1 + seed as usize % m, 2.0), numbers.vector(m));
            let mut cavity = Cavity::new(3);
            let spread = inverse(&sum(&inverse(&h, m), &precision, 1.0), m);
            let expected = product(&spread, &sum(&product(&inverse(&h, m), &mean, m), &eta, 1.0), m);
            cavity.spread[..m * m].copy_from_slice(&spread);
            let room = || vec![0.0; m];
            let (mut z, mut v, mut turned, mut turn) = (room(), room(), room(), vec![0.0; m * m]);
            cavity.leave_out(
                (&precision, &eta),
                (&expected, &residual),
                (&mut z, &mut v),
                (&mut turned, &mut turn),
            );
            Self { m, mean, h, residual, cavity, z, v, turned, turn }
        }
    }

    #[test]
    fn leaving_a_site_out_gives_what_the_others_expect() {
        for seed in 0..300 {
            let Case { m, mean, h, residual, z, v, turned, turn, .. } = Case::new(seed);
            assert_close(&product(&turn, &mean, m), &turned, 1e-9, "m");
            assert_close(&z, &product(&turn, &sum(&residual, &mean, -1.0), m), 1e-9, "z");
            let diagonal: Vec<f64> = (0..m * m).map(|k| identity(m)[k] * (v[k / m] - 1.0)).collect();
            let back = product(&product(&transposed(&turn, m), &diagonal, m), &turn, m);
            assert_close(&back, &h, 1e-9, "h");
        }
    }

    #[test]
    fn a_site_gives_the_mixture_its_mean_and_its_covariance() {
        let mut exact = 0;
        for seed in 0..600 {
            let Case { m, mean, h, residual, mut cavity, z, v, turned, turn } = Case::new(seed);
            let mut numbers = Numbers(seed + 10_000);
            let share: Vec<f64> = numbers.vector(3).iter().map(|share| share.abs()).collect();
            let belief: Vec<f64> = share.iter().map(|one| one / share.iter().sum::<f64>()).collect();
            let (bias, added) = (numbers.vector(m), 1.0 + numbers.next());
            let turned_bias = product(&turn, &bias, m);
            let ways = [
                Way { belief: belief[0], bias: None, added: 0.0 },
                Way { belief: belief[1], bias: Some(&turned_bias), added },
            ];
            let view = View { z: &z, v: &v, mean: &turned, turn: &turn };
            let (mut precision, mut eta) = (vec![0.0; m * m], vec![0.0; m]);
            cavity.match_moments(&ways, &view, 1.0, (&mut precision, &mut eta));

            // The three explanations one by one: mean and covariance of C e, by the textbook.
            let none = vec![0.0; m];
            let explained = |bias: &[f64], added: f64| {
                let gain = product(&h, &inverse(&sum(&h, &identity(m), 1.0 + added), m), m);
                let pull = product(&gain, &sum(&sum(&residual, &mean, -1.0), bias, -1.0), m);
                (sum(&mean, &pull, 1.0), sum(&h, &product(&gain, &h, m), -1.0))
            };
            let parts = [explained(&none, 0.0), explained(&bias, added), (mean.clone(), h.clone())];
            let (mut first, mut second) = (none.clone(), vec![0.0; m * m]);
            for (share, (mean, _)) in belief.iter().zip(&parts) {
                first = sum(&first, mean, *share);
            }
            for (share, (mean, covariance)) in belief.iter().zip(&parts) {
                let d = sum(mean, &first, -1.0);
                let outer: Vec<f64> = (0..m * m).map(|k| d[k / m] * d[k % m]).collect();
                second = sum(&second, &sum(covariance, &outer, 1.0), *share);
            }

            let posterior = inverse(&sum(&inverse(&h, m), &precision, 1.0), m);
            let shifted = sum(&product(&inverse(&h, m), &mean, m), &eta, 1.0);
            assert_close(&product(&posterior, &shifted, m), &first, 1e-7, "mean");
            let excess = sum(&h, &second, -1.0);
            if (0..m).all(|a| excess[a * m + a] > 0.0) && posterior[0] > second[0] * (1.0 - 1e-9) {
                exact += usize::from((posterior[0] - second[0]).abs() < 1e-7 * second[0]);
            }
            // No site takes away what the others know.
            let left = sum(&h, &posterior, -1.0);
            assert!((0..m).all(|a| left[a * m + a] >= -1e-9), "{left:?}");
        }
        assert!(exact > 300, "{exact}");
    }

    #[test]
    fn a_matrix_turned_to_a_diagonal_turns_back() {
        for seed in 0..400 {
            let mut numbers = Numbers(seed);
            let m = 1 + seed as usize % 6;
            let rank = 1 + seed as usize / 6 % m;
            let size = 10_f64.powi(seed as i32 % 20 - 10);
            let matrix = if seed % 7 == 0 { identity(m) } else { numbers.square(m, rank, size) };
            let (mut diagonal, mut turn) = (matrix.clone(), vec![0.0; m * m]);
            diagonalise(&mut diagonal, &mut turn, m);
            let straight = product(&turn, &transposed(&turn, m), m);
            assert_close(&straight, &identity(m), 1e-13, "rows of unit length at right angles");
            let kept: Vec<f64> = (0..m * m).map(|k| identity(m)[k] * diagonal[k]).collect();
            let back = product(&product(&transposed(&turn, m), &kept, m), &turn, m);
            assert_close(&back, &matrix, 1e-13, "Q D Qᵀ");
        }
    }
}
