//! Injections as states: a Kalman filter on X = [x; θ], with or without a drift of θ that is estimated too.
//!
//! ```text
//!     X[k+1] = diag(A, I) X[k] + [B; 0] u + [w; φ],   y = [C, Φ] X + D u + v
//! ```
//!
//! The model is that of the augmented system; φ is white noise in its Q.
//!
//! # References
//! Chen, Weng, Ho, Yu 2022, Remark 3 and eq. (9); Zhang 2018 for the drift.

pub mod drift;
pub mod report;

use crate::augmented::drift::{Drift, Forgetting};
use crate::augmented::report::Report;
use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::kalman::{self, Kalman};
use crate::{Dims, Error, Estimator, Output, Result, Status};

/// A Kalman filter on the augmented system.
#[derive(Debug, Clone)]
pub struct Augmented {
    filter: Kalman,
    report: Report,
    /// Variance of θ before the first sample, (w,).
    start: Vec<f64>,
    forgetting: Option<Forgetting>,
}

/// The Kalman filter's state, that of the drift, and scratch.
#[derive(Debug, Clone)]
pub struct State {
    filter: kalman::State,
    drift: Option<Drift>,
    /// X[k|k], its standard deviations and covariance.
    x: Vec<f64>,
    x_std: Vec<f64>,
    covariance: Vec<f64>,
    scratch: report::Scratch,
}

impl Augmented {
    /// An estimator on `filter`, which is that of the augmented system. `start` is the variance of θ[0] before y[0],
    /// (w,). With `forgetting` the drift of θ is estimated.
    ///
    /// # Errors
    /// If a length does not fit or a setting is out of range.
    pub fn new(
        filter: Kalman,
        report: Report,
        start: Vec<f64>,
        forgetting: Option<Forgetting>,
    ) -> Result<Self> {
        report.check(filter.model())?;
        let w = report.weak.len();
        Error::check_len("attack_start", w, start.len())?;
        if let Some(Forgetting { factor, start }) = &forgetting {
            Error::check_len("drift_start", w, start.len())?;
            if !(*factor > 0.0 && *factor <= 1.0) {
                return Err(Error::input("forgetting", "a number in (0, 1]", format!("{factor}")));
            }
            if !start.iter().all(|&variance| variance > 0.0) {
                return Err(Error::input("drift_start", "variances > 0", format!("{start:?}")));
            }
        }
        Ok(Self { filter, report, start, forgetting })
    }

    fn state(&self, filter: kalman::State) -> State {
        let model = self.filter.model();
        let n = model.dims.states;
        let drift = |forgetting| Drift::new(forgetting, model, &self.report.weak);
        State {
            filter,
            drift: self.forgetting.as_ref().map(drift),
            x: vec![0.0; n],
            x_std: vec![0.0; n],
            covariance: vec![0.0; n * n],
            scratch: self.report.scratch(),
        }
    }

    /// diag(P, start): θ[0] is independent of x[0].
    fn joint(&self, p: &[f64]) -> Result<Vec<f64>> {
        let (n, size) = (self.report.states, self.filter.model().dims.states);
        Error::check_len("prior.P", n * n, p.len())?;
        let mut joint = vec![0.0; size * size];
        for (row, own) in joint.chunks_exact_mut(size).zip(p.chunks_exact(n)) {
            row[..n].copy_from_slice(own);
        }
        for (j, variance) in self.start.iter().enumerate() {
            joint[(n + j) * (size + 1)] = *variance;
        }
        Ok(joint)
    }

    /// From the filter that takes the drift for zero to the one that knows it. False if the drift broke down: it then
    /// starts anew, and state and covariance stay those of the filter.
    fn follow(
        &self,
        forgetting: &Forgetting,
        (k, y): (usize, &[f64]),
        state: &mut State,
        out: &mut Output<'_>,
    ) -> bool {
        let State { filter, drift: Some(drift), x, covariance, .. } = state else { return true };
        let (model, before) = (self.filter.model(), [out.diagnostics[0], out.diagnostics[1]]);
        drift.forget(forgetting, &self.report.weak, y);
        let mut sound = drift.is_sound();
        if sound {
            drift.foresee(model, k, out.innovation, out.innovation_std);
            drift.correct(&filter.p.gains, out.innovation, &mut filter.scratch, out.diagnostics);
            sound = drift.is_sound();
        }
        if sound {
            drift.add_to(x, covariance);
        } else {
            drift.restart(forgetting);
            out.diagnostics[..2].copy_from_slice(&before);
        }
        drift.predict(model, k);
        sound
    }
}

impl Estimator for Augmented {
    type State = State;
    type Plan = ();

    fn dims(&self) -> Dims {
        Dims { states: self.report.states, ..self.filter.dims() }
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        self.filter.diagnostics()
    }

    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<State> {
        Error::check_len("prior.x", self.report.states, mean.len())?;
        let mut joint = mean.to_vec();
        joint.resize(self.filter.model().dims.states, 0.0);
        let covariance = covariance.map(|p| self.joint(p)).transpose()?;
        Ok(self.state(self.filter.start(&joint, covariance.as_deref())?))
    }

    fn step(&self, state: &mut State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let k = state.filter.k;
        let mut whole = Output {
            x: &mut state.x,
            x_std: &mut state.x_std,
            covariance: Some(&mut state.covariance),
            trust: out.trust,
            attack: out.attack,
            attack_std: out.attack_std,
            suspected: out.suspected,
            innovation: out.innovation,
            innovation_std: out.innovation_std,
            diagnostics: out.diagnostics,
            status: out.status,
        };
        self.filter.step(&mut state.filter, y, u, &mut whole)?;
        if let Some(forgetting) = &self.forgetting
            && !self.follow(forgetting, (k, y), state, out)
        {
            *out.status = Status::BrokenDown as u8;
        }
        let State { x, covariance, scratch, .. } = state;
        self.report.write(self.filter.model(), y, (x, covariance), scratch, out);
        Ok(())
    }

    fn save(&self, state: &State, to: &mut Encoder) {
        self.filter.save(&state.filter, to);
        if let Some(drift) = &state.drift {
            drift.save(to);
        }
    }

    fn load(&self, from: &mut Decoder<'_>) -> Result<State> {
        let mut state = self.state(self.filter.load(from)?);
        if let Some(drift) = &mut state.drift {
            drift.load(from)?;
        }
        Ok(state)
    }

    fn fingerprint(&self) -> u64 {
        let own = Fingerprint::default()
            .bytes(&self.filter.fingerprint().to_le_bytes())
            .sizes(&[self.report.states])
            .sizes(&self.report.weak)
            .floats(&self.report.quantiles)
            .floats(&self.start);
        let drift = self.forgetting.iter();
        drift.fold(own, |hash, drift| hash.floats(&[drift.factor]).floats(&drift.start)).finish()
    }
}
