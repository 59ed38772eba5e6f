//! Errors of the kernels as exceptions of `securestate.errors`.

use pyo3::prelude::*;
use securestate_kernels::Error;

/// The Python exception for a kernel error.
pub fn to_python(error: Error) -> PyErr {
    Python::attach(|py| match exception(py, error) {
        Ok(instance) => PyErr::from_value(instance),
        Err(failure) => failure,
    })
}

fn exception(py: Python<'_>, error: Error) -> PyResult<Bound<'_, PyAny>> {
    let errors = py.import("securestate.errors")?;
    match error {
        Error::Input { argument, expected, received } => {
            let class = match argument {
                "y" | "u" => "MeasurementError",
                _ => "InputError",
            };
            errors.getattr(class)?.call1((argument, expected, received))
        }
        Error::Resume(reason) => errors.getattr("ResumeError")?.call1((reason,)),
    }
}
