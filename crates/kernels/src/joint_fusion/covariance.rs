//! The part of a step that does not see data: gains and weights, from moments that move on.

use crate::Result;
use crate::joint_fusion::array::Array;
use crate::joint_fusion::exact::Exact;
use crate::joint_fusion::fusion::{Fusion, Rule};
use crate::joint_fusion::gains::Gains;
use crate::joint_fusion::layout::{Layout, Pattern};
use crate::joint_fusion::printed::Printed;
use crate::kalman::model::Model;
use crate::linalg::dot;
use crate::matrix::Matrix;

/// Whose recursions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// Exact second moments, form of Joseph.
    Exact,
    /// The same, kept as factors U D Uᵀ of all locals together.
    SquareRoot,
    /// As printed in the paper.
    Printed,
}

/// The moments of all locals.
#[derive(Debug, Clone)]
pub enum Moments {
    /// Exact second moments.
    Exact(Box<Exact>),
    /// Exact second moments as factors.
    Array(Box<Array>),
    /// As printed.
    Printed(Box<Printed>),
}

/// What is designed once.
#[derive(Debug, Clone)]
pub struct Design {
    /// The plant, all channels.
    pub model: Model,
    /// Who is stacked with whom.
    pub layout: Layout,
    /// Whose recursions.
    pub form: Form,
    /// How estimates are fused.
    pub rule: Rule,
    /// Q, (n, n).
    pub q: Vec<f64>,
}

/// Everything that decides the gains of the next sample.
#[derive(Debug, Clone)]
pub struct Covariance {
    /// Moments before the sample.
    pub moments: Moments,
    /// A P_0 Aᵀ + Q, (n, n).
    pub fused: Matrix,
    /// Gains of the latest sample.
    pub gains: Gains,
    /// The rows and η of the latest sample.
    pub pattern: Pattern,
    /// With the same rows and η the moments repeat themselves.
    pub settled: bool,
    /// `gains` belong to the moments and `pattern`.
    pub cached: bool,
    fusion: Fusion,
    scratch: [Matrix; 2],
}

impl Design {
    /// A design for `model`.
    #[must_use]
    pub fn new(model: Model, layout: Layout, form: Form, rule: Rule) -> Self {
        let (n, r) = (layout.n, model.q.len());
        let mut q = vec![0.0; n * n];
        for a in 0..n {
            for b in 0..n {
                let (left, right) = (&model.g[a * r..(a + 1) * r], &model.g[b * r..(b + 1) * r]);
                q[a * n + b] = left.iter().zip(right).zip(&model.q).map(|((g, h), q)| g * q * h).sum();
            }
        }
        Self { model, layout, form, rule, q }
    }

    /// Before the first sample: covariance `p` (n, n) of x[0|−1], no injections so far.
    ///
    /// # Errors
    /// If `p` is no covariance.
    pub fn start(&self, p: &[f64], eta: &[f64]) -> Result<Covariance> {
        let (layout, n) = (&self.layout, self.layout.n);
        let moments = match self.form {
            Form::Exact => Moments::Exact(Box::new(Exact::new(layout, p))),
            Form::SquareRoot => Moments::Array(Box::new(Array::new(layout, &self.model, p)?)),
            Form::Printed => Moments::Printed(Box::new(Printed::new(layout, p, eta))),
        };
        Ok(Covariance {
            moments,
            fused: Matrix::from_rows(n, n, p),
            gains: Gains::new(layout, self.model.dims.channels),
            pattern: Pattern::full(layout, eta),
            settled: false,
            cached: false,
            fusion: Fusion::new(self.rule, n, layout.count()),
            scratch: std::array::from_fn(|_| Matrix::zeros(n, n)),
        })
    }

    /// Gains for sample k.
    pub fn correct(&self, p: &mut Covariance, k: usize, pattern: &Pattern) {
        let repeats = p.settled && p.pattern == *pattern;
        if repeats && p.cached {
            return;
        }
        p.cached = repeats;
        self.correct_moments(p, k, pattern);
        self.fuse(p);
        self.innovation_deviations(p, k);
    }

