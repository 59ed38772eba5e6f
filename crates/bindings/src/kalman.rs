//! The kernel of the Kalman filter.

use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use securestate_kernels::kalman::Kalman;
use securestate_kernels::kalman::model::{Matrices, Model};
use securestate_kernels::{Design, Error, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;

/// Kernel of a Kalman filter. `a` (n, n) or (T, n, n), `b` (n, p), `c` (m, n) or (T, m, n), `d` (m, p), `q` (n, n),
/// `r` (m, m), `channel_sensor` (m,), `prior` (n, n) or None: P[k|k−1] of the steady state.
#[pyfunction]
#[pyo3(signature = (a, b, c, d, q, r, channel_sensor, n_sensors, prior, offset, scale, input_offset, input_scale))]
#[allow(clippy::too_many_arguments)]
pub fn kalman(
    a: Array<'_>,
    b: Array<'_>,
    c: Array<'_>,
    d: Array<'_>,
    q: Array<'_>,
    r: Array<'_>,
    channel_sensor: Vec<usize>,
    n_sensors: usize,
    prior: Option<Array<'_>>,
    offset: Array<'_>,
    scale: Array<'_>,
    input_offset: Array<'_>,
    input_scale: Array<'_>,
) -> PyResult<Kernel> {
    let matrices = Matrices {
        states: q.shape().first().copied().unwrap_or(0),
        a: arrays::owned("A", &a)?,
        b: arrays::owned("B", &b)?,
        c: arrays::owned("C", &c)?,
        d: arrays::owned("D", &d)?,
        q: arrays::owned("Q", &q)?,
        r: arrays::owned("R", &r)?,
        channel_sensor,
        sensors: n_sensors,
    };
    let units = arrays::units(&offset, &scale, &input_offset, &input_scale)?;
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let design = || -> Result<_> {
        let filter = Kalman::new(Model::new(matrices)?, prior)?;
        Design::boxed(filter, units)
    };
    Ok(Kernel { inner: design().map_err(|error: Error| to_python(error))? })
}
