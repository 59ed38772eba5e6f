//! The one trait every algorithm implements, and what it reads and writes per sample.

use crate::codec::{Decoder, Encoder};
use crate::record::RunRecord;
use crate::{Result, Units};

/// Sizes that the drivers need.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Dims {
    /// n, length of x.
    pub states: usize,
    /// m, scalar measurements.
    pub channels: usize,
    /// N, sensors; each owns one or more channels.
    pub sensors: usize,
    /// p, length of u.
    pub inputs: usize,
}

/// How a step went. The Python `Status` has the same numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Status {
    /// The numbers mean what they say.
    Ok = 0,
    /// No channel arrived, or all were left out: the estimate is a prediction.
    NoMeasurement = 1,
    /// The solver stopped at its cap; the gap in the diagnostics says how far it is from the optimum.
    NotConverged = 2,
    /// The channels that are left do not determine the state: treat the estimate as a guess.
    IllConditioned = 3,
    /// The method's own recursion has broken down; what is reported comes from a safer one.
    BrokenDown = 4,
    /// Two ways to say who lies explain the sample about equally well and disagree on x; the method says if P
    /// includes both.
    Ambiguous = 5,
    /// More sensors are suspected than a minority: those that are believed may be the liars.
    MajoritySuspect = 6,
    /// No prior was given: the estimate comes from the window of the first samples.
    ColdStart = 7,
}

/// Where a step writes its results. Units are those of the normalised plant; the driver converts.
#[derive(Debug)]
pub struct Output<'a> {
    /// x[k|k], (n,).
    pub x: &'a mut [f64],
    /// Standard deviations of x, (n,).
    pub x_std: &'a mut [f64],
    /// P[k|k], (n, n) row-major, if the caller wants it.
    pub covariance: Option<&'a mut [f64]>,
    /// Probability-like trust per sensor in [0, 1], NaN when it sent nothing, (N,). The driver adds where it
    /// cannot be checked.
    pub trust: &'a mut [f64],
    /// Estimated injection per channel, NaN where there is none, (m,).
    pub attack: &'a mut [f64],
    /// Standard deviation of the error of `attack`, NaN where the method states none, (m,).
    pub attack_std: &'a mut [f64],
    /// 1 where a sensor is suspected, (N,).
    pub suspected: &'a mut [u8],
    /// y − C x[k|k−1] − D u, NaN where missing, (m,).
    pub innovation: &'a mut [f64],
    /// Standard deviation of the innovation when nobody lies, (m,).
    pub innovation_std: &'a mut [f64],
    /// One number per name in [`Estimator::diagnostics`].
    pub diagnostics: &'a mut [f64],
    /// How the step went.
    pub status: &'a mut u8,
}

/// Arrays that an [`Output`] can point to: the results of an estimator inside another one.
#[derive(Debug, Clone)]
pub struct Buffers {
    /// x[k|k], (n,).
    pub x: Vec<f64>,
    /// Its deviations, (n,).
    pub x_std: Vec<f64>,
    /// P[k|k], (n, n).
    pub covariance: Vec<f64>,
    /// (N,)
    pub trust: Vec<f64>,
    /// (m,)
    pub attack: Vec<f64>,
    /// (m,)
    pub attack_std: Vec<f64>,
    /// (N,)
    pub suspected: Vec<u8>,
    /// (m,)
    pub innovation: Vec<f64>,
    /// (m,)
    pub innovation_std: Vec<f64>,
    /// One per name.
    pub diagnostics: Vec<f64>,
    /// How the step went.
    pub status: u8,
}

impl Buffers {
    /// Room for one sample.
    #[must_use]
    pub fn new(dims: Dims, diagnostics: usize) -> Self {
        let Dims { states: n, channels: m, sensors, .. } = dims;
        Self {
            x: vec![0.0; n],
            x_std: vec![0.0; n],
            covariance: vec![0.0; n * n],
            trust: vec![0.0; sensors],
            attack: vec![0.0; m],
            attack_std: vec![0.0; m],
            suspected: vec![0; sensors],
            innovation: vec![0.0; m],
            innovation_std: vec![0.0; m],
            diagnostics: vec![0.0; diagnostics],
            status: 0,
        }
    }

