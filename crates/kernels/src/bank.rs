//! The generic drivers: one live filter, many runs in parallel, save and resume.

use std::sync::Arc;

use rayon::prelude::*;

use crate::codec::{Decoder, Encoder, Fingerprint};
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
    /// The operating point.
    pub units: Units,
}

/// One filter state per run.
struct Bank<E: Estimator> {
    design: Arc<Design<E>>,
    runs: Vec<Run<E::State>>,
}

#[derive(Clone)]
struct Run<S> {
    state: S,
    y: Vec<f64>,
    u: Vec<f64>,
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
        Ok(Arc::new(Handle(Arc::new(Self { estimator, units }))))
    }

    fn fingerprint(&self) -> u64 {
        Fingerprint::default()
            .bytes(&self.estimator.fingerprint().to_le_bytes())
            .floats(&self.units.offset)
            .floats(&self.units.scale)
            .floats(&self.units.input_offset)
            .floats(&self.units.input_scale)
            .finish()
    }

    fn run(&self, state: E::State) -> Run<E::State> {
        let dims = self.estimator.dims();
        Run { state, y: vec![0.0; dims.channels], u: vec![0.0; dims.inputs] }
    }

    fn step(
        &self,
        run: &mut Run<E::State>,
        y: &[f64],
        u: &[f64],
        plan: Option<(&E::Plan, usize)>,
        out: &mut Output<'_>,
    ) -> Result<()> {
        self.units.normalise_measurement(y, &mut run.y)?;
        self.units.normalise_input(u, &mut run.u)?;
        match plan {
            Some((plan, k)) => {
                self.estimator.step_planned(plan, k, &mut run.state, &run.y, &run.u, out)?;
            }
            None => self.estimator.step(&mut run.state, &run.y, &run.u, out)?,
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
        let runs = means
            .chunks(n)
            .map(|mean| Ok(self.0.run(self.0.estimator.start(mean, covariance)?)))
            .collect::<Result<Vec<_>>>()?;
        Ok(Box::new(Bank { design: Arc::clone(&self.0), runs }))
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
        let run = self.0.run(self.0.estimator.load(&mut from)?);
        from.finish()?;
        Ok(Box::new(Bank { design: Arc::clone(&self.0), runs: vec![run] }))
    }
}

impl<E: Estimator + 'static> Filter for Bank<E> {
    fn step(&mut self, y: &[f64], u: &[f64], out: &mut Output<'_>) -> Result<()> {
        let dims = self.design.estimator.dims();
        Error::check_len("y", dims.channels, y.len())?;
        Error::check_len("u", dims.inputs, u.len())?;
        match self.runs.as_mut_slice() {
            [run] => self.design.step(run, y, u, None, out),
            runs => Err(Error::input("filter", "a single run", format!("{} runs", runs.len()))),
        }
    }

    fn advance(&mut self, block: Block<'_>, from: usize, to: usize, record: &mut Record) -> Result<()> {
        let dims = self.design.estimator.dims();
        let (runs, steps) = (self.runs.len(), block.steps);
        Error::check_len("y", runs * steps * dims.channels, block.y.len())?;
        let shared = block.u.len() == steps * dims.inputs;
        if !shared {
            Error::check_len("u", runs * steps * dims.inputs, block.u.len())?;
        }
        let plan = self.plan(&block, from, to);
        let (design, plan) = (&self.design, plan.as_ref());
        let rows = record.split();
        self.runs.par_iter_mut().zip(rows).enumerate().try_for_each(|(r, (run, row))| {
            let y = chunk(block.y, r, steps * dims.channels);
            let u = chunk(block.u, if shared { 0 } else { r }, steps * dims.inputs);
            advance_run(design, run, (y, u), (from, to), plan, row).map_err(|error| place(error, r, runs))
        })
    }

    fn save(&self) -> Result<Vec<u8>> {
        let [run] = self.runs.as_slice() else {
            return Err(Error::input("filter", "a single run", "several runs"));
        };
        let mut to = Encoder::default();
        to.integer(MAGIC);
        to.integer(self.design.fingerprint());
        self.design.estimator.save(&run.state, &mut to);
        Ok(to.finish())
    }
}

impl<E: Estimator> Bank<E> {
    /// Shared work for samples `from..to`; only worth it for more than one run.
    fn plan(&self, block: &Block<'_>, from: usize, to: usize) -> Option<E::Plan> {
        if self.runs.len() < 2 {
            return None;
        }
        let m = self.design.estimator.dims().channels;
        let mut y = Vec::with_capacity(self.runs.len() * (to - from) * m);
        for r in 0..self.runs.len() {
            let rows = chunk(block.y, r, block.steps * m);
            y.extend_from_slice(&rows[from * m..to * m]);
        }
        let states: Vec<&E::State> = self.runs.iter().map(|run| &run.state).collect();
        self.design.estimator.plan(&states, &y, to - from)
    }
}

fn advance_run<E: Estimator + 'static>(
    design: &Design<E>,
    run: &mut Run<E::State>,
    (y, u): (&[f64], &[f64]),
    (from, to): (usize, usize),
    plan: Option<&E::Plan>,
    mut row: RunRecord<'_>,
) -> Result<()> {
    let dims = design.estimator.dims();
    for k in from..to {
        let (yk, uk) = (chunk(y, k, dims.channels), chunk(u, k, dims.inputs));
        design
            .step(run, yk, uk, plan.map(|plan| (plan, k - from)), &mut row.at(k))
            .map_err(|error| at_sample(error, k))?;
    }
    if let Some(plan) = plan {
        design.estimator.leave_plan(plan, &mut run.state);
    }
    Ok(())
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
