//! The kernel of the Kalman filter.

use pyo3::prelude::*;
use securestate_kernels::Design;
use securestate_kernels::kalman::Kalman;

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Kernel of a Kalman filter for a `Plant`. `prior` (n, n) or None: P[k|k−1] of the steady state.
#[pyfunction]
#[pyo3(signature = (plant, prior))]
pub fn kalman(plant: &Bound<'_, PyAny>, prior: Option<Array<'_>>) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let filter = Kalman::new(model, prior).map_err(to_python)?;
    Ok(Kernel { inner: Design::boxed(filter, units).map_err(to_python)? })
}
