//! The matrices of a plant in normalised units, laid out for the kernels.

use crate::codec::Fingerprint;
use crate::kalman::ud::{semidefinite_factor, transpose};
use crate::kalman::whitening::Noise;
use crate::lanes::{self, LANES, Lane};
use crate::linalg::axpy;
use crate::{Dims, Error, Result};

/// What a plant is made of; row-major. A and C may hold one matrix per sample, one after the other.
#[derive(Debug, Clone)]
pub struct Matrices {
    /// (n, n) or (T, n, n)
    pub a: Vec<f64>,
    /// (n, p)
    pub b: Vec<f64>,
    /// (m, n) or (T, m, n)
    pub c: Vec<f64>,
    /// (m, p)
    pub d: Vec<f64>,
    /// (n, n)
    pub q: Vec<f64>,
    /// (m, m)
    pub r: Vec<f64>,
    /// Owner of every channel, (m,).
    pub channel_sensor: Vec<usize>,
    /// N.
    pub sensors: usize,
    /// n.
    pub states: usize,
}

/// Checked matrices, with the transposes whose products run along contiguous memory.
#[derive(Debug, Clone)]
pub struct Model {
    /// Sizes.
    pub dims: Dims,
    /// Samples that A and C cover; None if neither varies.
    pub horizon: Option<usize>,
    /// Owner of every channel, (m,).
    pub channel_sensor: Vec<usize>,
    /// Measurement noise.
    pub noise: Noise,
    /// Q = G diag(q) Gᵀ: G by rows, (n, q.len()).
    pub g: Vec<f64>,
    /// Weights of the columns of G.
    pub q: Vec<f64>,
    a: Vec<f64>,
    a_t: Vec<f64>,
    b: Vec<f64>,
    b_t: Vec<f64>,
    c: Vec<f64>,
    c_t: Vec<f64>,
    d: Vec<f64>,
    d_t: Vec<f64>,
    fingerprint: u64,
}

impl Model {
    /// Check shapes and covariances.
    ///
    /// # Errors
    /// A length that does not fit, an R that is not positive definite, a Q that is not positive semidefinite.
    pub fn new(given: Matrices) -> Result<Self> {
        let (n, m) = (given.states, given.channel_sensor.len());
        if n == 0 || m == 0 {
            return Err(Error::input("plant", "at least one state and one channel", "none"));
        }
        let (p, fingerprint) = (given.b.len() / n, fingerprint(&given));
        Error::check_len("B", n * p, given.b.len())?;
        Error::check_len("D", m * p, given.d.len())?;
        let horizon = horizon(samples("A", &given.a, n * n)?, samples("C", &given.c, m * n)?)?;
        if let Some(&owner) = given.channel_sensor.iter().find(|&&s| s >= given.sensors) {
            let expected = format!("indices below {}", given.sensors);
            return Err(Error::input("channel_sensor", expected, format!("{owner}")));
        }
        let (columns, q) = semidefinite_factor("Q", &given.q, n)?;
        let (a_t, c_t) = (transposes(&given.a, n, n), transposes(&given.c, m, n));
        Ok(Self {
            dims: Dims { states: n, channels: m, sensors: given.sensors, inputs: p },
            horizon,
            noise: Noise::new(given.r, m)?,
            g: transpose(&columns, q.len(), n),
            q,
            a: given.a,
            a_t,
            b_t: transpose(&given.b, n, p),
            b: given.b,
            c: given.c,
            c_t,
            d_t: transpose(&given.d, m, p),
            d: given.d,
            channel_sensor: given.channel_sensor,
            fingerprint,
        })
    }

    /// Whether the plant has a sample k.
    ///
    /// # Errors
    /// If A or C varies and does not cover it.
    pub fn check_horizon(&self, k: usize) -> Result<()> {
        match self.horizon {
            Some(horizon) if k >= horizon => Err(Error::input(
                "y",
                format!("at most {horizon} samples, as many as A and C cover"),
                "one more",
            )),
            _ => Ok(()),
        }
    }

