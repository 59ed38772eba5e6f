//! The Kalman filter with a rule that leaves out sensors before the correction.
//!
//! ```text
//!     gate      d_i² = r_iᵀ S_i⁻¹ r_i,  r_i = y_i − C_i x⁻ − D_i u,  S_i = C_i P⁻ C_iᵀ + R_i     out if d_i² > χ²
//!     sensor    the same about the prediction of a filter that hears sensor i alone              out if d_i² > χ²
//!     central   d² = rᵀ S⁻¹ r over all channels that arrived           nothing, or the worst out if d² > χ²
//! ```
//!
//! χ² is the quantile for as many degrees of freedom as channels were tested.

mod apart;
pub mod local;

use crate::codec::{Decoder, Encoder};
use crate::detectors::apart::Apart;
use crate::detectors::local::{LocalFilter, Locals};
use crate::kalman::gains::innovation_deviations;
use crate::kalman::{self, Kalman};
use crate::{Dims, Error, Estimator, Output, Result};

/// Who is left out.
#[derive(Debug, Clone)]
pub enum Rule {
    /// Sensors whose own channels are too far from the fused prediction.
    Gate,
    /// Sensors that are too far from the prediction of their own filter.
    Local {
        /// One per sensor.
        filters: Vec<LocalFilter>,
        /// Whether a filter does not take in a reading that raises the alarm.
        hold: bool,
    },
    /// Everyone, or the worst one after the other, when all channels together are too far from the prediction.
    Central {
        /// Leave out the worst until the others pass.
        drop_worst: bool,
    },
}

/// A Kalman filter with a rule.
#[derive(Debug, Clone)]
pub struct Detector {
    filter: Kalman,
    rule: Rule,
    apart: Apart,
    locals: Option<Locals>,
    /// χ² quantile per number of channels tested, (m + 1,); infinite for none.
    quantiles: Vec<f64>,
}

/// The Kalman filter's state, that of the local filters, and scratch.
#[derive(Debug, Clone)]
pub struct State {
    filter: kalman::State,
    locals: Option<Locals>,
    apart: Apart,
    /// y with NaN for the channels left out.
    heard: Vec<f64>,
    residual: Vec<f64>,
    /// d² over its quantile per sensor; NaN where nothing arrived.
    excess: Vec<f64>,
}

impl Detector {
    /// A detector on `filter`.
    ///
    /// # Errors
    /// If the channels of a sensor do not follow each other, or a length does not fit.
    pub fn new(filter: Kalman, rule: Rule, quantiles: Vec<f64>) -> Result<Self> {
        let model = filter.model();
        Error::check_len("quantiles", model.dims.channels + 1, quantiles.len())?;
        if !model.channel_sensor.is_sorted() {
            return Err(Error::input("channel_sensor", "the channels of a sensor side by side", "a mixture"));
        }
        let apart = Apart::new(model)?;
        let locals = match &rule {
            Rule::Local { filters, .. } => Some(Locals::new(model, filters)?),
            _ => None,
        };
        Ok(Self { filter, rule, apart, locals, quantiles })
    }

    fn state(&self, filter: kalman::State) -> State {
        let Dims { channels, sensors, .. } = self.filter.model().dims;
        State {
            filter,
            locals: self.locals.clone(),
            apart: self.apart.clone(),
            heard: vec![0.0; channels],
            residual: vec![0.0; channels],
            excess: vec![0.0; sensors],
        }
    }

    /// Leave out every sensor of excess above 1; returns the largest excess.
    fn leave_out_excessive(&self, state: &mut State) -> f64 {
        let owner = &self.filter.model().channel_sensor;
        for (value, &sensor) in state.heard.iter_mut().zip(owner) {
            if state.excess[sensor] > 1.0 {
                *value = f64::NAN;
            }
        }
        state.excess.iter().fold(0.0, |largest, &excess| excess.max(largest))
    }

    /// d² of every sensor about the fused prediction, over its quantile.
    fn measure(&self, state: &mut State, y: &[f64], innovation: &[f64]) {
        let kalman::State { k, p, scratch, .. } = &mut state.filter;
        state.apart.listen(self.filter.model(), *k, y, &p.prior);
        state.apart.excess(self.filter.model(), innovation, &self.quantiles, scratch, &mut state.excess);
    }

    /// d² of all channels heard, over its quantile; leaves the gains for them.
    fn test_together(&self, state: &mut State, innovation: &[f64], keep: bool) -> f64 {
        let kalman::State { k, p, scratch, .. } = &mut state.filter;
        self.filter.recursion.correct(p, *k, &state.heard, keep);
        p.gains.shift(innovation, scratch) / self.quantiles[p.gains.channels().len()]
    }

