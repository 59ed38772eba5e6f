//! The choices behind the beliefs.

use crate::codec::Fingerprint;
use crate::{Error, Result};

/// How an undecided sensor enters the estimate of the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// As the Gaussian with the first two moments of its mixture of honest and attacked: expectation propagation.
    Propagation,
    /// As a sensor whose noise is larger by 1 / γ.
    Weight,
}

/// What an attacked sensor sends, in units of the deviation of its innovation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Attacked {
    /// N(μ, τ²), both learned from the sample.
    Learned,
    /// Student's t about the prediction.
    Student,
}

/// What is remembered of a sensor's past.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Memory {
    /// How often its samples alone looked like lies lately.
    Rate,
    /// How often it was doubted lately, doubt from the past included.
    Doubt,
    /// How often it began and ended lying lately.
    Sticky,
}

/// All of them.
#[derive(Debug, Clone)]
pub struct Settings {
    /// How an undecided sensor enters.
    pub form: Form,
    /// What an attacked sensor sends.
    pub attacked: Attacked,
    /// What is remembered.
    pub memory: Memory,
    /// Whether rival labellings are merged, their spread included, rather than the best one taken.
    pub merge: bool,
    /// κ: prior variance of what an attacked sensor sends.
    pub kappa: f64,
    /// Share of the past that one sample forgets is 1 − this.
    pub forgetting: f64,
    /// Forgetting of the monitor of small biases; None = no monitor.
    pub monitor: Option<f64>,
    /// Iterations at most.
    pub cap: usize,
    /// Change of beliefs that counts as none.
    pub tolerance: f64,
    /// log of the constant of Student's density in m dimensions, without the 2π of a Gaussian, (m_max + 1,).
    pub student: Vec<f64>,
    /// Its degrees of freedom.
    pub degrees: f64,
    /// χ² quantile of the monitor per number of channels, (m_max + 1,).
    pub quantiles: Vec<f64>,
    /// Nobody can tamper with these, (N,).
    pub protected: Vec<bool>,
}

impl Settings {
    /// Check ranges.
    ///
    /// # Errors
    /// A number out of range.
    pub fn check(&self, widest: usize, sensors: usize) -> Result<()> {
        Error::check_len("protected", sensors, self.protected.len())?;
        Error::check_len("student", widest + 1, self.student.len())?;
        Error::check_len("quantiles", widest + 1, self.quantiles.len())?;
        let between = |name: &'static str, value: f64, low: f64, high: f64| match value {
            value if value > low && value < high => Ok(()),
            value => {
                Err(Error::input(name, format!("a number between {low} and {high}"), format!("{value}")))
            }
        };
        between("kappa", self.kappa, 0.0, 1e12)?;
        between("degrees", self.degrees, 0.0, 1e12)?;
        between("forgetting", self.forgetting, 0.0, 1.0)?;
        between("monitor", self.monitor.unwrap_or(0.5), 0.0, 1.0)?;
        between("tolerance", self.tolerance, 0.0, 1.0)?;
        match self.cap {
            0 => Err(Error::input("cap", "at least 1", "0")),
            _ => Ok(()),
        }
    }

    /// Mix in every choice.
    #[must_use]
    pub fn fingerprint(&self, hash: Fingerprint) -> Fingerprint {
        let choices = [
            self.form as usize,
            self.attacked as usize,
            self.memory as usize,
            usize::from(self.merge),
            self.cap,
        ];
        let protected: Vec<usize> = self.protected.iter().map(|&p| usize::from(p)).collect();
        let monitor = self.monitor.unwrap_or(f64::NAN);
        hash.sizes(&choices)
            .sizes(&protected)
            .floats(&[self.kappa, self.forgetting, monitor, self.tolerance, self.degrees])
            .floats(&self.student)
            .floats(&self.quantiles)
    }
}
