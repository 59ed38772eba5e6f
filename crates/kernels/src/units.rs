//! The operating point: files and users speak engineering units, kernels the normalised plant's.
//!
//! `y_file = offset + scale · y`, `u_file = input_offset + input_scale · u`.

use crate::{Error, Output, Result};

/// Offset and scale per channel and per input.
#[derive(Debug, Clone, PartialEq)]
pub struct Units {
    /// (m,)
    pub offset: Vec<f64>,
    /// (m,), positive.
    pub scale: Vec<f64>,
    /// (p,)
    pub input_offset: Vec<f64>,
    /// (p,), positive.
    pub input_scale: Vec<f64>,
}

impl Units {
    /// y in normalised units; NaN stays NaN.
    ///
    /// # Errors
    /// An infinite measurement.
    pub fn normalise_measurement(&self, file: &[f64], y: &mut [f64]) -> Result<()> {
        for (i, value) in y.iter_mut().enumerate() {
            if file[i].is_infinite() {
                return Err(Error::input(
                    "y",
                    "finite numbers, or NaN where a sample is missing",
                    format!("{} in channel {i}", file[i]),
                ));
            }
            *value = (file[i] - self.offset[i]) / self.scale[i];
        }
        Ok(())
    }

    /// u in normalised units.
    ///
    /// # Errors
    /// An input that is not finite.
    pub fn normalise_input(&self, file: &[f64], u: &mut [f64]) -> Result<()> {
        for (i, value) in u.iter_mut().enumerate() {
            if !file[i].is_finite() {
                return Err(Error::input("u", "finite numbers", format!("{} in input {i}", file[i])));
            }
            *value = (file[i] - self.input_offset[i]) / self.input_scale[i];
        }
        Ok(())
    }

    /// Results in file units.
    pub fn restore(&self, out: &mut Output<'_>) {
        for (i, &scale) in self.scale.iter().enumerate() {
            out.attack[i] *= scale;
            out.attack_std[i] *= scale;
            out.innovation[i] *= scale;
            out.innovation_std[i] *= scale;
        }
    }
}
