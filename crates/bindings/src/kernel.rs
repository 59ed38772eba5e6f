//! An estimator's kernel: made once at design time, shared by all its filters.

use std::sync::Arc;

use pyo3::prelude::*;

/// The run-time part of an estimator. Made by the functions of this module.
#[pyclass(frozen, module = "securestate._kernels")]
pub struct Kernel {
    pub inner: Arc<dyn securestate_kernels::Kernel>,
}

#[pymethods]
impl Kernel {
    /// Names of the diagnostics, in order.
    #[getter]
    fn diagnostics(&self) -> Vec<&'static str> {
        self.inner.diagnostics().to_vec()
    }
}
