//! How the covariance of the Kalman filter moves on: the part of a step that does not see data.

use crate::kalman::gains::{Gains, Scratch};
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::linalg::dot;
use std::ops::Range;

/// The covariance recursion of one plant.
#[derive(Debug, Clone)]
pub struct Recursion {
    /// The plant.
    pub model: Model,
    /// Rows of the time update, with G in its place: [A U, G].
    template: Vec<f64>,
    /// What [`Gains::listen`] says when every channel arrives; None if A or C varies.
    full: Option<Gains>,
}

/// The part of the state that does not see data.
#[derive(Debug, Clone)]
pub struct Covariance {
    /// P[k|k−1].
    pub prior: Ud,
    /// With every channel present the prior repeats itself.
    pub settled: bool,
    /// `gains` belong to `prior` with every channel present, covariance included.
    pub cached: bool,
    /// Gains of the latest sample.
    pub gains: Gains,
    work: Ud,
    rows: Vec<f64>,
    weights: Vec<f64>,
    weighted: Vec<f64>,
    before: Vec<f64>,
    after: Vec<f64>,
    scratch: Scratch,
}

impl Recursion {
    /// The recursion of `model`.
    #[must_use]
    pub fn new(model: Model) -> Self {
        let (n, m, r) = (model.dims.states, model.dims.channels, model.q.len());
        let mut template = vec![0.0; n * (n + r)];
        for (row, g) in template.chunks_exact_mut(n + r).zip(model.g.chunks(r.max(1))) {
            row[n..].copy_from_slice(g);
        }
        let full = model.horizon.is_none().then(|| {
            let mut gains = Gains::new(&model);
            gains.listen(&model, 0, &vec![0.0; m]);
            gains
        });
        Self { model, template, full }
    }

    /// Before the first sample.
    #[must_use]
    pub fn start(&self, prior: Ud) -> Covariance {
        let dims = self.model.dims;
        let n = dims.states;
        let mut weights = vec![0.0; n];
        weights.extend_from_slice(&self.model.q);
        Covariance {
            work: prior.clone(),
            prior,
            settled: false,
            cached: false,
            gains: Gains::new(&self.model),
            rows: self.template.clone(),
            weighted: weights.clone(),
            weights,
            before: vec![0.0; n],
            after: vec![0.0; n],
            scratch: Scratch::new(dims),
        }
    }

    /// The covariance part of one step: gains for sample k, then P[k+1|k].
    pub fn advance(&self, p: &mut Covariance, k: usize, y: &[f64], keep: bool) {
        self.correct(p, k, y, keep);
        self.predict(p, k);
    }

    /// Gains for sample k if the channels of y that are not NaN count. P[k|k−1] stays, so that it can be corrected
    /// again with other channels until [`Recursion::predict`].
    pub fn correct(&self, p: &mut Covariance, k: usize, y: &[f64], keep: bool) {
        let all = y.iter().all(|value| !value.is_nan());
        let repeats = all && p.settled;
        if repeats && p.cached {
            return;
        }
        self.listen(p, k, y);
        p.cached = repeats;
        p.work.copy_from(&p.prior);
        p.gains.correct_covariance(&self.model, k, &mut p.work, &mut p.scratch, keep || repeats);
    }

    /// What [`Recursion::correct`] begins with: the gains hear the channels of y that are not NaN, if they do not yet.
    pub fn listen(&self, p: &mut Covariance, k: usize, y: &[f64]) {
        let all = y.iter().all(|value| !value.is_nan());
        if all && p.settled && p.cached {
            return;
        }
        p.cached = false;
        match &self.full {
            Some(full) if all => p.gains.listen_to_all(full),
            _ => p.gains.listen(&self.model, k, y),
        }
    }

    /// From the latest correction of sample k to P[k+1|k].
    pub fn predict(&self, p: &mut Covariance, k: usize) {
        if p.cached {
            return;
        }
        let all = p.gains.channels().len() == self.model.dims.channels;
        self.time_update(p, k);
        p.settled = self.full.is_some() && all && p.repeats();
        std::mem::swap(&mut p.prior, &mut p.work);
    }

    /// From P[k|k] to P[k+1|k] in `work`: the rows [A U, G] with weights [D, q], made orthogonal.
    fn time_update(&self, p: &mut Covariance, k: usize) {
        let (n, width) = (self.model.dims.states, p.weights.len());
        p.weights[..n].copy_from_slice(&p.work.d);
        let a = self.model.a(k).chunks_exact(n);
        let rows = p.rows.chunks_exact_mut(width).zip(self.template.chunks_exact(width));
        for ((row, template), a) in rows.zip(a) {
            row[n..].copy_from_slice(&template[n..]);
            for (l, target) in row[..n].iter_mut().enumerate() {
                *target = a[l] + dot(p.work.column(l), &a[..l]);
            }
        }
        p.work.orthogonalise(&mut p.rows, &p.weights, &mut p.weighted);
    }
}

impl Covariance {
    /// First of three parts of [`Recursion::correct`], once the gains have listened: P[k|k−1] may be conditioned.
    pub fn expect(&mut self, model: &Model, k: usize) {
        self.cached = false;
        self.work.copy_from(&self.prior);
        self.gains.expect(model, k, &self.work, &mut self.scratch);
    }

    /// Second part, any number of times: take in some of the channels heard.
    pub fn condition(&mut self, some: Range<usize>) {
        self.gains.condition(some, &mut self.work, &mut self.scratch);
    }

    /// Last part: P[k|k] is complete.
    pub fn conclude(&mut self, keep: bool) {
        self.gains.conclude(&self.work, keep);
    }

    /// As [`Recursion::correct`], once the gains have listened, with the information of every channel (m,) multiplied by
    /// the square of its weight; one weight for channels whose noise is correlated.
    pub fn correct_weighted(&mut self, model: &Model, k: usize, weights: &[f64], keep: bool) {
        self.gains.weigh(weights);
        self.expect(model, k);
        self.condition(0..self.gains.channels().len());
        self.conclude(keep);
    }

    /// Whether the new prior in `work` differs from the old one by no more than one step's rounding: going on
    /// would not bring it closer to the limit than the recursion's own rounding allows.
    fn repeats(&mut self) -> bool {
        self.prior.variances(&mut self.before);
        self.work.variances(&mut self.after);
        let tolerance = (self.before.len() + 8) as f64 * f64::EPSILON;
        self.prior.is_close(&self.work, &self.before, &self.after, tolerance)
    }

    /// P[k|k], or as far as it has been conditioned, until [`Recursion::predict`], unless the gains were cached.
    #[must_use]
    pub fn posterior(&self) -> &Ud {
        &self.work
    }

    /// Equal to the bit in everything that decides how it goes on.
    #[must_use]
    pub fn same(&self, other: &Self) -> bool {
        let equal = |a: &[f64], b: &[f64]| a.iter().map(|v| v.to_bits()).eq(b.iter().map(|v| v.to_bits()));
        self.settled == other.settled
            && equal(&self.prior.d, &other.prior.d)
            && (0..self.prior.d.len()).all(|j| equal(self.prior.column(j), other.prior.column(j)))
    }
}
