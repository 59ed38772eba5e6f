//! The kernel of the Kalman filter whose state holds the injections.

use pyo3::prelude::*;
use securestate_kernels::augmented::Augmented;
use securestate_kernels::augmented::drift::Forgetting;
use securestate_kernels::augmented::report::Report;
use securestate_kernels::kalman::Kalman;
use securestate_kernels::{Design, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Kernel on an augmented `plant`, whose first `states` states are reported. `prior` is that of `kalman`; `weak` names
/// the channel of each injection (w,), `start` its variance before the first sample; `quantiles` (m + 1,) bound the
/// squared distance per number of channels. `forgetting` is None, or the factor and the variances (w,) of the drift.
#[pyfunction]
#[pyo3(signature = (plant, prior, *, states, weak, start, quantiles, forgetting))]
pub fn augmented(
    plant: &Bound<'_, PyAny>,
    prior: Option<Array<'_>>,
    states: usize,
    weak: Vec<usize>,
    start: Array<'_>,
    quantiles: Array<'_>,
    forgetting: Option<(f64, Array<'_>)>,
) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let start = arrays::owned("attack_start", &start)?;
    let report = Report { states, weak, quantiles: arrays::owned("quantiles", &quantiles)? };
    let forgetting = forgetting.as_ref().map(known).transpose()?;
    let design = || -> Result<_> {
        let filter = Kalman::new(model, prior)?;
        Design::boxed(Augmented::new(filter, report, start, forgetting)?, units)
    };
    Ok(Kernel { inner: design().map_err(to_python)? })
}

fn known((factor, start): &(f64, Array<'_>)) -> PyResult<Forgetting> {
    Ok(Forgetting { factor: *factor, start: arrays::owned("drift_start", start)? })
}