    /// The central test on all channels that arrived; returns its excess.
    fn test_centrally(
        &self,
        state: &mut State,
        y: &[f64],
        innovation: &[f64],
        drop_worst: bool,
        keep: bool,
    ) -> f64 {
        let all = self.test_together(state, innovation, keep);
        if all > 1.0 && !drop_worst {
            state.heard.fill(f64::NAN);
        }
        if all > 1.0 && drop_worst {
            self.measure(state, y, innovation);
            while self.leave_out_worst(state) && self.test_together(state, innovation, keep) > 1.0 {}
        }
        all
    }

    /// Leave out the sensor of largest excess among those heard; false if nobody is heard.
    fn leave_out_worst(&self, state: &mut State) -> bool {
        let heard = state.excess.iter().enumerate().filter(|(_, excess)| !excess.is_nan());
        let Some((worst, _)) = heard.max_by(|(_, a), (_, b)| a.total_cmp(b)) else { return false };
        state.excess[worst] = f64::NAN;
        let owner = &self.filter.model().channel_sensor;
        for (value, &sensor) in state.heard.iter_mut().zip(owner) {
            if sensor == worst {
                *value = f64::NAN;
            }
        }
        true
    }

    /// Trust, suspicion and attack of what was left out; returns how many sensors that were.
    fn report(&self, state: &mut State, (y, u): (&[f64], &[f64]), any: bool, out: &mut Output<'_>) -> usize {
        let model = self.filter.model();
        let left_out = |i: usize| !y[i].is_nan() && state.heard[i].is_nan();
        if any {
            model.innovation(state.filter.k, &state.filter.x, (y, u), &mut state.residual);
        }
        for (i, &sensor) in model.channel_sensor.iter().enumerate() {
            if !any || !left_out(i) {
                out.attack[i] = if y[i].is_nan() { f64::NAN } else { 0.0 };
                out.attack_std[i] = f64::NAN;
                continue;
            }
            out.attack[i] = state.residual[i];
            out.trust[sensor] = 0.0;
            out.suspected[sensor] = 1;
        }
        out.suspected.iter().filter(|&&suspected| suspected != 0).count()
    }
}

impl Estimator for Detector {
    type State = State;
    type Plan = ();

    fn dims(&self) -> Dims {
        self.filter.dims()
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        &["log_likelihood", "nis", "channels", "alarms", "excess"]
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        let mut state = self.state(self.filter.start(mean, covariance)?);
        if let (Rule::Local { filters, .. }, Some(locals)) = (&self.rule, &mut state.locals) {
            locals.start(filters, mean);
        }
        Ok(state)
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let (model, keep) = (self.filter.model(), out.covariance.is_some());
        self.filter.check_horizon(state.filter.k)?;
        model.innovation(state.filter.k, &state.filter.x, (y, u), out.innovation);
        state.heard.copy_from_slice(y);
        let excess = match &self.rule {
            Rule::Gate => {
                self.measure(state, y, out.innovation);
                self.leave_out_excessive(state)
            }
            Rule::Local { filters, hold } => {
                if let Some(locals) = &mut state.locals {
                    locals.step(filters, (y, u), &self.quantiles, *hold, &mut state.excess);
                }
                self.leave_out_excessive(state)
            }
            Rule::Central { drop_worst } => self.test_centrally(state, y, out.innovation, *drop_worst, keep),
        };
        let kalman::State { k, x, p, scratch, .. } = &mut state.filter;
        self.filter.recursion.correct(p, *k, &state.heard, keep);
        p.gains.correct_with_innovation(model, x, scratch, out);
        let left_out = (0..y.len()).any(|i| !y[i].is_nan() && state.heard[i].is_nan());
        if left_out {
            innovation_deviations(model, *k, p.posterior(), &mut scratch.channel, out.attack_std);
        }
        self.filter.recursion.predict(p, *k);
        state.apart.keep(p.cached);
        out.diagnostics[3] = self.report(state, (y, u), left_out, out) as f64;
        out.diagnostics[4] = excess;
        self.filter.predict_mean(&mut state.filter, u);
        Ok(())
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        self.filter.save(&state.filter, to);
        if let Some(locals) = &state.locals {
            to.floats(locals.z());
        }
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let mut state = self.state(self.filter.load(from)?);
        if let Some(locals) = &mut state.locals {
            from.floats(locals.z_mut())?;
        }
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        let (kind, filters) = match &self.rule {
            Rule::Gate => (0, None),
            Rule::Local { filters, hold } => (1 + usize::from(*hold), Some(filters)),
            Rule::Central { drop_worst } => (3 + usize::from(*drop_worst), None),
        };
        let own = crate::codec::Fingerprint::default()
            .bytes(&self.filter.fingerprint().to_le_bytes())
            .sizes(&[kind])
            .floats(&self.quantiles);
        filters.into_iter().flatten().fold(own, |hash, filter| filter.fingerprint(hash)).finish()
    }
}
