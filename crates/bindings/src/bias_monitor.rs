//! The kernel of the bias monitor, and its statistic alone, for its calibration.

use numpy::PyArray1;
use pyo3::prelude::*;
use securestate_kernels::Error;
use securestate_kernels::bias_monitor::scan::Rule;
use securestate_kernels::bias_monitor::verdict::{Law, Lead};
use securestate_kernels::bias_monitor::{BiasMonitor, Design};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// K (n, m), S (m, m) and P[k|k] (n, n) of the steady filter.
type Filter<'py> = (Array<'py>, Array<'py>, Array<'py>);
/// Window, kappa and gamma.
type Statistic = (usize, f64, f64);
/// Limit, margin, samples in a row, what the limit rises by for a further sensor, and the drop threshold.
type Decision = (f64, f64, usize, f64, f64);

/// Kernel of a bias monitor for a `Plant`.
#[pyfunction]
#[pyo3(signature = (plant, filter, *, statistic, decision))]
pub fn bias_monitor(
    plant: &Bound<'_, PyAny>,
    filter: Filter<'_>,
    statistic: Statistic,
    decision: Decision,
) -> PyResult<Kernel> {
    let estimator = build(plant, &filter, statistic, decision)?;
    let inner = securestate_kernels::Design::boxed(estimator, plant::units(plant)?).map_err(to_python)?;
    Ok(Kernel { inner })
}

/// Leader, its ratio and how far it is ahead at every sample.
type Leads<'py> = (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// The leading sensor at every sample of whitened innovations (T, m), its ratio and how far it is ahead, (T,) each, of
/// a monitor that never names anybody.
#[pyfunction]
#[pyo3(signature = (plant, filter, *, statistic, news))]
pub fn bias_leads<'py>(
    py: Python<'py>,
    plant: &Bound<'py, PyAny>,
    filter: Filter<'py>,
    statistic: Statistic,
    news: Array<'py>,
) -> PyResult<Leads<'py>> {
    let estimator = build(plant, &filter, statistic, (f64::INFINITY, 0.0, 1, 0.0, 0.0))?;
    let news = arrays::slice("news", &news)?;
    let (mut sensors, mut ratios, mut ahead) = (vec![], vec![], vec![]);
    py.detach(|| {
        estimator.listen(news, |lead: Lead| {
            sensors.push(lead.sensor as i64);
            ratios.push(lead.score);
            ahead.push(lead.ahead);
        });
    });
    Ok((PyArray1::from_vec(py, sensors), PyArray1::from_vec(py, ratios), PyArray1::from_vec(py, ahead)))
}

fn build(
    plant: &Bound<'_, PyAny>,
    (gain, innovation_cov, covariance): &Filter<'_>,
    (window, kappa, gamma): Statistic,
    (limit, margin, persist, further, drop): Decision,
) -> PyResult<BiasMonitor> {
    let design = Design {
        gain: arrays::owned("gain", gain)?,
        innovation_cov: arrays::owned("innovation_cov", innovation_cov)?,
        covariance: arrays::owned("covariance", covariance)?,
        rule: Rule { window, kappa, gamma },
        law: Law { limit, margin, persist, further, uncheckable: plant.getattr("uncheckable")?.extract()? },
        drop,
    };
    let positive = gamma > 0.0 && gamma.is_finite();
    if !positive {
        return Err(to_python(Error::input("gamma", "a number > 0", gamma.to_string())));
    }
    BiasMonitor::new(plant::model(plant)?, design).map_err(to_python)
}
