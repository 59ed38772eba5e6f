//! The kernels of joint fusion, and of the Kalman filter that hears protected sensors only.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use securestate_kernels::joint_fusion::JointFusion;
use securestate_kernels::joint_fusion::choice::Choice;
use securestate_kernels::joint_fusion::covariance::{Design as Recursions, Form};
use securestate_kernels::joint_fusion::fusion::Rule;
use securestate_kernels::joint_fusion::layout::Layout;
use securestate_kernels::kalman::Kalman;
use securestate_kernels::kalman::model::Model;
use securestate_kernels::protected::Protected;
use securestate_kernels::{Design, Error, Result};

use crate::arrays::{self, Array};
use crate::detector;
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Channels that may lie and channels that do not, of one local estimator.
type Stack = (Vec<usize>, Vec<usize>);

/// The plant of the protected sensors, P[k|k−1] of its steady state or None, and the channels of the whole plant.
type Alone<'py> = (Bound<'py, PyAny>, Option<Array<'py>>, Vec<usize>);

fn alone(model: Model, (selected, prior, own): &Alone<'_>, quantiles: &Array<'_>) -> PyResult<Protected> {
    let inner = plant::model(selected)?;
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let filter = Kalman::new(inner, prior).map_err(to_python)?;
    let quantiles = arrays::owned("quantiles", quantiles)?;
    Protected::new(filter, model, own.clone(), quantiles).map_err(to_python)
}

/// Kernel of the Kalman filter that hears protected sensors only. `quantiles` (m + 1,) bound the squared distance of
/// the others per number of channels.
#[pyfunction]
#[pyo3(signature = (plant, protected, quantiles))]
pub fn protected_kalman(
    plant: &Bound<'_, PyAny>,
    protected: Alone<'_>,
    quantiles: Array<'_>,
) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let filter = alone(model, &protected, &quantiles)?;
    Ok(Kernel { inner: Design::boxed(filter, units).map_err(to_python)? })
}

fn recursions(model: Model, stacks: &[Stack], form: &str, fusion: &str) -> Result<Recursions> {
    let layout = Layout::new(model.dims.states, &model.channel_sensor, stacks)?;
    let form = match form {
        "exact" => Form::Exact,
        "square-root" => Form::SquareRoot,
        "printed" => Form::Printed,
        other => return Err(Error::input("form", "exact, square-root or printed", other)),
    };
    let rule = match fusion {
        "optimal" => Rule::Optimal,
        "average" => Rule::Average,
        "covariance-intersection" => Rule::CovarianceIntersection,
        other => return Err(Error::input("fusion", "optimal, average or covariance-intersection", other)),
    };
    Ok(Recursions::new(model, layout, form, rule))
}

/// Kernel of joint fusion, and whether it has a steady state. `stacks` are the channels of every local estimator,
/// `eta` (Σ p,) or (T, Σ p) in normalised units, `adaptive` the window and the gate if η comes from the innovations,
/// `detector` the arguments of a detector if it says who is protected, `protected` the filter beside it, `prior`
/// (n, n) where the search for a steady state begins.
#[pyfunction]
#[pyo3(signature = (plant, stacks, *, eta, adaptive, detector, form, fusion, protected, quantiles, prior))]
#[allow(clippy::too_many_arguments)]
pub fn joint_fusion(
    plant: &Bound<'_, PyAny>,
    stacks: Vec<Stack>,
    eta: Array<'_>,
    adaptive: Option<(usize, f64)>,
    detector: Option<detector::Arguments<'_>>,
    form: &str,
    fusion: &str,
    protected: Option<Alone<'_>>,
    quantiles: Array<'_>,
    prior: Option<Array<'_>>,
) -> PyResult<(Kernel, bool)> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let beside = protected.map(|given| alone(model.clone(), &given, &quantiles)).transpose()?;
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let design = recursions(model, &stacks, form, fusion).map_err(to_python)?;
    let choice = match (adaptive, detector) {
        (Some((window, gate)), _) => Choice::Adaptive { window, gate },
        (None, Some(given)) => Choice::Auto {
            detector: Box::new(detector::build(plant, &given)?),
            marked: plant.getattr("protected")?.extract()?,
        },
        (None, None) => Choice::Fixed,
    };
    let eta = arrays::owned("eta", &eta)?;
    let estimator = JointFusion::new(design, (eta, choice), beside, prior).map_err(to_python)?;
    let steady = estimator.is_steady();
    Ok((Kernel { inner: Design::boxed(estimator, units).map_err(to_python)? }, steady))
}

/// Gains and moments of joint fusion by name, from the covariance `prior` (n, n) of x[0|−1]. `heard` (T, m) says which
/// channels arrive, `eta` (T, Σ p) in normalised units.
#[pyfunction]
#[pyo3(signature = (plant, stacks, *, eta, form, fusion, prior, heard))]
#[allow(clippy::too_many_arguments)]
pub fn joint_moments<'py>(
    py: Python<'py>,
    plant: &Bound<'py, PyAny>,
    stacks: Vec<Stack>,
    eta: Array<'py>,
    form: &str,
    fusion: &str,
    prior: Array<'py>,
    heard: PyReadonlyArray2<'py, bool>,
) -> PyResult<Bound<'py, PyDict>> {
    let model = plant::model(plant)?;
    let design = recursions(model, &stacks, form, fusion).map_err(to_python)?;
    let (layout, heard) = (&design.layout, heard.as_array());
    let steps = heard.nrows();
    let eta = arrays::slice("eta", &eta)?;
    let prior = arrays::slice("prior", &prior)?;
    let n = layout.n;
    Error::check_len("eta", steps * layout.weak, eta.len()).map_err(to_python)?;
    Error::check_len("prior", n * n, prior.len()).map_err(to_python)?;
    Error::check_len("heard", design.model.dims.channels, heard.ncols()).map_err(to_python)?;
    let channels: Vec<usize> = layout.locals.iter().flat_map(|local| local.channels.clone()).collect();
    let rows: Vec<bool> =
        heard.rows().into_iter().flat_map(|row| channels.iter().map(move |&c| row[c])).collect();
    let trace = py.detach(|| design.trace(prior, &rows, eta)).map_err(to_python)?;
    let arrays = PyDict::new(py);
    let mut locals = [("K", &trace.gain), ("Gamma", &trace.gamma), ("P_X", &trace.px)].to_vec();
    locals.extend([("U", &trace.u), ("V", &trace.v)]);
    for (name, numbers) in locals {
        let list = PyList::empty(py);
        for (local, numbers) in layout.locals.iter().zip(numbers) {
            let (size, p, m) = (n + local.weak, local.weak, local.height());
            let shape = match name {
                "K" => [steps, size, m],
                "Gamma" => [steps, p, m],
                "P_X" => [steps, size, size],
                "U" => [steps, size, p],
                _ => [steps, p, p],
            };
            list.append(PyArray1::from_slice(py, numbers).reshape(shape)?)?;
        }
        arrays.set_item(name, list)?;
    }
    let size = n * layout.count();
    arrays.set_item("Sigma", PyArray1::from_vec(py, trace.sigma).reshape([steps, size, size])?)?;
    arrays.set_item("G", PyArray1::from_vec(py, trace.weights).reshape([steps, n, size])?)?;
    arrays.set_item("P0", PyArray1::from_vec(py, trace.covariance).reshape([steps, n, n])?)?;
    arrays.set_item("broken", PyArray1::from_iter(py, trace.broken.iter().map(|&b| b != 0)))?;
    Ok(arrays)
}
