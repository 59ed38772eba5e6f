//! Covariance of the secure estimate: without the sensors in use, and after samples without measurements.

use super::{Scratch, SparseFusion, State};
use crate::estimator::Output;
use crate::linalg::{axpy, cholesky, cholesky_solve, dot, gemv, norm};

/// A pivot of the accused sensors' information below this share means the others do not determine the state.
const UNDETERMINED: f64 = 1e-9;
/// The covariance counts as steady again when it is this close, relative to its largest entry.
const STEADY: f64 = 1e-10;

impl SparseFusion {
    /// P[k|k] into `out`; false if the sensors without accusation do not determine the state.
    ///
    /// With the groups S in use, g_S = J⁻¹ (ν_S − …) to first order, J = H_SS + D and D the curvature of the
    /// penalty. Cov ν_S = H_SS and ν is uncorrelated with the Kalman error, so with Z = F_S J⁻¹
    ///     Cov x_s = P + Z H_SS Zᵀ + β βᵀ,   β = Z γ g/‖g‖ the shrinkage of the penalty.
    /// For freed sensors D = β = 0: the covariance of the Kalman estimate without them.
    pub(super) fn covariance(&self, state: &mut State, out: &mut Output<'_>) -> bool {
        let n = self.m.dims.states;
        let scratch = &mut state.scratch;
        scratch.square.copy_from_slice(if state.transient { &state.p } else { &self.m.p });
        let determined = self.collect_support(&state.g, scratch) && {
            self.add_uncertainty(&state.g, scratch);
            true
        };
        if !determined {
            scratch.square.fill(f64::INFINITY);
        }
        for (i, std) in out.x_std.iter_mut().enumerate() {
            *std = scratch.square[i * n + i].max(0.0).sqrt();
        }
        if let Some(target) = out.covariance.as_deref_mut() {
            target.copy_from_slice(&scratch.square);
        }
        determined
    }

    /// Whether the sensors with a penalty determine what the free ones inject: H on the free ones is regular.
    pub(super) fn free_sensors_are_determined(&self, scratch: &mut Scratch) -> bool {
        let groups = &self.m.groups;
        scratch.support.clear();
        scratch.support.extend((0..self.m.gamma.len()).filter(|&j| scratch.gamma[j] == 0.0));
        let d = self.elements();
        let k: usize = scratch.support.iter().map(|&j| groups[j + 1] - groups[j]).sum();
        if scratch.factor.len() < k * k {
            scratch.factor.resize(k * k, 0.0);
            scratch.half.resize(2 * k, 0.0);
        }
        for (row, i) in elements(groups, &scratch.support).enumerate() {
            for (column, j) in elements(groups, &scratch.support).enumerate().take(row + 1) {
                scratch.factor[row * k + column] = self.m.hessian[i * d + j];
            }
        }
        cholesky(&mut scratch.factor, k, k, UNDETERMINED).is_ok()
    }

    /// The groups in use, and the Cholesky factor of J. False if J is singular.
    fn collect_support(&self, g: &[f64], scratch: &mut Scratch) -> bool {
        let (groups, d) = (&self.m.groups, self.elements());
        scratch.support.clear();
        let used = |j: &usize| g[groups[*j]..groups[*j + 1]].iter().any(|&v| v != 0.0);
        scratch.support.extend((0..self.m.gamma.len()).filter(used));
        let k = scratch.support.iter().map(|&j| groups[j + 1] - groups[j]).sum();
        if scratch.factor.len() < k * k {
            scratch.factor.resize(k * k, 0.0);
            scratch.half.resize(2 * k, 0.0);
        }
        let mut row = 0;
        for &a in &scratch.support {
            let bend = Bend::new(scratch.gamma[a], &g[groups[a]..groups[a + 1]]);
            for i in groups[a]..groups[a + 1] {
                let mut column = 0;
                for &c in &scratch.support {
                    for j in groups[c]..groups[c + 1] {
                        let own = if a == c { bend.entry(i - groups[a], j - groups[a]) } else { 0.0 };
                        scratch.factor[row * k + column] = self.m.hessian[i * d + j] + own;
                        column += 1;
                    }
                }
                row += 1;
            }
        }
        scratch.used = k;
        cholesky(&mut scratch.factor, k, k, UNDETERMINED).is_ok()
    }

