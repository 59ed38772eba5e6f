//! LASSO by an exact active set (feature-sign search) with null-direction steps.
//!
//! Finite: every inner step either reaches the minimum over the current signs or drops an element. H restricted
//! to the support can be singular (two channels that say the same); then the step follows the null direction
//! until an element reaches zero. Warm start: the support and values of `g`.
//!
//! References: Lee, Battle, Raina, Ng 2007 (feature-sign search); the null-direction step is ours.

use crate::linalg::{axpy, backward_solve, dot, forward_solve};
use crate::penalty::{Outcome, Problem, SOLVED};

/// A pivot below this share of its diagonal entry makes the support singular.
const SINGULAR: f64 = 1e-11;
/// Violations of |ν_j| ≤ γ_j below this share of γ_j are rounding.
const TOLERANCE: f64 = 1e-12;
/// Inner steps per element before giving up.
const CAP: usize = 50;

/// Scratch space for problems of d elements.
#[derive(Debug, Clone)]
pub struct Workspace {
    nu: Vec<f64>,
    sign: Vec<f64>,
    support: Vec<usize>,
    member: Vec<bool>,
    step: Vec<f64>,
    factor: Vec<f64>,
}

impl Workspace {
    /// Room for d elements.
    #[must_use]
    pub fn new(d: usize) -> Self {
        Self {
            nu: vec![0.0; d],
            sign: vec![0.0; d],
            support: Vec::with_capacity(d),
            member: vec![false; d],
            step: vec![0.0; d],
            factor: vec![0.0; d * d],
        }
    }

    fn begin(&mut self, problem: &Problem<'_>, g: &[f64]) {
        self.support.clear();
        for (j, &value) in g.iter().enumerate() {
            let free = problem.gamma[j] == 0.0;
            self.member[j] = free || value != 0.0;
            self.sign[j] = if free || value == 0.0 { 0.0 } else { value.signum() };
            if self.member[j] {
                self.support.push(j);
            }
        }
    }

    fn add(&mut self, j: usize, sign: f64) {
        self.sign[j] = sign;
        self.member[j] = true;
        self.support.push(j);
    }

    fn remove(&mut self, position: usize) {
        let j = self.support.remove(position);
        self.sign[j] = 0.0;
        self.member[j] = false;
    }

    /// Cholesky rows `from..` of H on the support; the first singular row, if there is one.
    fn factorise(&mut self, problem: &Problem<'_>, from: usize) -> Option<usize> {
        let d = problem.len();
        for i in from..self.support.len() {
            let source = problem.row(self.support[i]);
            let (done, rest) = self.factor.split_at_mut(i * d);
            let row = &mut rest[..=i];
            for (target, &j) in row.iter_mut().zip(&self.support) {
                *target = source[j];
            }
            let diagonal = row[i];
            for j in 0..i {
                let above = &done[j * d..=j * d + j];
                row[j] = (row[j] - dot(&row[..j], &above[..j])) / above[j];
            }
            let pivot = diagonal - dot(&row[..i], &row[..i]);
            if pivot.is_nan() || pivot <= SINGULAR * diagonal {
                return Some(i);
            }
            row[i] = pivot.sqrt();
        }
        None
    }
}

/// Solve the problem, `g` in and out. Every group has one element.
pub fn solve(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace) -> Outcome {
    ws.begin(problem, g);
    let cap = CAP * (problem.len() + 10);
    let mut iterations = 0;
    loop {
        let settled = minimise_on_support(problem, g, ws, &mut iterations, cap);
        problem.residual(g, &mut ws.nu);
        let entering = if settled { most_violated(problem, ws) } else { None };
        match entering {
            Some((j, sign)) => ws.add(j, sign),
            None => {
                return Outcome { iterations, gap: problem.relative_gap(g, &ws.nu) };
            }
        }
        if iterations >= cap {
            let gap = problem.relative_gap(g, &ws.nu).max(2.0 * SOLVED);
            return Outcome { iterations, gap };
        }
    }
}

