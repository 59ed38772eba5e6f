//! Group LASSO by an active set: block coordinate descent to find the groups, Newton to finish on them.
//!
//! Coordinates are chosen at design time so that every diagonal block of H is diag(λ): one block update is a
//! scalar secular equation (closed form when all λ are equal, as in the robust form of sparse fusion).

mod newton;

use std::ops::Range;

use self::newton::newton;

use crate::linalg::{axpy, dot, norm};
use crate::penalty::{Outcome, Problem};

/// The active set stops growing once the relative gap is below this.
const TARGET: f64 = 1e-14;
/// Violations of ‖ν_j‖ ≤ γ_j below this share of γ_j are rounding.
const TOLERANCE: f64 = 1e-12;
/// Sweeps over all groups each time the active set has to grow.
const OPENING_SWEEPS: usize = 2;
/// Work after which the solver gives up.
const CAP: usize = 5000;
const SWEEPS: usize = 200;

/// Scratch space for problems of d elements.
#[derive(Debug, Clone)]
pub struct Workspace {
    /// ν = ν₀ − H g; on active groups only while they are being solved for.
    nu: Vec<f64>,
    /// Newton step, H times it and a copy of it, in the order of `active`.
    step: Vec<f64>,
    image: Vec<f64>,
    packed: Vec<f64>,
    active: Vec<usize>,
    member: Vec<bool>,
    factor: Vec<f64>,
}

/// Elements for whose square a workspace reserves room at once.
const RESERVED: usize = 400;

impl Workspace {
    /// Room for d elements in `groups` groups.
    ///
    /// The Newton matrix has room for 400 active elements; a filter that ever needs more grows it once.
    #[must_use]
    pub fn new(d: usize, groups: usize) -> Self {
        let reserved = d.min(RESERVED);
        Self {
            nu: vec![0.0; d],
            step: vec![0.0; d],
            image: vec![0.0; d],
            packed: vec![0.0; d],
            active: Vec::with_capacity(groups),
            member: vec![false; groups],
            factor: vec![0.0; reserved * reserved],
        }
    }

    fn begin(&mut self, problem: &Problem<'_>, g: &[f64]) {
        self.active.clear();
        for j in 0..problem.groups() {
            self.member[j] = problem.gamma[j] == 0.0 || g[problem.range(j)].iter().any(|&v| v != 0.0);
            if self.member[j] {
                self.active.push(j);
            }
        }
    }

    /// Number of active elements.
    fn size(&self, problem: &Problem<'_>) -> usize {
        self.active.iter().map(|&j| problem.range(j).len()).sum()
    }

    /// ν on the active groups.
    fn refresh(&mut self, problem: &Problem<'_>, g: &[f64]) {
        for &a in &self.active {
            for i in problem.range(a) {
                let row = problem.row(i);
                let product: f64 =
                    self.active.iter().map(|&c| dot(&row[problem.range(c)], &g[problem.range(c)])).sum();
                self.nu[i] = problem.linear[i] - product;
            }
        }
    }
}

/// Solve the problem, `g` in and out; a warm start is the support and values of `g`.
pub fn solve(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace) -> Outcome {
    ws.begin(problem, g);
    let mut iterations = 0;
    loop {
        iterations += minimise_on_active(problem, g, ws);
        problem.residual(g, &mut ws.nu);
        let gap = problem.relative_gap(g, &ws.nu);
        if gap <= TARGET || iterations > CAP || !somebody_enters(problem, ws) {
            return Outcome { iterations, gap };
        }
        for _ in 0..OPENING_SWEEPS {
            sweep_all(problem, g, ws);
        }
        iterations += OPENING_SWEEPS;
        ws.begin(problem, g);
    }
}

/// Whether an inactive group violates ‖ν_j‖ ≤ γ_j.
fn somebody_enters(problem: &Problem<'_>, ws: &Workspace) -> bool {
    (0..problem.groups())
        .any(|j| !ws.member[j] && norm(&ws.nu[problem.range(j)]) > (1.0 + TOLERANCE) * problem.gamma[j])
}

