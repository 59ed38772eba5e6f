//! The generic drivers: one live filter, many runs in parallel, save and resume.

use std::sync::Arc;

use rayon::prelude::*;

use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::estimator::PlannedRun;
use crate::lanes::LANES;
use crate::reaction::{OneRun, Reaction};
use crate::record::RunRecord;
use crate::{Dims, Error, Estimator, Output, Record, Result, Units};

/// Marks a saved filter state and its layout.
const MAGIC: u64 = u64::from_le_bytes(*b"sstate01");

/// Measurements and inputs of a block of samples, in file units.
#[derive(Debug, Clone, Copy)]
pub struct Block<'a> {
    /// (runs, steps, m)
    pub y: &'a [f64],
    /// (runs, steps, p), or (steps, p) shared by all runs.
    pub u: &'a [f64],
    /// Samples per run in `y` and `u`.
    pub steps: usize,
}

/// An estimator without its type: what bindings hold.
pub trait Kernel: Send + Sync {
    /// Sizes.
    fn dims(&self) -> Dims;
    /// Names of the diagnostics.
    fn diagnostics(&self) -> &'static [&'static str];
    /// Filters for `means.len() / n` runs.
    ///
    /// # Errors
    /// If the prior does not fit.
    fn start(&self, means: &[f64], covariance: Option<&[f64]>) -> Result<Box<dyn Filter>>;
    /// A filter from the bytes of [`Filter::save`].
    ///
    /// # Errors
    /// [`Error::Resume`] if the bytes are damaged or belong to another estimator.
    fn resume(&self, blob: &[u8]) -> Result<Box<dyn Filter>>;
}