    /// Hash of every number.
    #[must_use]
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::default().bytes(&self.fingerprint.to_le_bytes())
    }

    /// A at sample k, (n, n).
    #[must_use]
    pub fn a(&self, k: usize) -> &[f64] {
        at(&self.a, k, self.dims.states * self.dims.states)
    }

    /// Aᵀ at sample k, (n, n).
    #[must_use]
    pub fn a_t(&self, k: usize) -> &[f64] {
        at(&self.a_t, k, self.dims.states * self.dims.states)
    }

    /// C at sample k, (m, n).
    #[must_use]
    pub fn c(&self, k: usize) -> &[f64] {
        at(&self.c, k, self.dims.channels * self.dims.states)
    }

    /// Cᵀ at sample k, (n, m).
    #[must_use]
    pub fn c_t(&self, k: usize) -> &[f64] {
        at(&self.c_t, k, self.dims.channels * self.dims.states)
    }

    /// `out` = y − C x − D u, NaN where y is.
    pub fn innovation(&self, k: usize, x: &[f64], (y, u): (&[f64], &[f64]), out: &mut [f64]) {
        out.copy_from_slice(y);
        add_product(-1.0, self.c_t(k), x, out);
        add_product(-1.0, &self.d_t, u, out);
    }

    /// `out` −= D u.
    pub fn subtract_feedthrough(&self, u: &[f64], out: &mut [f64]) {
        add_product(-1.0, &self.d_t, u, out);
    }

    /// `out` += C x + D u.
    pub fn observe(&self, k: usize, x: &[f64], u: &[f64], out: &mut [f64]) {
        add_product(1.0, self.c_t(k), x, out);
        add_product(1.0, &self.d_t, u, out);
    }

    /// `out` = A x + B u.
    pub fn predict(&self, k: usize, x: &[f64], u: &[f64], out: &mut [f64]) {
        out.fill(0.0);
        add_product(1.0, self.a_t(k), x, out);
        add_product(1.0, &self.b_t, u, out);
    }

    /// As [`Model::innovation`], to the bit, for several runs.
    #[inline(always)]
    pub fn innovation_lanes(&self, k: usize, x: &[Lane], (y, u): (&[Lane], &[Lane]), out: &mut [Lane]) {
        out.copy_from_slice(y);
        lanes::add_product(-1.0, self.c(k), x, out);
        lanes::add_product(-1.0, &self.d, u, out);
    }

    /// As [`Model::predict`], to the bit, for several runs.
    #[inline(always)]
    pub fn predict_lanes(&self, k: usize, x: &[Lane], u: &[Lane], out: &mut [Lane]) {
        out.fill([0.0; LANES]);
        lanes::add_product(1.0, self.a(k), x, out);
        lanes::add_product(1.0, &self.b, u, out);
    }
}

/// `out` += sign · Σ v_j column_j, four columns per pass over `out`.
pub fn add_product(sign: f64, columns: &[f64], v: &[f64], out: &mut [f64]) {
    let size = out.len();
    let (fours, rest) = v.as_chunks::<4>();
    let (four_columns, columns) = columns.split_at(fours.len() * 4 * size);
    for (block, v) in four_columns.chunks_exact(4 * size).zip(fours) {
        let (c0, block) = block.split_at(size);
        let (c1, block) = block.split_at(size);
        let (c2, c3) = block.split_at(size);
        let [v0, v1, v2, v3] = v.map(|value| sign * value);
        for ((((target, c0), c1), c2), c3) in out.iter_mut().zip(c0).zip(c1).zip(c2).zip(c3) {
            *target += (v0 * c0 + v1 * c1) + (v2 * c2 + v3 * c3);
        }
    }
    for (column, value) in columns.chunks_exact(size).zip(rest) {
        axpy(sign * value, column, out);
    }
}

/// Matrix k of several, or the only one.
fn at(matrices: &[f64], k: usize, size: usize) -> &[f64] {
    let from = if matrices.len() == size { 0 } else { k * size };
    &matrices[from..from + size]
}

fn transposes(matrices: &[f64], rows: usize, columns: usize) -> Vec<f64> {
    let each = matrices.chunks_exact(rows * columns);
    each.flat_map(|matrix| transpose(matrix, rows, columns)).collect()
}

/// Number of matrices in an array; at least one.
fn samples(argument: &'static str, array: &[f64], size: usize) -> Result<usize> {
    let count = (array.len() / size).max(1);
    Error::check_len(argument, count * size, array.len())?;
    Ok(count)
}

fn horizon(a: usize, c: usize) -> Result<Option<usize>> {
    match (a, c) {
        (1, 1) => Ok(None),
        (1, steps) | (steps, 1) => Ok(Some(steps)),
        (a, c) if a == c => Ok(Some(a)),
        (a, c) => Err(Error::input("C", format!("{a} samples, as many as A"), format!("{c}"))),
    }
}

fn fingerprint(given: &Matrices) -> u64 {
    Fingerprint::default()
        .floats(&given.a)
        .floats(&given.b)
        .floats(&given.c)
        .floats(&given.d)
        .floats(&given.q)
        .floats(&given.r)
        .sizes(&given.channel_sensor)
        .sizes(&[given.sensors, given.states])
        .finish()
}
