//! The Kalman filter: UD factors, one channel at a time, gains cached once they repeat.
//!
//! ```text
//!     correct   K = P⁻Cᵀ(C P⁻Cᵀ + R)⁻¹,  x = x⁻ + K (y − C x⁻ − D u),  P = (I − K C) P⁻
//!     predict   x⁻ = A x + B u,  P⁻ = A P Aᵀ + Q
//! ```
//!
//! # References
//! Bierman 1977, *Factorization Methods for Discrete Sequential Estimation*.

pub mod alone;
pub mod covariance;
pub mod gains;
pub mod heard;
pub mod model;
pub mod ud;
pub mod whitening;

use crate::codec::{Decoder, Encoder};
use crate::estimator::PlannedRun;
use crate::kalman::covariance::{Covariance, Recursion};
use crate::kalman::gains::{Gains, Scratch};
use crate::kalman::model::Model;
use crate::kalman::ud::Ud;
use crate::lanes::{self, LANES, Lanes};
use crate::{Dims, Error, Estimator, Output, Result, Units};

/// Largest share of memory for gains that runs of a batch share, bytes.
const PLAN: usize = 1 << 28;

/// Samples after which the search for a fixed point at design time gives up.
const SEARCH: usize = 2000;

/// The Kalman filter of one plant.
#[derive(Debug, Clone)]
pub struct Kalman {
    /// What moves the covariance.
    pub recursion: Recursion,
    /// State before the first measurement in steady state, if there is one.
    steady: Option<State>,
}

/// Belief about x[k|k−1] and scratch.
#[derive(Debug, Clone)]
pub struct State {
    /// The next sample.
    pub k: usize,
    /// x[k|k−1].
    pub x: Vec<f64>,
    /// P[k|k−1] and the latest gains.
    pub p: Covariance,
    /// For the data part of a step.
    pub scratch: Scratch,
    next: Vec<f64>,
}

/// Gains for a block of samples, and the covariance after it.
#[derive(Debug)]
pub struct Plan {
    gains: Vec<Gains>,
    index: Vec<usize>,
    end: Covariance,
}

impl Kalman {
    /// A filter for `model`. `steady` is P[0|−1] (n, n) of the steady state, if there is one.
    ///
    /// # Errors
    /// If `steady` is not a covariance.
    pub fn new(model: Model, steady: Option<&[f64]>) -> Result<Self> {
        let recursion = Recursion::new(model);
        let mut filter = Self { recursion, steady: None };
        filter.steady = steady.map(|p| filter.settle(p)).transpose()?;
        Ok(filter)
    }

    /// The plant.
    #[must_use]
    pub fn model(&self) -> &Model {
        &self.recursion.model
    }

    fn state(&self, mean: Vec<f64>, prior: Ud) -> State {
        let (dims, n) = (self.model().dims, mean.len());
        let p = self.recursion.start(prior);
        State { k: 0, x: mean, p, scratch: Scratch::new(dims), next: vec![0.0; n] }
    }

    /// The state in steady state: `p`, iterated until it repeats itself if it does so soon.
    fn settle(&self, p: &[f64]) -> Result<State> {
        let (n, m) = (self.model().dims.states, self.model().dims.channels);
        let start = self.state(vec![0.0; n], Ud::new("prior covariance", p, n)?);
        let (mut state, all) = (start.clone(), vec![0.0; m]);
        for _ in 0..SEARCH {
            self.recursion.advance(&mut state.p, 0, &all, false);
            if state.p.cached {
                return Ok(state);
            }
        }
        Ok(start)
    }

    /// Whether the plant has a sample k.
    ///
    /// # Errors
    /// If A or C varies and does not cover it.
    pub fn check_horizon(&self, k: usize) -> Result<()> {
        self.model().check_horizon(k)
    }

    /// From x[k|k] and u to x[k+1|k].
    pub fn predict_mean(&self, state: &mut State, u: &[f64]) {
        let State { k, x, next, .. } = state;
        self.model().predict(*k, x, u, next);
        std::mem::swap(x, next);
        *k += 1;
    }

    /// The data part of one step.
    fn advance_mean(
        &self,
        gains: &Gains,
        (k, x): (&mut usize, &mut Vec<f64>),
        (scratch, next): (&mut Scratch, &mut Vec<f64>),
        (y, u): (&[f64], &[f64]),
        out: &mut Output<'_>,
    ) {
        gains.correct(self.model(), *k, x, (y, u), scratch, out);
        self.model().predict(*k, x, u, next);
        std::mem::swap(x, next);
        *k += 1;
    }
}

impl Estimator for Kalman {
    type State = State;
    type Plan = Plan;

