//! Results of many steps, one array per quantity.

use crate::lanes::LANES;
use crate::{Dims, Output};

/// Results of `runs × steps` samples, row-major, run first.
///
/// What the data do not change is kept once for many runs for as long as they share their plans.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// Sizes of the estimator.
    pub dims: Dims,
    /// Number of runs.
    pub runs: usize,
    /// Samples per run.
    pub steps: usize,
    /// 1 while the runs share what the data do not change, otherwise `runs`.
    pub copies: usize,
    /// (runs, steps, n)
    pub x: Vec<f64>,
    /// (copies, steps, n)
    pub x_std: Vec<f64>,
    /// (copies, steps, n, n) or empty
    pub covariance: Vec<f64>,
    /// (copies, steps, N)
    pub trust: Vec<f64>,
    /// (copies, steps, m)
    pub attack: Vec<f64>,
    /// (copies, steps, m)
    pub attack_std: Vec<f64>,
    /// (copies, steps, N)
    pub suspected: Vec<u8>,
    /// (runs, steps, m)
    pub innovation: Vec<f64>,
    /// (copies, steps, m)
    pub innovation_std: Vec<f64>,
    /// (runs, steps, names)
    pub diagnostics: Vec<f64>,
    /// (copies, steps)
    pub status: Vec<u8>,
}

impl Record {
    /// Room for the results.
    #[must_use]
    pub fn new(dims: Dims, diagnostics: usize, runs: usize, steps: usize, covariance: bool) -> Self {
        let (samples, copies) = (runs * steps, if runs > LANES { 1 } else { runs });
        let shared = copies * steps;
        let (n, m, sensors) = (dims.states, dims.channels, dims.sensors);
        Self {
            dims,
            runs,
            steps,
            copies,
            x: vec![0.0; samples * n],
            x_std: vec![0.0; shared * n],
            covariance: vec![0.0; if covariance { shared * n * n } else { 0 }],
            trust: vec![0.0; shared * sensors],
            attack: vec![0.0; shared * m],
            attack_std: vec![0.0; shared * m],
            suspected: vec![0; shared * sensors],
            innovation: vec![0.0; samples * m],
            innovation_std: vec![0.0; shared * m],
            diagnostics: vec![0.0; samples * diagnostics],
            status: vec![0; shared],
        }
    }

    /// Give every run its own copy of what was shared so far.
    pub fn unshare(&mut self) {
        if self.copies == self.runs {
            return;
        }
        for numbers in [
            &mut self.x_std,
            &mut self.covariance,
            &mut self.trust,
            &mut self.attack,
            &mut self.attack_std,
            &mut self.innovation_std,
        ] {
            *numbers = numbers.repeat(self.runs);
        }
        self.suspected = self.suspected.repeat(self.runs);
        self.status = self.status.repeat(self.runs);
        self.copies = self.runs;
    }

    /// One mutable view per run.
    pub fn split(&mut self) -> Vec<RunRecord<'_>> {
        self.split_between(0, self.steps)
    }

    /// One mutable view of samples `from..to` per run; what the runs share is in the first.
    pub fn split_between(&mut self, from: usize, to: usize) -> Vec<RunRecord<'_>> {
        let runs = self.runs;
        let own = Between { runs, steps: self.steps, from, to };
        let shared = Between { runs: self.copies, ..own };
        let mut x = own.shares(&mut self.x);
        let mut x_std = shared.shares(&mut self.x_std);
        let mut covariance = shared.shares(&mut self.covariance);
        let mut trust = shared.shares(&mut self.trust);
        let mut attack = shared.shares(&mut self.attack);
        let mut attack_std = shared.shares(&mut self.attack_std);
        let mut suspected = shared.shares(&mut self.suspected);
        let mut innovation = own.shares(&mut self.innovation);
        let mut innovation_std = shared.shares(&mut self.innovation_std);
        let mut diagnostics = own.shares(&mut self.diagnostics);
        let mut status = shared.shares(&mut self.status);
        (0..runs)
            .map(|_| RunRecord {
                steps: to - from,
                x: x(),
                x_std: x_std(),
                covariance: covariance(),
                trust: trust(),
                attack: attack(),
                attack_std: attack_std(),
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
    pub(crate) x: &'a mut [f64],
    x_std: &'a mut [f64],
    covariance: &'a mut [f64],
    trust: &'a mut [f64],
    attack: &'a mut [f64],
    attack_std: &'a mut [f64],
    suspected: &'a mut [u8],
    pub(crate) innovation: &'a mut [f64],
    innovation_std: &'a mut [f64],
    pub(crate) diagnostics: &'a mut [f64],
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
            attack_std: row(self.attack_std, k, steps),
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

/// Samples `from..to` of every run.
#[derive(Clone, Copy)]
struct Between {
    runs: usize,
    steps: usize,
    from: usize,
    to: usize,
}

impl Between {
    /// Successive calls hand out the samples of successive runs, then nothing.
    fn shares<'a, T>(self, data: &'a mut [T]) -> impl FnMut() -> &'a mut [T] + use<'a, T> {
        let width = data.len().checked_div(self.runs * self.steps).unwrap_or(0);
        let mut rest = data;
        move || {
            if rest.is_empty() {
                return &mut [];
            }
            let (head, tail) = std::mem::take(&mut rest).split_at_mut(width * self.steps);
            rest = tail;
            &mut head[width * self.from..width * self.to]
        }
    }
}
