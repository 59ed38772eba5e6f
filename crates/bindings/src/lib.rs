//! The Python extension module `securestate._kernels`.

use pyo3::prelude::*;

/// The numerical kernels of securestate.
#[pymodule]
mod _kernels {}