    fn dims(&self) -> Dims {
        self.model().dims
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        &["log_likelihood", "nis", "channels"]
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        Error::check_len("prior.x", self.model().dims.states, mean.len())?;
        if let Some(p) = covariance {
            return Ok(self.state(mean.to_vec(), Ud::new("prior.P", p, mean.len())?));
        }
        let steady = self.steady.as_ref().ok_or_else(|| {
            let expected = "a belief with a covariance P, because this plant has no steady state";
            Error::input("prior", expected, "none")
        })?;
        Ok(State { x: mean.to_vec(), ..steady.clone() })
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        self.check_horizon(state.k)?;
        self.recursion.advance(&mut state.p, state.k, y, out.covariance.is_some());
        let State { k, x, p, scratch, next } = state;
        self.advance_mean(&p.gains, (k, x), (scratch, next), (y, u), out);
        Ok(())
    }

    fn plan(&self, states: &[&State], y: &[&[f64]], steps: usize) -> Option<Plan> {
        let (lead, others) = states.split_first()?;
        let (pattern, rest) = y.split_first()?;
        let alike = |other: &&State| other.k == lead.k && other.p.same(&lead.p);
        if !others.iter().all(alike) || !rest.iter().all(|run| same_gaps(run, pattern)) {
            return None;
        }
        self.check_horizon((lead.k + steps).checked_sub(1)?).ok()?;
        let mut plan = Plan { gains: Vec::new(), index: Vec::new(), end: lead.p.clone() };
        for (i, row) in pattern.chunks(self.model().dims.channels).enumerate() {
            let known = plan.end.cached && !plan.gains.is_empty();
            self.recursion.advance(&mut plan.end, lead.k + i, row, true);
            if !(known && plan.end.cached) {
                plan.gains.push(plan.end.gains.clone());
            }
            plan.index.push(plan.gains.len() - 1);
            if plan.gains.len() * Gains::size(self.model()) > PLAN {
                return None;
            }
        }
        Some(plan)
    }

    fn step_planned(
        &self,
        plan: &Plan,
        i: usize,
        state: &mut State,
        y: &[f64],
        u: &[f64],
        out: &mut Output<'_>,
    ) -> Result<()> {
        let State { k, x, scratch, next, .. } = state;
        self.advance_mean(&plan.gains[plan.index[i]], (k, x), (scratch, next), (y, u), out);
        Ok(())
    }

    fn run_planned(&self, plan: &Plan, units: &Units, runs: &mut [PlannedRun<'_, State>]) -> bool {
        let (model, steps) = (self.model(), plan.index.len());
        let (m, p) = (model.dims.channels, model.dims.inputs);
        let (Some(last), Some(start)) = (runs.len().checked_sub(1), runs.first().map(|run| run.state.k))
        else {
            return true;
        };
        // Lanes without a run repeat the last one, and nobody looks at them.
        let y: [&[f64]; LANES] = std::array::from_fn(|lane| runs[lane.min(last)].y);
        let u: [&[f64]; LANES] = std::array::from_fn(|lane| runs[lane.min(last)].u);
        let x: [&[f64]; LANES] = std::array::from_fn(|lane| &runs[lane.min(last)].state.x[..]);
        let mut lanes = Lanes::new(model.dims, self.diagnostics().len());
        lanes::gather(&x, &mut lanes.x);
        for (i, &index) in plan.index.iter().enumerate() {
            if !lanes.read(units, &y.map(|y| &y[i * m..]), &u.map(|u| &u[i * p..])) {
                return false;
            }
            plan.gains[index].correct_lanes(model, start + i, &mut lanes);
            for (lane, run) in runs.iter_mut().enumerate() {
                lanes.write(units, lane, i, &mut run.record);
            }
            model.predict_lanes(start + i, &lanes.x, &lanes.u, &mut lanes.next);
            std::mem::swap(&mut lanes.x, &mut lanes.next);
        }
        for (lane, run) in runs.iter_mut().enumerate() {
            lanes::scatter(&lanes.x, lane, &mut run.state.x);
            run.state.k += steps;
            self.leave_plan(plan, run.state);
        }
        true
    }

    fn leave_plan(&self, plan: &Plan, state: &mut State) {
        state.p.prior.copy_from(&plan.end.prior);
        state.p.settled = plan.end.settled;
        state.p.cached = false;
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        to.integer(state.k as u64);
        to.integer(u64::from(state.p.settled));
        to.floats(&state.x);
        to.floats(&state.p.prior.d);
        for j in 0..state.x.len() {
            to.floats(state.p.prior.column(j));
        }
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let n = self.model().dims.states;
        let (k, settled) = (from.integer()?, from.integer()? != 0);
        let (mut x, mut prior) = (vec![0.0; n], Ud::zero(n));
        from.floats(&mut x)?;
        from.floats(&mut prior.d)?;
        for j in 0..n {
            from.floats(&mut prior.u[j * n..j * n + j])?;
        }
        let mut state = self.state(x, prior);
        state.k = usize::try_from(k).unwrap_or(usize::MAX);
        state.p.settled = settled;
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        let hash = self.model().fingerprint();
        match &self.steady {
            Some(steady) => hash.floats(&steady.p.prior.d).floats(&steady.p.prior.u).finish(),
            None => hash.finish(),
        }
    }
}

/// Whether the same entries are missing.
fn same_gaps(a: &[f64], b: &[f64]) -> bool {
    a.iter().zip(b).all(|(a, b)| a.is_nan() == b.is_nan())
}
