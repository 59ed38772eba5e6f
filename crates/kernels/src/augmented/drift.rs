//! A constant drift φ of the injections, estimated by recursive least squares with forgetting.
//!
//! ```text
//!     X[k+1] = A X[k] + F φ + w,   F = [0; I]
//!     Ω = C Υ⁻,   Υ = (I − K C) Υ⁻,   Υ⁻ ← A Υ + F
//!     Λ = (λ Σ + Ω S Ωᵀ)⁻¹,   Γ = S Ωᵀ Λ,   S ← (S − S Ωᵀ Λ Ω S) / λ
//!     φ ← φ + Γ (y − C X⁻),   X = X⁻ + K (y − C X⁻) + Υ (φ[k] − φ[k−1])
//! ```
//!
//! K and Σ are those of the Kalman filter that takes φ for zero. With its state X⁰, which starts where X does,
//! X = X⁰ + Υ φ at all times, and S ← S/λ followed by a plain correction by Ω gives S and Γ as above. So X⁰ runs on its own,
//! and what is new in its innovations is a measurement of φ with independent noise of variance 1 per channel.
//!
//! # References
//! Zhang 2018, eqs (5a)–(5l). Deviation: the drift of a channel that did not arrive is not forgotten, so that S does
//! not grow while nothing is heard. With every channel present the recursion is the printed one.

use crate::codec::{Decoder, Encoder};
use crate::kalman::gains::{Gains, Scratch};
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::kalman::whitening::LogProduct;
use crate::linalg::{axpy, dot};
use crate::{Dims, Result};

/// A variance of φ this many times those that it starts from and is measured with has nothing left of what was known.
const GROWTH: f64 = 1.0 / f64::EPSILON;

/// The settings.
#[derive(Debug, Clone)]
pub struct Forgetting {
    /// λ in (0, 1].
    pub factor: f64,
    /// Variance of φ before the first sample, per weak channel, (w,), positive.
    pub start: Vec<f64>,
}

/// φ, S and Υ⁻, with scratch.
#[derive(Debug, Clone)]
pub struct Drift {
    /// φ, (w,).
    pub phi: Vec<f64>,
    /// S.
    s: Ud,
    /// Υ by columns, (w, N): before a sample Υ⁻.
    upsilon: Vec<f64>,
    /// Ω by columns, (w, m).
    omega: Vec<f64>,
    /// What is new in Ω, by columns, (w, m).
    news: Vec<f64>,
    /// What is new in the innovation, (m,).
    fresh: Vec<f64>,
    /// Column of Υ U, (N,).
    column: Vec<f64>,
    row: Vec<f64>,
    f: Vec<f64>,
    gain: Vec<f64>,
    variances: Vec<f64>,
    limit: Vec<f64>,
}

impl Drift {
    /// Before the first sample of the augmented `model`, with these weak channels.
    #[must_use]
    pub fn new(forgetting: &Forgetting, model: &Model, weak: &[usize]) -> Self {
        let (w, Dims { states: n, channels: m, .. }) = (weak.len(), model.dims);
        let noise = weak.iter().map(|&channel| model.noise.r[channel * m + channel]);
        let zeros = || vec![0.0; w];
        let mut drift = Self {
            phi: zeros(),
            s: Ud::zero(w),
            upsilon: vec![0.0; w * n],
            omega: vec![0.0; w * m],
            news: vec![0.0; w * m],
            fresh: vec![0.0; m],
            column: vec![0.0; n],
            row: zeros(),
            f: zeros(),
            gain: zeros(),
            variances: zeros(),
            limit: noise.zip(&forgetting.start).map(|(r, start)| GROWTH * (r + start)).collect(),
        };
        drift.restart(forgetting);
        drift.enter();
        drift
    }

    /// Forget everything about φ; X is X⁰.
    pub fn restart(&mut self, forgetting: &Forgetting) {
        self.phi.fill(0.0);
        self.upsilon.fill(0.0);
        self.s.u.fill(0.0);
        self.s.d.copy_from_slice(&forgetting.start);
    }

    /// Υ⁻ ← Υ⁻ + F: from the next sample on φ enters.
    fn enter(&mut self) {
        let (w, n) = (self.phi.len(), self.column.len());
        for (j, column) in self.upsilon.chunks_exact_mut(n).enumerate() {
            column[n - w + j] += 1.0;
        }
    }

    /// S ← S / λ for the channels that arrived.
    pub fn forget(&mut self, forgetting: &Forgetting, weak: &[usize], y: &[f64]) {
        let wider = 1.0 / forgetting.factor.sqrt();
        for (factor, &channel) in self.f.iter_mut().zip(weak) {
            *factor = if y[channel].is_nan() { 1.0 } else { wider };
        }
        self.s.scale(&self.f);
    }