    /// Where a step writes.
    pub fn output(&mut self) -> Output<'_> {
        Output {
            x: &mut self.x,
            x_std: &mut self.x_std,
            covariance: Some(&mut self.covariance),
            trust: &mut self.trust,
            attack: &mut self.attack,
            attack_std: &mut self.attack_std,
            suspected: &mut self.suspected,
            innovation: &mut self.innovation,
            innovation_std: &mut self.innovation_std,
            diagnostics: &mut self.diagnostics,
            status: &mut self.status,
        }
    }
}

/// One of several runs over a block of samples, in file units.
#[derive(Debug)]
pub struct PlannedRun<'a, S> {
    /// Filter state.
    pub state: &'a mut S,
    /// (steps, m)
    pub y: &'a [f64],
    /// (steps, p)
    pub u: &'a [f64],
    /// Where the results go.
    pub record: RunRecord<'a>,
}

/// An estimator is an immutable value; its filter state is explicit.
pub trait Estimator: Send + Sync {
    /// Everything that changes from sample to sample, scratch space included.
    type State: Clone + Send + Sync;
    /// What the runs of a batch can share because it does not depend on the data.
    type Plan: Sync;

    /// Sizes.
    fn dims(&self) -> Dims;

    /// Names of the diagnostics, in order. At least one.
    fn diagnostics(&self) -> &'static [&'static str];

    /// State before the first measurement: belief about x[0|−1]. `covariance` None means steady state.
    ///
    /// # Errors
    /// If the prior does not fit the estimator.
    fn start(&self, mean: &[f64], covariance: Option<&[f64]>) -> Result<Self::State>;

    /// Correct with y[k] (NaN = missing, otherwise finite), report, predict with u[k].
    ///
    /// # Errors
    /// Only for a caller's mistake, such as a step beyond the horizon of a time-varying plant.
    fn step(&self, state: &mut Self::State, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()>;

    /// Work shared by all runs over the next `steps` samples, or None if there is nothing to share.
    /// `y` holds (steps, m) of every run in file units: only which entries are missing may be used.
    fn plan(&self, _states: &[&Self::State], _y: &[&[f64]], _steps: usize) -> Option<Self::Plan> {
        None
    }

    /// Whether runs with the same plan report the same but for x, innovations and diagnostics. If not, every run
    /// takes its own planned steps and [`Estimator::run_planned`] is not called.
    fn shares_results(&self) -> bool {
        true
    }

    /// As [`Estimator::step`], bit for bit, with sample `k` of a plan.
    ///
    /// # Errors
    /// As [`Estimator::step`].
    fn step_planned(
        &self,
        _plan: &Self::Plan,
        _k: usize,
        state: &mut Self::State,
        y: &[f64],
        u: &[f64],
        out: &mut Output<'_>,
    ) -> Result<()> {
        self.step(state, y, u, out)
    }

    /// Up to [`LANES`](crate::lanes::LANES) runs by all samples of a plan, bit for bit as
    /// [`Estimator::step_planned`] and then [`Estimator::leave_plan`]; every estimator that plans offers it.
    ///
    /// Writes only what the data change: x, innovation and diagnostics. False if it met a number that [`Units`]
    /// refuse.
    fn run_planned(
        &self,
        _plan: &Self::Plan,
        _units: &Units,
        _runs: &mut [PlannedRun<'_, Self::State>],
    ) -> bool {
        false
    }

    /// Bring a state that only took planned steps up to date with the end of the plan.
    fn leave_plan(&self, _plan: &Self::Plan, _state: &mut Self::State) {}

    /// Write what [`Estimator::load`] needs to continue bit for bit.
    fn save(&self, state: &Self::State, to: &mut Encoder);

    /// Read a state written by [`Estimator::save`].
    ///
    /// # Errors
    /// [`crate::Error::Resume`] if the bytes do not fit.
    fn load(&self, from: &mut Decoder<'_>) -> Result<Self::State>;

    /// Hash of every number of the design: a state resumes only on the estimator it came from.
    fn fingerprint(&self) -> u64;
}
