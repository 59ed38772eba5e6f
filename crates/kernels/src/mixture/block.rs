//! The same as [`crate::mixture::labels`] does for a scalar sensor, for one with several channels: blocks of (m, m).
//!
//! ```text
//!     h = (I − H Λ)⁻¹ H,  μ = (I − H Λ)⁻¹ (e − H η),  V = h + I,  ρ = r − μ
//!     M = γ (V⁻¹ − c V⁻¹ρ ρᵀV⁻¹),  c = min(1 − γ, 1 / ρᵀV⁻¹ρ)
//!     Λ' = (I − M h)⁻¹ M,  η' = Λ' (μ + γ h V⁻¹ρ) + γ V⁻¹ρ
//! ```
//!
//! No h is inverted: a sensor may measure the same thing twice.

use crate::linalg::{axpy, cholesky, cholesky_solve, dot, forward_solve};

/// Scratch for sensors with up to so many channels, and the leave-one-out prediction of one of them.
#[derive(Debug, Clone)]
pub struct Block {
    /// C_i P C_iᵀ from all sensors, (m, m).
    pub spread: Vec<f64>,
    /// h: the same from the others, (m, m).
    pub h: Vec<f64>,
    /// μ, where the others expect the sensor, (m,).
    pub mean: Vec<f64>,
    /// ρ, (m,).
    pub rho: Vec<f64>,
    /// V⁻¹ ρ, (m,).
    pub scaled: Vec<f64>,
    /// Diagonal of V, (m,).
    pub variance: Vec<f64>,
    /// ρᵀ V⁻¹ ρ
    pub square: f64,
    /// log det V
    pub log_det: f64,
    /// Cholesky factor of V.
    factor: Vec<f64>,
    /// M, (m, m).
    m: Vec<f64>,
    system: Vec<f64>,
    right: Vec<f64>,
}

impl Block {
    /// Room for m channels.
    #[must_use]
    pub fn new(m: usize) -> Self {
        let square = || vec![0.0; m * m];
        let vector = || vec![0.0; m];
        Self {
            spread: square(),
            h: square(),
            mean: vector(),
            rho: vector(),
            scaled: vector(),
            variance: vector(),
            square: 0.0,
            log_det: 0.0,
            factor: square(),
            m: square(),
            system: square(),
            right: vec![0.0; m * (m + 1)],
        }
    }

    /// L⁻¹ ρ with V = L Lᵀ, left in `scaled`.
    pub fn standardise(&mut self, m: usize) {
        self.scaled[..m].copy_from_slice(&self.rho[..m]);
        forward_solve(&self.factor, m, &mut self.scaled[..m]);
    }

    /// What the others expect of a sensor whose site is `precision` (m, m), `eta`; `spread` and `expected` (m,) are
    /// C_i P C_iᵀ and C_i x − C_i x⁻ with everyone.
    pub fn leave_out(&mut self, (precision, eta): (&[f64], &[f64]), expected: &[f64], residual: &[f64]) {
        let m = eta.len();
        let spread = &self.spread[..m * m];
        // (I − H Λ) [h, μ] = [H, e − H η]
        for a in 0..m {
            let row = &spread[a * m..(a + 1) * m];
            for b in 0..m {
                let known: f64 = (0..m).map(|c| row[c] * precision[c * m + b]).sum();
                self.system[a * m + b] = f64::from(u8::from(a == b)) - known;
            }
            self.right[a * (m + 1)..a * (m + 1) + m].copy_from_slice(row);
            self.right[a * (m + 1) + m] = expected[a] - dot(row, eta);
        }
        solve(&mut self.system[..m * m], &mut self.right[..m * (m + 1)], m);
        for (a, residual) in residual.iter().enumerate().take(m) {
            for b in 0..m {
                let mean = 0.5 * (self.right[a * (m + 1) + b] + self.right[b * (m + 1) + a]);
                self.h[a * m + b] = mean;
                self.factor[a * m + b] = mean + f64::from(u8::from(a == b));
            }
            self.mean[a] = self.right[a * (m + 1) + m];
            self.rho[a] = residual - self.mean[a];
            self.variance[a] = self.factor[a * m + a];
        }
        self.scaled[..m].copy_from_slice(&self.rho[..m]);
        // V is at least the identity but for rounding.
        if cholesky(&mut self.factor, m, m, 0.0).is_err() {
            (self.square, self.log_det) = (f64::INFINITY, 0.0);
            return;
        }
        cholesky_solve(&self.factor, m, &mut self.scaled[..m]);
        self.square = dot(&self.rho[..m], &self.scaled[..m]);
        self.log_det = 2.0 * (0..m).map(|a| self.factor[a * m + a].ln()).sum::<f64>();
    }