/// The element outside the support that violates |ν_j| ≤ γ_j most, per unit of √H_jj, and its sign.
fn most_violated(problem: &Problem<'_>, ws: &Workspace) -> Option<(usize, f64)> {
    let mut best = None;
    let mut best_score = 0.0;
    for (j, &nu) in ws.nu.iter().enumerate() {
        let diagonal = problem.row(j)[j];
        let excess = nu.abs() - problem.gamma[j];
        if ws.member[j] || diagonal <= 0.0 || excess <= TOLERANCE * problem.gamma[j] {
            continue;
        }
        let score = excess / diagonal.sqrt();
        if score > best_score {
            best_score = score;
            best = Some((j, nu.signum()));
        }
    }
    best
}

/// Minimise over the support with the signs held; elements that reach zero leave. False at the cap.
fn minimise_on_support(
    problem: &Problem<'_>,
    g: &mut [f64],
    ws: &mut Workspace,
    iterations: &mut usize,
    cap: usize,
) -> bool {
    let mut from = 0;
    while !ws.support.is_empty() {
        *iterations += 1;
        if *iterations > cap {
            return false;
        }
        let singular = ws.factorise(problem, from);
        let whole = match singular {
            None => newton_direction(problem, g, ws),
            Some(row) => null_direction(problem, g, ws, row),
        };
        let (length, blocking) = longest_step(g, ws, whole);
        if blocking.is_none() && singular.is_some() {
            return false; // flat and unbounded to rounding: leave it to the gap
        }
        for (&j, &p) in ws.support.iter().zip(&ws.step) {
            g[j] += length * p;
        }
        match blocking {
            None => return true,
            Some(position) => {
                g[ws.support[position]] = 0.0;
                ws.remove(position);
                from = position;
            }
        }
    }
    true
}

/// Step to the minimum over the support: H_SS⁻¹ (ν₀ − γ∘sign) − g. Its full length is 1.
fn newton_direction(problem: &Problem<'_>, g: &[f64], ws: &mut Workspace) -> f64 {
    let k = ws.support.len();
    for (target, &j) in ws.step.iter_mut().zip(&ws.support) {
        *target = problem.linear[j] - problem.gamma[j] * ws.sign[j];
    }
    forward_solve(&ws.factor, problem.len(), &mut ws.step[..k]);
    backward_solve(&ws.factor, problem.len(), &mut ws.step[..k]);
    for (target, &j) in ws.step.iter_mut().zip(&ws.support) {
        *target -= g[j];
    }
    1.0
}

/// Downhill null direction of H on the support, found at the singular row. Its length is unbounded.
fn null_direction(problem: &Problem<'_>, g: &[f64], ws: &mut Workspace, row: usize) -> f64 {
    let (d, k) = (problem.len(), ws.support.len());
    ws.step[..k].fill(0.0);
    ws.step[row] = 1.0;
    let (head, _) = ws.step.split_at_mut(row);
    axpy(-1.0, &ws.factor[row * d..row * d + row], head);
    backward_solve(&ws.factor, d, head);
    let mut slope = 0.0;
    for (&i, &p) in ws.support.iter().zip(&ws.step) {
        let gradient: f64 = ws.support.iter().map(|&j| problem.row(i)[j] * g[j]).sum();
        slope += p * (problem.linear[i] - problem.gamma[i] * ws.sign[i] - gradient);
    }
    if slope < 0.0 {
        ws.step[..k].iter_mut().for_each(|p| *p = -*p);
    }
    f64::INFINITY
}

/// How far the step goes before a penalised element changes sign, and which one that is.
fn longest_step(g: &[f64], ws: &Workspace, whole: f64) -> (f64, Option<usize>) {
    let (mut length, mut blocking) = (whole, None);
    for (position, (&j, &p)) in ws.support.iter().zip(&ws.step).enumerate() {
        if ws.sign[j] * p < 0.0 {
            let reach = -g[j] / p;
            if reach < length {
                length = reach;
                blocking = Some(position);
            }
        }
    }
    (length, blocking)
}
