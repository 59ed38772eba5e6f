//! The Kalman filter that hears protected sensors only, and tests all others against what it says.
//!
//! With x̂, P of that filter and v_w = B v_s + v', v' independent of the protected sensors' noise v_s,
//!
//! ```text
//!     r_i = (y_i − C_i x̂ − D_i u) − B_i (y_s − C_s x̂ − D_s u),   B = R_ws R_ss⁻¹
//!     V_i = (C_i − B_i C_s) P (C_i − B_i C_s)ᵀ + R_ii − B_i R_si
//!     d_i² = r_iᵀ V_i⁻¹ r_i ~ χ² if sensor i is honest, whatever the others send
//! ```
//!
//! r_i estimates the injection without any assumption about it; its error has the covariance V_i.

mod test;

use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::estimator::Buffers;
use crate::kalman::model::Model;
use crate::kalman::{self, Kalman};
use crate::protected::test::Test;
use crate::{Dims, Error, Estimator, Output, Result};

/// A Kalman filter on some channels of a plant, and a test of the others.
#[derive(Debug, Clone)]
pub struct Protected {
    filter: Kalman,
    model: Model,
    /// The plant's channel behind every channel of `filter`.
    own: Vec<usize>,
    test: Test,
}

/// The filter's state, the test's factors and scratch.
#[derive(Debug, Clone)]
pub struct State {
    filter: kalman::State,
    test: Test,
    heard: Vec<f64>,
    before: Vec<f64>,
    inner: Buffers,
}

impl Protected {
    /// `filter` hears the channels `own` of `model`. `quantiles` (m + 1,) bound d² per number of channels.
    ///
    /// # Errors
    /// Sizes that do not fit, or channels of a sensor that do not follow each other.
    pub fn new(filter: Kalman, model: Model, own: Vec<usize>, quantiles: Vec<f64>) -> Result<Self> {
        let (inner, dims) = (filter.dims(), model.dims);
        Error::check_len("protected channels", inner.channels, own.len())?;
        Error::check_len("protected states", dims.states, inner.states)?;
        Error::check_len("protected inputs", dims.inputs, inner.inputs)?;
        Error::check_len("quantiles", dims.channels + 1, quantiles.len())?;
        if own.iter().any(|&channel| channel >= dims.channels) {
            return Err(Error::input("protected", "channels of the plant", format!("{own:?}")));
        }
        let test = Test::new(&model, &own, quantiles)?;
        Ok(Self { filter, model, own, test })
    }

    fn state(&self, filter: kalman::State) -> State {
        State {
            filter,
            test: self.test.clone(),
            heard: vec![0.0; self.own.len()],
            before: vec![0.0; self.model.dims.states],
            inner: Buffers::new(self.filter.dims(), self.filter.diagnostics().len()),
        }
    }

    /// As [`Estimator::step`], without innovations, diagnostics and what is said about protected sensors.
    ///
    /// # Errors
    /// As [`Estimator::step`].
    pub fn advance(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let State { filter, test, heard, inner, .. } = state;
        let k = filter.k;
        for (value, &channel) in heard.iter_mut().zip(&self.own) {
            *value = y[channel];
        }
        let stale = !(filter.p.cached && test.current && heard.iter().all(|value| !value.is_nan()));
        if stale {
            self.filter.check_horizon(k)?;
            test.expect(&self.model, k, &filter.p.prior);
        }
        let mut told = inner.output();
        if !stale && out.covariance.is_none() {
            told.covariance = None;
        }
        self.filter.step(filter, heard, u, &mut told)?;
        if stale {
            test.prepare(&self.model, k, &self.own, (heard, &inner.covariance));
            test.current = filter.p.cached;
        }
        out.x.copy_from_slice(&inner.x);
        out.x_std.copy_from_slice(&inner.x_std);
        if let Some(covariance) = out.covariance.as_deref_mut() {
            covariance.copy_from_slice(&inner.covariance);
        }
        *out.status = inner.status;
        out.trust.fill(f64::NAN);
        out.suspected.fill(0);
        out.attack.fill(f64::NAN);
        out.attack_std.fill(f64::NAN);
        test.judge(&self.model, k, &self.own, (y, u), out);
        Ok(())
    }

    /// What to say about protected sensors: nothing can be injected there.
    fn report_own(&self, y: &[f64], out: &mut Output<'_>) {
        for &channel in &self.own {
            if !y[channel].is_nan() {
                out.trust[self.model.channel_sensor[channel]] = 1.0;
                out.attack[channel] = 0.0;
                out.attack_std[channel] = 0.0;
            }
        }
    }
}

impl Estimator for Protected {
    type State = State;
    type Plan = ();

    fn dims(&self) -> Dims {
        self.model.dims
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        self.filter.diagnostics()
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        Ok(self.state(self.filter.start(mean, covariance)?))
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        state.before.copy_from_slice(&state.filter.x);
        let k = state.filter.k;
        self.advance(state, y, u, out)?;
        let State { test, before, inner, .. } = state;
        out.diagnostics.copy_from_slice(&inner.diagnostics);
        self.model.innovation(k, before, (y, u), out.innovation);
        out.innovation_std.copy_from_slice(&test.innovation_std);
        self.report_own(y, out);
        Ok(())
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        self.filter.save(&state.filter, to);
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        Ok(self.state(self.filter.load(from)?))
    }

    fn fingerprint(&self) -> u64 {
        Fingerprint::default()
            .bytes(&self.filter.fingerprint().to_le_bytes())
            .bytes(&self.model.fingerprint().finish().to_le_bytes())
            .sizes(&self.own)
            .floats(&self.test.quantiles)
            .finish()
    }
}
