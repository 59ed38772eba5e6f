//! The kernel of the Kalman filter whose noise adapts to lies.

use pyo3::prelude::*;
use securestate_kernels::adaptive_joint::{AdaptiveJoint, Settings};
use securestate_kernels::kalman::Kalman;
use securestate_kernels::{Design, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Kernel of an adaptive filter. `plant` and `prior` are those of `kalman`; `window` samples and `gate` decide how
/// far the noise of a sensor that is not protected grows; `quantiles` (m + 1,) bound the squared distance of an
/// honest sensor per number of channels.
#[pyfunction]
#[pyo3(signature = (plant, prior, *, window, gate, quantiles))]
pub fn adaptive_joint(
    plant: &Bound<'_, PyAny>,
    prior: Option<Array<'_>>,
    window: usize,
    gate: f64,
    quantiles: Array<'_>,
) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let quantiles = arrays::owned("quantiles", &quantiles)?;
    let settings = Settings { protected: plant.getattr("protected")?.extract()?, window, gate, quantiles };
    let design =
        || -> Result<_> { Design::boxed(AdaptiveJoint::new(Kalman::new(model, prior)?, settings)?, units) };
    Ok(Kernel { inner: design().map_err(to_python)? })
}
