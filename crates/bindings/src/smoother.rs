//! The smoother of a record with missing channels.

use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use securestate_kernels::smoother::{Smoother, Sums};

use crate::arrays::{self, Array};
use crate::errors::to_python;

/// Smooth one segment: `model` is (A, C, Q, r, start), `drive` (N, n), `y` (N, m). Returns arrays by name: `states`
/// (N, n), sums of covariances `whole`, `first`, `last`, `crossed` (n, n) and `absent` (m, n, n), and `likelihood`.
#[pyfunction]
pub fn smooth<'py>(
    py: Python<'py>,
    model: (Array<'py>, Array<'py>, Array<'py>, Array<'py>, Array<'py>),
    drive: Array<'py>,
    y: Array<'py>,
) -> PyResult<Bound<'py, PyDict>> {
    let (a, c, q, r, start) = &model;
    let smoother = Smoother::new(
        arrays::slice("A", a)?,
        arrays::slice("C", c)?,
        arrays::slice("Q", q)?,
        arrays::slice("r", r)?,
        arrays::slice("start", start)?,
    )
    .map_err(to_python)?;
    let (drive, y) = (arrays::slice("drive", &drive)?, arrays::slice("y", &y)?);
    let mut states = vec![0.0; drive.len()];
    let sums = py.detach(|| smoother.smooth(drive, y, &mut states)).map_err(to_python)?;
    named(py, states, sums)
}

fn named(py: Python<'_>, states: Vec<f64>, sums: Sums) -> PyResult<Bound<'_, PyDict>> {
    let (n, m) = (sums.whole.rows(), sums.absent.len());
    let found = PyDict::new(py);
    let steps = states.len().checked_div(n).unwrap_or(0);
    found.set_item("states", PyArray1::from_vec(py, states).reshape([steps, n])?)?;
    for (name, matrix) in
        [("whole", &sums.whole), ("first", &sums.first), ("last", &sums.last), ("crossed", &sums.crossed)]
    {
        found.set_item(name, PyArray1::from_slice(py, matrix.numbers()).reshape([n, n])?)?;
    }
    let absent: Vec<f64> = sums.absent.iter().flat_map(|matrix| matrix.numbers()).copied().collect();
    found.set_item("absent", PyArray1::from_vec(py, absent).reshape([m, n, n])?)?;
    found.set_item("likelihood", sums.likelihood)?;
    Ok(found)
}
