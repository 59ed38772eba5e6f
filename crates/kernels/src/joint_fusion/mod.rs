//! Joint fusion: every sensor that may lie is stacked with sensors that do not, its injection is estimated with the
//! state, and the local estimates are fused by their covariances.
//!
//! ```text
//!     ỹ_i = y_i − C_i x⁻_i − D_i u − Φ_i θ⁻_i                                                 (7)
//!     [x̂_i; θ̂_i] = [x⁻_i; θ⁻_i] + K_i ỹ_i,   φ̂_i ← φ̂_i + Γ_i ỹ_i                             (6)
//!     x̂_0 = Σ G_i x̂_i                                                                         (8)
//!     x⁻_i = A x̂_i + B u,   θ⁻_i = θ̂_i + φ̂_i
//! ```
//!
//! Beside it runs the Kalman filter of the protected sensors alone: it tests the others, and is what is reported when
//! a recursion has broken down.
//!
//! # References
//! Chen, Weng, Ho, Yu 2022.

mod array;
pub mod choice;
pub mod covariance;
pub mod exact;
pub mod fusion;
pub mod gains;
mod intersection;
pub mod layout;
pub mod mean;
pub mod printed;
mod report;
mod semidefinite;
mod trace;

use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::estimator::Buffers;
use crate::joint_fusion::choice::{Choice, Memory};
use crate::joint_fusion::covariance::{Covariance, Design, Form};
use crate::joint_fusion::gains::Gains;
use crate::joint_fusion::layout::Pattern;
use crate::joint_fusion::mean::Mean;
pub use crate::joint_fusion::trace::Trace;
use crate::protected::{self, Protected};
use crate::{Dims, Error, Estimator, Output, Result, Status};

/// Samples after which the search for a steady state gives up; the printed recursions get four times as many, because
/// their second moments settle more slowly than their gains.
const SEARCH: usize = 5000;

/// Largest share of memory for gains that runs of a batch share, bytes.
const PLAN: usize = 1 << 28;

/// The estimator.
#[derive(Debug, Clone)]
pub struct JointFusion {
    design: Design,
    /// η of all injections, (Σ p_i,) or (T, Σ p_i).
    eta: Vec<f64>,
    choice: Choice,
    /// Channels of sensors that others are stacked with, in increasing order.
    stacked: Vec<usize>,
    beside: Option<Protected>,
    /// Moments before the first measurement in steady state, if there are any.
    steady: Option<Covariance>,
}

/// Everything that changes.
#[derive(Debug, Clone)]
pub struct State {
    k: usize,
    p: Covariance,
    pattern: Pattern,
    mean: Mean,
    memory: Memory,
    beside: Option<protected::State>,
    alone: Buffers,
}

/// Gains for a block of samples, and the covariances after it.
#[derive(Debug)]
pub struct Plan {
    gains: Vec<Gains>,
    index: Vec<usize>,
    end: Covariance,
}

impl JointFusion {
    /// An estimator. `from` is a covariance (n, n) to begin the search for a steady state with, None for no search.
    ///
    /// # Errors
    /// Sizes that do not fit.
    pub fn new(
        design: Design,
        (eta, choice): (Vec<f64>, Choice),
        beside: Option<Protected>,
        from: Option<&[f64]>,
    ) -> Result<Self> {
        let weak = design.layout.weak;
        if eta.is_empty()
            || !eta.len().is_multiple_of(weak)
            || eta.iter().any(|e| !(0.0..f64::MAX).contains(e))
        {
            let expected = format!("{weak} finite numbers of at least 0, or as many per sample");
            return Err(Error::input("eta", expected, format!("{} numbers", eta.len())));
        }
        if design.form == Form::Printed && !matches!(choice, Choice::Fixed) {
            return Err(Error::input(
                "form",
                "exact moments where eta or the protected sensors change",
                "printed",
            ));
        }
        let others = design.layout.locals.iter().flat_map(|local| &local.channels[local.weak..]);
        let mut stacked: Vec<usize> = others.copied().collect();
        stacked.sort_unstable();
        stacked.dedup();
        let mut estimator = Self { design, eta, choice, stacked, beside, steady: None };
        if let Some(from) = from {
            Error::check_len("prior", estimator.design.q.len(), from.len())?;
            estimator.steady = estimator.settle(from)?;
        }
        Ok(estimator)
    }

    /// The design.
    #[must_use]
    pub fn design(&self) -> &Design {
        &self.design
    }

    /// Whether there is a steady state.
    #[must_use]
    pub fn is_steady(&self) -> bool {
        self.steady.is_some()
    }

