//! Adversaries that react to the defender: they see what a filter expects its sensors to send, and answer in proportion.
//!
//! ```text
//!     expected[k] = offset + scale · (C x[k|k−1] + D u[k]),   x[k|k−1] = A x[k−1|k−1] + B u[k−1]
//!     y[k]        = open[k] + gain[k] · (clean[k] − expected[k])
//! ```

use crate::kalman::model::Model;
use crate::{Error, Result, Units};

/// What such adversaries do to a batch of runs, file units.
#[derive(Debug, Clone, Copy)]
pub struct Reaction<'a> {
    /// The plant by which the defender's estimate is carried on.
    pub model: &'a Model,
    /// What the sensors measure, (runs, steps, m).
    pub clean: &'a [f64],
    /// The same with all other injections, NaN where a reading is suppressed, (runs, steps, m).
    pub open: &'a [f64],
    /// Zero where nobody reacts, (runs, steps, m).
    pub gain: &'a [f64],
    /// (runs, steps, p)
    pub u: &'a [f64],
    /// x[0|−1] of every run, (runs, n).
    pub means: &'a [f64],
    /// Samples per run.
    pub steps: usize,
}

/// The part of one run.
pub(crate) struct OneRun<'a> {
    whole: Reaction<'a>,
    run: usize,
    /// x[k|k−1], (n,).
    x: Vec<f64>,
    next: Vec<f64>,
    expected: Vec<f64>,
}

impl<'a> Reaction<'a> {
    /// Check that every array holds `runs` runs.
    ///
    /// # Errors
    /// A wrong length, or more samples than A and C cover.
    pub fn check(&self, runs: usize) -> Result<()> {
        let dims = self.model.dims;
        let readings = runs * self.steps * dims.channels;
        Error::check_len("clean", readings, self.clean.len())?;
        Error::check_len("open", readings, self.open.len())?;
        Error::check_len("gain", readings, self.gain.len())?;
        Error::check_len("u", runs * self.steps * dims.inputs, self.u.len())?;
        Error::check_len("means", runs * dims.states, self.means.len())?;
        match self.model.horizon {
            Some(horizon) if self.steps > horizon => {
                let expected = format!("at most {horizon} samples, as many as A and C cover");
                Err(Error::input("y", expected, format!("{}", self.steps)))
            }
            _ => Ok(()),
        }
    }

    pub(crate) fn of(&self, run: usize) -> OneRun<'a> {
        let (n, m) = (self.model.dims.states, self.model.dims.channels);
        let x = self.means[run * n..(run + 1) * n].to_vec();
        OneRun { whole: *self, run, x, next: vec![0.0; n], expected: vec![0.0; m] }
    }
}

impl<'a> OneRun<'a> {
    /// u[k], file units.
    pub fn input(&self, k: usize) -> &'a [f64] {
        self.row(self.whole.u, k, self.whole.model.dims.inputs)
    }

    /// y[k] in file units from u[k] in normalised ones.
    pub fn send(&mut self, k: usize, units: &Units, u: &[f64], y: &mut [f64]) {
        let (model, m) = (self.whole.model, self.whole.model.dims.channels);
        self.expected.fill(0.0);
        model.observe(k, &self.x, u, &mut self.expected);
        let rows = (self.row(self.whole.clean, k, m), self.row(self.whole.open, k, m));
        let gains = self.row(self.whole.gain, k, m);
        for (i, target) in y.iter_mut().enumerate() {
            let expected = units.offset[i] + units.scale[i] * self.expected[i];
            *target = rows.1[i];
            if gains[i] != 0.0 {
                *target += gains[i] * (rows.0[i] - expected);
            }
        }
    }

    /// Take note of x[k|k] and of u[k], normalised units.
    pub fn hear(&mut self, k: usize, x: &[f64], u: &[f64]) {
        self.whole.model.predict(k, x, u, &mut self.next);
        std::mem::swap(&mut self.x, &mut self.next);
    }

    fn row(&self, array: &'a [f64], k: usize, width: usize) -> &'a [f64] {
        let from = (self.run * self.whole.steps + k) * width;
        &array[from..from + width]
    }
}
