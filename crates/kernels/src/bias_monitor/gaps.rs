//! Innovations of channels that did not arrive, replaced by their mean given those that did: with Λ = S⁻¹,
//! e_a = −Λ_aa⁻¹ Λ_ap e_p. Then K e is the steady gain's part for the present, and L⁻¹ e says nothing else.

use crate::linalg::{cholesky, cholesky_solve, dot};

/// Who is absent, and the factor of Λ_aa.
#[derive(Debug, Clone)]
pub struct Gaps {
    precision: Vec<f64>,
    channels: usize,
    absent: Vec<usize>,
    before: Vec<usize>,
    factor: Vec<f64>,
    mean: Vec<f64>,
}

impl Gaps {
    /// For innovations of precision Λ (m, m).
    #[must_use]
    pub fn new(precision: Vec<f64>, channels: usize) -> Self {
        Self {
            precision,
            channels,
            absent: Vec::with_capacity(channels),
            before: Vec::with_capacity(channels),
            factor: vec![0.0; channels * channels],
            mean: vec![0.0; channels],
        }
    }

    /// Note who did not arrive; returns how many did.
    pub fn listen(&mut self, y: &[f64]) -> usize {
        std::mem::swap(&mut self.absent, &mut self.before);
        self.absent.clear();
        self.absent.extend((0..y.len()).filter(|&i| y[i].is_nan()));
        let (count, m) = (self.absent.len(), self.channels);
        if self.absent != self.before {
            for (row, &i) in self.factor.chunks_exact_mut(m).zip(&self.absent) {
                for (target, &j) in row.iter_mut().zip(&self.absent) {
                    *target = self.precision[i * m + j];
                }
            }
            // Λ is positive definite, hence so is every principal part of it.
            let _ = cholesky(&mut self.factor, count, m, 0.0);
        }
        m - count
    }

    /// Replace what is absent of `e`.
    pub fn fill(&mut self, e: &mut [f64]) {
        if self.absent.is_empty() {
            return;
        }
        self.absent.iter().for_each(|&i| e[i] = 0.0);
        let (m, mean) = (self.channels, &mut self.mean[..self.absent.len()]);
        for (target, &i) in mean.iter_mut().zip(&self.absent) {
            *target = -dot(&self.precision[i * m..(i + 1) * m], e);
        }
        cholesky_solve(&self.factor, m, mean);
        self.absent.iter().zip(mean).for_each(|(&i, value)| e[i] = *value);
    }
}
