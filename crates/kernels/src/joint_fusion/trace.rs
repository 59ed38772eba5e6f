//! Gains and moments over a stretch of samples, for those who want to read them.

use std::ops::Range;

use crate::Result;
use crate::joint_fusion::covariance::{Covariance, Design, Moments};
use crate::joint_fusion::layout::Pattern;
use crate::matrix::Matrix;

/// One array per quantity, sample after sample; those per local one after the other.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// K_i, (steps, n + p_i, m_i).
    pub gain: Vec<Vec<f64>>,
    /// Γ_i, (steps, p_i, m_i).
    pub gamma: Vec<Vec<f64>>,
    /// P_ii^X, (steps, n + p_i, n + p_i).
    pub px: Vec<Vec<f64>>,
    /// U_ii, (steps, n + p_i, p_i).
    pub u: Vec<Vec<f64>>,
    /// V_ii, (steps, p_i, p_i).
    pub v: Vec<Vec<f64>>,
    /// Σ, (steps, n r, n r).
    pub sigma: Vec<f64>,
    /// [G_1 … G_r], (steps, n, n r).
    pub weights: Vec<f64>,
    /// P_0, (steps, n, n).
    pub covariance: Vec<f64>,
    /// Whether a covariance was none, (steps,).
    pub broken: Vec<u8>,
}

impl Design {
    /// From covariance `p` of x[0|−1]; `heard` (steps, rows) says which rows arrive, `eta` (steps, Σ p_i).
    ///
    /// # Errors
    /// If `p` is no covariance.
    pub fn trace(&self, p: &[f64], heard: &[bool], eta: &[f64]) -> Result<Trace> {
        let (layout, count) = (&self.layout, self.layout.count());
        let per_local = || vec![Vec::new(); count];
        let mut trace = Trace {
            gain: per_local(),
            gamma: per_local(),
            px: per_local(),
            u: per_local(),
            v: per_local(),
            ..Trace::default()
        };
        let mut moments = self.start(p, &eta[..layout.weak])?;
        let samples = heard.chunks_exact(layout.rows).zip(eta.chunks_exact(layout.weak));
        for (k, (heard, eta)) in samples.enumerate() {
            let pattern = Pattern { heard: heard.to_vec(), eta: eta.to_vec() };
            self.correct(&mut moments, k, &pattern);
            self.note(&moments, &mut trace);
            self.predict(&mut moments, k);
        }
        Ok(trace)
    }

    fn note(&self, p: &Covariance, trace: &mut Trace) {
        for (i, (local, j)) in self.layout.locals.iter().zip(&p.gains.j).enumerate() {
            let size = self.layout.n + local.weak;
            let (gain, gamma) = j.numbers().split_at(size * local.height());
            trace.gain[i].extend_from_slice(gain);
            trace.gamma[i].extend(gamma.iter().map(|value| -value));
            let [px, u, v] = match &p.moments {
                Moments::Exact(exact) => {
                    Self::parts(&exact.papers(self.layout.n, i, local, (&p.pattern, j)), size)
                }
                Moments::Array(array) => {
                    Self::parts(&array.papers(self.layout.n, i, local, &p.pattern), size)
                }
                Moments::Printed(printed) => {
                    let own = &printed.own[i];
                    [own.px.clone(), own.u.clone(), own.v.clone()]
                }
            };
            trace.px[i].extend_from_slice(px.numbers());
            trace.u[i].extend_from_slice(u.numbers());
            trace.v[i].extend_from_slice(v.numbers());
        }
        trace.sigma.extend_from_slice(p.sigma().numbers());
        trace.weights.extend_from_slice(p.gains.weights.numbers());
        trace.covariance.extend_from_slice(p.gains.covariance.numbers());
        trace.broken.push(u8::from(p.gains.broken));
    }

    /// P^X, U and V from the covariance of [X̃; φ̂].
    fn parts(whole: &Matrix, size: usize) -> [Matrix; 3] {
        let p = whole.rows() - size;
        let part = |rows: Range<usize>, columns: Range<usize>| {
            let mut part = Matrix::zeros(rows.len(), columns.len());
            rows.enumerate().for_each(|(a, row)| {
                part.row_mut(a).copy_from_slice(&whole.row(row)[columns.clone()]);
            });
            part
        };
        [part(0..size, 0..size), part(0..size, size..size + p), part(size..size + p, size..size + p)]
    }
}
