//! Results of many steps, one array per quantity.

use crate::{Dims, Output};

/// Results of `runs × steps` samples, row-major, run first.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Sizes of the estimator.
    pub dims: Dims,
    /// Number of runs.
    pub runs: usize,
    /// Samples per run.
    pub steps: usize,
    /// (runs, steps, n)
    pub x: Vec<f64>,
    /// (runs, steps, n)
    pub x_std: Vec<f64>,
    /// (runs, steps, n, n) or empty
    pub covariance: Vec<f64>,
    /// (runs, steps, N)
    pub trust: Vec<f64>,
    /// (runs, steps, m)
    pub attack: Vec<f64>,
    /// (runs, steps, N)
    pub suspected: Vec<u8>,
    /// (runs, steps, m)
    pub innovation: Vec<f64>,
    /// (runs, steps, m)
    pub innovation_std: Vec<f64>,
    /// (runs, steps, names)
    pub diagnostics: Vec<f64>,
    /// (runs, steps)
    pub status: Vec<u8>,
}

impl Record {
    /// Room for the results.
    #[must_use]
    pub fn new(dims: Dims, diagnostics: usize, runs: usize, steps: usize, covariance: bool) -> Self {
        let samples = runs * steps;
        let (n, m, sensors) = (dims.states, dims.channels, dims.sensors);
        Self {
            dims,
            runs,
            steps,
            x: vec![0.0; samples * n],
            x_std: vec![0.0; samples * n],
            covariance: vec![0.0; if covariance { samples * n * n } else { 0 }],
            trust: vec![0.0; samples * sensors],
            attack: vec![0.0; samples * m],
            suspected: vec![0; samples * sensors],
            innovation: vec![0.0; samples * m],
            innovation_std: vec![0.0; samples * m],
            diagnostics: vec![0.0; samples * diagnostics],
            status: vec![0; samples],
        }
    }

    /// One mutable view per run.
    pub fn split(&mut self) -> Vec<RunRecord<'_>> {
        let runs = self.runs;
        let mut x = shares(&mut self.x, runs);
        let mut x_std = shares(&mut self.x_std, runs);
        let mut covariance = shares(&mut self.covariance, runs);
        let mut trust = shares(&mut self.trust, runs);
        let mut attack = shares(&mut self.attack, runs);
        let mut suspected = shares(&mut self.suspected, runs);
        let mut innovation = shares(&mut self.innovation, runs);
        let mut innovation_std = shares(&mut self.innovation_std, runs);
        let mut diagnostics = shares(&mut self.diagnostics, runs);
        let mut status = shares(&mut self.status, runs);
        (0..runs)
            .map(|_| RunRecord {
                steps: self.steps,
                x: x(),
                x_std: x_std(),
                covariance: covariance(),
                trust: trust(),
                attack: attack(),
                suspected: suspected(),
                innovation: innovation(),
                innovation_std: innovation_std(),
                diagnostics: diagnostics(),
                status: status(),
            })
            .collect()
    }
}

/// The results of one run.
#[derive(Debug)]
pub struct RunRecord<'a> {
    steps: usize,
    x: &'a mut [f64],
    x_std: &'a mut [f64],
    covariance: &'a mut [f64],
    trust: &'a mut [f64],
    attack: &'a mut [f64],
    suspected: &'a mut [u8],
    innovation: &'a mut [f64],
    innovation_std: &'a mut [f64],
    diagnostics: &'a mut [f64],
    status: &'a mut [u8],
}

impl RunRecord<'_> {
    /// Where sample `k` goes.
    pub fn at(&mut self, k: usize) -> Output<'_> {
        let steps = self.steps;
        Output {
            x: row(self.x, k, steps),
            x_std: row(self.x_std, k, steps),
            covariance: if self.covariance.is_empty() { None } else { Some(row(self.covariance, k, steps)) },
            trust: row(self.trust, k, steps),
            attack: row(self.attack, k, steps),
            suspected: row(self.suspected, k, steps),
            innovation: row(self.innovation, k, steps),
            innovation_std: row(self.innovation_std, k, steps),
            diagnostics: row(self.diagnostics, k, steps),
            status: &mut self.status[k],
        }
    }
}

fn row<T>(data: &mut [T], k: usize, steps: usize) -> &mut [T] {
    let width = data.len() / steps;
    &mut data[k * width..(k + 1) * width]
}

/// Successive calls hand out successive equal shares of `data`.
fn shares<'a, T>(data: &'a mut [T], runs: usize) -> impl FnMut() -> &'a mut [T] {
    let width = data.len().checked_div(runs).unwrap_or(0);
    let mut rest = data;
    move || {
        let (head, tail) = std::mem::take(&mut rest).split_at_mut(width);
        rest = tail;
        head
    }
}
