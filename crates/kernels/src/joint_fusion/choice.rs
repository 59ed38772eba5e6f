//! What decides η and who counts as protected at every sample.
//!
//! ```text
//!     fixed      η as given; the protected sensors are those of the plant
//!     adaptive   ν = y_w − C_w x⁻_i − D_w u given the protected innovations of the local, S its variance if nothing is
//!                injected; η = max(0, mean of ν² − S over a window), at once at least ν² − S if ν² > gate · S
//!     auto       a detector says who is trusted; a sensor that is not keeps its own η and is in no other local, one
//!                that is has η = 0 and is in all of them. Nobody trusted: nothing is used
//! ```

use crate::adaptive_joint::window::Window;
use crate::codec::{Decoder, Encoder, Fingerprint};
use crate::detectors::{self, Detector};
use crate::estimator::Buffers;
use crate::joint_fusion::covariance::{Covariance, Design};
use crate::joint_fusion::layout::{Local, Pattern};
use crate::linalg::{cholesky, dot, forward_solve};
use crate::matrix::Matrix;
use crate::{Estimator, Result};

/// η beyond this times S says no more; a reading further off than the root of it is taken to be that far off.
const LARGEST: f64 = 1e12;

/// How η and the protected sensors are chosen.
#[derive(Debug, Clone)]
pub enum Choice {
    /// As given.
    Fixed,
    /// η from the innovations.
    Adaptive {
        /// Samples over which ν² − S is averaged.
        window: usize,
        /// ν²/S above which a sample counts at once.
        gate: f64,
    },
    /// Who is trusted from a detector.
    Auto {
        /// The detector.
        detector: Box<Detector>,
        /// Sensors that are trusted whatever it says, (N,).
        marked: Vec<bool>,
    },
}

/// What a choice remembers.
#[derive(Debug, Clone)]
pub enum Memory {
    /// Nothing.
    Fixed,
    /// The latest ν² − S of every injection, and scratch.
    Adaptive(Box<Adaptive>),
    /// The detector's state and its latest results.
    Auto(Box<(detectors::State, Buffers)>),
}

/// Memory and scratch of the adaptive η.
#[derive(Debug, Clone)]
pub struct Adaptive {
    window: Window,
    /// How far every injection may be off, (Σ p_i,).
    reach: Vec<f64>,
    p: Matrix,
    half: Vec<f64>,
    base: Vec<f64>,
    /// S of the protected rows that arrived, then its factor.
    s: Vec<f64>,
    rows: Vec<usize>,
    white: Vec<f64>,
    cross: Vec<f64>,
}

impl Choice {
    /// Before the first sample.
    ///
    /// # Errors
    /// As [`Estimator::start`] of the detector.
    pub fn start(&self, design: &Design, mean: &[f64], covariance: Option<&[f64]>) -> Result<Memory> {
        Ok(match self {
            Self::Fixed => Memory::Fixed,
            Self::Adaptive { window, .. } => Memory::Adaptive(Box::new(Adaptive::new(design, *window))),
            Self::Auto { detector, .. } => {
                let buffers = Buffers::new(detector.dims(), detector.diagnostics().len());
                Memory::Auto(Box::new((detector.start(mean, covariance)?, buffers)))
            }
        })
    }

    /// Write what a memory holds.
    pub fn save(&self, memory: &Memory, to: &mut Encoder) {
        match (self, memory) {
            (Self::Auto { detector, .. }, Memory::Auto(state)) => detector.save(&state.0, to),
            (_, Memory::Adaptive(adaptive)) => adaptive.window.save(to),
            _ => (),
        }
    }

    /// Read it back.
    ///
    /// # Errors
    /// If the bytes do not fit.
    pub fn load(&self, design: &Design, from: &mut Decoder<'_>) -> Result<Memory> {
        Ok(match self {
            Self::Fixed => Memory::Fixed,
            Self::Adaptive { window, .. } => {
                let mut adaptive = Adaptive::new(design, *window);
                adaptive.window.load(from)?;
                Memory::Adaptive(Box::new(adaptive))
            }
            Self::Auto { detector, .. } => {
                let buffers = Buffers::new(detector.dims(), detector.diagnostics().len());
                Memory::Auto(Box::new((detector.load(from)?, buffers)))
            }
        })
    }

    /// Mix in the settings.
    #[must_use]
    pub fn fingerprint(&self, hash: Fingerprint) -> Fingerprint {
        match self {
            Self::Fixed => hash,
            Self::Adaptive { window, gate } => hash.sizes(&[*window]).floats(&[*gate]),
            Self::Auto { detector, marked } => {
                let marked: Vec<usize> = marked.iter().map(|&one| usize::from(one)).collect();
                hash.bytes(&detector.fingerprint().to_le_bytes()).sizes(&marked)
            }
        }
    }
}

