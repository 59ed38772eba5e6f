//! The matrices of sparse fusion, made in Python, and the check that they fit together.

use crate::{Dims, Error, Result};

/// Everything computed at design time. Matrices are row-major; d elements of g in all, n_u flat and n_s other modes.
#[derive(Debug, Clone)]
pub struct Matrices {
    /// Sizes.
    pub dims: Dims,
    /// Plant: A (n, n), B (n, p), C (m, n), D (m, p).
    pub a: Vec<f64>,
    #[allow(missing_docs)]
    pub b: Vec<f64>,
    #[allow(missing_docs)]
    pub c: Vec<f64>,
    #[allow(missing_docs)]
    pub d: Vec<f64>,
    /// Local filters: T transposed (n, n) and b (n,) of (12).
    pub t_transposed: Vec<f64>,
    #[allow(missing_docs)]
    pub drive: Vec<f64>,
    /// Effect of the known input on the local filters, (m n, p).
    pub input_map: Vec<f64>,
    /// Local filters from the flat modes of the prior mean, (m n, n_u).
    pub start_map: Vec<f64>,
    /// V⁻¹ (n, n): flat modes first.
    pub modes: Vec<f64>,
    /// The other modes, driven by the known input alone: A_s (n_s, n_s), B_s (n_s, p), C V_s (m, n_s), V_s (n, n_s).
    pub a_s: Vec<f64>,
    #[allow(missing_docs)]
    pub b_s: Vec<f64>,
    #[allow(missing_docs)]
    pub c_s: Vec<f64>,
    #[allow(missing_docs)]
    pub v_s: Vec<f64>,
    /// Kalman fusion F (n, m n) of (11) and its effect on g, F S (n, d).
    pub fusion: Vec<f64>,
    #[allow(missing_docs)]
    pub fusion_g: Vec<f64>,
    /// H = Sᵀ N S (d, d).
    pub hessian: Vec<f64>,
    /// First element of every penalty group and of every sensor, and d at the end.
    pub groups: Vec<usize>,
    #[allow(missing_docs)]
    pub sensors: Vec<usize>,
    /// Owner of every channel.
    pub channel_sensor: Vec<usize>,
    /// γ per penalty group.
    pub gamma: Vec<f64>,
    /// Attack estimate per channel from its sensor's g(k) and g(k−1): (m, d) each, zero outside the sensor.
    pub attack_now: Vec<f64>,
    #[allow(missing_docs)]
    pub attack_before: Vec<f64>,
    /// Steady posterior covariance P (n, n), noise Q (n, n), K R Kᵀ (n, n), I − K C (n, n), √diag S (m,).
    pub p: Vec<f64>,
    #[allow(missing_docs)]
    pub q: Vec<f64>,
    #[allow(missing_docs)]
    pub krk: Vec<f64>,
    #[allow(missing_docs)]
    pub ikc: Vec<f64>,
    #[allow(missing_docs)]
    pub innovation_std: Vec<f64>,
    /// A sensor whose ‖f_i‖ in the metric N_ii exceeds this is suspected.
    pub suspicion: f64,
    /// How many suspected sensors may be freed of their penalty (refit); 0 = none.
    pub refit: usize,
}

impl Matrices {
    /// n_s, modes without a flat prior.
    pub(super) fn others(&self) -> usize {
        self.c_s.len().checked_div(self.dims.channels).unwrap_or(0)
    }

    /// Check every size.
    ///
    /// # Errors
    /// The name of the first matrix whose size does not fit.
    pub(super) fn check(&self) -> Result<()> {
        let Dims { states: n, channels, inputs: p, sensors } = self.dims;
        let d = self.groups.last().copied().unwrap_or(0);
        let others = self.others();
        let local = channels * n;
        let sizes: [(&'static str, usize, usize); 22] = [
            ("a", n * n, self.a.len()),
            ("b", n * p, self.b.len()),
            ("c", channels * n, self.c.len()),
            ("d", channels * p, self.d.len()),
            ("t_transposed", n * n, self.t_transposed.len()),
            ("drive", n, self.drive.len()),
            ("input_map", local * p, self.input_map.len()),
            ("start_map", local * (n - others.min(n)), self.start_map.len()),
            ("modes", n * n, self.modes.len()),
            ("a_s", others * others, self.a_s.len()),
            ("b_s", others * p, self.b_s.len()),
            ("v_s", n * others, self.v_s.len()),
            ("fusion", n * local, self.fusion.len()),
            ("fusion_g", n * d, self.fusion_g.len()),
            ("hessian", d * d, self.hessian.len()),
            ("gamma", self.groups.len().saturating_sub(1), self.gamma.len()),
            ("sensors", sensors + 1, self.sensors.len()),
            ("channel_sensor", channels, self.channel_sensor.len()),
            ("attack_now", channels * d, self.attack_now.len()),
            ("attack_before", channels * d, self.attack_before.len()),
            ("p", n * n, self.p.len()),
            ("innovation_std", channels, self.innovation_std.len()),
        ];
        for (name, expected, received) in sizes {
            Error::check_len(name, expected, received)?;
        }
        Ok(())
    }
}