    /// Samples that A, C and η cover; None if nothing varies.
    fn horizon(&self) -> Option<usize> {
        let samples = self.eta.len() / self.design.layout.weak;
        let varying = (samples > 1).then_some(samples);
        match (self.design.model.horizon, varying) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        }
    }

    fn check_horizon(&self, k: usize) -> Result<()> {
        match self.horizon() {
            Some(horizon) if k >= horizon => {
                let expected = format!("at most {horizon} samples, as many as A, C and eta cover");
                Err(Error::input("y", expected, "one more"))
            }
            _ => Ok(()),
        }
    }

    /// η at sample k.
    #[must_use]
    pub fn eta(&self, k: usize) -> &[f64] {
        let weak = self.design.layout.weak;
        let from = if self.eta.len() == weak { 0 } else { k * weak };
        &self.eta[from..from + weak]
    }

    /// Moments that repeat themselves, if nothing varies and they do so soon.
    fn settle(&self, from: &[f64]) -> Result<Option<Covariance>> {
        if self.horizon().is_some() {
            return Ok(None);
        }
        let eta = match self.choice {
            Choice::Fixed => self.eta.clone(),
            _ => vec![0.0; self.design.layout.weak],
        };
        let limit = if self.design.form == Form::Printed { 4 * SEARCH } else { SEARCH };
        self.design.settle(from, &eta, limit)
    }

    /// Which rows of the locals arrived, and η as given.
    fn listen(&self, pattern: &mut Pattern, k: usize, y: &[f64]) {
        pattern.eta.copy_from_slice(self.eta(k));
        for local in &self.design.layout.locals {
            for (heard, &channel) in pattern.heard[local.rows()].iter_mut().zip(&local.channels) {
                *heard = !y[channel].is_nan();
            }
        }
    }

    fn state(&self, mean: &[f64], p: Covariance, memory: Memory, beside: Option<protected::State>) -> State {
        State {
            k: 0,
            pattern: p.pattern.clone(),
            p,
            mean: Mean::new(&self.design, mean),
            memory,
            beside,
            alone: Buffers::new(self.dims(), 3),
        }
    }

    /// The data part of one step.
    fn advance_mean(
        &self,
        gains: &Gains,
        (k, mean): (usize, &mut Mean),
        (beside, alone, memory): (&mut Option<protected::State>, &mut Buffers, &Memory),
        (y, u): (&[f64], &[f64]),
        out: &mut Output<'_>,
    ) -> Result<()> {
        let together = self.beside.as_ref().zip(beside.as_mut());
        let known = together.is_some();
        if let Some((filter, state)) = together {
            let mut told = alone.output();
            if !gains.broken {
                told.covariance = None;
            }
            filter.advance(state, y, u, &mut told)?;
        }
        mean.correct(&self.design, (gains, memory.reach()), k, (y, u), out);
        let broken = gains.broken || out.x.iter().any(|value| !value.is_finite());
        if broken {
            report::fall_back(known.then_some(&*alone), gains.broken, mean.predicted(), out);
        }
        let owner = &self.design.model.channel_sensor;
        let counted = match memory {
            Memory::Auto(told) => report::repeat(owner, &told.1, out),
            _ => report::judge((owner, &self.stacked), y, known.then_some(&*alone), out),
        };
        out.diagnostics[4] = counted as f64;
        let mut heard = report::report(&self.design.layout.used, y, known.then_some(&*alone), out);
        if counted == 0 && matches!(memory, Memory::Auto(_)) {
            heard = 0;
        }
        *out.status = match (broken, heard) {
            (true, _) => Status::BrokenDown,
            (_, 0) => Status::NoMeasurement,
            _ => Status::Ok,
        } as u8;
        mean.predict(&self.design, k, u, out.x);
        Ok(())
    }

    /// η and who counts as protected, where that is chosen from the data.
    fn choose(
        &self,
        memory: &mut Memory,
        (k, p, mean): (usize, &Covariance, &Mean),
        (y, u): (&[f64], &[f64]),
        pattern: &mut Pattern,
    ) -> Result<()> {
        match (&self.choice, memory) {
            (Choice::Adaptive { gate, .. }, Memory::Adaptive(adaptive)) => {
                adaptive.choose(&self.design, *gate, k, (p, mean.states()), (y, u), pattern);
            }
            (Choice::Auto { detector, marked }, Memory::Auto(told)) => {
                choice::trust(&self.design, (detector, marked), told, (y, u), pattern)?;
            }
            _ => (),
        }
        Ok(())
    }
}

impl Estimator for JointFusion {
    type State = State;
    type Plan = Plan;

