//! The kernel of the secure filter.

use std::collections::HashMap;

use pyo3::prelude::*;
use securestate_kernels::secure::Secure;
use securestate_kernels::secure::settings::{Habit, Settings};
use securestate_kernels::{Design, Result};

use crate::arrays::{self, Array};
use crate::errors::to_python;
use crate::kernel::Kernel;
use crate::plant;

/// Kernel of a secure filter.
#[pyfunction]
#[pyo3(signature = (plant, prior, *, habits, sizes, deviations, numbers))]
pub fn secure_filter(
    plant: &Bound<'_, PyAny>,
    prior: Option<Array<'_>>,
    habits: Vec<(f64, f64, f64, f64)>,
    sizes: Vec<usize>,
    deviations: Array<'_>,
    numbers: HashMap<String, f64>,
) -> PyResult<Kernel> {
    let (model, units) = (plant::model(plant)?, plant::units(plant)?);
    let prior = prior.as_ref().map(|p| arrays::slice("prior", p)).transpose()?;
    let n = |name: &str| numbers.get(name).copied().unwrap_or(f64::NAN);
    let habit = |(onset, recovery, duty, weight)| Habit { onset, recovery, duty, weight };
    let settings = Settings {
        habits: habits.into_iter().map(habit).collect(),
        forgetting: (n("habit_forgetting"), n("habit_share")),
        kappa: n("kappa"),
        shares: [n("share_broad"), n("share_now")],
        scale: n("scale"),
        steady: (n("steady_begin"), n("steady_settle"), n("steady_end")),
        bias: (n("bias_first"), n("bias_change")),
        wander: n("wander"),
        turn: n("turn"),
        reuse: n("reuse"),
        starts: [n("start_prior") > 0.0, n("start_gate") > 0.0, n("start_robust") > 0.0],
        cap: n("cap") as usize,
        tolerance: n("tolerance"),
        doubt: (n("doubt") as usize, n("inflation")),
        votes: n("votes"),
        sizes,
        deviations: arrays::owned("deviations", &deviations)?,
        protected: plant.getattr("protected")?.extract()?,
    };
    let design = || -> Result<_> { Design::boxed(Secure::new(model, prior, settings)?, units) };
    Ok(Kernel { inner: design().map_err(to_python)? })
}
