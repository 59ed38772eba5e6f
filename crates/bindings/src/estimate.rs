//! The result of one live step.

use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use securestate_kernels::{Dims, Output};

/// Result of one step; the same fields as a `Run`, for one sample.
#[pyclass(frozen, module = "securestate._kernels")]
pub struct Estimate {
    dims: Dims,
    names: &'static [&'static str],
    /// x, x_std, trust, attack, attack_std, innovation, innovation_std, diagnostics, P, one after the other.
    numbers: Box<[f64]>,
    suspected: Box<[u8]>,
    status: u8,
}

impl Estimate {
    pub fn new(dims: Dims, names: &'static [&'static str]) -> Self {
        let (n, m, sensors) = (dims.states, dims.channels, dims.sensors);
        let total = 2 * n + sensors + 4 * m + names.len() + n * n;
        Self {
            dims,
            names,
            numbers: vec![0.0; total].into_boxed_slice(),
            suspected: vec![0; sensors].into_boxed_slice(),
            status: 0,
        }
    }

    /// Where a kernel writes.
    pub fn output(&mut self) -> Output<'_> {
        let (n, m, sensors) = (self.dims.states, self.dims.channels, self.dims.sensors);
        let (x, rest) = self.numbers.split_at_mut(n);
        let (x_std, rest) = rest.split_at_mut(n);
        let (trust, rest) = rest.split_at_mut(sensors);
        let (attack, rest) = rest.split_at_mut(m);
        let (attack_std, rest) = rest.split_at_mut(m);
        let (innovation, rest) = rest.split_at_mut(m);
        let (innovation_std, rest) = rest.split_at_mut(m);
        let (diagnostics, covariance) = rest.split_at_mut(self.names.len());
        Output {
            x,
            x_std,
            covariance: Some(covariance),
            trust,
            attack,
            attack_std,
            suspected: &mut self.suspected,
            innovation,
            innovation_std,
            diagnostics,
            status: &mut self.status,
        }
    }

    /// Part of `numbers` after `skip` entries.
    fn part<'py>(&self, py: Python<'py>, skip: usize, count: usize) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.numbers[skip..skip + count])
    }
}

#[pymethods]
impl Estimate {
    /// Filtered state x[k|k], shape (n,).
    #[getter]
    fn x<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.part(py, 0, self.dims.states)
    }

    /// Standard deviations of x, shape (n,).
    #[getter]
    fn x_std<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.part(py, self.dims.states, self.dims.states)
    }

    /// Covariance of x, shape (n, n).
    #[getter(P)]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let n = self.dims.states;
        self.part(py, self.numbers.len() - n * n, n * n).reshape([n, n])
    }

    /// Trust per sensor in [0, 1], NaN where it sent nothing or nothing speaks for it, shape (N,).
    #[getter]
    fn trust<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.part(py, 2 * self.dims.states, self.dims.sensors)
    }

    /// Estimated injection per channel in sensor units, shape (m,).
    #[getter]
    fn attack<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let skip = 2 * self.dims.states + self.dims.sensors;
        self.part(py, skip, self.dims.channels)
    }

    /// Standard deviation of its error in sensor units, NaN where none is stated, shape (m,).
    #[getter]
    fn attack_std<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let skip = 2 * self.dims.states + self.dims.sensors + self.dims.channels;
        self.part(py, skip, self.dims.channels)
    }

    /// y − C x[k|k−1] − D u in sensor units, shape (m,).
    #[getter]
    fn innovation<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let skip = 2 * self.dims.states + self.dims.sensors + 2 * self.dims.channels;
        self.part(py, skip, self.dims.channels)
    }

    /// Its standard deviation when nobody lies, shape (m,).
    #[getter]
    fn innovation_std<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let skip = 2 * self.dims.states + self.dims.sensors + 3 * self.dims.channels;
        self.part(py, skip, self.dims.channels)
    }

    /// Whether a sensor is suspected, shape (N,).
    #[getter]
    fn suspected<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        PyArray1::from_iter(py, self.suspected.iter().map(|&s| s != 0))
    }

    /// A `Status` number.
    #[getter]
    fn status(&self) -> u8 {
        self.status
    }

    /// Numbers about the step itself, by name.
    #[getter]
    fn diagnostics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let skip = 2 * self.dims.states + self.dims.sensors + 4 * self.dims.channels;
        let values = PyDict::new(py);
        for (name, value) in self.names.iter().zip(&self.numbers[skip..]) {
            values.set_item(name, value)?;
        }
        Ok(values)
    }

    fn __repr__(&self) -> String {
        let suspects = self.suspected.iter().filter(|&&s| s != 0).count();
        format!(
            "Estimate(x={:?}, suspected={suspects} of {}, status={})",
            &self.numbers[..self.dims.states],
            self.dims.sensors,
            self.status
        )
    }
}