    fn dims(&self) -> Dims {
        self.design.model.dims
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        &["channels", "trace", "protected_trace", "protected_gap", "protected"]
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        let n = self.design.layout.n;
        Error::check_len("prior.x", n, mean.len())?;
        let beside = (self.beside.as_ref()).map(|filter| filter.start(mean, covariance)).transpose()?;
        let memory = self.choice.start(&self.design, mean, covariance)?;
        let Some(p) = covariance else {
            let steady = self.steady.clone().ok_or_else(|| {
                let expected = "a belief with a covariance P, because this estimator has no steady state";
                Error::input("prior", expected, "none")
            })?;
            return Ok(self.state(mean, steady, memory, beside));
        };
        crate::kalman::ud::Ud::new("prior.P", p, n)?;
        Ok(self.state(mean, self.design.start(p, self.eta(0))?, memory, beside))
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        self.check_horizon(state.k)?;
        let State { k, p, pattern, mean, memory, beside, alone } = state;
        self.listen(pattern, *k, y);
        self.choose(memory, (*k, p, mean), (y, u), pattern)?;
        self.design.correct(p, *k, pattern);
        self.advance_mean(&p.gains, (*k, mean), (beside, alone, memory), (y, u), out)?;
        self.design.predict(p, *k);
        *k += 1;
        Ok(())
    }

    fn plan(&self, states: &[&State], y: &[&[f64]], steps: usize) -> Option<Plan> {
        if !matches!(self.choice, Choice::Fixed) {
            return None;
        }
        let (lead, others) = states.split_first()?;
        let (rows, rest) = y.split_first()?;
        let alike = |other: &&State| other.k == lead.k && other.p.same(&lead.p);
        let gaps = |run: &&[f64]| rows.iter().zip(run.iter()).all(|(a, b)| a.is_nan() == b.is_nan());
        if !others.iter().all(alike) || !rest.iter().all(gaps) {
            return None;
        }
        self.check_horizon((lead.k + steps).checked_sub(1)?).ok()?;
        let mut plan = Plan { gains: Vec::new(), index: Vec::new(), end: lead.p.clone() };
        let mut pattern = lead.pattern.clone();
        for (i, row) in rows.chunks(self.dims().channels).enumerate() {
            let known = plan.end.cached && !plan.gains.is_empty();
            self.listen(&mut pattern, lead.k + i, row);
            self.design.correct(&mut plan.end, lead.k + i, &pattern);
            if !(known && plan.end.cached) {
                plan.gains.push(plan.end.gains.clone());
            }
            plan.index.push(plan.gains.len() - 1);
            self.design.predict(&mut plan.end, lead.k + i);
            if plan.gains.len() * plan.end.gains.size() > PLAN {
                return None;
            }
        }
        Some(plan)
    }

    fn shares_results(&self) -> bool {
        false
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
        let State { k, mean, beside, alone, memory, .. } = state;
        self.advance_mean(&plan.gains[plan.index[i]], (*k, mean), (beside, alone, memory), (y, u), out)?;
        *k += 1;
        Ok(())
    }

    fn leave_plan(&self, plan: &Plan, state: &mut State) {
        state.p = plan.end.clone();
        state.p.cached = false;
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        to.integer(state.k as u64);
        to.integer(u64::from(state.p.settled));
        to.integer(u64::from(state.p.is_moved()));
        state.p.each(|numbers| to.floats(numbers));
        state.p.pattern.heard.iter().for_each(|&heard| to.integer(u64::from(heard)));
        to.floats(&state.p.pattern.eta);
        state.mean.each(|numbers| to.floats(numbers));
        self.choice.save(&state.memory, to);
        if let (Some(filter), Some(beside)) = (&self.beside, &state.beside) {
            filter.save(beside, to);
        }
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let n = self.design.layout.n;
        let k = usize::try_from(from.integer()?).unwrap_or(usize::MAX);
        let (settled, moved) = (from.integer()? != 0, from.integer()? != 0);
        let mut p = self.design.start(&vec![0.0; n * n], self.eta(0))?;
        p.each_mut(|numbers| from.floats(numbers))?;
        p.settled = settled;
        p.set_moved(moved);
        for heard in &mut p.pattern.heard {
            *heard = from.integer()? != 0;
        }
        from.floats(&mut p.pattern.eta)?;
        let mut mean = Mean::new(&self.design, &vec![0.0; n]);
        mean.each_mut(|numbers| from.floats(numbers))?;
        let memory = self.choice.load(&self.design, from)?;
        let beside = self.beside.as_ref().map(|filter| filter.load(from)).transpose()?;
        Ok(State { k, mean, ..self.state(&vec![0.0; n], p, memory, beside) })
    }

    fn fingerprint(&self) -> u64 {
        let layout = &self.design.layout;
        let own = Fingerprint::default()
            .bytes(&self.design.model.fingerprint().finish().to_le_bytes())
            .sizes(&[self.design.form as usize, self.design.rule as usize])
            .floats(&self.eta);
        let own = self.choice.fingerprint(own);
        let stacked =
            layout.locals.iter().fold(own, |hash, local| hash.sizes(&local.channels).sizes(&[local.weak]));
        let beside = self.beside.as_ref().map_or(0, Estimator::fingerprint);
        let steady = stacked.bytes(&beside.to_le_bytes());
        let mut hash = steady;
        if let Some(steady) = &self.steady {
            steady.each(|numbers| hash = hash.floats(numbers));
        }
        hash.finish()
    }
}
