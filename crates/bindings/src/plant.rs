//! A `securestate.Plant` as the kernels know it.

use pyo3::prelude::*;
use securestate_kernels::Units;
use securestate_kernels::kalman::model::{Matrices, Model};

use crate::arrays::{self, Array};
use crate::errors::to_python;

/// The matrices of a plant, checked.
pub fn model(plant: &Bound<'_, PyAny>) -> PyResult<Model> {
    let matrices = Matrices {
        states: plant.getattr("n")?.extract()?,
        a: floats(plant, "A")?,
        b: floats(plant, "B")?,
        c: floats(plant, "C")?,
        d: floats(plant, "D")?,
        q: floats(plant, "Q")?,
        r: floats(plant, "R")?,
        channel_sensor: plant.getattr("channel_sensor")?.extract()?,
        sensors: plant.getattr("n_sensors")?.extract()?,
    };
    Model::new(matrices).map_err(to_python)
}

/// The operating point of a plant, and its sensors that cannot be checked.
pub fn units(plant: &Bound<'_, PyAny>) -> PyResult<Units> {
    let uncheckable: Vec<bool> = plant.getattr("uncheckable")?.extract()?;
    Ok(Units {
        offset: floats(plant, "offset")?,
        scale: floats(plant, "scale")?,
        input_offset: floats(plant, "input_offset")?,
        input_scale: floats(plant, "input_scale")?,
        uncheckable: (0..uncheckable.len()).filter(|&sensor| uncheckable[sensor]).collect(),
    })
}

fn floats(plant: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Vec<f64>> {
    let array: Array<'_> = plant.getattr(name)?.extract()?;
    arrays::owned(name, &array)
}