    /// Ω, the innovation about X⁻ in place of X⁰⁻ and its standard deviation.
    pub fn foresee(&mut self, model: &Model, k: usize, innovation: &mut [f64], deviation: &mut [f64]) {
        let (n, m) = (self.column.len(), innovation.len());
        self.omega.fill(0.0);
        let columns = self.omega.chunks_exact_mut(m).zip(self.upsilon.chunks_exact(n));
        for ((omega, upsilon), phi) in columns.zip(&self.phi) {
            model.observe(k, upsilon, &[], omega);
            axpy(-phi, omega, innovation);
        }
        for (i, std) in deviation.iter_mut().enumerate() {
            let omega = self.omega.chunks_exact(m);
            self.row.iter_mut().zip(omega).for_each(|(target, column)| *target = column[i] / *std);
            *std *= self.s.variance(&self.row).sqrt();
        }
    }

    /// φ, S and Υ after the sample with these gains and the innovation about X⁻; notes likelihood and distance.
    pub fn correct(&mut self, gains: &Gains, innovation: &[f64], scratch: &mut Scratch, numbers: &mut [f64]) {
        let (n, m) = (self.column.len(), innovation.len());
        gains.surprises(innovation, scratch, &mut self.fresh);
        let columns = self.upsilon.chunks_exact_mut(n).zip(self.omega.chunks_exact(m));
        for ((upsilon, omega), news) in columns.zip(self.news.chunks_exact_mut(m)) {
            gains.surprises(omega, scratch, news);
            axpy(-1.0, &scratch.state, upsilon);
        }
        let (mut nis, mut log_det) = (0.0, LogProduct::default());
        let shift = &mut self.variances; // φ[k] − φ[k−1]
        shift.fill(0.0);
        for (j, fresh) in self.fresh[..gains.channels().len()].iter().enumerate() {
            self.row.iter_mut().zip(self.news.chunks_exact(m)).for_each(|(h, column)| *h = column[j]);
            let surprise = fresh - dot(&self.row, shift);
            let s = self.s.condition(&self.row, &mut self.f, &mut self.gain);
            axpy(surprise, &self.gain, shift);
            nis += surprise * surprise / s;
            log_det.multiply(s);
        }
        axpy(1.0, shift, &mut self.phi);
        numbers[0] = -0.5 * (gains.log_det() + log_det.log() + nis);
        numbers[1] = nis;
    }

    /// X⁰ + Υ φ and P + Υ S Υᵀ in place of X⁰ and P.
    pub fn add_to(&mut self, state: &mut [f64], covariance: &mut [f64]) {
        let n = state.len();
        for (j, upsilon) in self.upsilon.chunks_exact(n).enumerate() {
            axpy(self.phi[j], upsilon, state);
            self.column.copy_from_slice(upsilon);
            for (u, earlier) in self.s.column(j).iter().zip(self.upsilon.chunks_exact(n)) {
                axpy(*u, earlier, &mut self.column);
            }
            for (row, value) in covariance.chunks_exact_mut(n).zip(&self.column) {
                axpy(self.s.d[j] * value, &self.column, row);
            }
        }
    }

    /// Whether every number is finite, and S has not lost all that was ever known.
    pub fn is_sound(&mut self) -> bool {
        self.s.variances(&mut self.variances);
        let bounded = self.variances.iter().zip(&self.limit).all(|(variance, limit)| variance < limit);
        bounded && self.phi.iter().chain(&self.upsilon).all(|value| value.is_finite())
    }

    /// Υ⁻ ← A Υ + F.
    pub fn predict(&mut self, model: &Model, k: usize) {
        for upsilon in self.upsilon.chunks_exact_mut(self.column.len()) {
            model.predict(k, upsilon, &[], &mut self.column);
            upsilon.copy_from_slice(&self.column);
        }
        self.enter();
    }

    /// Write everything that the next sample depends on.
    pub fn save(&self, to: &mut Encoder) {
        to.floats(&self.phi);
        to.floats(&self.upsilon);
        to.floats(&self.s.d);
        to.floats(&self.s.u);
    }

    /// Read it back.
    ///
    /// # Errors
    /// If the lengths do not fit.
    pub fn load(&mut self, from: &mut Decoder<'_>) -> Result<()> {
        from.floats(&mut self.phi)?;
        from.floats(&mut self.upsilon)?;
        from.floats(&mut self.s.d)?;
        from.floats(&mut self.s.u)
    }
}
