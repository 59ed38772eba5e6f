//! Numerical kernels of securestate: filters that advance a state by one measurement at a time.
//!
//! Reading order: [`estimator`] (the trait), [`bank`] (the drivers over it), then one file per algorithm.

#![forbid(unsafe_code)]

pub mod adaptive_joint;
pub mod augmented;
pub mod bank;
pub mod bias_monitor;
pub mod codec;
pub mod dense;
pub mod detectors;
mod error;
pub mod estimator;
pub mod group_lasso;
pub mod joint_fusion;
pub mod kalman;
pub mod lanes;
pub mod lasso;
pub mod linalg;
pub mod matrix;
pub mod mixture;
pub mod mixture_fusion;
pub mod penalty;
pub mod projection;
pub mod protected;
pub mod reaction;
pub mod record;
pub mod secure;
pub mod simulation;
pub mod smoother;
pub mod sparse_fusion;
pub mod units;

pub use bank::{Block, Design, Filter, Kernel};
pub use error::{Error, Result};
pub use estimator::{Dims, Estimator, Output, Status};
pub use record::Record;
pub use units::Units;