    /// square += Z H_SS Zᵀ + β βᵀ, row by row: H_SS z = f − D z for J z = f.
    fn add_uncertainty(&self, g: &[f64], scratch: &mut Scratch) {
        let (n, d, k) = (self.m.dims.states, self.elements(), scratch.used);
        let groups = &self.m.groups;
        for a in 0..n {
            let (z, image) = scratch.half[..2 * k].split_at_mut(k);
            let mut at = 0;
            for &j in &scratch.support {
                let width = groups[j + 1] - groups[j];
                z[at..at + width].copy_from_slice(&self.m.fusion_g[a * d + groups[j]..][..width]);
                at += width;
            }
            image.copy_from_slice(z);
            cholesky_solve(&scratch.factor, k, z);
            let (mut shrinkage, mut at) = (0.0, 0);
            for &j in &scratch.support {
                let part = &g[groups[j]..groups[j + 1]];
                let range = at..at + part.len();
                let bend = Bend::new(scratch.gamma[j], part);
                shrinkage += scratch.gamma[j] * dot(bend.direction, &z[range.clone()]) / bend.length;
                bend.subtract(&z[range.clone()], &mut image[range]);
                at += part.len();
            }
            scratch.shrinkage[a] = shrinkage;
            // row a of Z H_SS Zᵀ = (H_SS z_a)ᵀ Zᵀ = (J⁻¹ H_SS z_a)ᵀ F_Sᵀ
            cholesky_solve(&scratch.factor, k, image);
            for c in 0..n {
                let (mut extra, mut at) = (0.0, 0);
                for &j in &scratch.support {
                    let width = groups[j + 1] - groups[j];
                    let row = &self.m.fusion_g[c * d + groups[j]..][..width];
                    extra += dot(&image[at..at + width], row);
                    at += width;
                }
                scratch.square[a * n + c] += extra;
            }
        }
        symmetrise(&mut scratch.square, n);
        for a in 0..n {
            for c in 0..n {
                scratch.square[a * n + c] += scratch.shrinkage[a] * scratch.shrinkage[c];
            }
        }
    }

    /// True covariance of the fixed-gain filter after samples without any measurement.
    pub(super) fn track_covariance(&self, state: &mut State, arrived: bool) {
        if arrived && !state.transient {
            return;
        }
        let m = &self.m;
        let n = m.dims.states;
        let (square, square_2) = (&mut state.scratch.square, &mut state.scratch.square_2);
        if !state.transient {
            state.p.copy_from_slice(&m.p);
        }
        congruence(&m.a, &state.p, square, square_2, n);
        axpy(1.0, &m.q, square_2);
        if arrived {
            state.p.copy_from_slice(square_2);
            congruence(&m.ikc, &state.p, square, square_2, n);
            axpy(1.0, &m.krk, square_2);
        }
        state.p.copy_from_slice(square_2);
        let largest = m.p.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
        let distance = m.p.iter().zip(&state.p).fold(0.0_f64, |a, (p, q)| a.max((p - q).abs()));
        state.transient = distance > STEADY * largest;
    }
}

/// Elements of these groups, in order.
fn elements(groups: &[usize], support: &[usize]) -> impl Iterator<Item = usize> {
    support.iter().flat_map(|&j| groups[j]..groups[j + 1])
}

/// Second derivative γ/‖g‖ (I − g gᵀ/‖g‖²) of the penalty of one group.
struct Bend<'a> {
    strength: f64,
    direction: &'a [f64],
    length: f64,
}

impl<'a> Bend<'a> {
    fn new(gamma: f64, g: &'a [f64]) -> Self {
        let length = norm(g);
        Self { strength: gamma / length, direction: g, length }
    }

    fn entry(&self, i: usize, j: usize) -> f64 {
        let along = self.direction[i] / self.length * (self.direction[j] / self.length);
        self.strength * (if i == j { 1.0 } else { 0.0 } - along)
    }

    /// image −= D z
    fn subtract(&self, z: &[f64], image: &mut [f64]) {
        let along = dot(self.direction, z) / (self.length * self.length);
        for ((target, value), direction) in image.iter_mut().zip(z).zip(self.direction) {
            *target -= self.strength * (value - along * direction);
        }
    }
}

fn symmetrise(a: &mut [f64], n: usize) {
    for i in 0..n {
        for j in 0..i {
            let mean = 0.5 * (a[i * n + j] + a[j * n + i]);
            a[i * n + j] = mean;
            a[j * n + i] = mean;
        }
    }
}

/// result = A P Aᵀ for symmetric P, `half` = A P.
fn congruence(a: &[f64], p: &[f64], half: &mut [f64], result: &mut [f64], n: usize) {
    for i in 0..n {
        gemv(p, &a[i * n..(i + 1) * n], &mut half[i * n..(i + 1) * n]);
    }
    for i in 0..n {
        for j in 0..=i {
            let value = dot(&half[i * n..(i + 1) * n], &a[j * n..(j + 1) * n]);
            result[i * n + j] = value;
            result[j * n + i] = value;
        }
    }
}
