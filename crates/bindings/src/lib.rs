//! `securestate._kernels`: borrows arrays, releases the GIL, maps errors. No mathematics here.

use pyo3::prelude::*;

mod adaptive_joint;
mod arrays;
mod augmented;
mod bias_monitor;
mod detector;
mod errors;
mod estimate;
mod filter;
mod joint_fusion;
mod kalman;
mod kernel;
mod mixture;
mod mixture_fusion;
mod plant;
mod secure;
mod simulation;
mod smoother;
mod sparse_fusion;

/// Run-time kernels of securestate.
#[pymodule]
mod _kernels {
    #[pymodule_export]
    use super::adaptive_joint::adaptive_joint;
    #[pymodule_export]
    use super::augmented::augmented;
    #[pymodule_export]
    use super::bias_monitor::{bias_leads, bias_monitor};
    #[pymodule_export]
    use super::detector::detector;
    #[pymodule_export]
    use super::estimate::Estimate;
    #[pymodule_export]
    use super::filter::Filter;
    #[pymodule_export]
    use super::joint_fusion::{joint_fusion, joint_moments, protected_kalman};
    #[pymodule_export]
    use super::kalman::kalman;
    #[pymodule_export]
    use super::kernel::Kernel;
    #[pymodule_export]
    use super::mixture::innovation_mixture;
    #[pymodule_export]
    use super::mixture_fusion::mixture_fusion;
    #[pymodule_export]
    use super::secure::secure_filter;
    #[pymodule_export]
    use super::simulation::simulate;
    #[pymodule_export]
    use super::smoother::smooth;
    #[pymodule_export]
    use super::sparse_fusion::{PenaltySolver, sparse_fusion};
}