/// One sweep of exact block updates over all groups, active or not: opens every group that asks for it at once.
fn sweep_all(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace) {
    for j in 0..problem.groups() {
        let range = problem.range(j);
        if update_block(problem, g, ws, j) > 0.0 {
            for (&delta, i) in ws.step[..range.len()].iter().zip(range) {
                axpy(-delta, problem.row(i), &mut ws.nu);
            }
        }
    }
}

/// Move group j to its minimum with the others held; the change is left in `step`. Returns its relative size.
fn update_block(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace, j: usize) -> f64 {
    let range = problem.range(j);
    let change = &mut ws.step[..range.len()];
    for (c, i) in change.iter_mut().zip(range.clone()) {
        *c = ws.nu[i] + problem.row(i)[i] * g[i];
    }
    block_minimum(problem, range.clone(), problem.gamma[j], change);
    let size = norm(change);
    for (c, i) in change.iter_mut().zip(range) {
        let new = *c;
        *c -= g[i];
        g[i] = new;
    }
    let moved = norm(change);
    if moved > 0.0 { moved / (size + moved) } else { 0.0 }
}

/// Minimise over the active groups; those that reach zero leave. Returns the work done.
fn minimise_on_active(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace) -> usize {
    ws.refresh(problem, g);
    for sweep in 1..=SWEEPS {
        let moved = descend(problem, g, ws);
        let (steps, done) = newton(problem, g, ws);
        if done || moved == 0.0 {
            return sweep + steps;
        }
    }
    SWEEPS
}

/// One sweep of exact block updates over the active groups. Returns the largest relative change.
fn descend(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace) -> f64 {
    let mut largest = 0.0_f64;
    for position in 0..ws.active.len() {
        let j = ws.active[position];
        let range = problem.range(j);
        let moved = update_block(problem, g, ws, j);
        largest = largest.max(moved);
        if moved > 0.0 {
            for (&delta, i) in ws.step[..range.len()].iter().zip(range) {
                let row = problem.row(i);
                for &a in &ws.active {
                    for k in problem.range(a) {
                        ws.nu[k] -= delta * row[k];
                    }
                }
            }
        }
    }
    largest
}

/// argmin ½ gᵀ diag(λ) g − cᵀg + γ‖g‖, c in and the minimiser out.
///
/// With t = ‖g‖ it is c∘t / (λ t + γ), where ‖c / (λ t + γ)‖ = 1: Newton on 1/‖·‖ − 1, which is concave and
/// increasing, from a lower bound.
fn block_minimum(problem: &Problem<'_>, range: Range<usize>, gamma: f64, c: &mut [f64]) {
    let lambda = |k: usize| problem.row(range.start + k)[range.start + k];
    if gamma == 0.0 {
        for (k, value) in c.iter_mut().enumerate() {
            *value = if lambda(k) > 0.0 { *value / lambda(k) } else { 0.0 };
        }
        return;
    }
    let size = norm(c);
    if size <= gamma {
        c.fill(0.0);
        return;
    }
    let top = (0..c.len()).map(lambda).fold(0.0, f64::max);
    let mut t = (size - gamma) / top;
    for _ in 0..60 {
        let (mut square, mut slope) = (0.0, 0.0);
        for (k, value) in c.iter().enumerate() {
            let denominator = lambda(k) * t + gamma;
            let w = value / denominator;
            square += w * w;
            slope += lambda(k) * w * w / denominator;
        }
        let h = square.sqrt();
        let step = (h - 1.0) * square / slope;
        t += step;
        if step.abs() <= 1e-15 * t {
            break;
        }
    }
    for (k, value) in c.iter_mut().enumerate() {
        *value *= t / (lambda(k) * t + gamma);
    }
}
