//! Covariance of the secure estimate: without the sensors in use, and after samples without measurements.

use super::{Scratch, SparseFusion, State};
use crate::estimator::Output;
use crate::linalg::{axpy, cholesky, dot, forward_solve, gemv};

/// A pivot of the accused sensors' information below this share means the others do not determine the state.
const UNDETERMINED: f64 = 1e-9;
/// The covariance counts as steady again when it is this close, relative to its largest entry.
const STEADY: f64 = 1e-10;

impl SparseFusion {
    /// P, or P + F_S H_SS⁻¹ F_Sᵀ when the elements S are in use: what is left without them. False if undetermined.
    pub(super) fn covariance(&self, state: &mut State, out: &mut Output<'_>) -> bool {
        let (n, d) = (self.m.dims.states, self.elements());
        let scratch = &mut state.scratch;
        scratch.square.copy_from_slice(if state.transient { &state.p } else { &self.m.p });
        scratch.support.clear();
        scratch.support.extend((0..d).filter(|&i| state.g[i] != 0.0));
        let k = scratch.support.len();
        let mut determined = true;
        if k > 0 {
            if scratch.factor.len() < k * k {
                scratch.factor.resize(k * k, 0.0);
                scratch.half.resize(k * n, 0.0);
            }
            for (row, &i) in scratch.support.iter().enumerate() {
                for (column, &j) in scratch.support[..=row].iter().enumerate() {
                    scratch.factor[row * k + column] = self.m.hessian[i * d + j];
                }
            }
            determined = cholesky(&mut scratch.factor, k, k, UNDETERMINED).is_ok();
            if determined {
                self.add_uncertainty(scratch, k);
            } else {
                scratch.square.fill(f64::INFINITY);
            }
        }
        for (i, std) in out.x_std.iter_mut().enumerate() {
            *std = scratch.square[i * n + i].max(0.0).sqrt();
        }
        if let Some(target) = out.covariance.as_deref_mut() {
            target.copy_from_slice(&scratch.square);
        }
        determined
    }

    /// square += (L⁻¹ F_Sᵀ)ᵀ (L⁻¹ F_Sᵀ)
    fn add_uncertainty(&self, scratch: &mut Scratch, k: usize) {
        let (n, d) = (self.m.dims.states, self.elements());
        for a in 0..n {
            let row = &mut scratch.half[a * k..(a + 1) * k];
            for (value, &j) in row.iter_mut().zip(&scratch.support) {
                *value = self.m.fusion_g[a * d + j];
            }
            forward_solve(&scratch.factor, k, row);
        }
        for a in 0..n {
            for c in 0..=a {
                let extra = dot(&scratch.half[a * k..(a + 1) * k], &scratch.half[c * k..(c + 1) * k]);
                scratch.square[a * n + c] += extra;
                if a != c {
                    scratch.square[c * n + a] += extra;
                }
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
