//! What a steady filter makes of a constant added to one channel.
//!
//! ```text
//!     r = e_i − C z,   w = z + K r,   z ← A w        per unit of the bias: in y − ŷ, in x[k|k], in x[k+1|k]
//! ```

use crate::kalman::model::{Model, add_product};
use crate::linalg::{cholesky, forward_solve};
use crate::{Error, Result};

/// The steady filter: gain and innovation covariance.
#[derive(Debug, Clone)]
pub struct Steady {
    /// The plant.
    pub model: Model,
    /// Kᵀ: the columns of K one after the other, (m, n).
    gain: Vec<f64>,
    /// L of S = L Lᵀ, (m, m).
    factor: Vec<f64>,
    /// √S_ii, (m,).
    pub std: Vec<f64>,
    /// S⁻¹, (m, m).
    pub precision: Vec<f64>,
}

impl Steady {
    /// From K (n, m) and S (m, m), by rows.
    ///
    /// # Errors
    /// A length that does not fit, a plant that varies in time, or an S that is no covariance.
    pub fn new(model: Model, gain: &[f64], innovation_cov: &[f64]) -> Result<Self> {
        let (n, m) = (model.dims.states, model.dims.channels);
        Error::check_len("gain", n * m, gain.len())?;
        Error::check_len("innovation_cov", m * m, innovation_cov.len())?;
        if model.horizon.is_some() {
            return Err(Error::input("plant", "one that does not vary in time", "A or C per sample"));
        }
        let mut factor = innovation_cov.to_vec();
        cholesky(&mut factor, m, m, 0.0).map_err(|_| {
            Error::input("innovation_cov", "a positive definite matrix", "a singular or indefinite one")
        })?;
        let mut precision = vec![0.0; m * m];
        for (i, row) in precision.chunks_exact_mut(m).enumerate() {
            row[i] = 1.0;
            crate::linalg::cholesky_solve(&factor, m, row);
        }
        Ok(Self {
            gain: (0..m).flat_map(|i| (0..n).map(move |j| gain[j * m + i])).collect(),
            std: (0..m).map(|i| innovation_cov[i * (m + 1)].sqrt()).collect(),
            model,
            factor,
            precision,
        })
    }

    /// r = e_i − C z.
    pub fn respond(&self, channel: usize, z: &[f64], r: &mut [f64]) {
        r.fill(0.0);
        r[channel] = 1.0;
        add_product(-1.0, self.model.c_t(0), z, r);
    }

    /// x += K e.
    pub fn correct(&self, e: &[f64], x: &mut [f64]) {
        add_product(1.0, &self.gain, e, x);
    }

    /// e ← L⁻¹ e.
    pub fn whiten(&self, e: &mut [f64]) {
        forward_solve(&self.factor, self.model.dims.channels, e);
    }

    /// z ← A w.
    pub fn carry(&self, w: &[f64], z: &mut [f64]) {
        self.model.predict(0, w, &[], z);
    }
}
