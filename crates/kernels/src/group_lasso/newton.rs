//! Newton's method on the active groups of a group LASSO.

use super::Workspace;
use crate::linalg::{cholesky, cholesky_solve, dot, norm};
use crate::penalty::Problem;

/// Newton stops when every active group's stationarity is within this share of its γ.
const STATIONARY: f64 = 1e-12;
/// Shares of the diagonal of H added to the Newton matrix, the next where the last leaves it singular.
const DAMPING: [f64; 4] = [1e-13, 1e-10, 1e-7, 1e-4];
/// A group this much smaller than the largest one counts as zero until it asks to come back.
const NEGLIGIBLE: f64 = 1e-9;
const NEWTON_STEPS: usize = 20;

/// Take groups at zero, or so close to it that Newton's matrix would explode, out of the active set.
fn leave(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace) {
    let sizes = ws.active.iter().map(|&j| norm(&g[problem.range(j)]));
    let negligible = NEGLIGIBLE * sizes.fold(0.0, f64::max);
    let mut moved = false;
    let member = &mut ws.member;
    ws.active.retain(|&j| {
        let part = &mut g[problem.range(j)];
        let size = norm(part);
        member[j] = problem.gamma[j] == 0.0 || size > negligible;
        if !member[j] {
            moved |= size > 0.0;
            part.fill(0.0);
        }
        member[j]
    });
    if moved {
        ws.refresh(problem, g);
    }
}

/// Newton's method on the active groups; those that reach zero leave. Returns steps and whether it is stationary.
pub(super) fn newton(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace) -> (usize, bool) {
    for steps in 0..NEWTON_STEPS {
        leave(problem, g, ws);
        let size = ws.size(problem);
        if ws.factor.len() < size * size {
            ws.factor.resize(size * size, 0.0);
        }
        if stationary(problem, g, ws) {
            return (steps, true);
        }
        let regular = DAMPING.iter().any(|&damping| {
            assemble(problem, g, ws, size, damping);
            cholesky(&mut ws.factor, size, size, 1e-14).is_ok()
        });
        if !regular {
            return (steps, false);
        }
        cholesky_solve(&ws.factor, size, &mut ws.step[..size]);
        if !search(problem, g, ws, size) {
            return (steps + 1, false);
        }
    }
    (NEWTON_STEPS, false)
}

/// Whether ν_j = γ_j g_j / ‖g_j‖ on every active group, to rounding.
fn stationary(problem: &Problem<'_>, g: &[f64], ws: &Workspace) -> bool {
    ws.active.iter().all(|&j| {
        let range = problem.range(j);
        let gamma = problem.gamma[j];
        let scale = if gamma > 0.0 { gamma / norm(&g[range.clone()]) } else { 0.0 };
        let square: f64 = range.clone().map(|i| (ws.nu[i] - scale * g[i]).powi(2)).sum();
        let reference = if gamma > 0.0 { gamma } else { norm(&problem.linear[range]).max(1.0) };
        square.sqrt() <= STATIONARY * reference
    })
}

/// Newton matrix into `factor` (lower triangle), right-hand side into `step` and `image`.
fn assemble(problem: &Problem<'_>, g: &[f64], ws: &mut Workspace, size: usize, damping: f64) {
    let mut at = 0;
    for &a in &ws.active {
        let own = problem.range(a);
        let gamma = problem.gamma[a];
        let length = norm(&g[own.clone()]);
        let scale = if gamma > 0.0 { gamma / length } else { 0.0 };
        for i in own.clone() {
            let source = problem.row(i);
            let row = &mut ws.factor[at * size..(at + 1) * size];
            let mut column = 0;
            for &c in &ws.active {
                let range = problem.range(c);
                row[column..column + range.len()].copy_from_slice(&source[range.clone()]);
                if c == a {
                    for k in range.clone() {
                        row[column + k - range.start] -= scale * g[i] / length * (g[k] / length);
                    }
                }
                column += range.len();
            }
            row[at] += scale + damping * source[i];
            ws.step[at] = ws.nu[i] - scale * g[i];
            ws.image[at] = ws.step[at];
            at += 1;
        }
    }
}

