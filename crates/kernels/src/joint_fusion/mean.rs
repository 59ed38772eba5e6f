//! The part of a step that sees data: (6), (7) and (8).

use crate::joint_fusion::covariance::Design;
use crate::joint_fusion::gains::Gains;
use crate::kalman::model::add_product;
use crate::linalg::{axpy, dot};
use crate::{Output, Result};

/// A surprise beyond this is held there, so that no outlier can drive a state beyond all numbers.
const LARGEST: f64 = 1e100;

/// [x⁻; θ⁻; φ̂] of all locals before a sample, [x̂; θ̂; φ̂] after it, and x⁻ of the fused estimate.
#[derive(Debug, Clone)]
pub struct Mean {
    locals: Vec<f64>,
    fused: Vec<f64>,
    /// y − D u, (m,).
    base: Vec<f64>,
    /// ỹ of one local.
    surprise: Vec<f64>,
    next: Vec<f64>,
    /// J ỹ of one local.
    shift: Vec<f64>,
}

impl Mean {
    /// Before the first sample: x⁻ = `mean` everywhere, no injections so far.
    #[must_use]
    pub fn new(design: &Design, mean: &[f64]) -> Self {
        let layout = &design.layout;
        let mut locals = vec![0.0; layout.states];
        for local in &layout.locals {
            locals[local.state(layout.n)][..layout.n].copy_from_slice(mean);
        }
        let tallest = layout.locals.iter().map(|local| local.height()).max().unwrap_or(0);
        Self {
            locals,
            fused: mean.to_vec(),
            base: vec![0.0; design.model.dims.channels],
            surprise: vec![0.0; tallest],
            next: vec![0.0; layout.n],
            shift: vec![0.0; layout.locals.iter().map(|local| local.size(layout.n)).max().unwrap_or(0)],
        }
    }

    /// [x⁻; θ⁻; φ̂] of all locals.
    #[must_use]
    pub fn states(&self) -> &[f64] {
        &self.locals
    }

    /// x⁻ of the fused estimate.
    #[must_use]
    pub fn predicted(&self) -> &[f64] {
        &self.fused
    }

    /// From x⁻ to x̂ of every local and of all together; reports everything but who is trusted.
    ///
    /// `reach` bounds |y − C x⁻ − D u| of every injection, (Σ p_i,); empty for no bound.
    pub fn correct(
        &mut self,
        design: &Design,
        (gains, reach): (&Gains, &[f64]),
        k: usize,
        (y, u): (&[f64], &[f64]),
        out: &mut Output<'_>,
    ) {
        let (layout, model, n) = (&design.layout, &design.model, design.layout.n);
        model.innovation(k, &self.fused, (y, u), out.innovation);
        out.innovation_std.copy_from_slice(&gains.innovation_std);
        self.base.copy_from_slice(y);
        model.subtract_feedthrough(u, &mut self.base);
        out.attack.fill(f64::NAN);
        out.attack_std.fill(f64::NAN);
        let c = model.c(k);
        for (local, columns) in layout.locals.iter().zip(&gains.columns.0) {
            let own = &mut self.locals[local.state(n)];
            let surprise = &mut self.surprise[..local.height()];
            for (row, (value, &channel)) in surprise.iter_mut().zip(&local.channels).enumerate() {
                let seen = dot(&c[channel * n..(channel + 1) * n], &own[..n]);
                let injected = if row < local.weak { own[n + row] } else { 0.0 };
                let bound = if row < local.weak { reach.get(local.first_weak + row) } else { None };
                let off = self.base[channel] - seen;
                let given = bound.map_or(off, |&bound| off.clamp(-bound, bound)) - injected;
                *value = if given.is_nan() { 0.0 } else { given.clamp(-LARGEST, LARGEST) };
            }
            let shift = &mut self.shift[..own.len()];
            shift.fill(0.0);
            add_product(1.0, columns.numbers(), surprise, shift);
            let (estimates, inputs) = own.split_at_mut(n + local.weak);
            axpy(1.0, shift, estimates); // [x̂; θ̂] += K ỹ
            axpy(-1.0, &shift[n + local.weak..], inputs); // φ̂ += Γ ỹ
            for (q, &channel) in local.channels[..local.weak].iter().enumerate() {
                if !y[channel].is_nan() {
                    out.attack[channel] = estimates[n + q];
                    out.attack_std[channel] = gains.attack_std[local.first_weak + q];
                }
            }
        }
        self.fuse(design, gains, out);
    }

    /// x̂_0 = x̂_1 + Σ G_i (x̂_i − x̂_1), (8) with Σ G_i = I.
    fn fuse(&mut self, design: &Design, gains: &Gains, out: &mut Output<'_>) {
        let n = design.layout.n;
        let Some((first, others)) = design.layout.locals.split_first() else { return };
        out.x.copy_from_slice(&self.locals[first.state(n)][..n]);
        for (i, local) in others.iter().enumerate() {
            let own = &self.locals[local.state(n)][..n];
            let lead = &self.locals[first.state(n)][..n];
            self.next.iter_mut().zip(own.iter().zip(lead)).for_each(|(d, (own, lead))| *d = own - lead);
            let columns = &gains.columns.1.numbers()[(i + 1) * n * n..(i + 2) * n * n];
            add_product(1.0, columns, &self.next, out.x);
        }
        out.x_std.copy_from_slice(&gains.x_std);
        if let Some(covariance) = out.covariance.as_deref_mut() {
            covariance.copy_from_slice(gains.covariance.numbers());
        }
    }

    /// From x̂ to x⁻ of the next sample, everywhere; θ⁻ = θ̂ + φ̂.
    pub fn predict(&mut self, design: &Design, k: usize, u: &[f64], fused: &[f64]) {
        let (layout, n) = (&design.layout, design.layout.n);
        for local in &layout.locals {
            let own = &mut self.locals[local.state(n)];
            design.model.predict(k, &own[..n], u, &mut self.next);
            own[..n].copy_from_slice(&self.next);
            let (injected, inputs) = own[n..].split_at_mut(local.weak);
            axpy(1.0, inputs, injected);
        }
        design.model.predict(k, fused, u, &mut self.fused);
    }

    /// All arrays that decide how it goes on.
    pub fn each(&self, mut visit: impl FnMut(&[f64])) {
        visit(&self.locals);
        visit(&self.fused);
    }

    /// The same arrays, to be read back.
    ///
    /// # Errors
    /// The first of `visit`.
    pub fn each_mut(&mut self, mut visit: impl FnMut(&mut [f64]) -> Result<()>) -> Result<()> {
        visit(&mut self.locals)?;
        visit(&mut self.fused)
    }
}
