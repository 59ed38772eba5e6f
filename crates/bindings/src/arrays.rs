//! Numpy arrays as slices and back.

use numpy::{Element, PyArray1, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use securestate_kernels::Record;

use crate::errors::to_python;

/// A contiguous array of any shape, borrowed from Python.
pub type Array<'py> = PyReadonlyArrayDyn<'py, f64>;

/// The numbers of a contiguous array.
pub fn slice<'a>(name: &'static str, array: &'a Array<'_>) -> PyResult<&'a [f64]> {
    array.as_slice().map_err(|_| {
        to_python(securestate_kernels::Error::input(
            name,
            "a C-contiguous float64 array",
            format!("strides {:?}", array.strides()),
        ))
    })
}

/// A copy of the numbers of a contiguous array.
pub fn owned(name: &'static str, array: &Array<'_>) -> PyResult<Vec<f64>> {
    Ok(slice(name, array)?.to_vec())
}

/// The arrays of a record by name, shape (runs, steps, …); read-only where all runs share one copy.
pub fn record(py: Python<'_>, record: Record) -> PyResult<Bound<'_, PyDict>> {
    let (runs, steps) = (record.runs, record.steps);
    let (n, m, sensors) = (record.dims.states, record.dims.channels, record.dims.sensors);
    let names = record.diagnostics.len().checked_div(runs * steps);
    let arrays = PyDict::new(py);
    let has_covariance = !record.covariance.is_empty();
    put(&arrays, "x", record.x, &[runs, steps, n])?;
    put(&arrays, "x_std", record.x_std, &[runs, steps, n])?;
    if has_covariance {
        put(&arrays, "P", record.covariance, &[runs, steps, n, n])?;
    }
    put(&arrays, "trust", record.trust, &[runs, steps, sensors])?;
    put(&arrays, "attack", record.attack, &[runs, steps, m])?;
    put(&arrays, "attack_std", record.attack_std, &[runs, steps, m])?;
    put(&arrays, "suspected", record.suspected, &[runs, steps, sensors])?;
    put(&arrays, "innovation", record.innovation, &[runs, steps, m])?;
    put(&arrays, "innovation_std", record.innovation_std, &[runs, steps, m])?;
    let shape = [runs, steps, names.unwrap_or(0)];
    put(&arrays, "diagnostics", record.diagnostics, &shape)?;
    put(&arrays, "status", record.status, &[runs, steps])?;
    Ok(arrays)
}

fn put<T: Element>(arrays: &Bound<'_, PyDict>, name: &str, data: Vec<T>, shape: &[usize]) -> PyResult<()> {
    let (py, whole) = (arrays.py(), shape.iter().product::<usize>());
    if data.len() == whole {
        return arrays.set_item(name, PyArray1::from_vec(py, data).reshape(shape)?);
    }
    let one = PyArray1::from_vec(py, data).reshape(&shape[1..])?;
    arrays.set_item(name, py.import("numpy")?.call_method1("broadcast_to", (one, shape.to_vec()))?)
}
