//! The kernel of the secure filter.

use pyo3::prelude::*;
use securestate_kernels::secure::Secure;
use securestate_kernels::secure::settings::{Part, Settings};
use securestate_kernels::{Design, Error, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Kernel of a secure filter. `plant` and `prior` are those of `kalman`. `onset` (N,) is the probability per sample that
/// an honest sensor begins to lie, `steady` the same for lies that stay about the same; `deviations` (m,) are those of
/// the noise of the channels; `without` names parts to leave out.
#[pyfunction]
#[pyo3(signature = (plant, prior, *, onset, steady, deviations, without))]
pub fn secure_filter(
    plant: &Bound<'_, PyAny>,
    prior: Option<Array<'_>>,
    onset: Array<'_>,
    steady: f64,
    deviations: Array<'_>,
    without: Vec<String>,
) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let onset = arrays::owned("onset", &onset)?;
    let deviations = arrays::owned("deviations", &deviations)?;
    let protected: Vec<bool> = plant.getattr("protected")?.extract()?;
    let without = without.iter().map(|name| part(name)).collect::<PyResult<Vec<_>>>()?;
    let design = || -> Result<_> {
        let settings = Settings::new((onset, steady), protected, &model.channel_sensor, deviations)?;
        let settings = Settings { without, ..settings };
        Design::boxed(Secure::new(model, prior, settings)?, units)
    };
    Ok(Kernel { inner: design().map_err(to_python)? })
}

fn part(given: &str) -> PyResult<Part> {
    let found = Part::NAMES.iter().find(|(name, _)| *name == given).map(|(_, part)| *part);
    let names = || Part::NAMES.map(|(name, _)| name).join(", ");
    found.ok_or_else(|| to_python(Error::input("without", names(), given.to_owned())))
}
