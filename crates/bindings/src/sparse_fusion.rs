//! Sparse fusion: the design's matrices in, a kernel out; and the solver alone, for tests and benchmarks.

use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use securestate_kernels::penalty::Problem;
use securestate_kernels::projection::{Blocks, Projection};
use securestate_kernels::sparse_fusion::{Matrices, SparseFusion};
use securestate_kernels::{Design, Dims, Error, group_lasso, lasso};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;

/// Kernel of `SparseFusion`. `design` holds every matrix by the name of its field; sizes are checked.
#[pyfunction]
pub fn sparse_fusion(design: &Bound<'_, PyDict>) -> PyResult<Kernel> {
    let get = |name: &'static str| floats(design, name);
    let dims = Dims {
        states: number(design, "n")?,
        channels: number(design, "m")?,
        sensors: number(design, "N")?,
        inputs: number(design, "p_inputs")?,
    };
    let matrices = Matrices {
        dims,
        a: get("a")?,
        b: get("b")?,
        c: get("c")?,
        d: get("d")?,
        t_transposed: get("t_transposed")?,
        drive: get("drive")?,
        input_map: get("input_map")?,
        start_map: get("start_map")?,
        modes: get("modes")?,
        a_s: get("a_s")?,
        b_s: get("b_s")?,
        c_s: get("c_s")?,
        v_s: get("v_s")?,
        fusion: get("fusion")?,
        fusion_g: get("fusion_g")?,
        hessian: get("hessian")?,
        groups: item(design, "groups")?.extract()?,
        sensors: item(design, "sensors")?.extract()?,
        channel_sensor: item(design, "channel_sensor")?.extract()?,
        gamma: get("gamma")?,
        attack_now: get("attack_now")?,
        attack_before: get("attack_before")?,
        p: get("p")?,
        q: get("q")?,
        krk: get("krk")?,
        ikc: get("ikc")?,
        innovation_std: get("innovation_std")?,
        suspicion: item(design, "suspicion")?.extract()?,
        refit: number(design, "refit")?,
    };
    let units = securestate_kernels::Units {
        offset: get("offset")?,
        scale: get("scale")?,
        input_offset: get("input_offset")?,
        input_scale: get("input_scale")?,
        uncheckable: item(design, "uncheckable")?.extract()?,
    };
    let estimator = SparseFusion::new(matrices, projection(design, dims)?).map_err(to_python)?;
    let inner = Design::boxed(estimator, units).map_err(to_python)?;
    Ok(Kernel { inner })
}

/// −Sᵀ N dense where `projection` is given, from its factors otherwise.
fn projection(design: &Bound<'_, PyDict>, dims: Dims) -> PyResult<Projection> {
    let sensors: Vec<usize> = item(design, "sensors")?.extract()?;
    let locals: Vec<usize> = item(design, "locals")?.extract()?;
    let inverse =
        Blocks::new(sensors.clone(), locals.clone(), floats(design, "basis_inverse")?).map_err(to_python)?;
    if design.contains("projection")? {
        return Projection::dense(floats(design, "projection")?, inverse).map_err(to_python);
    }
    let basis = Blocks::new(sensors, locals, floats(design, "basis_transposed")?).map_err(to_python)?;
    Projection::structured(
        dims.states,
        floats(design, "precision")?,
        floats(design, "mix")?,
        floats(design, "core")?,
        basis,
        inverse,
    )
    .map_err(to_python)
}

fn item<'py>(design: &Bound<'py, PyDict>, name: &'static str) -> PyResult<Bound<'py, PyAny>> {
    design.get_item(name)?.ok_or_else(|| to_python(Error::input(name, "a matrix of the design", "nothing")))
}

fn floats(design: &Bound<'_, PyDict>, name: &'static str) -> PyResult<Vec<f64>> {
    let array: Array<'_> = item(design, name)?.extract()?;
    arrays::owned(name, &array)
}

fn number(design: &Bound<'_, PyDict>, name: &'static str) -> PyResult<usize> {
    item(design, name)?.extract()
}

/// A solver that keeps its workspace and its last solution as warm start. For tests and benchmarks.
#[pyclass(module = "securestate._kernels")]
pub struct PenaltySolver {
    hessian: Vec<f64>,
    starts: Vec<usize>,
    gamma: Vec<f64>,
    g: Vec<f64>,
    elements: Option<lasso::Workspace>,
    groups: group_lasso::Workspace,
}

#[pymethods]
impl PenaltySolver {
    /// min ½ gᵀHg − linearᵀg + Σ γ_j ‖g_j‖; group j starts at `starts[j]`, `starts[-1]` = d.
    #[new]
    fn new(hessian: Array<'_>, starts: Vec<usize>, gamma: Array<'_>) -> PyResult<Self> {
        let (hessian, gamma) = (arrays::owned("hessian", &hessian)?, arrays::owned("gamma", &gamma)?);
        let d = starts.last().copied().unwrap_or(0);
        let ordered = starts.first() == Some(&0) && starts.windows(2).all(|w| w[0] < w[1]);
        if !ordered {
            let received = format!("{starts:?}");
            return Err(to_python(Error::input("starts", "increasing from 0 to d", received)));
        }
        Error::check_len("hessian", d * d, hessian.len()).map_err(to_python)?;
        Error::check_len("gamma", starts.len() - 1, gamma.len()).map_err(to_python)?;
        let single = starts.windows(2).all(|w| w[1] - w[0] == 1);
        Ok(Self {
            g: vec![0.0; d],
            elements: single.then(|| lasso::Workspace::new(d)),
            groups: group_lasso::Workspace::new(d, gamma.len()),
            hessian,
            starts,
            gamma,
        })
    }

    /// Solution g (d,), iterations and relative duality gap, for one right-hand side and energy q.
    fn solve<'py>(
        &mut self,
        py: Python<'py>,
        linear: Array<'_>,
        energy: f64,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, usize, f64)> {
        let linear = arrays::slice("linear", &linear)?;
        Error::check_len("linear", self.g.len(), linear.len()).map_err(to_python)?;
        let problem =
            Problem { hessian: &self.hessian, linear, starts: &self.starts, gamma: &self.gamma, energy };
        if problem.zero_is_optimal() {
            self.g.fill(0.0);
            return Ok((self.g.clone().into_pyarray(py), 0, 0.0));
        }
        let outcome = match &mut self.elements {
            Some(workspace) => lasso::solve(&problem, &mut self.g, workspace),
            None => group_lasso::solve(&problem, &mut self.g, &mut self.groups),
        };
        Ok((self.g.clone().into_pyarray(py), outcome.iterations, outcome.gap))
    }
}
