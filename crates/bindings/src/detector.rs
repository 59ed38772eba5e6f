//! The kernel of the Kalman filter with a rule that leaves out sensors.

use pyo3::prelude::*;
use securestate_kernels::detectors::local::LocalFilter;
use securestate_kernels::detectors::{Detector, Rule};
use securestate_kernels::kalman::Kalman;
use securestate_kernels::{Design, Error, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// T, A, B, C, D, K and S of a filter that hears one sensor.
pub type Local<'py> = (Array<'py>, Array<'py>, Array<'py>, Array<'py>, Array<'py>, Array<'py>, Array<'py>);

/// Kernel of a detector. `plant` and `prior` are those of `kalman`; `rule` is "gate", "drop" or "hold" (per sensor,
/// with one filter each in `local`), "predict" or "drop-worst" (central); `quantiles` (m + 1,) bound the squared
/// distance per number of channels.
#[pyfunction]
#[pyo3(signature = (plant, prior, *, rule, quantiles, local))]
pub fn detector(
    plant: &Bound<'_, PyAny>,
    prior: Option<Array<'_>>,
    rule: &str,
    quantiles: Array<'_>,
    local: Vec<Local<'_>>,
) -> PyResult<Kernel> {
    let estimator = build(plant, &(prior, rule.to_owned(), quantiles, local))?;
    Ok(Kernel { inner: Design::boxed(estimator, plant::units(plant)?).map_err(to_python)? })
}

/// Prior, rule, quantiles and local filters of a detector.
pub type Arguments<'py> = (Option<Array<'py>>, String, Array<'py>, Vec<Local<'py>>);

/// The detector itself.
pub fn build(
    plant: &Bound<'_, PyAny>,
    (prior, rule, quantiles, local): &Arguments<'_>,
) -> PyResult<Detector> {
    let model = plant::model(plant)?;
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let quantiles = arrays::owned("quantiles", quantiles)?;
    let filters = local.iter().map(local_filter).collect::<PyResult<Vec<_>>>()?;
    let design =
        || -> Result<_> { Detector::new(Kalman::new(model, prior)?, named(rule, filters)?, quantiles) };
    design().map_err(to_python)
}

fn named(rule: &str, filters: Vec<LocalFilter>) -> Result<Rule> {
    match rule {
        "gate" => Ok(Rule::Gate),
        "drop" => Ok(Rule::Local { filters, hold: false }),
        "hold" => Ok(Rule::Local { filters, hold: true }),
        "predict" => Ok(Rule::Central { drop_worst: false }),
        "drop-worst" => Ok(Rule::Central { drop_worst: true }),
        other => Err(Error::input("rule", "gate, drop, hold, predict or drop-worst", other)),
    }
}

fn local_filter((t, a, b, c, d, gain, innovation_cov): &Local<'_>) -> PyResult<LocalFilter> {
    Ok(LocalFilter {
        t: arrays::owned("T", t)?,
        a: arrays::owned("A", a)?,
        b: arrays::owned("B", b)?,
        c: arrays::owned("C", c)?,
        d: arrays::owned("D", d)?,
        gain: arrays::owned("gain", gain)?,
        innovation_cov: arrays::owned("innovation_cov", innovation_cov)?,
    })
}
