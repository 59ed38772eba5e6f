//! Filters with a state: one live filter, or one per run of a batch.

use std::sync::Arc;

use numpy::{
    AllowTypeChange, PyArray1, PyArrayDyn, PyArrayLike1, PyArrayMethods, PyReadonlyArray1,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use securestate_kernels::reaction::Reaction;
use securestate_kernels::{Block, Error, Record};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::estimate::Estimate;
use crate::kernel::Kernel;
use crate::plant;

/// Samples between two looks at the keyboard.
const BLOCK: usize = 1024;

/// A running filter. Base class of `securestate.Filter`.
#[pyclass(subclass, module = "securestate._kernels")]
pub struct Filter {
    kernel: Arc<dyn securestate_kernels::Kernel>,
    inner: Box<dyn securestate_kernels::Filter>,
    runs: usize,
}

#[pymethods]
impl Filter {
    /// From prior means (runs, n) with one covariance (n, n) or steady state, or from saved bytes.
    #[new]
    #[pyo3(signature = (kernel, means=None, covariance=None, blob=None))]
    fn new(
        kernel: &Kernel,
        means: Option<Array<'_>>,
        covariance: Option<Array<'_>>,
        blob: Option<&[u8]>,
    ) -> PyResult<Self> {
        let inner = &kernel.inner;
        let n = inner.dims().states;
        let (filter, runs) = match (means, blob) {
            (Some(means), None) => {
                let means = arrays::slice("prior.x", &means)?;
                let covariance = covariance.as_ref().map(|p| arrays::slice("prior.P", p)).transpose()?;
                (inner.start(means, covariance), means.len() / n)
            }
            (None, Some(blob)) => (inner.resume(blob), 1),
            _ => (Err(Error::input("prior", "either means or a blob", "both or neither")), 0),
        };
        Ok(Self { kernel: Arc::clone(inner), inner: filter.map_err(to_python)?, runs })
    }

    /// Advance by one measurement y (m,), NaN = missing, and input u (p,).
    #[pyo3(signature = (y, u=None))]
    fn step(&mut self, y: &Bound<'_, PyAny>, u: Option<&Bound<'_, PyAny>>) -> PyResult<Estimate> {
        let mut estimate = Estimate::new(self.kernel.dims(), self.kernel.diagnostics());
        with_slice("y", y, |y| match u {
            None => self.inner.step(y, &[], &mut estimate.output()).map_err(to_python),
            Some(u) => {
                with_slice("u", u, |u| self.inner.step(y, u, &mut estimate.output()).map_err(to_python))
            }
        })?;
        Ok(estimate)
    }

    /// Advance every run by a block: y (runs, steps, m), u (steps, p) or (runs, steps, p). Arrays by name.
    fn advance<'py>(
        &mut self,
        py: Python<'py>,
        y: Array<'_>,
        u: Array<'_>,
        steps: usize,
        covariance: bool,
    ) -> PyResult<Bound<'py, PyDict>> {
        let block = Block { y: arrays::slice("y", &y)?, u: arrays::slice("u", &u)?, steps };
        let (dims, names) = (self.kernel.dims(), self.kernel.diagnostics().len());
        let mut record = Record::new(dims, names, self.runs, steps, covariance);
        for from in (0..steps).step_by(BLOCK) {
            let to = steps.min(from + BLOCK);
            py.detach(|| self.inner.advance(block, from, to, &mut record)).map_err(to_python)?;
            py.check_signals()?;
        }
        arrays::record(py, record)
    }

    /// Every run against adversaries that answer in proportion to what the filter expects: y[k] = opened[k] +
    /// gain[k] (clean[k] − expected[k]). `clean`, `opened`, `gain` (runs, steps, m), `u` (runs, steps, p), `means`
    /// (runs, n), `plant` the `Plant`. Returns arrays by name, and y (runs, steps, m).
    #[allow(clippy::too_many_arguments)]
    fn react<'py>(
        &mut self,
        py: Python<'py>,
        clean: Array<'_>,
        opened: Array<'_>,
        gain: Array<'_>,
        u: Array<'_>,
        means: Array<'_>,
        plant: &Bound<'py, PyAny>,
        covariance: bool,
    ) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyArrayDyn<f64>>)> {
        let (dims, names) = (self.kernel.dims(), self.kernel.diagnostics().len());
        let steps = clean.shape().get(1).copied().unwrap_or(0);
        let model = plant::model(plant)?;
        let reaction = Reaction {
            model: &model,
            clean: arrays::slice("clean", &clean)?,
            open: arrays::slice("opened", &opened)?,
            gain: arrays::slice("gain", &gain)?,
            u: arrays::slice("u", &u)?,
            means: arrays::slice("means", &means)?,
            steps,
        };
        let mut y = vec![0.0; reaction.clean.len()];
        let mut record = Record::new(dims, names, self.runs, steps, covariance);
        py.detach(|| self.inner.react(&reaction, &mut y, &mut record)).map_err(to_python)?;
        let y = PyArray1::from_vec(py, y).reshape(clean.shape())?;
        Ok((arrays::record(py, record)?, y.to_dyn().clone()))
    }

    /// The state as bytes.
    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &self.inner.save().map_err(to_python)?))
    }
}

/// Call `body` with the numbers of a one-dimensional array or sequence, without a copy where possible.
fn with_slice<R>(
    name: &'static str,
    value: &Bound<'_, PyAny>,
    body: impl FnOnce(&[f64]) -> PyResult<R>,
) -> PyResult<R> {
    if let Ok(array) = value.extract::<PyReadonlyArray1<'_, f64>>() {
        if let Ok(numbers) = array.as_slice() {
            return body(numbers);
        }
        return body(&array.as_array().to_vec());
    }
    match value.extract::<PyArrayLike1<'_, f64, AllowTypeChange>>() {
        Ok(array) => body(&array.as_array().to_vec()),
        Err(_) => Err(to_python(Error::input(
            name,
            "one-dimensional numbers",
            value.repr().map_or_else(|_| "something else".into(), |text| text.to_string()),
        ))),
    }
}
