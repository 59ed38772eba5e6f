//! Several runs side by side, run index innermost, so that vector registers run across runs.
//!
//! Every function does for each run what its namesake in [`crate::linalg`] or [`crate::kalman::model`] does, in the same
//! order, so that a run has the same bits alone and in company.

use crate::record::RunRecord;
use crate::{Dims, Units};

/// Runs that advance together.
pub const LANES: usize = 8;

/// One number of each run.
pub type Lane = [f64; LANES];

/// A number combined with another, run by run.
#[inline(always)]
pub fn zip(a: &Lane, b: &Lane, combine: impl Fn(f64, f64) -> f64) -> Lane {
    std::array::from_fn(|run| combine(a[run], b[run]))
}

/// a + b, run by run.
#[inline(always)]
fn add(a: Lane, b: Lane) -> Lane {
    zip(&a, &b, |a, b| a + b)
}

/// a · b for one a.
#[inline(always)]
fn times(a: f64, b: &Lane) -> Lane {
    b.map(|b| a * b)
}

/// As [`crate::linalg::dot`]: eight partial sums over every eighth entry, and the rest.
///
/// A sum that starts from −0 starts from its first term. Only one of the eight needs the +0 they all have there:
/// it alone decides the sign of a total of zero.
#[inline(always)]
pub fn dot(a: &[f64], b: &[Lane]) -> Lane {
    let (a8, a_rest) = a.as_chunks::<8>();
    let (b8, b_rest) = b.as_chunks::<8>();
    let mut tail = [-0.0; LANES];
    for (a, b) in a_rest.iter().zip(b_rest) {
        tail = zip(&tail, b, |tail, b| tail + a * b);
    }
    if a8.is_empty() {
        return add([0.0; LANES], tail);
    }
    let part = |start: f64, i: usize| {
        let mut total = [start; LANES];
        for (a, b) in a8.iter().zip(b8) {
            total = zip(&total, &b[i], |total, b| total + a[i] * b);
        }
        total
    };
    let even = add(add(part(0.0, 0), part(-0.0, 4)), add(part(-0.0, 2), part(-0.0, 6)));
    let odd = add(add(part(-0.0, 1), part(-0.0, 5)), add(part(-0.0, 3), part(-0.0, 7)));
    add(add(even, odd), tail)
}

/// As [`crate::linalg::axpy`]: y += alpha x
#[inline(always)]
pub fn axpy(alpha: &Lane, x: &[f64], y: &mut [Lane]) {
    for (target, x) in y.iter_mut().zip(x) {
        *target = zip(target, alpha, |target, alpha| target + alpha * x);
    }
}

/// As [`crate::kalman::model::add_product`], from the rows of the matrix: `out` += sign · matrix · v
#[inline(always)]
pub fn add_product(sign: f64, matrix: &[f64], v: &[Lane], out: &mut [Lane]) {
    let (v4, v_rest) = v.as_chunks::<4>();
    for (row, target) in matrix.chunks_exact(v.len().max(1)).zip(out) {
        let (row4, row_rest) = row.as_chunks::<4>();
        let mut total = *target;
        for (row, [v0, v1, v2, v3]) in row4.iter().zip(v4) {
            let [c0, c1, c2, c3] = row.map(|c| sign * c);
            let front = add(times(c0, v0), times(c1, v1));
            let back = add(times(c2, v2), times(c3, v3));
            total = add(total, add(front, back));
        }
        for (c, v) in row_rest.iter().zip(v_rest) {
            total = add(total, times(sign * c, v));
        }
        *target = total;
    }
}

/// The latest sample of several runs of one plan.
#[derive(Debug)]
pub struct Lanes {
    /// x[k|k−1], then x[k|k], (n,).
    pub x: Vec<Lane>,
    /// Scratch, (n,).
    pub next: Vec<Lane>,
    /// Measurement in normalised units, (m,).
    pub y: Vec<Lane>,
    /// Input in normalised units, (p,).
    pub u: Vec<Lane>,
    /// y − C x[k|k−1] − D u, (m,).
    pub innovation: Vec<Lane>,
    /// The innovation with independent noise, (m,).
    pub white: Vec<Lane>,
    /// As the estimator names them.
    pub diagnostics: Vec<Lane>,
}

impl Lanes {
    /// Room for one sample.
    #[must_use]
    pub fn new(dims: Dims, diagnostics: usize) -> Self {
        let room = |count| vec![[0.0; LANES]; count];
        Self {
            x: room(dims.states),
            next: room(dims.states),
            y: room(dims.channels),
            u: room(dims.inputs),
            innovation: room(dims.channels),
            white: room(dims.channels),
            diagnostics: room(diagnostics),
        }
    }

    /// Take in y (m,) and u (p,) of each run in file units; false if a number is not what [`Units`] accepts.
    #[inline(always)]
    pub fn read(&mut self, units: &Units, y: &[&[f64]; LANES], u: &[&[f64]; LANES]) -> bool {
        gather(y, &mut self.y);
        gather(u, &mut self.u);
        let infinite = |lane: &Lane| lane.iter().fold(false, |any, value| any | value.is_infinite());
        let unknown = |lane: &Lane| lane.iter().fold(false, |any, value| any | !value.is_finite());
        if self.y.iter().any(infinite) || self.u.iter().any(unknown) {
            return false;
        }
        normalise(&mut self.y, &units.offset, &units.scale);
        normalise(&mut self.u, &units.input_offset, &units.input_scale);
        true
    }

    /// Write what the data change, in file units, as sample `k` of one run.
    #[inline(always)]
    pub fn write(&self, units: &Units, run: usize, k: usize, record: &mut RunRecord<'_>) {
        let place = |lanes: &[Lane]| k * lanes.len()..(k + 1) * lanes.len();
        scatter(&self.x, run, &mut record.x[place(&self.x)]);
        scatter(&self.diagnostics, run, &mut record.diagnostics[place(&self.diagnostics)]);
        let innovation = &mut record.innovation[place(&self.innovation)];
        for ((target, lane), scale) in innovation.iter_mut().zip(&self.innovation).zip(&units.scale) {
            *target = lane[run] * scale;
        }
    }
}

/// One number of each run from arrays of the same shape: number i of array r becomes `out[i][r]`.
#[inline(always)]
pub fn gather(arrays: &[&[f64]; LANES], out: &mut [Lane]) {
    let arrays = arrays.map(|array| &array[..out.len()]);
    for (i, lane) in out.iter_mut().enumerate() {
        *lane = std::array::from_fn(|run| arrays[run][i]);
    }
}

/// The numbers of one run.
#[inline(always)]
pub fn scatter(lanes: &[Lane], run: usize, out: &mut [f64]) {
    for (target, lane) in out.iter_mut().zip(lanes) {
        *target = lane[run];
    }
}

/// From file units.
#[inline(always)]
fn normalise(lanes: &mut [Lane], offset: &[f64], scale: &[f64]) {
    for ((lane, offset), scale) in lanes.iter_mut().zip(offset).zip(scale) {
        *lane = lane.map(|value| (value - offset) / scale);
    }
}