/// Running filters without their type.
pub trait Filter: Send + Sync {
    /// One sample of a single filter.
    ///
    /// # Errors
    /// A wrong length, an infinite number, a step beyond the horizon.
    fn step(&mut self, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()>;
    /// Samples `from..to` of a block for every run, written to the same samples of `record`.
    ///
    /// # Errors
    /// As [`Filter::step`].
    fn advance(&mut self, block: Block<'_>, from: usize, to: usize, record: &mut Record) -> Result<()>;
    /// Every run against adversaries that react to it; what arrives is written to `y` (runs, steps, m).
    ///
    /// # Errors
    /// As [`Filter::step`].
    fn react(&mut self, reaction: &Reaction<'_>, y: &mut [f64], record: &mut Record) -> Result<()>;
    /// The state of a single filter as bytes.
    ///
    /// # Errors
    /// If there is more than one run.
    fn save(&self) -> Result<Vec<u8>>;
}

/// An estimator with the operating point of its plant.
pub struct Design<E> {
    /// The algorithm.
    pub estimator: E,
    /// The operating point, and the sensors that cannot be checked.
    pub units: Units,
}

/// One filter state per run.
struct Bank<E: Estimator> {
    design: Arc<Design<E>>,
    states: Vec<E::State>,
    scratch: Scratch,
}

/// A sample in normalised units.
struct Scratch {
    y: Vec<f64>,
    u: Vec<f64>,
}

impl Scratch {
    fn new(dims: Dims) -> Self {
        Self { y: vec![0.0; dims.channels], u: vec![0.0; dims.inputs] }
    }
}

impl<E: Estimator + 'static> Design<E> {
    /// Check that the operating point fits and hide the type.
    ///
    /// # Errors
    /// A wrong length.
    pub fn boxed(estimator: E, units: Units) -> Result<Arc<dyn Kernel>> {
        let dims = estimator.dims();
        Error::check_len("offset", dims.channels, units.offset.len())?;
        Error::check_len("scale", dims.channels, units.scale.len())?;
        Error::check_len("input_offset", dims.inputs, units.input_offset.len())?;
        Error::check_len("input_scale", dims.inputs, units.input_scale.len())?;
        if let Some(sensor) = units.uncheckable.iter().find(|&&sensor| sensor >= dims.sensors) {
            let expected = format!("sensors in 0..{}", dims.sensors);
            return Err(Error::input("uncheckable", expected, sensor.to_string()));
        }
        Ok(Arc::new(Handle(Arc::new(Self { estimator, units }))))
    }

    /// Of what decides the state: sensors that cannot be checked may be marked later.
    fn fingerprint(&self) -> u64 {
        Fingerprint::default()
            .bytes(&self.estimator.fingerprint().to_le_bytes())
            .floats(&self.units.offset)
            .floats(&self.units.scale)
            .floats(&self.units.input_offset)
            .floats(&self.units.input_scale)
            .finish()
    }

    fn bank(self: &Arc<Self>, states: Vec<E::State>) -> Box<dyn Filter> {
        let scratch = Scratch::new(self.estimator.dims());
        Box::new(Bank { design: Arc::clone(self), states, scratch })
    }

    /// Samples `from..to` of every run, each by itself.
    fn advance(
        &self,
        runs: &mut [PlannedRun<'_, E::State>],
        from: usize,
        plan: Option<&E::Plan>,
    ) -> Result<()> {
        let count = runs.len();
        (runs.par_iter_mut().enumerate())
            .try_for_each(|(r, run)| self.finish(run, from, plan).map_err(|error| place(error, r, count)))
    }

    /// The same for runs that share a plan; the first reports for all what the data do not change.
    fn advance_planned(
        &self,
        runs: &mut [PlannedRun<'_, E::State>],
        from: usize,
        plan: &E::Plan,
    ) -> Result<()> {
        let count = runs.len();
        let Some((lead, others)) = runs.split_first_mut() else { return Ok(()) };
        self.finish(lead, from, Some(plan)).map_err(|error| place(error, 0, count))?;
        others.par_chunks_mut(LANES).enumerate().try_for_each(|(i, runs)| {
            if self.estimator.run_planned(plan, &self.units, runs) {
                return Ok(());
            }
            let refuse = |(lane, run)| {
                self.check(run, from).map_err(|error| place(error, 1 + i * LANES + lane, count))
            };
            runs.iter().enumerate().try_for_each(refuse)
        })
    }

    /// Whether all numbers of a run are acceptable.
    fn check(&self, run: &PlannedRun<'_, E::State>, from: usize) -> Result<()> {
        let dims = self.estimator.dims();
        let mut scratch = Scratch::new(dims);
        (0..run.y.len() / dims.channels).try_for_each(|i| {
            let (y, u) = (chunk(run.y, i, dims.channels), chunk(run.u, i, dims.inputs));
            self.normalise(y, u, &mut scratch).map_err(|error| at_sample(error, from + i))
        })
    }

    fn normalise(&self, y: &[f64], u: &[f64], scratch: &mut Scratch) -> Result<()> {
        self.units.normalise_measurement(y, &mut scratch.y)?;
        self.units.normalise_input(u, &mut scratch.u)
    }

    /// All samples of one run, the first of which is sample `from`.
    fn finish(&self, run: &mut PlannedRun<'_, E::State>, from: usize, plan: Option<&E::Plan>) -> Result<()> {
        let Dims { channels: m, inputs: p, .. } = self.estimator.dims();
        let mut scratch = Scratch::new(self.estimator.dims());
        for i in 0..run.y.len() / m {
            let sample = (chunk(run.y, i, m), chunk(run.u, i, p));
            self.step(run.state, &mut scratch, sample, plan.map(|plan| (plan, i)), &mut run.record.at(i))
                .map_err(|error| at_sample(error, from + i))?;
        }
        if let Some(plan) = plan {
            self.estimator.leave_plan(plan, run.state);
        }
        Ok(())
    }

    /// One run against adversaries that react to it.
    fn react(
        &self,
        state: &mut E::State,
        mut adversary: OneRun<'_>,
        y: &mut [f64],
        mut record: RunRecord<'_>,
    ) -> Result<()> {
        let m = self.estimator.dims().channels;
        let (mut scratch, mut u) =
            (Scratch::new(self.estimator.dims()), vec![0.0; self.estimator.dims().inputs]);
        for (k, y) in y.chunks_exact_mut(m).enumerate() {
            let (given, mut out) = (adversary.input(k), record.at(k));
            self.units.normalise_input(given, &mut u).map_err(|error| at_sample(error, k))?;
            adversary.send(k, &self.units, &u, y);
            self.step(state, &mut scratch, (y, given), None, &mut out)
                .map_err(|error| at_sample(error, k))?;
            adversary.hear(k, out.x, &u);
        }
        Ok(())
    }

    fn step(
        &self,
        state: &mut E::State,
        scratch: &mut Scratch,
        (y, u): (&[f64], &[f64]),
        plan: Option<(&E::Plan, usize)>,
        out: &mut Output<'_>,
    ) -> Result<()> {
        self.normalise(y, u, scratch)?;
        match plan {
            Some((plan, k)) => {
                self.estimator.step_planned(plan, k, state, &scratch.y, &scratch.u, out)?;
            }
            None => self.estimator.step(state, &scratch.y, &scratch.u, out)?,
        }
        self.units.restore(out);
        Ok(())
    }
}

struct Handle<E: Estimator>(Arc<Design<E>>);

impl<E: Estimator + 'static> Kernel for Handle<E> {
    fn dims(&self) -> Dims {
        self.0.estimator.dims()
    }

    fn diagnostics(&self) -> &'static [&'static str] {
        self.0.estimator.diagnostics()
    }

    fn start(&self, means: &[f64], covariance: Option<&[f64]>) -> Result<Box<dyn Filter>> {
        let n = self.dims().states;
        let states = means.chunks(n).map(|mean| self.0.estimator.start(mean, covariance));
        Ok(self.0.bank(states.collect::<Result<Vec<_>>>()?))
    }

    fn resume(&self, blob: &[u8]) -> Result<Box<dyn Filter>> {
        let mut from = Decoder::new(blob)?;
        if from.integer()? != MAGIC {
            return Err(Error::Resume("these bytes are not a filter state".into()));
        }
        if from.integer()? != self.0.fingerprint() {
            return Err(Error::Resume(
                "this filter state was saved by another estimator or another plant".into(),
            ));
        }
        let state = self.0.estimator.load(&mut from)?;
        from.finish()?;
        Ok(self.0.bank(vec![state]))
    }
}

impl<E: Estimator + 'static> Filter for Bank<E> {
    fn step(&mut self, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let dims = self.design.estimator.dims();
        Error::check_len("y", dims.channels, y.len())?;
        Error::check_len("u", dims.inputs, u.len())?;
        match self.states.as_mut_slice() {
            [state] => self.design.step(state, &mut self.scratch, (y, u), None, out),
            runs => Err(Error::input("filter", "a single run", format!("{} runs", runs.len()))),
        }
    }

    fn advance(&mut self, block: Block<'_>, from: usize, to: usize, record: &mut Record) -> Result<()> {
        let dims = self.design.estimator.dims();
        let (runs, steps) = (self.states.len(), block.steps);
        Error::check_len("y", runs * steps * dims.channels, block.y.len())?;
        let shared = block.u.len() == steps * dims.inputs;
        if !shared {
            Error::check_len("u", runs * steps * dims.inputs, block.u.len())?;
        }
        let width = if shared { 0 } else { steps * dims.inputs };
        let y = |r: usize| &block.y[r * steps * dims.channels..][from * dims.channels..to * dims.channels];
        let u = |r: usize| &block.u[r * width..][from * dims.inputs..to * dims.inputs];
        let plan = self.plan(&(0..runs).map(y).collect::<Vec<_>>(), to - from);
        if plan.is_none() || !self.design.estimator.shares_results() {
            record.unshare();
        }
        let alone = record.copies == runs;
        let mut jobs: Vec<PlannedRun<'_, E::State>> = (self.states.iter_mut())
            .zip(record.split_between(from, to))
            .enumerate()
            .map(|(r, (state, record))| PlannedRun { state, y: y(r), u: u(r), record })
            .collect();
        match &plan {
            Some(plan) if !alone => self.design.advance_planned(&mut jobs, from, plan),
            plan => self.design.advance(&mut jobs, from, plan.as_ref()),
        }
    }

    fn react(&mut self, reaction: &Reaction<'_>, y: &mut [f64], record: &mut Record) -> Result<()> {
        let (runs, width) = (self.states.len(), reaction.steps * self.design.estimator.dims().channels);
        reaction.check(runs)?;
        Error::check_len("y", runs * width, y.len())?;
        record.unshare();
        let jobs: Vec<_> = (self.states.iter_mut()).zip(y.chunks_mut(width)).zip(record.split()).collect();
        jobs.into_par_iter().enumerate().try_for_each(|(r, ((state, y), record))| {
            self.design.react(state, reaction.of(r), y, record).map_err(|error| place(error, r, runs))
        })
    }

    fn save(&self) -> Result<Vec<u8>> {
        let [state] = self.states.as_slice() else {
            return Err(Error::input("filter", "a single run", "several runs"));
        };
        let mut to = Encoder::default();
        to.integer(MAGIC);
        to.integer(self.design.fingerprint());
        self.design.estimator.save(state, &mut to);
        Ok(to.finish())
    }
}

impl<E: Estimator> Bank<E> {
    /// Work that the runs share over the next samples; only worth it for more than one run.
    fn plan(&self, y: &[&[f64]], steps: usize) -> Option<E::Plan> {
        if y.len() < 2 {
            return None;
        }
        let states: Vec<&E::State> = self.states.iter().collect();
        self.design.estimator.plan(&states, y, steps)
    }
}

fn chunk(data: &[f64], index: usize, width: usize) -> &[f64] {
    &data[index * width..(index + 1) * width]
}

fn at_sample(error: Error, k: usize) -> Error {
    match error {
        Error::Input { argument, expected, received } => {
            Error::input(argument, expected, format!("{received} at sample {k}"))
        }
        other => other,
    }
}

fn place(error: Error, r: usize, runs: usize) -> Error {
    match error {
        Error::Input { argument, expected, received } if runs > 1 => {
            Error::input(argument, expected, format!("{received} of run {r}"))
        }
        other => other,
    }
}