/// Who is trusted at this sample: whoever the detector does not suspect, and marked sensors that sent something.
///
/// # Errors
/// As [`Estimator::step`] of the detector.
pub fn trust(
    design: &Design,
    (detector, marked): (&Detector, &[bool]),
    (state, told): &mut (detectors::State, Buffers),
    (y, u): (&[f64], &[f64]),
    pattern: &mut Pattern,
) -> Result<()> {
    detector.step(state, y, u, &mut told.output())?;
    for (sensor, _) in marked.iter().enumerate().filter(|(_, marked)| **marked) {
        told.suspected[sensor] = 0;
        if !told.trust[sensor].is_nan() {
            told.trust[sensor] = 1.0;
        }
    }
    let owner = &design.model.channel_sensor;
    let trusted = |sensor: usize| told.trust[sensor] > 0.5;
    let anybody = (0..told.trust.len()).any(trusted);
    for local in &design.layout.locals {
        for (row, &channel) in local.channels.iter().enumerate() {
            let counts = row < local.weak || trusted(owner[channel]);
            pattern.heard[local.first_row + row] &= anybody && counts;
        }
        if trusted(local.sensor) {
            pattern.eta[local.first_weak..local.first_weak + local.weak].fill(0.0);
        }
    }
    Ok(())
}

impl Memory {
    /// How far every injection may be off, (Σ p_i,); empty if that is not limited.
    #[must_use]
    pub fn reach(&self) -> &[f64] {
        match self {
            Self::Adaptive(adaptive) => &adaptive.reach,
            _ => &[],
        }
    }
}

impl Adaptive {
    fn new(design: &Design, window: usize) -> Self {
        let (layout, n) = (&design.layout, design.layout.n);
        let tallest = layout.locals.iter().map(Local::height).max().unwrap_or(0);
        Self {
            window: Window::new(layout.weak, window),
            reach: vec![f64::INFINITY; layout.weak],
            p: Matrix::zeros(n, n),
            half: vec![0.0; n],
            base: vec![0.0; design.model.dims.channels],
            s: vec![0.0; tallest * tallest],
            rows: Vec::with_capacity(tallest),
            white: vec![0.0; tallest],
            cross: vec![0.0; tallest],
        }
    }

    /// η of every injection whose channel arrived, from x⁻ of the locals (states one after the other).
    pub fn choose(
        &mut self,
        design: &Design,
        gate: f64,
        k: usize,
        (p, states): (&Covariance, &[f64]),
        (y, u): (&[f64], &[f64]),
        pattern: &mut Pattern,
    ) {
        self.base.copy_from_slice(y);
        design.model.subtract_feedthrough(u, &mut self.base);
        for (i, local) in design.layout.locals.iter().enumerate() {
            let x = &states[local.state(design.layout.n)][..design.layout.n];
            p.local_prior(design.layout.n, i, &mut self.p);
            self.hear(design, k, local, x, pattern);
            for q in (0..local.weak).filter(|q| pattern.heard[local.first_row + q]) {
                let (nu, s) = self.surprise(design, k, local, x, q);
                let eta = self.window.eta(local.first_weak + q, nu, s, gate);
                pattern.eta[local.first_weak + q] = eta.min(LARGEST * s);
                self.reach[local.first_weak + q] = (LARGEST * s).sqrt();
            }
        }
    }

    /// The whitened innovations of the protected rows that arrived.
    fn hear(&mut self, design: &Design, k: usize, local: &Local, x: &[f64], pattern: &Pattern) {
        let heard = |row: &usize| pattern.heard[local.first_row + row];
        self.rows.clear();
        self.rows.extend((local.weak..local.height()).filter(heard).map(|row| local.channels[row]));
        let count = self.rows.len();
        for a in 0..count {
            self.white[a] = self.innovation(design, k, self.rows[a], x);
            for b in 0..=a {
                self.s[a * count + b] = self.covariance(design, k, self.rows[a], self.rows[b]);
            }
        }
        if cholesky(&mut self.s, count, count, 0.0).is_err() {
            self.rows.clear();
        }
        let count = self.rows.len();
        forward_solve(&self.s, count, &mut self.white[..count]);
    }

    /// ν and S of one injection.
    fn surprise(&mut self, design: &Design, k: usize, local: &Local, x: &[f64], q: usize) -> (f64, f64) {
        let (channel, count) = (local.channels[q], self.rows.len());
        for b in 0..count {
            self.cross[b] = self.covariance(design, k, channel, self.rows[b]);
        }
        forward_solve(&self.s, count, &mut self.cross[..count]);
        let (cross, white) = (&self.cross[..count], &self.white[..count]);
        let nu = self.innovation(design, k, channel, x) - dot(cross, white);
        let left = dot(cross, cross);
        let whole = self.covariance(design, k, channel, channel);
        let m = design.model.dims.channels;
        (nu, (whole - left).max(f64::EPSILON * design.model.noise.r[channel * m + channel]))
    }

    fn innovation(&self, design: &Design, k: usize, channel: usize, x: &[f64]) -> f64 {
        let n = x.len();
        self.base[channel] - dot(&design.model.c(k)[channel * n..(channel + 1) * n], x)
    }

    /// C_a P C_bᵀ + R_ab.
    fn covariance(&mut self, design: &Design, k: usize, a: usize, b: usize) -> f64 {
        let (n, m, c) = (self.half.len(), design.model.dims.channels, design.model.c(k));
        crate::linalg::gemv(self.p.numbers(), &c[b * n..(b + 1) * n], &mut self.half);
        dot(&c[a * n..(a + 1) * n], &self.half) + design.model.noise.r[a * m + b]
    }
}
