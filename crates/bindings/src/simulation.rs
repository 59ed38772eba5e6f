//! The loop over time of a simulation.

use numpy::{PyReadwriteArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use securestate_kernels::Error;
use securestate_kernels::simulation::{Batch, Simulation};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::plant;

/// Turn standard normal numbers into trajectories of a `Plant`, in place. `q` (n, n) and `r` (m, m) are square roots of
/// Q and R; `feedback` −L (p, n) or None. `x` (runs, T, n) holds x[0], w[0], w[1], …, `u` (runs, T, p) the input without
/// feedback, `y` (runs, T, m) v; `noise` (runs, T, m) receives what y holds of the noise.
#[pyfunction]
#[pyo3(signature = (plant, q, r, feedback, x, u, y, noise))]
#[allow(clippy::too_many_arguments)]
pub fn simulate(
    py: Python<'_>,
    plant: &Bound<'_, PyAny>,
    q: Array<'_>,
    r: Array<'_>,
    feedback: Option<Array<'_>>,
    mut x: PyReadwriteArrayDyn<'_, f64>,
    mut u: PyReadwriteArrayDyn<'_, f64>,
    mut y: PyReadwriteArrayDyn<'_, f64>,
    mut noise: PyReadwriteArrayDyn<'_, f64>,
) -> PyResult<()> {
    let feedback = feedback.as_ref().map(|l| arrays::owned("feedback", l)).transpose()?.unwrap_or_default();
    let roots = (arrays::owned("Q", &q)?, arrays::owned("R", &r)?);
    let simulation = Simulation::new(plant::model(plant)?, roots.0, roots.1, feedback).map_err(to_python)?;
    let batch = Batch {
        steps: x.shape().get(1).copied().unwrap_or(0),
        x: mutable("x", &mut x)?,
        u: mutable("u", &mut u)?,
        y: mutable("y", &mut y)?,
        noise: mutable("noise", &mut noise)?,
    };
    py.detach(|| simulation.run(batch)).map_err(to_python)
}

/// The numbers of a contiguous array that may be written to.
fn mutable<'a>(name: &'static str, array: &'a mut PyReadwriteArrayDyn<'_, f64>) -> PyResult<&'a mut [f64]> {
    array
        .as_slice_mut()
        .map_err(|_| to_python(Error::input(name, "a C-contiguous float64 array", "another layout")))
}