/// Step along `step` with backtracking on the cost; `image` holds the negative gradient on entry.
///
/// A step that would carry a group past zero is first tried as far as there, with that group at zero exactly: on
/// a singular active set the minimum lies where a group vanishes.
fn search(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace, size: usize) -> bool {
    let slope = dot(&ws.image[..size], &ws.step[..size]);
    let (nearest, leaving) = nearest_zero(problem, g, ws);
    if nearest < 1.0 && vanish(problem, g, ws, size, nearest, leaving) {
        return true;
    }
    let descent = product_with_step(problem, ws);
    let curvature = dot(&ws.image[..size], &ws.step[..size]);
    let mut t = 1.0;
    for _ in 0..40 {
        let change = 0.5 * t * t * curvature - t * descent + penalty_change(problem, g, ws, t);
        if change <= -1e-4 * t * slope + 1e-15 * descent.abs() {
            advance(problem, g, ws, t);
            return true;
        }
        t *= 0.5;
    }
    false
}

/// Take the step up to where group `leaving` is nearest to zero and put it at zero, if that lowers the cost.
/// Otherwise the step is left as it was.
fn vanish(
    problem: &Problem<'_>,
    g: &mut [f64],
    ws: &mut Workspace,
    size: usize,
    nearest: f64,
    leaving: usize,
) -> bool {
    ws.packed[..size].copy_from_slice(&ws.step[..size]);
    for (i, at) in positions(problem, &ws.active) {
        ws.step[at] = if problem.range(leaving).contains(&i) { -g[i] } else { nearest * ws.step[at] };
    }
    let descent = product_with_step(problem, ws);
    let curvature = dot(&ws.image[..size], &ws.step[..size]);
    if 0.5 * curvature - descent + penalty_change(problem, g, ws, 1.0) < 0.0 {
        advance(problem, g, ws, 1.0);
        return true;
    }
    ws.step[..size].copy_from_slice(&ws.packed[..size]);
    false
}

/// image = H step on the active groups; returns νᵀ step.
fn product_with_step(problem: &Problem<'_>, ws: &mut Workspace) -> f64 {
    for (i, at) in positions(problem, &ws.active) {
        let mut product = 0.0;
        let mut column = 0;
        for &c in &ws.active {
            let range = problem.range(c);
            product += dot(&problem.row(i)[range.clone()], &ws.step[column..column + range.len()]);
            column += range.len();
        }
        ws.image[at] = product;
    }
    positions(problem, &ws.active).map(|(i, at)| ws.nu[i] * ws.step[at]).sum()
}

/// g += t step, ν −= t image.
fn advance(problem: &Problem<'_>, g: &mut [f64], ws: &mut Workspace, t: f64) {
    for (i, at) in positions(problem, &ws.active) {
        g[i] += t * ws.step[at];
        ws.nu[i] -= t * ws.image[at];
    }
}

/// The first step length at which a penalised group is as close to zero as the step brings it, and the group.
fn nearest_zero(problem: &Problem<'_>, g: &[f64], ws: &Workspace) -> (f64, usize) {
    let (mut nearest, mut leaving, mut at) = (f64::INFINITY, 0, 0);
    for &j in &ws.active {
        let range = problem.range(j);
        let step = &ws.step[at..at + range.len()];
        at += range.len();
        let toward = -dot(&g[range], step);
        if problem.gamma[j] > 0.0 && toward > 0.0 && toward < nearest * dot(step, step) {
            nearest = toward / dot(step, step);
            leaving = j;
        }
    }
    (nearest, leaving)
}

/// Σ γ_j (‖g_j + t p_j‖ − ‖g_j‖)
fn penalty_change(problem: &Problem<'_>, g: &[f64], ws: &Workspace, t: f64) -> f64 {
    let mut total = 0.0;
    let mut at = 0;
    for &j in &ws.active {
        let range = problem.range(j);
        let (mut before, mut growth) = (0.0, 0.0);
        for (i, &p) in range.clone().zip(&ws.step[at..at + range.len()]) {
            before += g[i] * g[i];
            growth += t * p * (2.0 * g[i] + t * p);
        }
        let (old, new) = (before.sqrt(), (before + growth).max(0.0).sqrt());
        if old + new > 0.0 {
            total += problem.gamma[j] * growth / (old + new);
        }
        at += range.len();
    }
    total
}

/// (element, position in the packed vectors) for every active element.
fn positions<'a>(problem: &'a Problem<'_>, active: &'a [usize]) -> impl Iterator<Item = (usize, usize)> + 'a {
    active.iter().flat_map(|&j| problem.range(j)).enumerate().map(|(at, i)| (i, at))
}
