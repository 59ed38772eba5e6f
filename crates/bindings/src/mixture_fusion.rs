//! The kernel of mixture fusion.

use pyo3::prelude::*;
use securestate_kernels::kalman::Kalman;
use securestate_kernels::mixture_fusion::em::{Rules, Start};
use securestate_kernels::mixture_fusion::{MixtureFusion, Settings};
use securestate_kernels::{Design, Error, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Kernel of mixture fusion. `plant` and `prior` are those of `kalman`; `local` (N, n, n) is the steady covariance of
/// every sensor's own prediction, or None if local filters start from the fused one; `init` is "split", "median",
/// "mean" or "prediction"; `precise` and `prior_floor` say how the mixture is fitted, in at most `cap` iterations.
#[pyfunction]
#[pyo3(signature = (plant, prior, local, *, epsilon, literal, start, init, precise, prior_floor, cap))]
#[allow(clippy::too_many_arguments)] // one per setting, all named
pub fn mixture_fusion(
    plant: &Bound<'_, PyAny>,
    prior: Option<Array<'_>>,
    local: Option<Array<'_>>,
    epsilon: Option<f64>,
    literal: bool,
    start: usize,
    init: &str,
    precise: bool,
    prior_floor: bool,
    cap: usize,
) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let local = local.as_ref().map(|p| arrays::slice("local", p)).transpose()?;
    let design = || -> Result<_> {
        let rules = Rules { start: named(init)?, precise, prior_floor, cap };
        let settings = Settings { epsilon, literal, start, rules };
        Design::boxed(MixtureFusion::new(Kalman::new(model, prior)?, local, settings)?, units)
    };
    Ok(Kernel { inner: design().map_err(to_python)? })
}

fn named(init: &str) -> Result<Start> {
    match init {
        "split" => Ok(Start::Split),
        "median" => Ok(Start::Median),
        "mean" => Ok(Start::Mean),
        "prediction" => Ok(Start::Prediction),
        other => Err(Error::input("init", "split, median, mean or prediction", other)),
    }
}