    /// The site that gives the tilted moments for belief γ, mixed into the old one with weight `step`.
    pub fn match_moments(&mut self, gamma: f64, step: f64, precision: &mut [f64], eta: &mut [f64]) {
        let m = eta.len();
        if !self.square.is_finite() {
            precision.iter_mut().chain(eta).for_each(|value| *value *= 1.0 - step);
            return;
        }
        let shrink = gamma * (1.0 - gamma).min(1.0 / self.square.max(f64::MIN_POSITIVE));
        for a in 0..m {
            let row = &mut self.m[a * m..(a + 1) * m];
            row.fill(0.0);
            row[a] = gamma;
            cholesky_solve(&self.factor, m, row);
            axpy(-shrink * self.scaled[a], &self.scaled[..m], row);
        }
        for a in 0..m {
            for b in 0..m {
                let known: f64 = (0..m).map(|c| self.m[a * m + c] * self.h[c * m + b]).sum();
                self.system[a * m + b] = f64::from(u8::from(a == b)) - known;
            }
        }
        let right = &mut self.right[..m * m];
        right.copy_from_slice(&self.m[..m * m]);
        solve(&mut self.system[..m * m], right, m);
        // η' = Λ' (μ + γ h V⁻¹ρ) + γ V⁻¹ρ
        for a in 0..m {
            self.mean[a] += gamma * dot(&self.h[a * m..(a + 1) * m], &self.scaled[..m]);
        }
        for a in 0..m {
            for b in 0..m {
                let new = 0.5 * (right[a * m + b] + right[b * m + a]);
                // Written so that a step of 1 forgets the old site to the last bit: its rounding can be larger than the new.
                precision[a * m + b] = (1.0 - step) * precision[a * m + b] + step * new;
            }
            let new = dot(&right[a * m..(a + 1) * m], &self.mean[..m]) + gamma * self.scaled[a];
            eta[a] = (1.0 - step) * eta[a] + step * new;
        }
    }

    /// Columns f with Σ f fᵀ = Λ (m, m), one after the other; as many as Λ has pivots above rounding, largest first.
    pub fn factors(&mut self, precision: &[f64], m: usize, mut each: impl FnMut(&[f64])) {
        let rest = &mut self.system[..m * m];
        rest.copy_from_slice(precision);
        let largest = |rest: &[f64]| {
            (1..m).fold(0, |best, a| if rest[a * m + a] > rest[best * m + best] { a } else { best })
        };
        let least = f64::EPSILON * rest[largest(rest) * (m + 1)];
        for _ in 0..m {
            let pivot = largest(rest);
            let weight = rest[pivot * m + pivot];
            if weight <= least || weight.is_nan() {
                break;
            }
            let (column, root) = (&mut self.scaled[..m], weight.sqrt());
            for (a, value) in column.iter_mut().enumerate() {
                *value = rest[a * m + pivot] / root;
            }
            for a in 0..m {
                axpy(-column[a], column, &mut rest[a * m..(a + 1) * m]);
            }
            each(column);
        }
    }
}

/// A X = B in place of B (m, columns), by elimination with row pivoting; A is destroyed.
pub(crate) fn solve(a: &mut [f64], b: &mut [f64], m: usize) {
    let columns = b.len() / m;
    for j in 0..m {
        let pivot =
            (j..m).fold(j, |best, i| if a[i * m + j].abs() > a[best * m + j].abs() { i } else { best });
        if pivot != j {
            (0..m).for_each(|c| a.swap(pivot * m + c, j * m + c));
            (0..columns).for_each(|c| b.swap(pivot * columns + c, j * columns + c));
        }
        for i in j + 1..m {
            let factor = a[i * m + j] / a[j * m + j];
            let (top, below) = a.split_at_mut(i * m);
            axpy(-factor, &top[j * m..(j + 1) * m], &mut below[..m]);
            let (top, below) = b.split_at_mut(i * columns);
            axpy(-factor, &top[j * columns..(j + 1) * columns], &mut below[..columns]);
        }
    }
    for j in (0..m).rev() {
        let inverse = 1.0 / a[j * m + j];
        b[j * columns..(j + 1) * columns].iter_mut().for_each(|value| *value *= inverse);
        for i in 0..j {
            let (top, below) = b.split_at_mut(j * columns);
            axpy(-a[i * m + j], &below[..columns], &mut top[i * columns..(i + 1) * columns]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sensor of two channels that is certainly attacked, after its first sweep from trust.
    fn distrusted() -> Vec<f64> {
        let mut block = Block::new(2);
        let (mut precision, mut eta) = (vec![1.0, 0.0, 0.0, 1.0], vec![40.0, 30.0]);
        block.spread.copy_from_slice(&[0.3, 0.2, 0.2, 0.4]);
        block.leave_out((&precision, &eta), &[20.0, 16.0], &[40.0, 30.0]);
        block.match_moments(1e-70, 1.0, &mut precision, &mut eta);
        precision
    }

    #[test]
    fn a_full_step_forgets_the_old_site_to_the_last_bit() {
        let precision = distrusted();
        assert!(precision[0] > 0.0 && precision[3] > 0.0, "{precision:?}");
        assert!(precision[1] * precision[2] <= precision[0] * precision[3] * (1.0 + 1e-9), "{precision:?}");
    }

    #[test]
    fn factors_give_back_the_precision_and_stay_small_where_it_is_not_quite_semidefinite() {
        for precision in [distrusted(), vec![2.0, 0.5, 0.5, 1.0], vec![1e-40, 1e-17, 1e-17, 1.0]] {
            let mut sum = [0.0; 4];
            Block::new(2).factors(&precision, 2, |f| {
                (0..4).for_each(|i| sum[i] += f[i / 2] * f[i % 2]);
            });
            let size = precision[0].max(precision[3]);
            for (got, want) in sum.iter().zip(&precision) {
                assert!((got - want).abs() <= 1e-15 * size, "{sum:?} instead of {precision:?}");
            }
        }
    }
}
