//! One steady-state filter per sensor that hears this sensor alone.
//!
//! ```text
//!     r_i = y_i − C_i z_i − D_i u,   z_i ← A_i (z_i + K_i r_i) + B_i u,   r_i ~ N(0, S_i)
//! ```

use crate::codec::Fingerprint;
use crate::kalman::model::{Model, add_product};
use crate::kalman::ud::transpose;
use crate::linalg::{cholesky, dot, forward_solve, gemv};
use crate::{Error, Result};

/// The matrices of one sensor's filter, row-major; z = T x.
#[derive(Debug, Clone)]
pub struct LocalFilter {
    /// (n_i, n)
    pub t: Vec<f64>,
    /// (n_i, n_i)
    pub a: Vec<f64>,
    /// (n_i, p)
    pub b: Vec<f64>,
    /// (m_i, n_i)
    pub c: Vec<f64>,
    /// (m_i, p)
    pub d: Vec<f64>,
    /// K_i, (n_i, m_i).
    pub gain: Vec<f64>,
    /// S_i, (m_i, m_i).
    pub innovation_cov: Vec<f64>,
}

impl LocalFilter {
    /// Mix in every number.
    #[must_use]
    pub fn fingerprint(&self, hash: Fingerprint) -> Fingerprint {
        let parts = [&self.t, &self.a, &self.b, &self.c, &self.d, &self.gain, &self.innovation_cov];
        parts.iter().fold(hash, |hash, part| hash.floats(part))
    }
}

/// What a step needs of one filter: matrices by columns, and the Cholesky factor of S_i.
#[derive(Debug, Clone)]
struct Laid {
    modes: usize,
    channels: usize,
    a: Vec<f64>,
    b: Vec<f64>,
    c: Vec<f64>,
    d: Vec<f64>,
    gain: Vec<f64>,
    factor: Vec<f64>,
}

/// All filters, with their states z_i[k|k−1] one after the other.
#[derive(Debug, Clone)]
pub struct Locals {
    laid: Vec<Laid>,
    z: Vec<f64>,
    next: Vec<f64>,
    innovation: Vec<f64>,
    white: Vec<f64>,
    part: Vec<f64>,
}

impl Laid {
    fn new(filter: &LocalFilter, channels: usize, n: usize, p: usize) -> Result<Self> {
        let modes = filter.t.len() / n;
        for (name, size, part) in [
            ("T", modes * n, &filter.t),
            ("A", modes * modes, &filter.a),
            ("B", modes * p, &filter.b),
            ("C", channels * modes, &filter.c),
            ("D", channels * p, &filter.d),
            ("gain", modes * channels, &filter.gain),
            ("innovation_cov", channels * channels, &filter.innovation_cov),
        ] {
            Error::check_len(name, size, part.len())?;
        }
        let mut factor = filter.innovation_cov.clone();
        cholesky(&mut factor, channels, channels, 0.0).map_err(|_| {
            Error::input("innovation_cov", "a positive definite matrix", "a singular or indefinite one")
        })?;
        Ok(Self {
            modes,
            channels,
            a: transpose(&filter.a, modes, modes),
            b: transpose(&filter.b, modes, p),
            c: transpose(&filter.c, channels, modes),
            d: transpose(&filter.d, channels, p),
            gain: transpose(&filter.gain, modes, channels),
            factor,
        })
    }
}

impl Locals {
    /// Lay out the filters, one per sensor of `model`.
    ///
    /// # Errors
    /// A length that does not fit, or an S_i that is not a covariance.
    pub fn new(model: &Model, filters: &[LocalFilter]) -> Result<Self> {
        let dims = model.dims;
        Error::check_len("filters", dims.sensors, filters.len())?;
        let count = |sensor: usize| model.channel_sensor.iter().filter(|&&owner| owner == sensor).count();
        let laid = (filters.iter().enumerate())
            .map(|(sensor, filter)| Laid::new(filter, count(sensor), dims.states, dims.inputs))
            .collect::<Result<Vec<_>>>()?;
        let widest = laid.iter().map(|filter| filter.channels).max().unwrap_or(0);
        let total = laid.iter().map(|filter| filter.modes).sum();
        Ok(Self {
            laid,
            z: vec![0.0; total],
            next: vec![0.0; dims.states],
            innovation: vec![0.0; widest],
            white: vec![0.0; widest],
            part: vec![0.0; widest * widest],
        })
    }

    /// z_i = T_i x.
    pub fn start(&mut self, filters: &[LocalFilter], x: &[f64]) {
        let mut z = &mut self.z[..];
        for (filter, laid) in filters.iter().zip(&self.laid) {
            let (own, rest) = z.split_at_mut(laid.modes);
            gemv(&filter.t, x, own);
            z = rest;
        }
    }

    /// All states.
    #[must_use]
    pub fn z(&self) -> &[f64] {
        &self.z
    }

    /// All states, to be read back.
    pub fn z_mut(&mut self) -> &mut [f64] {
        &mut self.z
    }

    /// Test every sensor, then move every filter on. `excess` (N,) is d_i² over the quantile for as many channels
    /// as arrived, NaN where none did. A filter takes in complete readings only; with `hold` none that is too far.
    pub fn step(
        &mut self,
        filters: &[LocalFilter],
        (y, u): (&[f64], &[f64]),
        quantiles: &[f64],
        hold: bool,
        excess: &mut [f64],
    ) {
        let (mut z, mut y) = (&mut self.z[..], y);
        for ((laid, filter), excess) in self.laid.iter().zip(filters).zip(excess) {
            let (own, rest) = std::mem::take(&mut z).split_at_mut(laid.modes);
            let (sent, others) = y.split_at(laid.channels);
            let r = &mut self.innovation[..laid.channels];
            r.copy_from_slice(sent);
            add_product(-1.0, &laid.c, own, r);
            add_product(-1.0, &laid.d, u, r);
            let (square, count) = squared_distance(laid, filter, r, &mut self.white, &mut self.part);
            *excess = if count == 0 { f64::NAN } else { square / quantiles[count] };
            if count == laid.channels && !(hold && *excess > 1.0) {
                add_product(1.0, &laid.gain, r, own);
            }
            let next = &mut self.next[..laid.modes];
            next.fill(0.0);
            add_product(1.0, &laid.a, own, next);
            add_product(1.0, &laid.b, u, next);
            own.copy_from_slice(next);
            (z, y) = (rest, others);
        }
    }
}

/// rᵀ S⁻¹ r over the channels that arrived, and how many those are.
fn squared_distance(
    laid: &Laid,
    filter: &LocalFilter,
    r: &[f64],
    white: &mut [f64],
    part: &mut [f64],
) -> (f64, usize) {
    let m = laid.channels;
    let mut count = 0;
    for (i, value) in r.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
        white[count] = *value;
        let earlier = (0..=i).filter(|&j| !r[j].is_nan());
        for (target, j) in part[count * m..].iter_mut().zip(earlier) {
            *target = filter.innovation_cov[i * m + j];
        }
        count += 1;
    }
    let white = &mut white[..count];
    if count == m {
        forward_solve(&laid.factor, m, white);
    } else {
        // S is positive definite, hence so is every principal part of it.
        let _ = cholesky(part, count, m, 0.0);
        forward_solve(part, m, white);
    }
    (dot(white, white), count)
}
