//! The kernel of the secure filter.

use pyo3::prelude::*;
use securestate_kernels::secure::Secure;
use securestate_kernels::secure::settings::Settings;
use securestate_kernels::{Design, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Kernel of a secure filter. `plant` and `prior` are those of `kalman`. `onset` (N,) is the probability per sample that
/// an honest sensor begins to lie, `steady` the same for lies that stay about the same; `deviations` (m,) are those of
/// the noise of the channels.
#[pyfunction]
#[pyo3(signature = (plant, prior, *, onset, steady, deviations))]
pub fn secure_filter(
    plant: &Bound<'_, PyAny>,
    prior: Option<Array<'_>>,
    onset: Array<'_>,
    steady: f64,
    deviations: Array<'_>,
) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let onset = arrays::owned("onset", &onset)?;
    let deviations = arrays::owned("deviations", &deviations)?;
    let protected: Vec<bool> = plant.getattr("protected")?.extract()?;
    let design = || -> Result<_> {
        let settings = Settings::new((onset, steady), protected, &model.channel_sensor, deviations)?;
        Design::boxed(Secure::new(model, prior, settings)?, units)
    };
    Ok(Kernel { inner: design().map_err(to_python)? })
}
