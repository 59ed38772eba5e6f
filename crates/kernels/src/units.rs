//! What kernels do not know of a plant: its operating point, and whom nobody vouches for.
//!
//! Files and users speak engineering units, kernels the normalised plant's.
//!
//! `y_file = offset + scale · y`, `u_file = input_offset + input_scale · u`.

use crate::{Error, Output, Result};

/// Offset and scale per channel and per input, and the sensors that cannot be checked.
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
    /// Sensors that may lie and that no other vouches for: nothing ever speaks for them.
    pub uncheckable: Vec<usize>,
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

    /// Results in file units. Where nothing speaks against a sensor that cannot be checked, its trust is NaN.
    pub fn restore(&self, out: &mut Output<'_>) {
        for (i, &scale) in self.scale.iter().enumerate() {
            out.attack[i] *= scale;
            out.attack_std[i] *= scale;
            out.innovation[i] *= scale;
            out.innovation_std[i] *= scale;
        }
        for &sensor in &self.uncheckable {
            if out.suspected[sensor] == 0 {
                out.trust[sensor] = f64::NAN;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Dims;
    use crate::estimator::Buffers;

    #[test]
    fn a_sensor_that_cannot_be_checked_has_a_trust_only_while_it_is_suspected() {
        let dims = Dims { states: 1, channels: 3, sensors: 3, inputs: 0 };
        let (offset, scale) = (vec![0.0; 3], vec![2.0; 3]);
        let units =
            Units { offset, scale, input_offset: vec![], input_scale: vec![], uncheckable: vec![0, 1] };
        let mut sample = Buffers::new(dims, 1);
        sample.trust.copy_from_slice(&[1.0, 0.25, 0.75]);
        sample.suspected.copy_from_slice(&[0, 1, 0]);
        units.restore(&mut sample.output());
        assert!(sample.trust[0].is_nan(), "{:?}", sample.trust);
        assert_eq!(sample.trust[1..], [0.25, 0.75]);
    }
}
