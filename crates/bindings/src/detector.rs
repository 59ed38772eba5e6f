//! The kernel of the Kalman filter with a rule that leaves out sensors.

use numpy::PyUntypedArrayMethods;
use pyo3::prelude::*;
use securestate_kernels::detectors::local::LocalFilter;
use securestate_kernels::detectors::{Detector, Rule};
use securestate_kernels::kalman::Kalman;
use securestate_kernels::kalman::model::{Matrices, Model};
use securestate_kernels::{Design, Error, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;

/// T, A, B, C, D, K and S of a filter that hears one sensor.
type Local<'py> = (Array<'py>, Array<'py>, Array<'py>, Array<'py>, Array<'py>, Array<'py>, Array<'py>);

/// Kernel of a detector. The first arguments are those of `kalman`; `rule` is "gate", "drop" or "hold" (per sensor,
/// with one filter each in `local`), "predict" or "drop-worst" (central); `quantiles` (m + 1,) bound the squared
/// distance per number of channels.
#[pyfunction]
#[pyo3(signature = (a, b, c, d, q, r, channel_sensor, n_sensors, prior, offset, scale, input_offset, input_scale, *, rule, quantiles, local))]
#[allow(clippy::too_many_arguments)]
pub fn detector(
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
    rule: &str,
    quantiles: Array<'_>,
    local: Vec<Local<'_>>,
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
    let quantiles = arrays::owned("quantiles", &quantiles)?;
    let filters = local.iter().map(local_filter).collect::<PyResult<Vec<_>>>()?;
    let design = || -> Result<_> {
        let filter = Kalman::new(Model::new(matrices)?, prior)?;
        Design::boxed(Detector::new(filter, named(rule, filters)?, quantiles)?, units)
    };
    Ok(Kernel { inner: design().map_err(to_python)? })
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