    /// Gains of the locals, and all moments after the sample.
    fn correct_moments(&self, p: &mut Covariance, k: usize, pattern: &Pattern) {
        p.pattern.copy_from(pattern);
        let (layout, model) = (&self.layout, &self.model);
        match &mut p.moments {
            Moments::Exact(exact) => exact.correct(layout, model, k, pattern, &mut p.gains),
            Moments::Array(array) => array.correct(layout, model, k, pattern, &mut p.gains),
            Moments::Printed(printed) => {
                printed.correct(layout, model, k, (pattern, &self.q), &mut p.gains);
            }
        }
    }

    /// Σ, weights and P_0.
    fn fuse(&self, p: &mut Covariance) {
        let layout = &self.layout;
        match &mut p.moments {
            Moments::Exact(exact) => {
                layout.pairs().for_each(|(i, j)| p.fusion.put((i, j), &exact.work[layout.pair(i, j)]));
            }
            Moments::Array(array) => {
                for pair in layout.pairs() {
                    array.block(layout.n, pair, &mut p.scratch[0]);
                    p.fusion.put(pair, &p.scratch[0]);
                }
            }
            Moments::Printed(printed) => {
                printed.own.iter().enumerate().for_each(|(i, own)| p.fusion.put((i, i), &own.px));
                let pairs = layout.pairs().filter(|(i, j)| i < j).zip(&printed.cross);
                pairs.for_each(|(pair, cross)| p.fusion.put(pair, &cross.px));
                if p.cached {
                    printed.stay();
                }
            }
        }
        p.fusion.fuse(&mut p.gains);
        p.gains.lay_out();
    }

    /// Moments that repeat themselves when every row arrives, from covariance `p` (n, n); None if they do not within
    /// `limit` samples.
    ///
    /// # Errors
    /// If `p` is no covariance.
    pub fn settle(&self, p: &[f64], eta: &[f64], limit: usize) -> Result<Option<Covariance>> {
        let mut p = self.start(p, eta)?;
        let pattern = p.pattern.clone();
        for _ in 0..limit {
            self.correct_moments(&mut p, 0, &pattern);
            if p.gains.broken {
                return Ok(None);
            }
            self.predict_moments(&mut p, 0);
            if p.settled {
                self.correct(&mut p, 0, &pattern);
                self.predict_fused(&mut p, 0);
                self.innovation_deviations(&mut p, 0);
                return Ok((!p.gains.broken).then_some(p));
            }
        }
        Ok(None)
    }

    /// sqrt diag(C (A P_0 Aᵀ + Q) Cᵀ + R).
    fn innovation_deviations(&self, p: &mut Covariance, k: usize) {
        let (n, m, c) = (self.layout.n, self.model.dims.channels, self.model.c(k));
        for (i, deviation) in p.gains.innovation_std.iter_mut().enumerate() {
            let row = &c[i * n..(i + 1) * n];
            let spread: f64 = (0..n).map(|a| row[a] * dot(p.fused.row(a), row)).sum();
            *deviation = (spread.max(0.0) + self.model.noise.r[i * m + i]).sqrt();
        }
    }

    /// From the latest gains of sample k to the moments before the next.
    pub fn predict(&self, p: &mut Covariance, k: usize) {
        if p.cached {
            return;
        }
        self.predict_moments(p, k);
        self.predict_fused(p, k);
    }

    fn predict_moments(&self, p: &mut Covariance, k: usize) {
        let constant = self.model.horizon.is_none() && !p.gains.broken;
        p.settled = match &mut p.moments {
            Moments::Exact(exact) => {
                exact.predict(&self.layout, &self.model, k, &self.q);
                let repeats = exact.repeats(&self.layout);
                exact.take_over();
                repeats
            }
            Moments::Array(array) => {
                array.predict(&self.layout, &self.model, k);
                let repeats = array.repeats();
                array.take_over();
                repeats
            }
            Moments::Printed(printed) => printed.repeats(),
        } && constant;
    }

