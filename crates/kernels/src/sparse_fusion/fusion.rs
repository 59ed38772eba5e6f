//! Problem (31) for one sample: fast path, solve, refit.

use std::ops::Range;

use super::{Scratch, Solver, SparseFusion, State};
use crate::linalg::dot;
use crate::penalty::{Outcome, Problem};
use crate::{group_lasso, lasso};

/// The refit frees this many suspects one by one, solving in between; should there be more, the rest at once.
const ONE_BY_ONE: usize = 8;

/// How the fusion of one sample went.
pub(super) struct Fusion {
    pub(super) outcome: Outcome,
    pub(super) fast: bool,
    pub(super) determined: bool,
}

impl SparseFusion {
    /// Problem (31) in the coordinates g: fast path, solve, refit. `state.g` out.
    pub(super) fn fuse(&self, state: &mut State) -> Fusion {
        let m = &self.m;
        let scratch = &mut state.scratch;
        self.projection.apply(&state.zeta, &mut scratch.nu, &mut scratch.projection);
        scratch.gamma.copy_from_slice(&m.gamma);
        let mut determined = self.free_missing(scratch);
        let absent = self.freed(&scratch.gamma);
        if absent == 0 && self.problem(&scratch.nu, &scratch.gamma, 0.0).zero_is_optimal() {
            state.g.fill(0.0);
            return Fusion { outcome: Outcome::default(), fast: true, determined };
        }
        let seats = m.refit.min((m.dims.sensors - absent).saturating_sub(1) / 2);
        let energy = self.projection.energy(&state.zeta, &scratch.nu, &mut scratch.projection);
        let mut outcome = Outcome::default();
        loop {
            let problem = self.problem(&scratch.nu, &scratch.gamma, energy);
            let solved = match &mut scratch.solver {
                Solver::Elements(ws) => lasso::solve(&problem, &mut state.g, ws),
                Solver::Groups(ws) => group_lasso::solve(&problem, &mut state.g, ws),
            };
            outcome = Outcome { iterations: outcome.iterations + solved.iterations, gap: solved.gap };
            let accused = self.freed(&scratch.gamma) - absent;
            let wave = if accused < ONE_BY_ONE { 1 } else { seats };
            if !self.free_accused(&state.g, scratch, wave.min(seats - accused)) {
                break;
            }
            if !self.free_sensors_are_determined(scratch) {
                scratch.gamma.copy_from_slice(&scratch.gamma_before);
                determined = false;
                break;
            }
        }
        if !outcome.gap.is_finite() || state.g.iter().any(|v| !v.is_finite()) {
            state.g.fill(0.0);
            outcome.gap = f64::INFINITY;
        }
        Fusion { outcome, fast: false, determined }
    }

    /// Sensors with a missing channel lose their penalty, unless the others cannot do without them.
    fn free_missing(&self, scratch: &mut Scratch) -> bool {
        for (i, &sensor) in self.m.channel_sensor.iter().enumerate() {
            if scratch.missing[i] {
                free(&mut scratch.gamma, &self.m.groups, self.elements_of(sensor));
            }
        }
        let determined = self.free_sensors_are_determined(scratch);
        if !determined {
            scratch.gamma.copy_from_slice(&self.m.gamma);
        }
        determined
    }

    fn problem<'a>(&'a self, linear: &'a [f64], gamma: &'a [f64], energy: f64) -> Problem<'a> {
        Problem { hessian: &self.m.hessian, linear, starts: &self.m.groups, gamma, energy }
    }

    /// Elements of g that belong to a sensor.
    pub(super) fn elements_of(&self, sensor: usize) -> Range<usize> {
        self.m.sensors[sensor]..self.m.sensors[sensor + 1]
    }

    /// How many sensors have no penalty.
    fn freed(&self, gamma: &[f64]) -> usize {
        (0..self.m.dims.sensors)
            .filter(|&sensor| is_free(gamma, &self.m.groups, self.elements_of(sensor)))
            .count()
    }

    /// Take the penalty from up to `count` suspected sensors, the largest ‖f_i‖ first. False if there is none.
    fn free_accused(&self, g: &[f64], scratch: &mut Scratch, count: usize) -> bool {
        scratch.gamma_before.copy_from_slice(&scratch.gamma);
        for freed in 0..count {
            let Some(sensor) = self.accused(g, &scratch.gamma) else { return freed > 0 };
            free(&mut scratch.gamma, &self.m.groups, self.elements_of(sensor));
        }
        count > 0
    }

    /// The penalised sensor with the largest ‖f_i‖, if it is suspected.
    fn accused(&self, g: &[f64], gamma: &[f64]) -> Option<usize> {
        let mut best = None;
        let mut best_size = self.m.suspicion;
        for sensor in 0..self.m.dims.sensors {
            if !is_free(gamma, &self.m.groups, self.elements_of(sensor)) {
                let size = self.size(g, sensor);
                if size > best_size {
                    best_size = size;
                    best = Some(sensor);
                }
            }
        }
        best
    }

    /// ‖f_i‖ in the metric N_ii.
    pub(super) fn size(&self, g: &[f64], sensor: usize) -> f64 {
        let d = self.elements();
        let range = self.elements_of(sensor);
        let part = &g[range.clone()];
        if part.iter().all(|&v| v == 0.0) {
            return 0.0;
        }
        let square: f64 = range
            .clone()
            .zip(part)
            .map(|(i, &v)| v * dot(&self.m.hessian[i * d..][range.clone()], part))
            .sum();
        square.max(0.0).sqrt()
    }
}

/// Free every penalty group among these elements.
fn free(gamma: &mut [f64], groups: &[usize], elements: Range<usize>) {
    for (value, &start) in gamma.iter_mut().zip(groups) {
        if elements.contains(&start) {
            *value = 0.0;
        }
    }
}

/// Whether these elements have no penalty; a sensor without elements has none to lose.
fn is_free(gamma: &[f64], groups: &[usize], elements: Range<usize>) -> bool {
    !elements.is_empty() && groups.binary_search(&elements.start).is_ok_and(|j| gamma[j] == 0.0)
}
