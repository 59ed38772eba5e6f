//! The kernel of the mixture about measurements.

use pyo3::prelude::*;
use securestate_kernels::mixture::Mixture;
use securestate_kernels::mixture::settings::{Attacked, Form, Memory, Settings};
use securestate_kernels::{Design, Error, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Kernel of an innovation mixture. `plant` and `prior` are those of `kalman`. `form` is "propagation" or "belief",
/// `attacked` "learned" or "student" with log constants `student` per number of channels, `memory` "rate", "doubt"
/// or "sticky"; `monitor` holds the forgetting and the quantiles per number of channels.
#[pyfunction]
#[pyo3(signature = (
    plant, prior, *, form, attacked, memory, merge, kappa, forgetting, cap, tolerance, student, monitor
))]
#[allow(clippy::too_many_arguments)]
pub fn innovation_mixture(
    plant: &Bound<'_, PyAny>,
    prior: Option<Array<'_>>,
    form: &str,
    attacked: &str,
    memory: &str,
    merge: bool,
    kappa: f64,
    forgetting: f64,
    cap: usize,
    tolerance: f64,
    student: (f64, Array<'_>),
    monitor: (Option<f64>, Array<'_>),
) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let settings = Settings {
        form: named("form", form, [("propagation", Form::Propagation), ("belief", Form::Weight)])?,
        attacked: named(
            "attacked",
            attacked,
            [("learned", Attacked::Learned), ("student", Attacked::Student)],
        )?,
        memory: named(
            "memory",
            memory,
            [("rate", Memory::Rate), ("doubt", Memory::Doubt), ("sticky", Memory::Sticky)],
        )?,
        merge,
        kappa,
        forgetting,
        monitor: monitor.0,
        cap,
        tolerance,
        student: arrays::owned("student", &student.1)?,
        degrees: student.0,
        quantiles: arrays::owned("quantiles", &monitor.1)?,
        protected: plant.getattr("protected")?.extract()?,
    };
    let design = || -> Result<_> { Design::boxed(Mixture::new(model, prior, settings)?, units) };
    Ok(Kernel { inner: design().map_err(to_python)? })
}

fn named<T: Copy, const N: usize>(argument: &'static str, given: &str, known: [(&str, T); N]) -> PyResult<T> {
    let found = known.iter().find(|(name, _)| *name == given).map(|(_, value)| *value);
    found.ok_or_else(|| {
        to_python(Error::input(argument, known.map(|(name, _)| name).join(" or "), given.to_owned()))
    })
}