    fn predict_fused(&self, p: &mut Covariance, k: usize) {
        let (n, [a, half]) = (self.layout.n, &mut p.scratch);
        a.numbers_mut().copy_from_slice(self.model.a(k));
        half.set_product(a, &p.gains.covariance);
        p.fused.set_product_transposed(half, a);
        crate::linalg::axpy(1.0, &self.q, p.fused.numbers_mut());
        debug_assert_eq!(p.fused.rows(), n);
    }
}

impl Covariance {
    /// Covariance of x⁻ of one local, (n, n); zero for the printed form, whose moments are not of that kind.
    pub fn local_prior(&self, n: usize, i: usize, out: &mut Matrix) {
        match &self.moments {
            Moments::Exact(exact) => exact.local_prior(n, i, out),
            Moments::Array(array) => array.local_prior(n, i, out),
            Moments::Printed(_) => out.set_zero(),
        }
    }

    /// Σ after the latest correction, (n r, n r).
    #[must_use]
    pub fn sigma(&self) -> &Matrix {
        &self.fusion.sigma
    }

    /// Whether a sample was before, where that cannot be told from the moments.
    #[must_use]
    pub fn is_moved(&self) -> bool {
        matches!(&self.moments, Moments::Printed(printed) if printed.moved)
    }

    /// Note whether a sample was before.
    pub fn set_moved(&mut self, moved: bool) {
        if let Moments::Printed(printed) = &mut self.moments {
            printed.moved = moved;
        }
    }

    /// Equal to the bit in everything that decides how it goes on.
    #[must_use]
    pub fn same(&self, other: &Self) -> bool {
        let mut ours = Vec::new();
        let mut theirs = Vec::new();
        self.each(|numbers| ours.extend(numbers.iter().map(|v| v.to_bits())));
        other.each(|numbers| theirs.extend(numbers.iter().map(|v| v.to_bits())));
        let moved = self.is_moved() == other.is_moved();
        moved && self.settled == other.settled && self.pattern == other.pattern && ours == theirs
    }

    /// All arrays that decide how it goes on, one after the other.
    pub fn each(&self, mut visit: impl FnMut(&[f64])) {
        visit(self.fused.numbers());
        match &self.moments {
            Moments::Exact(exact) => {
                exact.prior.iter().chain(&exact.theta).for_each(|matrix| visit(matrix.numbers()));
            }
            Moments::Array(array) => {
                visit(&array.prior.d);
                visit(&array.prior.u);
            }
            Moments::Printed(printed) => {
                printed.own.iter().flat_map(|own| own.all()).for_each(|m| visit(m.numbers()));
                printed.cross.iter().flat_map(|cross| cross.all()).for_each(|m| visit(m.numbers()));
            }
        }
    }

    /// The same arrays, to be read back.
    ///
    /// # Errors
    /// The first of `visit`.
    pub fn each_mut(&mut self, mut visit: impl FnMut(&mut [f64]) -> Result<()>) -> Result<()> {
        visit(self.fused.numbers_mut())?;
        match &mut self.moments {
            Moments::Exact(exact) => {
                (exact.prior.iter_mut().chain(&mut exact.theta)).try_for_each(|m| visit(m.numbers_mut()))
            }
            Moments::Array(array) => {
                visit(&mut array.prior.d)?;
                visit(&mut array.prior.u)
            }
            Moments::Printed(printed) => {
                let own = printed.own.iter_mut().flat_map(|own| own.all_mut());
                let cross = printed.cross.iter_mut().flat_map(|cross| cross.all_mut());
                own.chain(cross).try_for_each(|matrix| visit(matrix.numbers_mut()))
            }
        }
    }
}
